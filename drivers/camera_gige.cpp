#include "drivers/camera_gige.h"

#include <arv.h>
#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <fstream>
#include <optional>
#include <type_traits>

#include "drivers/genicam_frame.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"

namespace turntable {
namespace {

using RealClock = std::chrono::steady_clock;

constexpr int kBuffers = 4;
constexpr auto kSlice = std::chrono::milliseconds{20};  // of waits: then somebody may have pulled
                                                        // the plug, or want to stop
constexpr auto kAnswerTime = std::chrono::milliseconds{400};  // Aravis repeats commands after 500
constexpr double kSettingTolerance = 0.01;  // cameras count exposure in lines and gain in steps
constexpr double kClockDrift = 2e-4;        // of the camera's clock against ours

template <class T>
struct Unref {
  void operator()(T* object) const { g_object_unref(object); }
};
template <class T>
using Owned = std::unique_ptr<T, Unref<T>>;

/// Gives the buffer back to the stream. Its id is wiped: one whose first packet is lost would show
/// that of an earlier frame.
struct GiveBack {
  ArvStream* stream = nullptr;
  void operator()(ArvBuffer* buffer) const {
    arv_buffer_set_frame_id(buffer, 0);
    arv_stream_push_buffer(stream, buffer);
  }
};
using Lease = std::unique_ptr<ArvBuffer, GiveBack>;

std::string text(const char* s) { return s ? s : ""; }

std::string listed(const std::vector<FoundCamera>& cameras) {
  if (cameras.empty())
    return " No camera was found. Check power, cable, and that the camera's address is in the "
           "subnet of this computer's interface.";
  std::string all = " Found:";
  for (const FoundCamera& camera : cameras)
    all += fmt::format("\n  {}  ({} {}, serial {}, {} {})", camera.id, camera.vendor, camera.model,
                       camera.serial, camera.protocol, camera.address);
  return all;
}

std::string_view status_name(ArvBufferStatus status) {
  switch (status) {
    case ARV_BUFFER_STATUS_TIMEOUT:
    case ARV_BUFFER_STATUS_MISSING_PACKETS:
      return "packets were lost";
    case ARV_BUFFER_STATUS_WRONG_PACKET_ID:
      return "packets came with wrong numbers";
    case ARV_BUFFER_STATUS_SIZE_MISMATCH:
      return "it is larger than announced";
    case ARV_BUFFER_STATUS_ABORTED:
      return "the transfer was aborted";
    default:
      return "it is of a kind that is not supported";
  }
}

}  // namespace

std::vector<FoundCamera> find_gige_cameras() {
  arv_update_device_list();
  std::vector<FoundCamera> cameras;
  for (unsigned i = 0; i < arv_get_n_devices(); ++i)
    cameras.push_back({text(arv_get_device_id(i)), text(arv_get_device_vendor(i)),
                       text(arv_get_device_model(i)), text(arv_get_device_serial_nbr(i)),
                       text(arv_get_device_address(i)), text(arv_get_device_protocol(i))});
  return cameras;
}

class GigeCamera::Impl {
 public:
  explicit Impl(CameraSetup setup) : setup_(std::move(setup)), config_(setup_.config) {}

  ~Impl() {
    // To a camera that is gone every command waits for its retries.
    if (acquiring_ && !*control_lost_) arv_camera_stop_acquisition(camera_.get(), nullptr);
  }

  void open() {
    connect();
    arv_camera_stop_acquisition(camera_.get(), nullptr);  // of a program that did not end well
    // A camera keeps its registers: whatever matters is set, always.
    set_pixel_format();
    set_region();
    set_exposure();
    set_trigger();
    start();
    if (by_software()) warm_up();
  }

  std::string identity() const {
    return fmt::format("{}, {}", name_,
                       bits_ == 8 ? "Mono8"
                                  : fmt::format("{} used as 8 bit: the upper eight of its {} bits",
                                                config_.pixel_format, bits_));
  }

  ImageSize image_size() const { return config_.image_size; }
  const GigeStatistics& statistics() const { return statistics_; }

  Frame trigger() {
    discard_queued();
    Frame frame;
    frame.timestamp = setup_.clock->now();
    for (int attempt = 0;; ++attempt) {
      const RealClock::time_point fired = RealClock::now();
      fire();
      const std::optional<Seen> seen = wait_for_answer(fired, &frame);
      if (!seen) throw TimeoutError(nothing_came());
      if (seen->status == ARV_BUFFER_STATUS_SUCCESS) return frame;
      if (seen->status == ARV_BUFFER_STATUS_SIZE_MISMATCH)
        throw DeviceError(
            fmt::format("camera {}: frame {} is larger than {} x {} px {}. Does "
                        "another program change its settings?",
                        name_, seen->id, config_.image_size.width, config_.image_size.height,
                        config_.pixel_format));
      if (!fires() || attempt >= config_.retries)
        throw TimeoutError(incomplete(attempt + 1, seen->status));
      ++statistics_.retriggered;
    }
  }

 private:
  struct Seen {
    ArvBufferStatus status;
    std::uint64_t id;
    std::uint64_t device_ns;  ///< on the camera's clock; 0 = not known
  };

  /// Calls an Aravis function, whose last argument is always the place for an error.
  template <class Function, class... Arguments>
  auto call(std::string_view feature, Function function, Arguments... arguments) {
    GError* error = nullptr;
    if constexpr (std::is_void_v<decltype(function(arguments..., &error))>) {
      function(arguments..., &error);
      check(feature, error);
    } else {
      const auto result = function(arguments..., &error);
      check(feature, error);
      return result;
    }
  }

  /// What one of Aravis' functions named `dup_available` lists.
  template <class Function>
  std::vector<std::string> names(std::string_view feature, Function function) {
    guint count = 0;
    const std::unique_ptr<const char*, decltype(&g_free)> list(
        call(feature, function, camera_.get(), &count), g_free);
    return {list.get(), list.get() + count};
  }

  void check(std::string_view feature, GError* error) const {
    if (!error) return;
    const std::string message = text(error->message);
    const bool gone =
        error->domain == ARV_DEVICE_ERROR &&
        (error->code == ARV_DEVICE_ERROR_TIMEOUT || error->code == ARV_DEVICE_ERROR_NOT_CONNECTED ||
         error->code == ARV_DEVICE_ERROR_TRANSFER_ERROR ||
         error->code == ARV_DEVICE_ERROR_NOT_CONTROLLER);
    g_error_free(error);
    if (gone) *control_lost_ = true;
    if (*control_lost_) throw lost(message);
    throw DeviceError(fmt::format("camera {}: {} was refused: {}.", name_, feature, message));
  }

  LineError lost(const std::string& detail) const {
    return LineError(fmt::format(
        "camera {}: control lost (unplugged, powered off, or taken by another program){}{}. Check "
        "cable and power, close other camera programs, and start again.",
        name_, detail.empty() ? "" : ": ", detail));
  }

  /// @throws DeviceError unless what was read back is what was wanted.
  template <class T>
  void compare(std::string_view feature, const T& wanted, const T& found) const {
    if (found != wanted)
      throw DeviceError(fmt::format(
          "camera {}: {} reads {} after it was set to {}. Correct the rig file, or the camera's "
          "other settings.",
          name_, feature, found, wanted));
  }

  void compare_roughly(std::string_view feature, std::string_view key, double wanted,
                       double found) const {
    if (std::abs(found - wanted) > kSettingTolerance * std::max(std::abs(wanted), 1.0))
      throw DeviceError(fmt::format(
          "camera {}: {} reads {:g} after it was set to {:g}, allowed: within 1 %. State a value "
          "that the camera has as {}.",
          name_, feature, found, wanted, key));
  }

  void connect() {
    std::string device = config_.device;
    if (device.empty()) {
      const std::vector<FoundCamera> cameras = find_gige_cameras();
      if (cameras.size() != 1)
        throw DeviceError(
            "camera: no \"device\" is named, allowed: if exactly one camera is found." +
            listed(cameras));
      device = cameras.front().id;
    }
    GError* error = nullptr;
    camera_.reset(arv_camera_new(device.c_str(), &error));
    if (!camera_) {
      const std::string message = error ? text(error->message) : "it is unknown";
      g_clear_error(&error);
      throw DeviceError(fmt::format("camera: \"{}\" cannot be opened: {}. Name an id or address.{}",
                                    device, message, listed(find_gige_cameras())));
    }
    name_ = device;
    ArvDevice* arv_device = arv_camera_get_device(camera_.get());
    if (ARV_IS_GV_DEVICE(arv_device) && !arv_gv_device_is_controller(ARV_GV_DEVICE(arv_device)))
      throw DeviceError(
          fmt::format("camera {}: is controlled by another program. Close that program.", device));
    // The signal comes on a thread of Aravis, perhaps while this object goes away: the flag stays.
    g_signal_connect_data(
        arv_device, "control-lost",
        G_CALLBACK(+[](ArvDevice*, std::shared_ptr<std::atomic<bool>>* flag) { **flag = true; }),
        new std::shared_ptr<std::atomic<bool>>(control_lost_),
        +[](gpointer flag, GClosure*) {
          delete static_cast<std::shared_ptr<std::atomic<bool>>*>(flag);
        },
        GConnectFlags{});
    name_ = fmt::format(
        "{} {}, serial {}, {}", call("vendor", arv_camera_get_vendor_name, camera_.get()),
        call("model", arv_camera_get_model_name, camera_.get()), serial_number(), device);
  }

  std::string serial_number() {
    GError* error = nullptr;
    const std::string serial = text(arv_camera_get_device_serial_number(camera_.get(), &error));
    g_clear_error(&error);
    return serial.empty() ? "unknown" : serial;
  }

  void set_pixel_format() {
    const std::vector<std::string> offered =
        names("PixelFormat", arv_camera_dup_available_pixel_formats_as_strings);
    if (std::ranges::find(offered, config_.pixel_format) == offered.end())
      throw DeviceError(fmt::format(
          "camera {}: found pixel_format {}, allowed: what the camera offers ({}) and this program "
          "reads (Mono8, Mono10, Mono12, Mono16).",
          name_, config_.pixel_format, fmt::join(offered, ", ")));
    call("PixelFormat", arv_camera_set_pixel_format_from_string, camera_.get(),
         config_.pixel_format.c_str());
    compare("PixelFormat", config_.pixel_format,
            text(call("PixelFormat", arv_camera_get_pixel_format_as_string, camera_.get())));
    bits_ = significant_bits(config_.pixel_format);
    format_ = call("PixelFormat", arv_camera_get_pixel_format, camera_.get());
  }

  void set_region() {
    ArvCamera* camera = camera_.get();
    if (call("Binning", arv_camera_is_binning_available, camera))
      call("Binning", arv_camera_set_binning, camera, 1, 1);
    const auto [x, y] = config_.offset_px;
    const auto [width, height] = config_.image_size;
    const bool has_offset = call("OffsetX", arv_camera_is_region_offset_available, camera);
    // The bounds of the size depend on the offset.
    if (has_offset) call("OffsetX", arv_camera_set_region, camera, 0, 0, -1, -1);
    check_extent("width", x, width, arv_camera_get_width_bounds, arv_camera_get_width_increment);
    check_extent("height", y, height, arv_camera_get_height_bounds,
                 arv_camera_get_height_increment);
    call("region", arv_camera_set_region, camera, has_offset ? x : -1, has_offset ? y : -1, width,
         height);
    gint found_x = 0, found_y = 0, found_width = 0, found_height = 0;
    call("region", arv_camera_get_region, camera, &found_x, &found_y, &found_width, &found_height);
    compare("OffsetX", x, found_x);
    compare("OffsetY", y, found_y);
    compare("Width", width, found_width);
    compare("Height", height, found_height);
  }

  template <class Bounds, class Increment>
  void check_extent(std::string_view what, int offset, int extent, Bounds bounds,
                    Increment increment) {
    gint least = 0, most = 0;
    call(what, bounds, camera_.get(), &least, &most);
    const gint step = std::max(1, call(what, increment, camera_.get()));
    if (extent < least || offset + extent > most || (extent - least) % step != 0)
      throw DeviceError(fmt::format(
          "camera {}: found a region of {} {} px from {} px, allowed: {} to {} px in steps of {}, "
          "offset included. Correct image_size_px or offset_px.",
          name_, what, extent, offset, least, most, step));
  }

  void set_exposure() {
    ArvCamera* camera = camera_.get();
    if (config_.exposure_us) {
      if (call("ExposureAuto", arv_camera_is_exposure_auto_available, camera))
        call("ExposureAuto", arv_camera_set_exposure_time_auto, camera, ARV_AUTO_OFF);
      double least = 0, most = 0;
      call("ExposureTime", arv_camera_get_exposure_time_bounds, camera, &least, &most);
      if (*config_.exposure_us < least || *config_.exposure_us > most)
        throw DeviceError(
            fmt::format("camera {}: found exposure_us {:g}, allowed: {:g} to {:g} us.", name_,
                        *config_.exposure_us, least, most));
      call("ExposureTime", arv_camera_set_exposure_time, camera, *config_.exposure_us);
      compare_roughly("ExposureTime", "exposure_us", *config_.exposure_us,
                      call("ExposureTime", arv_camera_get_exposure_time, camera));
    }
    if (config_.gain) {
      if (call("GainAuto", arv_camera_is_gain_auto_available, camera))
        call("GainAuto", arv_camera_set_gain_auto, camera, ARV_AUTO_OFF);
      call("Gain", arv_camera_set_gain, camera, *config_.gain);
      compare_roughly("Gain", "gain", *config_.gain, call("Gain", arv_camera_get_gain, camera));
    }
  }

  bool by_software() const { return config_.trigger.source == TriggerConfig::Source::kSoftware; }
  /// Whether it is this program that starts exposures.
  bool fires() const { return by_software() || setup_.fire; }

  void set_trigger() {
    ArvCamera* camera = camera_.get();
    call("AcquisitionMode", arv_camera_set_acquisition_mode, camera,
         ARV_ACQUISITION_MODE_CONTINUOUS);
    const std::string source = by_software() ? "Software" : config_.trigger.line;
    const std::vector<std::string> offered =
        names("TriggerSource", arv_camera_dup_available_trigger_sources);
    if (std::ranges::find(offered, source) == offered.end())
      throw DeviceError(fmt::format("camera {}: found trigger source {}, allowed: {}.", name_,
                                    source, fmt::join(offered, ", ")));
    // Switches all other triggers off, and takes FrameStart on a rising edge.
    call("TriggerSource", arv_camera_set_trigger, camera, source.c_str());
    if (!by_software()) {
      const std::string edge = config_.trigger.rising ? "RisingEdge" : "FallingEdge";
      call("TriggerActivation", arv_camera_set_string, camera, "TriggerActivation", edge.c_str());
      compare_string("TriggerActivation", edge);
    }
    compare_string("TriggerSelector", "FrameStart");
    compare_string("TriggerMode", "On");
    compare_string("TriggerSource", source);
  }

  void compare_string(const char* feature, const std::string& wanted) {
    compare(feature, wanted, text(call(feature, arv_camera_get_string, camera_.get(), feature)));
  }

  void start() {
    ArvCamera* camera = camera_.get();
    if (arv_camera_is_gv_device(camera)) prepare_network();
    stream_.reset(call("stream", arv_camera_create_stream, camera, nullptr, nullptr));
    const guint payload = call("PayloadSize", arv_camera_get_payload, camera);
    // The kernel's default of 208 KiB, its own overhead included, holds less than one frame of most
    // cameras. Aravis enlarges it when the first packet of a frame has come, too late for that
    // frame: see `warm_up`. (Its AUTO asks for one payload, which makes the default smaller if
    // frames are small.)
    if (ARV_IS_GV_STREAM(stream_.get()))
      g_object_set(stream_.get(), "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED,
                   "socket-buffer-size", static_cast<gint>(std::min(2 * payload, 1u << 30)),
                   nullptr);
    for (int i = 0; i < kBuffers; ++i)
      arv_stream_push_buffer(stream_.get(), arv_buffer_new(payload, nullptr));
    call("AcquisitionStart", arv_camera_start_acquisition, camera);
    acquiring_ = true;
  }

  void prepare_network() {
    ArvCamera* camera = camera_.get();
    GSocketAddress* address =
        arv_gv_device_get_device_address(ARV_GV_DEVICE(arv_camera_get_device(camera)));
    // Packet sockets, which root would use, see nothing on loopback.
    if (g_inet_address_get_is_loopback(
            g_inet_socket_address_get_address(G_INET_SOCKET_ADDRESS(address))))
      arv_camera_gv_set_stream_options(camera, ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
    arv_camera_gv_set_packet_size_adjustment(camera, ARV_GV_PACKET_SIZE_ADJUSTMENT_NEVER);
    if (config_.packet_bytes == 0) {
      call("packet size", arv_camera_gv_auto_packet_size, camera);
    } else {
      call("packet size", arv_camera_gv_set_packet_size, camera, config_.packet_bytes);
      compare("packet size", static_cast<guint>(config_.packet_bytes),
              call("packet size", arv_camera_gv_get_packet_size, camera));
    }
  }

  /// The first frame that does not fit the default socket buffer is lost, so that nobody waits for
  /// it. What becomes of it does not matter.
  void warm_up() {
    const RealClock::time_point fired = RealClock::now();
    fire();
    wait_for_answer(fired, nullptr);
    statistics_ = {};
  }

  void fire() {
    const RealClock::time_point began = RealClock::now();
    if (by_software())
      call("TriggerSoftware", arv_camera_software_trigger, camera_.get());
    else if (setup_.fire)
      setup_.fire();
    repeated_ = by_software() && RealClock::now() - began > kAnswerTime;
    ++unanswered_;
  }

  /// Frames that came since the last trigger: none of them answers the next.
  void discard_queued() {
    while (const Lease buffer = pop(RealClock::time_point::min()))
      if (account(buffer.get()).status == ARV_BUFFER_STATUS_SUCCESS) ++statistics_.stale;
  }

  /// The frame that answers the trigger, or the incomplete one; nothing at the deadline. A complete
  /// one goes to `frame`, if there is one.
  std::optional<Seen> wait_for_answer(RealClock::time_point fired, Frame* frame) {
    const auto deadline =
        RealClock::now() + std::chrono::duration_cast<RealClock::duration>(
                               std::chrono::duration<double>(config_.frame_timeout_s));
    while (const Lease buffer = pop(deadline)) {
      const bool others_are_due = unanswered_ > 1;
      const Seen seen = account(buffer.get());
      if (seen.status != ARV_BUFFER_STATUS_SUCCESS) {
        if (others_are_due) continue;  // whose it was is not known: ours may still come
        return seen;
      }
      if (others_are_due && exposed_before(fired, seen)) {
        ++statistics_.stale;
        continue;
      }
      unanswered_ = repeated_ ? 1 : 0;
      last_device_ns_ = seen.device_ns;
      last_arrival_ = RealClock::now();
      if (frame) {
        frame->image = image_of(buffer.get(), seen.id);
        frame->id = seen.id;
        ++statistics_.delivered;
      }
      return seen;
    }
    return std::nullopt;
  }

  /// Whether a frame answers an earlier trigger, whose wait had ended before it came. Both clocks
  /// go on alike, and the last frame was exposed before it arrived: that bounds from above when
  /// this one was exposed on our clock.
  bool exposed_before(RealClock::time_point fired, const Seen& seen) const {
    if (last_device_ns_ == 0 || seen.device_ns <= last_device_ns_) return false;
    const double since_s = 1e-9 * static_cast<double>(seen.device_ns - last_device_ns_);
    const double latest_s = since_s * (1 + kClockDrift);
    return latest_s < std::chrono::duration<double>(fired - last_arrival_).count();
  }

  /// Waits in real time. At the deadline, what is there is still taken.
  Lease pop(RealClock::time_point deadline) {
    for (;;) {
      throw_if_stopping_now();
      if (*control_lost_) throw lost("");
      const auto left =
          std::chrono::duration_cast<std::chrono::microseconds>(std::min<RealClock::duration>(
              kSlice, deadline > RealClock::now() ? deadline - RealClock::now()
                                                  : RealClock::duration::zero()));
      ArvBuffer* buffer = left.count() > 0 ? arv_stream_timeout_pop_buffer(
                                                 stream_.get(), static_cast<guint64>(left.count()))
                                           : arv_stream_try_pop_buffer(stream_.get());
      if (buffer || left.count() <= 0) return Lease(buffer, GiveBack{stream_.get()});
    }
  }

  /// Every buffer that comes out of the stream passes here, once and in order.
  Seen account(ArvBuffer* buffer) {
    const ArvBufferStatus status = arv_buffer_get_status(buffer);
    const std::uint64_t raw = arv_buffer_get_frame_id(buffer);
    const bool complete = status == ARV_BUFFER_STATUS_SUCCESS;
    if (!complete) ++statistics_.incomplete;
    std::uint64_t steps = 1;
    if (!complete && raw == 0) {
      ++nameless_;
    } else {
      const std::uint64_t before = ids_.current();
      const std::optional<std::uint64_t> advanced = ids_.advance(raw);
      if (!advanced)
        throw DeviceError(
            fmt::format("camera {}: frame id {} came after {}: the camera has started anew.", name_,
                        raw, before));
      steps = *advanced - std::min(*advanced - 1, nameless_);
      statistics_.missing += steps - 1;
      nameless_ = 0;
    }
    unanswered_ -= std::min(unanswered_, steps);
    const std::uint64_t device_ns = complete ? arv_buffer_get_timestamp(buffer) : 0;
    if (device_ns != 0) {
      if (device_ns <= newest_device_ns_)
        throw DeviceError(fmt::format(
            "camera {}: frame {} is stamped {} ns by the camera, allowed: later than {} ns, which "
            "the frame before it has. Was its clock set?",
            name_, ids_.current(), device_ns, newest_device_ns_));
      newest_device_ns_ = device_ns;
    }
    return {status, ids_.current(), device_ns};
  }

  Image image_of(ArvBuffer* buffer, std::uint64_t id) const {
    const ImageSize found{arv_buffer_get_image_width(buffer), arv_buffer_get_image_height(buffer)};
    const ImageSize wanted = config_.image_size;
    const ArvPixelFormat format = arv_buffer_get_image_pixel_format(buffer);
    if (found != wanted || format != format_)
      throw DeviceError(fmt::format(
          "camera {}: frame {} has {} x {} px of pixel format {:#x}, allowed: {} x {} px of {:#x} "
          "({}), as it was set up. Does another program change its settings?",
          name_, id, found.width, found.height, format, wanted.width, wanted.height, format_,
          config_.pixel_format));
    gint padding_x = 0, padding_y = 0;
    arv_buffer_get_image_padding(buffer, &padding_x, &padding_y);
    const auto width = static_cast<std::size_t>(wanted.width);
    const std::size_t stride = width * (bits_ > 8 ? 2 : 1) + static_cast<std::size_t>(padding_x);
    std::size_t size = 0;
    const auto* data = static_cast<const std::uint8_t*>(arv_buffer_get_image_data(buffer, &size));
    if (size < stride * static_cast<std::size_t>(wanted.height))
      throw DeviceError(fmt::format("camera {}: frame {} has {} bytes, allowed: {}.", name_, id,
                                    size, stride * static_cast<std::size_t>(wanted.height)));
    return top_8_bits(data, wanted, stride, bits_);
  }

  std::string losses() const {
    guint64 resent = 0, lost_packets = 0;
    if (ARV_IS_GV_STREAM(stream_.get()))
      arv_gv_stream_get_statistics(ARV_GV_STREAM(stream_.get()), &resent, &lost_packets);
    return fmt::format("Lost since opening: {} packets, {} frames incomplete, {} missing.",
                       lost_packets, statistics_.incomplete, statistics_.missing);
  }

  std::string nothing_came() const {
    const std::string remedy =
        by_software()
            ? "Check the exposure time and the cable"
            : fmt::format("Check the wiring of {}, its activation ({} edge){}",
                          config_.trigger.line, config_.trigger.rising ? "rising" : "falling",
                          fires() ? ", the controller's output and the cable" : " and the cable");
    return fmt::format("camera {}: no frame within {:.1f} s of the trigger. {}. {}", name_,
                       config_.frame_timeout_s, remedy, losses());
  }

  std::string incomplete(int frames, ArvBufferStatus status) const {
    return fmt::format(
        "camera {}: {} frame{} of this trigger came incomplete ({}). Check cable and network "
        "load, or lower packet_bytes{}. {}",
        name_, frames, frames == 1 ? "" : "s", status_name(status), buffer_advice(), losses());
  }

  /// A burst of packets that no socket buffer holds is lost before anybody reads it.
  std::string buffer_advice() const {
    const std::size_t frame = static_cast<std::size_t>(config_.image_size.width) *
                              static_cast<std::size_t>(config_.image_size.height);
    std::size_t most = 0;
    if (!(std::ifstream("/proc/sys/net/core/rmem_max") >> most) || most >= 2 * frame) return {};
    return fmt::format(
        "; the system lets a socket buffer {} bytes and a frame has {}: allow more with "
        "\"sysctl -w net.core.rmem_max={}\"",
        most, frame, 4 * frame);
  }

  CameraSetup setup_;
  const CameraConfig& config_;
  std::shared_ptr<std::atomic<bool>> control_lost_ = std::make_shared<std::atomic<bool>>(false);
  std::string name_;
  Owned<ArvCamera> camera_;
  Owned<ArvStream> stream_;  // goes before the camera
  bool acquiring_ = false;
  int bits_ = 8;
  ArvPixelFormat format_ = 0;

  FrameIds ids_;
  GigeStatistics statistics_;
  std::uint64_t nameless_ = 0;    // incomplete frames whose id is lost, since the last id
  std::uint64_t unanswered_ = 0;  // triggers whose frame has not been seen
  bool repeated_ = false;         // the last command may have been heard twice: two frames
  std::uint64_t newest_device_ns_ = 0;
  std::uint64_t last_device_ns_ = 0;    // of the last frame that answered a trigger,
  RealClock::time_point last_arrival_;  // and when it was here
};

GigeCamera::GigeCamera(CameraSetup setup) : impl_(std::make_unique<Impl>(std::move(setup))) {
  impl_->open();
}
GigeCamera::~GigeCamera() = default;
std::string GigeCamera::identity() const { return impl_->identity(); }
ImageSize GigeCamera::image_size() const { return impl_->image_size(); }
Frame GigeCamera::trigger() { return impl_->trigger(); }
GigeStatistics GigeCamera::statistics() const { return impl_->statistics(); }

std::unique_ptr<Camera> open_gige_camera(CameraSetup setup) {
  return std::make_unique<GigeCamera>(std::move(setup));
}

}  // namespace turntable
