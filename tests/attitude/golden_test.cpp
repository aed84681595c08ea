#include "tests/support/golden.h"

#include <gtest/gtest.h>

#include "src/attitude/cramer_rao.h"
#include "src/attitude/solver.h"

namespace turntable {
namespace {

std::vector<Ray> rays_of(const nlohmann::json& test_case) {
  const auto a = golden::vectors<2>(test_case.at("rays_on_plane_a_mm"));
  const auto b = golden::vectors<2>(test_case.at("rays_on_plane_b_mm"));
  if (a.size() != b.size()) throw std::runtime_error("different numbers of points on a and b");
  std::vector<Ray> rays;
  for (std::size_t t = 0; t < a.size(); ++t) rays.push_back({a[t], b[t]});
  return rays;
}

struct Worst {
  double R = 0.0, rows = 0.0, height = 0.0;
  int iterations = 0;
};

// Compares one answer; `worst` collects how close it came.
void compare(const Solution& got, const nlohmann::json& want, const char* R_key,
             const char* height_key, Worst& worst) {
  ASSERT_EQ(status_name(got.status), "converged");
  const double R = golden::largest_difference(got.R, golden::matrix3(want.at(R_key)));
  const double rows =
      golden::largest_difference(got.rows_ijk, golden::matrix3(want.at("rows_ijk")));
  const double height = want.at(height_key).get<double>();
  const double height_error = std::abs(got.position_mm.z() - height) / std::abs(height);
  EXPECT_LT(R, golden::kAgreement);
  EXPECT_LT(rows, golden::kAgreement);
  EXPECT_LT(height_error, golden::kAgreement) << got.position_mm.z() << " for " << height;
  worst.R = std::max(worst.R, R);
  worst.rows = std::max(worst.rows, rows);
  worst.height = std::max(worst.height, height_error);
  worst.iterations = std::max(worst.iterations,
                              std::abs(got.iterations - want.value("iterations", got.iterations)));
}

void report(const std::string& what, std::size_t cases, const Worst& worst) {
  golden::report(what + ", R", cases, worst.R);
  golden::report(what + ", rows i j k", cases, worst.rows);
  golden::report(what + ", height, relative", cases, worst.height);
  golden::report(what + ", iterations", cases, worst.iterations);
}

void check_rays(const char* solver_name, const char* golden_key) {
  const nlohmann::json document = golden::load("aopit.json");
  const SolveOptions options{document.at("tolerance_mm"), document.at("max_iterations")};
  const Solver* solver = find_solver(solver_name);
  ASSERT_NE(solver, nullptr);
  Worst worst;
  std::size_t number = 0;
  for (const auto& test_case : document.at("cases")) {
    SCOPED_TRACE("case " + std::to_string(number++));
    const TargetModel target(golden::vectors<3>(test_case.at("target_points_mm")));
    const std::vector<Ray> rays = rays_of(test_case);
    const Observation observation{
        rays, {test_case.at("plane_a_mm"), test_case.at("plane_b_mm")}, {}};
    compare(solver->function(target, observation, options), test_case.at(golden_key),
            "R_plane_from_target", "m_mm", worst);
  }
  report(solver_name, number, worst);
}

void check_pinhole(const char* solver_name) {
  const nlohmann::json document = golden::load("posit.json");
  const SolveOptions options{document.at("tolerance"), document.at("max_iterations")};
  const Solver* solver = find_solver(solver_name);
  ASSERT_NE(solver, nullptr);
  Worst worst;
  std::size_t number = 0;
  for (const auto& test_case : document.at("cases")) {
    SCOPED_TRACE("case " + std::to_string(number++));
    const TargetModel target(golden::vectors<3>(test_case.at("target_points_mm")));
    const auto points = golden::vectors<2>(test_case.at("normalised_image_points"));
    compare(solver->function(target, {{}, {}, points}, options), test_case.at("posit"),
            "R_camera_from_target", "z0_mm", worst);
  }
  report(solver_name, number, worst);
}

TEST(AopitGolden, published_form_agrees_on_every_case) { check_rays("aopit", "aopit_published"); }

TEST(AopitGolden, form_on_general_rays_agrees_on_every_case) {
  check_rays("aopit_ray", "aopit_ray");
}

TEST(PositGolden, raw_and_undistorted_rows_agree_on_every_case) {
  check_pinhole("posit");
  check_pinhole("posit_undistorted");
}

TEST(CramerRaoGolden, bound_agrees_on_every_case) {
  const nlohmann::json document = golden::load("cramer_rao.json");
  double worst = 0.0;
  std::size_t number = 0;
  for (const auto& test_case : document.at("cases")) {
    SCOPED_TRACE("case " + std::to_string(number++));
    const TargetModel target(golden::vectors<3>(test_case.at("target_points_mm")));
    const PoseBound bound =
        cramer_rao_bound_pinhole(target, golden::matrix3(test_case.at("R_plane_from_target")),
                                 golden::vector<3>(test_case.at("origin_mm")),
                                 golden::vector<3>(test_case.at("camera_centre_mm")),
                                 test_case.at("focal_px"), test_case.at("sigma_px"));
    const Matrix3d want = golden::matrix3(test_case.at("rotation_covariance_rad2"));
    // Entries are near 1e-7 rad^2: relative to the largest, or nothing would be tested.
    const double relative = golden::largest_difference(bound.rotation_covariance_rad2(), want) /
                            want.cwiseAbs().maxCoeff();
    EXPECT_LT(relative, golden::kAgreement);
    worst = std::max(worst, relative);
    EXPECT_LT(golden::largest_difference(bound.rotation_std_deg(),
                                         golden::vector<3>(test_case.at("rotation_std_deg"))),
              golden::kAgreement);
    EXPECT_NEAR(bound.total_std_deg(), test_case.at("total_std_deg").get<double>(),
                golden::kAgreement);
  }
  golden::report("Cramer-Rao bound, relative", number, worst);
}

}  // namespace
}  // namespace turntable
