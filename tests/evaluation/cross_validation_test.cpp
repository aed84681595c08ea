#include "src/evaluation/cross_validation.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "src/core/errors.h"
#include "tests/support/synthetic_campaign.h"

namespace turntable {
namespace {

double total_deg(const TruthLevels& levels, TruthLevel level) {
  return std::ranges::find(levels.judged.rows, level, &LevelRow::level)->statistics.rmse_total_deg;
}

TEST(CrossValidation, EndsAtTheBoundOnceTheRigIsKnown) {
  RigFile rig = toleranced_rig();
  double published = 0.0, aligned = 0.0, calibrated = 0.0, bound = 0.0;
  constexpr int kRigs = 5;
  for (int seed = 0; seed < kRigs; ++seed) {
    SyntheticCampaign campaign(rig, static_cast<std::uint64_t>(100 + seed), {});
    campaign.evaluation.solvers = {find_solver("aopit_ray"), &default_solver()};
    const TruthLevels levels =
        truth_levels(campaign.record, rig, campaign.calibration, campaign.evaluation);
    ASSERT_EQ(levels.why_not, "");
    EXPECT_EQ(levels.judged.folds, kFolds);
    ASSERT_EQ(levels.judged.rows.size(), 6u);
    EXPECT_EQ(levels.judged.rows[5].statistics.poses, 250u);
    EXPECT_EQ(levels.judged.bounds[0].left_out, 0u);
    const LevelBound& of = levels.judged.bounds[0];
    EXPECT_GT(of.total_with_repeatability_deg, of.total_deg);
    const double ml = levels.judged.rows[5].statistics.rmse_total_deg;
    EXPECT_NEAR(ml / of.total_with_repeatability_deg, 1.0, 0.25)
        << seed;  // one initial pose's luck
    published += levels.judged.rows[3].statistics.rmse_total_deg / kRigs;
    aligned += levels.judged.rows[4].statistics.rmse_total_deg / kRigs;
    calibrated += ml / kRigs;
    bound += of.total_with_repeatability_deg / kRigs;
  }
  EXPECT_NEAR(calibrated / bound, 1.0, 0.15);
  EXPECT_GT(published, 3.0 * bound);
  EXPECT_LT(aligned, published);
  EXPECT_GT(aligned, 1.2 * calibrated);
}

TEST(CrossValidation, IsTheSameAgain) {
  const RigFile rig = toleranced_rig();
  SyntheticCampaign campaign(rig, 7, {.poses_per_axis = 3, .stage_made = false});
  campaign.evaluation.solvers = {&default_solver()};
  const auto once = truth_levels(campaign.record, rig, campaign.calibration, campaign.evaluation);
  const auto again = truth_levels(campaign.record, rig, campaign.calibration, campaign.evaluation);
  for (const TruthLevel level : kTruthLevels)
    EXPECT_EQ(total_deg(once, level), total_deg(again, level));
}

TEST(CrossValidation, SaysWhatARunIsTooSmallFor) {
  const RigFile rig = toleranced_rig();
  SyntheticCampaign campaign(rig, 7, {});
  campaign.evaluation.solvers = {&default_solver()};
  campaign.evaluation.poses.resize(8);
  const auto levels = truth_levels(campaign.record, rig, campaign.calibration, campaign.evaluation);
  EXPECT_FALSE(levels.model);
  EXPECT_NE(levels.why_not.find("8 poses"), std::string::npos) << levels.why_not;
}

}  // namespace
}  // namespace turntable
