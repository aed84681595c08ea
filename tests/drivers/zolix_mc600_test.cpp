// The driver against the bytes of the manual's facts (protocols/README.md), and on its simulator.
#include "drivers/zolix_mc600.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <thread>

#include "drivers/motion.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_mc600.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

// ---- bytes

/// Says what a manual would have it say, whatever it is asked.
class Recording final : public Actor {
 public:
  explicit Recording(Line line) : line_(std::move(line)) {}
  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override { return std::nullopt; }
  void act(Time now) override {
    std::array<char, 256> buffer;
    pending_ += std::string(buffer.data(), line_.read_available(buffer, now));
    for (std::size_t end; (end = pending_.find('\r')) != std::string::npos;
         pending_.erase(0, end + 1)) {
      const std::string command = pending_.substr(0, end);
      heard.push_back(command + "\r");
      const auto reply = replies.find(command);
      line_.write_available(reply == replies.end() ? "OK\r" : reply->second, now);
    }
  }
  std::map<std::string, std::string> replies;
  std::vector<std::string> heard;

 private:
  Line line_;
  std::string pending_;
};

class DriverBytes : public ::testing::Test {
 protected:
  DriverBytes() : DriverBytes(line_pair("line")) {}
  explicit DriverBytes(std::pair<Line, Line> ends) : peer(std::move(ends.second)) {
    clock.attach(peer);
    ControllerConfig config;
    config.name = "mc600";
    config.model = "zolix-mc600";
    controller = open_zolix_mc600({config,
                                   {rotary_axis(AxisId::kYaw, "X"), linear_axis("T")},
                                   std::move(ends.first),
                                   &clock});
    peer.replies = {{"SetStageStyle? X", "SETSTAGESTYLE? X,R,OK\r"},
                    {"SetUnit? X", "SETUNIT? X,d,OK\r"},
                    {"SetStageStepsRev? X", "SETSTAGESTEPSREV? X,1600,OK\r"},
                    {"SetStageDriveRat? X", "SETSTAGEDRIVERAT? X,180,OK\r"},
                    {"SetInitSpeed? X", "SETINITSPEED? X,1,OK\r"},
                    {"SetSpeed? X", "SETSPEED? X,25,OK\r"},
                    {"SetAccSpeed? X", "SETACCSPEED? X,50,OK\r"},
                    {"SetHomeSpeed? X", "SETHOMESPEED? X,5,OK\r"},
                    {"SetUserPositiveLimit? X", "SETUSERPOSITIVELIMIT? X,30,OK\r"},
                    {"SetUserNegativeLimit? X", "SETUSERNEGATIVELIMIT? X,-30.0,OK\r"},
                    {"SetUserLimitAble? X", "SETUSERLIMITABLE? X,E,OK\r"},
                    {"SetOffset? X", "SETOFFSET? X,0.0,OK\r"},
                    // A controller in another mood: mixed case.
                    {"SetStageStyle? T", "SetStageStyle? T,t,ok\r"},
                    {"SetUnit? T", "setunit? t,M,OK\r"},
                    {"SetStageStepsRev? T", "SETSTAGESTEPSREV? T,1600.000,OK\r"},
                    {"SetStagePitch? T", "SETSTAGEPITCH? T,4.0,OK\r"},
                    {"SetInitSpeed? T", "SETINITSPEED? T,1,OK\r"},
                    {"SetSpeed? T", "SETSPEED? T,20,OK\r"},
                    {"SetAccSpeed? T", "SETACCSPEED? T,50,OK\r"},
                    {"SetHomeSpeed? T", "SETHOMESPEED? T,5.0,OK\r"},
                    {"SetUserPositiveLimit? T", "SETUSERPOSITIVELIMIT? T,201,OK\r"},
                    {"SetUserNegativeLimit? T", "SETUSERNEGATIVELIMIT? T,-1,OK\r"},
                    {"SetUserLimitAble? T", "SETUSERLIMITABLE? T,E,OK\r"},
                    {"SetOffset? T", "SETOFFSET? T,0,OK\r"}};
  }
  ~DriverBytes() override { clock.detach(peer); }

  /// As if homed: the motion's bytes alone are of interest.
  void home(const std::string& letter) {
    peer.replies["Position? " + letter] = "POSITION? " + letter + ",0,OK\r";
    peer.replies["GoHome " + letter] = "READY\r" + letter + " 0,OK\r";
  }

  ManualClock clock;
  Recording peer;
  std::unique_ptr<Controller> controller;
};

TEST_F(DriverBytes, ConnectingAsksAndChangesNothing) {
  EXPECT_THAT(controller->connect(), ElementsAre());
  EXPECT_THAT(peer.heard,
              ElementsAre("Hello\r", "SetStageStyle? X\r", "SetUnit? X\r", "SetStageStepsRev? X\r",
                          "SetStageDriveRat? X\r", "SetInitSpeed? X\r", "SetSpeed? X\r",
                          "SetAccSpeed? X\r", "SetHomeSpeed? X\r", "SetUserPositiveLimit? X\r",
                          "SetUserNegativeLimit? X\r", "SetUserLimitAble? X\r", "SetOffset? X\r",
                          "SetStageStyle? T\r", "SetUnit? T\r", "SetStageStepsRev? T\r",
                          "SetStagePitch? T\r", "SetInitSpeed? T\r", "SetSpeed? T\r",
                          "SetAccSpeed? T\r", "SetHomeSpeed? T\r", "SetUserPositiveLimit? T\r",
                          "SetUserNegativeLimit? T\r", "SetUserLimitAble? T\r", "SetOffset? T\r"));
}

TEST_F(DriverBytes, ConfiguringWritesTheSetUpAndReadsItBack) {
  controller->configure();
  peer.heard.resize(24);
  EXPECT_THAT(
      peer.heard,
      ElementsAre("SetStageStyle X,R\r", "SetUnit X,d\r", "SetStageStepsRev X,1600\r",
                  "SetStageDriveRat X,180\r", "SetInitSpeed X,1\r", "SetSpeed X,25\r",
                  "SetAccSpeed X,50\r", "SetHomeSpeed X,5\r", "SetUserPositiveLimit X,30\r",
                  "SetUserNegativeLimit X,-30\r", "SetUserLimitAble X,E\r", "SetOffset X,0\r",
                  "SetStageStyle T,T\r", "SetUnit T,m\r", "SetStageStepsRev T,1600\r",
                  "SetStagePitch T,4\r", "SetInitSpeed T,1\r", "SetSpeed T,20\r",
                  "SetAccSpeed T,50\r", "SetHomeSpeed T,5\r", "SetUserPositiveLimit T,201\r",
                  "SetUserNegativeLimit T,-1\r", "SetUserLimitAble T,E\r", "SetOffset T,0\r"));
}

TEST_F(DriverBytes, HomesMovesAndStopsInTheManualsWords) {
  controller->connect();
  home("X");
  Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
  yaw.home();
  const auto started = [&](double to) {
    peer.heard.clear();
    yaw.start(Degrees{to});
    yaw.stop();
    return peer.heard.at(1);  // after the position
  };
  peer.replies["GoPosition X,O,A,P,11.845"] = "READY\r";
  EXPECT_EQ(started(12.345), "GoPosition X,O,A,P,11.845\r");
  peer.replies["GoPosition X,O,A,N,5.50125"] = "ready\r";
  EXPECT_EQ(started(-5.00125),
            "GoPosition X,O,A,N,5.50125\r");  // sign as a letter, number as a magnitude
  peer.replies["GoPosition X,O,A,N,0.5"] = "READY\r";
  EXPECT_EQ(started(0), "GoPosition X,O,A,N,0.5\r");
  EXPECT_THAT(peer.heard,
              ElementsAre("Position? X\r", "GoPosition X,O,A,N,0.5\r", "Stop X\r", "Position? X\r",
                          "Position? X\r", "Position? X\r", "Position? X\r"));
}

TEST_F(DriverBytes, ReadsPositionsAsTheControllerWritesThem) {
  for (const auto& [shown, value] : std::map<std::string, double>{{"12.345", 12.345},
                                                                  {"-45000.1", -45000.1},
                                                                  {"0", 0},
                                                                  {"+1.5", 1.5},
                                                                  {"-0.00125", -0.00125},
                                                                  {".5", 0.5}}) {
    peer.replies["Position? X"] = "POSITION? X," + shown + ",OK\r";
    EXPECT_EQ(controller->rotary_axis(AxisId::kYaw)->position().value, value);
  }
  for (const char* odd : {"", "twelve", "1e3", "nan", "inf", "1,2", "0x10"}) {
    peer.replies["Position? X"] = std::string("POSITION? X,") + odd + ",OK\r";
    EXPECT_THROW(controller->rotary_axis(AxisId::kYaw)->position(), ProtocolError) << odd;
  }
}

TEST_F(DriverBytes, NamesWhatDiffersAndMovesNothing) {
  home("X");
  home("T");
  peer.replies["SetSpeed? X"] = "SETSPEED? X,20,OK\r";
  peer.replies["SetUnit? T"] = "SETUNIT? T,s,OK\r";
  EXPECT_THAT(controller->connect(), ElementsAre("yaw: SetSpeed? X: wanted 25, found 20",
                                                 "stage: SetUnit? T: wanted m, found S"));
  peer.heard.clear();
  const std::string message =
      message_of<DeviceError>([&] { controller->rotary_axis(AxisId::kYaw)->home(); });
  EXPECT_THAT(message, HasSubstr("SetSpeed? X: wanted 25, found 20"));
  EXPECT_THAT(message, HasSubstr("SetUnit? T: wanted m, found S"));
  EXPECT_THAT(peer.heard, ElementsAre());
  controller->stop_all();  // but stopping is always allowed
}

TEST_F(DriverBytes, AnotherProgramsWayBackAfterHomingIsADifference) {
  peer.replies["SetOffset? X"] = "SETOFFSET? X,1.5,OK\r";
  EXPECT_THAT(controller->connect(), ElementsAre("yaw: SetOffset? X: wanted 0, found 1.5"));
}

TEST_F(DriverBytes, AControllerWithoutAWayBackIsNoneTheWorse) {
  for (const char* odd : {"E01\r", "", "OK\r"}) {
    peer.replies["SetOffset? X"] = odd;
    EXPECT_THAT(controller->connect(), ElementsAre()) << odd;
    EXPECT_THAT(controller->identity(), HasSubstr("does not answer SetOffset? X"));
  }
  peer.replies["SetOffset X,0"] = "E01\r";
  controller->configure();
}

TEST_F(DriverBytes, AnyEWithTwoDigitsIsARefusalThatIsShown) {
  for (const char* code : {"E03", "E17", "ERR"}) {
    peer.replies["Hello"] = "OK\r";
    controller->connect();
    home("X");
    Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
    yaw.home();
    peer.replies["GoPosition X,O,A,P,9.5"] = code + std::string("\r");
    EXPECT_THAT(message_of<DeviceError>([&] { yaw.start(Degrees{10}); }),
                HasSubstr(std::string("\"GoPosition X,O,A,P,9.5\" was refused with ") + code));
    peer.replies["Hello"] = code + std::string("\r");
    EXPECT_THAT(message_of<DeviceError>([&] { controller->connect(); }),
                HasSubstr(std::string("\"Hello\" was refused with ") + code));
  }
}

TEST_F(DriverBytes, AnAnswerThatNobodyHasHeardOfIsTold) {
  controller->connect();
  home("X");
  Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
  yaw.home();
  peer.replies["GoPosition X,O,A,P,9.5"] = "BUSY\r";
  yaw.start(Degrees{10});
  EXPECT_THAT(message_of<DeviceError>([&] {
                while (!yaw.advance()) {
                }
              }),
              AllOf(HasSubstr("axis yaw"), HasSubstr("\"GoPosition X,O,A,P,9.5\""),
                    HasSubstr("answered by \"BUSY\""), HasSubstr("has not moved since")));
  EXPECT_EQ(std::ranges::count(peer.heard, "GoPosition X,O,A,P,9.5\r"), 1);
  EXPECT_FALSE(yaw.homed());
}

TEST_F(DriverBytes, APositionWithTooFewDigitsIsToldAsWhatItIs) {
  controller->connect();
  home("X");
  Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
  yaw.home();
  peer.replies["GoPosition X,O,A,P,11.845"] = "READY\rX 11.8,OK\r";
  yaw.start(Degrees{12.345});
  peer.replies["Position? X"] = "POSITION? X,11.8,OK\r";
  EXPECT_THAT(
      message_of<DeviceError>([&] {
        while (!yaw.advance()) {
        }
      }),
      AllOf(HasSubstr("\"11.8\""), HasSubstr("1 digits after the point"), HasSubstr("too few")));
}

TEST_F(DriverBytes, HearsBlanksEchoesAndLineFeeds) {
  for (auto& [command, reply] : peer.replies) {
    std::string spread;
    for (const char c : reply) spread += c == ',' ? " , " : c == '\r' ? " \r\n" : std::string(1, c);
    reply = command + "\r\n" + spread;
  }
  peer.replies["Hello"] = "Hello\r\n ok \r\n";
  EXPECT_THAT(controller->connect(), ElementsAre());
}

TEST_F(DriverBytes, FindsOutThatASettingWasNotKept) {
  peer.replies["SetAccSpeed? X"] = "SETACCSPEED? X,49,OK\r";
  EXPECT_THAT(message_of<DeviceError>([&] { controller->configure(); }),
              HasSubstr("SetAccSpeed? X: wanted 50, found 49"));
}

TEST_F(DriverBytes, ReportsErrorRepliesWithTheirCommand) {
  peer.replies["Hello"] = "E01\r";
  EXPECT_THAT(message_of<DeviceError>([&] { controller->connect(); }),
              HasSubstr("\"Hello\" was refused with E01"));
  peer.replies["Hello"] = "OK\r";
  controller->connect();
  home("X");
  Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
  yaw.home();
  peer.replies["GoPosition X,O,A,P,9.5"] = "E02\r";
  const std::string message = message_of<DeviceError>([&] { yaw.start(Degrees{10}); });
  EXPECT_THAT(message, HasSubstr("axis yaw"));
  EXPECT_THAT(message, HasSubstr("\"GoPosition X,O,A,P,9.5\" was refused with E02"));
  EXPECT_THAT(message, HasSubstr("do not define"));
  EXPECT_FALSE(yaw.homed());
}

// ---- on the simulator

class ZolixMc600 : public ::testing::Test, protected SimulatedMc600 {};

TEST_F(ZolixMc600, AgreesWithItsSimulatorAboutTheSetUp) {
  EXPECT_THAT(controller->connect(), ElementsAre());
  EXPECT_THAT(controller->identity(), HasSubstr("channels X Y Z T"));
}

TEST_F(ZolixMc600, DoesNotMoveBeforeItIsConnectedAndHomed) {
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{1}); }),
              HasSubstr("not connected"));
  controller->connect();
  wire.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{1}); }), HasSubstr("not homed"));
  EXPECT_EQ(wire.sent(), "");
}

TEST_F(ZolixMc600, ArrivesToThePulse) {
  ready();
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 100; ++i) {
    const double target = draws.uniform(-29.5, 30);
    const Arrival<Degrees> arrival = move(yaw(), target);
    EXPECT_FALSE(arrival.missed);
    EXPECT_EQ(arrival.requested.value, target);
    EXPECT_NEAR(arrival.position.value, target, 0.00125 / 2 + 1e-9);
    EXPECT_NEAR(counter(AxisId::kYaw), arrival.position.value, 1e-9);
    EXPECT_NEAR(truth(AxisId::kYaw), arrival.position.value, 1e-9);
  }
}

TEST_F(ZolixMc600, MovesTheStageInMillimetres) {
  controller->connect();
  stage().home();
  EXPECT_NEAR(move(stage(), 130.0).position.value, 130.0, 1e-9);
  EXPECT_NEAR(truth(AxisId::kStage), 130.0, 1e-9);
  EXPECT_EQ(controller->rotary_axis(AxisId::kStage), nullptr);
  EXPECT_EQ(controller->linear_axis(AxisId::kYaw), nullptr);
}

TEST_F(ZolixMc600, FindsItsHomeFromWhereverItWasSwitchedOn) {
  for (const double offset : {-40.0, -0.2, 0.0, 17.3}) {
    SimulatedMc600 rig(four_axes(), {}, {{AxisId::kYaw, {.home_offset = offset}}});
    rig.controller->connect();
    rig.yaw().home();
    EXPECT_TRUE(rig.yaw().homed());
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9) << offset;
    EXPECT_NEAR(rig.move(rig.yaw(), 5).position.value, 5.0, 1e-9);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 5.0, 1e-9) << offset;
  }
}

TEST_F(ZolixMc600, RefusesBeyondItsLimitsBeforeAnyByteLeaves) {
  ready();
  for (const double target :
       {30.001, -30.001, -29.6, 1e9, -1e9, std::nan(""), std::numeric_limits<double>::infinity()}) {
    const std::string message = message_of<LimitError>([&] { yaw().start(Degrees{target}); });
    EXPECT_THAT(message, HasSubstr("axis yaw"));
    EXPECT_THAT(message, HasSubstr("allowed [-29.5, 30] deg"));
  }
  EXPECT_EQ(wire.sent(), "");
  EXPECT_TRUE(yaw().homed());
  move(yaw(), 30);
  move(yaw(), -29.5);
}

TEST_F(ZolixMc600, ApproachesFromOneSide) {
  ready();
  const auto commands = [&](double to, bool overshot) {
    wire.clear();
    EXPECT_EQ(move(yaw(), to).overshot, overshot) << to;
    return wire.commands("GoPosition");
  };
  EXPECT_THAT(commands(10, true), ElementsAre("GoPosition Y,O,A,P,9.5", "GoPosition Y,O,A,P,10"));
  EXPECT_THAT(commands(10.4, false),
              ElementsAre("GoPosition Y,O,A,P,10.4"));  // short and in the final direction
  EXPECT_THAT(commands(10.3, true),
              ElementsAre("GoPosition Y,O,A,P,9.8", "GoPosition Y,O,A,P,10.3"));
  EXPECT_THAT(commands(10.3, false), ElementsAre());     // already there
  EXPECT_THAT(commands(10.3004, false), ElementsAre());  // the same pulse
  EXPECT_THAT(commands(-5, true), ElementsAre("GoPosition Y,O,A,N,5.5", "GoPosition Y,O,A,N,5"));
}

TEST_F(ZolixMc600, DoesNotTrustTheSideItStandsOnAfterAStop) {
  ready();
  move(yaw(), 10);
  yaw().stop();
  wire.clear();
  EXPECT_TRUE(move(yaw(), 10).overshot);
  EXPECT_THAT(wire.commands("GoPosition"),
              ElementsAre("GoPosition Y,O,A,P,9.5", "GoPosition Y,O,A,P,10"));
}

TEST_F(ZolixMc600, ArrivesAtTheSameTruePlaceFromBothSidesInSpiteOfBacklash) {
  SimulatedMc600 rig(four_axes(), {}, {{AxisId::kYaw, {.backlash = 0.03}}});
  rig.ready();
  rig.move(rig.yaw(), -10);
  rig.move(rig.yaw(), 5);
  const double from_below = rig.truth(AxisId::kYaw);
  rig.move(rig.yaw(), 20);
  rig.move(rig.yaw(), 5);
  EXPECT_NEAR(rig.truth(AxisId::kYaw), from_below, 1e-9);
  EXPECT_NEAR(from_below, 5.0, 1e-9);
}

TEST_F(ZolixMc600, StaysUntilItHasSettled) {
  ready();
  const Time before = clock.now();
  move(yaw(), 10);
  const double took = seconds(clock.now() - before);
  const double motion = yaw().move_seconds(Degrees{0}, Degrees{10});
  EXPECT_GE(took, motion + 0.1);
  EXPECT_LE(took, motion + 0.1 + 3 * 0.04 + 0.001);
}

TEST_F(ZolixMc600, MovesSeveralAxesAtTheSameTime) {
  controller->connect();
  yaw().home();
  roll().home();
  pitch().home();
  const Time before = clock.now();
  yaw().start(Degrees{25});
  roll().start(Degrees{10});
  pitch().start(Degrees{-20});
  wait_all(yaw(), roll(), pitch());
  const double took = seconds(clock.now() - before);
  const double longest = yaw().move_seconds(Degrees{0}, Degrees{25});
  EXPECT_LT(took, longest + 0.3);
  EXPECT_NEAR(yaw().arrival().position.value, 25, 1e-9);
  EXPECT_NEAR(roll().arrival().position.value, 10, 1e-9);
  EXPECT_NEAR(pitch().arrival().position.value, -20, 1e-9);
}

TEST_F(ZolixMc600, RefusesASecondMoveWhileItMoves) {
  ready();
  yaw().start(Degrees{10});
  EXPECT_THROW(yaw().start(Degrees{5}), DeviceError);
  while (!yaw().advance()) {
  }
  EXPECT_NEAR(yaw().arrival().position.value, 10.0, 1e-9);
  EXPECT_TRUE(yaw().advance());  // still arrived
}

TEST_F(ZolixMc600, GivesTheSameTruePositionsForTheSameSeed) {
  const auto run = [&] {
    const AxisTruth truth{
        .repeatability = 0.005, .backlash = 0.02, .worm_amplitude = 0.004, .home_offset = 3.0};
    SimulatedMc600 rig(four_axes(), {}, {{AxisId::kYaw, truth}, {AxisId::kRoll, truth}});
    rig.ready();
    rig.roll().home();
    std::vector<double> places;
    for (const double to : {5.0, -3.0, 12.5, 0.0, 0.2}) {
      rig.yaw().start(Degrees{to});
      rig.roll().start(Degrees{-to});
      wait_all(rig.yaw(), rig.roll());
      places.push_back(rig.truth(AxisId::kYaw));
      places.push_back(rig.truth(AxisId::kRoll));
      places.push_back(seconds(rig.clock.now()));
    }
    return places;
  };
  EXPECT_EQ(run(), run());
}

TEST_F(ZolixMc600, ConfiguresAControllerThatIsSetUpDifferently) {
  auto real = four_axes();
  real[1].speed = 10;
  real[1].drive_ratio = 90;
  real[0].upper = 100;
  SimulatedMc600 rig(four_axes(), real);
  EXPECT_GE(rig.controller->connect().size(), 3u);
  EXPECT_THROW(rig.yaw().home(), DeviceError);
  EXPECT_THAT(rig.wire.commands("Go"), ElementsAre());
  rig.controller->configure();
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), 5).position.value, 5.0, 1e-9);
}

TEST_F(ZolixMc600, NoticesThatItWasMovedBehindItsBack) {
  ready();
  move(yaw(), 5);
  fault({.kind = sim::FaultKind::kReset, .verb = "Hello"});
  controller->connect();
  clock.sleep_for(milliseconds{1});
  wire.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{6}); }),
              HasSubstr("was left at 5 deg and now stands at 0 deg"));
  EXPECT_FALSE(yaw().homed());
  EXPECT_THAT(wire.commands("Go"), ElementsAre());
}

// ---- stopping

TEST_F(ZolixMc600, StopsAndKnowsThatItHasStopped) {
  ready();
  yaw().start(Degrees{25});
  for (int i = 0; i < 10; ++i) yaw().advance();
  yaw().stop();
  EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now()));
  EXPECT_LT(counter(AxisId::kYaw), 20.0);
  EXPECT_TRUE(yaw().homed());
  EXPECT_THROW(yaw().advance(), DeviceError);
  EXPECT_NEAR(move(yaw(), 10).position.value, 10.0, 1e-9);
}

TEST_F(ZolixMc600, MayBeStoppedInEveryState) {
  yaw().stop();
  controller->connect();
  yaw().stop();
  ready();
  yaw().stop();
  move(yaw(), 1);
  yaw().stop();
  EXPECT_TRUE(yaw().homed());
  controller->stop_all();
}

TEST_F(ZolixMc600, StopsEvenWhenAnUrgentInterruptIsUp) {
  ready();
  yaw().start(Degrees{25});
  set_interrupt_level(2);
  EXPECT_THROW(
      {
        for (;;) yaw().advance();
      },
      Interrupted);
  controller->stop_all();
  set_interrupt_level(0);
  EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now()));
  EXPECT_TRUE(yaw().homed());
}

/// Stops an axis from a thread of its own, as soon as the mover has asked `nth` times where it is.
class OtherThread {
 public:
  OtherThread(SimulatedMc600& rig, int nth) : rig_(rig) {
    rig.wire.on_sent = [this, nth](std::string_view bytes, Time time) {
      if (bytes.starts_with("Stop") && stop_sent.load() == Time{0}) stop_sent = time;
      if (!bytes.starts_with("Position?") || ++asked_ != nth) return;
      asked_to_stop = time;
      thread_ = std::thread([this] { rig_.yaw().stop(); });
      std::this_thread::sleep_for(
          milliseconds{10});  // now it waits for the line, which this exchange holds
    };
  }
  void join() { thread_.join(); }

  std::atomic<Time> asked_to_stop{}, stop_sent{};

 private:
  SimulatedMc600& rig_;
  std::atomic<int> asked_{0};
  std::thread thread_;
};

TEST_F(ZolixMc600, LosesItsReferenceWhenHomingIsStopped) {
  ready();
  move(yaw(), 20);
  OtherThread other(*this, 10);
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().home(); }), HasSubstr("stopped"));
  other.join();
  EXPECT_FALSE(yaw().homed());
  EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now()));
}

TEST_F(ZolixMc600, StopFromAnotherThreadHaltsWithinOnePollIntervalAndNothingStartsAfterIt) {
  for (int nth = 1; nth <= 40; ++nth) {
    SimulatedMc600 rig;
    rig.ready();
    OtherThread other(rig, nth);
    EXPECT_THAT(message_of<DeviceError>([&] { rig.move(rig.yaw(), 25); }), HasSubstr("stopped"));
    other.join();
    EXPECT_FALSE(rig.simulator->axis(AxisId::kYaw).moving(rig.clock.now()));
    EXPECT_LE(other.stop_sent.load() - other.asked_to_stop.load(), milliseconds{40});
    const std::string sent = rig.wire.sent();
    EXPECT_EQ(sent.find("GoPosition", sent.find("Stop Y")), std::string::npos);
    EXPECT_TRUE(rig.yaw().homed());
  }
}

// ---- the table of controllers

TEST(ControllerCatalog, AgreesWithTheSimulators) {
  std::vector<std::string> real, simulated;
  for (const auto& row : controller_models()) real.emplace_back(row.model);
  for (const auto& row : sim::simulator_models()) simulated.emplace_back(row.model);
  EXPECT_EQ(real, simulated);
}

TEST(ControllerCatalog, SaysOfEachModelWhatNobodyHasConfirmed) {
  for (const ControllerModel& row : controller_models()) {
    EXPECT_FALSE(row.unconfirmed.empty()) << row.model;
    for (const std::string_view sentence : row.unconfirmed)
      EXPECT_TRUE(sentence.ends_with('.')) << row.model << ": " << sentence;
  }
}

TEST(ControllerCatalog, NamesTheModelsItKnows) {
  ManualClock clock;
  ControllerConfig config;
  config.name = "one";
  config.model = "two";
  const auto open = [&](std::vector<AxisConfig> axes) {
    return open_controller({config, std::move(axes), line_pair("line").first, &clock});
  };
  EXPECT_THAT(message_of<ConfigError>([&] { open({}); }), HasSubstr("zolix-mc600"));
  EXPECT_THROW(sim::simulate_controller("two", {}), ConfigError);
  config.model = "zolix-mc600";
  EXPECT_THAT(message_of<ConfigError>([&] { open({rotary_axis(AxisId::kYaw, "Q")}); }),
              HasSubstr("X, Y, Z, T"));
  EXPECT_THAT(message_of<ConfigError>([&] {
                open({rotary_axis(AxisId::kYaw, "X"), rotary_axis(AxisId::kRoll, "x")});
              }),
              HasSubstr("already taken by yaw"));
}

}  // namespace
}  // namespace turntable
