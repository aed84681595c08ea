#include "src/evaluation/attitude_sensor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "src/core/errors.h"
#include "src/core/units.h"
#include "src/imaging/opencv_yaml.h"
#include "tests/support/draws.h"
#include "tests/support/message_of.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

/// A lens with distortion, 600 mm above the middle of its rays' planes.
CentralModel distorting_lens() {
  CentralModel lens;
  lens.kind = CentralKind::kBrown;
  lens.fx = 1945.0;
  lens.fy = 1941.0;
  lens.cx = 517.0;
  lens.cy = 508.0;
  lens.distortion = {-0.06, 0.1, 0.0003, -0.0002, 0.0};
  lens.image_size = {1024, 1024};
  lens.R_plane_from_camera = Vector3d(1, -1, -1).asDiagonal();
  return lens;
}

const Calibration& calibration() {
  static const Calibration made =
      calibration_from_central(distorting_lens(), {-625.0, -575.0}, "lens");
  return made;
}

const TargetModel& target() {
  static const TargetModel model(
      std::vector<Vector3d>{{0, 0, 0}, {58.6, 13.0, -40}, {-40.6, 44.2, -40}, {-18.0, -57.2, -40}});
  return model;
}

struct Pose {
  Matrix3d R = rotation_from_vector({0.3, -0.25, 0.5});
  Vector3d at{12.0, -20.0, -590.0};
};

std::vector<Vector2d> pixels_of(const Pose& pose, const CentralModel& lens,
                                const TargetModel& model = target()) {
  std::vector<Vector2d> out;
  for (int t = 0; t < model.size(); ++t) {
    Vector3d at = pose.R * (model.points().col(t) - model.points().col(0)) + pose.at;
    at.head<2>() += lens.lean * at.z();  // from coordinates that move with the pattern
    out.push_back(lens.project(lens.R_plane_from_camera.transpose() * (at - lens.centre_mm)));
  }
  return out;
}

std::vector<Eigen::Matrix2d> same_for_all(const Eigen::Matrix2d& covariance_px2) {
  return std::vector<Eigen::Matrix2d>(static_cast<std::size_t>(target().size()), covariance_px2);
}

/// Errors of (delta, position) over what a covariance says of each, squared and summed.
struct Squares {
  std::array<double, 6> sums{};

  void add(const MeasuredAttitude& got, const Pose& true_pose, const Matrix6d& covariance) {
    const Vector3d turn = vector_from_rotation(true_pose.R * got.R_plane_from_target.transpose());
    const Vector3d shift = true_pose.at - got.position_mm;
    for (int i = 0; i < 6; ++i) {
      const double error = i < 3 ? turn[i] : shift[i - 3];
      sums[static_cast<std::size_t>(i)] += error * error / covariance(i, i);
    }
  }
  /// Means of chi^2 with one degree of freedom, four standard deviations.
  void expect_stated(int draws) const {
    for (const double sum : sums) EXPECT_NEAR(sum / draws, 1.0, 4.0 * std::sqrt(2.0 / draws));
  }
};

TEST(AttitudeSensor, ServesEverySolverThroughEveryCameraWithTheSameAnswer) {
  const Pose pose;
  const std::vector<Vector2d> seen = pixels_of(pose, distorting_lens());
  // The ray model misses the lens by up to 1e-3 px (calibration_from_central).
  for (const auto& [camera, tolerance_deg] : {std::pair{"brown", 1e-5}, {"irt", 1e-3}})
    for (const Solver& solver : kSolvers) {
      const AttitudeSensor sensor(calibration(), target(), solver, camera);
      const MeasuredAttitude got =
          sensor.measure(seen, same_for_all(0.01 * Eigen::Matrix2d::Identity()));
      ASSERT_EQ(got.status, SolveStatus::kConverged) << solver.name << camera;
      if (solver.peer) continue;
      EXPECT_LT(deg_from_rad(geodesic_angle(got.R_plane_from_target, pose.R)), tolerance_deg)
          << solver.name << camera;
      EXPECT_LT((got.position_mm - pose.at).norm(), 20.0 * tolerance_deg) << solver.name << camera;
      EXPECT_TRUE(got.in_domain);
      EXPECT_LT(got.residual, 0.01) << solver.name << camera;
    }
}

TEST(AttitudeSensor, TakesTheCameraThatTheSolverWantsIfNoneIsNamed) {
  const std::vector<Vector2d> seen = pixels_of({}, distorting_lens());
  for (const auto& [solver, camera] :
       {std::pair{"posit", "pinhole"}, {"posit_undistorted", "brown"}, {"ml_ray", "irt"}}) {
    const AttitudeSensor wanted(calibration(), target(), *find_solver(solver));
    const AttitudeSensor named(calibration(), target(), *find_solver(solver), camera);
    EXPECT_EQ(wanted.measure(seen).R_plane_from_target, named.measure(seen).R_plane_from_target);
  }
}

TEST(AttitudeSensor, StatesPositionsInThePlaneFrameOfACameraThatLeans) {
  Calibration leaning = calibration();
  CentralModel& lens = leaning.central.front();
  ASSERT_EQ(lens.kind, CentralKind::kBrown);
  lens.lean = {4e-4, -3e-4};
  const Pose pose;
  const std::vector<Vector2d> seen = pixels_of(pose, lens);
  for (const char* solver : {"posit_undistorted", "ml_ray"}) {
    const AttitudeSensor sensor(leaning, target(), *find_solver(solver), "brown");
    // 0.3 mm without the lean. What it shears of the target itself is a tenth of that.
    const Vector2d miss = (sensor.measure(seen).position_mm - pose.at).head<2>();
    EXPECT_LT(miss.norm(), 0.1) << solver;
  }
}

TEST(AttitudeSensor, StatesACovarianceThatItsErrorsHaveUnderUnequalNoise) {
  Eigen::Matrix2d L;  // px; longer across than along
  L << 0.2, 0.0, 0.075, 0.066;
  const Eigen::Matrix2d noise = L * L.transpose();
  const Pose pose;
  const std::vector<Vector2d> exact = pixels_of(pose, distorting_lens());
  for (const char* camera : {"irt", "brown"}) {
    const AttitudeSensor sensor(calibration(), target(), default_solver(), camera);
    Random random = draws_of_this_test();
    constexpr int kDraws = 400;
    Squares squares;
    double chi2 = 0.0;
    for (int k = 0; k < kDraws; ++k) {
      std::vector<Vector2d> seen = exact;
      for (Vector2d& p : seen) p += L * Vector2d(random.normal(), random.normal());
      const MeasuredAttitude got = sensor.measure(seen, same_for_all(noise));
      ASSERT_TRUE(got.has_attitude());
      squares.add(got, pose, got.covariance);
      chi2 += got.chi2;
    }
    squares.expect_stated(kDraws);
    // Mean of 400 draws of chi^2 with 2 degrees of freedom, four standard deviations.
    EXPECT_NEAR(chi2 / kDraws, 2.0, 4.0 * std::sqrt(4.0 / kDraws)) << camera;
  }
}

TEST(AttitudeSensor, TellsWhatSpotsRaysAndTargetDoToAMeasurement) {
  Calibration known = calibration();
  const Eigen::Index terms = known.irt.coefficients().rows();
  known.irt.set_covariance(1e-4 * Eigen::MatrixXd::Identity(2 * terms, 2 * terms));
  const std::vector<Vector2d> seen = pixels_of({}, distorting_lens());
  const std::vector<Eigen::Matrix2d> spots = same_for_all(0.0025 * Eigen::Matrix2d::Identity());
  const AttitudeSensor by_rays(known, target(), default_solver());
  const MeasuredAttitude got = by_rays.measure(seen, spots);
  const PoseUncertainty all = by_rays.uncertainty(seen, spots, got, 0.05);
  EXPECT_EQ(all.spots, got.covariance);
  EXPECT_GT(all.rays(0, 0), 0.0);
  EXPECT_GT(all.target(0, 0), 0.0);
  EXPECT_EQ(by_rays.uncertainty(seen, spots, got, 0.0).target(0, 0), 0.0);
  // Nothing is known of the rays of a central model, and nothing of anything without the spots'.
  const AttitudeSensor by_lens(known, target(), default_solver(), "brown");
  EXPECT_EQ(by_lens.uncertainty(seen, spots, by_lens.measure(seen, spots), 0.05).rays(0, 0), 0.0);
  EXPECT_TRUE(std::isnan(by_rays.uncertainty(seen, {}, by_rays.measure(seen), 0.05).total()(0, 0)));

  // The target's part against errors drawn from it.
  Random random = draws_of_this_test();
  constexpr int kDraws = 400;
  Squares squares;
  for (int k = 0; k < kDraws; ++k) {
    std::vector<Vector3d> points;
    for (int t = 0; t < target().size(); ++t)
      points.push_back(target().points().col(t) +
                       0.05 * Vector3d(random.normal(), random.normal(), random.normal()));
    const TargetModel real(points);
    Pose pose;  // of the real M0, which is beside the drawn one
    const MeasuredAttitude off = by_rays.measure(pixels_of(pose, distorting_lens(), real), spots);
    squares.add(off, pose, all.target);
  }
  squares.expect_stated(kDraws);
}

TEST(AttitudeSensor, StatesNoCovarianceIfTheSpotsStateNone) {
  const AttitudeSensor sensor(calibration(), target(), default_solver());
  const MeasuredAttitude got = sensor.measure(pixels_of({}, distorting_lens()));
  EXPECT_EQ(got.status, SolveStatus::kConverged);
  EXPECT_TRUE(got.covariance.array().isNaN().all());
  EXPECT_TRUE(std::isnan(got.chi2));
}

TEST(AttitudeSensor, SaysThatAPointLiesOutsideAndStatesTheAttitudeAllTheSame) {
  // One LED outside the image, which is all that this camera is calibrated for.
  const Pose pose{Matrix3d::Identity(), {110.0, 0.0, -590.0}};
  const std::vector<Vector2d> seen = pixels_of(pose, distorting_lens());
  for (const char* solver : {"ml_ray", "posit_undistorted"}) {
    const AttitudeSensor sensor(calibration(), target(), *find_solver(solver), "brown");
    const MeasuredAttitude got = sensor.measure(seen);
    EXPECT_EQ(got.status, SolveStatus::kOutsideDomain) << solver;
    EXPECT_FALSE(got.in_domain);
    EXPECT_TRUE(got.has_attitude());
    EXPECT_LT(deg_from_rad(geodesic_angle(got.R_plane_from_target, pose.R)), 1e-4) << solver;
  }
}

TEST(AttitudeSensor, HasNoAttitudeWhereTheCameraHasNoRay) {
  Calibration folding = calibration();
  folding.central.front().distortion = {-1.5, 0.0, 0.0, 0.0, 0.0};  // ends at 0.47 of a tangent
  std::vector<Vector2d> seen = pixels_of({}, distorting_lens());
  seen[1] = {1900.0, 500.0};
  for (const char* solver : {"ml_ray", "posit_undistorted"}) {
    const AttitudeSensor sensor(folding, target(), *find_solver(solver), "brown");
    const MeasuredAttitude got =
        sensor.measure(seen, same_for_all(0.01 * Eigen::Matrix2d::Identity()));
    EXPECT_EQ(got.status, SolveStatus::kOutsideDomain);
    EXPECT_FALSE(got.has_attitude());
  }
}

TEST(AttitudeSensor, RefusesPointsThatAreNotTheTargets) {
  const AttitudeSensor sensor(calibration(), target(), default_solver());
  std::vector<Vector2d> seen = pixels_of({}, distorting_lens());
  seen[0].x() = NAN;
  EXPECT_EQ(sensor.measure(seen).status, SolveStatus::kInvalidInput);
  seen.pop_back();
  EXPECT_EQ(sensor.measure(seen).status, SolveStatus::kInvalidInput);
}

TEST(AttitudeSensor, RefusesACameraThatIsNotThereAndATargetThatTheSolverDoesNotTake) {
  EXPECT_THAT(message_of<ConfigError>(
                  [] { AttitudeSensor(calibration(), target(), default_solver(), "fisheye"); }),
              HasSubstr("no camera model \"fisheye\", allowed: irt, "));
  Calibration rays_only = calibration();
  rays_only.central.clear();
  const Solver& posit = *find_solver("posit");
  EXPECT_FALSE(AttitudeSensor::can_serve(rays_only, posit));
  EXPECT_THAT(message_of<ConfigError>([&] { AttitudeSensor(rays_only, target(), posit); }),
              HasSubstr("needs a pinhole calibration"));
  EXPECT_NO_THROW(AttitudeSensor(rays_only, target(), posit, "irt"));
  const TargetModel flat(std::vector<Vector3d>{{0, 0, 0}, {60, 0, 0}, {0, 60, 0}, {-30, -40, 0}});
  EXPECT_THAT(message_of<ConfigError>([&] { AttitudeSensor(calibration(), flat, posit); }),
              HasSubstr("lie in a plane"));
  EXPECT_NO_THROW(AttitudeSensor(calibration(), flat, default_solver()));
}

}  // namespace
}  // namespace turntable
