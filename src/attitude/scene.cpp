#include "src/attitude/scene.h"

#include <array>
#include <cmath>

#include "src/core/units.h"

namespace turntable {
namespace {

double pupil_height(double theta, const SceneLens& lens) {
  return lens.centre_mm.z() + lens.pupil_walk_mm_per_rad2 * theta * theta;
}

/// (x/z, y/z) of a point for the central camera.
Vector2d central_view(const Vector3d& point_mm, const SceneLens& lens) {
  const Vector3d in_camera = R_camera_from_plane() * (point_mm - lens.central_pupil_mm());
  return in_camera.head<2>() / in_camera.z();
}

/// As the lens's distortion leaves it: right half-way between the planes.
Vector2d central_view(const Ray& ray, const SceneLens& lens) {
  const double z = 0.5 * (lens.planes.a_mm + lens.planes.b_mm);
  const Vector2d at = ray.at(z, lens.planes);
  return central_view(Vector3d(at.x(), at.y(), z), lens);
}

/// The height of the pupil that sees a point `radius` off the axis at height z.
double pupil_seen_from(double radius, double z, const SceneLens& lens) {
  double height = lens.centre_mm.z();
  for (int pass = 0; pass < 100; ++pass) {
    const double next = pupil_height(std::atan2(radius, height - z), lens);
    if (next == height) break;
    height = next;
  }
  return height;
}

}  // namespace

double SceneLens::half_field_rad() const { return std::atan(half_field_px / focal_px); }

void SceneLens::walk_over_field(double walk_mm) {
  pupil_walk_mm_per_rad2 = walk_mm / (half_field_rad() * half_field_rad());
}

Vector3d SceneLens::central_pupil_mm() const {
  return centre_mm +
         2.0 / 3.0 * (pupil_height(half_field_rad(), *this) - centre_mm.z()) * Vector3d::UnitZ();
}

Matrix3d TargetScene::truth(Sight sight) const {
  return sight == Sight::kRays ? R_plane_from_target
                               : Matrix3d(R_camera_from_plane() * R_plane_from_target);
}

Vector3d TargetScene::true_position(Sight sight) const {
  return sight == Sight::kRays
             ? origin_mm
             : Vector3d(R_camera_from_plane() * (origin_mm - lens.central_pupil_mm()));
}

Ray ray_along(const Vector2d& g, const SceneLens& lens) {
  const double pupil = pupil_height(std::atan(g.norm()), lens);
  return {lens.centre_mm.head<2>() + g * (lens.planes.a_mm - pupil),
          lens.centre_mm.head<2>() + g * (lens.planes.b_mm - pupil)};
}

Ray ray_through(const Vector3d& point_mm, const SceneLens& lens) {
  if (lens.telecentric) return {point_mm.head<2>(), point_mm.head<2>()};
  const Vector2d lateral = point_mm.head<2>() - lens.centre_mm.head<2>();
  const double pupil = pupil_seen_from(lateral.norm(), point_mm.z(), lens);
  return ray_along(-lateral / (pupil - point_mm.z()), lens);
}

ImageJacobian image_jacobian(const Vector3d& point_mm, const SceneLens& lens) {
  ImageJacobian J;
  if (lens.telecentric) {
    J << 1, 0, 0, 0, -1, 0;
    return lens.focal_px / (lens.centre_mm.z() - lens.planes.a_mm) * J;
  }
  const Vector2d l = point_mm.head<2>() - lens.centre_mm.head<2>();
  const double r = l.norm();
  const double depth = pupil_seen_from(r, point_mm.z(), lens) - point_mm.z();
  if (!(depth > 0.0)) return ImageJacobian::Constant(Solution::kNaN);
  // With D = p(theta) - z and q = p'(theta) cos^2 theta:
  //   dD (1 + q r / D^2) = q / D dr - dz,  dr = l.dl / r,  dg = -dl / D + l / D^2 dD
  const double theta = std::atan2(r, depth), cosine = std::cos(theta);
  const double q = 2.0 * lens.pupil_walk_mm_per_rad2 * theta * cosine * cosine;
  const double shared = 1.0 + q * r / (depth * depth);
  Vector3d dD(0, 0, -1.0 / shared);
  if (r > 0.0) dD.head<2>() = q / depth / shared / r * l;
  Eigen::Matrix<double, 2, 3> dg = l / (depth * depth) * dD.transpose();
  dg(0, 0) -= 1.0 / depth;
  dg(1, 1) -= 1.0 / depth;
  J << -lens.focal_px * dg.row(0), lens.focal_px * dg.row(1);
  return J;
}

TargetScene make_scene(std::vector<Vector3d> target_mm, const Matrix3d& R_plane_from_target,
                       const Vector3d& origin_mm, const SceneLens& lens) {
  TargetScene scene{std::move(target_mm), R_plane_from_target, origin_mm, lens, {}, {}, {}};
  for (const Vector3d& point : scene.target_mm) {
    const Vector3d in_plane = R_plane_from_target * (point - scene.target_mm[0]) + origin_mm;
    const Ray ray = ray_through(in_plane, lens);
    scene.rays.push_back(ray);
    // Where the rays meet, the point itself will do, and is not rounded twice.
    scene.normalised.push_back(lens.pupil_walk_mm_per_rad2 == 0.0 ? central_view(in_plane, lens)
                                                                  : central_view(ray, lens));
  }
  return scene;
}

void add_image_noise(TargetScene& scene, double sigma_px, Random& random) {
  const SceneLens& lens = scene.lens;
  for (std::size_t t = 0; t < scene.rays.size(); ++t) {
    const Ray seen = scene.rays[t];
    const Vector2d g = seen.slope(lens.planes);
    // What a step of each image coordinate does. Camera x is plane x, which a slope counts towards
    // the camera; camera y is plane -y.
    const auto moved = [&](const Vector2d& pixels) -> Ray {
      const Vector2d slope = Vector2d(-pixels.x(), pixels.y()) / lens.focal_px;
      if (!lens.telecentric) return ray_along(g + slope, lens);
      const Vector2d shift = -slope * (lens.centre_mm.z() - lens.planes.a_mm);
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
    scene.spreads.push_back(spread);
    const Vector2d noise = sigma_px * Vector2d(random.normal(), random.normal());
    scene.rays[t] = moved(noise);
    if (lens.pupil_walk_mm_per_rad2 == 0.0)
      scene.normalised[t] += noise / lens.focal_px;
    else
      scene.normalised[t] = central_view(scene.rays[t], lens);
  }
}

PoseBound scene_bound(const TargetModel& target, const TargetScene& scene, double sigma_px) {
  std::array<ImageJacobian, kMaxTargetPoints> jacobians;
  for (int t = 0; t < target.size(); ++t)
    jacobians[static_cast<std::size_t>(t)] = image_jacobian(
        scene.R_plane_from_target * (target.points().col(t) - target.points().col(0)) +
            scene.origin_mm,
        scene.lens);
  return cramer_rao_bound(
      target, scene.R_plane_from_target,
      std::span<const ImageJacobian>(jacobians).first(static_cast<std::size_t>(target.size())),
      sigma_px);
}

Matrix3d random_rotation(Random& random, double max_deg) {
  const Vector3d axis = Vector3d(random.normal(), random.normal(), random.normal()).normalized();
  return rotation_from_vector(rad_from_deg(random.uniform(0.0, max_deg)) * axis);
}

std::vector<Vector3d> default_target() {
  return {{0, 0, 0}, {58.6, 13.0, -40}, {-40.6, 44.2, -40}, {-18.0, -57.2, -40}};
}

}  // namespace turntable
