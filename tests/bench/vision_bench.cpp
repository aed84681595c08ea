// Image points and rendering on 1 Mpx, with OpenCV's ways to the same in the same run. Times are for
// ratios within one run; a wrong result fails.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstring>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

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

/// Bright blobs of the areas that SpotOptions lets through, by the detector's own steps from
/// threshold to threshold, or at a single one as ours.
std::vector<Vector2d> opencv_blobs(const Image& image, bool single_threshold) {
  cv::SimpleBlobDetector::Params wanted;
  if (single_threshold) {
    wanted.minThreshold = 70;
    wanted.maxThreshold = 80;
    wanted.minRepeatability = 1;
  }
  wanted.filterByColor = true;
  wanted.blobColor = 255;
  wanted.minArea = 6;
  wanted.maxArea = 4000;
  wanted.filterByConvexity = wanted.filterByInertia = false;
  std::vector<cv::KeyPoint> found;
  cv::SimpleBlobDetector::create(wanted)->detect(as_cv(image), found);
  std::vector<Vector2d> out;
  for (const cv::KeyPoint& k : found) out.emplace_back(k.pt.x, k.pt.y);
  return out;
}

/// rms error per coordinate of the four LEDs' nearest centres, px; infinite unless there are four.
double rms_of_leds(const std::vector<Vector2d>& found) {
  if (found.size() != 4) return INFINITY;
  view().world().mount(Payload::kLedTarget);
  double sum = 0.0;
  for (const Vector2d& truth : view().led_pixels()) {
    double least = INFINITY;
    for (const Vector2d& p : found) least = std::min(least, (p - truth).squaredNorm());
    sum += least;
  }
  return std::sqrt(sum / 8.0);
}

double median_s(auto&& work) {
  std::array<double, 31> times;
  for (double& t : times) {
    const auto start = std::chrono::steady_clock::now();
    work();
    t = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  std::ranges::nth_element(times, times.begin() + times.size() / 2);
  return times[times.size() / 2];
}

void spots_ours(benchmark::State& state) {
  const Image& image = led_image();
  SpotSearch search;
  for (auto _ : state) search = find_spots(image);

  std::vector<std::uint8_t> copy(image.pixels.size());
  std::vector<Vector2d> blobs;
  const double ours = median_s([&] { search = find_spots(image); });
  const double look_once = median_s([&] {
    double low = 0, high = 0;
    std::memcpy(copy.data(), image.pixels.data(), copy.size());
    benchmark::ClobberMemory();
    cv::minMaxLoc(as_cv(image), &low, &high);
    benchmark::DoNotOptimize(high);
  });
  const double blobs_once = median_s([&] { opencv_blobs(image, true); });
  const double blobs_in_steps = median_s([&] { blobs = opencv_blobs(image, false); });

  std::vector<Vector2d> found;
  for (const Spot& s : search.spots) found.push_back(s.centre_px);
  const double rms = rms_of_leds(found);
  state.counters["rms_px"] = rms;
  state.counters["blobs_rms_px"] = rms_of_leds(blobs);
  state.counters["of_copy_and_minmax"] = ours / look_once;
  state.counters["blobs_over_ours"] = blobs_in_steps / ours;
  state.counters["blobs_once_over_ours"] = blobs_once / ours;
  if (!(rms < 0.02) || blobs.size() != 4) state.SkipWithError("spots are wrong");
}
BENCHMARK(spots_ours);

void spots_opencv_blobs(benchmark::State& state) {
  std::vector<Vector2d> found;
  for (auto _ : state) found = opencv_blobs(led_image(), false);
  if (found.size() != 4) state.SkipWithError("four blobs expected");
}
BENCHMARK(spots_opencv_blobs);

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
  for (const IndexedCircle& c : search.circles) {
    const Vector2d p = c.on_pattern_mm(view().rig().pattern.spacing_mm);
    sum += (c.centre_px - view().pixel_of({p.x(), p.y(), 0})).squaredNorm();
  }
  const double rms = std::sqrt(sum / (2.0 * static_cast<double>(search.circles.size())));
  state.counters["circles"] = static_cast<double>(search.circles.size());
  state.counters["rms_px"] = rms;
  if (!(rms < 0.01) || search.circles.size() < 150) state.SkipWithError("the pattern is wrong");
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
