// Pose problems with known answers, made without any of the solvers' own code: a target somewhere
// in the plane frame and a camera above it whose entrance pupil may walk along the axis with the
// field angle.
#pragma once

#include <cmath>
#include <numbers>
#include <string_view>
#include <vector>

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

struct Lens {
  Vector3d centre_mm{0, 0, 700};
  double pupil_walk_mm_per_rad2 = 0.0;
  bool telecentric = false;  ///< rays parallel to z
};

struct Problem {
  std::vector<Vector3d> target_mm;
  Matrix3d R_plane_from_target;
  Vector3d origin_mm;
  Lens lens;

  std::vector<Ray> rays;             ///< noise-free unless noise was added
  std::vector<Vector2d> normalised;  ///< the central camera's, x right, y down, z forward
  std::vector<RaySpread> spreads;    ///< of the noise that was added; none without noise

  Observation observation() const { return {rays, kPlanes, normalised, spreads}; }
  /// Truth in the frame of a solver's answer.
  Matrix3d truth(Sight sight) const;
  Vector3d true_position(Sight sight) const;
};

/// Camera x along plane x, camera z down: a half turn about x.
inline Matrix3d R_camera_from_plane() { return Vector3d(1.0, -1.0, -1.0).asDiagonal(); }

inline Matrix3d Problem::truth(Sight sight) const {
  return sight == Sight::kRays ? R_plane_from_target
                               : Matrix3d(R_camera_from_plane() * R_plane_from_target);
}

inline Vector3d Problem::true_position(Sight sight) const {
  return sight == Sight::kRays ? origin_mm
                               : Vector3d(R_camera_from_plane() * (origin_mm - lens.centre_mm));
}

/// The ray of slope `g` through the entrance pupil as that direction sees it.
inline Ray ray_along(const Vector2d& g, const Lens& lens) {
  const double theta = std::atan(g.norm());
  const double pupil_z = lens.centre_mm.z() + lens.pupil_walk_mm_per_rad2 * theta * theta;
  return {lens.centre_mm.head<2>() + g * (kPlanes.a_mm - pupil_z),
          lens.centre_mm.head<2>() + g * (kPlanes.b_mm - pupil_z)};
}

/// The ray through `point_mm` and the entrance pupil as that point sees it.
inline Ray ray_through(const Vector3d& point_mm, const Lens& lens) {
  if (lens.telecentric) return {point_mm.head<2>(), point_mm.head<2>()};
  const Vector2d lateral = point_mm.head<2>() - lens.centre_mm.head<2>();
  double pupil_z = lens.centre_mm.z();
  for (int pass = 0; pass < 100; ++pass) {
    const double theta = std::atan2(lateral.norm(), pupil_z - point_mm.z());
    pupil_z = lens.centre_mm.z() + lens.pupil_walk_mm_per_rad2 * theta * theta;
  }
  return ray_along(-lateral / (pupil_z - point_mm.z()), lens);
}

inline Problem make(std::vector<Vector3d> target_mm, const Matrix3d& R, const Vector3d& origin_mm,
                    const Lens& lens = {}) {
  Problem p{std::move(target_mm), R, origin_mm, lens, {}, {}, {}};
  for (const Vector3d& point : p.target_mm) {
    const Vector3d in_plane = R * (point - p.target_mm[0]) + origin_mm;
    p.rays.push_back(ray_through(in_plane, lens));
    const Vector3d in_camera = R_camera_from_plane() * (in_plane - lens.centre_mm);
    p.normalised.emplace_back(in_camera.head<2>() / in_camera.z());
  }
  return p;
}

inline Matrix3d random_rotation(Random& random, double max_deg) {
  const Vector3d axis = Vector3d(random.normal(), random.normal(), random.normal()).normalized();
  return rotation_from_vector(rad_from_deg(random.uniform(0.0, max_deg)) * axis);
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
  for (std::size_t t = 0; t < problem.rays.size(); ++t) {
    const Vector2d g = problem.rays[t].slope(kPlanes);
    // What a step of each image coordinate does. Camera x is plane x, which a slope counts towards
    // the camera; camera y is plane -y.
    const Ray seen = problem.rays[t];
    const auto moved = [&](const Vector2d& pixels) -> Ray {
      const Vector2d slope = Vector2d(-pixels.x(), pixels.y()) / focal_px;
      if (!problem.lens.telecentric) return ray_along(g + slope, problem.lens);
      const Vector2d shift = -slope * (problem.lens.centre_mm.z() - kPlanes.a_mm);
      return {seen.at_a + shift, seen.at_b + shift};
    };
    RaySpread spread;
    constexpr double kStep = 0.01;  // px
    for (const Eigen::Index axis : {0, 1}) {
      const Vector2d step = kStep * Vector2d::Unit(axis);
      const Ray up = moved(step), down = moved(-step);
      spread.at_a.col(axis) = sigma_px / (2.0 * kStep) * (up.at_a - down.at_a);
      spread.at_b.col(axis) = sigma_px / (2.0 * kStep) * (up.at_b - down.at_b);
    }
    problem.spreads.push_back(spread);
    const Vector2d noise = sigma_px * Vector2d(random.normal(), random.normal());
    problem.normalised[t] += noise / focal_px;
    problem.rays[t] = moved(noise);
  }
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
