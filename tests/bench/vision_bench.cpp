// Image points and rendering on 1 Mpx, with OpenCV's ways to the same in the same run. Times are for
// ratios within one run; a wrong result fails.
#include <benchmark/benchmark.h>

#include <cmath>
#include <cstring>
#include <opencv2/imgproc.hpp>

#include "src/vision/pattern.h"
#include "src/vision/spots.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

SimulatedView& view() {
  static SimulatedView v(shipped_rig("simulated"));
  v.stand(120, 10, 5, -5);
  return v;
}

const Image& led_image() {
  static const Image image = view().look(Payload::kLedTarget);
  return image;
}

const Image& pattern_image() {
  static const Image image = view().look(Payload::kCirclePattern);
  return image;
}

cv::Mat as_cv(const Image& image) {
  return cv::Mat(image.height, image.width, CV_8U, const_cast<std::uint8_t*>(image.pixels.data()));
}

void memcpy_floor(benchmark::State& state) {
  std::vector<std::uint8_t> copy(led_image().pixels.size());
  for (auto _ : state) {
    std::memcpy(copy.data(), led_image().pixels.data(), copy.size());
    benchmark::ClobberMemory();
  }
}
BENCHMARK(memcpy_floor);

void min_max_loc(benchmark::State& state) {
  double low = 0, high = 0;
  for (auto _ : state) cv::minMaxLoc(as_cv(led_image()), &low, &high);
  benchmark::DoNotOptimize(high);
}
BENCHMARK(min_max_loc);

void spots_ours(benchmark::State& state) {
  SpotSearch search = find_spots(led_image());
  for (auto _ : state) search = find_spots(led_image());
  view().world().mount(Payload::kLedTarget);
  double worst = search.spots.size() == 4 ? 0.0 : INFINITY;
  for (const Vector2d& truth : view().led_pixels()) {
    double nearest = INFINITY;
    for (const Spot& s : search.spots) nearest = std::min(nearest, (s.centre_px - truth).norm());
    worst = std::max(worst, nearest);
  }
  state.counters["worst_px"] = worst;
  if (!(worst < 0.05)) state.SkipWithError("spots are wrong");
}
BENCHMARK(spots_ours);

void spots_opencv_components(benchmark::State& state) {
  int found = 0;
  for (auto _ : state) {
    cv::Mat binary, labels, stats, centroids;
    cv::threshold(as_cv(led_image()), binary, 70, 255, cv::THRESH_BINARY);
    found = cv::connectedComponentsWithStats(binary, labels, stats, centroids, 8) - 1;
  }
  if (found != 4) state.SkipWithError("four components expected");
}
BENCHMARK(spots_opencv_components);

void pattern_ours(benchmark::State& state) {
  PatternSearch search =
      find_pattern(pattern_image(), view().rig().pattern);  // the image is made here
  for (auto _ : state) search = find_pattern(pattern_image(), view().rig().pattern);
  view().world().mount(Payload::kCirclePattern);
  double sum = 0.0;
  for (const PatternPoint& c : search.points) {
    const Vector2d p = c.on_pattern_mm;
    sum += (c.centre_px - view().pixel_of({p.x(), p.y(), 0})).squaredNorm();
  }
  const double rms = std::sqrt(sum / (2.0 * static_cast<double>(search.points.size())));
  state.counters["circles"] = static_cast<double>(search.points.size());
  state.counters["rms_px"] = rms;
  if (!(rms < 0.01) || search.points.size() < 150) state.SkipWithError("the pattern is wrong");
}
BENCHMARK(pattern_ours)->Unit(benchmark::kMillisecond);

void render_leds(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(view().look(Payload::kLedTarget));
}
BENCHMARK(render_leds)->Unit(benchmark::kMillisecond);

void render_pattern(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(view().look(Payload::kCirclePattern));
}
BENCHMARK(render_pattern)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace turntable
