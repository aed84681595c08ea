#include "src/attitude/ray_start.h"

#include <algorithm>
#include <cmath>

#include "src/attitude/aopit_ray.h"
#include "src/attitude/ray_bundle.h"

namespace turntable {
namespace {

/// Squared: four standard deviations between the best pose and a rival.
constexpr double kMisfitMargin = 16.0;
/// Two refinements that end this near each other are one pose, rad.
constexpr double kSamePose = 1e-5;

/// A target thinner than this has the planar starts as well.
constexpr double kFlat = 0.15;
/// Passes of aopit_ray on a flat target: what has not converged by then creeps.
constexpr int kFlatPasses = 50;

}  // namespace

RayStart planar_start(const TargetModel& target, const Observation& observation) {
  RayStart start;
  RayBundle bundle;
  if (!make_bundle(target, observation, bundle)) return start;
  const TargetModel::Columns& H = target.pseudo_inverse();
  Vector3d I = Vector3d::Zero(), J = Vector3d::Zero(), I1 = I, J1 = J;
  const Vector3d& n = target.normal();
  for (int t = 0; t < bundle.count; ++t) {
    // Of a flat target too what its plane alone tells: (1 - n n^T) H is the rank-2 pseudo-inverse.
    const Vector3d h = H.col(t) - n.dot(H.col(t)) * n;
    const Vector2d d = bundle.d_a[static_cast<std::size_t>(t)];
    const Vector2d opening = bundle.g[static_cast<std::size_t>(t)] - bundle.g_0;
    I += h * d.x();
    J += h * d.y();
    I1 += h * opening.x();
    J1 += h * opening.y();
  }
  const double II = I.squaredNorm(), JJ = J.squaredNorm(), IJ = I.dot(J);
  const double s2 = 0.5 * (II + JJ + std::hypot(II - JJ, 2.0 * IJ));  // larger eigenvalue
  start.status = SolveStatus::kDegenerate;
  if (!(s2 > kMinRow * kMinRow) || !std::isfinite(s2)) return start;
  const double s = std::sqrt(s2);
  const double slopes = I1.squaredNorm() + J1.squaredNorm();
  const bool parallel = nearly_parallel(std::sqrt(0.5 * slopes), target);
  // (I, J) + w (I1, J1) shrinks to nothing at the camera, w = distance, and to 1 / s at M0.
  const double distance = parallel ? 0.0 : -(I.dot(I1) + J.dot(J1)) / slopes;
  const double w = parallel ? 0.0 : distance * (1.0 - 1.0 / s);

  const double alpha = std::sqrt(std::max(0.0, 1.0 - II / s2));
  const double beta = std::copysign(std::sqrt(std::max(0.0, 1.0 - JJ / s2)), -IJ);
  for (const double sign : {1.0, -1.0}) {
    const Vector3d i = (I / s + sign * alpha * n).normalized();
    const Vector3d j = (J / s + sign * beta * n).normalized();
    if (!(i.cross(j).norm() > kMinSine)) continue;
    RayPose& pose = start.poses[start.count++];
    pose.R = nearest_rotation_from_rows(i, j);
    pose.T << observation.rays[0].at(observation.planes.a_mm + w, observation.planes),
        observation.planes.a_mm + w;
    if (alpha == 0.0 && beta == 0.0) break;
  }
  start.iterations = 1;
  if (start.count > 0)
    start.status = parallel ? SolveStatus::kHeightUndefined : SolveStatus::kConverged;
  return start;
}

RayStart start_on_rays(const TargetModel& target, const Observation& observation,
                       double tolerance_mm, int max_iterations) {
  RayStart start;
  if (target.thickness() < kFlat) {
    start = planar_start(target, observation);
    if (start.status == SolveStatus::kInvalidInput) return start;
    if (max_iterations < 1) return {SolveStatus::kNotConverged, 0, {}, 0};
    if (target.coplanar()) return start;
    max_iterations = std::min(max_iterations, kFlatPasses);
  }
  const Solution s = solve_aopit_ray(target, observation, {tolerance_mm, max_iterations});
  start.iterations += s.iterations;
  if (start.count == 0) start.status = s.status;
  if (!s.has_attitude()) return start;
  RayPose& pose = start.poses[start.count++];
  pose = {s.R, s.position_mm};
  if (s.status == SolveStatus::kHeightUndefined) pose.T.z() = observation.planes.a_mm;
  return start;
}

Ranking rank(std::span<const RayEnd> ends, double dof) {
  const auto usable = [&](const RayEnd& end) { return end.status != SolveStatus::kDegenerate; };
  Ranking ranking;
  for (std::size_t c = 1; c < ends.size(); ++c)
    if (usable(ends[c]) &&
        (!usable(ends[ranking.best]) || ends[c].misfit < ends[ranking.best].misfit))
      ranking.best = c;
  const RayEnd& best = ends[ranking.best];
  ranking.status = best.status;
  for (std::size_t c = 0; c < ends.size(); ++c)
    if (usable(ends[c]) && geodesic_angle(best.pose.R, ends[c].pose.R) > kSamePose &&
        (!ranking.has_rival() || ends[c].misfit < ends[ranking.rival].misfit))
      ranking.rival = c;
  if (!ranking.has_rival() || best.status != SolveStatus::kConverged) return ranking;
  const double other = ends[ranking.rival].misfit;
  const bool told_apart =
      dof > 0.0 ? other - best.misfit >= kMisfitMargin * std::max(1.0, best.misfit / dof)
                : other >= kMisfitMargin * best.misfit;
  if (!told_apart) ranking.status = SolveStatus::kAmbiguous;
  return ranking;
}

}  // namespace turntable
