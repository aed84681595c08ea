// Trigger -> Frame.
#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "src/core/image.h"

namespace turntable {

/// What an exposure is of: for cameras that look up images taken earlier.
struct Exposure {
  std::string scenario;
  int repeat = 1;         ///< from 1
  std::size_t point = 0;  ///< within the repeat, 0 = its reference pose
  std::size_t index = 0;  ///< of the pose in the whole plan, from 0
  int image = 1;          ///< of the images of one pose, from 1
  double stage_mm = 0, yaw_deg = 0, roll_deg = 0, pitch_deg = 0;
};

class Camera {
 public:
  virtual ~Camera() = default;
  virtual std::string identity() const = 0;  ///< model, serial, firmware as the device states them
  virtual ImageSize image_size() const = 0;
  /// Can it answer these exposures, all of them and in this order? Asked before anything moves, of a
  /// camera that does not expose.
  /// @throws ConfigError naming the first that it cannot, and how many there are.
  virtual void check(std::span<const Exposure>) const {}
  /// False for one that looks up images taken earlier: a second trigger shows nothing new.
  virtual bool exposes() const { return true; }
  /// One exposure before anything moves, to see whether trigger and transfer work. Only of a camera
  /// that exposes. @throws as `trigger`.
  virtual Frame try_out() { return trigger(); }
  /// Says what the next trigger is for. Cameras that expose do not care.
  virtual void announce(const Exposure&) {}
  /// Fires one exposure and returns its frame: never an older one, never two for one trigger.
  /// @throws TimeoutError if no frame with the next id arrives before the camera's deadline.
  virtual Frame trigger() = 0;
};

}  // namespace turntable
