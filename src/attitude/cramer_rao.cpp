#include "src/attitude/cramer_rao.h"

#include <Eigen/Cholesky>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>

#include "src/core/units.h"

namespace turntable {

Vector3d PoseBound::rotation_std_deg() const {
  return kDegPerRad * rotation_covariance_rad2().diagonal().cwiseSqrt();
}

double PoseBound::total_std_deg() const {
  return kDegPerRad * std::sqrt(rotation_covariance_rad2().trace());
}

PoseBound cramer_rao_bound(const TargetModel& target, const Matrix3d& R_plane_from_target,
                           std::span<const ImageJacobian> jacobians, double sigma_px) {
  assert(jacobians.size() == static_cast<std::size_t>(target.size()));
  // Rotations are scaled by the target's radius, so that the six unknowns are all lengths of one
  // size.
  const double radius = target.radius_mm();
  Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();
  for (int t = 0; t < target.size(); ++t) {
    const Vector3d p =
        R_plane_from_target * (target.points().col(t) - target.points().col(0)) / radius;
    Matrix3d minus_p_cross;  // d(delta x p)/d delta
    minus_p_cross << 0, p.z(), -p.y(), -p.z(), 0, p.x(), p.y(), -p.x(), 0;
    Eigen::Matrix<double, 2, 6> J;
    J << jacobians[static_cast<std::size_t>(t)] * minus_p_cross,
        jacobians[static_cast<std::size_t>(t)];
    information += J.transpose() * J;
  }
  PoseBound bound;
  const Eigen::LDLT<Eigen::Matrix<double, 6, 6>> factor(information);
  const auto pivots = factor.vectorD();
  if (!information.allFinite() || !(pivots.minCoeff() > 1e-14 * pivots.maxCoeff())) {
    bound.covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
    return bound;
  }
  bound.covariance = sigma_px * sigma_px * factor.solve(Eigen::Matrix<double, 6, 6>::Identity());
  bound.covariance.topRows<3>() /= radius;
  bound.covariance.leftCols<3>() /= radius;
  return bound;
}

PoseBound cramer_rao_bound_pinhole(const TargetModel& target, const Matrix3d& R_plane_from_target,
                                   const Vector3d& origin_mm, const Vector3d& camera_centre_mm,
                                   double focal_px, double sigma_px) {
  std::array<ImageJacobian, kMaxTargetPoints> jacobians;
  for (int t = 0; t < target.size(); ++t) {
    const Vector3d X =
        R_plane_from_target * (target.points().col(t) - target.points().col(0)) + origin_mm;
    const Vector3d from_camera = X - camera_centre_mm;
    const double depth = -from_camera.z();
    // u = f x / depth, v = f y / depth with depth = Cz - z; nothing is seen behind the camera.
    ImageJacobian& jacobian = jacobians[static_cast<std::size_t>(t)];
    jacobian << 1, 0, from_camera.x() / depth, 0, 1, from_camera.y() / depth;
    jacobian *= depth > 0.0 ? focal_px / depth : std::numeric_limits<double>::quiet_NaN();
  }
  return cramer_rao_bound(
      target, R_plane_from_target,
      std::span<const ImageJacobian>(jacobians).first(static_cast<std::size_t>(target.size())),
      sigma_px);
}

}  // namespace turntable
