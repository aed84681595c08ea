// Rotations. R_b_from_a takes coordinates in frame a to frame b, so that names cancel: R_c_from_b *
// R_b_from_a.
#pragma once

#include <Eigen/Geometry>

namespace turntable {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

/// exp([v]x): rotation by |v| rad about v.
Matrix3d rotation_from_vector(const Vector3d& v_rad);
/// log(R): the rotation vector, rad, |v| <= pi.
Vector3d vector_from_rotation(const Matrix3d& R);
/// The rotation nearest to M in the Frobenius norm (polar factor by SVD, det +1).
Matrix3d nearest_rotation(const Matrix3d& M);
/// The rotation nearest to the matrix with rows i, j, i x j, for unit i and j that are not parallel
/// (else NaN).
Matrix3d nearest_rotation_from_rows(const Vector3d& i, const Vector3d& j);
/// Angle of R_a^T R_b, rad, in [0, pi].
double geodesic_angle(const Matrix3d& R_a, const Matrix3d& R_b);
/// `angle` wrapped to (-period/2, period/2].
double wrap(double angle, double period);

}  // namespace turntable
