// The driver on a simulator that misbehaves: each fault ends in the right error or in the right
// place, never in a motion command sent twice, and leaves a driver that can go on after a stop.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "drivers/motion.h"
#include "src/core/errors.h"
#include "tests/support/simulated_mc600.h"

namespace turntable {
namespace {

using sim::FaultKind;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class Faults : public ::testing::Test, protected SimulatedMc600 {
 protected:
  Faults() { ready(); }

  /// 10 deg: one leg to 9.5 and one to 10. @return virtual time it took, s.
  double move_to_ten() {
    const Time before = clock.now();
    const Arrival<Degrees> arrival = move(yaw(), 10);
    EXPECT_FALSE(arrival.missed);
    EXPECT_NEAR(arrival.position.value, 10.0, 1e-9);
    EXPECT_NEAR(counter(AxisId::kYaw), 10.0, 1e-9);
    expect_two_commands();
    return seconds(clock.now() - before);
  }
  void expect_two_commands() {
    EXPECT_THAT(wire.commands("GoPosition"),
                ElementsAre("GoPosition Y,O,A,P,9.5", "GoPosition Y,O,A,P,10"));
  }
  template <class E>
  std::string fails_to_move() {
    try {
      move(yaw(), 10);
    } catch (const E& error) {
      return error.what();
    } catch (const std::exception& error) {
      ADD_FAILURE() << "another kind of error: " << error.what();
      return {};
    }
    ADD_FAILURE() << "arrived";
    return {};
  }
  /// After an error: nothing doubled, not homed, and usable again.
  void expect_recovery() {
    const auto commands = wire.commands("GoPosition");
    EXPECT_EQ(commands.size(), std::set(commands.begin(), commands.end()).size());
    EXPECT_FALSE(yaw().homed());
    EXPECT_THROW(yaw().start(Degrees{1}), DeviceError);
    yaw().stop();
    EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now()));
    yaw().home();
    EXPECT_NEAR(move(yaw(), 3).position.value, 3.0, 1e-9);
  }
  double undisturbed() {
    SimulatedMc600 rig;
    rig.ready();
    const Time before = rig.clock.now();
    rig.move(rig.yaw(), 10);
    return seconds(rig.clock.now() - before);
  }
};

TEST_F(Faults, NoiseBeforeEveryReplyIsSurvived) {
  fault({.kind = FaultKind::kGarbage, .times = kForEver});
  EXPECT_NEAR(move_to_ten(), undisturbed(), 1e-9);
}

TEST_F(Faults, NoiseThatSpoilsAReplyIsAskedAgain) {
  fault(
      {.kind = FaultKind::kGarbage, .verb = "Position?", .nth = 3, .times = 2, .text = "\x01\x02"});
  move_to_ten();
}

TEST_F(Faults, SplitRepliesArePutTogether) {
  fault({.kind = FaultKind::kSplitReply, .times = kForEver, .delay_s = 0.02});
  move_to_ten();
}

TEST_F(Faults, TruncatedRepliesAreAskedAgain) {
  fault({.kind = FaultKind::kTruncatedReply, .verb = "Position?", .nth = 2});
  fault({.kind = FaultKind::kTruncatedReply, .verb = "Position?", .nth = 7});
  move_to_ten();
}

TEST_F(Faults, CorruptRepliesAreAskedAgain) {
  fault({.kind = FaultKind::kCorruptReply, .verb = "Position?", .nth = 4});
  move_to_ten();
}

TEST_F(Faults, LateRepliesAreNotTakenForLaterOnes) {
  fault({.kind = FaultKind::kLateReply, .verb = "Position?", .nth = 5, .delay_s = 1.2});
  fault({.kind = FaultKind::kLateReply, .verb = "Position?", .nth = 9, .delay_s = 0.5});
  move_to_ten();
}

TEST_F(Faults, RepliesThatComeTwiceAreHeardOnce) {
  fault({.kind = FaultKind::kDuplicatedLine, .times = kForEver});
  EXPECT_NEAR(move_to_ten(), undisturbed(), 1e-9);
}

TEST_F(Faults, ALostAcknowledgementIsResolvedByReadingPositions) {
  fault({.kind = FaultKind::kLostReply, .verb = "GoPosition", .times = 2});
  move_to_ten();
}

TEST_F(Faults, AnAcknowledgementThatComesTooLateIsResolvedToo) {
  fault({.kind = FaultKind::kLateReply, .verb = "GoPosition", .times = 2, .delay_s = 1.5});
  move_to_ten();
}

TEST_F(Faults, ALostCompletionLineIsResolvedByReadingPositions) {
  fault({.kind = FaultKind::kLostCompletion, .verb = "GoPosition", .times = 2});
  EXPECT_LT(move_to_ten(), undisturbed() + 0.3);
}

TEST_F(Faults, ACommandThatNeverArrivedIsNotSentAgain) {
  fault({.kind = FaultKind::kSilence, .verb = "GoPosition"});
  const Time before = clock.now();
  EXPECT_THAT(fails_to_move<TimeoutError>(),
              HasSubstr("had not acknowledged the command, which was not sent again"));
  EXPECT_LT(seconds(clock.now() - before), 4.0);
  EXPECT_EQ(wire.commands("GoPosition").size(), 1u);
  expect_recovery();
}

TEST_F(Faults, SilenceTimesOutWithinTheDeadlineOfTheMove) {
  const MotionAxis<Degrees>& axis = dynamic_cast<MotionAxis<Degrees>&>(yaw());
  for (const int nth : {1, 2, 5, 10}) {
    SimulatedMc600 rig;
    rig.ready();
    rig.fault({.kind = FaultKind::kSilence, .nth = nth, .times = kForEver});
    const Time before = rig.clock.now();
    EXPECT_THROW(rig.move(rig.yaw(), 10), TimeoutError) << nth;
    EXPECT_LE(seconds(rig.clock.now() - before),
              0.2 + axis.deadline_seconds(Degrees{9.5}) + 3 * 1.0 + 2 * 0.3 /* reads under way */)
        << nth;
    const auto commands = rig.wire.commands("GoPosition");
    EXPECT_LE(commands.size(), 1u);
    EXPECT_FALSE(rig.yaw().homed());
    EXPECT_THROW(rig.yaw().stop(), TimeoutError);  // it cannot be verified
  }
}

TEST_F(Faults, ErrorRepliesAreReportedWithTheirCommandAndLoseTheReference) {
  for (const char* code : {"E01", "E02", "E07"}) {
    SimulatedMc600 rig;
    rig.ready();
    rig.fault({.kind = FaultKind::kErrorReply, .verb = "GoPosition", .text = code});
    try {
      rig.move(rig.yaw(), 10);
      ADD_FAILURE();
    } catch (const DeviceError& error) {
      EXPECT_THAT(error.what(),
                  HasSubstr(std::string("\"GoPosition Y,O,A,P,9.5\" was refused with ") + code));
    }
    EXPECT_EQ(rig.wire.commands("GoPosition").size(), 1u);
    EXPECT_FALSE(rig.yaw().homed());
  }
}

TEST_F(Faults, AStuckAxisIsNoticedByTheWatchdogBeforeTheDeadline) {
  fault({.kind = FaultKind::kStuckAxis, .verb = "GoPosition", .delay_s = 0.3});
  const Time before = clock.now();
  EXPECT_THAT(fails_to_move<TimeoutError>(), HasSubstr("stalled at"));
  EXPECT_LT(seconds(clock.now() - before), 0.3 + 1.3);
  EXPECT_EQ(wire.commands("GoPosition").size(), 1u);
  EXPECT_FALSE(yaw().homed());
}

TEST_F(Faults, ABlockedTableIsBeyondWhatAPulseCounterCanSee) {
  fault({.kind = FaultKind::kBlockedTable, .verb = "GoPosition", .delay_s = 0.3});
  move_to_ten();
  EXPECT_LT(truth(AxisId::kYaw), 9.0);
}

TEST_F(Faults, AResetInMidMoveIsNoticedWhereverItComes) {
  for (double delay = 0.02; delay < 1.0; delay += 0.05) {
    SimulatedMc600 rig;
    rig.ready();
    rig.move(rig.yaw(), -8);
    rig.fault({.kind = FaultKind::kReset, .verb = "GoPosition", .delay_s = delay});
    EXPECT_THROW(rig.move(rig.yaw(), 7), Error) << delay;
    EXPECT_FALSE(rig.yaw().homed());
    rig.yaw().stop();
    rig.yaw().home();
    EXPECT_NEAR(rig.move(rig.yaw(), 3).position.value, 3.0, 1e-9);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 3.0, 1e-9);
  }
}

TEST_F(Faults, AResetOnTheWayToZeroIsNotTakenForArriving) {
  int noticed = 0, all = 0;
  for (double delay = 0.02; delay < 0.7; delay += 0.02, ++all) {
    SimulatedMc600 rig;
    rig.ready();
    rig.move(rig.yaw(), -15);
    rig.fault({.kind = FaultKind::kReset, .verb = "GoPosition", .delay_s = delay});
    try {
      rig.move(rig.yaw(), 0.5);  // the first leg ends at 0, where a reset puts the counter
    } catch (const Error&) {
      ++noticed;
    }
  }
  EXPECT_EQ(noticed, all);
}

TEST_F(Faults, AnUnpluggedLineIsNamedAndAFreshDriverGoesOn) {
  fault({.kind = FaultKind::kUnplugged, .verb = "GoPosition", .delay_s = 0.3});
  EXPECT_THAT(fails_to_move<LineError>(), HasSubstr("gone"));
  EXPECT_THROW(yaw().stop(), LineError);
  EXPECT_FALSE(yaw().homed());
  auto [near, far] = line_pair("line again");
  WireRecord record;
  near.set_log(record.log());
  simulator->plug(std::move(far));
  ControllerConfig config;
  config.name = "mc600";
  config.model = "zolix-mc600";
  const auto again = open_controller({config, four_axes(), std::move(near), &clock});
  EXPECT_THAT(again->connect(), ElementsAre());
  again->stop_all();
  Axis<Degrees>& axis = *again->rotary_axis(AxisId::kYaw);
  EXPECT_FALSE(axis.homed());
  axis.home();
  EXPECT_NEAR(move(axis, 3).position.value, 3.0, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 3.0, 1e-9);
}

TEST_F(Faults, HomingSurvivesALostAcknowledgementAndNeverStartsTwice) {
  for (const FaultKind kind : {FaultKind::kLostReply, FaultKind::kGarbage,
                               FaultKind::kDuplicatedLine, FaultKind::kTruncatedReply}) {
    move(yaw(), 5);
    wire.clear();
    fault({.kind = kind, .verb = "GoHome", .text = "??"});
    yaw().home();
    EXPECT_TRUE(yaw().homed());
    EXPECT_THAT(wire.commands("GoHome"), ElementsAre("GoHome Y"));
    EXPECT_NEAR(truth(AxisId::kYaw), 0.0, 1e-9);
  }
}

TEST_F(Faults, ACounterAtZeroIsNotTakenForAHomedAxis) {
  move(yaw(), 5);
  fault({.kind = FaultKind::kReset, .verb = "GoHome", .delay_s = 0.2});
  EXPECT_THROW(yaw().home(), TimeoutError);
  EXPECT_FALSE(yaw().homed());
  yaw().home();
  EXPECT_NEAR(truth(AxisId::kYaw), 0.0, 1e-9);
  move(yaw(), 5);
  fault({.kind = FaultKind::kLostCompletion, .verb = "GoHome"});
  EXPECT_THROW(yaw().home(), TimeoutError);
  yaw().home();
  EXPECT_NEAR(truth(AxisId::kYaw), 0.0, 1e-9);
}

TEST_F(Faults, ALostHomeCommandIsNotTakenForAHomedAxis) {
  fault({.kind = FaultKind::kSilence, .verb = "GoHome"});
  EXPECT_THROW(yaw().home(), TimeoutError);  // the counter says 0 all the time
  EXPECT_FALSE(yaw().homed());
  EXPECT_THAT(wire.commands("GoHome"), ElementsAre("GoHome Y"));
}

TEST_F(Faults, HomingIsBoundedInTime) {
  move(yaw(), 20);
  fault({.kind = FaultKind::kStuckAxis, .verb = "GoHome", .delay_s = 0.5});
  const Time before = clock.now();
  EXPECT_THROW(yaw().home(), TimeoutError);
  EXPECT_LT(seconds(clock.now() - before), 3.0);
  EXPECT_FALSE(yaw().homed());
}

TEST_F(Faults, RandomFaultsEndInTheRightPlaceOrInAnError) {
  int arrived = 0, failed = 0;
  for (std::uint64_t k = 0; k < 300; ++k) {
    Random draws = draws_of_this_test(k);
    SimulatedMc600 rig;
    rig.ready();
    constexpr std::array kKinds{
        FaultKind::kSilence,        FaultKind::kLostReply,      FaultKind::kGarbage,
        FaultKind::kTruncatedReply, FaultKind::kSplitReply,     FaultKind::kLateReply,
        FaultKind::kDuplicatedLine, FaultKind::kLostCompletion, FaultKind::kErrorReply,
        FaultKind::kReset,          FaultKind::kStuckAxis,      FaultKind::kUnplugged};
    for (int n = 0; n < 2; ++n)
      rig.fault({.kind = kKinds[draws() % kKinds.size()],
                 .verb = draws.uniform() < 0.5 ? "GoPosition" : "Position?",
                 .nth = 1 + static_cast<int>(draws() % 20),
                 .delay_s = draws.uniform(0, 2),
                 .text = "E02"});
    std::size_t commands = 0;
    try {
      for (int move_number = 0; move_number < 5; ++move_number) {
        const double target = draws.uniform(-25, 25);
        rig.wire.clear();
        const auto arrival = rig.move(rig.yaw(), target);
        commands = rig.wire.commands("GoPosition").size();
        EXPECT_LE(commands, 2u + 2u * static_cast<unsigned>(arrival.retries)) << k;
        EXPECT_NEAR(arrival.position.value, target, 0.002) << k;
        EXPECT_NEAR(rig.truth(AxisId::kYaw), target, 0.002) << k;
      }
      ++arrived;
    } catch (const Error&) {
      ++failed;
      EXPECT_LE(rig.wire.commands("GoPosition").size(), 2u);
      EXPECT_FALSE(rig.yaw().homed()) << k;
    }
  }
  EXPECT_GT(arrived, 50);
  EXPECT_GT(failed, 50);
}

}  // namespace
}  // namespace turntable
