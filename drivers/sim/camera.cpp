#include "drivers/sim/camera.h"

#include <fmt/format.h>

#include "src/core/errors.h"

namespace turntable::sim {
namespace {

constexpr double kExposureAndTransferS = 0.03;

}  // namespace

SimulatedCamera::SimulatedCamera(Clock& clock, const World& world, double frame_timeout_s,
                                 CameraFaults faults)
    : clock_(clock),
      renderer_(world),
      size_(world.image_size()),
      frame_timeout_s_(frame_timeout_s),
      faults_(std::move(faults)) {}

std::string SimulatedCamera::identity() const {
  return fmt::format("simulated camera {} x {} px, 8 bit", size_.width, size_.height);
}

ImageSize SimulatedCamera::image_size() const { return size_; }

void SimulatedCamera::wire_input(bool rising, std::function<void()> fire) {
  rising_ = rising;
  fire_ = std::move(fire);
}

void SimulatedCamera::input(bool on) {
  if (fire_ && on == rising_) exposed_ = expose();
}

Frame SimulatedCamera::expose() {
  Frame frame;
  frame.id = next_id_++;
  frame.timestamp = clock_.now();
  if (!faults_.lost_frames.contains(frame.id)) frame.image = renderer_.render(frame.id);
  return frame;
}

Frame SimulatedCamera::trigger() {
  exposed_.reset();
  if (fire_)
    fire_();
  else
    exposed_ = expose();
  if (exposed_ && !exposed_->image.pixels.empty()) {
    clock_.sleep_for(from_seconds(kExposureAndTransferS));
    return *std::move(exposed_);
  }
  clock_.sleep_for(from_seconds(frame_timeout_s_));
  throw TimeoutError(
      fmt::format("camera: no frame within {:.1f} s of the trigger{}. Check the cable, the trigger "
                  "mode and the "
                  "exposure time.",
                  frame_timeout_s_, exposed_ ? fmt::format(" (frame {})", exposed_->id) : ""));
}

Frame SimulatedCamera::try_out() {
  const std::uint64_t next = next_id_;
  try {
    Frame frame = trigger();
    next_id_ = next;
    return frame;
  } catch (...) {
    next_id_ = next;
    throw;
  }
}

}  // namespace turntable::sim
