#include "src/attitude/posit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "src/attitude/reprojection.h"

namespace turntable {
namespace {

// Image smaller than this many radians: nothing to measure.
constexpr double kMinImage = 1e-9;

}  // namespace

Solution solve_posit(const TargetModel& target, const Observation& observation,
                     const SolveOptions& options) {
  Solution solution;
  const std::span<const Vector2d> x = observation.normalised;
  if (x.size() != static_cast<std::size_t>(target.size())) return solution;
  for (const Vector2d& point : x)
    if (!point.allFinite()) return solution;
  if (target.coplanar()) {
    solution.status = SolveStatus::kCoplanarTarget;
    return solution;
  }

  const TargetModel::Columns& G = target.vectors();
  const TargetModel::Columns& H = target.pseudo_inverse();
  const auto count = static_cast<std::size_t>(target.vector_count());
  std::array<double, kMaxTargetPoints - 1> e{};
  Vector3d i, j;
  double z0 = 0.0;
  solution.status = SolveStatus::kNotConverged;
  while (solution.status == SolveStatus::kNotConverged &&
         solution.iterations < options.max_iterations) {
    ++solution.iterations;
    Vector3d I = Vector3d::Zero(), J = Vector3d::Zero();
    for (std::size_t t = 0; t < count; ++t) {
      const Vector2d shifted = x[t + 1] * (1.0 + e[t]) - x[0];
      const auto h = H.col(static_cast<Eigen::Index>(t));
      I += h * shifted.x();
      J += h * shifted.y();
    }
    const double norm_I = I.norm(), norm_J = J.norm();
    if (!(std::min(norm_I, norm_J) * target.radius_mm() > kMinImage)) {
      solution.status = SolveStatus::kDegenerate;
      return solution;
    }
    i = I / norm_I;
    j = J / norm_J;
    z0 = 2.0 / (norm_I + norm_J);
    const Vector3d k = i.cross(j);
    double change = 0.0;
    for (std::size_t t = 0; t < count; ++t) {
      const double depth = G.col(static_cast<Eigen::Index>(t)).dot(k) / z0;
      change = std::max(change, std::abs(depth - e[t]));
      e[t] = depth;
    }
    if (!std::isfinite(change)) {
      solution.status = SolveStatus::kDegenerate;
      return solution;
    }
    if (change < options.tolerance) solution.status = SolveStatus::kConverged;
  }
  if (solution.iterations == 0) return solution;

  const Vector3d k = i.cross(j);
  solution.rows_ijk << i.transpose(), j.transpose(), k.transpose();
  solution.R = nearest_rotation_from_rows(i, j);
  solution.position_mm << x[0] * z0, z0;
  solution.residual = reprojection_rms(target, x, solution.R, solution.position_mm);
  if (!(k.norm() > kMinSine) || !solution.R.allFinite() || !std::isfinite(solution.residual))
    solution.status = SolveStatus::kDegenerate;
  return solution;
}

}  // namespace turntable
