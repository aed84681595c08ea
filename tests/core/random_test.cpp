#include "src/core/random.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "tests/support/draws.h"

namespace turntable {
namespace {

TEST(RandomDraws, are_the_same_for_the_same_address) {
  Random a(7, "yaw repeatability", 3), b(7, "yaw repeatability", 3);
  for (int i = 0; i < 100; ++i) {
    ASSERT_EQ(a(), b());
    ASSERT_EQ(a.normal(), b.normal());
  }
}

TEST(RandomDraws, differ_between_seeds_streams_and_indices) {
  std::set<std::uint64_t> first;
  int addresses = 0;
  for (std::uint64_t seed = 0; seed < 10; ++seed)
    for (const char* stream : {"", "yaw", "yaw repeatability", "pitch"})
      for (std::uint64_t index = 0; index < 10; ++index) {
        first.insert(Random(seed, stream, index)());
        ++addresses;
      }
  EXPECT_EQ(first.size(), static_cast<std::size_t>(addresses));
}

TEST(RandomDraws, of_neighbouring_indices_are_uncorrelated) {
  double product = 0.0;
  constexpr int kDraws = 20000;
  for (std::uint64_t index = 0; index < kDraws; ++index)
    product += Random(1, "noise", index).normal() * Random(1, "noise", index + 1).normal();
  EXPECT_LT(std::abs(product / kDraws), 4.0 / std::sqrt(kDraws));
}

TEST(RandomDraws, uniform_fills_its_interval_and_excludes_the_upper_end) {
  Random random = draws_of_this_test();
  double sum = 0.0, squares = 0.0;
  constexpr int kDraws = 100000;
  for (int i = 0; i < kDraws; ++i) {
    const double u = random.uniform();
    ASSERT_GE(u, 0.0);
    ASSERT_LT(u, 1.0);
    sum += u;
    squares += u * u;
  }
  EXPECT_NEAR(sum / kDraws, 0.5, 0.005);
  EXPECT_NEAR(squares / kDraws, 1.0 / 3.0, 0.005);
  for (int i = 0; i < 1000; ++i) {
    const double u = random.uniform(-3.0, -1.0);
    ASSERT_GE(u, -3.0);
    ASSERT_LT(u, -1.0);
  }
}

TEST(RandomDraws, normal_has_the_moments_of_a_normal) {
  Random random = draws_of_this_test();
  double sum = 0.0, squares = 0.0, fourth = 0.0;
  constexpr int kDraws = 100000;
  for (int i = 0; i < kDraws; ++i) {
    const double x = random.normal();
    sum += x;
    squares += x * x;
    fourth += x * x * x * x;
  }
  EXPECT_NEAR(sum / kDraws, 0.0, 0.015);
  EXPECT_NEAR(squares / kDraws, 1.0, 0.02);
  EXPECT_NEAR(fourth / kDraws, 3.0, 0.2);
}

TEST(RandomDraws, are_pinned_so_that_committed_results_stay_reproducible) {
  Random random(1, "pinned");
  const std::uint64_t bits = random();
  const double normal = random.normal();
  EXPECT_EQ(bits, 9740260803923118182u);
  EXPECT_EQ(normal, -0x1.984ea43991b8ep-1);
}

}  // namespace
}  // namespace turntable
