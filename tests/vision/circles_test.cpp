#include "src/vision/circles.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/drawn_plane.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

using Eigen::Vector2d;

struct Scene {
  double ground = 25, plateau = 200, blur_px = 0.8, noise = 2.0;
  double light_left = 1.0;  ///< share of the light at the right edge
  double major = 14, minor = 9;
};

struct Drawn {
  Image image;
  std::vector<Vector2d> centres;
};

/// 8 x 6 ellipses at random sub-pixel places and angles; the blur is a Gaussian step along the edge.
Drawn draw(const Scene& scene, Random random) {
  constexpr int kPitch = 48;
  Drawn out;
  const ImageSize size{8 * kPitch, 6 * kPitch};
  std::vector<double> signal(static_cast<std::size_t>(size.width * size.height), scene.ground);
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 8; ++i) {
      const Vector2d c(kPitch * (i + 0.5) + random.uniform(-1, 1),
                       kPitch * (j + 0.5) + random.uniform(-1, 1));
      const double angle = random.uniform(0, 3.2);
      const double cos = std::cos(angle), sin = std::sin(angle);
      out.centres.push_back(c);
      for (int v = j * kPitch; v < (j + 1) * kPitch; ++v)
        for (int u = i * kPitch; u < (i + 1) * kPitch; ++u) {
          const double x = cos * (u - c.x()) + sin * (v - c.y()),
                       y = -sin * (u - c.x()) + cos * (v - c.y());
          // Distance from the edge to first order: (1 - q) q / |grad q|, q the scaled radius.
          const double q = std::hypot(x / scene.major, y / scene.minor);
          const double slope =
              std::hypot(x / (scene.major * scene.major), y / (scene.minor * scene.minor)) /
              std::max(q, 1e-9);
          const double inside = q > 1e-9 ? (1 - q) / slope : scene.minor;
          signal[static_cast<std::size_t>(v * size.width + u)] +=
              (scene.plateau - scene.ground) * 0.5 *
              std::erfc(-inside / (scene.blur_px * std::sqrt(2.0)));
        }
    }
  out.image = Image(size, 0);
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u) {
      const double share = 1.0 + (scene.light_left - 1.0) * u / (size.width - 1);
      const double grey = signal[static_cast<std::size_t>(v * size.width + u)] * share +
                          scene.noise * random.normal();
      out.image.row(v)[u] = static_cast<std::uint8_t>(std::clamp(std::lround(grey), 0L, 255L));
    }
  return out;
}

struct Errors {
  int count = 0;
  double rms_px = 0.0, in_sigmas = 0.0;  ///< per coordinate
  Vector2d mean_px = Vector2d::Zero();
};

/// Errors over several images.
Errors errors_of(const Scene& scene, bool bright, int images) {
  Errors e;
  double square = 0.0, scaled = 0.0;
  for (int k = 0; k < images; ++k) {
    const Drawn drawn = draw(scene, draws_of_this_test(static_cast<std::uint64_t>(k)));
    for (const Circle& c : find_circles(drawn.image, bright).circles)
      for (const Vector2d& truth : drawn.centres) {
        const Vector2d d = c.centre_px - truth;
        if (d.norm() > 3) continue;
        ++e.count;
        e.mean_px += d;
        square += d.squaredNorm();
        scaled += d.squaredNorm() / (c.sigma_px * c.sigma_px);
      }
  }
  e.mean_px /= e.count;
  e.rms_px = std::sqrt(square / (2 * e.count));
  e.in_sigmas = std::sqrt(scaled / (2 * e.count));
  return e;
}

TEST(Circles, LieWithinTheirStatedUncertaintyUnderAnyLightContrastBlurAndNoise) {
  Scene plain, falling, dark, blurred, small, noisy;
  falling.light_left = 0.4;
  std::swap(dark.ground, dark.plateau);
  blurred.blur_px = 2.5;
  small.major = 5;
  small.minor = 4;
  noisy.noise = 15;
  struct Case {
    const char* name;
    Scene scene;
    double limit_px;
  };
  for (const Case& c : {Case{"plain", plain, 0.01},
                        {"falling light", falling, 0.015},
                        {"dark", dark, 0.01},
                        {"blurred", blurred, 0.025},
                        {"small", small, 0.02},
                        {"noisy", noisy, 0.07}}) {
    SCOPED_TRACE(c.name);
    const bool bright = c.scene.plateau > c.scene.ground;
    const Errors e = errors_of(c.scene, bright, 12);
    EXPECT_EQ(e.count, 12 * 48);
    EXPECT_LT(e.rms_px, c.limit_px);
    EXPECT_GT(e.in_sigmas, 0.9);
    EXPECT_LT(e.in_sigmas, 1.1);
    EXPECT_LT(e.mean_px.norm(), 4.0 * e.rms_px / std::sqrt(1.0 * e.count));
  }
}

TEST(Circles, UnderFallingLightAreNotDrawnTowardsIt) {
  // A plain centroid is: by r^2/4 times the light's relative slope, 0.07 px here at the dark end.
  Scene scene;
  scene.light_left = 0.4;
  scene.noise = 0.5;
  const Errors e = errors_of(scene, true, 4);
  EXPECT_EQ(e.count, 4 * 48);
  EXPECT_LT(std::abs(e.mean_px.x()), 0.002);
}

TEST(Circles, UnderNoiseOfThirtyGreyLevelsAreAllFoundAndNothingElse) {
  Scene scene;
  scene.noise = 30;
  for (std::uint64_t k = 0; k < 10; ++k) {
    const Drawn drawn = draw(scene, draws_of_this_test(k));
    const CircleSearch search = find_circles(drawn.image, true);
    EXPECT_EQ(search.circles.size(), 48u);
    for (const Circle& c : search.circles) {
      double nearest = INFINITY;
      for (const Vector2d& t : drawn.centres) nearest = std::min(nearest, (c.centre_px - t).norm());
      EXPECT_LT(nearest, 1.0);
    }
  }
}

TEST(Circles, AreNotSeenInTheNoiseOfWideEmptyGround) {
  Random random = draws_of_this_test();
  Image image({600, 600}, 0);
  for (int v = 0; v < 600; ++v)
    for (int u = 0; u < 600; ++u) {
      const double inside = 12.5 - std::hypot(u - 300, v - 300);
      const double grey = 60 + 140 * std::clamp(inside, 0.0, 1.0) + 25 * random.normal();
      image.row(v)[u] = static_cast<std::uint8_t>(std::clamp(std::lround(grey), 0L, 255L));
    }
  const CircleSearch search = find_circles(image, true);
  ASSERT_EQ(search.circles.size(), 1u);
  EXPECT_LT((search.circles[0].centre_px - Vector2d(300, 300)).norm(), 0.5);
}

TEST(Circles, CutByTheBorderAreLeftOutAndCounted) {
  const Drawn drawn = draw(Scene(), draws_of_this_test());
  ImageView cut = drawn.image;
  cut.data += 24;  // half a pitch: through the middle of the first column
  cut.width -= 24;
  const CircleSearch search = find_circles(cut, true);
  EXPECT_EQ(search.circles.size(), 42u);
  EXPECT_EQ(search.cut_by_border, 6);
}

TEST(Circles, AreNotSeenInBarsEmptyImagesOrNoise) {
  EXPECT_TRUE(find_circles(Image(), true).circles.empty());
  EXPECT_TRUE(find_circles(Image({300, 200}, 90), true).circles.empty());
  EXPECT_TRUE(find_circles(Image({5, 3}, 90), false).circles.empty());
  Image bars({300, 200}, 20);
  for (int v = 60; v < 140; ++v)
    for (int u = 20; u < 280; ++u)
      if (u % 40 < 12) bars.row(v)[u] = 200;
  const CircleSearch search = find_circles(bars, true);
  EXPECT_TRUE(search.circles.empty());
  EXPECT_EQ(search.rejected, 6);
}

}  // namespace
}  // namespace turntable
