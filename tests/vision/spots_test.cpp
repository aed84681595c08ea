#include "src/vision/spots.h"

#include <gtest/gtest.h>

#include <cmath>

#include "src/core/random.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

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
  Random random(1, "Spots.OfImagesWithoutALightAreNone");
  for (auto& p : noise.pixels) p = static_cast<std::uint8_t>(random.uniform(0, 256));
  for (const Spot& s : find_spots(noise).spots) EXPECT_TRUE(std::isfinite(s.centre_px.x()));
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
