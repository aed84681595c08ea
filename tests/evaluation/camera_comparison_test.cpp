#include "src/evaluation/camera_comparison.h"

#include <gtest/gtest.h>

#include <cmath>

#include "src/core/units.h"
#include "src/imaging/opencv_yaml.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

/// Poses seen by a distorting lens, evaluated with a calibration that has that lens, a pinhole that
/// leaves its distortion out, and rays.
class CameraComparisonTest : public ::testing::Test {
 protected:
  CameraComparisonTest() {
    rig = load_rig_file(std::filesystem::path(TURNTABLE_SOURCE_DIR) /
                        "scenarios/rigs/simulated.json");
    CentralModel lens;
    lens.kind = CentralKind::kBrown;
    lens.fx = lens.fy = 1945.0;
    lens.cx = lens.cy = 511.5;
    lens.distortion = {-0.065, 0.12, 0, 0, 0};
    lens.image_size = {1024, 1024};
    lens.R_plane_from_camera = Vector3d(1, -1, -1).asDiagonal();
    calibration = calibration_from_central(lens, {-625.0, -575.0}, "lens");
    CentralModel pinhole = lens;
    pinhole.kind = CentralKind::kPinhole;
    pinhole.distortion.clear();
    std::erase_if(calibration.central,
                  [](const CentralModel& m) { return m.kind == CentralKind::kPinhole; });
    calibration.central.push_back(pinhole);

    Random random = draws_of_this_test();
    const Gimbal gimbal(rig.gimbal);
    for (int k = 0; k <= 200; ++k) {
      EvaluatedPose pose;
      pose.planned.role = k == 0 ? PoseRole::kReference : PoseRole::kMeasure;
      pose.taken = true;
      if (k > 0)
        pose.read_back_deg = {random.uniform(-30, 30), random.uniform(-20, 20),
                              random.uniform(-20, 20)};
      const Matrix3d R = gimbal.rotation({rad_from_deg(pose.read_back_deg.yaw),
                                          rad_from_deg(pose.read_back_deg.roll),
                                          rad_from_deg(pose.read_back_deg.pitch)});
      for (const Vector3d& p : rig.target.points_mm) {
        const Vector3d at = R * p + Vector3d(20, 10, -600);
        pose.points_px.push_back(lens.project(lens.R_plane_from_camera.transpose() * at) +
                                 0.01 * Vector2d(random.normal(), random.normal()));
        pose.covariances_px2.push_back(1e-4 * Eigen::Matrix2d::Identity());
      }
      evaluation.poses.push_back(std::move(pose));
    }
  }

  const CameraSolverCell& cell(const CameraComparison& c, std::string_view camera,
                               std::string_view solver) {
    const auto at = std::ranges::find_if(c.cells, [&](const CameraSolverCell& candidate) {
      return candidate.camera == camera && candidate.solver->name == solver;
    });
    EXPECT_NE(at, c.cells.end());
    return *at;
  }

  RigFile rig;
  Calibration calibration;
  Evaluation evaluation;
};

TEST_F(CameraComparisonTest, ToldApartByTheLensNotByTheSolver) {
  const CameraComparison c = compare_cameras(evaluation, rig, calibration);
  ASSERT_EQ(c.cameras, (std::vector<std::string>{"pinhole", "brown", "irt"}));
  ASSERT_EQ(c.cells.size(), c.cameras.size() * c.solvers.size());
  for (const CameraSolverCell& each : c.cells) {
    EXPECT_EQ(each.poses, 200u);
    EXPECT_EQ(each.failed, 0u);
    EXPECT_LT(each.rmse_deg.interval.lower, each.rmse_deg.value);
    EXPECT_GT(each.rmse_deg.interval.upper, each.rmse_deg.value);
  }
  for (const Solver* solver : c.solvers) {
    // The distortion is in the pinhole alone.
    EXPECT_GT(cell(c, "pinhole", solver->name).rmse_deg.value,
              1.5 * cell(c, "brown", solver->name).rmse_deg.value);
    EXPECT_LT(cell(c, "brown", solver->name).from_camera_before_deg.interval.upper, 0.0);
    EXPECT_NEAR(cell(c, "irt", solver->name).rmse_deg.value,
                cell(c, "brown", solver->name).rmse_deg.value, 0.002);
  }
  // Likelihood beats POSIT where noise is all there is, and the pairs tell it.
  EXPECT_LT(cell(c, "brown", "ml_ray").from_first_solver_deg.interval.upper, 0.0);
  EXPECT_TRUE(std::isnan(cell(c, "brown", "posit").from_first_solver_deg.value));
  EXPECT_TRUE(std::isnan(cell(c, "pinhole", "ml_ray").from_camera_before_deg.value));
}

TEST_F(CameraComparisonTest, CountsWhatFailedAndGoesOnWithoutPinholes) {
  evaluation.poses[7].points_px.clear();
  evaluation.poses[7].covariances_px2.clear();
  evaluation.poses[9].points_px.assign(4, Vector2d(300, 400));
  calibration.central.clear();
  const CameraComparison c = compare_cameras(evaluation, rig, calibration);
  ASSERT_EQ(c.cameras, std::vector<std::string>{"irt"});
  for (const CameraSolverCell& each : c.cells) EXPECT_GE(each.failed, 1u);
  EXPECT_EQ(cell(c, "irt", "aopit_ray").failed, 2u);
  EXPECT_TRUE(std::isfinite(cell(c, "irt", "aopit_ray").rmse_deg.value));
}

TEST_F(CameraComparisonTest, OfARepeatWithoutItsInitialPoseEverythingFails) {
  evaluation.poses.erase(evaluation.poses.begin());
  for (const CameraSolverCell& each : compare_cameras(evaluation, rig, calibration).cells) {
    EXPECT_EQ(each.failed, 200u);
    EXPECT_TRUE(std::isnan(each.rmse_deg.value));
  }
  evaluation.poses.clear();
  for (const CameraSolverCell& each : compare_cameras(evaluation, rig, calibration).cells)
    EXPECT_EQ(each.poses, 0u);
}

}  // namespace
}  // namespace turntable
