// A camera whose own software writes images into a folder: the next file that appears after the
// trigger answers it. In replay, images taken earlier answer instead: in an order, or each pose by
// a file name made from the pose.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/camera.h"

namespace turntable {

/// @throws ConfigError if the folder is none, the layout cannot be used, or there is nothing to
/// replay.
std::unique_ptr<Camera> open_folder_camera(CameraSetup setup);

class FolderCamera final : public Camera {
 public:
  explicit FolderCamera(CameraSetup setup);

  std::string identity() const override;
  ImageSize image_size() const override { return config_.image_size; }
  /// In replay: too few images; with a layout, files that are not there, and one file for two
  /// exposures. Only a pose that is visited again within the same repeat may get the same file: a
  /// layout of angles gives the reference pose and a measured pose at zero one image.
  void check(std::span<const Exposure> exposures) const override;
  bool exposes() const override { return !config_.replay; }
  void announce(const Exposure& exposure) override { announced_ = exposure; }
  /// Waits for a file that was not there before and has stopped growing; the first in order.
  /// In replay: the next file, or the one of the announced exposure.
  /// @throws TimeoutError; DeviceError for a file that is no image, or of another size.
  Frame trigger() override;

 private:
  std::vector<std::filesystem::path> matching_files() const;
  void sort(std::vector<std::filesystem::path>& files) const;
  std::filesystem::path laid_out(const Exposure& exposure) const;
  std::filesystem::path earlier_file() const;
  std::filesystem::path await_new_file(Image& image);

  CameraConfig config_;
  Clock* clock_;
  std::function<Image(const std::filesystem::path&)> load_;
  std::string pattern_;                         ///< config_.files for fnmatch
  std::vector<std::filesystem::path> earlier_;  ///< replay without a layout: all, in order
  std::set<std::filesystem::path> spent_;       ///< returned, or there before the trigger
  std::optional<Exposure> announced_;
  std::uint64_t next_id_ = 0;
};

/// Runs of digits compare as numbers: img2 before img10.
bool natural_less(std::string_view a, std::string_view b);

}  // namespace turntable
