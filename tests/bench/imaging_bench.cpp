// The ray model: two planes x 225 points, order 5. Times are for ratios within one run; a wrong result
// fails.
#include <benchmark/benchmark.h>

#include <cmath>

#include "src/core/random.h"
#include "src/imaging/order_choice.h"

namespace turntable {
namespace {

constexpr ImageSize kSize{1024, 1024};
constexpr RayPlanes kPlanes{130, 180};
constexpr double kNoise = 0.02;

/// A pinhole with radial distortion over 15 x 15 pixels of each plane.
std::vector<PlanePoint> points(bool stated) {
  Random random(1, "imaging_bench");
  std::vector<PlanePoint> out;
  for (const double z : {kPlanes.a_mm, kPlanes.b_mm})
    for (int row = -7; row <= 7; ++row)
      for (int column = -7; column <= 7; ++column) {
        PlanePoint p;
        const Vector2d from_middle = 70.0 * Vector2d(column, row);
        const double bend = 1.0 + 0.05 * from_middle.squaredNorm() / (1945.0 * 1945.0);
        p.on_plane_mm = bend * (700.0 - z) / 1945.0 * Vector2d(from_middle.x(), -from_middle.y());
        p.pixel_px = from_middle + Vector2d(511.5, 511.5) +
                     kNoise * Vector2d(random.normal(), random.normal());
        p.z_mm = z;
        p.column = column;
        p.row = row;
        p.sigma_px = stated ? kNoise : 0.0;
        out.push_back(p);
      }
  return out;
}

const IrtModel& model() {
  static const IrtModel m = fit_irt(points(true), kPlanes, 5, kSize).model;
  return m;
}

void fit_with_statistics(benchmark::State& state) {
  const auto p = points(state.range(0) != 0);
  IrtFit fit;
  for (auto _ : state) fit = fit_irt(p, kPlanes, 5, kSize);
  state.counters["sigma_px"] = fit.sigma_mm * 1945.0 / 545.0;
  state.counters["loo_over_rms"] = fit.loo_rms_mm / fit.rms_mm;
  if (!(std::abs(fit.sigma_mm * 1945.0 / 545.0 / kNoise - 1.0) < 0.1) || !fit.outliers.empty())
    state.SkipWithError("the fit is wrong");
}
BENCHMARK(fit_with_statistics)->ArgName("stated")->Arg(0)->Arg(1)->Unit(benchmark::kMillisecond);

void fit_with_ten_outliers(benchmark::State& state) {
  auto p = points(true);
  for (std::size_t i = 0; i < 10; ++i) p[20 + 41 * i].pixel_px.x() += 2.0;
  IrtFit fit;
  for (auto _ : state) fit = fit_irt(p, kPlanes, 5, kSize);
  if (fit.outliers.size() != 10) state.SkipWithError("ten outliers expected");
}
BENCHMARK(fit_with_ten_outliers)->Unit(benchmark::kMillisecond);

void compare_all_orders(benchmark::State& state) {
  const auto p = points(true);
  int order = 0;
  for (auto _ : state) order = choose_order(compare_orders(p, {}, kPlanes, kSize));
  state.counters["order"] = order;
  if (order != 3) state.SkipWithError("the lens is of order 3");
}
BENCHMARK(compare_all_orders)->Unit(benchmark::kMillisecond);

void rays_1000(benchmark::State& state) {
  Vector2d sum = Vector2d::Zero();
  for (auto _ : state) {
    sum.setZero();
    for (int i = 0; i < 1000; ++i) sum += model().ray({i + 12.0, 1011.0 - i}).at_a;
    benchmark::DoNotOptimize(sum);
  }
  if (!(sum.norm() / 1000.0 < 0.5))
    state.SkipWithError("rays are wrong");  // the diagonal is balanced
}
BENCHMARK(rays_1000)->Unit(benchmark::kMicrosecond);

void sigma_map_64(benchmark::State& state) {
  std::vector<MapPoint> map;
  for (auto _ : state) map = sigma_map(model(), 0.0, 64);
  double least = INFINITY;
  for (const MapPoint& p : map) least = std::min(least, p.value);
  if (!(least > 0.0 && least < kNoise)) state.SkipWithError("the map is wrong");
}
BENCHMARK(sigma_map_64)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace turntable
