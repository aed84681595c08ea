// A ZC300 driver and its simulator, joined by a socketpair under a manual clock.
#pragma once

#include <memory>

#include "drivers/catalog.h"
#include "drivers/sim/catalog.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/wire_record.h"

namespace turntable {

inline std::vector<AxisConfig> zc300_axes() {
  return {linear_axis("X"), rotary_axis(AxisId::kYaw, "Y"), rotary_axis(AxisId::kRoll, "Z")};
}

inline ControllerConfig zc300_config(LineConfig::Kind kind = LineConfig::Kind::kSimulated) {
  ControllerConfig config;
  config.name = "zc300";
  config.model = "zolix-zc300";
  config.line.kind = kind;
  return config;
}

struct SimulatedZc300 {
  struct Options {
    std::vector<AxisConfig> axes = zc300_axes();
    std::vector<AxisConfig> real{};  ///< how the simulated controller is set up; empty = the same
    std::map<AxisId, AxisTruth> truth{};
    ControllerConfig config = zc300_config();
    std::optional<double> reply_delay_s = 0.0;  ///< nothing = as slow as a real one
  };
  SimulatedZc300() : SimulatedZc300(Options{}) {}
  explicit SimulatedZc300(Options options) : axes(options.axes), config(options.config) {
    simulator = sim::simulate_controller("zolix-zc300",
                                         {options.real.empty() ? axes : options.real, options.truth,
                                          draws_of_this_test()(), config, options.reply_delay_s});
    simulator->note_requests();
    clock.attach(*simulator);
    plug();
  }
  ~SimulatedZc300() {
    controller.reset();
    clock.detach(*simulator);
  }
  SimulatedZc300(const SimulatedZc300&) = delete;
  SimulatedZc300& operator=(const SimulatedZc300&) = delete;

  /// A fresh driver on a fresh line to the same device.
  void plug() {
    auto [near, far] = line_pair("line to zc300");
    near.set_log(wire.log());
    simulator->plug(std::move(far));
    controller = open_controller({config, axes, std::move(near), &clock});
  }

  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Axis<Degrees>& roll() { return *controller->rotary_axis(AxisId::kRoll); }
  Axis<Millimetres>& stage() { return *controller->linear_axis(AxisId::kStage); }
  double truth(AxisId id) const { return simulator->axis(id).true_position(clock.now()); }
  double counter(AxisId id) const { return simulator->axis(id).counter_position(clock.now()); }
  void fault(sim::Fault f) { simulator->add_fault(std::move(f)); }
  /// How many requests of that kind or verb have reached the simulator.
  std::size_t count(const std::string& word) const {
    std::size_t n = 0;
    for (const auto& request : simulator->requests())
      if (request.kind == word || request.verb == word) ++n;
    return n;
  }

  /// Connected and yaw homed; what was said until then is forgotten.
  void ready() {
    controller->connect();
    yaw().home();
    wire.clear();
  }
  template <class Q>
  Arrival<Q> move(Axis<Q>& axis, double to) {
    axis.start(Q{to});
    while (!axis.advance()) {
    }
    return axis.arrival();
  }

  ManualClock clock;
  WireRecord wire;
  std::vector<AxisConfig> axes;
  ControllerConfig config;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<Controller> controller;
};

}  // namespace turntable
