// The driver against a ZC300 that was written from the manual, the vendor's library and laboratories'
// notes, and not from our simulator.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>

#include "drivers/catalog.h"
#include "drivers/motion.h"
#include "src/core/errors.h"
#include "tests/support/axis_configs.h"
#include "tests/support/message_of.h"
#include "tests/support/zc300_peer.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class ForeignZc300 : public ::testing::TestWithParam<Zc300Manners> {
 protected:
  ForeignZc300() : ForeignZc300(line_pair("line to a foreign zc300")) {}
  explicit ForeignZc300(std::pair<Line, Line> ends) : peer(std::move(ends.second), GetParam()) {
    clock.attach(peer);
    ControllerConfig config;
    config.name = "mc";
    config.model = "zolix-zc300";
    axes = {linear_axis("X"), rotary_axis(AxisId::kYaw, "Y")};
    controller = open_controller({config, axes, std::move(ends.first), &clock});
  }
  ~ForeignZc300() override {
    controller.reset();
    clock.detach(peer);
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Axis<Millimetres>& stage() { return *controller->linear_axis(AxisId::kStage); }
  template <class Q>
  Arrival<Q> move(Axis<Q>& axis, double to) {
    axis.start(Q{to});
    while (!axis.advance()) {
    }
    return axis.arrival();
  }
  void ready() {
    controller->configure();
    EXPECT_THAT(controller->connect(), IsEmpty());
    stage().home();
    yaw().home();
  }
  double degrees() { return peer.from_home(1, clock.now()); }

  ManualClock clock;
  Zc300Peer peer;
  std::vector<AxisConfig> axes;
  std::unique_ptr<Controller> controller;
};

INSTANTIATE_TEST_SUITE_P(
    , ForeignZc300,
    ::testing::Values(Zc300Manners{.name = "plain"},
                      Zc300Manners{.name = "slow", .reply = milliseconds{300}},
                      Zc300Manners{.name = "halves", .second_half = milliseconds{9}},
                      Zc300Manners{.name = "echo", .echo = true},
                      Zc300Manners{.name = "noise", .noise = std::string("\0\xff", 2)},
                      Zc300Manners{.name = "misses_a_question_after_motion",
                                   .misses_after_motion = true},
                      Zc300Manners{.name = "busy", .busy_every = 5}),
    [](const auto& manners) { return std::string(manners.param.name); });

TEST_P(ForeignZc300, IsSetUpHomedMovedAndStopped) {
  EXPECT_THAT(controller->connect(), Contains(HasSubstr("drive ratio")));
  EXPECT_THROW(yaw().home(), DeviceError);
  EXPECT_THAT(peer.opcodes, IsEmpty());
  ready();
  EXPECT_THAT(peer.opcodes, Contains("69 31 ").Times(1));
  EXPECT_THAT(peer.opcodes, Contains("69 32 ").Times(1));
  EXPECT_NEAR(degrees(), 0, 1e-9);  // it does not count from there by itself: the driver made it 0
  EXPECT_NEAR(peer.shown(1, clock.now()), 0, 1e-9);
  const double pulse = axes[1].per_step();
  for (const double to : {12.345, -5.0, 20.0}) {
    EXPECT_FALSE(move(yaw(), to).missed) << to;
    EXPECT_NEAR(degrees(), to, pulse / 2 + 0.0005 + 1e-9);
  }
  EXPECT_FALSE(move(stage(), 7.5).missed);
  EXPECT_NEAR(peer.from_home(0, clock.now()), 7.5, axes[0].per_step() / 2 + 0.0005);
  yaw().start(Degrees{-20});
  clock.sleep_for(milliseconds{300});
  yaw().stop();
  EXPECT_FALSE(peer.moving(1, clock.now()));
  EXPECT_GT(degrees(), -19);
  EXPECT_FALSE(move(yaw(), -3).missed);
  EXPECT_NEAR(degrees(), -3, pulse / 2 + 0.0005 + 1e-9);
  // Nothing reserved was touched, no number of registers was wrong, and each frame had its silence.
  EXPECT_THAT(peer.refused, IsEmpty());
  EXPECT_EQ(peer.too_soon, 0);
}

TEST_P(ForeignZc300, ThatDoesNotHearAMoveIsNotToldAgain) {
  ready();
  peer.opcodes.clear();
  peer.deaf_to_opcodes = true;
  EXPECT_THROW(move(yaw(), 10), Error);
  EXPECT_THAT(peer.opcodes, Not(Contains(HasSubstr("64 "))));
  EXPECT_EQ(peer.unheard, 1);
  EXPECT_NEAR(degrees(), 0, 1e-9);
}

TEST_P(ForeignZc300, ThatRefusesAMoveIsNotAskedAgain) {
  ready();
  for (const int code : {0x06, 0x07, 0x08, 0x09}) {
    peer.opcodes.clear();
    peer.refuses_moves = code;
    EXPECT_THAT(message_of<DeviceError>([&] { move(yaw(), 10); }),
                HasSubstr(fmt::format("opcode 64h was refused with {:02X}: ", code)));
    EXPECT_EQ(std::ranges::count_if(peer.opcodes,
                                    [](const std::string& o) { return o.starts_with("64"); }),
              1);
    peer.refuses_moves.reset();
    EXPECT_NEAR(degrees(), 0, 1e-9);
    yaw().home();
  }
}

TEST_P(ForeignZc300, ThatWasSwitchedOffIsNotMovedBeforeItIsHomed) {
  ready();
  move(yaw(), 5);
  peer.switch_on();
  peer.opcodes.clear();
  EXPECT_THROW(move(yaw(), 10), DeviceError);
  EXPECT_THROW(move(stage(), 10), DeviceError);
  EXPECT_THAT(peer.opcodes, Not(Contains(HasSubstr("64 "))));
}

}  // namespace
}  // namespace turntable
