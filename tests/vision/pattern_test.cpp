#include "src/vision/pattern.h"

#include <gtest/gtest.h>

#include <cmath>

#include "src/core/random.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

struct Accuracy {
  int circles = 0;
  int wrong = 0;  ///< indexed as another circle
  double rms_px = 0.0;
};

Accuracy accuracy(const SimulatedView& view, const PatternSearch& search) {
  Accuracy a;
  double sum = 0.0;
  for (const PatternPoint& c : search.points) {
    const Vector2d on_pattern = c.on_pattern_mm;
    const double miss = (c.centre_px - view.pixel_of({on_pattern.x(), on_pattern.y(), 0})).norm();
    if (miss > 5) ++a.wrong;
    sum += miss * miss;
    ++a.circles;
  }
  a.rms_px = std::sqrt(sum / (2 * std::max(1, a.circles)));
  return a;
}

TEST(Pattern, IsIndexedToAHundredthOfAPixelAtZeroAndAtThirtyDegrees) {
  SimulatedView view(shipped_rig("simulated"));
  for (const auto& [yaw, roll, pitch] :
       {std::array{0.0, 0.0, 0.0}, {0.0, 30.0, 0.0}, {0.0, 0.0, -30.0}, {40.0, 20.0, 20.0}}) {
    view.stand(100, yaw, roll, pitch);
    const PatternSearch search =
        find_pattern(view.look(Payload::kCirclePattern), view.rig().pattern);
    ASSERT_EQ(search.status, PatternStatus::kFound);
    const Accuracy a = accuracy(view, search);
    EXPECT_GT(a.circles, 150);
    EXPECT_EQ(a.wrong, 0);
    EXPECT_LT(a.rms_px, 0.01);
  }
}

TEST(Pattern, IsIndexedWhateverItsRotation) {
  SimulatedView view(shipped_rig("simulated"));
  for (double yaw = -180; yaw < 180; yaw += 30) {
    view.stand(60, yaw, 0, 0);
    const PatternSearch search =
        find_pattern(view.look(Payload::kCirclePattern), view.rig().pattern);
    ASSERT_EQ(search.status, PatternStatus::kFound) << yaw;
    EXPECT_EQ(accuracy(view, search).wrong, 0) << yaw;
  }
}

TEST(Pattern, CentresAreCorrectedForPerspective) {
  // Without the correction the centre of the ellipse is off by about r^2 f tan(tilt) / Z^2: 0.04 px
  // here.
  SimulatedView view(shipped_rig("ideal"));
  view.stand(100, 0, 30, 0);
  const PatternSearch search = find_pattern(view.look(Payload::kCirclePattern), view.rig().pattern);
  ASSERT_EQ(search.status, PatternStatus::kFound);
  Vector2d mean = Vector2d::Zero();
  for (const PatternPoint& c : search.points) {
    const Vector2d p = c.on_pattern_mm;
    mean += (c.centre_px - view.pixel_of({p.x(), p.y(), 0})) /
            static_cast<double>(search.points.size());
  }
  EXPECT_LT(mean.norm(), 0.003);
}

TEST(Pattern, OfDarkCirclesOnABrightGroundIsTheSame) {
  RigFile rig = shipped_rig("simulated");
  rig.pattern.bright = false;
  SimulatedView view(rig);
  view.stand(120, 10, 10, 0);
  const PatternSearch search = find_pattern(view.look(Payload::kCirclePattern), rig.pattern);
  ASSERT_EQ(search.status, PatternStatus::kFound);
  EXPECT_EQ(accuracy(view, search).wrong, 0);
  EXPECT_LT(accuracy(view, search).rms_px, 0.01);
}

TEST(Pattern, WithTheWrongYDirectionIsRecognisedAsMirrored) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 0, 0, 0);
  PatternConfig stated = view.rig().pattern;
  for (auto& d : stated.direction_circles) d[1] = -d[1];
  stated.origin_row = stated.rows - 1 - stated.origin_row;
  EXPECT_EQ(find_pattern(view.look(Payload::kCirclePattern), stated).status,
            PatternStatus::kMirrored);
}

TEST(Pattern, WithOneDirectionCircleCoveredIsRefused) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 0, 0, 0);
  Image image = view.look(Payload::kCirclePattern);
  const Vector2d at = view.pixel_of({0, 80, 0});
  for (int v = -40; v <= 40; ++v)
    for (int u = -40; u <= 40; ++u)
      image.row(static_cast<int>(at.y()) + v)[static_cast<int>(at.x()) + u] = 25;
  EXPECT_NE(find_pattern(image, view.rig().pattern).status, PatternStatus::kFound);
}

TEST(Pattern, OfImagesWithoutOneIsNotFound) {
  const PatternConfig pattern = shipped_rig("simulated").pattern;
  EXPECT_EQ(find_pattern(Image(), pattern).status, PatternStatus::kNoContrast);
  EXPECT_EQ(find_pattern(Image({200, 200}, 40), pattern).status, PatternStatus::kNoContrast);
  Random random(1, "Pattern.OfImagesWithoutOneIsNotFound");
  Image noise({400, 400}, 0);
  for (auto& p : noise.pixels) p = static_cast<std::uint8_t>(random.uniform(0, 256));
  EXPECT_NE(find_pattern(noise, pattern).status, PatternStatus::kFound);
  SimulatedView leds(shipped_rig("simulated"));
  leds.stand(120, 0, 0, 0);
  EXPECT_NE(find_pattern(leds.look(Payload::kLedTarget), pattern).status, PatternStatus::kFound);
}

}  // namespace
}  // namespace turntable
