// The simulated camera: exposes the world as it is when the trigger comes.
#pragma once

#include <set>

#include "drivers/sim/render.h"
#include "src/core/camera.h"

namespace turntable::sim {

/// Frames that a fault takes away, by frame id.
struct CameraFaults {
  std::set<std::uint64_t> lost_frames;
};

class SimulatedCamera final : public Camera {
 public:
  SimulatedCamera(Clock& clock, const World& world, double frame_timeout_s,
                  CameraFaults faults = {});

  std::string identity() const override;
  ImageSize image_size() const override;
  Frame trigger() override;

 private:
  Clock& clock_;
  Renderer renderer_;
  ImageSize size_;
  double frame_timeout_s_;
  CameraFaults faults_;
  std::uint64_t next_id_ = 0;
};

}  // namespace turntable::sim
