// Scenes for the correspondence: a target under the camera, its spots shuffled among others that
// are no LEDs. The test and the benchmark draw the same ones.
#pragma once

#include <algorithm>
#include <vector>

#include "src/attitude/correspondence.h"
#include "tests/attitude/problems.h"

namespace turntable::problems {

/// The target of scenarios/rigs/simulated.json: three of its LEDs stand within 0.1 deg and 0.1 mm
/// of a triangle that a third of a turn takes to itself.
inline std::vector<Vector3d> rig_target() { return default_target(); }

/// n points on 60 mm, 40 mm deep, 10 mm from each other at least.
inline std::vector<Vector3d> spaced_target(Random& random, int n) {
  for (;;) {
    std::vector<Vector3d> points{Vector3d::Zero()};
    for (int tries = 0; tries < 10000 && static_cast<int>(points.size()) < n; ++tries) {
      const Vector3d p(random.uniform(-60, 60), random.uniform(-60, 60), random.uniform(-40, 0));
      if (p.head<2>().norm() < 60.0 &&
          std::ranges::all_of(points, [&](const Vector3d& q) { return (p - q).norm() > 10.0; }))
        points.push_back(p);
    }
    if (static_cast<int>(points.size()) == n && TargetModel::refusal(points).empty() &&
        TargetModel(points).thickness() > 0.2)
      return points;
  }
}

struct Scene {
  Problem truth;
  std::vector<Ray> rays;
  std::vector<int> spot_of_point;  ///< -1: hidden
  double sigma_mm = 0.0;           ///< of a coordinate of a ray, half-way down the target
};

inline Ray stray_ray(Random& random, const Lens& lens) {
  return ray_through(
      {random.uniform(-110, 110), random.uniform(-110, 110), random.uniform(100, 160)}, lens);
}

/// @param hidden the last so many points of the target are not seen.
inline Scene scene(Random& random, Problem problem, double noise_px, int strays, int hidden = 0) {
  Scene s{std::move(problem), {}, {}, 0.0};
  add_noise(s.truth, noise_px, random);
  const int n = static_cast<int>(s.truth.rays.size());
  std::vector<int> order;  // spot -> point, or n for a stray one
  for (int t = 0; t < n - hidden; ++t) order.push_back(t);
  for (int k = 0; k < strays; ++k) order.push_back(n);
  for (std::size_t i = order.size(); i > 1; --i)
    std::swap(order[i - 1],
              order[static_cast<std::size_t>(random.uniform() * static_cast<double>(i))]);
  s.spot_of_point.assign(static_cast<std::size_t>(n), -1);
  for (std::size_t j = 0; j < order.size(); ++j) {
    if (order[j] < n) s.spot_of_point[static_cast<std::size_t>(order[j])] = static_cast<int>(j);
    s.rays.push_back(order[j] < n ? s.truth.rays[static_cast<std::size_t>(order[j])]
                                  : stray_ray(random, s.truth.lens));
  }
  double height = 0.0;
  for (const Vector3d& p : s.truth.target_mm)
    height +=
        (s.truth.R_plane_from_target * (p - s.truth.target_mm[0]) + s.truth.origin_mm).z() / n;
  s.sigma_mm = noise_px / kFocalPx * (s.truth.lens.centre_mm.z() - height);
  return s;
}

}  // namespace turntable::problems
