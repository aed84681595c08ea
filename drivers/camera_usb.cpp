#include "drivers/camera_usb.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/videoio.hpp>
#include <optional>

#include "src/core/errors.h"
#include "src/core/interrupt.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

constexpr int kStaleOfDevice = 4;
constexpr int kDeepestBuffer = VIDEO_MAX_FRAME;
constexpr double kUsualInterval = 1.0 / 30;  ///< s, of a device that does not say
constexpr double kExposureUnitUs = 100;      ///< V4L2_CID_EXPOSURE_ABSOLUTE
constexpr double kManualExposure = 1;        ///< V4L2_EXPOSURE_MANUAL
constexpr double kControlTolerance = 0.05;   ///< of a value that a device rounds to its own steps

/// The library warns on stderr about what is an exception or an answer here.
class Silence {
 public:
  Silence() : level_(cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT)) {}
  ~Silence() { cv::utils::logging::setLogLevel(level_); }
  Silence(const Silence&) = delete;
  Silence& operator=(const Silence&) = delete;

 private:
  cv::utils::logging::LogLevel level_;
};

/// The name of the card if the device captures.
std::optional<std::string> capturing_card(const fs::path& device) {
  const int fd = ::open(device.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) return std::nullopt;
  v4l2_capability has{};
  const bool answered = ::ioctl(fd, VIDIOC_QUERYCAP, &has) == 0;
  ::close(fd);
  // One piece of hardware is several devices, of which one captures and others carry metadata.
  const std::uint32_t caps =
      (has.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? has.device_caps : has.capabilities;
  if (!answered || (caps & V4L2_CAP_VIDEO_CAPTURE) == 0) return std::nullopt;
  const auto* card = reinterpret_cast<const char*>(has.card);
  return std::string(card, ::strnlen(card, sizeof has.card));
}

class UsbCamera final : public Camera {
 public:
  explicit UsbCamera(CameraSetup setup) : config_(std::move(setup.config)), clock_(setup.clock) {
    name_ = config_.device;
    if (name_.find_first_not_of("0123456789") == std::string::npos) name_ = "/dev/video" + name_;
    is_device_ = name_.starts_with("/dev/");
    stale_ = config_.stale_frames.value_or(is_device_ ? kStaleOfDevice : 0);
    const Silence silence;
    if (is_device_)
      open_device();
    else
      open_file();
    compare("width", capture_.get(cv::CAP_PROP_FRAME_WIDTH), config_.image_size.width);
    compare("height", capture_.get(cv::CAP_PROP_FRAME_HEIGHT), config_.image_size.height);
  }

  std::string identity() const override {
    return fmt::format("{} {}{}, {} x {} px, colour to luma, 16 bit to the upper 8",
                       is_device_ ? "video device" : "video file", name_,
                       card_.empty() ? "" : " (" + card_ + ")", config_.image_size.width,
                       config_.image_size.height);
  }
  ImageSize image_size() const override { return config_.image_size; }
  bool exposes() const override { return is_device_; }

  Frame trigger() override {
    const Silence silence;
    Frame frame;
    frame.timestamp = clock_->now();
    cv::Mat pixels;
    try {
      const Time give_up = wall_.now() + from_seconds(config_.frame_timeout_s);
      const auto grab = [&] {
        throw_if_stopping_now();
        if (is_device_ && wall_.now() > give_up)
          throw TimeoutError(
              fmt::format("camera: {} gives no frame of after the trigger within {:g} s. Raise "
                          "frame_timeout_ms "
                          "or the frame rate.",
                          name_, config_.frame_timeout_s));
        const bool came = capture_.grab();
        grabbed_ += came ? 1 : 0;
        return came;
      };
      if (!grab_after_now(grab, wall_, stale_, interval_)) no_frame();
      capture_.retrieve(pixels);
    } catch (const cv::Exception& e) {
      throw DeviceError(fmt::format("camera: {}: {}", name_, e.what()));
    }
    if (pixels.empty()) damaged_frame();
    const bool deep = pixels.depth() == CV_16U;
    const int channels = pixels.channels();
    if ((!deep && pixels.depth() != CV_8U) || channels == 2 || channels > 4)
      throw DeviceError(fmt::format(
          "camera: {} gives frames that are neither 8-bit nor 16-bit, grey or colour.", name_));
    frame.image = to_grey({pixels.data,
                           {pixels.cols, pixels.rows},
                           static_cast<std::ptrdiff_t>(pixels.step[0]),
                           channels,
                           deep ? 16 : 8});
    compare("width", frame.image.width, config_.image_size.width);
    compare("height", frame.image.height, config_.image_size.height);
    frame.id = grabbed_ - 1;
    return frame;
  }

 private:
  void open_device() {
    card_ = capturing_card(name_).value_or("");
    if (!capture_.open(name_, cv::CAP_V4L2)) {
      std::string found;
      for (const std::string& camera : find_usb_cameras()) found += "\n  " + camera;
      throw DeviceError(
          fmt::format("camera: {} cannot be opened: it is not there, captures nothing, "
                      "is used by another program, or may not be read by this user. "
                      "Devices that capture:{}",
                      name_, found.empty() ? " none." : found));
    }
    // Either of the first two starts the stream afresh, so the controls come after them.
    capture_.set(cv::CAP_PROP_FRAME_WIDTH, config_.image_size.width);
    capture_.set(cv::CAP_PROP_FRAME_HEIGHT, config_.image_size.height);
    capture_.set(cv::CAP_PROP_BUFFERSIZE, 1);  // a driver may insist on more
    if (config_.exposure_us) {
      capture_.set(cv::CAP_PROP_AUTO_EXPOSURE, kManualExposure);
      const double wanted = std::max(1.0, std::round(*config_.exposure_us / kExposureUnitUs));
      control(cv::CAP_PROP_EXPOSURE, "exposure", wanted, kExposureUnitUs, " us");
    }
    if (config_.gain) control(cv::CAP_PROP_GAIN, "gain", *config_.gain, 1, "");
    const double fps = capture_.get(cv::CAP_PROP_FPS);
    interval_ = from_seconds(
        std::max(fps > 0 ? 1 / fps : kUsualInterval, config_.exposure_us.value_or(0) * 1e-6));
  }

  void open_file() {
    for (const auto& [key, value] :
         {std::pair("exposure_us", config_.exposure_us), std::pair("gain", config_.gain)})
      if (value)
        throw ConfigError("rig", fmt::format("/camera/{}", key),
                          fmt::format("cannot be changed in {}, which was taken earlier. Remove "
                                      "it.",
                                      name_));
    const bool sequence = name_.find('%') != std::string::npos;
    std::error_code unreadable;
    if (!sequence && !fs::is_regular_file(name_, unreadable))
      throw ConfigError("rig", "/camera/device",
                        fmt::format("found \"{}\", which is not there. Allowed: a device such as "
                                    "/dev/video0 or its number, a video file, or an image sequence "
                                    "such as shot_%03d.png.",
                                    name_));
    const bool opened = sequence ? capture_.open(name_, cv::CAP_IMAGES)
                                 : capture_.open(name_, cv::CAP_FFMPEG) ||
                                       capture_.open(name_, cv::CAP_OPENCV_MJPEG);
    if (!opened)
      throw ConfigError(
          "rig", "/camera/device",
          fmt::format("{} cannot be opened as {}. Name another file, or convert it to AVI with "
                      "Motion JPEG.",
                      name_, sequence ? "an image sequence" : "a video"));
  }

  /// Sets a control and reads it back. @param unit of one step, in the rig file's own unit.
  void control(int property, std::string_view what, double wanted, double unit,
               std::string_view unit_name) {
    const bool taken = capture_.set(property, wanted);
    const double found = capture_.get(property);
    if (taken && std::abs(found - wanted) <= std::max(1.0, kControlTolerance * wanted)) return;
    throw DeviceError(fmt::format(
        "camera: {} was asked for {} {}{}, and {}. Change /camera/{} in the rig file, or leave it "
        "out to keep what the camera is set to.",
        name_, what, wanted * unit, unit_name,
        taken ? fmt::format("has {}{}", found * unit, unit_name) : "does not take it",
        what == "exposure" ? "exposure_us" : what));
  }

  void compare(std::string_view what, double found, double wanted) const {
    if (found == wanted) return;
    throw DeviceError(fmt::format(
        "camera: {} has frames of {} {} px, wanted: {} px as the rig file says. State an image "
        "size that it offers.",
        name_, what, found, wanted));
  }

  [[noreturn]] void no_frame() const {
    if (!is_device_)
      throw DeviceError(fmt::format(
          "camera: {} ends after {} frames, and another one was asked for.", name_, grabbed_));
    std::error_code unreadable;
    if (!fs::exists(name_, unreadable))
      throw LineError(fmt::format("camera: {} is gone. Check its cable.", name_));
    throw TimeoutError(fmt::format("camera: {} gave no frame", name_));
  }

  [[noreturn]] void damaged_frame() const {
    if (is_device_) throw TimeoutError(fmt::format("camera: {} gave a damaged frame", name_));
    throw DeviceError(
        fmt::format("camera: frame {} of {} cannot be decoded.", grabbed_ - 1, name_));
  }

  CameraConfig config_;
  Clock* clock_;
  SystemClock wall_;  ///< a device keeps real time whatever the rig's clock does
  std::string name_, card_;
  bool is_device_ = false;
  int stale_ = 0;
  Time interval_{0};  ///< between frames; 0 for files
  cv::VideoCapture capture_;
  std::uint64_t grabbed_ = 0;
};

}  // namespace

bool grab_after_now(const std::function<bool()>& grab, const Clock& clock, int stale,
                    Time interval) {
  const Time began = clock.now();
  for (int grabbed = 1;; ++grabbed) {
    const Time before = clock.now();
    if (!grab()) return false;
    const Time now = clock.now();
    const bool waited_for = now - before >= interval / 2 || grabbed > kDeepestBuffer;
    if (grabbed > stale && waited_for && now - began >= 2 * interval) return true;
  }
}

std::unique_ptr<Camera> open_usb_camera(CameraSetup setup) {
  return std::make_unique<UsbCamera>(std::move(setup));
}

std::vector<std::string> find_usb_cameras() {
  std::vector<std::pair<std::size_t, std::string>> found;  // video2 before video10
  std::error_code gone;
  for (const auto& entry : fs::directory_iterator("/dev", gone)) {
    const std::string device = entry.path().string();
    if (!device.starts_with("/dev/video")) continue;
    if (const auto card = capturing_card(device))
      found.emplace_back(device.size(), device + ": " + *card);
  }
  std::ranges::sort(found);
  std::vector<std::string> out;
  for (auto& [length, camera] : found) out.push_back(std::move(camera));
  return out;
}

}  // namespace turntable
