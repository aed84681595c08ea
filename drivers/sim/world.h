// The truth of the simulated rig: where the table, the LEDs, the circles and the camera really are,
// after backlash and repeatability error. Nobody above the bytes may ask it; the simulated camera
// looks at it.
#pragma once

#include <atomic>
#include <functional>
#include <vector>

#include "drivers/sim/lens.h"
#include "src/core/rig_file.h"
#include "src/geometry/gimbal.h"

namespace turntable::sim {

/// A flat disc, in the camera frame: centre and the two half-axes that span it, mm.
struct Disc {
  Vector3d centre;
  Vector3d across;
  Vector3d down;
};

class World {
 public:
  /// @param true_position where an axis really is now, mm or deg.
  World(const RigFile& rig, std::function<double(AxisId)> true_position);

  void mount(Payload payload) { payload_ = payload; }
  Payload payload() const { return payload_; }

  /// The LEDs, or the circles, where they are now.
  std::vector<Disc> discs() const;
  /// Pattern frame -> camera frame now: rotation and the origin circle's place, mm.
  struct Pose {
    Matrix3d R_camera_from_payload;
    Vector3d origin_in_camera;
  };
  Pose payload_pose() const;

  const Lens& lens() const { return lens_; }
  const ImageTruth& image_truth() const { return truth_.image; }
  std::uint64_t seed() const { return truth_.seed; }
  const PatternConfig& pattern() const { return rig_.pattern; }
  ImageSize image_size() const { return rig_.camera.image_size; }

 private:
  RigFile rig_;
  SimulationConfig truth_;
  Gimbal gimbal_;
  Lens lens_;
  std::function<double(AxisId)> true_position_;
  Matrix3d R_camera_from_plane_;
  std::atomic<Payload> payload_ =
      Payload::kCirclePattern;  ///< a served camera looks from its own thread
};

}  // namespace turntable::sim
