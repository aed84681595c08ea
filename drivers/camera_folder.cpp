#include "drivers/camera_folder.h"

#include <fmt/format.h>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr double kPollS = 0.02;

}  // namespace

std::unique_ptr<Camera> open_folder_camera(CameraSetup setup) {
  return std::make_unique<FolderCamera>(std::move(setup));
}

FolderCamera::FolderCamera(CameraSetup setup)
    : config_(std::move(setup.config)), clock_(setup.clock), load_(std::move(setup.load)) {
  if (!std::filesystem::is_directory(config_.folder))
    throw ConfigError(config_.folder.string(), "",
                      "is not a folder. Name the folder that the camera's images go to.");
}

std::string FolderCamera::identity() const {
  return "images from folder " + config_.folder.string();
}

std::filesystem::path FolderCamera::next_file() const {
  std::filesystem::path first;
  for (const auto& entry : std::filesystem::directory_iterator(config_.folder)) {
    if (entry.path().extension() != ".png" || spent_.contains(entry.path())) continue;
    if (first.empty() || entry.path() < first) first = entry.path();
  }
  return first;
}

void FolderCamera::ignore_present_files() {
  for (const auto& entry : std::filesystem::directory_iterator(config_.folder))
    spent_.insert(entry.path());
}

Frame FolderCamera::trigger() {
  if (!config_.replay) ignore_present_files();
  Frame frame;
  frame.timestamp = clock_->now();
  const Time deadline = clock_->now() + from_seconds(config_.frame_timeout_s);
  std::uintmax_t last_size = 0;
  std::filesystem::path last;
  std::string unreadable;
  for (;;) {
    const std::filesystem::path file = next_file();
    std::error_code gone;  // renamed or removed between two looks
    const std::uintmax_t size = file.empty() ? 0 : std::filesystem::file_size(file, gone);
    if (!file.empty() && !gone) {
      if (file == last && size == last_size && size > 0) {  // two looks, the same size: written
        try {
          frame.image = load_(file);
          break;
        } catch (const ConfigError& e) {  // or only stalled
          unreadable = e.what();
        }
      }
      last = file;
      last_size = size;
    }
    if (clock_->now() >= deadline) {
      if (!unreadable.empty()) throw DeviceError("camera: " + unreadable);
      throw TimeoutError(fmt::format(
          "camera: no new .png in {} within {:.1f} s of the trigger. Check the camera's "
          "software and its folder.",
          config_.folder.string(), config_.frame_timeout_s));
    }
    clock_->sleep_for(from_seconds(kPollS));
  }
  spent_.insert(last);
  if (frame.image.size() != config_.image_size)
    throw DeviceError(
        fmt::format("camera: {} has {} x {} px, allowed: {} x {} px as the rig file says.",
                    last.string(), frame.image.width, frame.image.height, config_.image_size.width,
                    config_.image_size.height));
  frame.id = next_id_++;
  return frame;
}

}  // namespace turntable
