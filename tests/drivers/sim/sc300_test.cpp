// The simulated controller against the bytes of the manual's facts (protocols/README.md).
#include "drivers/sim/sc300.h"

#include <gtest/gtest.h>

#include <array>
#include <string>

#include "src/core/errors.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

/// Both answers to what the manual leaves open.
class Sc300 : public ::testing::TestWithParam<bool> {
 protected:
  Sc300() : Sc300(line_pair("line")) {}
  explicit Sc300(std::pair<Line, Line> ends) : line(std::move(ends.first)) {
    SimulatorSetup setup{
        {linear_axis("X"), rotary_axis(AxisId::kYaw, "Y")}, {}, draws_of_this_test()()};
    setup.controller.answers_while_moving = GetParam();
    OutputConfig& output = setup.controller.outputs.emplace_back();
    output.name = "shutter";
    output.on_text = "O1";
    output.off_text = "O0";
    device = simulate_sc300(setup);
    device->plug(std::move(ends.second));
    clock.attach(*device);
  }

  /// Sends bytes as they are, and returns all that comes back at once.
  std::string raw(const std::string& bytes) {
    line.write(bytes, clock, clock.now());
    clock.sleep_until(clock.now());
    return heard();
  }
  std::string say(const std::string& command) { return raw(command + "\r"); }
  std::string heard() {
    std::array<char, 1024> buffer;
    return {buffer.data(), line.read_available(buffer, clock.now())};
  }
  /// Both answers of a command: the one now, and the one at its end.
  std::string done(const std::string& command) {
    const std::string now = say(command);
    return now + after(seconds{5});
  }
  std::string after(Time time) {
    clock.sleep_for(time);
    return heard();
  }
  /// What comes back while something moves, if the controller listens.
  std::string if_heard(const std::string& reply) { return GetParam() ? reply : ""; }

  ManualClock clock;
  Line line;
  std::unique_ptr<ControllerSimulator> device;
};

INSTANTIATE_TEST_SUITE_P(AnswersWhileMoving, Sc300, ::testing::Bool());

TEST_P(Sc300, SaysWhatItIs) {
  EXPECT_EQ(raw("\r"), "OK\r");
  EXPECT_EQ(say("VE"), "SC300_V1.0\r");
  EXPECT_EQ(say("TY"), "SC300\r");
  EXPECT_EQ(say("ID"), "ID0000\r");
  EXPECT_EQ(say("?Y"), "?Y,0\r");
}

TEST_P(Sc300, KeepsSpeedsAndAccelerationInPulses) {
  EXPECT_EQ(say("YV"), "YV,20000\r");
  EXPECT_EQ(say("YF"), "YF,800\r");
  EXPECT_EQ(say("YA"), "YA,40000\r");
  EXPECT_EQ(say("XV"), "XV,8000\r");
  EXPECT_EQ(say("VY,10000"), "OK\r");
  EXPECT_EQ(say("FY,2500"), "OK\r");
  EXPECT_EQ(say("AY,30000"), "OK\r");
  EXPECT_EQ(say("YV"), "YV,10000\r");
  EXPECT_EQ(say("YF"), "YF,2500\r");
  EXPECT_EQ(say("YA"), "YA,30000\r");
  EXPECT_EQ(say("XV"), "XV,8000\r");
  const Time before = clock.now();
  EXPECT_EQ(say("+Y,20000"), "");
  EXPECT_TRUE(clock.wait_readable(line.descriptor(), before + seconds{10}));
  // (v - f)/a twice, and the rest of the way at v
  EXPECT_NEAR(turntable::seconds(clock.now() - before), 2 * 0.25 + (20000 - 12500 * 0.25) / 1e4,
              1e-6);
}

TEST_P(Sc300, AnswersAMoveWhenItHasEnded) {
  EXPECT_EQ(say("+Y,9876"), "");
  EXPECT_EQ(after(milliseconds{100}), "");
  EXPECT_EQ(after(seconds{5}), "?Y,9876\r");
  EXPECT_EQ(say("-Y,10000"), "");
  EXPECT_EQ(after(seconds{5}), "?Y,-124\r");
  EXPECT_EQ(say("?Y"), "?Y,-124\r");
  EXPECT_NEAR(device->axis(AxisId::kYaw).true_position(clock.now()), -0.155, 1e-9);
}

TEST_P(Sc300, AnswersAHomingWhenItHasEnded) {
  EXPECT_EQ(say("+Y,800"), "");
  EXPECT_EQ(after(seconds{5}), "?Y,800\r");
  EXPECT_EQ(say("HY"), "");
  EXPECT_EQ(after(seconds{60}), "?Y,0\r");
  EXPECT_TRUE(device->axis(AxisId::kYaw).homed(clock.now()));
  EXPECT_EQ(say("?Y"), "?Y,0\r");
}

TEST_P(Sc300, HearsInMidMoveWhatItsSetUpSays) {
  EXPECT_EQ(say("+Y,20000"), "");
  EXPECT_EQ(after(milliseconds{500}), "");
  const std::string place = say("?Y");
  EXPECT_EQ(place.starts_with("?Y,"), GetParam()) << place;
  EXPECT_EQ(raw("\r"), if_heard("OK\r"));
  EXPECT_EQ(say("XV"), if_heard("XV,8000\r"));
  EXPECT_EQ(say("O1"), if_heard("OK\r"));
  EXPECT_EQ(say("VX,7000"), if_heard("OK\r"));
  EXPECT_EQ(say("VY,7000"), if_heard("E1\r"));  // it moves
  EXPECT_EQ(say("+Y,1"), if_heard("E1\r"));
  EXPECT_EQ(say("HY"), if_heard("E1\r"));
  EXPECT_EQ(after(seconds{5}), "?Y,20000\r");
  EXPECT_EQ(say("XV"), GetParam() ? "XV,7000\r" : "XV,8000\r");
}

TEST_P(Sc300, MovesTwoChannelsAtOnceIfItListens) {
  EXPECT_EQ(say("+Y,16000"), "");
  EXPECT_EQ(say("+X,400"), "");
  EXPECT_EQ(after(seconds{5}), if_heard("?X,400\r") + "?Y,16000\r");
  EXPECT_EQ(say("?X"), GetParam() ? "?X,400\r" : "?X,0\r");
}

TEST_P(Sc300, StopsAndAnswersTheMoveWithWhereItEnded) {
  EXPECT_EQ(say("+Y,20000"), "");
  EXPECT_EQ(after(milliseconds{500}), "");
  EXPECT_EQ(say("SPY"), "OK\r");
  const std::string ended = after(seconds{5});
  ASSERT_TRUE(ended.starts_with("?Y,")) << ended;
  EXPECT_LT(std::stoi(ended.substr(3)), 16000);
  EXPECT_EQ(say("?Y"), ended);
  EXPECT_EQ(say("SPY"), "OK\r");  // at rest too
  EXPECT_EQ(after(seconds{5}), "");
}

TEST_P(Sc300, RefusesWhatItDoesNotKnow) {
  for (const char* command :
       {"Nonsense", "ve",     "VE,1", "+",      "+Y",   "+Y,",          "+Y,-5", "+Y,1.5",
        "+Y,1e3",   "+Y,1,",  "+W,1", "Y,1",    "?",    "?W",           "?Y,1",  "?y",
        "H",        "HW",     "HY,1", "SP",     "SPW",  "SPY,1",        "VY",    "VY,",
        "VY,fast",  "QY,1",   "YQ",   "WV",     "VW,1", "\x01\x7f\xff", "?Y\n",  "\n?Y",
        "\n",       "+Y,1\n", "O2",   "1234567"})
    EXPECT_EQ(say(command), "E0\r") << command;
  EXPECT_EQ(say("?Y"), "?Y,0\r");
}

TEST_P(Sc300, RefusesWhatIsNotAllowed) {
  for (const char* command : {"+Y,0", "-Y,0", "+Y,100000000", "VY,0", "FY,-1", "AY,100000000",
                              "+Z,1", "?Z", "HZ", "SPZ", "ZV", "VZ,1"})
    EXPECT_EQ(say(command), "E1\r") << command;
}

TEST_P(Sc300, SwitchesTheOutputsOfTheRigFile) {
  std::string switched;
  device->on_output(
      [&](const std::string& name, bool on, Time) { switched += name + (on ? " on " : " off "); });
  EXPECT_EQ(say("O1"), "OK\r");
  EXPECT_EQ(say("O0"), "OK\r");
  EXPECT_EQ(switched, "shutter on shutter off ");
}

TEST_P(Sc300, EndsAMoveAtALimitSwitch) {
  device->add_fault({.kind = FaultKind::kLimitHit, .verb = "move", .delay_s = 0.5});
  EXPECT_EQ(say("+Y,20000"), "");
  const std::string ended = after(seconds{5});
  ASSERT_TRUE(ended.starts_with("?Y,")) << ended;
  EXPECT_LT(std::stoi(ended.substr(3)), 16000);
  EXPECT_EQ(done("+Y,100"), ended);  // it is still on
  EXPECT_EQ(done("-Y,100"), "?Y," + std::to_string(std::stoi(ended.substr(3)) - 100) + "\r");
  EXPECT_EQ(say("+Y,9999999"), "");
  after(seconds{600});
  EXPECT_TRUE(device->axis(AxisId::kYaw).at_hard_limit(clock.now()));
}

TEST_P(Sc300, DoesNotMoveWhileTheEmergencyStopOrAnAlarmIsOn) {
  device->add_fault({.kind = FaultKind::kEmergencyStop, .verb = "move", .delay_s = 0.5});
  EXPECT_EQ(say("+Y,20000"), "");
  EXPECT_EQ(after(seconds{5}).substr(0, 3), "?Y,");
  EXPECT_EQ(say("+Y,100"), "ER\r");
  EXPECT_EQ(say("HY"), "ER\r");
  device->clear_trouble();
  device->add_fault({.kind = FaultKind::kAlarm, .verb = "move", .nth = 1, .delay_s = 0.1});
  EXPECT_EQ(say("+Y,20000"), "");
  after(seconds{5});
  EXPECT_EQ(say("+Y,100"), "ER\r");
  EXPECT_EQ(say("+X,100"), "");
}

TEST_P(Sc300, PutsSplitCommandsTogetherAndTakesSeveralAtOnce) {
  EXPECT_EQ(raw("?"), "");
  EXPECT_EQ(raw("Y"), "");
  EXPECT_EQ(raw("\r\rTY\r"), "?Y,0\rOK\rSC300\r");
}

TEST_P(Sc300, SurvivesNoise) {
  EXPECT_EQ(raw(std::string(10000, '#')), "");
  EXPECT_EQ(raw("\r"), "E0\r");
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 500; ++i) {
    std::string noise;
    for (int n = 0; n < 40; ++n) noise += static_cast<char>(draws() & 0xff);
    raw(noise);
  }
  raw("\r");
  EXPECT_EQ(say("TY"), "SC300\r");
}

TEST_P(Sc300, KeepsMovingWhileTheCableIsOut) {
  EXPECT_EQ(say("+Y,16000"), "");
  device->unplug();
  clock.sleep_for(seconds{5});
  auto [near, far] = line_pair("line");
  line = std::move(near);
  device->plug(std::move(far));
  EXPECT_EQ(say("?Y"), "?Y,16000\r");
}

// ---- faults

TEST_P(Sc300, NotesRequestsByWordAndKind) {
  device->note_requests();
  for (const char* command : {"VE", "VY,20000", "YV", "?Y", "O1", "HY", "SPY", "+X,5"})
    say(command);
  say("");
  std::string noted;
  for (const auto& request : device->requests())
    noted += request.verb + "/" + request.kind +
             (request.axis ? "/" + std::string(axis_name(*request.axis)) : "") + " ";
  EXPECT_EQ(noted,
            "VE/get VY/set/yaw YV/get/yaw ?Y/status/yaw O1/set HY/home/yaw SPY/stop/yaw "
            "+X/move/stage cr/get ");
}

TEST_P(Sc300, SpoilsTheAnswerOfAMoveWhenItIsDue) {
  for (const FaultKind kind :
       {FaultKind::kGarbage, FaultKind::kTruncatedReply, FaultKind::kSplitReply,
        FaultKind::kLateReply, FaultKind::kDuplicatedLine, FaultKind::kLostReply,
        FaultKind::kLostCompletion, FaultKind::kCorruptReply})
    device->add_fault({.kind = kind,
                       .verb = "+y",
                       .nth = 1 + static_cast<int>(kind),
                       .delay_s = 10,
                       .text = "??"});
  const auto ended = [&](int to) { return "?Y," + std::to_string(to) + "\r"; };
  for (int k = 1; k <= 17; ++k) {
    EXPECT_EQ(say("+Y,1000"), "") << k;  // never at once
    const std::string soon = after(seconds{5}), late = after(seconds{10});
    const std::string whole = ended(1000 * k);
    const std::string half = whole.substr(0, whole.size() / 2);
    switch (static_cast<FaultKind>(k - 1)) {
      case FaultKind::kGarbage:
        EXPECT_EQ(soon, "??" + whole);
        break;
      case FaultKind::kTruncatedReply:
        EXPECT_EQ(soon + late, half);
        break;
      case FaultKind::kSplitReply:
        EXPECT_EQ(soon, half);
        EXPECT_EQ(soon + late, whole);
        break;
      case FaultKind::kLateReply:
        EXPECT_EQ(soon, "");
        EXPECT_EQ(late, whole);
        break;
      case FaultKind::kDuplicatedLine:
        EXPECT_EQ(soon, whole + whole);
        break;
      case FaultKind::kLostReply:
      case FaultKind::kLostCompletion:
        EXPECT_EQ(soon + late, "");
        break;
      case FaultKind::kCorruptReply:
        EXPECT_NE(soon, whole);
        EXPECT_EQ(soon.size(), whole.size());
        break;
      default:
        EXPECT_EQ(soon, whole);
    }
  }
}

TEST_P(Sc300, RefusesAsTold) {
  device->add_fault({.kind = FaultKind::kErrorReply, .verb = "move", .text = "E1"});
  EXPECT_EQ(say("+Y,1000"), "E1\r");
  EXPECT_EQ(after(seconds{5}), "");
  EXPECT_EQ(say("?Y"), "?Y,0\r");
}

TEST_P(Sc300, ForgetsWhereItIsAfterAReset) {
  device->add_fault({.kind = FaultKind::kReset, .verb = "move", .delay_s = 0.5});
  EXPECT_EQ(say("+Y,16000"), "");
  EXPECT_EQ(after(seconds{5}), "");
  EXPECT_EQ(say("?Y"), "?Y,0\r");
  EXPECT_GT(device->axis(AxisId::kYaw).true_position(clock.now()), 1.0);
}

TEST(Sc300Simulator, RefusesAnyOtherChannel) {
  EXPECT_THROW(simulate_sc300({{rotary_axis(AxisId::kYaw, "T")}, {}, 1}), ConfigError);
}

}  // namespace
}  // namespace turntable::sim
