#include "src/evaluation/rig_model.h"

#include <gtest/gtest.h>

#include "src/core/units.h"
#include "tests/support/draws.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

/// Errors of every kind, as the model names them.
RigParameters erring(const RigFile& rig) {
  RigParameters p{
      {0.4, -0.3, 0.2},    {-0.2, 0.5, 0.3}, {0.3, -0.2, 0.4}, rig.gimbal.centre_at_stage_zero_mm,
      {0.05, -0.04, 0.06}, {0.25, -0.2},     1.0005,           rig.target.points_mm};
  p.target_offset_mm += rig.target.offset_mm;
  for (std::size_t i = 1; i < p.target_points_mm.size(); ++i)
    p.target_points_mm[i] += Vector3d(0.1, -0.05, 0.08) * static_cast<double>(i);
  return p;
}

TEST(RigModel, HoldsTheTruthOfTheSimulatedRig) {
  RigFile rig = shipped_rig("ideal");
  const RigParameters p = erring(rig);
  SimulationConfig& truth = *rig.simulation;
  truth.camera_rotation_deg.setZero();
  truth.plane_from_gimbal_deg = p.plane_from_gimbal_deg;
  truth.table_from_target_deg = p.table_from_target_deg;
  truth.target_offset_error_mm = p.target_offset_mm - rig.target.offset_mm;
  truth.stage_squareness_deg = p.stage_squareness_deg;
  truth.stage_scale = p.stage_scale;
  for (std::size_t i = 0; i < p.target_points_mm.size(); ++i)
    truth.target_errors_mm[i] = p.target_points_mm[i] - rig.target.points_mm[i];
  // Yaw, roll, pitch = z, y, x: roll leans towards z, pitch towards z and y.
  truth.axis_errors_deg = {Vector3d::Zero(), Vector3d(p.axis_tilt_deg(0), 0, 0),
                           Vector3d(0, -p.axis_tilt_deg(1), p.axis_tilt_deg(2))};

  SimulatedView view(rig);
  view.world().mount(Payload::kLedTarget);
  const Matrix3d R_plane_from_camera = Vector3d(1, -1, -1).asDiagonal();
  const RigModel orthonormal(rig, false), on_stage(rig, true);
  for (const double stage : {0.0, 120.0})
    for (const Vector3d& deg : {Vector3d(0, 0, 0), Vector3d(20, -15, 10), Vector3d(-25, 5, -20)}) {
      view.stand(stage, deg.x(), deg.y(), deg.z());
      const TablePosition at{stage,
                             {rad_from_deg(deg.x()), rad_from_deg(deg.y()), rad_from_deg(deg.z())}};
      const Eigen::VectorXd values = orthonormal.values(p);
      const Eigen::VectorXd leds = orthonormal.leds(values, at),
                            sheared = on_stage.leds(values, at);
      const std::vector<sim::Disc> discs = view.world().discs();
      for (std::size_t i = 0; i < discs.size(); ++i) {
        const auto row = 3 * static_cast<Eigen::Index>(i);
        const Vector3d real = R_plane_from_camera * discs[i].centre + truth.camera_position_mm;
        EXPECT_LT((leds.segment<3>(row) - real).norm(), 2e-4) << i;
        // A circle that the rays take to be at (x', y', z') stood where the stage had carried it.
        const Vector3d named = sheared.segment<3>(row);
        const double z = p.stage_scale * named.z();
        const Vector3d carried(named.x() + std::tan(rad_from_deg(0.25)) * z,
                               named.y() + std::tan(rad_from_deg(-0.2)) * z, z);
        EXPECT_LT((carried - real).norm(), 2e-4) << i;
      }
    }
}

TEST(RigModel, StatesItsDerivatives) {
  RigFile rig = shipped_rig("ideal");
  for (const bool stage_made : {false, true}) {
    const RigModel model(rig, stage_made);
    const Eigen::VectorXd values = model.values(erring(rig));
    const TablePosition at{80.0, {0.3, -0.2, 0.4}};
    RigModel::Derivatives derivatives;
    model.leds(values, at, &derivatives);
    for (int k = 0; k < model.size(); ++k) {
      const double h = 1e-4;
      Eigen::VectorXd above = values, below = values;
      above(k) += h;
      below(k) -= h;
      const Eigen::VectorXd slope = (model.leds(above, at) - model.leds(below, at)) / (2 * h);
      EXPECT_LT((slope - derivatives.by_value.col(k)).cwiseAbs().maxCoeff(), 2e-6)
          << model.parameters()[static_cast<std::size_t>(k)].name << stage_made;
    }
    const auto moved = [&](std::size_t axis, double by) {
      TablePosition there = at;
      if (kAllAxes[axis] == AxisId::kStage)
        there.stage_mm += by;
      else
        there.angles[kAllAxes[axis]] += rad_from_deg(by);
      return model.leds(values, there);
    };
    for (std::size_t a = 0; a < kAllAxes.size(); ++a) {
      const Eigen::VectorXd slope = (moved(a, 1e-3) - moved(a, -1e-3)) / 2e-3;
      EXPECT_LT(
          (slope - derivatives.by_axis.col(static_cast<Eigen::Index>(a))).cwiseAbs().maxCoeff(),
          2e-6)
          << axis_name(kAllAxes[a]);
    }
  }
}

TEST(RigModel, NamesEveryValueAndItsPrior) {
  const RigFile rig = shipped_rig("ideal");
  const RigModel model(rig, true);
  EXPECT_EQ(model.size(), 18 + 9);
  const Eigen::VectorXd values = model.values(erring(rig));
  EXPECT_EQ(model.values(model.named(values)), values);
  EXPECT_EQ(model.parameters()[13].name, "pitch_tilt_to_yaw");
  EXPECT_EQ(model.parameters()[18].name, "target_1_x");
  EXPECT_EQ(model.parameters()[18].drawing, rig.target.points_mm[1].x());
  EXPECT_EQ(model.parameters()[18].prior.sd, 0.1);
  EXPECT_EQ(model.parameters()[18].prior.source, "default");
  EXPECT_EQ(model.drawing()(17), 1.0);
}

TEST(RigModel, GivesAGimbalWithItsAxes) {
  const RigFile rig = shipped_rig("ideal");
  const RigModel model(rig, false);
  RigParameters p = erring(rig);
  p.target_offset_mm.setZero();
  p.table_from_target_deg.setZero();
  p.stage_squareness_deg.setZero();
  const Eigen::VectorXd values = model.values(p);
  const TablePosition at{0.0, {0.3, -0.2, 0.4}};
  const Matrix3d X = rotation_from_vector(p.plane_from_gimbal_deg / kDegPerRad);
  const Matrix3d R = model.gimbal(values).rotation(at.angles);
  const Vector3d from_m0 =
      model.leds(values, at).segment<3>(3) - model.leds(values, at).segment<3>(0);
  EXPECT_LT((R * X * p.target_points_mm[1] - from_m0).norm(), 1e-9);
}

TEST(ArrivalNumbers, AreSharedUntilTheAxisMovesAgain) {
  RunRecord record;
  const auto pose = [&](Payload payload, double stage, double yaw, double pitch) {
    PlannedPose& p = record.plan.poses.emplace_back();
    p.index = record.plan.poses.size() - 1;
    p.payload = payload;
    p.stage_mm = stage;
    p.yaw_deg = yaw;
    p.pitch_deg = pitch;
    TakenPose& taken = record.poses.emplace_back();
    taken.planned = p;
  };
  pose(Payload::kCirclePattern, 100, 0, 0);
  pose(Payload::kLedTarget, 100, 0, 0);  // the stage has been at zero meanwhile
  pose(Payload::kLedTarget, 100, 0, 5);
  pose(Payload::kLedTarget, 100, 5, 5);
  pose(Payload::kLedTarget, 100, 5, 5);  // here a session begins
  pose(Payload::kLedTarget, 100, 5, 5);
  record.sessions.resize(2);
  record.sessions[0].events["primary"] = 4;
  record.sessions[1].events["primary"] = 2;
  record.poses[4].pitch.missed = true;
  // By stage, yaw, roll, pitch.
  const std::vector<ArrivalNumbers> expected{{0, 0, 0, 0}, {1, 0, 0, 0}, {1, 0, 0, 1},
                                             {1, 1, 0, 1}, {2, 2, 1, 2}, {2, 2, 1, 3}};
  EXPECT_EQ(arrival_numbers(record), expected);
}

}  // namespace
}  // namespace turntable
