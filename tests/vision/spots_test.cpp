#include "src/vision/spots.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "tests/support/draws.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

/// A simulated rig that sees sixteen LEDs at once.
RigFile rig_of_many_leds(double read_noise_grey, double electrons_per_grey,
                         double peak_grey = 200) {
  RigFile rig = shipped_rig("simulated");
  rig.target.points_mm.clear();
  for (int i = 0; i < 4; ++i)
    for (int j = 0; j < 4; ++j)
      rig.target.points_mm.push_back({30.0 * i - 43, 29.0 * j - 41, -10.0 * ((i + j) % 3)});
  rig.simulation->target_errors_mm.assign(rig.target.points_mm.size(), Vector3d::Zero());
  rig.simulation->image.read_noise_grey = read_noise_grey;
  rig.simulation->image.electrons_per_grey = electrons_per_grey;
  rig.simulation->image.led_peak_grey = peak_grey;
  return rig;
}

/// Centre of mass of a disc's image: a tilted disc's centre is elsewhere.
Vector2d image_centre(const sim::World& world, const sim::Disc& disc) {
  constexpr int kCorners = 64;
  std::array<Vector2d, kCorners> edge;
  for (int i = 0; i < kCorners; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kCorners;
    edge[static_cast<std::size_t>(i)] = world.lens().project(
        disc.centre + std::cos(angle) * disc.across + std::sin(angle) * disc.down);
  }
  double area = 0.0;
  Vector2d moment = Vector2d::Zero();
  for (std::size_t i = 0; i < kCorners; ++i) {
    const Vector2d a = edge[i] - edge[0], b = edge[(i + 1) % kCorners] - edge[0];
    const double cross = a.x() * b.y() - a.y() * b.x();
    area += cross;
    moment += cross * (a + b) / 3.0;
  }
  return edge[0] + moment / area;
}

/// Errors of spot centres over two tilts, heights and places in the pixel.
struct SpotErrors {
  int spots = 0, missed = 0;
  double sum_squares = 0.0, sum_normalised = 0.0, sum_normalised_squares = 0.0;

  double rms_px() const { return std::sqrt(sum_squares / (2.0 * spots)); }
  double deviation_of_normalised() const {
    const double n = 2.0 * spots, mean = sum_normalised / n;
    return std::sqrt(sum_normalised_squares / n - mean * mean);
  }
};

SpotErrors spot_errors(const RigFile& rig, double tilt_deg, int images, double electrons_per_grey) {
  SimulatedView view(rig);
  SpotErrors out;
  for (int i = 0; i < images; ++i) {
    const double about = 2.4 * i;  // radians; every image elsewhere
    view.stand(20.0 + 45.0 * (i % 4), 7.0 * (i % 9), tilt_deg * std::sin(about),
               tilt_deg * std::cos(about));
    const SpotSearch search =
        find_spots(view.look(Payload::kLedTarget), {.electrons_per_grey = electrons_per_grey});
    for (const sim::Disc& disc : view.world().discs()) {
      const Vector2d truth = image_centre(view.world(), disc);
      const auto nearest = std::ranges::min_element(
          search.spots, {}, [&](const Spot& s) { return (s.centre_px - truth).norm(); });
      if (nearest == search.spots.end() || (nearest->centre_px - truth).norm() > 1.0) {
        ++out.missed;
        continue;
      }
      const Vector2d error = nearest->centre_px - truth;
      ++out.spots;
      out.sum_squares += error.squaredNorm();
      out.sum_normalised += error.sum() / nearest->sigma_px;
      out.sum_normalised_squares += error.squaredNorm() / (nearest->sigma_px * nearest->sigma_px);
    }
  }
  return out;
}

TEST(Spots, OfReadNoiseErrAsTheirUncertaintySays) {
  for (const double tilt_deg : {0.0, 30.0}) {
    const SpotErrors e = spot_errors(rig_of_many_leds(2.0, 0.0), tilt_deg, 100, 0.0);
    EXPECT_EQ(e.missed, 0);
    EXPECT_NEAR(e.deviation_of_normalised(), 1.0, 0.1) << tilt_deg << " deg";
    EXPECT_LT(e.rms_px(), 0.02);
  }
}

TEST(Spots, OnGroundWhoseNoiseIsCutOffAtBlackErrAsTheirUncertaintySays) {
  for (const double noise_grey : {10.0, 20.0, 30.0}) {  // on ground of 12
    const SpotErrors e = spot_errors(rig_of_many_leds(noise_grey, 0.0), 15.0, 60, 0.0);
    EXPECT_EQ(e.missed, 0);
    EXPECT_NEAR(e.deviation_of_normalised(), 1.0, 0.1) << noise_grey << " grey";
  }
}

TEST(Spots, OnDarkGroundOfAQuietCameraErrAsTheirUncertaintySays) {
  RigFile rig = rig_of_many_leds(0.8, 0.0);
  rig.simulation->image.background_grey = 1.4;  // a tenth of it is rounded or cut off to 0
  const SpotErrors e = spot_errors(rig, 15.0, 60, 0.0);
  EXPECT_EQ(e.missed, 0);
  EXPECT_NEAR(e.deviation_of_normalised(), 1.0, 0.08);
}

TEST(Spots, OfShotNoiseErrAsTheirUncertaintySays) {
  for (const double tilt_deg : {0.0, 30.0}) {
    const SpotErrors e = spot_errors(rig_of_many_leds(1.2, 40.0), tilt_deg, 100, 40.0);
    EXPECT_EQ(e.missed, 0);
    EXPECT_NEAR(e.deviation_of_normalised(), 1.0, 0.1) << tilt_deg << " deg";
    EXPECT_LT(e.rms_px(), 0.02);
  }
}

TEST(Spots, WithoutTheCamerasElectronsClaimTooLittleUncertainty) {
  const SpotErrors e = spot_errors(rig_of_many_leds(1.2, 40.0), 0.0, 30, 0.0);
  EXPECT_GT(e.deviation_of_normalised(), 1.2);  // or the key of the rig file would mean nothing
}

TEST(Spots, ThatAreClippedErrNoMoreThanTheirUncertaintySays) {
  for (const double peak_grey : {300.0, 400.0, 800.0}) {
    const SpotErrors e = spot_errors(rig_of_many_leds(1.2, 40.0, peak_grey), 15.0, 30, 40.0);
    EXPECT_EQ(e.missed, 0);
    EXPECT_LT(e.deviation_of_normalised(), 1.1) << peak_grey;
  }
}

/// rms error of spot centres per coordinate over a range of attitudes, px.
double spot_rms(const std::string& rig) {
  SimulatedView view(shipped_rig(rig));
  double sum = 0.0;
  int count = 0;
  for (double pitch = -30; pitch <= 30; pitch += 15)
    for (double yaw = -30; yaw <= 30; yaw += 15) {
      view.stand(120, yaw, 5, pitch);
      const SpotSearch search = find_spots(view.look(Payload::kLedTarget));
      EXPECT_EQ(search.spots.size(), 4u);
      for (const Vector2d& truth : view.led_pixels()) {
        double nearest = INFINITY;
        for (const Spot& s : search.spots)
          nearest = std::min(nearest, (s.centre_px - truth).norm());
        sum += nearest * nearest;
        count += 2;
      }
    }
  return std::sqrt(sum / count);
}

TEST(Spots, OfIdealImagesAreFoundToAFewThousandthsOfAPixel) { EXPECT_LT(spot_rms("ideal"), 0.004); }
TEST(Spots, OfNoisyImagesAreFoundToAHundredthOfAPixel) { EXPECT_LT(spot_rms("simulated"), 0.012); }

TEST(Spots, OfImagesWithoutALightAreNone) {
  EXPECT_TRUE(find_spots(Image()).spots.empty());
  EXPECT_TRUE(find_spots(Image({64, 64}, 0)).spots.empty());
  EXPECT_TRUE(find_spots(Image({64, 64}, 255)).spots.empty());
  EXPECT_TRUE(find_spots(Image({1, 1}, 90)).spots.empty());
  Image noise({300, 300}, 0);
  Random random = draws_of_this_test();
  for (auto& p : noise.pixels) p = static_cast<std::uint8_t>(random.uniform(0, 256));
  EXPECT_TRUE(find_spots(noise).spots.empty());
}

TEST(Spots, OfNormalNoiseAreNone) {
  int faint = 0;
  for (const double ground : {12.0, 60.0, 128.0, 220.0}) {
    Image image({1024, 1024}, 0);
    Random random = draws_of_this_test(static_cast<std::uint64_t>(ground));
    for (auto& p : image.pixels)
      p = static_cast<std::uint8_t>(
          std::clamp(std::round(ground + 30.0 * random.normal()), 0.0, 255.0));
    const SpotSearch search = find_spots(image);
    EXPECT_TRUE(search.spots.empty()) << ground;
    faint += search.rejected.faint;
  }
  EXPECT_GT(faint, 0);  // some have the size and shape of spots
}

TEST(Spots, AreGatedAndEveryRejectionCounted) {
  const auto search = [](int width, int height, int grey, const SpotOptions& options = {}) {
    Image image({200, 200}, 10);
    for (int v = 60; v < 60 + height; ++v)
      for (int u = 60; u < 60 + width; ++u) image.row(v)[u] = static_cast<std::uint8_t>(grey);
    return find_spots(image, options);
  };
  EXPECT_EQ(search(8, 8, 200).spots.size(), 1u);
  EXPECT_EQ(search(8, 8, 29).spots.size(), 0u);  // range below the least one
  EXPECT_EQ(search(2, 2, 200).rejected.area, 1);
  EXPECT_EQ(search(70, 70, 200).rejected.area, 1);
  EXPECT_EQ(search(30, 4, 200).rejected.shape, 1);
  EXPECT_EQ(search(8, 8, 255, {.keep_saturated = false}).rejected.saturated, 1);
  EXPECT_EQ(search(8, 8, 200, {.min_snr = 1e9}).rejected.faint, 1);
}

TEST(Spots, CutByTheBorderAreRejectedAndCounted) {
  Image image({80, 80}, 10);
  for (int v = 30; v < 40; ++v)
    for (int u = 0; u < 10; ++u) image.row(v)[u] = 200;
  const SpotSearch search = find_spots(image);
  EXPECT_TRUE(search.spots.empty());
  EXPECT_EQ(search.rejected.border, 1);
  EXPECT_EQ(search.rejected.total(), 1);
}

TEST(Spots, SayWhenTheyAreSaturated) {
  Image image({80, 80}, 10);
  for (int v = 30; v < 40; ++v)
    for (int u = 30; u < 40; ++u) image.row(v)[u] = 255;
  const SpotSearch search = find_spots(image);
  ASSERT_EQ(search.spots.size(), 1u);
  EXPECT_TRUE(search.spots.front().saturated);
  EXPECT_NEAR(search.spots.front().centre_px.x(), 34.5, 1e-9);
}

}  // namespace
}  // namespace turntable
