// Pose problems with known answers (src/attitude/scene.h), as the tests draw them.
#pragma once

#include <numbers>
#include <vector>

#include "src/attitude/scene.h"
#include "src/attitude/solver.h"
#include "src/core/random.h"
#include "src/core/units.h"

namespace turntable::problems {

constexpr RayPlanes kPlanes{130.0, 180.0};
constexpr double kFocalPx = 1945.0;

/// A target like the published one: M0 at the apex, 60 mm to the other LEDs, about 40 mm deep.
inline std::vector<Vector3d> published_target() {
  return {{0, 0, 0}, {57, 1, -35}, {-38, 45, -39}, {-38, -47, -44}};
}

using Lens = SceneLens;
using Problem = TargetScene;
using turntable::R_camera_from_plane;
using turntable::random_rotation;
using turntable::ray_along;
using turntable::ray_through;

inline Problem make(std::vector<Vector3d> target_mm, const Matrix3d& R, const Vector3d& origin_mm,
                    const Lens& lens = {}) {
  return make_scene(std::move(target_mm), R, origin_mm, lens);
}

/// A pose the rig could have: up to `max_deg` of tilt, any turn about z, M0 near the axis.
inline Problem random_problem(Random& random, std::vector<Vector3d> target_mm = published_target(),
                              double max_deg = 35.0, Lens lens = {}) {
  const Matrix3d turn =
      rotation_from_vector({0, 0, random.uniform(-std::numbers::pi, std::numbers::pi)});
  const Matrix3d R = turn * random_rotation(random, max_deg);
  const Vector3d origin(random.uniform(-50, 50), random.uniform(-50, 50), random.uniform(120, 180));
  return make(std::move(target_mm), R, origin, lens);
}

/// The same image noise for every sight: `sigma_px` on each image coordinate, taken along by the lens.
inline void add_noise(Problem& problem, double sigma_px, Random& random,
                      double focal_px = kFocalPx) {
  problem.lens.focal_px = focal_px;
  add_image_noise(problem, sigma_px, random);
}

/// n points in a ball of 60 mm about M0, never near a plane.
inline std::vector<Vector3d> random_target(Random& random, int n) {
  for (;;) {
    std::vector<Vector3d> points{Vector3d::Zero()};
    while (static_cast<int>(points.size()) < n)
      points.emplace_back(random.uniform(-60, 60), random.uniform(-60, 60), random.uniform(-60, 0));
    if (TargetModel::refusal(points).empty() && TargetModel(points).thickness() > 0.3)
      return points;
  }
}

}  // namespace turntable::problems
