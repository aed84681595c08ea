#include "src/geometry/rotation.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace turntable {

Matrix3d rotation_from_vector(const Vector3d& v_rad) {
  const double angle = v_rad.norm();
  if (angle == 0.0) return Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, v_rad / angle).toRotationMatrix();
}

Vector3d vector_from_rotation(const Matrix3d& R) {
  const Eigen::AngleAxisd aa(R);
  return aa.angle() * aa.axis();
}

Matrix3d nearest_rotation(const Matrix3d& M) {
  const Eigen::JacobiSVD<Matrix3d> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vector3d sign = Vector3d::Ones();
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0.0) sign.z() = -1.0;
  return svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
}

Matrix3d nearest_rotation_from_rows(const Vector3d& i, const Vector3d& j) {
  // Polar factor (M M^T)^-1/2 M in closed form: M M^T has the eigenvectors (1, +-1, 0) and (0, 0,
  // 1), and i + j and i - j are perpendicular because i and j have the same length.
  const Vector3d sum = (i + j) / (i + j).norm();
  // Nearly parallel rows: i - j is all rounding along i + j, which is taken out.
  Vector3d difference = i - j;
  difference -= sum * sum.dot(difference);
  difference /= difference.norm();
  const Vector3d i_out = std::numbers::sqrt2 / 2.0 * (sum + difference);
  const Vector3d j_out = std::numbers::sqrt2 / 2.0 * (sum - difference);
  Matrix3d R;
  R << i_out.transpose(), j_out.transpose(), i_out.cross(j_out).transpose();
  return R;
}

double geodesic_angle(const Matrix3d& R_a, const Matrix3d& R_b) {
  // atan2 of sine and cosine: exact near 0 and near pi, where acos of the trace is not.
  const Matrix3d D = R_a.transpose() * R_b;
  const Vector3d twice_sine(D(2, 1) - D(1, 2), D(0, 2) - D(2, 0), D(1, 0) - D(0, 1));
  return std::atan2(0.5 * twice_sine.norm(), 0.5 * (D.trace() - 1.0));
}

double wrap(double angle, double period) {
  const double wrapped = std::remainder(angle, period);
  return wrapped == -0.5 * period ? 0.5 * period : wrapped;
}

}  // namespace turntable
