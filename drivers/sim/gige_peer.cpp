#include "drivers/sim/gige_peer.h"

#include <arpa/inet.h>
#include <arv.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <mutex>
#include <thread>

#include "src/core/errors.h"

namespace turntable::sim {
namespace {

constexpr const char* kAddress = "127.0.0.1";
constexpr std::uint16_t kControlPort = 3956;  // GVCP
constexpr double kTriggerLooksPerS = 500;     // how often the fake camera looks for a trigger
constexpr auto kEdgeTimeout = std::chrono::seconds{1};
constexpr guint32 kLongestExposure_us = 10'000'000;

// Register values, from the fake camera's GenICam description.
constexpr guint32 kOn = 1;
constexpr guint32 kLine0 = 0;
constexpr guint32 kSoftware = 1;

/// The fake camera does not say that somebody else has the port.
bool port_is_free() {
  const int fd = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(kControlPort);
  ::inet_pton(AF_INET, kAddress, &address.sin_addr);
  const bool free = ::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  ::close(fd);
  return free;
}

struct Unref {
  void operator()(ArvGvFakeCamera* camera) const { g_object_unref(camera); }
};

}  // namespace

class GigePeer::Impl {
 public:
  Impl(Expose expose, ImageSize sensor, const GigePeerOptions& options)
      : expose_(std::move(expose)), serial_(options.serial) {
    if (!port_is_free())
      throw LineError(fmt::format(
          "simulated camera: UDP port {} of {} is taken: another camera is served on this "
          "computer. End that program; there can be one only.",
          kControlPort, kAddress));
    server_.reset(ARV_GV_FAKE_CAMERA(g_object_new(
        ARV_TYPE_GV_FAKE_CAMERA, "interface-name", kAddress, "serial-number", serial_.c_str(),
        "gvsp-lost-ratio", options.lost_packets_per_1000 / 1000.0, nullptr)));
    if (!arv_gv_fake_camera_is_running(server_.get()))
      throw LineError(
          fmt::format("simulated camera: cannot be served on {}: is loopback up?", kAddress));
    camera_ = arv_gv_fake_camera_get_fake_camera(server_.get());
    const auto width = static_cast<guint32>(sensor.width);
    const auto height = static_cast<guint32>(sensor.height);
    write(ARV_FAKE_CAMERA_REGISTER_SENSOR_WIDTH, width);
    write(ARV_FAKE_CAMERA_REGISTER_SENSOR_HEIGHT, height);
    write(ARV_FAKE_CAMERA_REGISTER_WIDTH, width);
    write(ARV_FAKE_CAMERA_REGISTER_HEIGHT, height);
    arv_fake_camera_set_trigger_frequency(camera_, kTriggerLooksPerS);
    arv_fake_camera_set_fill_pattern(
        camera_,
        [](ArvBuffer* buffer, void* self, guint32, guint32, ArvPixelFormat format) noexcept {
          static_cast<Impl*>(self)->fill(buffer, format);
        },
        this);
  }

  std::string id() const { return "Aravis-Fake-" + serial_; }
  std::uint64_t exposures() const { return exposures_; }

  void hardware_trigger() {
    const std::lock_guard one_edge_at_a_time(edges_);
    std::unique_lock lock(mutex_);
    // Not armed, so the edge is lost, as on the device.
    if (!server_ || read(ARV_FAKE_CAMERA_REGISTER_ACQUISITION) == 0 ||
        read(ARV_FAKE_CAMERA_REGISTER_TRIGGER_MODE) != kOn ||
        read(ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOURCE) != kLine0)
      return;
    // The fake camera does not act on lines. For one exposure it is told that software triggers it.
    edge_ = Edge::kPending;
    write(ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOFTWARE, 1);
    write(ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOURCE, kSoftware);
    edge_changed_.wait_for(lock, kEdgeTimeout, [&] { return edge_ != Edge::kPending; });
    if (edge_ == Edge::kPending) {  // the client has just stopped it
      write(ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOFTWARE, 0);
      write(ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOURCE, kLine0);
      edge_ = Edge::kNone;
    }
    edge_changed_.wait_for(lock, std::chrono::seconds{10}, [&] { return edge_ == Edge::kNone; });
  }

  void kill() {
    const std::lock_guard no_edge(edges_);
    server_.reset();  // waits for its thread, which `fill` may be on
  }

 private:
  guint32 read(guint32 address) const {
    guint32 value = 0;
    arv_fake_camera_read_register(camera_, address, &value);
    return value;
  }
  void write(guint32 address, guint32 value) {
    arv_fake_camera_write_register(camera_, address, value);
  }

  void fill(ArvBuffer* buffer, ArvPixelFormat format) {
    const Image sensor = expose();
    // The buffer says 0 bytes here, since it has not been filled.
    std::size_t none = 0;
    auto* pixels =
        static_cast<std::uint8_t*>(const_cast<void*>(arv_buffer_get_data(buffer, &none)));
    std::fill_n(pixels, arv_fake_camera_get_payload(camera_), std::uint8_t{0});
    const bool mono16 = format == ARV_PIXEL_FORMAT_MONO_16;
    if (!mono16 && format != ARV_PIXEL_FORMAT_MONO_8) return;  // colours of a grey world: black
    const int width = arv_buffer_get_image_width(buffer);
    const int height = arv_buffer_get_image_height(buffer);
    const int x = arv_buffer_get_image_x(buffer);
    const int y = arv_buffer_get_image_y(buffer);
    const ImageView view = sensor;
    for (int v = 0; v < std::min(height, view.height - y); ++v)
      for (int u = 0; u < std::min(width, view.width - x); ++u) {
        const auto at = static_cast<std::size_t>(v) * static_cast<std::size_t>(width) +
                        static_cast<std::size_t>(u);
        pixels[mono16 ? 2 * at + 1 : at] = view.row(v + y)[u + x];  // little-endian: grey << 8
      }
  }

  Image expose() {
    std::unique_lock lock(mutex_);
    const bool by_edge = edge_ == Edge::kPending;
    if (by_edge) {
      write(ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOURCE, kLine0);
      edge_ = Edge::kTaken;
      edge_changed_.notify_all();
    }
    lock.unlock();
    Image sensor = expose_(exposures_++);
    std::this_thread::sleep_for(std::chrono::microseconds{
        std::min(read(ARV_FAKE_CAMERA_REGISTER_EXPOSURE_TIME_US), kLongestExposure_us)});
    // Who triggers during an exposure is not heard.
    if (!by_edge) write(ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOFTWARE, 0);
    if (by_edge) {
      lock.lock();
      edge_ = Edge::kNone;
      edge_changed_.notify_all();
    }
    return sensor;
  }

  Expose expose_;
  std::string serial_;
  std::atomic<std::uint64_t> exposures_{0};
  std::mutex edges_;
  std::mutex mutex_;
  std::condition_variable edge_changed_;
  enum class Edge { kNone, kPending, kTaken } edge_ = Edge::kNone;
  ArvFakeCamera* camera_ = nullptr;
  std::unique_ptr<ArvGvFakeCamera, Unref> server_;  // last: its thread ends before the rest
};

GigePeer::GigePeer(Expose expose, ImageSize sensor, GigePeerOptions options)
    : impl_(std::make_unique<Impl>(std::move(expose), sensor, options)) {}
GigePeer::~GigePeer() = default;
std::string GigePeer::address() const { return kAddress; }
std::string GigePeer::id() const { return impl_->id(); }
std::uint64_t GigePeer::exposures() const { return impl_->exposures(); }
void GigePeer::hardware_trigger() { impl_->hardware_trigger(); }
void GigePeer::kill() { impl_->kill(); }

}  // namespace turntable::sim
