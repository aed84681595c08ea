// Any controller of the catalogue with its simulator, joined by any kind of line, under a manual
// clock: the same hours pass in the same milliseconds over a socketpair, a pty or TCP.
#pragma once

#include <sys/ioctl.h>

#include <atomic>
#include <map>
#include <memory>
#include <stdexcept>

#include "drivers/catalog.h"
#include "drivers/sim/catalog.h"
#include "protocols/serial.h"
#include "protocols/tcp.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/wire_record.h"

namespace turntable {

enum class Transport { kSocketPair, kPty, kTcp };
inline constexpr std::array kAllTransports{Transport::kSocketPair, Transport::kPty,
                                           Transport::kTcp};

inline std::string transport_name(Transport transport) {
  return transport == Transport::kSocketPair ? "socketpair"
         : transport == Transport::kPty      ? "pty"
                                             : "tcp";
}

/// A controller model, and what its manual leaves open.
struct ControllerVariant {
  std::string model;
  bool answers_while_moving = true;
  bool gateway = false;  ///< Modbus TCP

  std::string name() const {
    std::string text = model + (answers_while_moving ? "" : "_deaf") + (gateway ? "_gateway" : "");
    for (char& c : text) c = c == '-' ? '_' : c;
    return text;
  }
  /// Of a described controller: the one that has a simulator.
  std::string description() const { return model == "described" ? "zaber_ascii" : ""; }
  friend void PrintTo(const ControllerVariant& variant, std::ostream* out) {
    *out << variant.name();
  }
};

/// Every model of the catalogue, and its variants.
inline std::vector<ControllerVariant> all_controllers() {
  std::vector<ControllerVariant> all;
  for (const ControllerModel& row : controller_models()) {
    all.push_back({std::string(row.model)});
    if (row.model == "zolix-sc300") all.push_back({std::string(row.model), false});
    if (row.modbus) all.push_back({std::string(row.model), true, true});
  }
  return all;
}

/// Stage, yaw, roll and, where there is a fourth channel, pitch.
inline std::vector<AxisConfig> axes_of(const std::string& model) {
  static const std::map<std::string, std::vector<std::string>> kChannels{
      {"zolix-mc600", {"X", "Y", "Z", "T"}},
      {"zolix-zc300", {"X", "Y", "Z"}},
      {"zolix-sc300", {"X", "Y", "Z"}},
      {"leadshine-pr", {"1", "2", "3", "4"}},
      {"described", {"1 1", "1 2", "2 1", "2 2"}}};
  const auto channels = kChannels.find(model);
  if (channels == kChannels.end())
    throw std::runtime_error("tests/support/simulated_controller.h knows no channels of " + model);
  std::vector<AxisConfig> axes = four_axes();
  axes.resize(channels->second.size());
  for (std::size_t i = 0; i < axes.size(); ++i) {
    axes[i].channel = channels->second[i];
    axes[i].controller = "mc1";
  }
  return axes;
}

struct SimulatedController {
  /// @param real how the simulated controller is set up; by default like the rig file.
  /// @param recorded false: nothing is noted or counted, for benchmarks on a socketpair.
  explicit SimulatedController(const ControllerVariant& variant,
                               Transport transport = Transport::kSocketPair,
                               std::vector<AxisConfig> real = {},
                               std::map<AxisId, AxisTruth> truth = {}, std::uint64_t seed = 1,
                               bool recorded = true)
      : transport_(transport), axes(axes_of(variant.model)), recorded_(recorded) {
    config.name = "mc1";
    config.model = variant.model;
    config.answers_while_moving = variant.answers_while_moving;
    config.description = variant.description();
    if (variant.gateway) config.line.kind = LineConfig::Kind::kModbusTcp;
    sim::SimulatorSetup setup{real.empty() ? axes : real, std::move(truth), seed, config};
    simulator = sim::simulate_controller(variant.model, setup);
    if (recorded_) simulator->note_requests();
    clock.attach(*simulator);
    clock.set_in_flight([this] { return in_flight(); });
    reconnect();
  }
  ~SimulatedController() {
    controller.reset();
    clock.detach(*simulator);
  }

  /// A new line and a new driver on the same controller.
  void reconnect() {
    controller.reset();
    simulator->unplug();
    near_sent = near_received = far_sent = far_received = 0;
    auto [near, far] = ends();
    near_descriptor_ = near.descriptor();
    if (recorded_)
      near.set_log([this, record = wire.log()](Direction d, std::string_view bytes, Time t) {
        (d == Direction::kSent ? near_sent : near_received) += bytes.size();
        record(d, bytes, t);
      });
    if (recorded_)
      far.set_log([this](Direction d, std::string_view bytes, Time) {
        (d == Direction::kSent ? far_sent : far_received) += bytes.size();
      });
    simulator->plug(std::move(far));
    controller = open_controller({config, axes, std::move(near), &clock});
  }

  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Axis<Degrees>& roll() { return *controller->rotary_axis(AxisId::kRoll); }
  Axis<Millimetres>& stage() { return *controller->linear_axis(AxisId::kStage); }
  const sim::AxisModel& model(AxisId id) const { return simulator->axis(id); }
  double truth(AxisId id) const { return model(id).true_position(clock.now()); }
  bool anything_moves() const {
    return std::ranges::any_of(
        axes, [this](const AxisConfig& axis) { return model(axis.id).moving(clock.now()); });
  }
  void fault(sim::Fault f) { simulator->add_fault(std::move(f)); }
  std::size_t requests(std::string_view kind) const {
    return static_cast<std::size_t>(
        std::ranges::count(simulator->requests(), kind, &sim::ControllerSimulator::Request::kind));
  }

  /// Connected, stage, yaw and roll homed.
  void ready() {
    controller->connect();
    stage().home();
    yaw().home();
    roll().home();
  }
  template <class Q>
  static Arrival<Q> move(Axis<Q>& axis, double to) {
    axis.start(Q{to});
    while (!axis.advance()) {
    }
    return axis.arrival();
  }

  Transport transport_;
  std::vector<AxisConfig> axes;
  ControllerConfig config;
  ManualClock clock;
  WireRecord wire;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<Controller> controller;
  std::atomic<std::size_t> near_sent{0}, near_received{0}, far_sent{0}, far_received{0};

 private:
  std::pair<Line, Line> ends() {
    if (transport_ == Transport::kSocketPair) return line_pair("line");
    if (transport_ == Transport::kPty) {
      Pty pty = make_pty();
      Line near = open_serial(pty.path, 19200);
      return {std::move(near), std::move(pty.master)};
    }
    TcpListener listener(0);
    Line near = open_tcp("127.0.0.1", listener.port(), std::chrono::seconds{5});
    for (;;)
      if (auto far = listener.accept()) return {std::move(near), std::move(*far)};
  }
  /// Bytes that one side has written and the other does not have yet.
  bool in_flight() const {
    if (transport_ == Transport::kSocketPair || !simulator->plugged() || !controller) return false;
    int waiting = 0;
    ::ioctl(near_descriptor_, FIONREAD, &waiting);
    return near_sent != far_received ||
           near_received + static_cast<std::size_t>(waiting) != far_sent;
  }
  int near_descriptor_ = -1;
  bool recorded_;
};

}  // namespace turntable
