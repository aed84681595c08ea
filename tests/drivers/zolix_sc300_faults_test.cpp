// The driver on a simulator that misbehaves: each fault ends in the right error or in the right
// place, never in a motion command sent twice, and leaves a driver that can go on after a stop.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "drivers/motion.h"
#include "src/core/errors.h"
#include "tests/support/simulated_sc300.h"

namespace turntable {
namespace {

using sim::FaultKind;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class Sc300Faults : public ::testing::TestWithParam<bool>, protected SimulatedSc300 {
 protected:
  Sc300Faults() : SimulatedSc300(GetParam()) { ready(); }

  /// 10 deg: one leg of 9.5 and one of 0.5. @return virtual time it took, s.
  double move_to_ten() {
    const Time before = clock.now();
    const Arrival<Degrees> arrival = move(yaw(), 10);
    EXPECT_FALSE(arrival.missed);
    EXPECT_NEAR(arrival.position.value, 10.0, 1e-9);
    EXPECT_NEAR(counter(AxisId::kYaw), 10.0, 1e-9);
    EXPECT_THAT(motions(), ElementsAre("+Y,7600", "+Y,400"));
    return seconds(clock.now() - before);
  }
  template <class E>
  std::string fails_to_move(double to = 10) {
    try {
      move(yaw(), to);
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
    EXPECT_LE(motions().size(), 2u);
    EXPECT_FALSE(yaw().homed());
    EXPECT_THROW(yaw().start(Degrees{1}), DeviceError);
    yaw().stop();
    EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now()));
    yaw().home();
    EXPECT_NEAR(move(yaw(), 3).position.value, 3.0, 1e-9);
    EXPECT_NEAR(truth(AxisId::kYaw), 3.0, 1e-9);
  }
  double undisturbed() {
    SimulatedSc300 rig(GetParam());
    rig.ready();
    const Time before = rig.clock.now();
    rig.move(rig.yaw(), 10);
    return seconds(rig.clock.now() - before);
  }
};

INSTANTIATE_TEST_SUITE_P(AnswersWhileMoving, Sc300Faults, ::testing::Bool());

TEST_P(Sc300Faults, NoiseBeforeEveryReplyIsSurvived) {
  fault({.kind = FaultKind::kGarbage, .times = kForEver});
  EXPECT_NEAR(move_to_ten(), undisturbed(), 1e-9);
}

TEST_P(Sc300Faults, NoiseThatRunsIntoAReplyIsSurvived) {
  fault({.kind = FaultKind::kGarbage, .nth = 3, .times = 4, .text = "\x01\x02"});
  move_to_ten();
}

TEST_P(Sc300Faults, SplitRepliesArePutTogether) {
  fault({.kind = FaultKind::kSplitReply, .times = kForEver, .delay_s = 0.02});
  move_to_ten();
}

TEST_P(Sc300Faults, RepliesThatComeTwiceAreHeardOnce) {
  fault({.kind = FaultKind::kDuplicatedLine, .times = kForEver});
  EXPECT_NEAR(move_to_ten(), undisturbed(), 0.05);
}

TEST_P(Sc300Faults, AnyQuestionMayBeSpoiltWhateverMoveItIsPartOf) {
  for (const FaultKind kind :
       {FaultKind::kLostReply, FaultKind::kTruncatedReply, FaultKind::kCorruptReply,
        FaultKind::kSilence, FaultKind::kLateReply})
    for (int nth = 1; nth <= 25; ++nth)
      for (const double late : {0.03, 1.2, 2.5}) {
        SimulatedSc300 rig(GetParam());
        rig.ready();
        rig.fault({.kind = kind, .verb = "status", .nth = nth, .delay_s = late});
        EXPECT_NEAR(rig.move(rig.yaw(), 10).position.value, 10.0, 1e-9);
        EXPECT_NEAR(rig.truth(AxisId::kYaw), 10.0, 1e-9)
            << fault_name(kind) << " " << nth << " " << late;
        EXPECT_THAT(rig.motions(), ElementsAre("+Y,7600", "+Y,400"));
        rig.move(rig.yaw(), 12);
        EXPECT_NEAR(rig.truth(AxisId::kYaw), 12.0, 1e-9);
      }
}

TEST_P(Sc300Faults, TheAnswerOfAMoveMayBeSpoiltLostOrLate) {
  for (const FaultKind kind :
       {FaultKind::kLostReply, FaultKind::kTruncatedReply, FaultKind::kCorruptReply,
        FaultKind::kLateReply, FaultKind::kLostCompletion, FaultKind::kSplitReply,
        FaultKind::kGarbage, FaultKind::kDuplicatedLine})
    for (const double late : {0.03, 0.3, 1.0, 2.0, 4.0}) {
      SimulatedSc300 rig(GetParam());
      rig.ready();
      rig.fault({.kind = kind, .verb = "move", .times = 2, .delay_s = late});
      const Time before = rig.clock.now();
      EXPECT_NEAR(rig.move(rig.yaw(), 10).position.value, 10.0, 1e-9);
      EXPECT_LT(seconds(rig.clock.now() - before), undisturbed() + 2.5);
      EXPECT_NEAR(rig.truth(AxisId::kYaw), 10.0, 1e-9) << fault_name(kind) << " " << late;
      EXPECT_THAT(rig.motions(), ElementsAre("+Y,7600", "+Y,400"));
      rig.move(rig.yaw(), 12);
      rig.move(rig.yaw(), -5);
      EXPECT_NEAR(rig.truth(AxisId::kYaw), -5.0, 1e-9);
    }
}

TEST_P(Sc300Faults, ACommandThatNeverArrivedIsNotSentAgain) {
  fault({.kind = FaultKind::kSilence, .verb = "move"});
  const Time before = clock.now();
  EXPECT_THAT(fails_to_move<TimeoutError>(),
              HasSubstr("had not acknowledged the command, which was not sent again"));
  EXPECT_LT(seconds(clock.now() - before), 4.0);
  EXPECT_THAT(motions(), ElementsAre("+Y,7600"));
  expect_recovery();
}

TEST_P(Sc300Faults, SilenceTimesOutWithinTheDeadlineOfTheMove) {
  const MotionAxis<Degrees>& axis = dynamic_cast<MotionAxis<Degrees>&>(yaw());
  for (const int nth : {1, 2, 3, 4, 5, 10}) {
    SimulatedSc300 rig(GetParam());
    rig.ready();
    rig.fault({.kind = FaultKind::kSilence, .nth = nth, .times = kForEver});
    const Time before = rig.clock.now();
    EXPECT_THROW(rig.move(rig.yaw(), 10), TimeoutError) << nth;
    EXPECT_LE(seconds(rig.clock.now() - before),
              0.2 + axis.deadline_seconds(Degrees{9.5}) + 3 * 1.0 + 2 * 0.3 /* reads under way */)
        << nth;
    EXPECT_LE(rig.motions().size(), 2u);
    EXPECT_FALSE(rig.yaw().homed());
    EXPECT_THROW(rig.yaw().stop(), TimeoutError);  // it cannot be verified
  }
}

TEST_P(Sc300Faults, ErrorRepliesAreReportedWithTheirCommandAndLoseTheReference) {
  for (const char* code : {"E0", "E1", "ER"})
    for (const char* kind : {"move", "status"}) {
      SimulatedSc300 rig(GetParam());
      rig.ready();
      rig.fault({.kind = FaultKind::kErrorReply, .verb = kind, .text = code});
      try {
        rig.move(rig.yaw(), 10);
        ADD_FAILURE();
      } catch (const DeviceError& error) {
        EXPECT_THAT(error.what(),
                    HasSubstr(std::string(kind) == "move" ? "\"+Y,7600\"" : "\"?Y\""));
        EXPECT_THAT(error.what(), HasSubstr(std::string("was refused with ") + code));
      }
      EXPECT_LE(rig.motions().size(), 1u);
      EXPECT_FALSE(rig.yaw().homed());
    }
}

TEST_P(Sc300Faults, AStuckAxisIsNoticed) {
  fault({.kind = FaultKind::kStuckAxis, .verb = "move", .delay_s = 0.3});
  const Time before = clock.now();
  EXPECT_THAT(fails_to_move<TimeoutError>(),
              HasSubstr(GetParam() ? "stalled at" : "did not reach"));
  EXPECT_LT(seconds(clock.now() - before), GetParam() ? 1.6 : 8.0);
  EXPECT_THAT(motions(), ElementsAre("+Y,7600"));
  EXPECT_FALSE(yaw().homed());
  yaw().stop();
}

TEST_P(Sc300Faults, WhateverHaltsTheAxisEndsInAnErrorThatNamesThePlace) {
  for (const FaultKind kind :
       {FaultKind::kLimitHit, FaultKind::kAlarm, FaultKind::kEmergencyStop}) {
    SimulatedSc300 rig(GetParam());
    rig.ready();
    rig.fault({.kind = kind, .verb = "move", .delay_s = 0.3});
    try {
      rig.move(rig.yaw(), 10);
      ADD_FAILURE();
    } catch (const DeviceError& error) {
      EXPECT_THAT(error.what(), HasSubstr("instead of 9.5 deg: a limit switch"));
    }
    EXPECT_THAT(rig.motions(), ElementsAre("+Y,7600"));
    EXPECT_FALSE(rig.yaw().homed());
    rig.yaw().stop();
    if (kind != FaultKind::kLimitHit) {
      EXPECT_THROW(rig.yaw().home(), DeviceError);  // refused
      rig.simulator->clear_trouble();
    }
    rig.yaw().home();
    rig.move(rig.yaw(), 3);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 3.0, 1e-9);
  }
}

TEST_P(Sc300Faults, AResetInMidMoveIsNoticedWhereverItComes) {
  for (double delay = 0.02; delay < 1.0; delay += 0.05)
    for (const double to : {7.0, 0.5}) {  // the first leg ends at 0, where a reset puts the counter
      SimulatedSc300 rig(GetParam());
      rig.ready();
      rig.move(rig.yaw(), -15);
      rig.fault(
          {.kind = FaultKind::kReset, .verb = "move", .delay_s = to == 0.5 ? 0.65 * delay : delay});
      EXPECT_THROW(rig.move(rig.yaw(), to), Error) << delay;
      EXPECT_FALSE(rig.yaw().homed());
      rig.yaw().stop();
      rig.yaw().home();
      rig.move(rig.yaw(), 3);
      EXPECT_NEAR(rig.truth(AxisId::kYaw), 3.0, 1e-9);
    }
}

TEST_P(Sc300Faults, AnUnpluggedLineIsNamedAndAFreshDriverGoesOn) {
  fault({.kind = FaultKind::kUnplugged, .verb = "move", .delay_s = 0.3});
  EXPECT_THAT(fails_to_move<LineError>(), HasSubstr("gone"));
  EXPECT_THROW(yaw().stop(), LineError);
  EXPECT_FALSE(yaw().homed());
  plug_in();
  EXPECT_THAT(controller->connect(), ElementsAre());
  controller->stop_all();
  EXPECT_FALSE(yaw().homed());
  yaw().home();
  EXPECT_NEAR(move(yaw(), 3).position.value, 3.0, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 3.0, 1e-9);
}

TEST_P(Sc300Faults, ALostAnswerToStopIsAskedForAgain) {
  for (const FaultKind kind : {FaultKind::kLostReply, FaultKind::kSilence, FaultKind::kGarbage,
                               FaultKind::kLateReply, FaultKind::kErrorReply}) {
    SimulatedSc300 rig(GetParam());
    rig.ready();
    rig.fault({.kind = kind, .verb = "stop", .delay_s = 1.5, .text = "E1"});
    rig.yaw().start(Degrees{25});
    for (int i = 0; i < 5; ++i) rig.yaw().advance();
    rig.yaw().stop();
    EXPECT_FALSE(rig.simulator->axis(AxisId::kYaw).moving(rig.clock.now()));
    rig.move(rig.yaw(), 3);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 3.0, 1e-9);
  }
}

TEST_P(Sc300Faults, ARefusalOfSomethingElseIsNoRefusalOfTheMove) {
  yaw().start(Degrees{10});
  yaw().advance();
  // A question is lost; what ends it is refused, for there was noise before.
  fault({.kind = FaultKind::kSilence, .verb = "status", .nth = 2});
  fault({.kind = FaultKind::kErrorReply, .verb = "cr", .text = "E0"});
  while (!yaw().advance()) {
  }
  EXPECT_NEAR(truth(AxisId::kYaw), 10.0, 1e-9);
}

// ---- homing

TEST_P(Sc300Faults, OnlyTheAnswerToHomeMakesAHomedAxis) {
  for (const FaultKind kind : {FaultKind::kReset, FaultKind::kSilence, FaultKind::kLostReply,
                               FaultKind::kLostCompletion, FaultKind::kTruncatedReply})
    for (const double from : {5.0, 0.0}) {
      SimulatedSc300 rig(GetParam());
      rig.ready();
      if (from != 0) rig.move(rig.yaw(), from);
      rig.wire.clear();
      rig.fault({.kind = kind, .verb = "home", .delay_s = 0.05});
      EXPECT_THROW(rig.yaw().home(), TimeoutError) << fault_name(kind) << from;
      EXPECT_FALSE(rig.yaw().homed());
      EXPECT_THAT(rig.motions(), ElementsAre("HY"));
      if (from == 0) rig.yaw().stop();  // not needed, and does not hurt
      rig.yaw().home();
      EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9);
    }
}

TEST_P(Sc300Faults, ALateAnswerToAQuestionIsNotTakenForThatToHome) {
  // The counter says 0 all the time, the command is lost, and an earlier answer comes now.
  for (int nth = 1; nth <= 6; ++nth)
    for (const double late : {1.1, 1.7, 2.3, 2.9}) {
      SimulatedSc300 rig(GetParam());
      rig.ready();
      rig.fault({.kind = FaultKind::kSilence, .verb = "home"});
      rig.fault({.kind = FaultKind::kLateReply, .verb = "status", .nth = nth, .delay_s = late});
      EXPECT_THROW(rig.yaw().home(), TimeoutError) << nth << " " << late;
      EXPECT_FALSE(rig.yaw().homed());
    }
}

TEST_P(Sc300Faults, HomingSurvivesWhatSpoilsItsLinesALittle) {
  for (const FaultKind kind : {FaultKind::kGarbage, FaultKind::kDuplicatedLine,
                               FaultKind::kSplitReply, FaultKind::kLateReply}) {
    move(yaw(), 5);
    wire.clear();
    const double delay = kind == FaultKind::kLateReply ? 0.3 : 0.02;
    fault({.kind = kind, .verb = "home", .delay_s = delay, .text = "??"});
    yaw().home();
    EXPECT_THAT(motions(), ElementsAre("HY"));
    EXPECT_NEAR(truth(AxisId::kYaw), 0.0, 1e-9);
  }
}

TEST_P(Sc300Faults, AHomingInWhichAQuestionIsLostSucceeds) {
  for (int nth = 1; nth <= 60; ++nth) {
    SimulatedSc300 rig(GetParam());
    rig.ready();
    rig.move(rig.yaw(), 20);
    rig.fault({.kind = FaultKind::kLostReply, .verb = "status", .nth = nth});
    rig.yaw().home();
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9);
  }
}

TEST_P(Sc300Faults, HomingIsBoundedInTime) {
  move(yaw(), 20);
  fault({.kind = FaultKind::kStuckAxis, .verb = "home", .delay_s = 0.5});
  const MotionAxis<Degrees>& axis = dynamic_cast<MotionAxis<Degrees>&>(yaw());
  const Time before = clock.now();
  EXPECT_THROW(yaw().home(), TimeoutError);
  EXPECT_LT(seconds(clock.now() - before), GetParam() ? 3.0 : axis.home_deadline_seconds() + 3.5);
  EXPECT_FALSE(yaw().homed());
}

// ---- anything at all

TEST_P(Sc300Faults, RandomFaultsEndInTheRightPlaceOrInAnError) {
  constexpr double kPulse = 0.00125;  // a motor may get stuck between two
  // A limit switch just before the goal is a near miss, which the loop tries again.
  const auto retried = [](SimulatedSc300& rig) {
    return 2u * static_cast<unsigned>(rig.yaw().arrival().retries + rig.roll().arrival().retries);
  };
  int arrived = 0, failed = 0, recovered = 0;
  for (std::uint64_t k = 0; k < 300; ++k) {
    Random draws = draws_of_this_test(k);
    SimulatedSc300 rig(GetParam());
    rig.ready();
    rig.roll().home();
    constexpr std::array kKinds{
        FaultKind::kSilence,        FaultKind::kLostReply,      FaultKind::kGarbage,
        FaultKind::kTruncatedReply, FaultKind::kSplitReply,     FaultKind::kLateReply,
        FaultKind::kDuplicatedLine, FaultKind::kLostCompletion, FaultKind::kErrorReply,
        FaultKind::kReset,          FaultKind::kStuckAxis,      FaultKind::kUnplugged,
        FaultKind::kCorruptReply,   FaultKind::kLimitHit};
    for (int n = 0; n < 2; ++n)
      rig.fault({.kind = kKinds[draws() % kKinds.size()],
                 .verb = draws.uniform() < 0.5 ? "move" : "status",
                 .nth = 1 + static_cast<int>(draws() % 20),
                 .delay_s = draws.uniform(0, 2),
                 .text = "E1"});
    try {
      for (int move_number = 0; move_number < 5; ++move_number) {
        const double target = draws.uniform(-25, 25), other = draws.uniform(-25, 25);
        rig.wire.clear();
        rig.yaw().start(Degrees{target});
        rig.roll().start(Degrees{other});
        wait_all(rig.yaw(), rig.roll());
        EXPECT_LE(rig.motions().size(), 4u + retried(rig)) << k;
        EXPECT_FALSE(rig.yaw().arrival().missed) << k;
        EXPECT_NEAR(rig.truth(AxisId::kYaw), target, kPulse) << k;
        EXPECT_NEAR(rig.truth(AxisId::kRoll), other, kPulse) << k;
      }
      ++arrived;
    } catch (const Error&) {
      ++failed;
      EXPECT_LE(rig.motions().size(), 4u + retried(rig)) << k;
      EXPECT_FALSE(rig.yaw().homed() && rig.roll().homed()) << k;
      try {
        rig.controller->stop_all();
      } catch (const Error&) {
      }
      if (!rig.simulator->plugged()) rig.plug_in();
      // Whatever is left of the faults, an axis that counts as homed is where it says.
      try {
        rig.controller->stop_all();
        rig.controller->connect();
        rig.yaw().home();
        EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9) << k;
        rig.move(rig.yaw(), 7);
        EXPECT_NEAR(rig.truth(AxisId::kYaw), 7.0, 1e-9) << k;
        ++recovered;
      } catch (const Error&) {
      }
    }
  }
  std::cout << arrived << " arrived, " << failed << " failed, " << recovered << " recovered\n";
  EXPECT_GT(arrived, 60);
  EXPECT_GT(failed, 60);
  EXPECT_GT(recovered, failed / 2);
}

TEST_P(Sc300Faults, RandomFaultsWhileHomingAndStoppingEndAtHomeOrInAnError) {
  int homed = 0, failed = 0;
  for (std::uint64_t k = 0; k < 300; ++k) {
    Random draws = draws_of_this_test(k);
    SimulatedSc300 rig(GetParam());
    rig.ready();
    constexpr std::array kKinds{
        FaultKind::kSilence,        FaultKind::kLostReply,      FaultKind::kGarbage,
        FaultKind::kTruncatedReply, FaultKind::kSplitReply,     FaultKind::kLateReply,
        FaultKind::kDuplicatedLine, FaultKind::kLostCompletion, FaultKind::kErrorReply,
        FaultKind::kReset,          FaultKind::kStuckAxis,      FaultKind::kCorruptReply,
        FaultKind::kLimitHit};
    constexpr std::array kVerbs{"home", "stop", "status", "status"};
    for (int n = 0; n < 2; ++n) {
      const char* verb = kVerbs[draws() % kVerbs.size()];
      rig.fault({.kind = kKinds[draws() % kKinds.size()],
                 .verb = verb,
                 .nth = 1 + static_cast<int>(draws() % (verb[2] == 'a' ? 30 : 2)),
                 .delay_s = draws.uniform(0, 2),
                 .text = "E1"});
    }
    for (int round = 0; round < 3; ++round) {
      rig.wire.clear();
      try {
        const double target = draws.uniform(-25, 25);
        if (rig.yaw().homed()) {
          rig.yaw().start(Degrees{target});
          for (int i = 0; i < 5; ++i) rig.yaw().advance();
        }
        rig.yaw().stop();
        const double here = rig.counter(AxisId::kYaw);
        rig.clock.sleep_for(std::chrono::milliseconds{200});
        // Still there, unless a reset that was due has come.
        EXPECT_TRUE(rig.counter(AxisId::kYaw) == here || rig.counter(AxisId::kYaw) == 0.0) << k;
        rig.yaw().home();
        EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9) << k;
        ++homed;
      } catch (const Error&) {
        EXPECT_FALSE(rig.yaw().homed()) << k;
        ++failed;
      }
      EXPECT_LE(rig.wire.commands("H").size(), 1u) << k;
    }
  }
  std::cout << homed << " homed, " << failed << " failed\n";
  EXPECT_GT(homed, 450);
  EXPECT_GT(failed, 50);
}

}  // namespace
}  // namespace turntable
