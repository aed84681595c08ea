// The simulated camera: exposes the world as it is when the trigger comes, by software or by an
// edge on its input.
#pragma once

#include <functional>
#include <optional>
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
  /// From now on exposures begin with an edge on the input. @param fire pulses what is wired to it.
  void wire_input(bool rising, std::function<void()> fire);
  /// The input changes.
  void input(bool on);

  std::string identity() const override;
  ImageSize image_size() const override;
  Frame trigger() override;
  /// Counts as no exposure, so that the noise of those that follow, and lost frames, stay as they are.
  Frame try_out() override;

 private:
  Frame expose();

  Clock& clock_;
  Renderer renderer_;
  ImageSize size_;
  double frame_timeout_s_;
  CameraFaults faults_;
  std::uint64_t next_id_ = 0;
  bool rising_ = true;
  std::function<void()> fire_;
  std::optional<Frame> exposed_;  ///< by the edge
};

}  // namespace turntable::sim
