#include "drivers/sim/world.h"

#include <algorithm>
#include <cmath>

namespace turntable::sim {
namespace {

Vector3d radians(const Vector3d& deg) { return deg / kDegPerRad; }

/// The drawn axes, each turned by its hidden error. What a rig file believes to have identified is
/// no truth of the world's.
Gimbal real_gimbal(const RigFile& rig) {
  GimbalConfig drawn = rig.gimbal;
  drawn.plane_from_gimbal_deg = drawn.axis_tilt_deg = Vector3d::Zero();
  std::array<Vector3d, 3> axes = drawn.axes;
  for (std::size_t i = 0; i < axes.size(); ++i)
    axes[i] = rotation_from_vector(radians(rig.simulation->axis_errors_deg[i])) * axes[i];
  return Gimbal(drawn).turning_about(axes);
}

}  // namespace

World::World(const RigFile& rig, std::function<double(AxisId)> true_position)
    : rig_(rig),
      truth_(rig.simulation.value()),
      gimbal_(real_gimbal(rig)),
      lens_(truth_.lens),
      true_position_(std::move(true_position)) {
  // Looking straight down: image right is +x, image down is -y, forward is -z of the plane frame.
  Matrix3d R_camera_from_plane_nominal = Vector3d(1, -1, -1).asDiagonal();
  R_camera_from_plane_ = R_camera_from_plane_nominal *
                         rotation_from_vector(radians(truth_.camera_rotation_deg)).transpose();
}

World::Pose World::payload_pose() const {
  GimbalAngles angles;
  for (const AxisId axis : kRotaryAxes) angles[axis] = rad_from_deg(true_position_(axis));
  const double travel = truth_.stage_scale * true_position_(AxisId::kStage);
  const Vector2d lean(std::tan(rad_from_deg(truth_.stage_squareness_deg.x())),
                      std::tan(rad_from_deg(truth_.stage_squareness_deg.y())));
  const Vector3d centre =
      rig_.gimbal.centre_at_stage_zero_mm + travel * Vector3d(lean.x(), lean.y(), 1.0);

  const Matrix3d X = rotation_from_vector(radians(truth_.plane_from_gimbal_deg));
  const Matrix3d R_gimbal = gimbal_.rotation(angles);
  Matrix3d R_plane_from_payload;
  Vector3d origin;
  if (payload_ == Payload::kLedTarget) {
    R_plane_from_payload =
        X * R_gimbal * rotation_from_vector(radians(truth_.table_from_target_deg));
    origin = centre + X * R_gimbal * (rig_.target.offset_mm + truth_.target_offset_error_mm);
  } else {
    // The pattern defines the plane frame: at zero angles it lies in it without rotation.
    R_plane_from_payload = X * R_gimbal * X.transpose();
    origin = centre + R_plane_from_payload * rig_.pattern.offset_mm;
  }
  return {R_camera_from_plane_ * R_plane_from_payload,
          R_camera_from_plane_ * (origin - truth_.camera_position_mm)};
}

std::vector<Disc> World::discs() const {
  const Pose pose = payload_pose();
  std::vector<Disc> discs;
  const auto add = [&](const Vector3d& at, double radius) {
    discs.push_back({pose.R_camera_from_payload * at + pose.origin_in_camera,
                     radius * pose.R_camera_from_payload.col(0),
                     radius * pose.R_camera_from_payload.col(1)});
  };
  if (payload_ == Payload::kLedTarget) {
    for (std::size_t i = 0; i < rig_.target.points_mm.size(); ++i)
      add(rig_.target.points_mm[i] + truth_.target_errors_mm[i], rig_.target.led_radius_mm);
    return discs;
  }
  const PatternConfig& p = rig_.pattern;
  for (int row = 0; row < p.rows; ++row)
    for (int column = 0; column < p.columns; ++column) {
      const std::array at{column - p.origin_column, row - p.origin_row};
      const bool big = std::ranges::find(p.direction_circles, at) != p.direction_circles.end();
      add({at[0] * p.spacing_mm, at[1] * p.spacing_mm, 0.0},
          big ? p.direction_radius_mm : p.radius_mm);
    }
  return discs;
}

}  // namespace turntable::sim
