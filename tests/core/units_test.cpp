#include "src/core/units.h"

#include <gtest/gtest.h>

#include <type_traits>

namespace turntable {
namespace {

// The mistake these types exist for does not compile.
static_assert(!std::is_convertible_v<Millimetres, Degrees>);
static_assert(!std::is_convertible_v<Steps, Millimetres>);
static_assert(!std::is_convertible_v<double, Degrees>);

TEST(Units, add_subtract_compare_and_scale) {
  EXPECT_EQ(Millimetres{2} + Millimetres{3}, Millimetres{5});
  EXPECT_EQ(Millimetres{2} - Millimetres{3}, -Millimetres{1});
  EXPECT_EQ(2.0 * Degrees{1.5}, Degrees{3});
  EXPECT_LT(Degrees{-1}, Degrees{1});
  EXPECT_EQ(abs(Degrees{-4}), Degrees{4});
  EXPECT_EQ(Millimetres::unit(), "mm");
  EXPECT_EQ(Degrees::unit(), "deg");
}

TEST(Units, degrees_and_radians_return_to_each_other) {
  EXPECT_DOUBLE_EQ(rad_from_deg(180.0), std::numbers::pi);
  EXPECT_DOUBLE_EQ(deg_from_rad(rad_from_deg(12.345)), 12.345);
}

TEST(StepScale, a_rotary_table_of_180_to_1_and_1600_pulses_turns_0_00125_deg_per_pulse) {
  const StepScale<Degrees> scale{{360.0 / (180.0 * 1600.0)}};
  EXPECT_DOUBLE_EQ(scale.per_step.value, 0.00125);
  EXPECT_EQ(scale.to_steps(Degrees{45.0}).count, 36000);
  EXPECT_DOUBLE_EQ(scale.from_steps(Steps{-800}).value, -1.0);
}

TEST(StepScale, rounds_to_the_nearest_pulse_and_halves_away_from_zero) {
  const StepScale<Millimetres> scale{{0.5}};
  EXPECT_EQ(scale.to_steps(Millimetres{0.74}).count, 1);
  EXPECT_EQ(scale.to_steps(Millimetres{0.75}).count, 2);
  EXPECT_EQ(scale.to_steps(Millimetres{-0.74}).count, -1);
  EXPECT_EQ(scale.to_steps(Millimetres{-0.75}).count, -2);
}

TEST(StepScale, every_pulse_returns_through_its_engineering_value) {
  const StepScale<Degrees> scale{{0.00125}};
  for (std::int64_t count = -300000; count <= 300000; count += 7)
    ASSERT_EQ(scale.to_steps(scale.from_steps(Steps{count})).count, count);
}

TEST(StepScale, the_grid_value_is_within_half_a_pulse_and_stays_put) {
  const StepScale<Degrees> scale{{0.00125}};
  for (const double deg : {0.0, 3.0, -4.9999, 12.3456789}) {
    const Degrees on_grid = scale.on_grid({deg});
    EXPECT_LE(std::abs(on_grid.value - deg), 0.5 * 0.00125 + 1e-12);
    EXPECT_EQ(scale.on_grid(on_grid), on_grid);
  }
}

}  // namespace
}  // namespace turntable
