#include "src/attitude/correspondence.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "src/attitude/p3p.h"
#include "tests/attitude/correspondence_scenes.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

using problems::kPlanes;
using problems::Scene;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

struct Tally {
  int right = 0;  ///< matched, and rightly
  int wrong = 0;  ///< matched, but a point has another point's spot or a stray one
  int ambiguous = 0;
  int none = 0;
};

/// A hidden point may be given no spot, a seen one its own only.
bool right(const Scene& s, const AssignedPose& pose) {
  return pose.spot_of_point == s.spot_of_point;
}

void count(Tally& tally, const Scene& s, const Correspondence& c) {
  if (c.status == CorrespondenceStatus::kMatched)
    ++(right(s, c.ranked[0]) ? tally.right : tally.wrong);
  else
    ++(c.status == CorrespondenceStatus::kAmbiguous ? tally.ambiguous : tally.none);
}

CorrespondenceOptions options_for(const Scene& s, int min_points = 0) {
  CorrespondenceOptions options;
  options.sigma_mm = std::max(s.sigma_mm, 1e-3);
  options.min_points = min_points;
  options.max_tilt_rad = rad_from_deg(45.0);
  return options;
}

Correspondence solve(const Scene& s, const CorrespondenceOptions& options) {
  return correspond(TargetModel(s.truth.target_mm), s.rays, kPlanes, options);
}

TEST(P3p, finds_the_ranges_of_every_triangle) {
  Random random = draws_of_this_test();
  for (int trial = 0; trial < 2000; ++trial) {
    Matrix3d x;
    for (double& entry : x.reshaped()) entry = random.uniform(-60, 60);
    x.row(2).array() += random.uniform(200, 700);
    const Vector3d distances((x.col(0) - x.col(1)).norm(), (x.col(0) - x.col(2)).norm(),
                             (x.col(1) - x.col(2)).norm());
    const P3pSolutions found =
        solve_p3p(x.col(0).normalized(), x.col(1).normalized(), x.col(2).normalized(), distances);
    double nearest = std::numeric_limits<double>::infinity();
    for (int k = 0; k < found.count; ++k)
      nearest = std::min(
          nearest,
          (found.ranges[static_cast<std::size_t>(k)] - x.colwise().norm().transpose()).norm());
    EXPECT_LT(nearest, 0.01) << trial;  // double roots are only good to the root of the rounding
  }
}

TEST(P3p, answers_nothing_to_directions_that_are_the_same) {
  const Vector3d y = Vector3d(0.1, 0.2, -1).normalized();
  EXPECT_EQ(solve_p3p(y, y, y, {50, 60, 70}).count, 0);
}

TEST(Correspondence, finds_every_order_of_four_spots_and_the_pose) {
  Random random = draws_of_this_test();
  std::vector<int> order{0, 1, 2, 3};
  const TargetModel target(problems::published_target());
  do {
    const problems::Problem p = problems::random_problem(random);
    std::vector<Ray> rays(4);
    for (std::size_t t = 0; t < 4; ++t) rays[static_cast<std::size_t>(order[t])] = p.rays[t];
    CorrespondenceOptions options;
    options.sigma_mm = 0.005;
    const Correspondence c = correspond(target, rays, kPlanes, options);
    ASSERT_EQ(c.status, CorrespondenceStatus::kMatched);
    EXPECT_EQ(c.ranked[0].spot_of_point, order);
    EXPECT_LT(geodesic_angle(c.ranked[0].R_plane_from_target, p.R_plane_from_target), 1e-5);
    EXPECT_LT((c.ranked[0].position_mm - p.origin_mm).norm(), 0.01);
    EXPECT_LT(c.ranked[0].rms_mm, 1e-3);
    if (c.ranked.size() > 1) {
      EXPECT_GT(c.ranked[1].rms_mm, 4.0 * c.ranked[0].rms_mm);
    }
  } while (std::ranges::next_permutation(order).found);
}

TEST(Correspondence, never_takes_four_spots_for_others_under_noise_and_strays) {
  Random random = draws_of_this_test();
  for (const int strays : {0, 1, 2, 4}) {
    Tally tally;
    for (int trial = 0; trial < 100; ++trial) {
      const Scene s = problems::scene(random, problems::random_problem(random), 0.05, strays);
      count(tally, s, solve(s, options_for(s)));
    }
    EXPECT_EQ(tally.wrong, 0) << strays;
    EXPECT_LE(tally.none, 1) << strays;
    EXPECT_GE(tally.right, 90) << strays;
  }
}

class CorrespondenceOfMany : public ::testing::TestWithParam<int> {};

TEST_P(CorrespondenceOfMany, finds_all_points_among_strays) {
  Random random = draws_of_this_test();
  for (const double noise_px : {0.05, 0.5}) {
    Tally tally;
    for (int trial = 0; trial < 20; ++trial) {
      const Scene s = problems::scene(
          random,
          problems::random_problem(random, problems::spaced_target(random, GetParam()), 40.0),
          noise_px, trial % 9);
      count(tally, s, solve(s, options_for(s)));
    }
    EXPECT_EQ(tally.wrong, 0) << noise_px;
    EXPECT_EQ(tally.none, 0) << noise_px;
    EXPECT_GE(tally.right, noise_px < 0.1 ? 19 : 14) << noise_px;
  }
}

TEST_P(CorrespondenceOfMany, says_which_points_are_hidden) {
  Random random = draws_of_this_test();
  Tally tally;
  for (int trial = 0; trial < 10; ++trial) {
    const int n = GetParam(), hidden = n / 4;
    const Scene s = problems::scene(
        random, problems::random_problem(random, problems::spaced_target(random, n), 40.0), 0.05, 2,
        hidden);
    count(tally, s, solve(s, options_for(s, n - hidden)));
  }
  EXPECT_EQ(tally.wrong, 0);
  EXPECT_EQ(tally.none, 0);
  EXPECT_GE(tally.right, 8);
}

INSTANTIATE_TEST_SUITE_P(Points, CorrespondenceOfMany, ::testing::Values(8, 16, 32));

TEST(Correspondence, does_not_find_a_target_in_random_spots) {
  Random random = draws_of_this_test();
  const TargetModel target(problems::published_target());
  CorrespondenceOptions options;
  options.sigma_mm = 0.02;
  int matched = 0, accepted = 0;
  constexpr int kScenes = 3000;
  for (int trial = 0; trial < kScenes; ++trial) {
    std::vector<Ray> rays;
    for (int j = 0; j < 4 + trial % 3; ++j) rays.push_back(problems::stray_ray(random, {}));
    const Correspondence c = correspond(target, rays, kPlanes, options);
    matched += c.status == CorrespondenceStatus::kMatched;
    accepted += !c.ranked.empty();
  }
  // max_chance bounds the expected share: 0.01 for each scene that has an acceptable fit of that
  // chance, so a few in all at most.
  EXPECT_LE(matched, kScenes / 500);
  EXPECT_LE(accepted, kScenes / 20);
}

TEST(Correspondence, does_not_find_half_a_target_in_random_spots) {
  Random random = draws_of_this_test();
  int matched = 0;
  constexpr int kScenes = 200;
  for (int trial = 0; trial < kScenes; ++trial) {
    const TargetModel target(problems::spaced_target(random, 8));
    std::vector<Ray> rays;
    for (int j = 0; j < 6; ++j) rays.push_back(problems::stray_ray(random, {}));
    CorrespondenceOptions options;
    options.min_points = 4;
    matched += correspond(target, rays, kPlanes, options).status == CorrespondenceStatus::kMatched;
  }
  EXPECT_LE(matched, kScenes / 50);  // max_chance, and twice as many for the draw
}

TEST(Correspondence, calls_a_symmetric_target_ambiguous_unless_told_where_to_look) {
  Random random = draws_of_this_test();
  const double h = 30.0 * std::numbers::sqrt3;
  const std::vector<Vector3d> points{{0, 0, 0}, {60, 0, -40}, {-30, h, -40}, {-30, -h, -40}};
  for (int trial = 0; trial < 20; ++trial) {
    const Scene s = problems::scene(
        random, problems::make(points, problems::random_rotation(random, 40), {5, -3, 150}), 0.05,
        trial % 3);
    CorrespondenceOptions options = options_for(s);
    const Correspondence c = solve(s, options);
    ASSERT_EQ(c.status, CorrespondenceStatus::kAmbiguous);
    ASSERT_EQ(c.ranked.size(), 2u);
    EXPECT_NE(c.ranked[0].spot_of_point, c.ranked[1].spot_of_point);
    EXPECT_NEAR(geodesic_angle(c.ranked[0].R_plane_from_target, c.ranked[1].R_plane_from_target),
                rad_from_deg(120), rad_from_deg(3));
    options.max_turn_rad = rad_from_deg(55);
    const Correspondence told = solve(s, options);
    ASSERT_EQ(told.status, CorrespondenceStatus::kMatched) << told.chance;
    EXPECT_TRUE(right(s, told.ranked[0]));
  }
}

TEST(Correspondence, uses_rays_that_have_no_common_centre_or_are_parallel) {
  Random random = draws_of_this_test();
  problems::Lens walking, telecentric;
  walking.pupil_walk_mm_per_rad2 = 60.0;
  telecentric.telecentric = true;
  for (int trial = 0; trial < 20; ++trial) {
    const std::vector<Vector3d> points = problems::spaced_target(random, 8);
    const Scene walk = problems::scene(
        random, problems::random_problem(random, points, 35, walking), 0.05, trial % 3);
    const Correspondence c = solve(walk, options_for(walk));
    ASSERT_EQ(c.status, CorrespondenceStatus::kMatched) << trial;
    EXPECT_TRUE(right(walk, c.ranked[0]));
    const Scene flat = problems::scene(
        random, problems::random_problem(random, points, 35, telecentric), 0.0, trial % 3);
    const Correspondence f = solve(flat, options_for(flat));
    ASSERT_EQ(f.status, CorrespondenceStatus::kMatched) << trial;
    EXPECT_TRUE(right(flat, f.ranked[0]));
    EXPECT_TRUE(std::isnan(f.ranked[0].position_mm.z()));
    EXPECT_LT((f.ranked[0].position_mm - flat.truth.origin_mm).head<2>().norm(), 0.01);
  }
}

TEST(Correspondence, keeps_to_the_heights_and_tilts_that_are_allowed) {
  Random random = draws_of_this_test();
  const Scene s =
      problems::scene(random,
                      problems::make(problems::published_target(),
                                     rotation_from_vector({rad_from_deg(30), 0, 0}), {0, 0, 150}),
                      0.02, 0);
  CorrespondenceOptions options = options_for(s);
  ASSERT_EQ(solve(s, options).status, CorrespondenceStatus::kMatched);
  options.min_height_mm = 170;
  EXPECT_EQ(solve(s, options).status, CorrespondenceStatus::kNoFit);
  options.min_height_mm = 100;
  options.max_height_mm = 130;
  EXPECT_EQ(solve(s, options).status, CorrespondenceStatus::kNoFit);
  options = options_for(s);
  options.max_tilt_rad = rad_from_deg(20);
  EXPECT_EQ(solve(s, options).status, CorrespondenceStatus::kNoFit);
}

TEST(Correspondence, has_no_fit_for_a_camera_on_the_other_side) {
  Random random = draws_of_this_test();
  Scene s = problems::scene(random, problems::random_problem(random), 0.0, 0);
  for (Ray& ray : s.rays) std::swap(ray.at_a, ray.at_b);  // the bundle now opens upwards
  EXPECT_EQ(solve(s, options_for(s)).status, CorrespondenceStatus::kNoFit);
}

TEST(Correspondence, has_a_clear_answer_to_rays_that_are_useless) {
  Random random = draws_of_this_test();
  const Scene s = problems::scene(random, problems::random_problem(random), 0.02, 0);
  const CorrespondenceOptions options = options_for(s);
  const TargetModel target(problems::published_target());
  const auto status = [&](const std::vector<Ray>& rays) {
    return correspond(target, rays, kPlanes, options).status;
  };
  EXPECT_EQ(status({}), CorrespondenceStatus::kTooFewSpots);
  std::vector<Ray> rays = s.rays;
  rays[2].at_b.y() = kNaN;
  EXPECT_EQ(status(rays), CorrespondenceStatus::kTooFewSpots);
  rays.insert(rays.begin(), Ray{{kNaN, 0}, {0, 0}});
  rays.push_back(s.rays[2]);
  const Correspondence c = correspond(target, rays, kPlanes, options);
  ASSERT_EQ(c.status, CorrespondenceStatus::kMatched);
  for (std::size_t t = 0; t < 4; ++t) {
    const int spot = s.spot_of_point[t];
    EXPECT_EQ(c.ranked[0].spot_of_point[t], spot == 2 ? 5 : spot + 1);
  }
  EXPECT_EQ(status(std::vector<Ray>(6, s.rays[0])), CorrespondenceStatus::kNoFit);
  rays = s.rays;
  rays.push_back(rays[1]);  // which of the two it is cannot be known
  EXPECT_EQ(status(rays), CorrespondenceStatus::kAmbiguous);
  rays = s.rays;
  rays[1] = rays[0];
  EXPECT_EQ(status(rays), CorrespondenceStatus::kNoFit);
  rays = s.rays;
  rays[3].at_a.x() = 1e300, rays[3].at_b.x() = -1e300;
  EXPECT_NE(status(rays), CorrespondenceStatus::kMatched);
}

TEST(Correspondence, refuses_to_rest_on_points_that_are_coplanar) {
  Random random = draws_of_this_test();
  // Five of a plane and one above it, which is hidden.
  const std::vector<Vector3d> points{{0, 0, -20},     {50, 10, -20},  {-30, 40, -20},
                                     {-10, -45, -20}, {35, -35, -20}, {5, 5, 20}};
  const Scene s = problems::scene(
      random, problems::make(points, problems::random_rotation(random, 30), {0, 0, 150}), 0.02, 0,
      1);
  EXPECT_EQ(solve(s, options_for(s, 5)).status, CorrespondenceStatus::kNoFit);
}

TEST(Correspondence, tells_the_turn_of_the_nearly_symmetric_rig_target_only_if_noise_is_low) {
  Random random = draws_of_this_test();
  // The rival a third of a turn away misses the rays by 0.05 mm, 0.2 px.
  for (const double noise_px : {0.05, 0.3}) {
    Tally free, told;
    for (int trial = 0; trial < 100; ++trial) {
      const Scene s =
          problems::scene(random,
                          problems::make(problems::rig_target(),
                                         problems::random_rotation(random, 40), {5, -3, 150}),
                          noise_px, 0);
      CorrespondenceOptions options = options_for(s);
      const Correspondence c = solve(s, options);
      count(free, s, c);
      options.max_turn_rad = rad_from_deg(45);
      count(told, s, solve(s, options));
      // A match leaves no close rival in the other thirds.
      for (const double turn_deg : {120.0, -120.0}) {
        options.R_near = rotation_from_vector({0, 0, rad_from_deg(turn_deg)});
        const Correspondence other = solve(s, options);
        if (c.status == CorrespondenceStatus::kMatched && !other.ranked.empty()) {
          EXPECT_GT(other.ranked[0].rms_mm, 2.0 * s.sigma_mm);
        }
      }
    }
    EXPECT_EQ(free.wrong, 0) << noise_px;
    EXPECT_EQ(told.wrong, 0) << noise_px;
    EXPECT_GE(told.right, 90) << noise_px;
    EXPECT_GE(noise_px < 0.1 ? free.right : free.ambiguous, 80) << noise_px;
  }
}

}  // namespace
}  // namespace turntable
