// A controller's own grid: goals lie where the axis can be sent, and windows are no finer than what is
// told back.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "src/core/errors.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_controller.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

/// Axes with pulses that are finer than, or no divisor of, what controllers take.
struct Pulses {
  const char* name;
  double steps_per_rev, drive_ratio;
};
constexpr Pulses kPulses[] = {{"64 microsteps", 12800, 180},
                              {"10000 pulses", 10000, 180},
                              {"an odd ratio", 1600, 407.04},
                              {"0.0008 deg", 2500, 180},
                              {"the usual", 1600, 180}};

RigFile one_axis(const std::string& model, AxisConfig axis) {
  RigFile rig;
  ControllerConfig controller;
  controller.name = axis.controller = "mc1";
  controller.model = model;
  rig.controllers = {controller};
  rig.axes[axis.id] = std::move(axis);
  return rig;
}

AxisConfig yaw_with(const Pulses& pulses) {
  AxisConfig axis = rotary_axis(AxisId::kYaw, "Y");
  axis.steps_per_rev = pulses.steps_per_rev;
  axis.drive_ratio = pulses.drive_ratio;
  axis.tolerance = 1.5 * axis.per_step();
  axis.tolerance_stated = false;
  return axis;
}

TEST(Grid, EveryTargetIsReachedOnEveryGridOfPulses) {
  for (const char* model : {"zolix-mc600", "zolix-zc300", "zolix-sc300"})
    for (const Pulses& pulses : kPulses) {
      SCOPED_TRACE(std::string(model) + ", " + pulses.name);
      RigFile rig = one_axis(model, yaw_with(pulses));
      know_controllers(rig);
      const AxisConfig axis = rig.axis(AxisId::kYaw);
      ManualClock clock;
      auto simulator = sim::simulate_controller(model, {{axis}, {}, 1, rig.controllers.front()});
      clock.attach(*simulator);
      auto [near, far] = line_pair("line");
      simulator->plug(std::move(far));
      const auto controller =
          open_controller({rig.controllers.front(), {axis}, std::move(near), &clock});
      controller->connect();
      Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
      yaw.home();
      Random draws = draws_of_this_test();
      for (int k = 0; k < 25; ++k) {
        const double target = draws.uniform(-25, 25);
        yaw.start(Degrees{target});
        while (!yaw.advance()) {
        }
        const Arrival<Degrees> arrival = yaw.arrival();
        EXPECT_FALSE(arrival.missed) << target;
        EXPECT_EQ(arrival.retries, 0) << target;
        const double truth = simulator->axis(AxisId::kYaw).true_position(clock.now());
        // What is sent may lie in the middle between two pulses: then the controller has the choice.
        const double sent = axis.sent_step > 0
                                ? std::round(axis.on_grid(target) / axis.sent_step) * axis.sent_step
                                : axis.on_grid(target);
        const double sent_pulses = std::abs(sent / axis.per_step());
        const bool middle = std::abs(sent_pulses - std::floor(sent_pulses) - 0.5) < 1e-6;
        EXPECT_NEAR(truth, axis.on_grid(target), middle ? 1.001 * axis.per_step() : 1e-6) << target;
        EXPECT_LE(std::abs(truth - target), 0.5 * axis.per_step() + 0.5 * axis.sent_step + 1e-9);
      }
      clock.detach(*simulator);
    }
}

TEST(Grid, KeepsEveryPulseThatCanBeAskedFor) {
  AxisConfig axis = yaw_with(kPulses[4]);
  axis.sent_step = 0.001;
  for (int pulse = -4000; pulse <= 4000; ++pulse)
    EXPECT_NEAR(axis.on_grid(pulse * 0.00125), pulse * 0.00125, 1e-12);
  EXPECT_EQ(axis.least_move(), axis.per_step());
  axis = yaw_with(kPulses[0]);
  axis.sent_step = 0.001;
  EXPECT_EQ(axis.least_move(), 0.001);
  EXPECT_NEAR(axis.on_grid(3.3333), 21331 * 0.00015625, 1e-12);  // what 3.333 comes to
}

TEST(Grid, GivesNoWindowThatIsFinerThanWhatIsTold) {
  AxisConfig axis = yaw_with(kPulses[0]);
  RigFile rig = one_axis("zolix-mc600", axis);
  know_controllers(rig);
  EXPECT_NEAR(rig.axis(AxisId::kYaw).tolerance, 0.5 * axis.per_step() + 0.001, 1e-12);
  axis.tolerance = 0.0004;
  axis.tolerance_stated = true;
  rig = one_axis("zolix-mc600", axis);
  EXPECT_THAT(message_of<ConfigError>([&] { know_controllers(rig); }),
              HasSubstr("/axes/yaw/tolerance_deg: found 0.0004 deg, allowed: at least 0.000578"));
  rig = one_axis("zolix-sc300", axis);
  EXPECT_NO_THROW(know_controllers(rig));  // it speaks in pulses
  axis = yaw_with(kPulses[4]);
  rig = one_axis("zolix-mc600", axis);
  know_controllers(rig);
  EXPECT_EQ(rig.axis(AxisId::kYaw).tolerance, 1.5 * axis.per_step());
}

// ---- an axis whose controller counts the other way

class Reversed : public ::testing::TestWithParam<ControllerVariant> {};

TEST_P(Reversed, MovesTheOtherWayOnTheWireAndTheSameWayOnTheRig) {
  std::vector<AxisConfig> axes = axes_of(GetParam().model);
  axes.front().reversed = true;
  axes.front().lower = -1;
  axes.front().upper = 150;
  ControllerConfig config;
  config.name = "mc1";
  config.model = GetParam().model;
  config.answers_while_moving = GetParam().answers_while_moving;
  config.description = GetParam().description();
  if (GetParam().gateway) config.line.kind = LineConfig::Kind::kModbusTcp;
  std::vector<AxisConfig> seen = axes;
  for (AxisConfig& axis : seen) axis = controller_side(axis);
  EXPECT_EQ(seen.front().lower, -150);
  EXPECT_EQ(seen.front().upper, 1);
  ManualClock clock;
  auto simulator = sim::simulate_controller(config.model, {seen, {}, 1, config});
  clock.attach(*simulator);
  auto [near, far] = line_pair("line");
  simulator->plug(std::move(far));
  const auto controller = open_controller({config, axes, std::move(near), &clock});
  EXPECT_THAT(controller->connect(), ::testing::IsEmpty());
  Axis<Millimetres>& stage = *controller->linear_axis(AxisId::kStage);
  stage.home();
  EXPECT_THROW(stage.start(Millimetres{-20}), LimitError);
  for (const double to : {100.0, 40.0, 0.5}) {
    stage.start(Millimetres{to});
    while (!stage.advance()) {
    }
    EXPECT_FALSE(stage.arrival().missed);
    EXPECT_NEAR(stage.position().value, to, 0.01);
    EXPECT_NEAR(simulator->axis(AxisId::kStage).true_position(clock.now()), -to, 0.01);
  }
  controller->stop_all();
  clock.detach(*simulator);
}

INSTANTIATE_TEST_SUITE_P(Catalogue, Reversed, ::testing::ValuesIn(all_controllers()),
                         [](const auto& one) { return one.param.name(); });

}  // namespace
}  // namespace turntable
