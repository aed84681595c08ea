// A campaign without images: a rig whose hidden errors are drawn from its tolerances, as a pinhole
// camera would see its LEDs with Gaussian noise.
#pragma once

#include <cmath>
#include <cstdint>

#include "src/core/random.h"
#include "src/core/units.h"
#include "src/evaluation/self_calibration.h"

namespace turntable {

struct SyntheticOptions {
  int poses_per_axis = 5;  ///< of a raster of yaw, roll and pitch, repeated at two stage positions
  bool yaw_alone = false;  ///< 25 steps of yaw instead
  double sigma_px = 0.05;
};

struct SyntheticCampaign {
  static constexpr double kFocalPx = 1945.0;
  static constexpr double kSpanDeg = 20.0;

  Eigen::VectorXd truth;  ///< by `RigModel::parameters`
  RigSightings sightings;
  std::vector<PlannedPose> planned;  ///< of each sighting; a reference pose begins each repeat

  SyntheticCampaign(const RigModel& model, std::uint64_t seed, const SyntheticOptions& options) {
    truth = model.drawing();
    Random hidden(seed, "hidden errors");
    for (Eigen::Index i = 0; i < truth.size(); ++i)
      truth(i) += model.prior_sd()(i) * hidden.normal();
    sightings.planes = {130.0, 180.0};
    plan_poses(options);

    const Vector3d camera(1.4, -2.1, 700.8);
    ArrivalNumbers arrivals{};
    for (std::size_t k = 0; k < planned.size(); ++k) {
      TablePosition stated{planned[k].stage_mm, planned[k].angles()}, real = stated;
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
      RigSighting& sighting = sightings.poses.emplace_back();
      sightings.places.push_back(k);
      sighting.at = stated;
      sighting.arrivals = arrivals;
      const Eigen::VectorXd leds = model.leds(truth, real);
      Random noise(seed, "spots", k);
      for (int i = 0; i < model.points(); ++i) {
        const Vector3d down = leds.segment<3>(3 * i) - camera;
        Vector2d slope = down.head<2>() / down.z();
        for (int c = 0; c < 2; ++c) slope(c) += options.sigma_px / kFocalPx * noise.normal();
        const auto on = [&](double z) -> Vector2d {
          return camera.head<2>() + slope * (z - camera.z());
        };
        const auto spread = [&](double z) -> Eigen::Matrix2d {
          return (z - camera.z()) * options.sigma_px / kFocalPx * Eigen::Matrix2d::Identity();
        };
        sighting.rays.push_back({on(sightings.planes.a_mm), on(sightings.planes.b_mm)});
        sighting.spreads.push_back({spread(sightings.planes.a_mm), spread(sightings.planes.b_mm)});
      }
    }
  }

 private:
  void plan_poses(const SyntheticOptions& options) {
    const auto add = [&](double stage, int repeat, PoseRole role, double yaw, double roll,
                         double pitch) {
      PlannedPose& p = planned.emplace_back();
      p.index = planned.size() - 1;
      p.role = role;
      p.repeat = repeat;
      p.stage_mm = stage;
      p.yaw_deg = yaw;
      p.roll_deg = roll;
      p.pitch_deg = pitch;
    };
    const int n = options.yaw_alone ? 25 : options.poses_per_axis;
    const auto step = [&](int i) { return kSpanDeg * (2.0 * i / (n - 1) - 1.0); };
    if (options.yaw_alone) {
      add(120, 1, PoseRole::kReference, 0, 0, 0);
      for (int i = 0; i < n; ++i) add(120, 1, PoseRole::kMeasure, step(i), 0, 0);
      return;
    }
    for (const int repeat : {1, 2}) {
      const double stage = repeat == 1 ? 80.0 : 180.0;
      add(stage, repeat, PoseRole::kReference, 0, 0, 0);
      for (int y = 0; y < n; ++y)
        for (int r = 0; r < n; ++r)
          for (int p = 0; p < n; ++p)
            add(stage, repeat, PoseRole::kMeasure, step(y), step(r), step(p));
    }
  }
};

}  // namespace turntable
