#include "drivers/camera_folder.h"

#include <fmt/format.h>
#include <fnmatch.h>
#include <sys/stat.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

#include "src/core/errors.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

constexpr double kPollS = 0.02;

std::string escaped(std::string_view files) {  // * and ? are all that a pattern knows
  std::string out;
  for (const char c : files) {
    if (c == '[' || c == '\\') out += '\\';
    out += c;
  }
  return out;
}

/// Targets are sums of steps; in a name 0.1 + 0.2 is 0.3, and nothing is -0.
double tidy(double target) { return std::round(target * 1e9) / 1e9 + 0.0; }

std::string describe(const Exposure& e) {
  return fmt::format(
      "pose {} (scenario {}, repeat {}, point {}, image {}; stage {} mm, yaw {} deg, roll {} deg, "
      "pitch {} deg)",
      e.index, e.scenario, e.repeat, e.point, e.image, tidy(e.stage_mm), tidy(e.yaw_deg),
      tidy(e.roll_deg), tidy(e.pitch_deg));
}

/// The same place in the same repeat: one image can stand for both.
bool alike(const Exposure& a, const Exposure& b) {
  const auto key = [](const Exposure& e) {
    return std::tuple(e.scenario, e.repeat, e.image, e.stage_mm, e.yaw_deg, e.roll_deg,
                      e.pitch_deg);
  };
  return key(a) == key(b);
}

/// Takes a run of digits off the front. @return it without leading zeros.
std::string_view take_number(std::string_view& text) {
  const std::size_t end = std::min(text.find_first_not_of("0123456789"), text.size());
  std::string_view digits = text.substr(0, end);
  text.remove_prefix(end);
  digits.remove_prefix(std::min(digits.find_first_not_of('0'), digits.size()));
  return digits;
}

bool starts_with_digit(std::string_view text) {
  return !text.empty() && text.front() >= '0' && text.front() <= '9';
}

}  // namespace

bool natural_less(std::string_view a, std::string_view b) {
  while (!a.empty() && !b.empty()) {
    if (starts_with_digit(a) && starts_with_digit(b)) {
      const std::string_view x = take_number(a), y = take_number(b);
      if (x != y) return std::pair(x.size(), x) < std::pair(y.size(), y);
    } else {
      if (a.front() != b.front()) return a.front() < b.front();
      a.remove_prefix(1);
      b.remove_prefix(1);
    }
  }
  return a.size() < b.size();
}

std::unique_ptr<Camera> open_folder_camera(CameraSetup setup) {
  return std::make_unique<FolderCamera>(std::move(setup));
}

FolderCamera::FolderCamera(CameraSetup setup)
    : config_(std::move(setup.config)),
      clock_(setup.clock),
      load_(std::move(setup.load)),
      pattern_(escaped(config_.files)) {
  std::error_code unreadable;
  if (!fs::is_directory(config_.folder, unreadable))
    throw ConfigError(config_.folder.string(), "",
                      "is not a folder. Name the folder that the camera's images go to.");
  if (!config_.replay) return;
  if (!config_.layout.empty()) {
    laid_out({});  // refuses it now if it ever will
    return;
  }
  earlier_ = matching_files();
  sort(earlier_);
  if (earlier_.empty())
    throw ConfigError("rig", "/camera/files",
                      fmt::format("no file matches \"{}\" below {}: there is nothing to replay. "
                                  "* and ? stand for characters of one name; write folders out, as "
                                  "in \"*/cam*.bmp\".",
                                  config_.files, config_.folder.string()));
}

std::string FolderCamera::identity() const {
  return fmt::format("images {} folder {}, {}", config_.replay ? "taken earlier, from" : "from",
                     config_.folder.string(),
                     config_.layout.empty() ? config_.files : config_.layout);
}

std::vector<fs::path> FolderCamera::matching_files() const {
  const auto depth = std::ranges::count(pattern_, '/');
  std::vector<fs::path> found;
  std::error_code gone;  // renamed or removed while it is looked at
  fs::recursive_directory_iterator it(config_.folder,
                                      fs::directory_options::follow_directory_symlink |
                                          fs::directory_options::skip_permission_denied,
                                      gone);
  for (; it != fs::recursive_directory_iterator(); it.increment(gone)) {
    if (it.depth() >= depth) it.disable_recursion_pending();
    const std::string name = it->path().lexically_relative(config_.folder).generic_string();
    if (::fnmatch(pattern_.c_str(), name.c_str(), FNM_PATHNAME | FNM_PERIOD) == 0 &&
        it->is_regular_file(gone))
      found.push_back(it->path());
  }
  return found;
}

void FolderCamera::sort(std::vector<fs::path>& files) const {
  std::ranges::sort(files);
  if (config_.order == FileOrder::kNatural)
    std::ranges::stable_sort(files, [](const fs::path& a, const fs::path& b) {
      return natural_less(a.native(), b.native());
    });
  if (config_.order == FileOrder::kTime) {
    std::error_code gone;
    std::map<fs::path, fs::file_time_type> written;
    for (const fs::path& file : files) written[file] = fs::last_write_time(file, gone);
    std::ranges::stable_sort(files, {}, [&](const fs::path& file) { return written.at(file); });
  }
}

fs::path FolderCamera::laid_out(const Exposure& e) const {
  try {
    return config_.folder /
           fmt::format(fmt::runtime(config_.layout), fmt::arg("scenario", e.scenario),
                       fmt::arg("repeat", e.repeat), fmt::arg("point", e.point),
                       fmt::arg("index", e.index), fmt::arg("image", e.image),
                       fmt::arg("stage_mm", tidy(e.stage_mm)), fmt::arg("yaw_deg", tidy(e.yaw_deg)),
                       fmt::arg("roll_deg", tidy(e.roll_deg)),
                       fmt::arg("pitch_deg", tidy(e.pitch_deg)));
  } catch (const fmt::format_error& error) {
    throw ConfigError(
        "rig", "/camera/layout",
        fmt::format("found \"{}\", which cannot be used ({}). Allowed: {{scenario}}, {{repeat}}, "
                    "{{point}}, {{index}}, {{image}}, {{stage_mm}}, {{yaw_deg}}, {{roll_deg}}, "
                    "{{pitch_deg}}, with a format if you like: {{point:03}}, {{yaw_deg:+06.1f}}.",
                    config_.layout, error.what()));
  }
}

void FolderCamera::check(std::span<const Exposure> exposures) const {
  if (!config_.replay) return;
  const std::string folder = config_.folder.string();
  if (config_.layout.empty()) {
    const std::size_t left = earlier_.size() - next_id_;
    if (exposures.size() > left)
      throw ConfigError(
          folder, "",
          fmt::format(
              "found {} images for \"{}\" that are not used yet, and the plan needs {}. Add "
              "what is missing, or ask for the poses that were taken.",
              left, config_.files, exposures.size()));
    return;
  }
  std::map<fs::path, const Exposure*> users;
  std::size_t missing = 0;
  std::string first;
  for (const Exposure& exposure : exposures) {
    const fs::path file = laid_out(exposure);
    const auto [user, fresh] = users.emplace(file, &exposure);
    if (!fresh && !alike(*user->second, exposure))
      throw ConfigError(
          folder, "",
          fmt::format("the layout \"{}\" gives {} to {} and to {}. Add what tells them apart.",
                      config_.layout, file.string(), describe(*user->second), describe(exposure)));
    std::error_code unreadable;
    if (fs::is_regular_file(file, unreadable)) continue;
    if (missing++ == 0) first = fmt::format("{} of {}", file.string(), describe(exposure));
  }
  if (missing > 0)
    throw ConfigError(
        folder, "",
        fmt::format("{} of the plan's {} images are missing; the first is {}. Restore "
                    "them, or correct the layout \"{}\".",
                    missing, exposures.size(), first, config_.layout));
}

fs::path FolderCamera::earlier_file() const {
  if (config_.layout.empty()) {
    if (next_id_ < earlier_.size()) return earlier_[next_id_];
    throw DeviceError(fmt::format("camera: all {} images of {} are used up.", earlier_.size(),
                                  config_.folder.string()));
  }
  if (!announced_)
    throw DeviceError(
        "camera: which image to look up depends on the pose, and none was announced. Run a "
        "scenario, or open the folder without a layout.");
  return laid_out(*announced_);
}

std::optional<FolderCamera::Identity> FolderCamera::identify(const fs::path& file) {
  struct stat status {};
  if (::stat(file.c_str(), &status) != 0) return std::nullopt;  // renamed or removed meanwhile
  return Identity{static_cast<std::uint64_t>(status.st_dev),
                  static_cast<std::uint64_t>(status.st_ino),
                  static_cast<std::int64_t>(status.st_size),
                  std::int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec};
}

FolderCamera::Snapshot FolderCamera::look() const {
  Snapshot seen;
  for (fs::path& file : matching_files())
    if (const auto identity = identify(file)) seen.emplace(std::move(file), *identity);
  return seen;
}

fs::path FolderCamera::await_new_file(Image& image) {
  // What is written up to here may have been exposed before the trigger.
  clock_->sleep_for(from_seconds(config_.latency_s));
  const Snapshot before = look();
  const Time deadline = clock_->now() + from_seconds(config_.frame_timeout_s);
  Snapshot last;
  std::string unreadable;
  fs::path changing;
  for (;;) {
    Snapshot now = look();
    std::vector<fs::path> fresh;
    for (const auto& [file, identity] : now)
      if (const auto old = before.find(file); old == before.end() || old->second != identity)
        fresh.push_back(file);
    sort(fresh);
    for (const fs::path& file : fresh) {
      const Identity& identity = now.at(file);
      const auto earlier = last.find(file);
      if (earlier == last.end() || earlier->second != identity || identity.size == 0) {
        changing = file;  // written to since the last look
        continue;
      }
      try {
        image = load_(file);
        if (identify(file) == identity) return file;
        changing = file;
      } catch (const ConfigError& e) {  // or only stalled
        unreadable = e.what();
      }
    }
    if (clock_->now() >= deadline) {
      if (!unreadable.empty()) throw DeviceError("camera: " + unreadable);
      throw TimeoutError(fmt::format(
          "camera: no new {} in {} within {:.1f} s of the trigger{}. Check the camera's software "
          "and "
          "its folder.",
          config_.files, config_.folder.string(), config_.latency_s + config_.frame_timeout_s,
          changing.empty() ? std::string()
                           : fmt::format(": {} is being rewritten all the time, and no two looks "
                                         "{:g} s apart found it the same",
                                         changing.string(), kPollS)));
    }
    last = std::move(now);
    clock_->sleep_for(from_seconds(kPollS));
  }
}

Frame FolderCamera::try_out() {
  Frame frame = trigger();
  if (config_.latency_stated || config_.replay) return frame;
  Image another;
  try {
    await_new_file(another);
  } catch (const TimeoutError&) {
    return frame;  // it saves when it is told to
  }
  throw ConfigError(
      "rig", "/camera/latency_ms",
      fmt::format(
          "is missing: images come into {} without being asked for, so one that comes after a "
          "trigger may have been exposed before it, while the axes still moved. State how long "
          "after the beginning of its exposure an image is in the folder at the latest (let the "
          "camera look at a running clock, and compare what an image shows with the time of its "
          "file). 0 says that this cannot happen. Nothing was moved.",
          config_.folder.string()));
}

Frame FolderCamera::trigger() {
  Frame frame;
  frame.timestamp = clock_->now();
  fs::path file;
  if (config_.replay) {
    file = earlier_file();
    try {
      frame.image = load_(file);
    } catch (const ConfigError& e) {
      throw DeviceError(fmt::format(
          "camera: {}{}", e.what(),
          announced_ ? fmt::format(" It is the image of {}.", describe(*announced_)) : ""));
    }
  } else {
    file = await_new_file(frame.image);
  }
  if (frame.image.size() != config_.image_size)
    throw DeviceError(
        fmt::format("camera: {} has {} x {} px, allowed: {} x {} px as the rig file says.",
                    file.string(), frame.image.width, frame.image.height, config_.image_size.width,
                    config_.image_size.height));
  frame.id = next_id_++;
  return frame;
}

}  // namespace turntable
