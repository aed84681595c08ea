#include "src/vision/matching.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

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

TEST(Matching, NamesThePointThatIsAmbiguousOrTooFar) {
  std::vector<Ray> rays;
  for (const Vector3d& p : kPoints) rays.push_back(ray_through(p));
  EXPECT_EQ(match_to_prediction(kPoints, rays, kPlanes, 15.0).point, -1);
  rays.push_back(ray_through(kPoints[2] + Vector3d(3, 0, 0)));
  Match match = match_to_prediction(kPoints, rays, kPlanes, 15.0);
  EXPECT_EQ(match.status, MatchStatus::kAmbiguous);
  EXPECT_EQ(match.point, 2);
  rays = {rays[0], rays[1], rays[2], ray_through(kPoints[3] + Vector3d(0, -40, 0))};
  match = match_to_prediction(kPoints, rays, kPlanes, 15.0);
  EXPECT_EQ(match.status, MatchStatus::kTooFar);
  EXPECT_EQ(match.point, 3);
}

TEST(Matching, PairsNothingWithRaysThatAreNotFinite) {
  std::vector<Ray> rays;
  for (const Vector3d& p : kPoints) rays.push_back(ray_through(p));
  const Ray lost{Vector2d::Constant(std::nan("")), Vector2d::Zero()};
  rays.insert(rays.begin(), lost);
  const Match match = match_to_prediction(kPoints, rays, kPlanes, 15.0);
  ASSERT_EQ(match.status, MatchStatus::kMatched);
  EXPECT_EQ(match.ray_of_point, (std::vector{1, 2, 3, 4}));
  rays[2] = lost;
  EXPECT_EQ(match_to_prediction(kPoints, rays, kPlanes, 15.0).status, MatchStatus::kTooFar);
}

TEST(Matching, FindsThirtyTwoPointsUnderACommonOffset) {
  Random random(1, "Matching.FindsThirtyTwoPointsUnderACommonOffset");
  std::vector<Vector3d> points;
  for (int k = 0; k < 32; ++k)
    points.emplace_back(20.0 * (k % 8) - 70.0, 20.0 * (k / 8) - 30.0, random.uniform(80, 100));
  std::vector<Ray> rays;
  for (auto p = points.rbegin(); p != points.rend(); ++p)
    rays.push_back(ray_through(*p + Vector3d(4, -3, 2)));
  const Match match = match_to_prediction(points, rays, kPlanes, 15.0);
  ASSERT_EQ(match.status, MatchStatus::kMatched);
  for (int k = 0; k < 32; ++k) EXPECT_EQ(match.ray_of_point[static_cast<std::size_t>(k)], 31 - k);
}

}  // namespace
}  // namespace turntable
