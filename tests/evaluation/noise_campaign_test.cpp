#include "src/evaluation/noise_campaign.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "src/core/errors.h"
#include "src/evaluation/scenario_statistics.h"
#include "src/record/atomic_file.h"
#include "src/record/image_archive.h"
#include "tests/support/message_of.h"
#include "tests/support/point_run.h"

namespace turntable {
namespace {

TEST(GreyNoise, IsGaussianRoundedAndClipped) {
  const Image even({1024, 1024}, 128);
  for (const double sigma : {1.0, 5.0, 20.0}) {
    const Image noisy = with_noise(even, sigma, Random(1, "noise", 2));
    EXPECT_EQ(noisy.pixels, with_noise(even, sigma, Random(1, "noise", 2)).pixels);
    EXPECT_NE(noisy.pixels, with_noise(even, sigma, Random(2, "noise", 2)).pixels);
    double sum = 0.0, squares = 0.0, neighbours = 0.0;
    std::size_t within = 0, beyond = 0;
    const std::size_t n = noisy.pixels.size();
    for (std::size_t i = 0; i < n; ++i) {
      const double e = noisy.pixels[i] - 128.0;
      sum += e;
      squares += e * e;
      if (i > 0) neighbours += e * (noisy.pixels[i - 1] - 128.0);
      within += std::abs(e) < sigma;
      beyond += std::abs(e) > 4.0 * sigma;
    }
    const auto count = static_cast<double>(n);
    const double rounded = std::sqrt(sigma * sigma + 1.0 / 12.0);
    EXPECT_NEAR(sum / count, 0.0, 5.0 * rounded / std::sqrt(count)) << sigma;
    EXPECT_NEAR(std::sqrt(squares / count), rounded, 0.01 * rounded) << sigma;
    EXPECT_NEAR(neighbours / squares, 0.0, 5.0 / std::sqrt(count)) << sigma;
    if (sigma > 1.0) {
      EXPECT_GT(beyond, 20u) << sigma;  // 66 of a million
      EXPECT_LT(beyond, 150u) << sigma;
    }
  }
  // Half of the noise of a black image, and of a white one, is cut off.
  const auto at_edge = [](std::uint8_t grey) {
    const Image noisy = with_noise(Image({256, 256}, grey), 10.0, Random(1, "edge"));
    return static_cast<double>(std::ranges::count(noisy.pixels, grey)) / (256.0 * 256.0);
  };
  EXPECT_NEAR(at_edge(0), 0.52, 0.01);
  EXPECT_NEAR(at_edge(255), 0.52, 0.01);
}

/// Eight poses of a simulated rig at each of two places, with images of the LEDs.
class NoisyImages : public ::testing::Test {
 protected:
  NoisyImages()
      : run_(shipped_rig("ideal"), 1, solvers(), few_poses()),
        folder_(RunFolder::create(temporary_ / "run", run_.record.plan)) {
    std::filesystem::create_directories(folder_.images());
    SimulatedView view(run_.rig);
    for (TakenPose& pose : run_.record.poses) {
      const PlannedPose& p = pose.planned;
      view.stand(p.stage_mm, p.yaw_deg, p.roll_deg, p.pitch_deg);
      pose.images.front().file = "images/" + p.id + ".png";
      write_atomically(folder_.root() / pose.images.front().file,
                       encode_png(view.look(Payload::kLedTarget)));
    }
    options_ = {{5.0, 20.0}, 7, "raster_80"};
    how_.solvers = solvers();
  }
  static std::vector<const Solver*> solvers() {
    return {find_solver("aopit_ray"), &default_solver()};
  }
  static PointRunOptions few_poses() {
    PointRunOptions options;
    options.steps = 2;
    return options;
  }
  NoisySpots find(const NoiseOptions& options) const {
    return find_noisy_spots(run_.record, folder_, run_.rig, run_.calibration, options, {});
  }
  NoiseCampaign evaluated(const NoisySpots& spots) const {
    return evaluate_noise(run_.record, folder_, run_.rig, run_.calibration, how_, spots);
  }

  TemporaryFolder temporary_;
  PointRun run_;
  RunFolder folder_;
  NoiseOptions options_;
  EvaluateOptions how_;
};

TEST_F(NoisyImages, WithoutNoiseGiveWhatEvaluateGives) {
  const NoiseCampaign campaign = evaluated(find(options_));
  ASSERT_EQ(campaign.levels.size(), 3u);
  const Evaluation plain = evaluate(run_.record, folder_, run_.rig, run_.calibration, how_);
  const Evaluation& zero = campaign.levels[0].evaluation;
  ASSERT_EQ(zero.poses.size(), 9u);
  ASSERT_EQ(plain.poses.size(), 18u);
  for (std::size_t i = 0; i < zero.poses.size(); ++i)
    for (std::size_t k = 0; k < how_.solvers.size(); ++k) {
      const PoseResult &a = zero.poses[i].results[k], &b = plain.poses[i].results[k];
      ASSERT_TRUE(a.measured);
      EXPECT_EQ(a.error.yaw_deg, b.error.yaw_deg);
      EXPECT_EQ(a.error.pitch_deg, b.error.pitch_deg);
      EXPECT_EQ(a.status, b.status);
    }
}

TEST_F(NoisyImages, GetWorseWithNoiseAndStateIt) {
  options_.sigmas_grey = {5.0, 10.0, 20.0, 30.0};
  const NoiseCampaign campaign = evaluated(find(options_));
  for (std::size_t level = 1; level < campaign.levels.size(); ++level) {
    const auto before = scenario_statistics(campaign.levels[level - 1].evaluation),
               after = scenario_statistics(campaign.levels[level].evaluation);
    ASSERT_EQ(after.size(), 2u);
    for (std::size_t k = 0; k < after.size(); ++k) {
      EXPECT_GE(after[k].rmse_total_deg.interval.upper, before[k].rmse_total_deg.interval.lower);
      EXPECT_EQ(after[k].pooled.poses, 8u);
    }
    EXPECT_GT(campaign.levels[level].median_spot_sigma_px,
              campaign.levels[level - 1].median_spot_sigma_px);
  }
  // In proportion to the noise, and more than stated only where it is clipped.
  EXPECT_EQ(campaign.levels[0].spot_shift_px, 0.0);
  EXPECT_NEAR(campaign.levels[3].spot_shift_px / campaign.levels[1].spot_shift_px, 4.0, 1.2);
  EXPECT_NEAR(campaign.levels[1].spot_shift_px / campaign.levels[1].median_spot_sigma_px, 1.0, 0.4);
  // The cut-out is an LED at every level, and its centre hardly moves.
  ASSERT_TRUE(campaign.detail);
  ASSERT_EQ(campaign.detail->cutouts.size(), 5u);
  ASSERT_TRUE(campaign.detail->centres_px[0] && campaign.detail->centres_px[2]);
  EXPECT_LT((*campaign.detail->centres_px[0] - *campaign.detail->centres_px[2]).norm(), 1.0);
  EXPECT_NE(campaign.detail->cutouts[0].pixels, campaign.detail->cutouts[1].pixels);
}

TEST_F(NoisyImages, FollowFromSeedPoseAndSigmaAlone) {
  const NoisySpots both = find(options_);
  NoiseOptions one = options_;
  one.sigmas_grey = {20.0};
  const NoisySpots alone = find(one);
  for (const auto& [key, lists] : both.images) {
    const std::vector<SpotList>& others = alone.images.at(key);
    ASSERT_EQ(lists[2].centres_px.size(), others[1].centres_px.size());
    for (std::size_t i = 0; i < lists[2].centres_px.size(); ++i)
      EXPECT_EQ(lists[2].centres_px[i], others[1].centres_px[i]);
  }
  one.seed = 8;
  EXPECT_NE(find(one).images.begin()->second[1].centres_px,
            alone.images.begin()->second[1].centres_px);
}

TEST_F(NoisyImages, AreTheSameFromTheirStoredSpots) {
  const NoisySpots found = find(options_);
  const auto file = temporary_ / "noise_spots.csv";
  write_noise_spots(found, file);
  const NoiseCampaign stored = evaluated(read_noise_spots(file, options_, run_.record.plan));
  const NoiseCampaign made = evaluated(found);
  write_noise_poses(made, run_.record.plan, temporary_ / "made.csv");
  write_noise_poses(stored, run_.record.plan, temporary_ / "stored.csv");
  EXPECT_EQ(slurp(temporary_ / "made.csv"), slurp(temporary_ / "stored.csv"));
  EXPECT_EQ(slurp(temporary_ / "made.csv").substr(0, 20), "sigma_grey,index,id,");
  ASSERT_TRUE(stored.detail);
  EXPECT_TRUE(stored.detail->cutouts.empty());
  EXPECT_EQ(stored.detail->left, made.detail->left);
  // Spots of other noise, of another pose, or none at all.
  NoiseOptions other = options_;
  other.sigmas_grey = {5.0};
  EXPECT_NE(message_of<ConfigError>([&] {
              read_noise_spots(file, other, run_.record.plan);
            }).find("--noise"),
            std::string::npos);
  other = options_;
  other.scenario = "raster_180";
  EXPECT_THROW(read_noise_spots(file, other, run_.record.plan), ConfigError);
  EXPECT_THROW(read_noise_spots(temporary_ / "nowhere.csv", options_, run_.record.plan),
               ConfigError);
}

TEST_F(NoisyImages, PosesThatNoiseHidesAreCountedAsFailed) {
  options_.sigmas_grey = {255.0};
  const NoiseCampaign campaign = evaluated(find(options_));
  const auto statistics = scenario_statistics(campaign.levels[1].evaluation);
  EXPECT_EQ(statistics[0].pooled.poses, 8u);
  EXPECT_EQ(statistics[0].pooled.failed, 8u);
  EXPECT_TRUE(std::isnan(statistics[0].rmse_total_deg.value));
}

TEST_F(NoisyImages, AreThoseOfTheScenarioThatTurnsMostAxes) {
  Plan& plan = run_.record.plan;
  EXPECT_EQ(noise_scenario(run_.record, folder_, ""), "raster_80");
  plan.scenarios[1].table = 5;
  EXPECT_EQ(noise_scenario(run_.record, folder_, ""), "raster_180");
  plan.scenarios[1].axes = {AxisId::kYaw};
  EXPECT_EQ(noise_scenario(run_.record, folder_, ""), "raster_80");
  EXPECT_EQ(noise_scenario(run_.record, folder_, "raster_180"), "raster_180");
  const std::string unknown =
      message_of<ConfigError>([&] { (void)noise_scenario(run_.record, folder_, "raster_90"); });
  EXPECT_NE(unknown.find("allowed: raster_80, raster_180"), std::string::npos) << unknown;
  // One image that was not archived is enough: its pose could not be judged.
  run_.record.poses.front().images.front().file.clear();
  EXPECT_EQ(noise_scenario(run_.record, folder_, ""), "raster_180");
  EXPECT_THROW((void)noise_scenario(run_.record, folder_, "raster_80"), ConfigError);
  run_.record.poses.back().images.front().file.clear();
  const std::string none =
      message_of<ConfigError>([&] { (void)noise_scenario(run_.record, folder_, ""); });
  EXPECT_NE(none.find("--images"), std::string::npos) << none;
}

}  // namespace
}  // namespace turntable
