// The rules of a move, on a port that does as the test says: what a real controller rarely does.
#include "drivers/motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "src/core/errors.h"
#include "tests/support/axis_configs.h"
#include "tests/support/message_of.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

/// Goes from where it is to where it is sent in one second, in a straight line.
class FakePort final : public AxisPort<Degrees> {
 public:
  explicit FakePort(Clock& clock) : clock_(&clock) {}

  std::unique_lock<std::recursive_mutex> lock() override { return std::unique_lock(mutex_); }
  void require_ready() const override {}
  Acknowledgement start_move(Degrees, Degrees to) override {
    sent.push_back(to.value);
    go(to.value + (sent.size() <= misses.size() ? misses[sent.size() - 1] : 0.0));
    return acknowledgement;
  }
  Acknowledgement start_home() override {
    ++homings;
    go(0.0);
    return acknowledgement;
  }
  AxisStatus<Degrees> status(Time) override {
    ++reads;
    const double since = seconds(clock_->now() - began_) - starts_late_s;
    const double way = std::clamp(since / (never_ends_slowly ? 60.0 : 1.0), 0.0, 1.0);
    const double here = from_ + (to_ - from_) * way + (wobble ? wobble() : 0.0);
    const Motion motion = !tells                    ? Motion::kUnknown
                          : since < 0.0             ? Motion::kEnded  // of the move before
                          : way < 1.0 || never_ends ? Motion::kMoving
                                                    : Motion::kEnded;
    if (gives_way) throw GaveWay("gave way");
    if (hides_position && way < 1.0) return {std::nullopt, motion};
    AxisStatus<Degrees> status{Degrees{here + counter_shift}, motion};
    status.fault = fault;
    return status;
  }
  void send_stop(bool immediate) override {
    stops.push_back(immediate ? "immediate" : "decelerating");
    if (immediate || !deaf_to_slow_stops) {
      const double here = status(Time{0}).position.value_or(Degrees{from_}).value;
      from_ = to_ = here;
      began_ = clock_->now() - std::chrono::minutes{2};  // and is there
    }
  }

  std::vector<double> sent;
  std::vector<double> misses;  ///< of the first moves
  int homings = 0, reads = 0;
  std::vector<std::string> stops;
  Acknowledgement acknowledgement = Acknowledgement::kReceived;
  bool tells = true, never_ends = false, hides_position = false, deaf_to_slow_stops = false;
  bool gives_way = false;          ///< a stop of another axis waits for the line
  bool never_ends_slowly = false;  ///< it takes a minute to go anywhere
  double counter_shift = 0;
  double starts_late_s = 0;  ///< and says "ended" so long
  std::string fault;
  std::function<double()> wobble;

 private:
  void go(double to) {
    from_ = to_;
    to_ = to;
    began_ = clock_->now();
  }

  Clock* clock_;
  std::recursive_mutex mutex_;
  double from_ = 0, to_ = 0;
  Time began_{0};
};

class MotionRules : public ::testing::Test {
 protected:
  MotionRules() : port(clock) {}
  static AxisConfig config() {
    AxisConfig c = rotary_axis(AxisId::kYaw, "X");
    c.speed = 30;
    return c;
  }
  Arrival<Degrees> move(double to) {
    axis.start(Degrees{to});
    while (!axis.advance()) {
    }
    return axis.arrival();
  }
  template <class E>
  std::string fails(double to) {
    try {
      move(to);
    } catch (const E& error) {
      return error.what();
    }
    ADD_FAILURE() << "did not fail";
    return {};
  }

  ManualClock clock;
  FakePort port;
  MotionAxis<Degrees> axis{config(), port, clock};
};

TEST_F(MotionRules, RepeatsANearMissFromTheRightSide) {
  axis.home();
  port.misses = {0, 0.005, 0.005};
  const Arrival<Degrees> arrival = move(5);
  EXPECT_EQ(arrival.retries, 1);  // it had ended past the goal: from below once more
  EXPECT_FALSE(arrival.missed);
  EXPECT_THAT(port.sent, ElementsAre(4.5, 5, 4.5, 5));
}

TEST_F(MotionRules, GivesUpAfterItsRetriesAndSaysSo) {
  axis.home();
  port.misses.assign(20, 0.005);
  const Arrival<Degrees> arrival = move(5);
  EXPECT_TRUE(arrival.missed);
  EXPECT_EQ(arrival.retries, 2);
  EXPECT_NEAR(arrival.position.value, 5.005, 1e-12);
  EXPECT_EQ(arrival.requested.value, 5.0);
  EXPECT_TRUE(axis.homed());  // data, not an error
}

TEST_F(MotionRules, TakesAFarMissForTrouble) {
  axis.home();
  port.misses = {0, -0.2};
  EXPECT_THAT(fails<DeviceError>(5), HasSubstr("ended at 4.8 deg instead of 5 deg"));
  EXPECT_FALSE(axis.homed());
}

TEST_F(MotionRules, WaitsInsideTheWindowForTheWholeSettleTime) {
  axis.home();
  const Time before = clock.now();
  // Two legs of a second each; then, in the middle of settling, a read outside the window.
  port.wobble = [&] {
    const Time t = clock.now() - before;
    return t > milliseconds{2030} && t < milliseconds{2050} ? 0.003 : 0.0;
  };
  const Arrival<Degrees> arrival = move(5);
  EXPECT_FALSE(arrival.missed);
  EXPECT_EQ(arrival.retries, 0);
  const Time took = clock.now() - before;
  EXPECT_GE(took, milliseconds{2050 + 100}) << "the whole settle time, counted anew";
  EXPECT_LE(took, milliseconds{2050 + 40 + 100});
}

TEST_F(MotionRules, DoesNotBelieveALeftOverEndedForLessThanAPollInterval) {
  AxisConfig direct = config();
  direct.backlash = 0.0;
  MotionAxis<Degrees> short_steps(direct, port, clock);
  short_steps.home();
  port.starts_late_s = 0.06;
  const double step =
      0.05;  // should take less than a poll: it is asked for at once, and again soon
  ASSERT_LT(short_steps.move_seconds(Degrees{0}, Degrees{step}), 0.04);
  short_steps.start(Degrees{step});
  while (!short_steps.advance()) {
  }
  EXPECT_NEAR(short_steps.arrival().position.value, step, 1e-9);
  EXPECT_EQ(short_steps.arrival().retries, 0);
}

TEST_F(MotionRules, BelievesAControllerThatSaysItStillMoves) {
  axis.home();
  port.never_ends = true;
  EXPECT_THAT(fails<TimeoutError>(5), HasSubstr("stands still without being reported as arrived"));
}

TEST_F(MotionRules, WaitsForAControllerThatCannotTellWhereItIsWhileMoving) {
  axis.home();
  port.hides_position = true;
  EXPECT_NEAR(move(5).position.value, 5.0, 1e-12);
}

TEST_F(MotionRules, NoticesAnAxisThatRunsTheWrongWay) {
  axis.home();
  port.misses = {-20};
  EXPECT_THAT(fails<DeviceError>(5), HasSubstr("where it cannot be"));
  EXPECT_FALSE(axis.homed());
}

TEST_F(MotionRules, EscalatesAStopThatIsNotObeyedAndVerifiesIt) {
  axis.home();
  port.deaf_to_slow_stops = true;
  axis.start(Degrees{20});
  axis.advance();
  double creeping = 0;
  port.wobble = [&] { return port.stops.size() < 2 ? creeping += 0.01 : creeping; };
  axis.stop();
  EXPECT_THAT(port.stops, ElementsAre("decelerating", "immediate"));
}

TEST_F(MotionRules, SaysLoudlyThatAnAxisCannotBeStopped) {
  axis.home();
  double creeping = 0;
  port.wobble = [&] { return creeping += 0.01; };
  try {
    axis.stop();
    ADD_FAILURE();
  } catch (const DeviceError& error) {
    EXPECT_THAT(error.what(), HasSubstr("EMERGENCY STOP"));
  }
  EXPECT_FALSE(axis.homed());
}

TEST_F(MotionRules, StatesTheTimeOfAMoveWithItsOvershoot) {
  // 30 deg/s, 50 deg/s^2 from 1 deg/s: ramps of 0.58 s and 8.99 deg each.
  const double long_leg = 2 * 0.58 + (19.5 - 17.98) / 30;
  const double short_leg = 2 * (std::sqrt(1 + 50 * 0.5) - 1) / 50;
  EXPECT_NEAR(axis.move_seconds(Degrees{0}, Degrees{20}), long_leg + short_leg, 1e-9);
  EXPECT_EQ(axis.move_seconds(Degrees{5}, Degrees{5}), 0.0);
  EXPECT_NEAR(axis.move_seconds(Degrees{5}, Degrees{5.5}), short_leg, 1e-9);
  EXPECT_GT(axis.move_seconds(Degrees{5.5}, Degrees{5}), 2 * short_leg);
  EXPECT_GT(axis.deadline_seconds(Degrees{20}), axis.move_seconds(Degrees{0}, Degrees{20}));
}

TEST_F(MotionRules, GoesDirectWithoutAnOvershootToTake) {
  AxisConfig plain = config();
  plain.backlash = 0;
  MotionAxis<Degrees> direct(plain, port, clock);
  direct.home();
  direct.start(Degrees{-30});  // to the very limit: there is no overshoot to leave room for
  while (!direct.advance()) {
  }
  EXPECT_THAT(port.sent, ElementsAre(-30));
  EXPECT_FALSE(direct.arrival().overshot);
}

TEST_F(MotionRules, ApproachesFromAboveWithANegativeOvershoot) {
  AxisConfig mirrored = config();
  mirrored.backlash = -0.5;
  MotionAxis<Degrees> above(mirrored, port, clock);
  above.home();
  above.start(Degrees{5});
  while (!above.advance()) {
  }
  EXPECT_THAT(port.sent, ElementsAre(5.5, 5));
  EXPECT_THROW(above.check(Degrees{29.6}), LimitError);
  above.check(Degrees{-30});
}

TEST_F(MotionRules, RefusesWhatWouldWindTheCableBeforeAnyByteLeaves) {
  AxisConfig wound = config();
  wound.backlash = 0.5;
  wound.cable_lower = -12;
  wound.cable_upper = 400;
  MotionAxis<Degrees> tied(wound, port, clock);
  tied.home();
  const auto message = [&](double target) {
    return message_of<LimitError>([&] { tied.start(Degrees{target}); });
  };
  EXPECT_THAT(message(-11.6),
              AllOf(HasSubstr("[-11.5, 30] deg"), HasSubstr("cable range [-12, 30]"),
                    HasSubstr("overshoot of 0.5")));
  EXPECT_THAT(message(31), AllOf(HasSubstr("widen the limits"), Not(HasSubstr("cable"))));
  EXPECT_THAT(message(std::nan("")), HasSubstr("Nothing was sent"));
  EXPECT_TRUE(port.sent.empty());
  EXPECT_DOUBLE_EQ(tied.limits().lower.value, -12);
  tied.check(Degrees{-11.5});
}

// ---- what a stop may and may not believe

TEST_F(MotionRules, KeepsItsReferenceThroughAnOrdinaryStop) {
  axis.home();
  axis.start(Degrees{20});
  axis.advance();
  axis.stop();
  EXPECT_TRUE(axis.homed());
}

TEST_F(MotionRules, LosesItsReferenceIfAStopFindsItWhereItCannotBe) {
  axis.home();
  move(20);
  port.counter_shift = -20;  // the controller was reset: its counter says 0
  axis.stop();
  EXPECT_FALSE(axis.homed());

  port.counter_shift = 0;
  axis.home();
  axis.start(Degrees{20});
  axis.advance();
  port.counter_shift = -200;
  axis.stop();
  EXPECT_FALSE(axis.homed());
}

TEST_F(MotionRules, LosesItsReferenceWithAHaltThatHadNoRamp) {
  axis.home();
  port.deaf_to_slow_stops = port.never_ends_slowly = true;
  axis.start(Degrees{28});
  axis.advance();
  axis.stop();
  EXPECT_THAT(port.stops, ElementsAre("decelerating", "immediate"));
  EXPECT_FALSE(axis.homed());
}

TEST_F(MotionRules, LosesItsReferenceWithAnEmergencyStopThatAnybodySaw) {
  axis.home();
  port.fault = "the emergency stop is pressed";
  axis.position();  // a baseline reading, say
  port.fault.clear();
  EXPECT_FALSE(axis.homed());
  EXPECT_THAT(fails<DeviceError>(5), HasSubstr("not homed (the emergency stop is pressed)"));
  axis.home();
  EXPECT_FALSE(move(5).missed);
}

TEST_F(MotionRules, KeepsItsReferenceIfAnotherAxisIsStopped) {
  axis.home();
  axis.start(Degrees{20});
  axis.advance();
  port.gives_way = true;
  EXPECT_FALSE(axis.advance());
  port.gives_way = false;
  while (!axis.advance()) {
  }
  EXPECT_TRUE(axis.homed());
}

}  // namespace
}  // namespace turntable
