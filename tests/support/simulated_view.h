// A simulated camera's view with known truth, for tests of what looks at images.
#pragma once

#include <map>

#include "drivers/sim/render.h"
#include "src/core/rig_file.h"

namespace turntable {

inline RigFile shipped_rig(const std::string& name) {
  return load_rig_file(std::string(TURNTABLE_SOURCE_DIR) + "/scenarios/rigs/" + name + ".json");
}

/// A world whose axes stand where the test says.
class SimulatedView {
 public:
  explicit SimulatedView(const RigFile& rig)
      : rig_(rig),
        world_(rig, [this](AxisId axis) { return position_[axis]; }),
        renderer_(world_) {}

  void stand(double stage_mm, double yaw_deg, double roll_deg, double pitch_deg) {
    position_ = {{AxisId::kStage, stage_mm},
                 {AxisId::kYaw, yaw_deg},
                 {AxisId::kRoll, roll_deg},
                 {AxisId::kPitch, pitch_deg}};
  }
  Image look(Payload payload) {
    world_.mount(payload);
    return renderer_.render(frame_++);
  }
  /// True pixel of a point of the payload, mm.
  Vector2d pixel_of(const Vector3d& on_payload) const {
    const sim::World::Pose pose = world_.payload_pose();
    return world_.lens().project(pose.R_camera_from_payload * on_payload + pose.origin_in_camera);
  }
  /// True pixels of the LEDs' centres.
  std::vector<Vector2d> led_pixels() const {
    std::vector<Vector2d> out;
    for (const sim::Disc& disc : world_.discs()) out.push_back(world_.lens().project(disc.centre));
    return out;
  }
  const RigFile& rig() const { return rig_; }
  sim::World& world() { return world_; }

 private:
  RigFile rig_;
  std::map<AxisId, double> position_;
  sim::World world_;
  sim::Renderer renderer_;
  std::uint64_t frame_ = 0;
};

}  // namespace turntable
