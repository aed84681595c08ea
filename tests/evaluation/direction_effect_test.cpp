#include "src/evaluation/direction_effect.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "src/core/random.h"

namespace turntable {
namespace {

/// Every place from both sides, `visits` times, with an error of its own for every place and repeat.
std::vector<DirectedError> sweeps(int places, int visits, double effect, double sigma,
                                  Random& random) {
  std::vector<DirectedError> out;
  for (int repeat = 1; repeat <= visits; ++repeat) {
    const double initial = random.normal();
    for (int place = 0; place < places; ++place)
      for (const int direction : {1, -1})
        out.push_back({static_cast<std::size_t>(place), repeat, direction,
                       5.0 * place + initial + 0.5 * effect * direction + sigma * random.normal()});
  }
  return out;
}

TEST(DirectionEffect, IsWhatIsLeftOfPlacesAndRepeats) {
  Random random(7, "test");
  const WithInterval found = direction_effect(sweeps(6, 3, 0.02, 0.0, random));
  EXPECT_NEAR(found.value, 0.02, 1e-12);
  EXPECT_NEAR(found.interval.lower, 0.02, 1e-12);
  EXPECT_NEAR(found.interval.upper, 0.02, 1e-12);
}

TEST(DirectionEffect, ItsIntervalMissesTheTruthOnceInTwentyAlsoWithFewPoses) {
  constexpr int kTrials = 4000;
  for (const auto& [places, visits] : {std::pair(3, 1), std::pair(5, 1), std::pair(2, 3)}) {
    int missed = 0;
    for (int k = 0; k < kTrials; ++k) {
      Random random(11, "test", static_cast<std::uint64_t>(k));
      const WithInterval found = direction_effect(sweeps(places, visits, 0.3, 1.0, random));
      missed += found.interval.lower > 0.3 || found.interval.upper < 0.3;
    }
    EXPECT_NEAR(missed / double{kTrials}, 0.05, 0.015)
        << places << " places, " << visits << " visits";
  }
}

TEST(DirectionEffect, StatesNothingThatTheErrorsCannotTell) {
  const auto value = [](std::vector<DirectedError> errors) {
    return direction_effect(errors).value;
  };
  EXPECT_TRUE(std::isnan(value({})));
  EXPECT_TRUE(std::isnan(value({{0, 1, 1, 0.1}, {0, 1, 1, 0.2}}))) << "one direction only";
  EXPECT_TRUE(std::isnan(value({{0, 1, 1, 0.1}, {1, 1, -1, 0.2}}))) << "at different places";
  EXPECT_TRUE(std::isnan(value({{0, 1, 1, 0.1}, {0, 2, -1, 0.2}, {1, 1, 1, 0.1}, {1, 2, -1, 0.2}})))
      << "each repeat has one direction, and an initial pose of its own";
  const WithInterval two =
      direction_effect(std::vector<DirectedError>{{0, 1, 1, 0.3}, {0, 1, -1, 0.1}});
  EXPECT_NEAR(two.value, 0.2, 1e-12);
  EXPECT_TRUE(std::isnan(two.interval.lower)) << "nothing tells the noise";
  EXPECT_THROW((void)direction_effect(std::vector<DirectedError>{{0, 1, 0, 0.1}}),
               std::invalid_argument);
}

}  // namespace
}  // namespace turntable
