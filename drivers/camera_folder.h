// A camera whose own software writes images into a folder: the next file that appears answers the
// trigger. Such software exposes when it likes and saves when it has time, so a file that appears now
// may show what was there before the trigger. The rig file's latency says how long after the beginning
// of its exposure an image is in the folder at the latest; only what is written later than that counts.
// In replay, images taken earlier answer instead: in an order, or each pose by a file name made from
// the pose.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
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
  /// Waits for the latency, and then for a file that is written after it and has stopped growing; the
  /// first in order. A file is known by its path, inode, size and time, so a name may be used again.
  /// In replay: the next file, or the one of the announced exposure.
  /// @throws TimeoutError; DeviceError for a file that is no image, or of another size.
  Frame trigger() override;
  /// Where no latency is stated, waits for another file, up to the frame's deadline, and nothing moves.
  /// @throws DeviceError if one comes: the camera runs freely, and nobody says how late its files are.
  Frame try_out() override;

 private:
  /// What tells a file from the one that had its name before.
  struct Identity {
    std::uint64_t device = 0, inode = 0;
    std::int64_t size = 0, modified_ns = 0;
    bool operator==(const Identity&) const = default;
  };
  using Snapshot = std::map<std::filesystem::path, Identity>;

  static std::optional<Identity> identify(const std::filesystem::path& file);
  Snapshot look() const;
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
  std::optional<Exposure> announced_;
  std::uint64_t next_id_ = 0;
};

/// Runs of digits compare as numbers: img2 before img10.
bool natural_less(std::string_view a, std::string_view b);

}  // namespace turntable
