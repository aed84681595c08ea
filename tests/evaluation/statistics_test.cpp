#include "src/evaluation/statistics.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "src/core/random.h"
#include "src/core/units.h"
#include "tests/support/draws.h"
#include "tests/support/golden.h"

namespace turntable {
namespace {

Gimbal default_gimbal() {
  GimbalConfig config;
  config.axes = {Vector3d::UnitZ(), Vector3d::UnitY(), Vector3d::UnitX()};  // yaw, roll, pitch
  return Gimbal(config);
}

Matrix3d rotation_deg(const Gimbal& gimbal, double pitch, double roll, double yaw) {
  return gimbal.rotation({rad_from_deg(yaw), rad_from_deg(roll), rad_from_deg(pitch)});
}

// The errors of the files that come with the project are printed to six decimals, their statistics
// were taken before: what rounding by `quantum` may do to the RMSE of n errors (five standard
// deviations). Errors with fewer decimals are taken as exact, and so are errors with more than
// eight.
double rounding_of(const std::vector<Vector3d>& errors_deg) {
  for (const double quantum : {1e-6, 1e-7, 1e-8}) {
    bool fits = true, fits_coarser = true;
    for (const Vector3d& e : errors_deg)
      for (const double value : e) {
        const auto multiple = [&](double q) { return std::abs(std::remainder(value, q)) < 1e-12; };
        fits = fits && multiple(quantum);
        fits_coarser = fits_coarser && multiple(10 * quantum);
      }
    if (fits && !fits_coarser)
      return 5.0 * quantum / std::sqrt(12.0 * static_cast<double>(errors_deg.size()));
  }
  return 0.0;
}

TEST(StatisticsGolden, maxima_and_rmse_agree_on_every_case) {
  const nlohmann::json document = golden::load("statistics.json");
  double worst_max = 0.0, worst_rmse = 0.0, worst_total = 0.0;
  std::size_t number = 0;
  for (const auto& test_case : document.at("cases")) {
    SCOPED_TRACE("case " + std::to_string(number++));
    const auto given = golden::vectors<3>(test_case.at("errors_pitch_roll_yaw_deg"));
    std::vector<PoseError> errors;
    for (const Vector3d& e : given) errors.push_back({e.x(), e.y(), e.z(), e.norm()});
    ASSERT_FALSE(errors.empty());
    const ErrorStatistics got = error_statistics(errors, 0);
    const Vector3d want_rmse = golden::vector<3>(test_case.at("rmse_deg"));
    const double want_total = test_case.at("total_rmse_deg");
    const double rounding = rounding_of(given);

    const Vector3d max(got.pitch.max_signed_deg, got.roll.max_signed_deg, got.yaw.max_signed_deg);
    const double max_difference =
        golden::largest_difference(max, golden::vector<3>(test_case.at("max_error_signed_deg")));
    EXPECT_LT(max_difference, golden::kAgreement);
    const Vector3d rmse(got.pitch.rmse_deg, got.roll.rmse_deg, got.yaw.rmse_deg);
    const double rmse_difference = golden::largest_difference(rmse, want_rmse);
    EXPECT_LT(rmse_difference, golden::kAgreement + rounding);
    EXPECT_LT(std::abs(got.rmse_total_deg - want_total), golden::kAgreement + rounding);
    // The rule of the total, apart from the rounding of the errors.
    const double total_difference =
        std::abs(total_rmse(want_rmse.x(), want_rmse.y(), want_rmse.z()) - want_total);
    EXPECT_LT(total_difference, golden::kAgreement);
    worst_max = std::max(worst_max, max_difference);
    worst_rmse = std::max(worst_rmse, rmse_difference);
    worst_total = std::max(worst_total, total_difference);
  }
  golden::report("statistics, maxima, deg", number, worst_max);
  golden::report("statistics, RMSE per axis (errors rounded in the file), deg", number, worst_rmse);
  golden::report("statistics, total RMSE from the axes', deg", number, worst_total);
}

TEST(Statistics, failed_poses_are_counted_and_never_dropped) {
  const std::array errors{PoseError{0.1, 0, 0, 0.1}, PoseError{-0.1, 0, 0, 0.1}};
  const ErrorStatistics some = error_statistics(errors, 3);
  EXPECT_EQ(some.poses, 5u);
  EXPECT_EQ(some.failed, 3u);
  EXPECT_DOUBLE_EQ(some.failed_share(), 0.6);
  const ErrorStatistics all = error_statistics({}, 4);
  EXPECT_EQ(all.poses, 4u);
  EXPECT_EQ(all.failed, 4u);
  EXPECT_DOUBLE_EQ(all.failed_share(), 1.0);
  EXPECT_TRUE(std::isnan(all.rmse_total_deg));
  EXPECT_TRUE(std::isnan(all.pitch.max_signed_deg));
  EXPECT_EQ(error_statistics({}, 0).failed_share(), 0.0);
}

TEST(Statistics, the_maximum_keeps_its_sign) {
  EXPECT_EQ(max_signed(std::array{0.1, -0.3, 0.2}), -0.3);
  EXPECT_EQ(max_signed(std::array{0.3, -0.3}), 0.3);
  EXPECT_TRUE(std::isnan(max_signed({})));
}

TEST(Statistics, bias_and_scatter_make_up_the_rmse) {
  Random random = draws_of_this_test();
  std::vector<double> values;
  for (int i = 0; i < 50; ++i) values.push_back(0.3 + random.normal());
  const double n = 50.0;
  const double sd = standard_deviation(values);
  EXPECT_NEAR(std::pow(root_mean_square(values), 2),
              std::pow(mean(values), 2) + sd * sd * (n - 1) / n, 1e-12);
  EXPECT_TRUE(std::isnan(standard_deviation(std::array{1.0})));
}

TEST(Statistics, percentile_interpolates_between_sorted_values) {
  const std::array values{4.0, 1.0, 3.0, 2.0, 5.0};
  EXPECT_DOUBLE_EQ(percentile(values, 0.0), 1.0);
  EXPECT_DOUBLE_EQ(percentile(values, 0.5), 3.0);
  EXPECT_DOUBLE_EQ(percentile(values, 0.95), 4.8);
  EXPECT_DOUBLE_EQ(percentile(values, 1.0), 5.0);
  EXPECT_DOUBLE_EQ(percentile(std::array{7.0}, 0.95), 7.0);
  EXPECT_TRUE(std::isnan(percentile({}, 0.5)));
}

TEST(Statistics, the_error_of_a_pose_is_the_difference_of_its_angles) {
  const Gimbal gimbal = default_gimbal();
  const PoseError error = pose_error(gimbal, rotation_deg(gimbal, 10.02, 20.0, -30.05),
                                     rotation_deg(gimbal, 10, 20.01, -30));
  EXPECT_NEAR(error.pitch_deg, 0.02, 1e-12);
  EXPECT_NEAR(error.roll_deg, -0.01, 1e-12);
  EXPECT_NEAR(error.yaw_deg, -0.05, 1e-12);
  EXPECT_GT(error.geodesic_deg, 0.03);
  EXPECT_LT(error.geodesic_deg, 0.08);
}

TEST(Statistics, errors_wrap_across_a_half_turn) {
  const Gimbal gimbal = default_gimbal();
  const PoseError error =
      pose_error(gimbal, rotation_deg(gimbal, 0, 0, -179.9), rotation_deg(gimbal, 0, 0, 179.9));
  EXPECT_NEAR(error.yaw_deg, 0.2, 1e-10);
  EXPECT_NEAR(error.geodesic_deg, 0.2, 1e-10);
}

TEST(Statistics, a_fixed_rotation_of_the_target_cancels_in_relative_attitudes) {
  Random random = draws_of_this_test();
  const Gimbal gimbal = default_gimbal();
  const Matrix3d Y = rotation_from_vector({0.1, -0.2, 0.3});
  const Matrix3d R_0 = rotation_deg(gimbal, 3, -2, 5);
  const Matrix3d R_k = rotation_deg(gimbal, random.uniform(-30, 30), random.uniform(-30, 30), 40);
  EXPECT_LT((relative_attitude(R_k * Y, R_0 * Y) - relative_attitude(R_k, R_0)).norm(), 1e-14);
  EXPECT_LT((relative_attitude(R_k, R_k) - Matrix3d::Identity()).norm(), 1e-14);
}

TEST(Statistics, bootstrap_intervals_hold_the_truth_as_often_as_they_say) {
  Random random = draws_of_this_test();
  int held = 0;
  constexpr int kTrials = 300;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<double> values(100);
    for (double& v : values) v = 2.0 * random.normal();
    const Interval interval = bootstrap_interval(
        values.size(),
        [&](std::span<const std::size_t> drawn) {
          double sum = 0.0;
          for (const std::size_t i : drawn) sum += values[i] * values[i];
          return std::sqrt(sum / static_cast<double>(drawn.size()));
        },
        Random(7, "bootstrap", static_cast<std::uint64_t>(trial)), 400);
    EXPECT_LT(interval.lower, interval.upper);
    held += interval.lower <= 2.0 && 2.0 <= interval.upper;
  }
  // 95 %, a little less for 100 values; four standard deviations of 300 trials.
  EXPECT_NEAR(held / static_cast<double>(kTrials), 0.94, 0.055);
  EXPECT_TRUE(std::isnan(bootstrap_interval(
                             1, [](auto) { return 1.0; }, Random(1, "x"))
                             .lower));
}

}  // namespace
}  // namespace turntable
