// The driver on a bus that misbehaves: each fault ends in the right error or in the right place,
// never in a motion triggered twice, and leaves a driver that can go on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "drivers/motion.h"
#include "src/core/errors.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_leadshine.h"

namespace turntable {
namespace {

using sim::FaultKind;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr const char* kRun = "0x6002=0x10";
/// Slave 17, which is nobody of ours, answers a read with one register; its checksum is right.
const std::string kForeignFrame("\x11\x03\x02\x12\x34\x74\xf0", 7);

class LeadshineFaults : public ::testing::TestWithParam<bool> {
 protected:
  LeadshineFaults() : rig({.gateway = GetParam()}) { rig.ready(); }

  SimulatedLeadshine rig;

  /// 10 deg: one leg to 9.5 and one to 10.
  void move_to_ten() {
    const Arrival<Degrees> arrival = rig.move(rig.yaw(), 10);
    EXPECT_FALSE(arrival.missed);
    EXPECT_NEAR(arrival.position.value, 10.0, 1e-9);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 10.0, 1e-9);
    EXPECT_EQ(rig.said(kRun), 2);
  }
  template <class E>
  std::string fails_to_move() {
    try {
      rig.move(rig.yaw(), 10);
    } catch (const E& error) {
      return error.what();
    } catch (const std::exception& error) {
      ADD_FAILURE() << "another kind of error: " << error.what();
      return {};
    }
    ADD_FAILURE() << "arrived";
    return {};
  }
  /// After an error: triggered once, not homed, and usable again.
  void expect_recovery() {
    EXPECT_LE(rig.said(kRun), 2);
    EXPECT_FALSE(rig.yaw().homed());
    EXPECT_THROW(rig.yaw().start(Degrees{1}), DeviceError);
    rig.yaw().stop();
    EXPECT_FALSE(rig.moving(AxisId::kYaw));
    rig.simulator->clear_trouble();
    rig.yaw().home();
    EXPECT_NEAR(rig.move(rig.yaw(), 3).position.value, 3.0, 1e-9);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 3.0, 1e-9);
  }
};

INSTANTIATE_TEST_SUITE_P(, LeadshineFaults, ::testing::Bool(), [](const auto& gateway) {
  return gateway.param ? "BehindAGateway" : "OnTheBus";
});

// ---- the wire

TEST_P(LeadshineFaults, WhatStandsBeforeAnAnswerIsPassedOver) {
  rig.fault({.kind = FaultKind::kGarbage, .nth = 1, .times = kForEver});
  move_to_ten();
}

TEST_P(LeadshineFaults, AnswersThatComeInPartsOrTwiceAreHeardOnce) {
  rig.fault({.kind = FaultKind::kSplitReply, .times = kForEver, .delay_s = 0.005});
  move_to_ten();
  rig.mark();
  rig.fault({.kind = FaultKind::kDuplicatedLine, .times = kForEver});
  rig.move(rig.yaw(), -10);
  EXPECT_NEAR(rig.truth(AxisId::kYaw), -10.0, 1e-9);
}

TEST_P(LeadshineFaults, SpoiltReadsAreAskedAgain) {
  for (const FaultKind kind : {FaultKind::kCorruptReply, FaultKind::kTruncatedReply,
                               FaultKind::kSilence, FaultKind::kLostReply})
    rig.fault({.kind = kind, .verb = "status", .nth = 3 + 4 * static_cast<int>(kind)});
  move_to_ten();
}

TEST_P(LeadshineFaults, LateAnswersAreNotTakenForLaterOnes) {
  rig.fault({.kind = FaultKind::kLateReply, .verb = "status", .nth = 5, .delay_s = 1.2});
  rig.fault({.kind = FaultKind::kLateReply, .verb = "status", .nth = 12, .delay_s = 1.5});
  move_to_ten();
}

TEST_P(LeadshineFaults, ABlockWhoseConfirmationIsLostIsWrittenAgain) {
  for (const FaultKind kind :
       {FaultKind::kSilence, FaultKind::kLostReply, FaultKind::kCorruptReply}) {
    rig.mark();
    rig.fault({.kind = kind, .verb = "fc16"});
    rig.move(rig.yaw(), rig.counter(AxisId::kYaw) + 3);
    EXPECT_EQ(rig.said("fc16"), 3);
    EXPECT_EQ(rig.said(kRun), 2);
  }
}

TEST_P(LeadshineFaults, ALostConfirmationOfTheTriggerIsResolvedByReading) {
  for (const FaultKind kind : {FaultKind::kLostReply, FaultKind::kCorruptReply,
                               FaultKind::kTruncatedReply, FaultKind::kLateReply}) {
    rig.move(rig.yaw(), 0);
    rig.mark();
    rig.fault({.kind = kind, .verb = kRun, .times = 2, .delay_s = 1.5});
    move_to_ten();
  }
}

TEST_P(LeadshineFaults, ATriggerThatNeverArrivedIsNotSentAgain) {
  rig.fault({.kind = FaultKind::kSilence, .verb = kRun});
  EXPECT_THAT(fails_to_move<DeviceError>(), HasSubstr("was not sent again"));
  EXPECT_EQ(rig.said(kRun), 1);
  expect_recovery();
}

TEST_P(LeadshineFaults, ForeignFramesOnTheBusArePassedOver) {
  for (int nth = 1; nth < 200; nth += 3)
    rig.fault({.kind = FaultKind::kGarbage, .nth = nth, .text = kForeignFrame});
  move_to_ten();
  rig.move(rig.yaw(), -10);
  EXPECT_NEAR(rig.truth(AxisId::kYaw), -10.0, 1e-9);
}

TEST_P(LeadshineFaults, ARefusalIsNamedAndLosesTheReference) {
  rig.fault({.kind = FaultKind::kErrorReply, .verb = kRun, .text = "04"});
  EXPECT_THAT(fails_to_move<DeviceError>(),
              AllOf(HasSubstr("axis yaw (channel 2 of bus on bus line)"),
                    HasSubstr("writing 0x0010 to register 0x6002"), HasSubstr("exception 04")));
  EXPECT_EQ(rig.said(kRun), 1);
  expect_recovery();
}

TEST_P(LeadshineFaults, ARequestThatArrivedSpoiltIsSaidAgainUnlessItIsATrigger) {
  rig.fault({.kind = FaultKind::kErrorReply, .verb = "status", .nth = 4, .text = "08"});
  rig.fault({.kind = FaultKind::kErrorReply, .verb = "fc16", .text = "08"});
  move_to_ten();
  rig.mark();
  rig.fault({.kind = FaultKind::kErrorReply, .verb = kRun, .text = "08"});
  EXPECT_THROW(rig.move(rig.yaw(), 0), DeviceError);
  EXPECT_EQ(rig.said(kRun), 1);
  expect_recovery();
}

TEST_P(LeadshineFaults, SilenceForEverTimesOut) {
  rig.fault({.kind = FaultKind::kSilence, .nth = 7, .times = kForEver});
  const Time before = rig.clock.now();
  EXPECT_THAT(fails_to_move<TimeoutError>(), HasSubstr("slave 2"));
  EXPECT_LT(seconds(rig.clock.now() - before), 10.0);
  EXPECT_FALSE(rig.yaw().homed());
  EXPECT_THROW(rig.yaw().stop(), TimeoutError);  // it cannot be verified
}

TEST_P(LeadshineFaults, AnUnpluggedLineIsNamedAndAFreshDriverGoesOn) {
  rig.fault({.kind = FaultKind::kUnplugged, .verb = kRun, .delay_s = 0.3});
  EXPECT_THAT(fails_to_move<LineError>(), HasSubstr("gone"));
  EXPECT_THROW(rig.yaw().stop(), LineError);
  EXPECT_FALSE(rig.yaw().homed());
  rig.reconnect();
  EXPECT_THAT(rig.controller->connect(), IsEmpty());
  rig.controller->stop_all();
  EXPECT_FALSE(rig.yaw().homed());
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), 3).position.value, 3.0, 1e-9);
}

// ---- the drive

TEST_P(LeadshineFaults, AnAlarmIsNamedWithItsCodeAndWhatToDo) {
  rig.fault({.kind = FaultKind::kAlarm, .verb = kRun, .delay_s = 0.3});
  EXPECT_THAT(fails_to_move<DeviceError>(),
              AllOf(HasSubstr("axis yaw: "), HasSubstr("alarm 0x0001 (overcurrent)"),
                    HasSubstr("0x1111 in register 0x1801"), HasSubstr("home the axis again")));
  EXPECT_THROW(rig.yaw().home(), DeviceError);  // it is still there
  rig.mark();
  expect_recovery();
}

TEST_P(LeadshineFaults, AnEmergencyStopIsAnAlarmOfEveryDrive) {
  rig.roll().home();
  rig.roll().start(Degrees{20});
  rig.fault({.kind = FaultKind::kEmergencyStop, .verb = kRun, .delay_s = 0.3});
  EXPECT_THAT(fails_to_move<DeviceError>(),
              AllOf(HasSubstr("alarm 0x1000"), HasSubstr("emergency stop")));
  EXPECT_THROW(wait_all(rig.roll()), DeviceError);
  EXPECT_FALSE(rig.roll().homed());
  EXPECT_THROW(rig.yaw().home(), DeviceError);
  rig.mark();
  expect_recovery();
}

TEST_P(LeadshineFaults, ALimitSwitchIsNamedByTheDrivesWarningAndItsInput) {
  rig.fault({.kind = FaultKind::kLimitHit, .verb = kRun, .delay_s = 0.3});
  EXPECT_THAT(fails_to_move<DeviceError>(),
              AllOf(HasSubstr("met a limit switch"), HasSubstr("warning 0x0200"),
                    HasSubstr("input 2, set up as the upper limit switch, reads on"),
                    HasSubstr("input 3, set up as the lower limit switch, reads off")));
  expect_recovery();
}

TEST_P(LeadshineFaults, AHomingThatEndsAtALimitSwitchSaysSo) {
  rig.move(rig.yaw(), 5);
  rig.fault({.kind = FaultKind::kLimitHit, .verb = "home", .delay_s = 0.3});
  EXPECT_THAT(message_of<DeviceError>([&] { rig.yaw().home(); }),
              AllOf(HasSubstr("homing failed"), HasSubstr("warning 0x0100")));
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), 3).position.value, 3.0, 1e-9);
}

TEST_P(LeadshineFaults, ALimitSwitchThatRaisesAnAlarmIsNamedByIt) {
  SimulatedLeadshine other({.gateway = GetParam(), .guesses = {.limit_alarm = 0x0033}});
  other.ready();
  other.fault({.kind = FaultKind::kLimitHit, .verb = kRun, .delay_s = 0.3});
  try {
    other.move(other.yaw(), 10);
    ADD_FAILURE();
  } catch (const DeviceError& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("alarm 0x0033"), HasSubstr("limit input")));
  }
  EXPECT_FALSE(other.yaw().homed());
}

TEST_P(LeadshineFaults, AStuckAxisIsNoticedByTheWatchdog) {
  rig.fault({.kind = FaultKind::kStuckAxis, .verb = kRun, .delay_s = 0.3});
  const Time before = rig.clock.now();
  EXPECT_THAT(fails_to_move<TimeoutError>(), HasSubstr("stalled at"));
  EXPECT_LT(seconds(rig.clock.now() - before), 0.3 + 1.3);
  EXPECT_FALSE(rig.yaw().homed());
}

TEST_P(LeadshineFaults, APowerCycleInMidMoveIsNoticedWhereverItComes) {
  for (double delay = 0.02; delay < 1.0; delay += 0.05)
    for (const auto& [from, to] : {std::pair{-8.0, 7.0}, std::pair{-15.0, 0.5}}) {
      SimulatedLeadshine other({.gateway = GetParam()});
      other.ready();
      other.move(other.yaw(), from);
      other.fault({.kind = FaultKind::kReset, .verb = kRun, .delay_s = delay});
      try {
        other.move(other.yaw(), to);
        ADD_FAILURE() << delay;
      } catch (const DeviceError& error) {
        EXPECT_THAT(error.what(), HasSubstr("switched off and on again"));
      }
      EXPECT_FALSE(other.yaw().homed());
      other.yaw().stop();
      other.yaw().home();
      EXPECT_NEAR(other.move(other.yaw(), 3).position.value, 3.0, 1e-9);
      EXPECT_NEAR(other.truth(AxisId::kYaw), 3.0, 1e-9);
    }
}

TEST_P(LeadshineFaults, APowerCycleAtRestIsNoticedEvenWhereTheCounterDoesNotChange) {
  rig.move(rig.yaw(), 0);
  rig.fault({.kind = FaultKind::kReset, .verb = "status"});
  rig.yaw().position();
  rig.yaw().position();
  EXPECT_THAT(fails_to_move<DeviceError>(), HasSubstr("switched off and on again"));
  rig.mark();
  expect_recovery();
}

// ---- homing

TEST_P(LeadshineFaults, HomingSurvivesALostConfirmationAndNeverBeginsTwice) {
  for (const FaultKind kind : {FaultKind::kLostReply, FaultKind::kGarbage,
                               FaultKind::kDuplicatedLine, FaultKind::kTruncatedReply}) {
    rig.move(rig.yaw(), 5);
    rig.mark();
    rig.fault({.kind = kind, .verb = "home"});
    rig.yaw().home();
    EXPECT_EQ(rig.said("home"), 1);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9);
  }
}

TEST_P(LeadshineFaults, AnEarlierHomingIsNotTakenForOneThatNeverBegan) {
  rig.fault({.kind = FaultKind::kSilence, .verb = "home"});
  EXPECT_THROW(rig.yaw().home(), TimeoutError);  // home done and 0 all the time, from before
  EXPECT_FALSE(rig.yaw().homed());
  EXPECT_EQ(rig.said("home"), 1);
  rig.yaw().home();
  EXPECT_TRUE(rig.yaw().homed());
}

TEST_P(LeadshineFaults, HomingThatIsBrokenOffIsNoticed) {
  for (const FaultKind kind : {FaultKind::kReset, FaultKind::kLimitHit, FaultKind::kAlarm,
                               FaultKind::kEmergencyStop, FaultKind::kUnplugged}) {
    rig.move(rig.yaw(), 5);
    rig.fault({.kind = kind, .verb = "home", .delay_s = 0.3});
    EXPECT_THROW(rig.yaw().home(), Error) << fault_name(kind);
    EXPECT_FALSE(rig.yaw().homed());
    rig.simulator->clear_trouble();
    if (kind == FaultKind::kUnplugged) {
      rig.reconnect();
      rig.controller->connect();
    }
    rig.yaw().stop();
    rig.yaw().home();
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9) << fault_name(kind);
  }
}

// ---- all together

TEST_P(LeadshineFaults, EveryFaultAtEveryKindOfRequestLeavesAUsableDriver) {
  for (const FaultKind kind : sim::all_faults()) {
    if (kind == FaultKind::kStuckAxis || kind == FaultKind::kBlockedTable ||
        kind == FaultKind::kFlood)
      continue;  // for ever
    for (const char* verb : {"status", "get", "set", "move", "stop", "home"}) {
      SimulatedLeadshine other({.gateway = GetParam()});
      other.ready();
      other.fault({.kind = kind, .verb = verb, .nth = 2, .delay_s = 0.2, .text = "04"});
      for (const double target : {5.0, -5.0, 2.0}) try {
          other.move(other.yaw(), target);
          EXPECT_NEAR(other.truth(AxisId::kYaw), target, 0.001) << fault_name(kind) << verb;
          other.yaw().stop();
        } catch (const Error&) {
          EXPECT_FALSE(other.yaw().homed() && !other.moving(AxisId::kYaw))
              << fault_name(kind) << " " << verb;
        }
      other.simulator->clear_trouble();
      if (!other.simulator->plugged()) {
        other.reconnect();
        EXPECT_THAT(other.controller->connect(), IsEmpty());
      }
      try {
        other.controller->stop_all();
      } catch (const Error&) {  // the fault strikes here
        other.controller->stop_all();
      }
      EXPECT_FALSE(other.moving(AxisId::kYaw)) << fault_name(kind) << " " << verb;
      try {
        other.yaw().home();
      } catch (const Error&) {
        other.simulator->clear_trouble();
        if (!other.simulator->plugged()) {
          other.reconnect();
          other.controller->connect();
        }
        other.yaw().stop();
        other.yaw().home();
      }
      EXPECT_NEAR(other.move(other.yaw(), 3).position.value, 3.0, 1e-9);
      EXPECT_NEAR(other.truth(AxisId::kYaw), 3.0, 1e-9) << fault_name(kind) << " " << verb;
    }
  }
}

TEST_P(LeadshineFaults, RandomFaultsEndInTheRightPlaceOrInAnError) {
  int arrived = 0, failed = 0;
  for (std::uint64_t k = 0; k < 150; ++k) {
    Random draws = draws_of_this_test(k);
    SimulatedLeadshine other({.gateway = GetParam()});
    other.ready();
    constexpr std::array kKinds{
        FaultKind::kSilence,        FaultKind::kLostReply,     FaultKind::kGarbage,
        FaultKind::kTruncatedReply, FaultKind::kSplitReply,    FaultKind::kLateReply,
        FaultKind::kDuplicatedLine, FaultKind::kCorruptReply,  FaultKind::kErrorReply,
        FaultKind::kReset,          FaultKind::kStuckAxis,     FaultKind::kUnplugged,
        FaultKind::kAlarm,          FaultKind::kEmergencyStop, FaultKind::kLimitHit};
    constexpr std::array kVerbs{"move", "status", "set", "get", ""};
    for (int n = 0; n < 2; ++n)
      other.fault({.kind = kKinds[draws() % kKinds.size()],
                   .verb = kVerbs[draws() % kVerbs.size()],
                   .nth = 1 + static_cast<int>(draws() % 20),
                   .delay_s = draws.uniform(0, 2),
                   .text = draws.uniform() < 0.5 ? "04" : ""});
    try {
      for (int move_number = 0; move_number < 5; ++move_number) {
        const double target = draws.uniform(-25, 25);
        other.mark();
        const auto arrival = other.move(other.yaw(), target);
        EXPECT_LE(other.said(kRun), 2 + 2 * arrival.retries) << k;
        EXPECT_NEAR(arrival.position.value, target, 0.002) << k;
        EXPECT_NEAR(other.truth(AxisId::kYaw), target, 0.002) << k;
      }
      ++arrived;
    } catch (const Error&) {
      ++failed;
      EXPECT_LE(other.said(kRun), 2) << k;
      EXPECT_FALSE(other.yaw().homed()) << k;
    }
  }
  EXPECT_GT(arrived, 25);
  EXPECT_GT(failed, 25);
}

}  // namespace
}  // namespace turntable
