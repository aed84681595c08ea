#include "src/attitude/ray_bundle.h"

#include <cmath>

namespace turntable {

bool make_bundle(const TargetModel& target, const Observation& observation, RayBundle& bundle) {
  const std::span<const Ray> rays = observation.rays;
  const RayPlanes& planes = observation.planes;
  if (rays.size() != static_cast<std::size_t>(target.size())) return false;
  if (!std::isfinite(planes.a_mm) || !std::isfinite(planes.b_mm) || !(planes.b_mm > planes.a_mm))
    return false;
  for (const Ray& ray : rays)
    if (!ray.at_a.allFinite() || !ray.at_b.allFinite()) return false;
  bundle.count = target.vector_count();
  bundle.g_0 = rays[0].slope(planes);
  for (std::size_t t = 1; t < rays.size(); ++t) {
    bundle.d_a[t - 1] = rays[t].at_a - rays[0].at_a;
    bundle.d_b[t - 1] = rays[t].at_b - rays[0].at_b;
    bundle.g[t - 1] = rays[t].slope(planes);
  }
  return true;
}

void finish_on_rays(const TargetModel& target, const Observation& observation, const Vector3d& i,
                    const Vector3d& j, double m_mm, Solution& solution) {
  solution.rows_ijk << i.transpose(), j.transpose(), i.cross(j).transpose();
  solution.R = nearest_rotation_from_rows(i, j);
  const RayPlanes& planes = observation.planes;
  const Ray& ray_0 = observation.rays[0];
  solution.position_mm << ray_0.at(m_mm, planes), m_mm;
  double sum = 0.0;
  for (int t = 0; t < target.size(); ++t) {
    const Vector3d point =
        solution.R * (target.points().col(t) - target.points().col(0)) + solution.position_mm;
    const double miss = distance_mm(point, observation.rays[static_cast<std::size_t>(t)], planes);
    sum += miss * miss;
  }
  solution.residual = std::sqrt(sum / target.size());
  if (!(i.cross(j).norm() > kMinSine) || !solution.R.allFinite() ||
      !solution.position_mm.allFinite() || !std::isfinite(solution.residual))
    solution.status = SolveStatus::kDegenerate;
  if (solution.status == SolveStatus::kHeightUndefined) solution.position_mm.z() = Solution::kNaN;
}

}  // namespace turntable
