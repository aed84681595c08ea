#include "src/evaluation/self_calibration.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "src/core/errors.h"
#include "tests/support/synthetic_campaign.h"

namespace turntable {
namespace {

TEST(SelfCalibration, RecoversHiddenErrorsWithinItsStatedUncertainty) {
  const RigFile rig = toleranced_rig();
  const RigModel model(rig, true);
  std::map<ParameterGroup, double> squares;
  std::map<ParameterGroup, int> counts;
  double chi2_per_dof = 0.0;
  constexpr int kRigs = 100;
  for (int seed = 0; seed < kRigs; ++seed) {
    const SyntheticCampaign campaign(rig, static_cast<std::uint64_t>(seed), {});
    const SelfCalibration found = self_calibrate(model, campaign.sightings);
    ASSERT_TRUE(found.converged) << seed;
    chi2_per_dof += found.chi2 / found.dof / kRigs;
    for (Eigen::Index i = 0; i < model.size(); ++i) {
      const double pull = (found.values(i) - campaign.truth(i)) / found.sd(i);
      const ParameterGroup group = model.parameters()[static_cast<std::size_t>(i)].group;
      squares[group] += pull * pull;
      ++counts[group];
    }
  }
  EXPECT_NEAR(chi2_per_dof, 1.0, 0.01);
  for (const auto& [group, sum] : squares) {
    const double sd = std::sqrt(sum / counts[group]);
    EXPECT_GT(sd, 0.8) << static_cast<int>(group);
    EXPECT_LT(sd, 1.2) << static_cast<int>(group);
  }
}

TEST(SelfCalibration, DeterminesWhatACampaignShowsAndHoldsWhatItDoesNot) {
  const RigFile rig = toleranced_rig();
  const RigModel model(rig, true);
  const auto verdict = [&](const SelfCalibration& found, std::string_view name) {
    for (std::size_t i = 0; i < model.parameters().size(); ++i)
      if (model.parameters()[i].name == name) return found.verdicts[i];
    ADD_FAILURE() << name;
    return Verdict::kHeld;
  };
  const SelfCalibration all = self_calibrate(model, SyntheticCampaign(rig, 1, {}).sightings);
  for (const char* name : {"plane_from_gimbal_x", "plane_from_gimbal_y", "pitch_tilt_to_yaw",
                           "stage_squareness_x", "target_1_z", "target_3_x"})
    EXPECT_NE(verdict(all, name), Verdict::kHeld) << name;
  // Yaw alone, from zero: nothing leans, and the others never turn.
  const SelfCalibration yaw =
      self_calibrate(model, SyntheticCampaign(rig, 1, {.yaw_alone = true}).sightings);
  for (const char* name : {"roll_tilt_to_yaw", "pitch_tilt_to_yaw", "pitch_tilt_to_roll"})
    EXPECT_EQ(verdict(yaw, name), Verdict::kHeld) << name;
  for (Eigen::Index i = 0; i < model.size(); ++i)
    if (yaw.held(i)) {
      EXPECT_EQ(yaw.values(i), model.drawing()(i));
      EXPECT_EQ(yaw.sd(i), model.prior_sd()(i));
    }
}

TEST(SelfCalibration, FindsNoiseThatSpotsStateTooSmall) {
  const RigFile rig = toleranced_rig();
  const RigModel model(rig, true);
  SyntheticCampaign campaign(rig, 3, {});
  for (RigSighting& sighting : campaign.sightings.poses)
    for (RaySpread& spread : sighting.spreads) {
      spread.at_a *= 0.5;
      spread.at_b *= 0.5;
    }
  EXPECT_NEAR(self_calibrate(model, campaign.sightings).noise_factor, 2.0, 0.1);
}

TEST(SelfCalibration, IsTheSameAgain) {
  const RigFile rig = toleranced_rig();
  const RigModel model(rig, false);
  const SyntheticCampaign campaign(rig, 4, {.stage_made = false});
  const SelfCalibration once = self_calibrate(model, campaign.sightings);
  EXPECT_EQ(once.values, self_calibrate(model, campaign.sightings).values);
  const std::vector<std::size_t> few{0, 1, 2};
  EXPECT_THROW(self_calibrate(model, campaign.sightings, few), Error);
}

}  // namespace
}  // namespace turntable
