// A connection that was closed: serial servers do that to a line that nobody uses.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "src/core/errors.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_controller.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// A controller behind a server that takes as many connections, one at a time, as it is told to.
struct BehindAServer {
  explicit BehindAServer(const ControllerVariant& variant) : axes(axes_of(variant.model)) {
    config.name = "mc1";
    config.model = variant.model;
    config.answers_while_moving = variant.answers_while_moving;
    config.description = variant.description();
    if (variant.gateway) config.line.kind = LineConfig::Kind::kModbusTcp;
    device = make(axes);
    controller = open_controller({config, axes, line(), &clock});
  }
  std::unique_ptr<sim::ControllerSimulator> make(const std::vector<AxisConfig>& real) {
    auto simulator = sim::simulate_controller(config.model, {real, {}, 1, config});
    simulator->note_requests();
    clock.attach(*simulator);
    return simulator;
  }
  SharedLine line() {
    return SharedLine([this] {
      if (refuses) throw LineError("server: connection refused.");
      ++connections;
      auto [near, far] = line_pair("server");
      device->plug(std::move(far));
      return std::move(near);
    });
  }
  void close() { device->unplug(); }
  void ready() {
    EXPECT_THAT(controller->connect(), IsEmpty());
    for (const AxisConfig& axis : axes)
      if (axis.kind == StageKind::kLinear)
        controller->linear_axis(axis.id)->home();
      else
        controller->rotary_axis(axis.id)->home();
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  double move(double to) {
    yaw().start(Degrees{to});
    while (!yaw().advance()) {
    }
    return yaw().arrival().position.value;
  }
  bool moves() const { return device->axis(AxisId::kYaw).moving(clock.now()); }
  std::size_t told(std::string_view kind) const {
    return static_cast<std::size_t>(
        std::ranges::count(device->requests(), kind, &sim::ControllerSimulator::Request::kind));
  }

  std::vector<AxisConfig> axes;
  ControllerConfig config;
  ManualClock clock;
  bool refuses = false;
  int connections = 0;
  std::unique_ptr<sim::ControllerSimulator> device;
  std::unique_ptr<Controller> controller;
};

class ClosedLine : public ::testing::TestWithParam<ControllerVariant> {
 protected:
  ClosedLine() : rig(GetParam()) { rig.ready(); }
  BehindAServer rig;
};

TEST_P(ClosedLine, IsOpenedAgainWhileNothingMoves) {
  rig.move(5);
  rig.close();
  EXPECT_NEAR(rig.move(-7), -7, 1e-3);
  EXPECT_EQ(rig.connections, 2);
  rig.close();
  EXPECT_NEAR(rig.yaw().position().value, -7, 1e-3);
  rig.close();
  rig.yaw().home();
  EXPECT_EQ(rig.connections, 4);
}

TEST_P(ClosedLine, NeedsNoEmergencyStopForAxesThatWereSeenToStand) {
  rig.move(5);
  rig.refuses = true;
  rig.close();
  EXPECT_THAT(message_of<LineError>([&] { rig.move(3); }),
              AllOf(HasSubstr("connection refused"), HasSubstr("No axis was moving")));
  EXPECT_NO_THROW(rig.controller->stop_all());
}

TEST_P(ClosedLine, IsOpenedAgainForAStop) {
  rig.yaw().start(Degrees{28});
  rig.yaw().advance();
  rig.close();
  EXPECT_THROW(
      {
        for (;;) rig.yaw().advance();
      },
      Error);
  EXPECT_TRUE(rig.moves());
  EXPECT_EQ(rig.connections, 1);
  rig.controller->stop_all();
  EXPECT_FALSE(rig.moves());
  EXPECT_EQ(rig.connections, 2);
  EXPECT_FALSE(rig.yaw().homed());
}

TEST_P(ClosedLine, SaysThatAMovingAxisCouldNotBeStopped) {
  rig.yaw().start(Degrees{28});
  rig.yaw().advance();
  rig.refuses = true;
  rig.close();
  EXPECT_THROW(rig.controller->stop_all(), Error);
}

TEST_P(ClosedLine, LeadsToNothingElseThanWhatWasThereBefore) {
  rig.move(5);
  rig.close();
  std::vector<AxisConfig> others = rig.axes;
  for (AxisConfig& axis : others) axis.speed *= 0.5;
  const auto first = std::move(rig.device);
  rig.clock.detach(*first);
  rig.device = rig.make(others);
  if (GetParam().model == "leadshine-pr") {  // its speed travels with each move
    EXPECT_THROW(rig.move(3), DeviceError);
    return;
  }
  EXPECT_THAT(message_of<DeviceError>([&] { rig.move(3); }),
              HasSubstr("was closed and opened again"));
  EXPECT_EQ(rig.told("move"), 0u);
}

TEST_P(ClosedLine, IsKeptOpenByWhoeverWaits) {
  rig.move(5);
  const std::size_t asked = rig.device->requests().size();
  rig.clock.sleep_for(std::chrono::seconds{2});
  rig.controller->keep_alive();
  EXPECT_EQ(rig.device->requests().size(), asked);  // the line is busy enough
  rig.clock.sleep_for(std::chrono::seconds{4});
  rig.controller->keep_alive();
  EXPECT_GT(rig.device->requests().size(), asked);
  rig.close();
  rig.clock.sleep_for(std::chrono::seconds{6});
  rig.controller->keep_alive();
  EXPECT_EQ(rig.connections, 2);
  rig.refuses = true;
  rig.close();
  rig.clock.sleep_for(std::chrono::seconds{6});
  EXPECT_NO_THROW(rig.controller->keep_alive());  // whoever moves next will hear of it
  EXPECT_EQ(rig.told("home"), rig.axes.size());
}

INSTANTIATE_TEST_SUITE_P(Catalogue, ClosedLine, ::testing::ValuesIn(all_controllers()),
                         [](const auto& one) { return one.param.name(); });

}  // namespace
}  // namespace turntable
