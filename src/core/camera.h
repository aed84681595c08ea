// Trigger -> Frame.
#pragma once

#include <string>

#include "src/core/image.h"

namespace turntable {

class Camera {
 public:
  virtual ~Camera() = default;
  virtual std::string identity() const = 0;  ///< model, serial, firmware as the device states them
  virtual ImageSize image_size() const = 0;
  /// Fires one exposure and returns its frame: never an older one, never two for one trigger.
  /// @throws TimeoutError if no frame with the next id arrives before the camera's deadline.
  virtual Frame trigger() = 0;
};

}  // namespace turntable
