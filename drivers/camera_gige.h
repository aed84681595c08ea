// Cameras that speak GenICam over GigE Vision or USB3 Vision, through Aravis 0.8. They are real
// devices even on a simulated rig, whose camera is served on loopback: their frames are waited for
// in real time, whatever the rig's clock is; only `Frame::timestamp` is read from that clock.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "drivers/camera.h"

namespace turntable {

struct FoundCamera {
  std::string id;  ///< what `device` of a rig file may name; so may the address
  std::string vendor, model, serial;
  std::string address;   ///< of a network camera
  std::string protocol;  ///< "GigEVision", "USB3Vision"
};

/// Every camera that answers now; takes about a second.
std::vector<FoundCamera> find_gige_cameras();

/// Where the frames have gone, since opening. For every frame id from the first that was delivered
/// to the last: delivered, incomplete, missing or stale.
struct GigeStatistics {
  std::uint64_t delivered = 0;
  std::uint64_t incomplete = 0;   ///< arrived with packets lost
  std::uint64_t missing = 0;      ///< ids that never arrived
  std::uint64_t stale = 0;        ///< exposed before the trigger that found them
  std::uint64_t retriggered = 0;  ///< further triggers after incomplete frames
};

class GigeCamera final : public Camera {
 public:
  /// Finds the camera, sets all of it that the rig file states, reads it back, starts acquisition.
  /// @throws DeviceError if it is not there, not to be controlled, or not to be set up as stated;
  /// LineError if it stops answering.
  explicit GigeCamera(CameraSetup setup);
  ~GigeCamera() override;

  std::string identity() const override;
  ImageSize image_size() const override;
  /// Incomplete frames are exposed again up to `retries` times, if it is this program that triggers.
  /// @throws TimeoutError if no frame arrives in time, or none arrives complete; LineError if the
  /// camera is gone; DeviceError if it sends what it was not set up for.
  Frame trigger() override;

  GigeStatistics statistics() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

std::unique_ptr<Camera> open_gige_camera(CameraSetup setup);

}  // namespace turntable
