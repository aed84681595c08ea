#include "src/attitude/aopit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "src/attitude/ray_bundle.h"

namespace turntable {
namespace {

// Share of the largest |d^a| below which eq. 19's quotient is replaced by its limit.
constexpr double kVanishing = 1e-6;
// In tolerances: m moves about as many times more than eps as the camera is target radii away.
constexpr double kHeightTolerance = 100.0;

}  // namespace

Solution solve_aopit(const TargetModel& target, const Observation& observation,
                     const SolveOptions& options) {
  Solution solution;
  RayBundle bundle;
  if (!make_bundle(target, observation, bundle)) return solution;
  if (target.coplanar()) {
    solution.status = SolveStatus::kCoplanarTarget;
    return solution;
  }
  const double a = observation.planes.a_mm, b = observation.planes.b_mm;
  const TargetModel::Columns& G = target.vectors();
  const TargetModel::Columns& H = target.pseudo_inverse();
  const auto count = static_cast<std::size_t>(bundle.count);

  double largest = 0.0, largest_relative_slope = 0.0;
  for (std::size_t t = 0; t < count; ++t) {
    largest = std::max(largest, bundle.d_a[t].cwiseAbs().maxCoeff());
    largest_relative_slope =
        std::max(largest_relative_slope, (bundle.g[t] - bundle.g_0).cwiseAbs().maxCoeff());
  }
  const double vanishing = kVanishing * largest;
  const bool parallel = nearly_parallel(largest_relative_slope / largest, target);

  std::array<double, kMaxTargetPoints - 1> eps{};
  Vector3d i, j;
  Vector2d s(1.0, 1.0);
  double m = a;
  bool converged = false;
  while (!converged && solution.iterations < options.max_iterations) {
    ++solution.iterations;
    Vector3d I = Vector3d::Zero(), J = Vector3d::Zero();
    for (std::size_t t = 0; t < count; ++t) {
      Vector2d xi = bundle.d_a[t];
      for (Eigen::Index axis = 0; axis < 2; ++axis) {
        // d^m: separation of the rays at M0's height, mm.
        const double d_m =
            ((b - m) * bundle.d_a[t][axis] + (m - a) * bundle.d_b[t][axis]) / (b - a);
        const double scale = std::abs(d_m) > vanishing ? bundle.d_a[t][axis] / d_m : s[axis];
        xi[axis] += bundle.g[t][axis] * scale * eps[t];
      }
      const auto h = H.col(static_cast<Eigen::Index>(t));
      I += h * xi.x();
      J += h * xi.y();
    }
    s << I.norm(), J.norm();
    if (!(s.minCoeff() > kMinRow)) {
      solution.status = SolveStatus::kDegenerate;
      return solution;
    }
    i = I / s.x();
    j = J / s.y();
    const Vector3d k = i.cross(j);

    double cc = 0.0, cr = 0.0;  // normal equation of c m = r
    for (std::size_t t = 0; t < count; ++t)
      for (Eigen::Index axis = 0; axis < 2; ++axis) {
        const double d_a = bundle.d_a[t][axis], d_b = bundle.d_b[t][axis];
        const double c = s[axis] * (d_b - d_a);
        cc += c * c;
        cr += c * ((b - a) * d_a - s[axis] * (b * d_a - a * d_b));
      }
    // Parallel rays have the same separation at every height, so that m may be any.
    const double m_before = m;
    if (cc > 0.0) m = cr / cc;

    double change = 0.0;
    for (std::size_t t = 0; t < count; ++t) {
      const double height = G.col(static_cast<Eigen::Index>(t)).dot(k);
      change = std::max(change, std::abs(height - eps[t]));
      eps[t] = height;
    }
    if (!std::isfinite(change) || !std::isfinite(m)) {
      solution.status = SolveStatus::kDegenerate;
      return solution;
    }
    converged = change < options.tolerance &&
                (parallel || std::abs(m - m_before) < kHeightTolerance * options.tolerance);
  }
  solution.status = !converged ? SolveStatus::kNotConverged
                    : parallel ? SolveStatus::kHeightUndefined
                               : SolveStatus::kConverged;
  if (solution.iterations > 0) finish_on_rays(target, observation, i, j, m, solution);
  return solution;
}

}  // namespace turntable
