// Image to attitude on one core: 1 Mpx, four LEDs, spots with their uncertainty, which spot is which
// point, maximum likelihood with its covariance. Median and 99th percentile are counters, the
// latter also without the time that others had the core. A wrong attitude fails, time never does.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <numbers>
#include <vector>

#include "src/core/units.h"
#include "src/evaluation/measure_spots.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

constexpr int kPoses = 32;
constexpr double kRightDeg = 0.03;  ///< several times what the spots' noise does

/// The ray model through the lens' own points, so that errors are those of the images.
Calibration calibration_of(SimulatedView& view) {
  const RayPlanes planes{130.0, 180.0};
  view.world().mount(Payload::kCirclePattern);
  std::vector<PlanePoint> points;
  for (const double z : {planes.a_mm, planes.b_mm}) {
    view.stand(z, 0, 0, 0);
    for (int row = -9; row <= 9; ++row)
      for (int column = -9; column <= 9; ++column) {
        const Vector2d at(20.0 * column, 20.0 * row);
        const Vector2d pixel = view.pixel_of({at.x(), at.y(), 0.0});
        if (pixel.minCoeff() >= 0.0 && pixel.maxCoeff() <= 1023.0)
          points.push_back({pixel, at, z, column, row});
      }
  }
  Calibration calibration;
  calibration.source = "lens";
  calibration.irt = fit_irt(points, planes, 5, view.rig().camera.image_size).model;
  return calibration;
}

TargetModel target_of(const RigFile& rig) {
  std::vector<Vector3d> points = rig.target.points_mm;
  for (std::size_t i = 0; i < points.size(); ++i) points[i] += rig.simulation->target_errors_mm[i];
  return TargetModel(points);
}

/// A stage that travels along the pattern's normal: what it shears is no error of the images.
RigFile square_rig() {
  RigFile rig = shipped_rig("simulated");
  rig.simulation->stage_squareness_deg.setZero();
  return rig;
}

/// The target on its way: each attitude is near the one before.
struct Scene {
  Scene()
      : view(square_rig()),
        calibration(calibration_of(view)),
        target(target_of(view.rig())),
        sensor(calibration, target, default_solver()) {
    view.stand(120, 0, 0, 0);
    const Matrix3d R_camera_from_plane = view.world().payload_pose().R_camera_from_payload;
    for (int k = 0; k < kPoses; ++k) {
      const double phase = 2.0 * std::numbers::pi * k / kPoses;
      view.stand(120, 15 * std::sin(phase), 10 * std::cos(phase), 12 * std::sin(phase + 1));
      images.push_back(view.look(Payload::kLedTarget));
      truth.push_back(R_camera_from_plane.transpose() *
                      view.world().payload_pose().R_camera_from_payload);
    }
  }

  SimulatedView view;
  Calibration calibration;
  TargetModel target;
  AttitudeSensor sensor;
  std::vector<Image> images;
  std::vector<Matrix3d> truth;
};

/// What this thread has worked: a core that others want too does not count.
double thread_ms() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

double quantile(std::vector<double> values, double share) {
  std::ranges::sort(values);
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

void image_to_attitude(benchmark::State& state, bool predict) {
  static const Scene scene;
  const double electrons = scene.view.rig().camera.electrons_per_grey;
  // The target looks the same after a third of a turn.
  const TargetSearch search{.target_uncertainty_mm = 0.01, .max_turn_rad = rad_from_deg(60)};
  MeasuredAttitude last =
      measure_spots(scene.sensor, spots_in(scene.images.back(), electrons), search).attitude;
  std::vector<double> times_ms, busy_ms;
  double worst_deg = 0.0;
  std::size_t k = 0;
  for (auto _ : state) {
    const auto start = std::chrono::steady_clock::now();
    const double busy_before = thread_ms();
    const TargetMeasurement got = measure_spots(scene.sensor, spots_in(scene.images[k], electrons),
                                                search, predict ? &last : nullptr);
    busy_ms.push_back(thread_ms() - busy_before);
    const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
    times_ms.push_back(took.count());
    if (!got.attitude.has_attitude() || got.predicted != predict ||
        !got.attitude.covariance.allFinite()) {
      state.SkipWithError(("no attitude: " + got.status).c_str());
      return;
    }
    last = got.attitude;
    worst_deg =
        std::max(worst_deg, deg_from_rad(geodesic_angle(last.R_plane_from_target, scene.truth[k])));
    k = (k + 1) % kPoses;
  }
  state.counters["median_ms"] = quantile(times_ms, 0.5);
  state.counters["p99_ms"] = quantile(times_ms, 0.99);
  state.counters["busy_p99_ms"] = quantile(busy_ms, 0.99);
  state.counters["worst_deg"] = worst_deg;
  if (!(worst_deg < kRightDeg)) state.SkipWithError("an attitude is wrong");
}

void image_to_attitude_predicted(benchmark::State& state) { image_to_attitude(state, true); }
BENCHMARK(image_to_attitude_predicted)->Unit(benchmark::kMillisecond);

void image_to_attitude_searched(benchmark::State& state) { image_to_attitude(state, false); }
BENCHMARK(image_to_attitude_searched)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace turntable
