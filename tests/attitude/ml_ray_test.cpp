// What maximum likelihood on rays states beyond a pose: covariance, where it comes from, and points
// that do not belong.
#include "src/attitude/ml_ray.h"

#include <gtest/gtest.h>

#include <cmath>

#include "src/attitude/cramer_rao.h"
#include "src/attitude/information.h"
#include "src/attitude/uncertainty.h"
#include "tests/attitude/problems.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

using problems::Problem;
using Vector6d = Eigen::Matrix<double, 6, 1>;

const SolveOptions kExact{1e-7, 200};

Solution solve(const Problem& problem, SolveOptions options = kExact) {
  return solve_ml_ray(TargetModel(problem.target_mm), problem.observation(), options);
}

/// (delta, T) of `to` seen from `from`.
Vector6d difference(const Solution& from, const Solution& to) {
  Vector6d d;
  d << vector_from_rotation(to.R * from.R.transpose()), to.position_mm - from.position_mm;
  return d;
}

/// Without noise, but with the spreads of it.
Problem stated(const Problem& exact, double sigma_px, Random& random) {
  Problem p = exact;
  problems::add_noise(p, sigma_px, random);
  p.rays = exact.rays;
  p.normalised = exact.normalised;
  return p;
}

/// Symmetric and positive, with standard deviations about `sigma`: root root^T.
struct Covariance {
  Eigen::MatrixXd root, matrix;

  Covariance(Eigen::Index size, double sigma, Random& random) : root(size, size) {
    for (Eigen::Index i = 0; i < size; ++i)
      for (Eigen::Index j = 0; j < size; ++j)
        root(i, j) = sigma / std::sqrt(static_cast<double>(size)) * random.normal();
    matrix = root.lazyProduct(root.transpose());
  }
  Eigen::VectorXd draw(Random& random) const {
    Eigen::VectorXd z(root.cols());
    for (double& value : z) value = random.normal();
    return root.lazyProduct(z);
  }
};

void expect_same_covariance(const Matrix6d& sampled, const Matrix6d& stated, int draws) {
  // An entry of the sample scatters by sqrt((C_ii C_jj + C_ij^2) / draws) about C_ij.
  for (Eigen::Index i = 0; i < 6; ++i)
    for (Eigen::Index j = 0; j < 6; ++j)
      EXPECT_LT(
          std::abs(sampled(i, j) - stated(i, j)),
          5.0 * std::sqrt((stated(i, i) * stated(j, j) + stated(i, j) * stated(i, j)) / draws))
          << i << " " << j;
}

TEST(MlRay, covariance_is_the_cramer_rao_bound_for_central_cameras) {
  Random random = draws_of_this_test();
  for (int i = 0; i < 50; ++i) {
    const Problem problem = stated(problems::random_problem(random), 0.07, random);
    const Solution s = solve(problem);
    const PoseBound bound = cramer_rao_bound_pinhole(
        TargetModel(problem.target_mm), problem.R_plane_from_target, problem.origin_mm,
        problem.lens.centre_mm, problems::kFocalPx, 0.07);
    EXPECT_LT((s.covariance - bound.covariance).norm(), 1e-5 * bound.covariance.norm());
    EXPECT_NEAR(s.chi2, 0.0, 1e-12);
  }
}

TEST(MlRay, states_no_covariance_where_the_noise_is_not_known) {
  Random random = draws_of_this_test();
  const Solution s = solve(problems::random_problem(random));
  ASSERT_TRUE(s.has_attitude());
  EXPECT_TRUE(std::isnan(s.covariance(0, 0)));
  EXPECT_TRUE(std::isnan(s.chi2));
}

TEST(MlRay, spreads_that_are_not_numbers_or_too_few_are_invalid) {
  Random random = draws_of_this_test();
  Problem problem = stated(problems::random_problem(random), 0.05, random);
  problem.spreads[1].at_b(0, 1) = Solution::kNaN;
  EXPECT_EQ(status_name(solve(problem).status), "invalid_input");
  problem.spreads.pop_back();
  EXPECT_EQ(status_name(solve(problem).status), "invalid_input");
}

TEST(MlRay, spots_of_unequal_noise_weigh_by_it) {
  // The least noisy four of five determine the pose; the fifth is nearly without weight.
  Random random = draws_of_this_test();
  for (int i = 0; i < 20; ++i) {
    Problem problem = problems::random_problem(random, problems::random_target(random, 5));
    const Problem exact = problem;
    problems::add_noise(problem, 0.01, random);
    for (Eigen::Matrix2d* S : {&problem.spreads[4].at_a, &problem.spreads[4].at_b}) *S *= 1e4;
    problem.rays[4].at_a += Vector2d(3.0, -2.0);  // mm
    problem.rays[4].at_b += Vector2d(3.0, -2.0);
    EXPECT_LT(geodesic_angle(exact.R_plane_from_target, solve(problem).R), rad_from_deg(0.1));
  }
}

TEST(MlRay, robust_leaves_out_the_point_that_contradicts_the_others) {
  Random random = draws_of_this_test();
  SolveOptions robust = kExact;
  robust.robust = true;
  int named = 0;
  for (int i = 0; i < 200; ++i) {
    Problem problem = problems::random_problem(random, problems::random_target(random, 7));
    problems::add_noise(problem, 0.05, random);
    const int bad = static_cast<int>(random.uniform(0, 7));
    const Vector2d off = Vector2d(random.normal(), random.normal()).normalized() * 2.0;  // mm
    problem.rays[static_cast<std::size_t>(bad)].at_a += off;
    problem.rays[static_cast<std::size_t>(bad)].at_b += off;
    const Solution s = solve(problem, robust);
    ASSERT_TRUE(s.has_attitude());
    named += s.left_out == 1u << bad;
    EXPECT_LT(geodesic_angle(problem.R_plane_from_target, s.R), rad_from_deg(0.5));
    EXPECT_GT(geodesic_angle(problem.R_plane_from_target, solve(problem).R),
              geodesic_angle(problem.R_plane_from_target, s.R));
  }
  EXPECT_GE(named, 195);
}

TEST(MlRay, robust_leaves_two_out_and_keeps_good_points) {
  Random random = draws_of_this_test();
  SolveOptions robust = kExact;
  robust.robust = true;
  int two = 0, clean_but_dropped = 0;
  for (int i = 0; i < 200; ++i) {
    Problem problem = problems::random_problem(random, problems::random_target(random, 9));
    problems::add_noise(problem, 0.05, random);
    clean_but_dropped += solve(problem, robust).left_out != 0;
    for (const std::size_t bad : {2u, 5u})
      for (Vector2d* at : {&problem.rays[bad].at_a, &problem.rays[bad].at_b})
        *at += Vector2d(1.5, bad == 2u ? 1.0 : -1.0);
    two += solve(problem, robust).left_out == (1u << 2 | 1u << 5);
  }
  EXPECT_GE(two, 190);
  EXPECT_LE(clean_but_dropped, 3);  // one in a thousand is expected
}

TEST(MlRay, robust_changes_nothing_for_four_points) {
  Random random = draws_of_this_test();
  Problem problem = problems::random_problem(random);
  problems::add_noise(problem, 0.05, random);
  problem.rays[1].at_a.x() += 1.0;
  SolveOptions robust = kExact;
  robust.robust = true;
  EXPECT_EQ(solve(problem, robust).R, solve(problem).R);
  EXPECT_EQ(solve(problem, robust).left_out, 0u);
}

/// n points, M0 among them, in a disc of 60 mm that is flat to `thickness`.
std::vector<Vector3d> flat_target(Random& random, int n, double thickness) {
  for (;;) {
    const Matrix3d Q = problems::random_rotation(random, 180);
    std::vector<Vector3d> points;
    for (int t = 0; t < n; ++t)
      points.push_back(Q * Vector3d(random.uniform(-60, 60), random.uniform(-60, 60),
                                    60 * thickness * random.uniform(-1, 1)));
    if (!TargetModel::refusal(points).empty()) continue;
    const TargetModel target(points);
    if (!target.coplanar() && target.thickness() < 0.1) return points;
  }
}

TEST(MlRay, flat_targets_are_answered_right_or_not_at_all) {
  // The fixed point of aopit_ray, where it starts from, is a wrong one there in up to every tenth case.
  Random random = draws_of_this_test();
  int wrong = 0, answered = 0, start_wrong = 0;
  constexpr int kDraws = 3000;
  for (int i = 0; i < kDraws; ++i) {
    const int n = i % 3 == 0 ? 4 : i % 3 == 1 ? 6 : 12;
    Problem problem =
        problems::random_problem(random, flat_target(random, n, random.uniform(0.02, 0.15)), 180);
    problems::add_noise(problem, 0.05, random);
    const auto off = [&](const Solution& s) {
      return s.has_attitude() &&
             geodesic_angle(problem.R_plane_from_target, s.R) > rad_from_deg(10);
    };
    const Solution s = solve(problem, {1e-5, 200});
    answered += s.has_attitude();
    wrong += off(s);
    start_wrong +=
        off((*find_solver("aopit_ray"))(TargetModel(problem.target_mm), problem.observation()));
  }
  std::cout << "ml_ray: " << answered << " of " << kDraws << " answered, " << wrong
            << " wrong; aopit_ray " << start_wrong << " wrong\n";
  EXPECT_LE(wrong, kDraws / 500);
  EXPECT_GT(answered, 0.8 * kDraws);
  EXPECT_GT(start_wrong, 20);  // else this tests nothing
}

TEST(MlRay, points_that_contradict_each_other_show_in_chi_square) {
  Random random = draws_of_this_test();
  for (int i = 0; i < 50; ++i) {
    Problem swapped = problems::random_problem(random);
    problems::add_noise(swapped, 0.05, random);
    std::swap(swapped.rays[1], swapped.rays[2]);
    const Solution s = solve(swapped);
    EXPECT_TRUE(!s.has_attitude() || s.chi2 > 100.0 * s.dof);
    // Two of five are off: four that agree cannot be found, and nothing pretends that they were.
    Problem two = problems::random_problem(random, problems::random_target(random, 5));
    problems::add_noise(two, 0.05, random);
    for (const std::size_t bad : {1u, 3u})
      for (Vector2d* at : {&two.rays[bad].at_a, &two.rays[bad].at_b})
        *at += Vector2d(random.uniform(2, 4), random.uniform(2, 4));
    SolveOptions robust = kExact;
    robust.robust = true;
    const Solution r = solve(two, robust);
    EXPECT_TRUE(!r.has_attitude() || r.chi2 > 3.0 * r.dof ||
                geodesic_angle(two.R_plane_from_target, r.R) < rad_from_deg(0.5));
  }
}

TEST(MlRay, robust_answers_for_the_first_point_also_where_it_is_left_out) {
  Random random = draws_of_this_test();
  SolveOptions robust = kExact;
  robust.robust = true;
  for (int i = 0; i < 50; ++i) {
    Problem problem = problems::random_problem(random, problems::random_target(random, 7));
    const Problem exact = problem;
    problems::add_noise(problem, 0.05, random);
    for (Vector2d* at : {&problem.rays[0].at_a, &problem.rays[0].at_b}) *at += Vector2d(3, -2);
    const Solution s = solve(problem, robust);
    ASSERT_EQ(s.left_out, 1u);
    Vector6d d;
    d << vector_from_rotation(exact.R_plane_from_target * s.R.transpose()),
        exact.origin_mm - s.position_mm;
    EXPECT_LT(d.dot(Vector6d(inverse_of_information(s.covariance) * d)),
              40.0);  // 6 degrees of freedom
  }
}

TEST(MlRay, parallel_rays_state_everything_but_the_height) {
  Random random = draws_of_this_test();
  const Problem exact = problems::random_problem(random, problems::published_target(), 35.0,
                                                 {.centre_mm = {0, 0, 700}, .telecentric = true});
  const Solution s = solve(stated(exact, 0.05, random));
  ASSERT_EQ(status_name(s.status), "height_undefined");
  EXPECT_TRUE((s.covariance.topLeftCorner<5, 5>().allFinite()));
  EXPECT_TRUE(std::isnan(s.covariance(5, 5)));
  Eigen::Matrix<double, 5, 5> sum = Eigen::Matrix<double, 5, 5>::Zero();
  constexpr int kDraws = 3000;
  for (int i = 0; i < kDraws; ++i) {
    Problem noisy = exact;
    problems::add_noise(noisy, 0.05, random);
    const Eigen::Matrix<double, 5, 1> d = difference(s, solve(noisy)).head<5>();
    sum += d * d.transpose() / kDraws;
  }
  const Eigen::Array<double, 5, 1> ratio =
      sum.diagonal().array() / s.covariance.diagonal().head<5>().array();
  EXPECT_LT((ratio - 1.0).abs().maxCoeff(), 5.0 * std::sqrt(2.0 / kDraws)) << ratio.transpose();
}

/// One pose seen by a lens whose pupil walks, and what may be wrong with it.
class Uncertainty : public ::testing::Test {
 protected:
  Uncertainty()
      : random(draws_of_this_test()),
        exact(stated(
            problems::random_problem(random, problems::random_target(random, 5), 35.0,
                                     {.centre_mm = {-28, 12, 700}, .pupil_walk_mm_per_rad2 = 300}),
            0.05, random)),
        target(exact.target_mm),
        truth(solve(exact)) {}

  static constexpr int kPoints = 5;
  /// `problem` with errors of the rays' points on a and b: (x_a.., x_b..), then y.
  Problem with_ray_errors(const Eigen::VectorXd& x, const Eigen::VectorXd& y) const {
    Problem p = exact;
    for (Eigen::Index t = 0; t < kPoints; ++t) {
      Ray& ray = p.rays[static_cast<std::size_t>(t)];
      ray.at_a += Vector2d(x(t), y(t));
      ray.at_b += Vector2d(x(kPoints + t), y(kPoints + t));
    }
    return p;
  }
  /// The target is really off by `e` (3n); what is seen is seen of the real one.
  Problem with_target_errors(const Eigen::VectorXd& e) const {
    std::vector<Vector3d> real = exact.target_mm;
    for (Eigen::Index t = 0; t < kPoints; ++t)
      real[static_cast<std::size_t>(t)] += e.segment<3>(3 * t);
    // M0 stays where it is in the plane frame: T is where it really is.
    Problem p = problems::make(real, exact.R_plane_from_target, exact.origin_mm, exact.lens);
    p.target_mm = exact.target_mm;
    p.spreads = exact.spreads;
    return p;
  }

  Random random;
  Problem exact;
  TargetModel target;
  Solution truth;
};

TEST_F(Uncertainty, of_rays_and_target_is_what_finite_differences_say) {
  constexpr double kStep = 1e-4;  // mm
  const auto derivative = [&](const auto& moved) -> Vector6d {
    return difference(solve(moved(-kStep)), solve(moved(kStep))) / (2.0 * kStep);
  };
  const Covariance of_rays(2 * kPoints, 0.01, random), of_target(3 * kPoints, 0.02, random);
  const UncertaintySources sources{of_rays.matrix, of_target.matrix};
  Eigen::MatrixXd to_x(6, 2 * kPoints), to_y = to_x, to_target(6, 3 * kPoints);
  const Eigen::VectorXd none = Eigen::VectorXd::Zero(2 * kPoints);
  for (Eigen::Index i = 0; i < 2 * kPoints; ++i) {
    const Eigen::VectorXd unit = Eigen::VectorXd::Unit(2 * kPoints, i);
    to_x.col(i) = derivative([&](double h) { return with_ray_errors(h * unit, none); });
    to_y.col(i) = derivative([&](double h) { return with_ray_errors(none, h * unit); });
  }
  for (Eigen::Index i = 0; i < 3 * kPoints; ++i)
    to_target.col(i) = derivative(
        [&](double h) { return with_target_errors(h * Eigen::VectorXd::Unit(3 * kPoints, i)); });
  const PoseUncertainty u = propagate_uncertainty(target, exact.observation(), truth, sources);
  const Matrix6d rays =
      to_x * sources.rays_mm2 * to_x.transpose() + to_y * sources.rays_mm2 * to_y.transpose();
  const Matrix6d geometry = to_target * sources.target_mm2 * to_target.transpose();
  EXPECT_LT((u.rays - rays).norm(), 1e-5 * rays.norm());
  EXPECT_LT((u.target - geometry).norm(), 1e-5 * geometry.norm());
  EXPECT_EQ(u.spots, truth.covariance);
  EXPECT_EQ(u.total(), u.spots + u.rays + u.target);
}

TEST_F(Uncertainty, of_each_source_is_what_monte_carlo_says) {
  const Covariance of_rays(2 * kPoints, 0.01, random), of_target(3 * kPoints, 0.02, random);
  const UncertaintySources sources{of_rays.matrix, of_target.matrix};
  const PoseUncertainty u = propagate_uncertainty(target, exact.observation(), truth, sources);
  constexpr int kDraws = 4000;
  Matrix6d spots = Matrix6d::Zero(), rays = spots, geometry = spots, all = spots;
  const auto add = [&](Matrix6d& sum, const Problem& problem) {
    const Vector6d d = difference(truth, solve(problem));
    sum += d * d.transpose() / kDraws;
  };
  for (int i = 0; i < kDraws; ++i) {
    Problem noisy = exact;
    noisy.spreads.clear();
    problems::add_noise(noisy, 0.05, random);
    add(spots, noisy);
    const Eigen::VectorXd x = of_rays.draw(random), y = of_rays.draw(random);
    const Problem moved = with_ray_errors(x, y);
    add(rays, moved);
    Problem together = with_target_errors(of_target.draw(random));
    add(geometry, together);
    for (std::size_t t = 0; t < kPoints; ++t) {
      together.rays[t].at_a += moved.rays[t].at_a + noisy.rays[t].at_a - 2.0 * exact.rays[t].at_a;
      together.rays[t].at_b += moved.rays[t].at_b + noisy.rays[t].at_b - 2.0 * exact.rays[t].at_b;
    }
    add(all, together);
  }
  expect_same_covariance(spots, u.spots, kDraws);
  expect_same_covariance(rays, u.rays, kDraws);
  expect_same_covariance(geometry, u.target, kDraws);
  expect_same_covariance(all, u.total(), kDraws);
}

TEST_F(Uncertainty, expects_the_residuals_that_monte_carlo_finds) {
  const Covariance of_rays(2 * kPoints, 0.01, random), of_target(3 * kPoints, 0.02, random);
  const UncertaintySources sources{of_rays.matrix, of_target.matrix};
  constexpr int kDraws = 4000;
  struct Case {
    bool spots, rays, target;
  };
  for (const Case& c :
       {Case{true, false, false}, {true, true, false}, {true, false, true}, {true, true, true}}) {
    UncertaintySources stated_sources;
    if (c.rays) stated_sources.rays_mm2 = sources.rays_mm2;
    if (c.target) stated_sources.target_mm2 = sources.target_mm2;
    double sum = 0.0, squares = 0.0, expected = 0.0;
    for (int i = 0; i < kDraws; ++i) {
      Problem noisy = exact;
      problems::add_noise(noisy, 0.05, random);
      Problem seen = with_target_errors(c.target ? of_target.draw(random)
                                                 : Eigen::VectorXd::Zero(3 * kPoints).eval());
      const Eigen::VectorXd none = Eigen::VectorXd::Zero(2 * kPoints);
      const Problem moved = with_ray_errors(c.rays ? of_rays.draw(random) : none,
                                            c.rays ? of_rays.draw(random) : none);
      for (std::size_t t = 0; t < kPoints; ++t) {
        seen.rays[t].at_a += moved.rays[t].at_a + noisy.rays[t].at_a - 2.0 * exact.rays[t].at_a;
        seen.rays[t].at_b += moved.rays[t].at_b + noisy.rays[t].at_b - 2.0 * exact.rays[t].at_b;
      }
      const Solution s = solve(seen);
      const Fit fit = judge_fit(target, seen.observation(), s.R, s.position_mm, stated_sources);
      EXPECT_NEAR(fit.chi2, s.chi2, 1e-6 * (1.0 + s.chi2));
      EXPECT_EQ(fit.dof, 2 * kPoints - 6);
      sum += fit.chi2;
      squares += fit.chi2 * fit.chi2;
      expected += fit.expected / kDraws;
    }
    const double mean = sum / kDraws;
    const double spread = std::sqrt((squares / kDraws - mean * mean) / kDraws);
    EXPECT_NEAR(mean, expected, 4.0 * spread) << c.rays << c.target;
    if (!c.rays && !c.target) {
      EXPECT_NEAR(expected, 2 * kPoints - 6, 1e-9);
    } else {
      EXPECT_GT(expected, 1.5 * (2 * kPoints - 6)) << "the case must say something";
    }
  }
}

TEST_F(Uncertainty, judges_what_is_left_of_points_and_height) {
  const Observation seen = exact.observation();
  const Fit all = judge_fit(target, seen, truth.R, truth.position_mm, {});
  const Fit four = judge_fit(target, seen, truth.R, truth.position_mm, {}, 1u << 3);
  EXPECT_EQ(four.dof, all.dof - 2);
  EXPECT_NEAR(four.expected, all.expected - 2.0, 1e-9);
  const Matrix3d turned = rotation_from_vector({0.0, 0.1, 0.0}) * truth.R;
  EXPECT_GT(judge_fit(target, seen, turned, truth.position_mm, {}).misfit(), 1e4);
  Random draws = draws_of_this_test();
  const Problem parallel = problems::random_problem(
      draws, exact.target_mm, 35.0, {.centre_mm = {0, 0, 700}, .telecentric = true});
  const Problem noisy = stated(parallel, 0.05, draws);
  const Solution s = solve(noisy);
  ASSERT_EQ(status_name(s.status), "height_undefined");
  const Fit fit = judge_fit(target, noisy.observation(), s.R, s.position_mm, {});
  EXPECT_EQ(fit.dof, 2 * kPoints - 5);
  EXPECT_NEAR(fit.expected, 2 * kPoints - 5, 1e-9);
}

TEST(NearlyParallelRays, pass_the_uncertainty_of_the_target_on_through_their_scale) {
  Random random = draws_of_this_test();
  const Problem exact = stated(problems::random_problem(random, problems::published_target(), 35.0,
                                                        {.centre_mm = {0, 0, 1e5}}),
                               1e-3, random);
  const Solution truth = solve(exact);
  ASSERT_EQ(status_name(truth.status), "height_undefined");
  const Covariance of_target(12, 0.02, random);
  const UncertaintySources sources{{}, of_target.matrix};
  const PoseUncertainty u =
      propagate_uncertainty(TargetModel(exact.target_mm), exact.observation(), truth, sources);
  EXPECT_TRUE(std::isnan(u.target(5, 5)));
  constexpr int kDraws = 3000;
  Eigen::Matrix<double, 5, 1> squares = Eigen::Matrix<double, 5, 1>::Zero();
  for (int i = 0; i < kDraws; ++i) {
    const Eigen::VectorXd e = of_target.draw(random);
    std::vector<Vector3d> real = exact.target_mm;
    for (Eigen::Index t = 0; t < 4; ++t) real[static_cast<std::size_t>(t)] += e.segment<3>(3 * t);
    Problem seen = problems::make(real, exact.R_plane_from_target, exact.origin_mm, exact.lens);
    seen.target_mm = exact.target_mm;
    seen.spreads = exact.spreads;
    squares += difference(truth, solve(seen)).head<5>().cwiseAbs2() / kDraws;
  }
  const Eigen::Array<double, 5, 1> ratio = squares.array() / u.target.diagonal().head<5>().array();
  EXPECT_LT((ratio - 1.0).abs().maxCoeff(), 5.0 * std::sqrt(2.0 / kDraws)) << ratio.transpose();
}

TEST_F(Uncertainty, of_sources_not_stated_is_zero_and_without_covariance_unknown) {
  const PoseUncertainty u = propagate_uncertainty(target, exact.observation(), truth, {});
  EXPECT_EQ(u.rays, Matrix6d(Matrix6d::Zero()));
  EXPECT_EQ(u.total(), truth.covariance);
  Solution unknown = truth;
  unknown.covariance.setConstant(Solution::kNaN);
  EXPECT_TRUE(
      std::isnan(propagate_uncertainty(target, exact.observation(), unknown, {}).total()(0, 0)));
}

}  // namespace
}  // namespace turntable
