// The simulated controller against the bytes of the manual's facts (protocols/README.md).
#include "drivers/sim/mc600.h"

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

class Mc600 : public ::testing::Test {
 protected:
  Mc600() : Mc600(line_pair("line")) {}
  explicit Mc600(std::pair<Line, Line> ends)
      : line(std::move(ends.first)),
        device(simulate_mc600({four_axes(), {}, draws_of_this_test()()})) {
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
  std::string after(Time time) {
    clock.sleep_for(time);
    return heard();
  }
  void home(const std::string& letter) {
    ASSERT_EQ(say("GoHome " + letter), "READY\r");
    ASSERT_EQ(after(seconds{60}), letter + " 0,OK\r");
  }

  ManualClock clock;
  Line line;
  std::unique_ptr<ControllerSimulator> device;
};

TEST_F(Mc600, AnswersHello) { EXPECT_EQ(say("Hello"), "OK\r"); }

TEST_F(Mc600, TakesCommandsInAnyCaseAndEchoesQueriesInUpperCase) {
  EXPECT_EQ(say("hello"), "OK\r");
  EXPECT_EQ(say("position? y"), "POSITION? Y,0,OK\r");
  EXPECT_EQ(say("goposition y,o,a,p,1"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y 1,OK\r");
}

TEST_F(Mc600, AnswersAMoveTwice) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,12.345"), "READY\r");
  EXPECT_EQ(after(milliseconds{100}), "");
  EXPECT_EQ(after(seconds{5}), "Y 12.345,OK\r");
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,12.345,OK\r");
  EXPECT_EQ(say("GoPosition Y,O,A,N,5"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y -5,OK\r");
  EXPECT_EQ(say("GoPosition Y,O,R,P,1.00125"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y -3.99875,OK\r");
  EXPECT_EQ(say("GoPosition Y,O,R,N,1"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y -4.99875,OK\r");
}

TEST_F(Mc600, AWayBackAfterHomingShiftsItsZeroUnseen) {
  EXPECT_EQ(say("SetOffset Y,1.5"), "OK\r");
  EXPECT_EQ(say("SetOffset? Y"), "SETOFFSET? Y,1.5,OK\r");
  EXPECT_EQ(say("GoHome Y"), "READY\r");
  EXPECT_EQ(after(seconds{60}), "Y 0,OK\r");
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,0,OK\r");
  EXPECT_NEAR(device->axis(AxisId::kYaw).true_position(clock.now()), 1.5, 1e-9);
}

TEST_F(Mc600, KnowsWhatItsSistersKnow) {
  EXPECT_EQ(say("SetStageWorkState Y,C"), "OK\r");
  EXPECT_EQ(say("SetStageWorkState? Y"), "SETSTAGEWORKSTATE? Y,C,OK\r");
  EXPECT_EQ(say("SetDriveRat Y,90"), "OK\r");
  EXPECT_EQ(say("SetStageDriveRat? Y"), "SETSTAGEDRIVERAT? Y,90,OK\r");
  EXPECT_EQ(say("SetUserOrigin Y,2"), "OK\r");
  EXPECT_EQ(say("SetUserOrigin? Y"), "SETUSERORIGIN? Y,2,OK\r");
  EXPECT_EQ(say("SetOrigin? Y"), "SETORIGIN? Y,P,OK\r");
}

TEST_F(Mc600, EndsEvenAMoveOfNoLength) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,0"), "READY\rY 0,OK\r");
}

TEST_F(Mc600, MovesSeveralChannelsAtOnce) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,20"), "READY\r");
  EXPECT_EQ(say("GoPosition Z,O,A,P,1"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Z 1,OK\rY 20,OK\r");
}

TEST_F(Mc600, ReadsBackItsSetUp) {
  EXPECT_EQ(say("SetUnit? X"), "SETUNIT? X,m,OK\r");
  EXPECT_EQ(say("SetUnit? Y"), "SETUNIT? Y,d,OK\r");
  EXPECT_EQ(say("SetStageStyle? X"), "SETSTAGESTYLE? X,T,OK\r");
  EXPECT_EQ(say("SetStageStyle? Y"), "SETSTAGESTYLE? Y,R,OK\r");
  EXPECT_EQ(say("SetStagePitch? X"), "SETSTAGEPITCH? X,4,OK\r");
  EXPECT_EQ(say("SetStageStepsRev? Y"), "SETSTAGESTEPSREV? Y,1600,OK\r");
  EXPECT_EQ(say("SetStageDriveRat? Y"), "SETSTAGEDRIVERAT? Y,180,OK\r");
  EXPECT_EQ(say("SetSpeed? Y"), "SETSPEED? Y,25,OK\r");
  EXPECT_EQ(say("SetInitSpeed? Y"), "SETINITSPEED? Y,1,OK\r");
  EXPECT_EQ(say("SetAccSpeed? Y"), "SETACCSPEED? Y,50,OK\r");
  EXPECT_EQ(say("SetUserLimitAble? Y"), "SETUSERLIMITABLE? Y,E,OK\r");
  EXPECT_EQ(say("SetUserPositiveLimit? Y"), "SETUSERPOSITIVELIMIT? Y,30,OK\r");
  EXPECT_EQ(say("SetUserNegativeLimit? Y"), "SETUSERNEGATIVELIMIT? Y,-30,OK\r");
}

TEST_F(Mc600, KeepsWhatItIsSetTo) {
  for (const auto& [verb, value] :
       std::vector<std::pair<std::string, std::string>>{{"SetStageStepsRev", "3200"},
                                                        {"SetStageDriveRat", "90"},
                                                        {"SetSpeed", "12.5"},
                                                        {"SetInitSpeed", "2"},
                                                        {"SetAccSpeed", "40"},
                                                        {"SetHomeSpeed", "3"},
                                                        {"SetStageDistance", "300"},
                                                        {"SetSechHomeMode", "2"},
                                                        {"SetUserLimitAble", "D"},
                                                        {"SetUserPositiveLimit", "20.5"},
                                                        {"SetUserNegativeLimit", "-20.5"}}) {
    EXPECT_EQ(say(verb + " Y," + value), "OK\r") << verb;
    std::string upper = verb;
    for (char& c : upper) c = static_cast<char>(std::toupper(c));
    EXPECT_EQ(say(verb + "? Y"), upper + "? Y," + value + ",OK\r");
  }
}

TEST_F(Mc600, SpeaksInTheUnitThatIsSet) {
  EXPECT_EQ(say("SetUnit Y,s"), "OK\r");
  EXPECT_EQ(say("GoPosition Y,O,A,P,800"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y 800,OK\r");
  EXPECT_EQ(say("SetSpeed? Y"), "SETSPEED? Y,20000,OK\r");
  EXPECT_EQ(say("SetUnit Y,d"), "OK\r");
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,1,OK\r");
  EXPECT_EQ(say("SetUnit X,u"), "OK\r");
  EXPECT_EQ(say("GoPosition X,O,A,P,12.5"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "X 12.5,OK\r");
  EXPECT_EQ(say("SetUnit X,m"), "OK\r");
  EXPECT_EQ(say("Position? X"), "POSITION? X,0.0125,OK\r");
}

TEST_F(Mc600, TurnsTheTableByWhatTheGearDoesAndNotByWhatItWasTold) {
  EXPECT_EQ(say("SetStageDriveRat Y,90"), "OK\r");
  EXPECT_EQ(say("GoPosition Y,O,A,P,4"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y 4,OK\r");
  EXPECT_NEAR(device->axis(AxisId::kYaw).true_position(clock.now()), 2.0, 1e-9);
}

TEST_F(Mc600, HomesOneAxisOrSeveral) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,3"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y 3,OK\r");
  home("Y");
  EXPECT_TRUE(device->axis(AxisId::kYaw).homed(clock.now()));
  EXPECT_EQ(say("GonAxisHome N,Y,N,Y"), "READY\r");
  const std::string lines = after(seconds{60});
  EXPECT_NE(lines.find("Y 0,OK\r"), std::string::npos);
  EXPECT_NE(lines.find("T 0,OK\r"), std::string::npos);
  EXPECT_FALSE(device->axis(AxisId::kRoll).homed(clock.now()));
}

TEST_F(Mc600, ReturnsToItsWorkOrigin) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,3"), "READY\r");
  after(seconds{5});
  EXPECT_EQ(say("SetUserOrigin Y,0"), "OK\r");
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,0,OK\r");
  EXPECT_EQ(say("GoPosition Y,O,A,P,1"), "READY\r");
  after(seconds{5});
  EXPECT_EQ(say("GoOrigion Y"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "Y 0,OK\r");
  EXPECT_NEAR(device->axis(AxisId::kYaw).true_position(clock.now()), 3.0, 1e-9);
}

TEST_F(Mc600, StopsAMoveAndReportsWhereItEnded) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,25"), "READY\r");
  EXPECT_EQ(after(milliseconds{500}), "");
  EXPECT_EQ(say("Stop Y"), "OK\r");
  const std::string ended = after(seconds{5});
  ASSERT_TRUE(ended.starts_with("Y ") && ended.ends_with(",OK\r")) << ended;
  EXPECT_LT(std::stod(ended.substr(2)), 15.0);
  EXPECT_EQ(say("STOP Y"), "OK\r");  // at rest too
  EXPECT_EQ(after(seconds{5}), "");
}

TEST_F(Mc600, DrawsAStraightLineThroughSeveralAxes) {
  EXPECT_EQ(say("GoInterpolationline2 Y,20,Z,-5"), "READY\r");
  clock.sleep_for(milliseconds{300});
  const double y = device->axis(AxisId::kYaw).counter_position(clock.now());
  const double z = device->axis(AxisId::kRoll).counter_position(clock.now());
  EXPECT_GT(y, 0.5);
  EXPECT_NEAR(z, -y / 4, 0.003);
  EXPECT_EQ(after(seconds{5}), "Y 20,OK\rZ -5,OK\r");
  EXPECT_EQ(say("GoInterpolationline3 Y,0,Z,0,X,10"), "READY\r");
  EXPECT_EQ(after(seconds{5}).size(), std::string("Y 0,OK\rZ 0,OK\rX 10,OK\r").size());
}

TEST_F(Mc600, RefusesWhatItDoesNotKnow) {
  for (const char* command : {"Nonsense",
                              "GoPosition",
                              "GoPosition Y",
                              "GoPosition Y,O,A,P",
                              "GoPosition Y,O,A,P,1,2",
                              "GoPosition Y,O,A,Q,1",
                              "GoPosition W,O,A,P,1",
                              "GoPosition Y,O,A,P,-5",
                              "GoPosition Y,O,A,P,1e3",
                              "GoPosition Y,O,A,P,nan",
                              "GoPosition Y,O,A,P,",
                              "SetSpeed Y",
                              "SetSpeed Y,fast",
                              "SetUnit Y,x",
                              "Position?",
                              "Position? W",
                              "Position? Y,1",
                              "Hello there",
                              "GonAxisHome N,N,N,N",
                              "GonAxisHome Y",
                              "GoInterpolationline2 Y,1",
                              "GoInterpolationline2 Y,1,Y,2",
                              "\x01\x7f\xff",
                              "Stop",
                              "SetOrigin Y,Q",
                              "Hello? Y"})
    EXPECT_EQ(say(command), "E01\r") << command;
}

TEST_F(Mc600, RefusesWhatIsNotAllowedNow) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,30.5"), "E02\r");  // soft limit
  EXPECT_EQ(say("GoPosition Y,O,R,N,31"), "E02\r");
  EXPECT_EQ(say("GoInterpolationline2 Y,1,Z,40"), "E02\r");
  EXPECT_EQ(say("GoPosition Y,C,A,P,1"), "E02\r");  // no encoder
  EXPECT_EQ(say("SetSpeed Y,0"), "E02\r");
  EXPECT_EQ(say("SetSpeed Y,-1"), "E02\r");
  EXPECT_EQ(say("SetUnit X,d"), "E02\r");  // degrees of a slide
  EXPECT_EQ(say("GoPosition Y,O,A,P,20"), "READY\r");
  EXPECT_EQ(say("GoPosition Y,O,A,P,1"), "E02\r");  // moving
  EXPECT_EQ(say("GoHome Y"), "E02\r");
  EXPECT_EQ(say("SetSpeed Y,5"), "E02\r");
  EXPECT_EQ(say("LoadDefault"), "E02\r");
  EXPECT_EQ(after(seconds{5}), "Y 20,OK\r");  // none of which disturbed the move
}

TEST_F(Mc600, RefusesAChannelWithoutAStage) {
  const auto device_of_two = simulate_mc600({{rotary_axis(AxisId::kYaw, "X")}, {}, 1});
  auto [near, far] = line_pair("line");
  device_of_two->plug(std::move(far));
  clock.attach(*device_of_two);
  near.write("GoPosition T,O,A,P,1\r", clock, clock.now());
  clock.sleep_until(clock.now());
  std::array<char, 64> buffer;
  EXPECT_EQ(std::string(buffer.data(), near.read_available(buffer, clock.now())), "E02\r");
  clock.detach(*device_of_two);
}

TEST_F(Mc600, MovesAnywhereWithItsSoftLimitsOff) {
  EXPECT_EQ(say("SetUserLimitAble Y,D"), "OK\r");
  EXPECT_EQ(say("GoPosition Y,O,A,P,90"), "READY\r");
  EXPECT_EQ(after(seconds{60}), "Y 90,OK\r");
  EXPECT_EQ(say("GoPosition Y,O,A,P,9000"), "READY\r");  // until the mechanics end
  after(seconds{600});
  EXPECT_TRUE(device->axis(AxisId::kYaw).at_hard_limit(clock.now()));
}

TEST_F(Mc600, GoesBackToFactorySettings) {
  EXPECT_EQ(say("SetStageDriveRat Y,90"), "OK\r");
  EXPECT_EQ(say("LoadDefault"), "OK\r");
  EXPECT_EQ(say("SetStageDriveRat? Y"), "SETSTAGEDRIVERAT? Y,180,OK\r");
  EXPECT_EQ(say("SetUserLimitAble? Y"), "SETUSERLIMITABLE? Y,D,OK\r");
}

TEST_F(Mc600, PutsSplitCommandsTogetherAndTakesSeveralAtOnce) {
  EXPECT_EQ(raw("Posi"), "");
  EXPECT_EQ(raw("tion? Y"), "");
  EXPECT_EQ(raw("\rHello\r\nPosition? Z\r"), "POSITION? Y,0,OK\rOK\rPOSITION? Z,0,OK\r");
  EXPECT_EQ(raw("\r\r\r"), "");
}

TEST_F(Mc600, SurvivesNoise) {
  EXPECT_EQ(raw(std::string(10000, '#')), "");
  EXPECT_EQ(raw("\r"), "E01\r");
  EXPECT_EQ(say("Hello"), "OK\r");
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 500; ++i) {
    std::string noise;
    for (int n = 0; n < 40; ++n) noise += static_cast<char>(draws() & 0xff);
    raw(noise);
  }
  raw("\r");
  EXPECT_EQ(say("Hello"), "OK\r");
}

TEST_F(Mc600, KeepsItsStateWhileTheCableIsOut) {
  EXPECT_EQ(say("GoPosition Y,O,A,P,20"), "READY\r");
  device->unplug();
  clock.sleep_for(seconds{5});
  auto [near, far] = line_pair("line");
  line = std::move(near);
  device->plug(std::move(far));
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,20,OK\r");
}

// ---- faults

TEST_F(Mc600, FaultsStrikeTheCommandTheyAreMeantFor) {
  device->add_fault({.kind = FaultKind::kSilence, .verb = "position?", .nth = 2, .times = 2});
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,0,OK\r");
  EXPECT_EQ(say("Position? Y"), "");
  EXPECT_EQ(say("Hello"), "OK\r");
  EXPECT_EQ(say("Position? Y"), "");
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,0,OK\r");
}

TEST_F(Mc600, SilenceDoesNothingAndALostReplyDoesItUnheard) {
  device->add_fault({.kind = FaultKind::kSilence, .verb = "GoPosition"});
  EXPECT_EQ(say("GoPosition Y,O,A,P,1"), "");
  EXPECT_EQ(after(seconds{5}), "");
  device->add_fault({.kind = FaultKind::kLostReply, .verb = "GoPosition"});
  EXPECT_EQ(say("GoPosition Y,O,A,P,1"), "");
  EXPECT_EQ(after(seconds{5}), "Y 1,OK\r");
}

TEST_F(Mc600, SpoilsRepliesAsTold) {
  device->add_fault({.kind = FaultKind::kGarbage, .nth = 1, .text = "??"});
  device->add_fault({.kind = FaultKind::kTruncatedReply, .nth = 2});
  device->add_fault({.kind = FaultKind::kSplitReply, .nth = 3, .delay_s = 0.5});
  device->add_fault({.kind = FaultKind::kLateReply, .nth = 4, .delay_s = 0.5});
  device->add_fault({.kind = FaultKind::kDuplicatedLine, .nth = 5});
  device->add_fault({.kind = FaultKind::kErrorReply, .nth = 6, .text = "E02"});
  EXPECT_EQ(say("Position? Y"), "??POSITION? Y,0,OK\r");
  EXPECT_EQ(say("Position? Y"), "POSITION");
  EXPECT_EQ(say("Position? Y"), "POSITION");
  EXPECT_EQ(after(milliseconds{500}), "? Y,0,OK\r");
  EXPECT_EQ(say("Position? Y"), "");
  EXPECT_EQ(after(milliseconds{500}), "POSITION? Y,0,OK\r");
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,0,OK\rPOSITION? Y,0,OK\r");
  EXPECT_EQ(say("Position? Y"), "E02\r");
}

TEST_F(Mc600, ForgetsWhereItIsAfterAReset) {
  device->add_fault({.kind = FaultKind::kReset, .verb = "GoPosition", .delay_s = 0.5});
  EXPECT_EQ(say("GoPosition Y,O,A,P,20"), "READY\r");
  EXPECT_EQ(after(seconds{5}), "");
  EXPECT_EQ(say("Position? Y"), "POSITION? Y,0,OK\r");
  EXPECT_GT(device->axis(AxisId::kYaw).true_position(clock.now()), 1.0);
}

TEST_F(Mc600, UnplugsItself) {
  device->add_fault({.kind = FaultKind::kUnplugged, .verb = "GoPosition", .delay_s = 0.5});
  EXPECT_EQ(say("GoPosition Y,O,A,P,20"), "READY\r");
  EXPECT_THROW(after(seconds{1}), LineError);
}

}  // namespace
}  // namespace turntable::sim
