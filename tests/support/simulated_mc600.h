// A controller's driver and its simulator, joined by a socketpair under a manual clock.
#pragma once

#include <memory>

#include "drivers/catalog.h"
#include "drivers/sim/catalog.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/wire_record.h"

namespace turntable {

struct SimulatedMc600 {
  /// @param real how the simulated controller is set up; by default like the rig file.
  explicit SimulatedMc600(std::vector<AxisConfig> axes = four_axes(),
                          std::vector<AxisConfig> real = {},
                          std::map<AxisId, AxisTruth> truth = {}) {
    simulator = sim::simulate_controller(
        "zolix-mc600", {real.empty() ? axes : real, truth, draws_of_this_test()()});
    auto [near, far] = line_pair("line to mc600");
    near.set_log(wire.log());
    simulator->plug(std::move(far));
    clock.attach(*simulator);
    ControllerConfig config;
    config.name = "mc600";
    config.model = "zolix-mc600";
    controller = open_controller({config, std::move(axes), std::move(near), &clock});
  }
  ~SimulatedMc600() {
    controller.reset();
    clock.detach(*simulator);
  }

  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Axis<Degrees>& roll() { return *controller->rotary_axis(AxisId::kRoll); }
  Axis<Degrees>& pitch() { return *controller->rotary_axis(AxisId::kPitch); }
  Axis<Millimetres>& stage() { return *controller->linear_axis(AxisId::kStage); }
  double truth(AxisId id) const { return simulator->axis(id).true_position(clock.now()); }
  double counter(AxisId id) const { return simulator->axis(id).counter_position(clock.now()); }
  void fault(sim::Fault f) { simulator->add_fault(std::move(f)); }

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
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<Controller> controller;
};

}  // namespace turntable
