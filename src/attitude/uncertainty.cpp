#include "src/attitude/uncertainty.h"

#include <cassert>

#include "src/attitude/ray_residual.h"

namespace turntable {

PoseUncertainty propagate_uncertainty(const TargetModel& target, const Observation& observation,
                                      const Solution& solution, const UncertaintySources& sources) {
  PoseUncertainty out;
  out.spots = solution.covariance;
  if (!solution.covariance.topLeftCorner<5, 5>().allFinite()) {
    out.rays = out.target = out.spots;
    return out;
  }
  const int n = target.size();
  const bool rays = sources.rays_mm2.size() > 0, geometry = sources.target_mm2.size() > 0;
  assert(!rays || sources.rays_mm2.rows() == 2 * n);
  assert(!geometry || sources.target_mm2.rows() == 3 * n);
  // The height of parallel rays is not known and nothing of it reaches the attitude.
  Matrix6d N_inverse = solution.covariance;
  const bool height = N_inverse.allFinite();
  if (!height) {
    N_inverse.row(5).setZero();
    N_inverse.col(5).setZero();
  }
  const double a = observation.planes.a_mm, span = observation.planes.b_mm - a;
  // Sensitivities M: what each input moves the pose by.
  Eigen::Matrix<double, 6, Eigen::Dynamic> to_x(6, 2 * n), to_y(6, 2 * n), to_target(6, 3 * n);
  to_x.setZero();
  to_y.setZero();
  to_target.setZero();
  Vector3d T = solution.position_mm;
  if (!height) T.z() = a;
  for (int t = 0; t < n; ++t) {
    if ((solution.left_out >> t & 1u) != 0) continue;
    const auto index = static_cast<std::size_t>(t);
    const Sighted sighted(observation.rays[index],
                          observation.spreads.empty() ? nullptr : &observation.spreads[index],
                          observation.planes);
    const Vector3d q = solution.R * (target.points().col(t) - target.points().col(0)), X = q + T;
    const RayResidual residual = sighted.residual(X, X.z() - a);
    const double lambda = (X.z() - a) / span;
    for (Eigen::Index row = 0; row < 2; ++row) {
      const Vector3d x = residual.row(row);
      Eigen::Matrix<double, 6, 1> J;
      J << q.cross(x), x;
      const Eigen::Matrix<double, 6, 1> gain = N_inverse * J;  // -d theta / d r
      to_x.col(t) += gain * (1.0 - lambda) * x.x();
      to_x.col(n + t) += gain * lambda * x.x();
      to_y.col(t) += gain * (1.0 - lambda) * x.y();
      to_y.col(n + t) += gain * lambda * x.y();
      const Eigen::RowVector3d in_target = x.transpose() * solution.R;
      to_target.middleCols<3>(3 * t) -= gain * in_target;
      to_target.leftCols<3>() += gain * in_target;
    }
  }
  if (rays)
    out.rays =
        to_x * sources.rays_mm2 * to_x.transpose() + to_y * sources.rays_mm2 * to_y.transpose();
  if (geometry) out.target = to_target * sources.target_mm2 * to_target.transpose();
  if (!height)
    for (Matrix6d* part : {&out.rays, &out.target}) {
      part->row(5).setConstant(Solution::kNaN);
      part->col(5).setConstant(Solution::kNaN);
    }
  return out;
}

}  // namespace turntable
