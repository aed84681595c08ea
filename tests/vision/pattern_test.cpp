#include "src/vision/pattern.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/support/drawn_plane.h"
#include "tests/support/draws.h"
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

TEST(Pattern, CentresAreCorrectedForPerspectiveAndLens) {
  // Without the correction the centroid is off by about r^2 f sin(tilt) / Z^2: 0.06 px here.
  for (const bool physical : {false, true}) {
    RigFile rig = shipped_rig("ideal");
    if (physical) rig.simulation->lens = shipped_rig("simulated").simulation->lens;
    SimulatedView view(rig);
    view.stand(100, 0, 30, 0);
    const Image image = view.look(Payload::kCirclePattern);
    const auto bias = [&](bool corrected) {
      const PatternSearch search =
          find_pattern(image, view.rig().pattern, {.correct_centres = corrected});
      EXPECT_EQ(search.status, PatternStatus::kFound);
      Vector2d mean = Vector2d::Zero();
      for (const PatternPoint& c : search.points)
        mean += (c.centre_px - view.pixel_of({c.on_pattern_mm.x(), c.on_pattern_mm.y(), 0})) /
                static_cast<double>(search.points.size());
      return mean.norm();
    };
    EXPECT_LT(bias(true), 0.003);
    EXPECT_GT(bias(false), 0.04);
  }
}

TEST(Pattern, CentresLieWithinTheirStatedUncertainty) {
  RigFile rig = shipped_rig("simulated");
  rig.simulation->image.read_noise_grey = 2.0;
  SimulatedView view(rig);
  for (const double tilt : {0.0, 30.0}) {
    double scaled = 0.0;
    int count = 0;
    for (int frame = 0; frame < 4; ++frame) {
      view.stand(100, 7.0 * frame, tilt, 0);
      const PatternSearch search = find_pattern(view.look(Payload::kCirclePattern), rig.pattern);
      ASSERT_EQ(search.status, PatternStatus::kFound);
      EXPECT_LT(accuracy(view, search).rms_px, 0.02);
      for (const PatternPoint& c : search.points) {
        const Vector2d d =
            c.centre_px - view.pixel_of({c.on_pattern_mm.x(), c.on_pattern_mm.y(), 0});
        scaled += d.squaredNorm() / (c.sigma_px * c.sigma_px);
        ++count;
      }
    }
    EXPECT_GT(std::sqrt(scaled / (2 * count)), 0.9);
    EXPECT_LT(std::sqrt(scaled / (2 * count)), 1.1);
  }
}

TEST(Pattern, UnderUnevenLightIsFoundAsWell) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 40, 20, 20);
  const Image even = view.look(Payload::kCirclePattern);
  const std::size_t all = find_pattern(even, view.rig().pattern).points.size();
  const auto falling = [](int u, int) { return 1.0 - 0.6 * u / 1023.0; };
  const auto vignetting = [](int u, int v) {  // cos^4 of a wide lens: a quarter in the corners
    return std::pow(1.0 + (std::pow(u - 512.0, 2) + std::pow(v - 512.0, 2)) / (2 * 512.0 * 512.0),
                    -2.0);
  };
  for (const Image& image : {under_light(even, falling), under_light(even, vignetting)}) {
    const PatternSearch search = find_pattern(image, view.rig().pattern);
    ASSERT_EQ(search.status, PatternStatus::kFound);
    EXPECT_EQ(search.points.size(), all);
    EXPECT_EQ(accuracy(view, search).wrong, 0);
    EXPECT_LT(accuracy(view, search).rms_px, 0.02);
  }
}

TEST(Pattern, IsIndexedAtFortyFiveDegreesOfTilt) {
  SimulatedView view(shipped_rig("simulated"));
  for (double yaw = -170; yaw < 180; yaw += 50) {
    view.stand(60, yaw, 45, 0);
    const PatternSearch search =
        find_pattern(view.look(Payload::kCirclePattern), view.rig().pattern);
    ASSERT_EQ(search.status, PatternStatus::kFound) << yaw;
    EXPECT_EQ(search.unexplained, 0);
    EXPECT_EQ(accuracy(view, search).wrong, 0) << yaw;
    EXPECT_LT(accuracy(view, search).rms_px, 0.02) << yaw;
  }
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

/// Covers the circle at a lattice position with ground.
void cover(const SimulatedView& view, Image& image, int column, int row, int reach = 28) {
  const double spacing = view.rig().pattern.spacing_mm;
  const Vector2d at = view.pixel_of({column * spacing, row * spacing, 0});
  const int u0 = static_cast<int>(at.x()), v0 = static_cast<int>(at.y());
  for (int v = std::max(0, v0 - reach); v <= std::min(image.height - 1, v0 + reach); ++v)
    for (int u = std::max(0, u0 - reach); u <= std::min(image.width - 1, u0 + reach); ++u)
      image.row(v)[u] = 25;
}

/// Adds a bright disc at a lattice position.
void add_disc(const SimulatedView& view, Image& image, double column, double row, double radius) {
  const double spacing = view.rig().pattern.spacing_mm;
  const Vector2d at = view.pixel_of({column * spacing, row * spacing, 0});
  const int reach = static_cast<int>(radius) + 2;
  for (int v = static_cast<int>(at.y()) - reach; v <= at.y() + reach; ++v)
    for (int u = static_cast<int>(at.x()) - reach; u <= at.x() + reach; ++u) {
      if (u < 0 || v < 0 || u >= image.width || v >= image.height) continue;
      const double inside = radius - (Vector2d(u, v) - at).norm() + 0.5;
      const auto grey = static_cast<std::uint8_t>(25 + 180 * std::clamp(inside, 0.0, 1.0));
      image.row(v)[u] = std::max(image.row(v)[u], grey);
    }
}

TEST(Pattern, WithAnyOneDirectionCircleCoveredIsStillUnique) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 20, 10, 0);
  const Image whole = view.look(Payload::kCirclePattern);
  for (const auto& [column, row] : view.rig().pattern.direction_circles) {
    Image image = whole;
    cover(view, image, column, row);
    const PatternSearch search = find_pattern(image, view.rig().pattern);
    ASSERT_EQ(search.status, PatternStatus::kFound);
    EXPECT_EQ(accuracy(view, search).wrong, 0);
  }
}

TEST(Pattern, WithTwoDirectionCirclesCoveredOrASmallOneInTheirPlaceIsRefused) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 0, 0, 0);
  Image two = view.look(Payload::kCirclePattern);
  cover(view, two, 0, 4);
  Image replaced = two;
  cover(view, two, -1, 1);
  EXPECT_EQ(find_pattern(two, view.rig().pattern).status, PatternStatus::kDirectionCirclesMissing);
  add_disc(view, replaced, 0, 4, 16.2);  // as small as the others
  EXPECT_EQ(find_pattern(replaced, view.rig().pattern).status, PatternStatus::kAmbiguous);
}

TEST(Pattern, WithABigCircleWhereASmallOneIsDrawnIsAmbiguous) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 0, 0, 0);
  Image image = view.look(Payload::kCirclePattern);
  add_disc(view, image, 1, 3, 22.5);
  EXPECT_EQ(find_pattern(image, view.rig().pattern).status, PatternStatus::kAmbiguous);
}

TEST(Pattern, SeenInPartIsIndexedFromThreeDirectionCircles) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 0, 0, 0);
  const Image image = view.look(Payload::kCirclePattern);
  // Cut so that the direction circle (0, 4) is out of view, and little is left beside the others.
  const Vector2d low = view.pixel_of({-60, 60, 0}), high = view.pixel_of({80, -50, 0});
  ImageView part = image;
  const int left = static_cast<int>(low.x()), top = static_cast<int>(low.y());
  part.data += top * part.stride + left;
  part.width = static_cast<int>(high.x()) - left;
  part.height = static_cast<int>(high.y()) - top;
  const PatternSearch search = find_pattern(part, view.rig().pattern);
  ASSERT_EQ(search.status, PatternStatus::kFound);
  EXPECT_GE(search.points.size(), 20u);
  for (const PatternPoint& c : search.points) {
    const Vector2d truth =
        view.pixel_of({c.on_pattern_mm.x(), c.on_pattern_mm.y(), 0}) - Vector2d(left, top);
    EXPECT_LT((c.centre_px - truth).norm(), 0.2);
  }
}

TEST(Pattern, WithMissingCirclesAndFalseBlobsHasNoWrongIndex) {
  SimulatedView view(shipped_rig("simulated"));
  Random random = draws_of_this_test();
  for (int trial = 0; trial < 6; ++trial) {
    view.stand(100, 60.0 * trial, 5.0 * trial, -10);
    Image image = view.look(Payload::kCirclePattern);
    const PatternConfig& pattern = view.rig().pattern;
    const PatternSearch whole = find_pattern(image, pattern);
    ASSERT_EQ(whole.status, PatternStatus::kFound);
    std::size_t left = 0;
    for (const PatternPoint& c : whole.points) {
      const bool big = std::ranges::find(pattern.direction_circles, std::array{c.column, c.row}) !=
                       pattern.direction_circles.end();
      if (!big && random.uniform() < 0.3)
        cover(view, image, c.column, c.row, 24);
      else
        ++left;
    }
    // Between the circles; of their size, a little smaller, and smaller still.
    for (int k = 0; k < 100; ++k)
      add_disc(view, image, std::floor(random.uniform(-8, 8)) + 0.5,
               std::floor(random.uniform(-5, 7)) + random.uniform(0.3, 0.7), random.uniform(3, 14));
    const PatternSearch search = find_pattern(image, pattern);
    ASSERT_EQ(search.status, PatternStatus::kFound) << trial;
    int wrong = 0;
    for (const PatternPoint& c : search.points)
      if ((c.centre_px - view.pixel_of({c.on_pattern_mm.x(), c.on_pattern_mm.y(), 0})).norm() > 1)
        ++wrong;
    EXPECT_EQ(wrong, 0);
    EXPECT_GT(search.points.size(), left * 7 / 10);  // false ones spoil some they touch
  }
}

TEST(Pattern, WhoseLowerPartIsShiftedIsNotTakenForOneLattice) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(100, 0, 0, 0);
  const Image image = view.look(Payload::kCirclePattern);
  const double pitch = (view.pixel_of({20, 0, 0}) - view.pixel_of({0, 0, 0})).norm();
  const int cut = static_cast<int>(view.pixel_of({0, -30, 0}).y());
  for (const double share : {0.1, 0.15, 0.3, 0.5}) {  // of a step
    Image shifted = image;
    const int by = static_cast<int>(std::lround(share * pitch));
    for (int v = cut; v < image.height; ++v)
      std::copy_n(image.pixels.begin() + v * image.width, image.width - by, shifted.row(v) + by);
    const PatternSearch search = find_pattern(shifted, view.rig().pattern);
    if (search.status != PatternStatus::kFound) continue;
    // Found: then without the part that does not belong to the direction circles.
    for (const PatternPoint& c : search.points) EXPECT_LT(c.centre_px.y(), cut) << share;
    EXPECT_GT(search.unexplained, 50) << share;
  }
}

TEST(Pattern, UnderNoiseOfThirtyGreyLevelsIsWhollyIndexedAThousandTimes) {
  // Half the size of the shipped camera's image, and a dozen renders; the noise is new each time.
  RigFile rig = shipped_rig("ideal");
  rig.camera.image_size = {512, 512};
  rig.simulation->lens.focal_px /= 2;
  rig.simulation->lens.principal_point_px /= 2;
  SimulatedView view(rig);
  NoiseTable noise(draws_of_this_test());
  int wrong = 0, missing = 0, refused = 0, images = 0;
  for (int pose = 0; pose < 10; ++pose) {
    view.stand(80, 36.0 * pose, 3.0 * pose, -12);
    const Image clean = view.look(Payload::kCirclePattern);
    std::vector<std::array<int, 2>> expected;  // fully in view, with room for the blur
    for (const PatternPoint& c : find_pattern(clean, rig.pattern).points)
      if (c.box.left >= 5 && c.box.top >= 5 && c.box.right < 507 && c.box.bottom < 507)
        expected.push_back({c.column, c.row});
    ASSERT_GT(expected.size(), 100u);
    for (int k = 0; k < 100; ++k) {
      const PatternSearch search = find_pattern(noise.add_to(clean, 30), rig.pattern);
      ++images;
      if (search.status != PatternStatus::kFound) ++refused;
      wrong += accuracy(view, search).wrong;
      for (const auto& [column, row] : expected)
        if (std::ranges::none_of(search.points, [&](const PatternPoint& c) {
              return c.column == column && c.row == row;
            }))
          ++missing;
    }
  }
  EXPECT_EQ(images, 1000);
  EXPECT_EQ(refused, 0);
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(missing, 0);
}

RigFile grid_rig(int columns, int rows) {
  RigFile rig = shipped_rig("simulated");
  rig.pattern.kind = PatternKind::kCircleGrid;
  rig.pattern.columns = columns;
  rig.pattern.rows = rows;
  rig.pattern.origin_column = columns / 2;
  rig.pattern.origin_row = rows / 2;
  rig.pattern.direction_circles.clear();
  return rig;
}

TEST(CircleGrid, IsIndexedUpToTheTurnsThatItCannotTell) {
  for (const auto& [columns, rows] : {std::array{10, 8}, {9, 9}}) {
    SimulatedView view(grid_rig(columns, rows));
    for (const double yaw : {-40.0, 0.0, 30.0, 130.0}) {
      view.stand(100, yaw, 15, -10);
      const PatternSearch search =
          find_pattern(view.look(Payload::kCirclePattern), view.rig().pattern);
      ASSERT_EQ(search.status, PatternStatus::kFound) << yaw;
      EXPECT_TRUE(search.half_turn_ambiguous);
      EXPECT_EQ(search.quarter_turn_ambiguous, columns == rows);
      EXPECT_EQ(search.points.size(), static_cast<std::size_t>(columns * rows));
      // With an odd count the origin is the middle, whatever the turn; and x runs along u.
      const auto place = [&](int column, int row) {
        return std::ranges::find_if(
                   search.points,
                   [&](const PatternPoint& p) { return p.column == column && p.row == row; })
            ->centre_px;
      };
      const Vector2d x = place(1, 0) - place(0, 0), y = place(0, 1) - place(0, 0);
      EXPECT_GT(x.x(), 0);
      EXPECT_LT(x.x() * y.y() - x.y() * y.x(), 0);
      if (columns == rows) {
        EXPECT_LT((place(0, 0) - view.pixel_of({0, 0, 0})).norm(), 0.1);
        EXPECT_GT(x.x(), std::abs(x.y()));
      }
    }
  }
}

TEST(CircleGrid, WithACircleMissingOrOutOfViewIsIncomplete) {
  SimulatedView view(grid_rig(10, 8));
  view.stand(100, 0, 0, 0);
  Image image = view.look(Payload::kCirclePattern);
  ImageView cut = image;
  cut.width = static_cast<int>(view.pixel_of({80, 0, 0}).x());
  EXPECT_EQ(find_pattern(cut, view.rig().pattern).status, PatternStatus::kIncomplete);
  cover(view, image, 1, 1, 24);
  EXPECT_EQ(find_pattern(image, view.rig().pattern).status, PatternStatus::kIncomplete);
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
