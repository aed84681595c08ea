// A campaign without images: a rig whose hidden errors are drawn from its tolerances, as a pinhole
// camera would see its LEDs with Gaussian noise. Everything that an evaluated run would have is there.
#pragma once

#include <cstdint>

#include "src/core/random.h"
#include "src/core/units.h"
#include "src/evaluation/self_calibration.h"

namespace turntable {

/// Tolerances of a careful workshop.
inline RigFile toleranced_rig() {
  RigFile rig = load_rig_file(std::string(TURNTABLE_SOURCE_DIR) + "/scenarios/rigs/ideal.json");
  rig.tolerances.target_mm.sd = 0.1;
  rig.tolerances.squareness_deg.sd = 0.25;
  rig.tolerances.mounting_deg.sd = 0.4;
  rig.tolerances.axes_deg.sd = 0.05;
  for (const AxisId axis : kRotaryAxes) rig.axes.at(axis).repeatability = 0.005;
  return rig;
}

struct SyntheticOptions {
  int poses_per_axis = 5;  ///< of a raster of yaw, roll and pitch, repeated at two stage positions
  bool yaw_alone = false;  ///< 25 steps of yaw instead
  bool stage_made = true;  ///< the camera's rays carry the stage's errors
  double sigma_px = 0.05;
};

struct SyntheticCampaign {
  static constexpr double kFocalPx = 1945.0, kSpanDeg = 20.0;

  RigModel model;
  Eigen::VectorXd truth;  ///< by `RigModel::parameters`
  RunRecord record;
  Calibration calibration;
  Evaluation evaluation;
  RigSightings sightings;

  SyntheticCampaign(const RigFile& rig, std::uint64_t seed, const SyntheticOptions& options)
      : model(rig, options.stage_made), truth(model.drawing()) {
    Random hidden(seed, "hidden errors");
    for (Eigen::Index i = 0; i < truth.size(); ++i)
      truth(i) += model.prior_sd()(i) * hidden.normal();
    plan_poses(options);
    look_from(options);

    ArrivalNumbers arrivals{};
    const std::vector<PlannedPose>& planned = record.plan.poses;
    for (std::size_t k = 0; k < planned.size(); ++k) {
      TablePosition real{planned[k].stage_mm, planned[k].angles()};
      for (std::size_t a = 0; a < kAllAxes.size(); ++a) {
        if (k > 0 && planned[k].target(kAllAxes[a]) != planned[k - 1].target(kAllAxes[a]))
          ++arrivals[a];
        const double error =
            model.arrival_sd()[a] *
            Random(seed, axis_name(kAllAxes[a]), static_cast<std::uint64_t>(arrivals[a])).normal();
        if (kAllAxes[a] == AxisId::kStage)
          real.stage_mm += error;
        else
          real.angles[kAllAxes[a]] += rad_from_deg(error);
      }
      EvaluatedPose& pose = evaluation.poses.emplace_back();
      pose.planned = planned[k];
      pose.taken = pose.in_domain = true;
      pose.stage_mm = planned[k].stage_mm;
      pose.read_back_deg = {planned[k].yaw_deg, planned[k].roll_deg, planned[k].pitch_deg};
      const Eigen::VectorXd leds = model.leds(truth, real);
      Random noise(seed, "spots", k);
      for (int i = 0; i < model.points(); ++i) {
        const Vector3d from_camera = leds.segment<3>(3 * i) - kCamera;
        const Vector2d seen =
            kFocalPx / -from_camera.z() * Vector2d(from_camera.x(), -from_camera.y());
        const double u = options.sigma_px * noise.normal(), v = options.sigma_px * noise.normal();
        pose.points_px.push_back(kMiddlePx + seen + Vector2d(u, v));
        pose.covariances_px2.push_back(options.sigma_px * options.sigma_px *
                                       Eigen::Matrix2d::Identity());
      }
    }
    sightings = rig_sightings(record, rig, calibration, evaluation);
  }

 private:
  inline static const Vector3d kCamera{1.4, -2.1, 700.8};
  inline static const Vector2d kMiddlePx{511.5, 511.5};

  void look_from(const SyntheticOptions& options) {
    const RayPlanes planes{130.0, 180.0};
    Eigen::MatrixX4d monomials = Eigen::MatrixX4d::Zero(3, 4);  // 1, v, u
    for (int p = 0; p < 2; ++p) {
      const double per_px = (kCamera.z() - (p == 0 ? planes.a_mm : planes.b_mm)) / kFocalPx;
      monomials.col(2 * p) << kCamera.x() - per_px * kMiddlePx.x(), 0.0, per_px;
      monomials.col(2 * p + 1) << kCamera.y() + per_px * kMiddlePx.y(), -per_px, 0.0;
    }
    calibration.irt =
        IrtModel::from_monomials({1024, 1024}, planes, 1, monomials, VDirection::kDown,
                                 {{0, 0}, {1023, 0}, {1023, 1023}, {0, 1023}});
    if (options.stage_made) calibration.stage.emplace_back();
  }

  void plan_poses(const SyntheticOptions& options) {
    ScenarioInfo& scenario = record.plan.scenarios.emplace_back();
    scenario.name = "synthetic";
    scenario.axes = {AxisId::kYaw};
    if (!options.yaw_alone) scenario.axes = {AxisId::kYaw, AxisId::kRoll, AxisId::kPitch};
    const auto add = [&](double stage, int repeat, PoseRole role, const Vector3d& deg) {
      PlannedPose& p = record.plan.poses.emplace_back();
      p.index = record.plan.poses.size() - 1;
      p.role = role;
      p.repeat = repeat;
      p.stage_mm = stage;
      p.yaw_deg = deg(0);
      p.roll_deg = deg(1);
      p.pitch_deg = deg(2);
      record.poses.emplace_back().planned = p;
    };
    const int n = options.yaw_alone ? 25 : options.poses_per_axis;
    const auto step = [&](int i) { return kSpanDeg * (2.0 * i / (n - 1) - 1.0); };
    for (int repeat = 1; repeat <= (options.yaw_alone ? 1 : 2); ++repeat) {
      const double stage = repeat == 1 ? 80.0 : 180.0;
      add(stage, repeat, PoseRole::kReference, Vector3d::Zero());
      for (int yaw = 0; yaw < n; ++yaw) {
        if (options.yaw_alone) add(stage, repeat, PoseRole::kMeasure, {step(yaw), 0, 0});
        for (int roll = 0; roll < n && !options.yaw_alone; ++roll)
          for (int pitch = 0; pitch < n; ++pitch)
            add(stage, repeat, PoseRole::kMeasure, {step(yaw), step(roll), step(pitch)});
      }
    }
  }
};

}  // namespace turntable
