#include "src/evaluation/scenario_statistics.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/draws.h"

namespace turntable {
namespace {

/// One scenario, two solvers, errors as the test says.
class ScenarioStatisticsTest : public ::testing::Test {
 protected:
  ScenarioStatisticsTest() {
    evaluation.solvers = {find_solver("posit"), find_solver("aopit")};
    plan.scenarios.resize(1);
    plan.scenarios[0].name = "sweep";
    plan.scenarios[0].axes = {AxisId::kYaw};
  }

  /// A pose of the sweep with a yaw error for each solver; NaN: not measured.
  void visit(double yaw_deg, int repeat, double first, double other) {
    EvaluatedPose pose;
    pose.planned.index = evaluation.poses.size();
    pose.planned.yaw_deg = yaw_deg;
    pose.planned.repeat = repeat;
    for (std::size_t k = 0; k < 2; ++k) {
      const double e = k == 0 ? first : other;
      PoseResult result;
      result.solver = evaluation.solvers[k];
      result.measured = std::isfinite(e);
      if (result.measured) result.error.yaw_deg = e;
      pose.results.push_back(result);
    }
    evaluation.poses.push_back(std::move(pose));
  }
  void reference() {
    EvaluatedPose pose;
    pose.planned.role = PoseRole::kReference;
    pose.results.resize(2);
    evaluation.poses.push_back(std::move(pose));
  }

  Evaluation evaluation;
  Plan plan;
  static constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
};

TEST_F(ScenarioStatisticsTest, RepeatabilityIsTheSpreadAtTheSameAngles) {
  // Angles differ by a degree, repeats of an angle by +-0.1: only the latter is repeatability.
  for (int repeat : {1, 2}) {
    reference();
    for (int k = 1; k <= 5; ++k) visit(k, repeat, k + (repeat == 1 ? 0.1 : -0.1), kNaN);
  }
  const auto statistics = scenario_statistics(evaluation);
  ASSERT_EQ(statistics.size(), 2u);
  const ScenarioStatistics& s = statistics[0];
  EXPECT_EQ(s.repeats, 2);
  EXPECT_EQ(s.pooled.poses, 10u);
  EXPECT_NEAR(s.axes[2].repeatability_deg, 0.1 * std::sqrt(2.0), 1e-12);
  EXPECT_NEAR(s.axes[0].repeatability_deg, 0.0, 1e-12);
  EXPECT_NEAR(s.rmse_total_deg.value, s.pooled.rmse_total_deg, 1e-12);
  EXPECT_LT(s.rmse_total_deg.interval.lower, s.rmse_total_deg.value);
  EXPECT_GT(s.rmse_total_deg.interval.upper, s.rmse_total_deg.value);
  // One that measured nothing: counted, and nothing stated.
  EXPECT_EQ(statistics[1].pooled.failed, 10u);
  EXPECT_TRUE(std::isnan(statistics[1].rmse_total_deg.value));
  EXPECT_TRUE(std::isnan(statistics[1].axes[2].repeatability_deg));
}

TEST_F(ScenarioStatisticsTest, DirectionsAreComparedAtTheSameAngle) {
  // Errors grow with the angle, and are 0.02 larger on the way up.
  reference();
  for (int sweep = 0; sweep < 3; ++sweep) {
    for (int k = 1; k <= 9; ++k) visit(k, 1, 0.5 * k + 0.02, 0);
    for (int k = 8; k >= 1; --k) visit(k, 1, 0.5 * k, 0);
    visit(0, 1, 0, 0);
  }
  const auto s = scenario_statistics(evaluation);
  EXPECT_NEAR(s[0].axes[2].forward_minus_backward_deg.value, 0.02, 1e-9);
  EXPECT_TRUE(std::isnan(s[0].axes[0].forward_minus_backward_deg.value)) << "pitch never moved";
}

TEST(ChangeVerdict, WithoutAnIntervalThereAreTooFewPoses) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(change_verdict({0.1, {kNaN, kNaN}}, 0.2), ChangeVerdict::kTooFew);
  EXPECT_EQ(change_verdict({kNaN, {kNaN, kNaN}}, 0.2), ChangeVerdict::kNothing);
  EXPECT_EQ(change_verdict({0.1, {-0.1, 0.3}}, 0.2), ChangeVerdict::kCannotTell);
}

TEST_F(ScenarioStatisticsTest, OneDirectionHasNoDifference) {
  reference();
  for (int k = 1; k <= 9; ++k) visit(k, 1, 0.1, 0.1);
  EXPECT_TRUE(
      std::isnan(scenario_statistics(evaluation)[0].axes[2].forward_minus_backward_deg.value));
}

TEST_F(ScenarioStatisticsTest, AnIntervalHoldsTheTruthAsOftenAsItSays) {
  Random random = draws_of_this_test();
  int held = 0;
  constexpr int kTrials = 200;
  for (int trial = 0; trial < kTrials; ++trial) {
    evaluation.poses.clear();
    reference();
    for (int k = 0; k < 40; ++k) visit(k, 1, random.normal(), random.normal());
    const PairedComparison c = paired_comparisons(evaluation).front();
    held += c.verdict() == PairedComparison::Verdict::kCannotTell;
  }
  EXPECT_GT(held, 0.88 * kTrials) << "two equal solvers were told apart too often";
}

TEST_F(ScenarioStatisticsTest, TheBetterSolverIsCalledBetter) {
  Random random = draws_of_this_test();
  reference();
  for (int k = 0; k < 60; ++k) {
    const double e = random.normal();
    visit(k, 1, e, 0.8 * e);
  }
  visit(60, 1, 5.0, kNaN);  // not in the comparison, but counted
  const PairedComparison c = paired_comparisons(evaluation).front();
  EXPECT_EQ(c.verdict(), PairedComparison::Verdict::kBetter);
  EXPECT_EQ(c.poses, 60u);
  EXPECT_EQ(c.only_first, 1u);
  EXPECT_EQ(c.only_other, 0u);
  EXPECT_DOUBLE_EQ(c.share_other_nearer, 1.0);
}

TEST_F(ScenarioStatisticsTest, ADifferenceNobodyWouldSeeIsNone) {
  Random random = draws_of_this_test();
  reference();
  for (int k = 0; k < 60; ++k) {
    const double e = random.normal();
    visit(k, 1, e, 0.999 * e);
  }
  EXPECT_EQ(paired_comparisons(evaluation).front().verdict(), PairedComparison::Verdict::kSame);
}

TEST_F(ScenarioStatisticsTest, Iso230ByHand) {
  // Two positions between the ends, three approaches from each side.
  // Position 1: up -0.1 0 0.1 (mean 0, s 0.1), down 0.2 0.3 0.4 (mean 0.3, s 0.1): B -0.3.
  // Position 2: up 0.5 0.5 0.5, down 0.5 0.5 0.5: B 0.
  reference();
  const double up[]{-0.1, 0.0, 0.1}, down[]{0.2, 0.3, 0.4};
  for (int k = 0; k < 3; ++k) {
    visit(1, 1, up[k], 0);
    visit(2, 1, 0.5, 0);
    visit(3, 1, 9.0, 0);  // the turning point is come to from one side only, and is left out
    visit(2, 1, 0.5, 0);
    visit(1, 1, down[k], 0);
    visit(0, 1, 9.0, 0);
  }
  const Iso230 i = iso230(evaluation, plan).front();
  EXPECT_TRUE(i.bidirectional);
  EXPECT_EQ(i.axis, AxisId::kYaw);
  EXPECT_EQ(i.positions, 4u);
  EXPECT_EQ(i.approaches, 3);
  EXPECT_NEAR(i.reversal_deg, 0.3, 1e-12);
  EXPECT_NEAR(i.systematic_deg, 0.5, 1e-12);
  EXPECT_NEAR(i.mean_range_deg, 0.5 - 0.15, 1e-12);
  EXPECT_NEAR(i.repeatability_deg, 0.2 + 0.2 + 0.3, 1e-12);
  EXPECT_NEAR(i.accuracy_deg, 0.5 - -0.2, 1e-12);
}

TEST_F(ScenarioStatisticsTest, Iso230SaysWhatOneApproachCannotTell) {
  reference();
  for (int k = 1; k <= 5; ++k) visit(k, 1, 0.1 * k, 0);
  const Iso230 i = iso230(evaluation, plan).front();
  EXPECT_FALSE(i.bidirectional);
  EXPECT_EQ(i.approaches, 1);
  EXPECT_NEAR(i.systematic_deg, 0.4, 1e-12);
  EXPECT_TRUE(std::isnan(i.accuracy_deg));
  EXPECT_TRUE(std::isnan(i.repeatability_deg));
  EXPECT_TRUE(std::isnan(i.reversal_deg));
}

}  // namespace
}  // namespace turntable
