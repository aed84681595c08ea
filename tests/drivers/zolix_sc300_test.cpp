// The driver against the bytes of the manual's facts (protocols/README.md), and on its simulator,
// with both answers to what the manual leaves open.
#include "drivers/zolix_sc300.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <thread>

#include "drivers/motion.h"
#include "src/core/errors.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_sc300.h"

namespace turntable {
namespace {

using sim::FaultKind;
using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

// ---- bytes

/// Says what a manual would have it say, whatever it is asked; nothing where that is empty.
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
      if (on_heard) on_heard(command);
    }
  }
  void say(const std::string& bytes) { line_.write_available(bytes, Time{0}); }
  std::map<std::string, std::string> replies;
  std::vector<std::string> heard;
  std::function<void(const std::string&)> on_heard;

 private:
  Line line_;
  std::string pending_;
};

class Sc300Bytes : public ::testing::Test {
 protected:
  Sc300Bytes() : Sc300Bytes(line_pair("line")) {}
  explicit Sc300Bytes(std::pair<Line, Line> ends) : peer(std::move(ends.second)) {
    clock.attach(peer);
    controller = open_zolix_sc300({sc300_config(true),
                                   {rotary_axis(AxisId::kYaw, "x"), linear_axis("Z")},
                                   std::move(ends.first),
                                   &clock});
    peer.replies = {{"VE", "SC300_V1.0\r"}, {"TY", "SC300\r"},  {"ID", "ID0000\r"},
                    {"XV", "XV,20000\r"},   {"XF", "XF,800\r"}, {"XA", "XA,40000\r"},
                    {"ZV", "..,8000\r"},    {"ZF", "FZ,400\r"}, {"ZA", "??,20000\r"},
                    {"?X", "?X,0\r"},       {"?Z", "?Z,0\r"},   {"HX", ""}};
  }
  ~Sc300Bytes() override {
    controller.reset();
    clock.detach(peer);
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  void home() {
    peer.replies["HX"] = "?X,0\r";
    yaw().home();
    peer.heard.clear();
  }

  ManualClock clock;
  Recording peer;
  std::unique_ptr<Controller> controller;
};

TEST_F(Sc300Bytes, ConnectsByAskingOnly) {
  EXPECT_THAT(controller->connect(), ElementsAre());
  EXPECT_THAT(peer.heard, ElementsAre("\r", "VE\r", "TY\r", "ID\r", "XV\r", "XF\r", "XA\r", "ZV\r",
                                      "ZF\r", "ZA\r"));
  EXPECT_THAT(controller->identity(), HasSubstr("SC300 SC300_V1.0 ID0000"));
}

TEST_F(Sc300Bytes, WritesItsSetUpInPulses) {
  controller->configure();
  peer.heard.resize(6);
  EXPECT_THAT(peer.heard, ElementsAre("VX,20000\r", "FX,800\r", "AX,40000\r", "VZ,8000\r",
                                      "FZ,400\r", "AZ,20000\r"));
}

TEST_F(Sc300Bytes, MovesByDifferencesFromACounterThatItReadsTwice) {
  controller->connect();
  home();
  peer.replies["+X,7600"] = "";
  yaw().start(Degrees{10});
  EXPECT_THAT(peer.heard, ElementsAre("?X\r", "?X\r", "?X\r", "+X,7600\r"));
  yaw().stop();
  EXPECT_THAT(peer.heard.at(4), "SPX\r");
  peer.heard.clear();
  peer.replies["?X"] = "?X,-100\r";
  peer.replies["-X,4300"] = "";
  EXPECT_THROW(yaw().start(Degrees{-5}), DeviceError);  // it was left at 0
  EXPECT_THAT(peer.heard, ElementsAre("?X\r", "?X\r", "?X\r"));
}

TEST_F(Sc300Bytes, NeverSendsALineFeed) {
  controller->configure();
  home();
  yaw().start(Degrees{-5});
  controller->stop_all();
  controller->pulse_output("shutter");
  for (const std::string& command : peer.heard)
    EXPECT_EQ(command.find('\n'), std::string::npos) << command;
  EXPECT_EQ(peer.heard.at(peer.heard.size() - 2), "O1\r");
  EXPECT_EQ(peer.heard.back(), "O0\r");
}

TEST_F(Sc300Bytes, NamesWhatDiffersAndMovesNothing) {
  peer.replies["XV"] = "XV,19999\r";
  peer.replies["ZA"] = "..,1\r";
  EXPECT_THAT(controller->connect(), ElementsAre("yaw: XV: wanted 20000, found 19999",
                                                 "stage: ZA: wanted 20000, found 1"));
  peer.heard.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().home(); }),
              HasSubstr("XV: wanted 20000, found 19999"));
  EXPECT_THAT(message_of<DeviceError>([&] { controller->configure(); }),
              HasSubstr("ZA: wanted 20000, found 1"));
}

TEST_F(Sc300Bytes, SaysWhoAnsweredInsteadOfAnSc300) {
  peer.replies["TY"] = "SC101\r";
  peer.replies["VE"] = "SC101_V2.0\r";
  const std::string message = message_of<DeviceError>([&] { controller->connect(); });
  EXPECT_THAT(message, HasSubstr("\"SC101\""));
  EXPECT_THAT(message, HasSubstr("expected SC300"));
}

TEST_F(Sc300Bytes, ReadsCountersAsTheControllerWritesThem) {
  for (const auto& [shown, value] :
       std::map<std::string, double>{{"?X,800", 1}, {"?X,-4", -0.005}, {"?x,+8", 0.01}}) {
    peer.replies["?X"] = shown + "\r";
    EXPECT_NEAR(yaw().position().value, value, 1e-12);
  }
  for (const char* odd : {"?X,", "?X,twelve", "?X,1.5", "?X,1e3", "?X", "?Z,5", "?X 5"}) {
    peer.replies["?X"] = std::string(odd) + "\r";
    EXPECT_THROW(yaw().position(), Error) << odd;
  }
}

TEST_F(Sc300Bytes, ReportsErrorRepliesWithTheirCommand) {
  for (const char* code : {"E0", "E1", "ER"}) {
    peer.replies["VE"] = std::string(code) + "\r";
    EXPECT_THAT(message_of<DeviceError>([&] { controller->connect(); }),
                HasSubstr(std::string("\"VE\" was refused with ") + code));
    peer.replies["VE"] = "SC300_V1.0\r";
    controller->connect();
    home();
    peer.replies["+X,7600"] = std::string(code) + "\r";
    const std::string message = message_of<DeviceError>([&] { yaw().start(Degrees{10}); });
    EXPECT_THAT(message, HasSubstr("axis yaw"));
    EXPECT_THAT(message, HasSubstr(std::string("\"+X,7600\" was refused with ") + code));
    EXPECT_THAT(message, HasSubstr("do not define"));
    EXPECT_FALSE(yaw().homed());
    peer.replies["HX"] = std::string(code) + "\r";
    EXPECT_THAT(message_of<DeviceError>([&] { yaw().home(); }),
                HasSubstr(std::string("\"HX\" was refused with ") + code));
  }
}

TEST_F(Sc300Bytes, TakesARefusalThatComesLateForWhatItIs) {
  controller->connect();
  home();
  peer.replies["+X,7600"] = "";
  yaw().start(Degrees{10});
  peer.say("E1\r");
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().advance(); }),
              HasSubstr("\"+X,7600\" was refused with E1"));
}

TEST_F(Sc300Bytes, RefusesToMoveFromAnywhereElse) {
  controller->connect();
  home();
  int asked = 0;
  peer.on_heard = [&](const std::string& command) {
    if (command == "?X" && ++asked == 1) peer.replies["?X"] = "?X,40\r";
  };
  const std::string message = message_of<DeviceError>([&] { yaw().start(Degrees{10}); });
  EXPECT_THAT(message, HasSubstr("stands at 40 instead of 0 pulses"));
  EXPECT_THAT(message, HasSubstr("Nothing was sent"));
  EXPECT_THAT(peer.heard, ElementsAre("?X\r", "?X\r", "?X\r"));
}

TEST_F(Sc300Bytes, ReadsASpoiltCounterAgainBeforeItMoves) {
  controller->connect();
  home();
  int asked = 0;
  peer.on_heard = [&](const std::string& command) {
    if (command != "?X") return;
    ++asked;  // the answer to the second question is spoilt
    peer.replies["?X"] = asked == 1 ? "?X,9\r" : "?X,0\r";
  };
  peer.replies["+X,7600"] = "";
  yaw().start(Degrees{10});
  EXPECT_THAT(peer.heard, ElementsAre("?X\r", "?X\r", "?X\r", "?X\r", "+X,7600\r"));
  // One that reads differently each time is not moved from.
  yaw().stop();
  asked = 0;
  peer.heard.clear();
  peer.on_heard = [&](const std::string& command) {
    if (command == "?X") peer.replies["?X"] = "?X," + std::to_string(asked++) + "\r";
  };
  EXPECT_THROW(yaw().start(Degrees{20}), Error);
  for (const std::string& command : peer.heard) EXPECT_EQ(command, "?X\r");
}

// ---- on the simulator

class ZolixSc300 : public ::testing::TestWithParam<bool>, protected SimulatedSc300 {
 protected:
  ZolixSc300() : SimulatedSc300(GetParam()) {}
};

INSTANTIATE_TEST_SUITE_P(AnswersWhileMoving, ZolixSc300, ::testing::Bool());

TEST_P(ZolixSc300, AgreesWithItsSimulatorAboutTheSetUp) {
  EXPECT_THAT(controller->connect(), ElementsAre());
  EXPECT_THAT(controller->identity(), HasSubstr("channels X Y Z: SC300 SC300_V1.0 ID0000"));
}

TEST_P(ZolixSc300, DoesNotMoveBeforeItIsConnectedAndHomed) {
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{1}); }),
              HasSubstr("not connected"));
  controller->connect();
  wire.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{1}); }), HasSubstr("not homed"));
  EXPECT_EQ(wire.sent(), "");
}

TEST_P(ZolixSc300, ConfiguresAControllerThatIsSetUpDifferently) {
  auto real = sc300_axes();
  real[1].speed = 10;
  real[0].acceleration = 30;
  SimulatedSc300 rig(GetParam(), sc300_axes(), real);
  EXPECT_THAT(rig.controller->connect(), ElementsAre("stage: XA: wanted 20000, found 12000",
                                                     "yaw: YV: wanted 20000, found 8000"));
  EXPECT_THROW(rig.yaw().home(), DeviceError);
  EXPECT_THAT(rig.motions(), ElementsAre());
  rig.controller->configure();
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), 5).position.value, 5.0, 1e-9);
}

TEST_P(ZolixSc300, ArrivesToThePulse) {
  ready();
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 200; ++i) {
    const double target = draws.uniform(-29.5, 30);
    const Arrival<Degrees> arrival = move(yaw(), target);
    EXPECT_FALSE(arrival.missed);
    EXPECT_NEAR(arrival.position.value, target, 0.00125 / 2 + 1e-9);
    EXPECT_NEAR(counter(AxisId::kYaw), arrival.position.value, 1e-9);
    EXPECT_NEAR(truth(AxisId::kYaw), arrival.position.value, 1e-9);
  }
}

TEST_P(ZolixSc300, IsNoSlowerThanItsMotorsAndItsQuestions) {
  ready();
  const Time before = clock.now();
  move(yaw(), 10);
  const double took = seconds(clock.now() - before);
  const double motion = yaw().move_seconds(Degrees{0}, Degrees{10});
  EXPECT_GE(took, motion + 0.1);
  EXPECT_LE(took, motion + 0.1 + 0.15);
}

TEST_P(ZolixSc300, MovesToZeroAndAcrossIt) {
  ready();
  for (const double to : {5.0, 0.0, 0.5, -0.5, 0.00125, -3.0, 0.5, 0.0})
    EXPECT_NEAR(move(yaw(), to).position.value, to, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 0.0, 1e-9);
}

TEST_P(ZolixSc300, MovesTheStageInMillimetres) {
  controller->connect();
  stage().home();
  EXPECT_NEAR(move(stage(), 130.0).position.value, 130.0, 1e-9);
  EXPECT_NEAR(truth(AxisId::kStage), 130.0, 1e-9);
}

TEST_P(ZolixSc300, FindsItsHomeFromWhereverItWasSwitchedOn) {
  for (const double offset : {-40.0, -0.2, 0.0, 17.3}) {
    SimulatedSc300 rig(GetParam(), sc300_axes(), {}, {{AxisId::kYaw, {.home_offset = offset}}});
    rig.controller->connect();
    rig.yaw().home();
    EXPECT_TRUE(rig.yaw().homed());
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9) << offset;
    EXPECT_NEAR(rig.move(rig.yaw(), 5).position.value, 5.0, 1e-9);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 5.0, 1e-9) << offset;
  }
}

TEST_P(ZolixSc300, MovesAxesAtOnceOrOneAfterTheOther) {
  controller->connect();
  yaw().home();
  roll().home();
  stage().home();
  wire.clear();
  const Time before = clock.now();
  yaw().start(Degrees{25});
  roll().start(Degrees{-20});
  stage().start(Millimetres{50});
  wait_all(yaw(), roll(), stage());
  const double took = seconds(clock.now() - before);
  const double a = yaw().move_seconds(Degrees{0}, Degrees{25});
  const double b = roll().move_seconds(Degrees{0}, Degrees{-20});
  const double c = stage().move_seconds(Millimetres{0}, Millimetres{50});
  if (GetParam())
    EXPECT_LT(took, std::max({a, b, c}) + 0.4);
  else
    EXPECT_NEAR(took, a + b + c + 0.4, 0.4);
  EXPECT_NEAR(yaw().arrival().position.value, 25, 1e-9);
  EXPECT_NEAR(roll().arrival().position.value, -20, 1e-9);
  EXPECT_NEAR(stage().arrival().position.value, 50, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 25, 1e-9);
  EXPECT_NEAR(truth(AxisId::kRoll), -20, 1e-9);
  EXPECT_NEAR(truth(AxisId::kStage), 50, 1e-9);
  EXPECT_EQ(motions().size(), 6u);
}

TEST_P(ZolixSc300, MovesPairsOfAxesToManyPlaces) {
  controller->connect();
  yaw().home();
  roll().home();
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 50; ++i) {
    const double to = draws.uniform(-29, 30), other = draws.uniform(-29, 30);
    yaw().start(Degrees{to});
    roll().start(Degrees{other});
    wait_all(yaw(), roll());
    EXPECT_NEAR(truth(AxisId::kYaw), to, 0.000626);
    EXPECT_NEAR(truth(AxisId::kRoll), other, 0.000626);
  }
}

TEST_P(ZolixSc300, KnowsWhereARestingAxisIsWhileAnotherMoves) {
  ready();
  roll().home();
  move(roll(), 3);
  yaw().start(Degrees{25});
  wire.clear();
  EXPECT_NEAR(roll().position().value, 3.0, 1e-9);
  EXPECT_EQ(wire.commands("?Z").empty(), !GetParam());
  roll().stop();  // and stops it without touching the other
  while (!yaw().advance()) {
  }
  EXPECT_NEAR(truth(AxisId::kYaw), 25, 1e-9);
}

TEST_P(ZolixSc300, AsksNothingOfAControllerThatDoesNotListen) {
  ready();
  yaw().start(Degrees{25});
  wire.clear();
  for (int i = 0; i < 10; ++i) yaw().advance();
  EXPECT_EQ(wire.sent().empty(), !GetParam()) << wire.sent();
  while (!yaw().advance()) {
  }
}

TEST_P(ZolixSc300, SwitchesItsOutputs) {
  controller->connect();
  std::string switched;
  simulator->on_output(
      [&](const std::string& name, bool on, Time) { switched += name + (on ? " on " : " off "); });
  controller->pulse_output("shutter");
  EXPECT_EQ(switched, "shutter on shutter off ");
  EXPECT_THROW(controller->pulse_output("lamp"), ConfigError);
}

TEST_P(ZolixSc300, NoticesThatItWasMovedAtItsFrontPanel) {
  ready();
  move(yaw(), 5);
  by_hand("+Y,800");
  wire.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{8}); }),
              HasSubstr("was left at 5 deg and now stands at 6 deg"));
  EXPECT_THAT(motions(), ElementsAre());
  EXPECT_FALSE(yaw().homed());
}

TEST_P(ZolixSc300, IsNotConfusedByLinesThatNobodyAskedFor) {
  ready();
  by_hand("+X,400");  // axes of which this rig moves none
  by_hand("-Z,400");
  EXPECT_NEAR(move(yaw(), 5).position.value, 5.0, 1e-9);
  by_hand("+Y,400");
  by_hand("-Y,400");
  EXPECT_NEAR(move(yaw(), 7).position.value, 7.0, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 7.0, 1e-9);
}

// ---- stopping

TEST_P(ZolixSc300, StopsWhileTheAnswerIsPending) {
  ready();
  for (int polls = 0; polls < 12; ++polls) {
    yaw().start(Degrees{polls % 2 == 0 ? 25.0 : -25.0});
    for (int i = 0; i < polls; ++i) yaw().advance();
    const Time before = clock.now();
    yaw().stop();
    EXPECT_LT(seconds(clock.now() - before), 1.2) << polls;
    EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now())) << polls;
    EXPECT_TRUE(yaw().homed());
    EXPECT_THROW(yaw().advance(), DeviceError);
  }
  EXPECT_NEAR(move(yaw(), 10).position.value, 10.0, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 10.0, 1e-9);
}

TEST_P(ZolixSc300, DoesNotTakeTheLateAnswerOfAStoppedMoveForTheEndOfTheNext) {
  for (double late = 0.1; late < 3; late += 0.1) {
    SimulatedSc300 rig(GetParam());
    rig.ready();
    rig.fault({.kind = FaultKind::kLateReply, .verb = "move", .delay_s = late});
    rig.yaw().start(Degrees{25});
    for (int i = 0; i < 5; ++i) rig.yaw().advance();
    rig.yaw().stop();
    EXPECT_NEAR(rig.move(rig.yaw(), 20).position.value, 20.0, 1e-9) << late;
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 20.0, 1e-9) << late;
    EXPECT_FALSE(rig.simulator->axis(AxisId::kYaw).moving(rig.clock.now()));
  }
}

TEST_P(ZolixSc300, MayBeStoppedInEveryState) {
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

TEST_P(ZolixSc300, StopsAllItsAxes) {
  ready();
  roll().home();
  yaw().start(Degrees{25});
  roll().start(Degrees{-25});
  for (int i = 0; i < 5; ++i) {
    yaw().advance();
    roll().advance();
  }
  controller->stop_all();
  EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now()));
  EXPECT_FALSE(simulator->axis(AxisId::kRoll).moving(clock.now()));
  const std::string sent = wire.sent();
  EXPECT_NEAR(move(roll(), 10).position.value, 10.0, 1e-9);
  EXPECT_NEAR(move(yaw(), 10).position.value, 10.0, 1e-9);
}

TEST_P(ZolixSc300, StopFromAnotherThreadHaltsAndNothingStartsAfterIt) {
  for (int nth = 1; nth <= 30; ++nth) {
    SimulatedSc300 rig(GetParam());
    rig.ready();
    std::atomic<int> sent{0};
    std::thread other;
    rig.wire.on_sent = [&](std::string_view, Time) {
      if (++sent != nth) return;
      std::atomic<bool> begun{false};
      other = std::thread([&] {
        begun = true;
        rig.yaw().stop();
      });
      while (!begun) std::this_thread::yield();
      std::this_thread::sleep_for(milliseconds{10});
    };
    bool stopped = false;
    try {
      rig.move(rig.yaw(), 25);
    } catch (const DeviceError& error) {
      stopped = true;
      EXPECT_THAT(error.what(), HasSubstr("stopped"));
    }
    EXPECT_EQ(stopped, other.joinable());
    if (!other.joinable()) continue;  // fewer things were said than that
    other.join();
    EXPECT_FALSE(rig.simulator->axis(AxisId::kYaw).moving(rig.clock.now()));
    const std::string all = rig.wire.sent();
    EXPECT_EQ(all.find("+Y", all.find("SPY")), std::string::npos);
    EXPECT_TRUE(rig.yaw().homed());
  }
}

}  // namespace
}  // namespace turntable
