// What a camera is opened with.
#pragma once

#include <filesystem>
#include <functional>

#include "src/core/camera.h"
#include "src/core/rig_file.h"

namespace turntable {

struct CameraSetup {
  CameraConfig config;
  Clock* clock = nullptr;
  /// Reads an image file. @throws ConfigError if it is none.
  std::function<Image(const std::filesystem::path&)> load;
  /// Pulses the controller output that is wired to the camera's input; empty = there is none.
  std::function<void()> fire;
};

}  // namespace turntable
