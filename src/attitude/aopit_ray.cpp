#include "src/attitude/aopit_ray.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "src/attitude/ray_bundle.h"

namespace turntable {

Solution solve_aopit_ray(const TargetModel& target, const Observation& observation,
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

  Vector3d I1 = Vector3d::Zero(), J1 = Vector3d::Zero();
  for (std::size_t t = 0; t < count; ++t) {
    const Vector2d opening = bundle.g[t] - bundle.g_0;
    const auto h = H.col(static_cast<Eigen::Index>(t));
    I1 += h * opening.x();
    J1 += h * opening.y();
  }
  const double A = I1.squaredNorm() + J1.squaredNorm();
  const bool parallel = nearly_parallel(std::sqrt(0.5 * A), target);

  std::array<double, kMaxTargetPoints - 1> eps{};
  Vector3d i, j;
  double w = 0.0;
  bool converged = false, real_root = true;
  while (!converged && solution.iterations < options.max_iterations) {
    ++solution.iterations;
    Vector3d I = Vector3d::Zero(), J = Vector3d::Zero();
    for (std::size_t t = 0; t < count; ++t) {
      const Vector2d lateral = bundle.d_a[t] + bundle.g[t] * eps[t];
      const auto h = H.col(static_cast<Eigen::Index>(t));
      I += h * lateral.x();
      J += h * lateral.y();
    }
    if (!parallel) {
      const double B = 2.0 * (I.dot(I1) + J.dot(J1));
      const double C = I.squaredNorm() + J.squaredNorm() - 2.0;
      const double discriminant = B * B - 4.0 * A * C;
      real_root = discriminant >= 0.0;
      // Without a real root the narrowest place comes closest; later passes may still find one.
      w = real_root ? -2.0 * C / (B + std::copysign(std::sqrt(discriminant), B)) : -B / (2.0 * A);
      I += w * I1;
      J += w * J1;
    }
    const double norm_I = I.norm(), norm_J = J.norm();
    if (!(std::min(norm_I, norm_J) > kMinRow)) {
      solution.status = SolveStatus::kDegenerate;
      return solution;
    }
    i = I / norm_I;
    j = J / norm_J;
    const Vector3d k = i.cross(j);
    double change = 0.0;
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
  if (!real_root) solution.status = SolveStatus::kDegenerate;
  if (solution.iterations > 0)
    finish_on_rays(target, observation, i, j, observation.planes.a_mm + w, solution);
  return solution;
}

}  // namespace turntable
