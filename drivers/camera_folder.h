// A camera whose own software writes images into a folder: the next file that appears after the
// trigger answers it. In replay, images taken earlier answer instead, in the order of their names.
#pragma once

#include <filesystem>
#include <memory>
#include <set>

#include "drivers/camera.h"

namespace turntable {

/// @throws ConfigError if the folder is none.
std::unique_ptr<Camera> open_folder_camera(CameraSetup setup);

class FolderCamera final : public Camera {
 public:
  explicit FolderCamera(CameraSetup setup);

  std::string identity() const override;
  ImageSize image_size() const override { return config_.image_size; }
  /// Waits for a .png file that was not there before (in replay: was not returned before) and has
  /// stopped growing; the first by name. @throws TimeoutError; DeviceError for a file that is no
  /// image, or of another size.
  Frame trigger() override;

 private:
  std::filesystem::path next_file() const;
  void ignore_present_files();

  CameraConfig config_;
  Clock* clock_;
  std::function<Image(const std::filesystem::path&)> load_;
  std::set<std::filesystem::path> spent_;  ///< returned, or there before the trigger
  std::uint64_t next_id_ = 0;
};

}  // namespace turntable
