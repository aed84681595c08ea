// Trigger -> Frame.
#pragma once

#include <cstddef>
#include <string>

#include "src/core/image.h"

namespace turntable {

/// What an exposure is of: for cameras that look up images taken earlier.
struct Exposure {
  std::string scenario;
  int repeat = 0;
  std::size_t point = 0;  ///< within the repeat
  std::size_t index = 0;  ///< of the pose in the whole plan
  int image = 0;          ///< of the images of one pose
  double stage_mm = 0, yaw_deg = 0, roll_deg = 0, pitch_deg = 0;
};

class Camera {
 public:
  virtual ~Camera() = default;
  virtual std::string identity() const = 0;  ///< model, serial, firmware as the device states them
  virtual ImageSize image_size() const = 0;
  /// Says what the next trigger is for. Cameras that expose do not care.
  virtual void announce(const Exposure&) {}
  /// Fires one exposure and returns its frame: never an older one, never two for one trigger.
  /// @throws TimeoutError if no frame with the next id arrives before the camera's deadline.
  virtual Frame trigger() = 0;
};

}  // namespace turntable
