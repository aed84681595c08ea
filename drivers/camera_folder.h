// A camera whose own software writes images into a folder: the next new file answers a trigger. The same serves
// images taken earlier, in the order of their names.
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
  FolderCamera(Clock& clock, std::filesystem::path folder, ImageSize size, double frame_timeout_s, Loader load);

  std::string identity() const override;
  ImageSize image_size() const override { return size_; }
  /// Waits for a .png file that was not returned before and has stopped growing; the first by name.
  /// @throws TimeoutError; ConfigError for a file that is no image, or of another size.
  Frame trigger() override;

 private:
  std::filesystem::path next_file() const;

  Clock& clock_;
  std::filesystem::path folder_;
  ImageSize size_;
  double frame_timeout_s_;
  Loader load_;
  std::set<std::filesystem::path> returned_;
  std::uint64_t next_id_ = 0;
};

}  // namespace turntable
