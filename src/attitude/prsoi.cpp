#include "src/attitude/prsoi.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "src/attitude/ray_bundle.h"

namespace turntable {

Solution solve_prsoi(const TargetModel& target, const Observation& observation,
                     const SolveOptions& options) {
  Solution solution;
  RayBundle bundle;
  if (!make_bundle(target, observation, bundle)) return solution;
  if (target.coplanar()) {
    solution.status = SolveStatus::kCoplanarTarget;
    return solution;
  }
  const TargetModel::Columns& G = target.vectors();
  const TargetModel::Columns& H = target.pseudo_inverse();
  const auto count = static_cast<std::size_t>(bundle.count);

  // How the rays open, and how their separation on plane a goes with it.
  double opening_2 = 0.0, opening_d = 0.0;
  Vector3d I1 = Vector3d::Zero(), J1 = Vector3d::Zero();
  for (std::size_t t = 0; t < count; ++t) {
    const Vector2d opening = bundle.g[t] - bundle.g_0;
    const auto h = H.col(static_cast<Eigen::Index>(t));
    I1 += h * opening.x();
    J1 += h * opening.y();
    opening_2 += opening.squaredNorm();
    opening_d += opening.dot(bundle.d_a[t]);
  }
  const bool parallel =
      nearly_parallel(std::sqrt(0.5 * (I1.squaredNorm() + J1.squaredNorm())), target);

  std::array<double, kMaxTargetPoints - 1> eps{};
  Vector3d i, j;
  double s = 1.0;
  bool converged = false;
  while (!converged && solution.iterations < options.max_iterations) {
    ++solution.iterations;
    Vector3d I = Vector3d::Zero(), J = Vector3d::Zero();
    for (std::size_t t = 0; t < count; ++t) {
      const Vector2d xi = bundle.d_a[t] + s * eps[t] * bundle.g[t];
      const auto h = H.col(static_cast<Eigen::Index>(t));
      I += h * xi.x();
      J += h * xi.y();
    }
    const double norm_I = I.norm(), norm_J = J.norm();
    if (!(std::min(norm_I, norm_J) > kMinRow)) {
      solution.status = SolveStatus::kDegenerate;
      return solution;
    }
    i = I / norm_I;
    j = J / norm_J;
    const Vector3d k = i.cross(j);
    const double s_before = s;
    s = 0.5 * (norm_I + norm_J);
    double change = std::abs(s - s_before) * target.radius_mm();
    for (std::size_t t = 0; t < count; ++t) {
      const double height = G.col(static_cast<Eigen::Index>(t)).dot(k);
      change = std::max(change, std::abs(height - eps[t]));
      eps[t] = height;
    }
    if (!std::isfinite(change)) {
      solution.status = SolveStatus::kDegenerate;
      return solution;
    }
    converged = change < options.tolerance;
  }
  solution.status = !converged ? SolveStatus::kNotConverged
                    : parallel ? SolveStatus::kHeightUndefined
                               : SolveStatus::kConverged;
  const double above_a = parallel ? 0.0 : (1.0 / s - 1.0) * opening_d / opening_2;
  if (solution.iterations > 0)
    finish_on_rays(target, observation, i, j, observation.planes.a_mm + above_a, solution);
  return solution;
}

}  // namespace turntable
