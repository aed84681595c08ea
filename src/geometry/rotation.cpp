#include "src/geometry/rotation.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

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
