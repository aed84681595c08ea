// The Cramer-Rao bound of a pose: what no unbiased solver can beat.
//   cov(delta, T) = sigma^2 (J^T J)^-1,  J = d(image points)/d(delta, T)
//   X_t = exp([delta]x) R M0Mt + T
// Left perturbation: delta (rad) is in the frame of the rows of R, the plane frame here. Source:
// mathematics of the rig, section 6; golden numbers: cramer_rao.json. Symbols:
//   J     -> (2n x 6), px per rad and px per mm        T -> origin of M0, mm
//   sigma -> sigma_px, standard deviation of each image coordinate, independent, px
// Domain: points in front of the camera that determine the pose. Outside, every number is NaN.
#pragma once

#include <Eigen/Core>
#include <span>

#include "src/attitude/target.h"

namespace turntable {

using ImageJacobian = Eigen::Matrix<double, 2, 3>;  ///< d(u, v)/d(x, y, z) of a point, px/mm

struct PoseBound {
  Eigen::Matrix<double, 6, 6> covariance;  ///< (delta, T): rad^2, rad mm, mm^2

  Matrix3d rotation_covariance_rad2() const { return covariance.topLeftCorner<3, 3>(); }
  /// About x, y, z of the plane frame, deg.
  Vector3d rotation_std_deg() const;
  /// sqrt of the trace, deg: to be compared with the RMSE of the geodesic angle.
  double total_std_deg() const;
};

/// For any camera: `jacobians[t]` is taken at the true position of point t.
PoseBound cramer_rao_bound(const TargetModel& target, const Matrix3d& R_plane_from_target,
                           std::span<const ImageJacobian> jacobians, double sigma_px);

/// For a pinhole at `camera_centre_mm` that looks down -z of the plane frame with `focal_px`.
PoseBound cramer_rao_bound_pinhole(const TargetModel& target, const Matrix3d& R_plane_from_target,
                                   const Vector3d& origin_mm, const Vector3d& camera_centre_mm,
                                   double focal_px, double sigma_px);

}  // namespace turntable
