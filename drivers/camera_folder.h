// A camera whose own software writes images into a folder: the next file that appears after the
// trigger answers it. In replay, images taken earlier answer instead, in the order of their names.
#pragma once

#include <filesystem>
#include <functional>
#include <set>

#include "src/core/camera.h"

namespace turntable {

class FolderCamera final : public Camera {
 public:
  using Loader = std::function<Image(const std::filesystem::path&)>;

  /// @param load reads an image file; @throws ConfigError if `folder` is not a folder.
  FolderCamera(Clock& clock, std::filesystem::path folder, bool replay, ImageSize size,
               double frame_timeout_s, Loader load);

  std::string identity() const override;
  ImageSize image_size() const override { return size_; }
  /// Waits for a .png file that was not there before (in replay: was not returned before) and has
  /// stopped growing; the first by name. @throws TimeoutError; DeviceError for a file that is no
  /// image, or of another size.
  Frame trigger() override;

 private:
  std::filesystem::path next_file() const;
  void ignore_present_files();

  Clock& clock_;
  std::filesystem::path folder_;
  bool replay_;
  ImageSize size_;
  double frame_timeout_s_;
  Loader load_;
  std::set<std::filesystem::path> spent_;  ///< returned, or there before the trigger
  std::uint64_t next_id_ = 0;
};

}  // namespace turntable
