// The driver against a drive that was written from the manuals and from other people's programs, and
// not from our simulator.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>

#include "drivers/catalog.h"
#include "drivers/leadshine_pr.h"
#include "drivers/motion.h"
#include "src/core/errors.h"
#include "tests/support/axis_configs.h"
#include "tests/support/leadshine_peer.h"
#include "tests/support/message_of.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr double kDrivePulse = 0.00125;

class ForeignLeadshine : public ::testing::TestWithParam<DriveManners> {
 protected:
  ForeignLeadshine() : ForeignLeadshine(line_pair("bus line")) {}
  explicit ForeignLeadshine(std::pair<Line, Line> ends)
      : peer(std::move(ends.second), 3, GetParam()) {
    clock.attach(peer);
    ControllerConfig config;
    config.name = "bus";
    config.model = "leadshine-pr";
    OutputConfig camera;
    camera.name = "camera";
    camera.register_at = 0x0157;  // of all outputs
    camera.slave = 3;
    camera.bit = 1;
    config.outputs = {camera};
    controller =
        open_controller({config, {rotary_axis(AxisId::kYaw, "3")}, std::move(ends.first), &clock});
  }
  ~ForeignLeadshine() override {
    controller.reset();
    clock.detach(peer);
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Arrival<Degrees> move(double to) {
    yaw().start(Degrees{to});
    while (!yaw().advance()) {
    }
    return yaw().arrival();
  }
  double degrees() { return peer.position(clock.now()) * kDrivePulse; }

  ManualClock clock;
  LeadshinePeer peer;
  std::unique_ptr<Controller> controller;
};

INSTANTIATE_TEST_SUITE_P(
    , ForeignLeadshine,
    ::testing::Values(DriveManners{.name = "plain"},
                      DriveManners{.name = "slow", .reply = milliseconds{60}},
                      DriveManners{.name = "echo", .echo = true},
                      DriveManners{.name = "halves", .second_half = milliseconds{8}},
                      DriveManners{.name = "home_done_at_switch",
                                   .home_done_at_switch = true,
                                   .pause_at_switch = milliseconds{300}},
                      DriveManners{.name = "pause_at_switch", .pause_at_switch = milliseconds{300}},
                      DriveManners{.name = "noise", .noise = std::string("\0\xff", 2)},
                      DriveManners{.name = "spoilt", .spoilt_every = 9}),
    [](const auto& manners) { return std::string(manners.param.name); });

TEST_P(ForeignLeadshine, IsSetUpHomedMovedAndStopped) {
  controller->configure();
  EXPECT_THAT(controller->connect(), IsEmpty());
  yaw().home();
  EXPECT_NEAR(degrees(), 0, 1e-9);
  for (const double to : {12.345, -5.0, 20.0}) {
    EXPECT_FALSE(move(to).missed);
    EXPECT_NEAR(degrees(), to, kDrivePulse / 2 + 1e-9);
  }
  yaw().start(Degrees{-20});
  clock.sleep_for(milliseconds{300});
  yaw().stop();
  EXPECT_FALSE(peer.running(clock.now()));
  EXPECT_GT(degrees(), -19);
  move(-3);
  EXPECT_NEAR(degrees(), -3, kDrivePulse / 2 + 1e-9);
  EXPECT_EQ(std::ranges::count(peer.triggers, 0x20), 1);
}

TEST_P(ForeignLeadshine, IsNotMovedAsItComesFromTheFactory) {
  const auto differences = controller->connect();
  EXPECT_THAT(differences, Contains(HasSubstr("0x600A (homes on the origin switch, and goes to the "
                                              "stop position then): wanted 0x0006, found 0x0004")));
  EXPECT_THROW(yaw().home(), DeviceError);
  EXPECT_THAT(peer.triggers, IsEmpty());
}

TEST_P(ForeignLeadshine, ThatHomesByItselfIsAskedNotTo) {
  controller->configure();
  peer.words[0x6000] |= 4;
  peer.saved = peer.words;
  peer.switch_on(clock.now());
  EXPECT_TRUE(peer.running(clock.now()));
  clock.sleep_for(milliseconds{5000});
  EXPECT_THAT(controller->connect(), ElementsAre(AllOf(HasSubstr("moves without being asked"),
                                                       HasSubstr("wanted off, found on"))));
  EXPECT_THROW(yaw().home(), DeviceError);
  controller->configure();
  EXPECT_EQ(peer.words[0x6000], 2);
  yaw().home();
  EXPECT_NEAR(move(5).position.value, 5, 1e-9);
}

TEST_P(ForeignLeadshine, ThatMeetsALimitSwitchSaysWhich) {
  controller->configure();
  yaw().home();
  peer.upper_switch = 4000;
  yaw().start(Degrees{20});
  EXPECT_THAT(message_of<DeviceError>([&] {
                while (!yaw().advance()) {
                }
              }),
              AllOf(HasSubstr("met a limit switch"), HasSubstr("0x0200"),
                    HasSubstr("input 2, set up as the upper limit switch, reads on")));
  EXPECT_FALSE(yaw().homed());
  peer.upper_switch.reset();
  yaw().home();
  EXPECT_NEAR(move(5).position.value, 5, 1e-9);
}

TEST_P(ForeignLeadshine, WhoseTriggerArrivesSpoiltIsNotMovedAndSaysSo) {
  controller->configure();
  yaw().home();
  peer.triggers.clear();
  peer.spoils_triggers = true;
  EXPECT_THAT(message_of<DeviceError>([&] { move(20); }),
              AllOf(HasSubstr("0x6002"), HasSubstr("exception 08"), HasSubstr("arrived spoilt")));
  EXPECT_THAT(peer.triggers, IsEmpty());
  EXPECT_NEAR(degrees(), 0, 1e-9);
}

TEST_P(ForeignLeadshine, KeepsTheOtherOutputsOfARegister) {
  for (const int others : {0x0001, 0x0083}) {
    peer.words[0x0157] = others;
    peer.written.clear();
    controller->pulse_output("camera");
    EXPECT_THAT(peer.written,
                ElementsAre(std::pair{0x0157, others | 2}, std::pair{0x0157, others & ~2}));
  }
}

TEST_P(ForeignLeadshine, OfTheOtherRegisterMapIsTold) {
  for (int a = 0x6000; a <= 0x6019; ++a) peer.words.erase(a);
  EXPECT_THAT(message_of<DeviceError>([&] { controller->connect(); }),
              AllOf(HasSubstr("exception 02"), HasSubstr("\"CL57RS\""), HasSubstr("PR paths")));
  EXPECT_THROW(yaw().home(), DeviceError);
}

}  // namespace
}  // namespace turntable
