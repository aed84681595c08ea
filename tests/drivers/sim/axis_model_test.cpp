#include "drivers/sim/axis_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr Ramp kRamp{1, 25, 50};

AxisModel ideal() { return {rotary_axis(AxisId::kYaw, "X"), {}, 1}; }

TEST(Trapezoid, TakesTheTimeOfItsRampsAndItsCruise) {
  // Ramps of (25 - 1)/50 = 0.48 s and 6.24 deg each; 10 deg less 12.48 deg is a triangle, 20 deg is
  // not.
  EXPECT_NEAR(Trapezoid(20, kRamp).duration(), 2 * 0.48 + (20 - 12.48) / 25, 1e-12);
  const double peak = std::sqrt(1.0 + 50.0 * 10.0);
  EXPECT_NEAR(Trapezoid(10, kRamp).duration(), 2 * (peak - 1) / 50, 1e-12);
  EXPECT_EQ(Trapezoid(0, kRamp).duration(), 0.0);
}

TEST(Trapezoid, IsTheIntegralOfItsSpeed) {
  for (const double distance : {0.01, 1.0, 12.0, 20.0, 300.0}) {
    const Trapezoid t(distance, kRamp);
    const int n = 20000;
    double way = 0;
    for (int i = 0; i < n; ++i) way += t.speed_at((i + 0.5) * t.duration() / n) * t.duration() / n;
    EXPECT_NEAR(way, distance, 1e-4 * distance);
    EXPECT_NEAR(t.distance_at(0.4 * t.duration()) + t.distance_at(0.6 * t.duration()), distance,
                1e-9);
    EXPECT_EQ(t.distance_at(t.duration()), distance);
  }
}

TEST(AxisModel, CountsWholePulsesAndEndsOnTheNearestOne) {
  AxisModel axis = ideal();
  axis.move_to(Time{0}, 1.0008, kRamp);
  EXPECT_TRUE(axis.moving(Time{0}));
  for (Time t{0}; t < *axis.ends_at(); t += milliseconds{7}) {
    const double pulses = axis.counter_position(t) / 0.00125;
    EXPECT_NEAR(pulses, std::round(pulses), 1e-6);
  }
  EXPECT_FALSE(axis.moving(*axis.ends_at()));
  EXPECT_NEAR(axis.counter_position(seconds{5}), 1.00125, 1e-12);
}

TEST(AxisModel, PowersUpAtCounterZeroWhereverItStands) {
  const AxisModel axis(rotary_axis(AxisId::kYaw, "X"), {.home_offset = 12.5}, 1);
  EXPECT_EQ(axis.counter_position(Time{0}), 0.0);
  EXPECT_EQ(axis.true_position(Time{0}), 12.5);
  EXPECT_FALSE(axis.homed(Time{0}));
}

TEST(AxisModel, FindsItsHomeFromEitherSide) {
  for (const double offset : {12.5, -12.5, 0.0, 0.1, -0.1}) {
    AxisModel axis(rotary_axis(AxisId::kYaw, "X"), {.backlash = 0.02, .home_offset = offset}, 1);
    axis.home(Time{0}, {1, 5, 50});
    EXPECT_FALSE(axis.homed(Time{0}));
    const Time end = *axis.ends_at();
    EXPECT_LT(end, seconds{10});
    EXPECT_NEAR(axis.true_position(end), 0.0, 1e-12) << offset;
    EXPECT_EQ(axis.counter_position(end), 0.0);
    EXPECT_TRUE(axis.homed(end));
    axis.move_to(end, 3.0, kRamp);
    EXPECT_NEAR(axis.true_position(seconds{60}), 3.0, 1e-12);
    EXPECT_TRUE(axis.homed(seconds{60}));
  }
}

TEST(AxisModel, LosesNothingIfHomingIsBrokenOffButIsNotHomed) {
  AxisModel axis(rotary_axis(AxisId::kYaw, "X"), {.home_offset = 12.5}, 1);
  axis.home(Time{0}, {1, 5, 50});
  axis.stop(seconds{1});
  EXPECT_FALSE(axis.homed(seconds{60}));
  EXPECT_NEAR(axis.true_position(seconds{60}) - axis.counter_position(seconds{60}), 12.5, 1e-9);
}

TEST(AxisModel, DeceleratesWhenStopped) {
  AxisModel axis = ideal();
  axis.move_to(Time{0}, 25.0, kRamp);
  const Time when = milliseconds{700};
  const double at = axis.counter_position(when);
  axis.stop(when);
  EXPECT_NEAR(axis.counter_position(when), at, 0.00126);
  EXPECT_NEAR(turntable::seconds(*axis.ends_at() - when), 24.0 / 50, 1e-3);
  EXPECT_NEAR(axis.counter_position(seconds{60}) - at, (25.0 * 25 - 1) / 100, 0.005);
  EXPECT_FALSE(axis.moving(seconds{60}));
}

TEST(AxisModel, HaltsOnTheSpotWhenTold) {
  AxisModel axis = ideal();
  axis.move_to(Time{0}, 25.0, kRamp);
  const double at = axis.counter_position(milliseconds{700});
  axis.stop(milliseconds{700}, true);
  EXPECT_FALSE(axis.moving(milliseconds{700}));
  EXPECT_NEAR(axis.counter_position(seconds{60}), at, 0.00126);
}

TEST(AxisModel, StopsWithoutAnInitialSpeedAtAnyTime) {
  for (int ms = 0; ms < 1000; ++ms) {  // 5 deg take 632 ms
    AxisModel axis = ideal();
    axis.move_to(Time{0}, 5.0, {0.0, 25.0, 50.0});
    const Time when = milliseconds{ms};
    axis.stop(when);
    EXPECT_FALSE(axis.moving(when + milliseconds{350})) << ms;
  }
}

TEST(AxisModel, StopsAtTheEndOfItsMechanics) {
  AxisModel axis = ideal();
  axis.move_to(Time{0}, 1000.0, kRamp);
  EXPECT_NEAR(axis.true_position(seconds{3600}), axis.hard_upper(), 1e-9);
  EXPECT_TRUE(axis.at_hard_limit(seconds{3600}));
  EXPECT_GT(axis.hard_upper(), 180.0);
}

TEST(AxisModel, LosesMotionWhenTheDirectionChanges) {
  AxisModel axis(rotary_axis(AxisId::kYaw, "X"), {.backlash = 0.02}, 1);
  auto go = [&, now = Time{0}](double to) mutable {
    axis.move_to(now, to, kRamp);
    now += seconds{60};
    return axis.true_position(now);
  };
  EXPECT_NEAR(go(5), 5.0, 1e-12);
  EXPECT_NEAR(go(4.99), 5.0, 1e-12);  // taken up by the play
  EXPECT_NEAR(go(3), 3.02, 1e-12);
  EXPECT_NEAR(go(3.005), 3.02, 1e-12);
  EXPECT_NEAR(go(3.1), 3.1, 1e-12);
}

TEST(AxisModel, HasAPeriodicErrorPerRevolutionOfItsWorm) {
  AxisModel axis(rotary_axis(AxisId::kYaw, "X"), {.worm_amplitude = 0.004}, draws_of_this_test()());
  std::vector<double> errors;
  Time now{0};
  for (int i = 0; i <= 32; ++i) {  // 16 positions in each of two revolutions of 2 deg
    axis.move_to(now, 0.125 * i, kRamp);
    now += seconds{60};
    errors.push_back(axis.true_position(now) - axis.counter_position(now));
  }
  EXPECT_NEAR(errors[0], 0.0, 1e-12);
  for (std::size_t i = 0; i + 16 < errors.size(); ++i)
    EXPECT_NEAR(errors[i], errors[i + 16], 1e-12);
  const auto [least, most] = std::ranges::minmax(errors);
  EXPECT_NEAR(most - least, 0.008, 0.0002);
}

TEST(AxisModel, ScattersItsArrivalsByItsRepeatability) {
  AxisModel axis(rotary_axis(AxisId::kYaw, "X"), {.repeatability = 0.005}, draws_of_this_test()());
  const int n = 2000;
  double sum = 0, squares = 0;
  Time now{0};
  for (int i = 0; i < n; ++i) {
    axis.move_to(now, i % 2 == 0 ? 1.0 : 0.0, kRamp);
    now += seconds{60};
    const double error = axis.true_position(now) - axis.counter_position(now);
    sum += error;
    squares += error * error;
  }
  EXPECT_NEAR(sum / n, 0.0, 4 * 0.0025 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(squares / n), 0.0025, 0.0002);
}

TEST(AxisModel, MovesWithoutJumps) {
  AxisModel axis(
      rotary_axis(AxisId::kYaw, "X"),
      {.repeatability = 0.01, .backlash = 0.02, .worm_amplitude = 0.004, .home_offset = 3},
      draws_of_this_test()());
  Random draws = draws_of_this_test(1);
  Time now{0};
  double last = axis.true_position(now);
  axis.home(now, {1, 5, 50});
  for (int step = 0; step < 20000; ++step) {
    now += milliseconds{1};
    const double here = axis.true_position(now);
    ASSERT_LT(std::abs(here - last), 0.03) << step;
    last = here;
    if (draws.uniform() < 0.002) axis.move_to(now, draws.uniform(-20, 20), kRamp);
    if (draws.uniform() < 0.002) axis.stop(now);
  }
}

TEST(AxisModel, DoesTheSameForTheSameSeedAndNotForAnother) {
  const std::uint64_t seed = draws_of_this_test()();
  const auto run = [](std::uint64_t s) {
    AxisModel axis(rotary_axis(AxisId::kYaw, "X"),
                   {.repeatability = 0.005, .worm_amplitude = 0.004}, s);
    axis.move_to(Time{0}, 5.0, kRamp);
    return axis.true_position(seconds{60});
  };
  EXPECT_EQ(run(seed), run(seed));
  EXPECT_NE(run(seed), run(seed + 1));
}

TEST(AxisModel, NeverEndsWithStuckPulses) {
  AxisModel axis = ideal();
  axis.move_to(Time{0}, 25.0, kRamp);
  axis.jam(milliseconds{500}, AxisModel::Jam::kPulses);
  EXPECT_TRUE(axis.moving(seconds{3600}));
  EXPECT_FALSE(axis.ends_at());
  EXPECT_EQ(axis.counter_position(seconds{3600}), axis.counter_position(milliseconds{500}));
  axis.stop(seconds{3600});
  EXPECT_FALSE(axis.moving(seconds{3600}));
}

TEST(AxisModel, CountsOnWithABlockedTable) {
  AxisModel axis = ideal();
  axis.move_to(Time{0}, 25.0, kRamp);
  axis.jam(milliseconds{500}, AxisModel::Jam::kTable);
  EXPECT_EQ(axis.counter_position(seconds{60}), 25.0);
  EXPECT_LT(axis.true_position(seconds{60}), 25.0);
}

TEST(AxisModel, ForgetsItsReferenceWhenPowerCycled) {
  AxisModel axis = ideal();
  axis.home(Time{0}, {1, 5, 50});
  axis.move_to(seconds{10}, 5.0, kRamp);
  axis.power_cycle(seconds{20});
  EXPECT_EQ(axis.counter_position(seconds{20}), 0.0);
  EXPECT_EQ(axis.true_position(seconds{20}), 5.0);
  EXPECT_FALSE(axis.homed(seconds{20}));
}

}  // namespace
}  // namespace turntable::sim
