// An SC300's driver and its simulator, joined by a socketpair under a manual clock. The manual leaves
// open whether the controller answers questions while it moves: everything is tested both ways.
#pragma once

#include <unistd.h>

#include <memory>

#include "drivers/catalog.h"
#include "drivers/sim/catalog.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/wire_record.h"

namespace turntable {

inline std::vector<AxisConfig> sc300_axes() {
  return {linear_axis("X"), rotary_axis(AxisId::kYaw, "Y"), rotary_axis(AxisId::kRoll, "Z")};
}

inline ControllerConfig sc300_config(bool answers_while_moving) {
  ControllerConfig config;
  config.name = "sc";
  config.model = "zolix-sc300";
  config.answers_while_moving = answers_while_moving;
  OutputConfig& output = config.outputs.emplace_back();
  output.name = "shutter";
  output.on_text = "O1";
  output.off_text = "O0";
  return config;
}

struct SimulatedSc300 {
  /// @param real how the simulated controller is set up; by default like the rig file.
  explicit SimulatedSc300(bool answers_while_moving, std::vector<AxisConfig> axes = sc300_axes(),
                          std::vector<AxisConfig> real = {}, std::map<AxisId, AxisTruth> truth = {})
      : config(sc300_config(answers_while_moving)), rig_axes(axes) {
    sim::SimulatorSetup setup{real.empty() ? axes : real, truth, draws_of_this_test()()};
    setup.controller = config;
    simulator = sim::simulate_controller("zolix-sc300", setup);
    clock.attach(*simulator);
    plug_in();
  }
  ~SimulatedSc300() {
    controller.reset();
    clock.detach(*simulator);
    close(panel_);
  }

  /// A fresh driver on a fresh line to the same controller.
  void plug_in() {
    auto [near, far] = line_pair("line to sc300");
    near.set_log(wire.log());
    if (panel_ >= 0) close(panel_);
    panel_ = dup(near.descriptor());
    simulator->plug(std::move(far));
    controller = open_controller({config, rig_axes, std::move(near), &clock});
  }
  /// What the driver knows nothing of: somebody at the front panel.
  void by_hand(const std::string& command) {
    const std::string bytes = command + "\r";
    EXPECT_EQ(write(panel_, bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
    clock.sleep_for(std::chrono::seconds{5});
  }

  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Axis<Degrees>& roll() { return *controller->rotary_axis(AxisId::kRoll); }
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
  /// Moves and homings that were sent.
  std::vector<std::string> motions() const {
    std::vector<std::string> all;
    for (const char* verb : {"+", "-", "H"})
      for (const std::string& command : wire.commands(verb)) all.push_back(command);
    return all;
  }

  ControllerConfig config;
  std::vector<AxisConfig> rig_axes;
  ManualClock clock;
  WireRecord wire;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<Controller> controller;

 private:
  int panel_ = -1;
};

}  // namespace turntable
