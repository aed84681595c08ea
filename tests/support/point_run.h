// A run without images: a simulated rig's sweep and raster as image points with Gaussian noise, taken
// through the true lens of its world, calibrated and evaluated as any other run.
#pragma once

#include <cmath>
#include <cstdint>

#include "src/core/random.h"
#include "src/core/units.h"
#include "src/evaluation/evaluate.h"
#include "tests/support/simulated_view.h"
#include "tests/support/temporary_folder.h"

namespace turntable {

struct PointRunOptions {
  int steps = 5;  ///< of yaw, roll and pitch each
  double span_deg = 20.0;
  std::vector<double> stages_mm{80.0, 180.0};  ///< one scenario each
  double sigma_px = 0.05;
  bool both_ways = false;  ///< each repeat forward and backward; two of them
};

struct PointRun {
  RigFile rig;
  RunRecord record;
  Calibration calibration;
  Evaluation evaluation;

  /// @param rig with its hidden errors in `rig.simulation`
  PointRun(RigFile rig_file, std::uint64_t seed, std::vector<const Solver*> solvers,
           const PointRunOptions& options = {})
      : rig(std::move(rig_file)), seed_(seed), options_(options), view_(rig) {
    sweep();
    for (const double stage : options.stages_mm) scenario(stage);
    for (std::size_t k = 0; k < record.plan.poses.size(); ++k) {
      record.plan.poses[k].index = k;
      record.plan.poses[k].id = std::to_string(k);
      take(record.plan.poses[k]);
    }
    EvaluateOptions evaluate_options;
    evaluate_options.solvers = std::move(solvers);
    evaluate_options.spots = SpotSource::kJournal;
    const TemporaryFolder folder;  // no image is looked for
    evaluation = evaluate(record, RunFolder::create(folder.path() / "run", record.plan), rig,
                          calibration, evaluate_options);
  }

 private:
  Vector2d noisy(const Vector2d& px, Random& random) const {
    return px + options_.sigma_px * Vector2d(random.normal(), random.normal());
  }

  void sweep() {
    view_.world().mount(Payload::kCirclePattern);
    std::vector<PlanePoint> points;
    const PatternConfig& p = rig.pattern;
    Random random(seed_, "sweep");
    for (const double z : {50.0, 90.0, 130.0, 180.0}) {
      view_.stand(z, 0, 0, 0);
      for (int row = 0; row < p.rows; ++row)
        for (int column = 0; column < p.columns; ++column) {
          const Vector2d at((column - p.origin_column) * p.spacing_mm,
                            (row - p.origin_row) * p.spacing_mm);
          const Vector2d px = noisy(view_.pixel_of({at.x(), at.y(), 0.0}), random);
          if (px.minCoeff() < 0 || px.x() > rig.camera.image_size.width ||
              px.y() > rig.camera.image_size.height)
            continue;
          points.push_back({px, at, z, column, row, options_.sigma_px});
        }
    }
    calibration.set_irt(fit_irt(points, {130.0, 180.0}, 5, rig.camera.image_size), points);
    calibration.source = "sweep of a simulated stage";
    calibration.stage.push_back({130.0, 130.0, 1});  // a stage has made it
  }

  void scenario(double stage) {
    ScenarioInfo info;
    info.name = "raster_" + std::to_string(static_cast<int>(stage));
    info.axes = {AxisId::kYaw, AxisId::kRoll, AxisId::kPitch};
    record.plan.scenarios.push_back(info);
    const int repeats = options_.both_ways ? 2 : 1;
    for (int repeat = 1; repeat <= repeats; ++repeat) {
      PlannedPose pose;
      pose.scenario = record.plan.scenarios.size() - 1;
      pose.repeat = repeat;
      pose.stage_mm = stage;
      pose.role = PoseRole::kReference;
      record.plan.poses.push_back(pose);
      pose.role = PoseRole::kMeasure;
      const int n = options_.steps;
      for (int k = 0; k < n * n * n; ++k) {
        const int i = repeat == 1 ? k : n * n * n - 1 - k;
        const auto angle = [&](int step) {
          return options_.span_deg * (2.0 * step / (n - 1) - 1.0);
        };
        pose.yaw_deg = angle(i / (n * n));
        pose.roll_deg = angle(i / n % n);
        pose.pitch_deg = angle(i % n);
        pose.point = k + 1;
        record.plan.poses.push_back(pose);
      }
    }
  }

  /// Where the axes really arrive: with half the repeatability as standard deviation, and behind by
  /// half the lost motion.
  void take(const PlannedPose& pose) {
    view_.world().mount(Payload::kLedTarget);
    std::array<double, kAllAxes.size()> real{};
    for (std::size_t a = 0; a < kAllAxes.size(); ++a) {
      const double target = pose.target(kAllAxes[a]);
      if (record.poses.empty() || target != last_[a]) {
        if (!record.poses.empty()) direction_[a] = target > last_[a] ? 1.0 : -1.0;
        ++arrivals_[a];
      }
      last_[a] = target;
      const AxisTruth& truth = rig.simulation->axes.at(kAllAxes[a]);
      real[a] =
          target +
          0.5 * truth.repeatability * Random(seed_, axis_name(kAllAxes[a]), arrivals_[a]).normal() -
          0.5 * truth.backlash * direction_[a];
    }
    view_.stand(real[0], real[1], real[2], real[3]);
    TakenPose taken;
    taken.planned = pose;
    for (const AxisId axis : kAllAxes) taken.axis(axis).position = pose.target(axis);
    TakenImage image;
    image.spots.emplace();
    Random random(seed_, "spots", pose.index);
    for (const Vector2d& led : view_.led_pixels()) {
      const Vector2d px = noisy(led, random);
      image.spots->push_back({px.x(), px.y(), options_.sigma_px, 200.0, 10, false});
    }
    taken.images.push_back(std::move(image));
    record.poses.push_back(std::move(taken));
  }

  std::uint64_t seed_;
  PointRunOptions options_;
  SimulatedView view_;
  std::array<double, kAllAxes.size()> last_{}, direction_{};
  std::array<std::uint64_t, kAllAxes.size()> arrivals_{};
};

}  // namespace turntable
