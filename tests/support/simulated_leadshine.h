// A bus of Leadshine drives and its driver, joined by a socketpair under a manual clock.
#pragma once

#include <algorithm>
#include <memory>

#include "drivers/catalog.h"
#include "drivers/sim/leadshine.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/wire_record.h"

namespace turntable {

/// Stage, yaw, roll and pitch at the addresses 1 to 4.
inline std::vector<AxisConfig> bus_axes() {
  return {linear_axis("1"), rotary_axis(AxisId::kYaw, "2"), rotary_axis(AxisId::kRoll, "3"),
          rotary_axis(AxisId::kPitch, "4")};
}

struct SimulatedLeadshine {
  struct Options {
    bool gateway = false;
    std::vector<AxisConfig> axes = bus_axes();
    std::vector<AxisConfig> real{};  ///< how the drives are set up; by default like the rig file
    std::vector<OutputConfig> outputs{};
    sim::LeadshineGuesses guesses{};
  };

  SimulatedLeadshine() : SimulatedLeadshine(Options{}) {}
  explicit SimulatedLeadshine(Options options) : axes(options.axes) {
    config.name = "bus";
    config.model = "leadshine-pr";
    config.line.kind =
        options.gateway ? LineConfig::Kind::kModbusTcp : LineConfig::Kind::kSimulated;
    config.outputs = options.outputs;
    simulator = sim::simulate_leadshine(
        {options.real.empty() ? axes : options.real, {}, draws_of_this_test()(), config},
        options.guesses);
    simulator->note_requests();
    clock.attach(*simulator);
    reconnect();
  }
  ~SimulatedLeadshine() {
    controller.reset();
    clock.detach(*simulator);
  }

  /// The cable is plugged in again, and a fresh driver opened.
  void reconnect() {
    controller.reset();
    auto [near, far] = line_pair("bus line");
    near.set_log(wire.log());
    simulator->plug(std::move(far));
    controller = open_controller({config, axes, std::move(near), &clock});
  }

  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Axis<Degrees>& roll() { return *controller->rotary_axis(AxisId::kRoll); }
  Axis<Degrees>& pitch() { return *controller->rotary_axis(AxisId::kPitch); }
  Axis<Millimetres>& stage() { return *controller->linear_axis(AxisId::kStage); }
  double truth(AxisId id) const { return simulator->axis(id).true_position(clock.now()); }
  double counter(AxisId id) const { return simulator->axis(id).counter_position(clock.now()); }
  bool moving(AxisId id) const { return simulator->axis(id).moving(clock.now()); }
  void fault(sim::Fault f) { simulator->add_fault(std::move(f)); }
  /// Requests of this kind or with this verb since `mark`.
  std::ptrdiff_t said(const std::string& word) const {
    return std::count_if(simulator->requests().begin() + static_cast<std::ptrdiff_t>(mark_),
                         simulator->requests().end(), [&](const auto& request) {
                           return request.kind == word || request.verb == word;
                         });
  }
  void mark() { mark_ = simulator->requests().size(); }

  /// Connected and yaw homed.
  void ready() {
    controller->connect();
    yaw().home();
    mark();
  }
  template <class Q>
  Arrival<Q> move(Axis<Q>& axis, double to) {
    axis.start(Q{to});
    while (!axis.advance()) {
    }
    return axis.arrival();
  }

  std::vector<AxisConfig> axes;
  ControllerConfig config;
  ManualClock clock;
  WireRecord wire;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<Controller> controller;

 private:
  std::size_t mark_ = 0;
};

}  // namespace turntable
