#include "src/vision/matching.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "src/core/random.h"

namespace turntable {
namespace {

constexpr RayPlanes kPlanes{130, 180};

Ray ray_through(const Vector3d& point) {
  const Vector3d camera(0, 0, 700);
  const auto at = [&](double z) -> Vector2d {
    return (camera + (point - camera) * ((camera.z() - z) / (camera.z() - point.z()))).head<2>();
  };
  return {at(kPlanes.a_mm), at(kPlanes.b_mm)};
}

const std::vector<Vector3d> kPoints{{0, 0, 120}, {58, 13, 80}, {-40, 44, 80}, {-18, -57, 80}};

TEST(Matching, FindsEveryOrderUnderACommonOffset) {
  Random random(1, "Matching.FindsEveryOrderUnderACommonOffset");
  std::vector<int> order{0, 1, 2, 3};
  do {
    std::vector<Ray> rays(4);
    const Vector3d offset(random.uniform(-5, 5), random.uniform(-5, 5), random.uniform(-5, 5));
    for (std::size_t i = 0; i < 4; ++i)
      rays[static_cast<std::size_t>(order[i])] = ray_through(kPoints[i] + offset);
    const Match match = match_to_prediction(kPoints, rays, kPlanes, 15.0);
    ASSERT_EQ(match.status, MatchStatus::kMatched);
    EXPECT_EQ(match.ray_of_point, order);
  } while (std::ranges::next_permutation(order).found);
}

TEST(Matching, IgnoresFarReflections) {
  std::vector<Ray> rays{ray_through({150, 100, 100})};
  for (const Vector3d& p : kPoints) rays.push_back(ray_through(p));
  const Match match = match_to_prediction(kPoints, rays, kPlanes, 15.0);
  ASSERT_EQ(match.status, MatchStatus::kMatched);
  EXPECT_EQ(match.ray_of_point, (std::vector{1, 2, 3, 4}));
}

TEST(Matching, SaysWhatIsWrongInsteadOfGuessing) {
  std::vector<Ray> three, doubled, elsewhere;
  for (const Vector3d& p : kPoints) {
    doubled.push_back(ray_through(p + Vector3d(2, 0, 0)));
    elsewhere.push_back(ray_through(p * 0.2 + Vector3d(90, 90, 90)));
  }
  three.assign(doubled.begin(), doubled.begin() + 3);
  doubled.push_back(ray_through(kPoints[1] + Vector3d(-2, 0, 0)));
  EXPECT_EQ(match_to_prediction(kPoints, three, kPlanes, 15.0).status, MatchStatus::kTooFewSpots);
  EXPECT_EQ(match_to_prediction(kPoints, {}, kPlanes, 15.0).status, MatchStatus::kTooFewSpots);
  EXPECT_EQ(match_to_prediction(kPoints, doubled, kPlanes, 15.0).status, MatchStatus::kAmbiguous);
  EXPECT_NE(match_to_prediction(kPoints, elsewhere, kPlanes, 15.0).status, MatchStatus::kMatched);
}

}  // namespace
}  // namespace turntable
