// A computer that sleeps while an axis moves: its clock stands still, the controller goes on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "src/core/errors.h"
#include "tests/support/simulated_controller.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

/// The time of a computer among things whose time never stops.
class SleepyClock final : public Clock {
 public:
  Time now() const override { return world.now() - asleep_; }
  bool wait_readable(int fd, Time deadline) override {
    return world.wait_readable(fd, deadline + asleep_);
  }
  void sleep_until(Time deadline) override { world.sleep_until(deadline + asleep_); }
  Time asleep() const override { return tells ? asleep_ : Time{0}; }
  void fall_asleep(Time time) {
    world.sleep_for(time);
    asleep_ += time;
  }

  ManualClock world;
  bool tells = true;

 private:
  Time asleep_{0};
};

class SleepingComputer : public ::testing::TestWithParam<ControllerVariant> {
 protected:
  SleepingComputer() : axes(axes_of(GetParam().model)) {
    config.name = "mc1";
    config.model = GetParam().model;
    config.answers_while_moving = GetParam().answers_while_moving;
    config.description = GetParam().description();
    if (GetParam().gateway) config.line.kind = LineConfig::Kind::kModbusTcp;
    simulator = sim::simulate_controller(config.model, {axes, {}, 1, config});
    simulator->note_requests();
    clock.world.attach(*simulator);
    auto [near, far] = line_pair("line");
    simulator->plug(std::move(far));
    controller = open_controller({config, axes, std::move(near), &clock});
    controller->connect();
    yaw().home();
    move_to(-28);
  }
  ~SleepingComputer() override { clock.world.detach(*simulator); }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  void move_to(double target, double asleep_s = 0.0) {
    yaw().start(Degrees{target});
    for (int i = 0; !yaw().advance(); ++i)
      if (i == 3 && asleep_s > 0) clock.fall_asleep(from_seconds(asleep_s));
  }

  std::vector<AxisConfig> axes;
  ControllerConfig config;
  SleepyClock clock;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<Controller> controller;
};

TEST_P(SleepingComputer, FindsTheAxisAtItsGoalAndGoesOn) {
  for (const double target : {28.0, -28.0}) {
    move_to(target, 5.0);
    EXPECT_FALSE(yaw().arrival().missed);
    EXPECT_NEAR(simulator->axis(AxisId::kYaw).true_position(clock.world.now()), target, 0.002);
    EXPECT_TRUE(yaw().homed());
  }
}

TEST_P(SleepingComputer, IsNotTakenForAnExcuseWhereItDidNotSleep) {
  clock.tells = false;  // the time was lost elsewhere
  try {
    move_to(28, 5.0);
  } catch (const DeviceError& e) {
    EXPECT_THAT(e.what(), HasSubstr("where it cannot be"));
    return;
  }
  // Who hears of the end alone cannot tell how long it took.
  EXPECT_FALSE(GetParam().answers_while_moving);
}

INSTANTIATE_TEST_SUITE_P(Catalogue, SleepingComputer, ::testing::ValuesIn(all_controllers()),
                         [](const auto& one) { return one.param.name(); });

TEST(SystemClock, HasNotSleptSinceItBegan) {
  const SystemClock clock;
  EXPECT_EQ(clock.asleep(), Time{0});
}

}  // namespace
}  // namespace turntable
