// Image points and rendering on 1 Mpx, with OpenCV's ways to the same in the same run. Times are for
// ratios within one run; a wrong result fails.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstring>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "src/core/random.h"
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

/// 15 x 15 equal dark circles, all in view, as OpenCV's search needs them.
struct GridScene {
  SimulatedView view;
  Image image;

  GridScene() : view(rig()) {
    view.stand(0, 5, 5, -5);
    image = view.look(Payload::kCirclePattern);
  }
  static RigFile rig() {
    RigFile rig = shipped_rig("simulated");
    rig.pattern.kind = PatternKind::kCircleGrid;
    rig.pattern.columns = rig.pattern.rows = 15;
    rig.pattern.origin_column = rig.pattern.origin_row = 7;
    rig.pattern.direction_circles.clear();
    rig.pattern.bright = false;
    return rig;
  }
  /// rms per coordinate of image points against the nearest true centres, px.
  double rms(const std::vector<Vector2d>& found) const {
    double sum = 0.0;
    for (const Vector2d& p : found) {
      double least = INFINITY;
      for (int row = -7; row <= 7; ++row)
        for (int column = -7; column <= 7; ++column)
          least =
              std::min(least, (p - view.pixel_of({20.0 * column, 20.0 * row, 0})).squaredNorm());
      sum += least;
    }
    return std::sqrt(sum / (2.0 * static_cast<double>(found.size())));
  }
};

GridScene& grid_scene() {
  static GridScene scene;
  return scene;
}

std::vector<Vector2d> opencv_grid(const Image& image) {
  std::vector<cv::Point2f> centres;  // the detector's default areas, 25 to 5000 px, fit the image
  if (!cv::findCirclesGrid(as_cv(image), {15, 15}, centres, cv::CALIB_CB_SYMMETRIC_GRID)) return {};
  std::vector<Vector2d> out;
  for (const cv::Point2f& p : centres) out.emplace_back(p.x, p.y);
  return out;
}

double seconds_of(auto&& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

void grid_ours(benchmark::State& state) {
  const GridScene& scene = grid_scene();
  const PatternConfig& pattern = scene.view.rig().pattern;
  PatternSearch search;
  std::vector<double> ours, theirs;
  for (auto _ : state) search = find_pattern(scene.image, pattern);
  std::vector<Vector2d> opencv;
  for (int i = 0; i < 7; ++i) {  // in turns, so that both meet the same machine
    theirs.push_back(seconds_of([&] { opencv = opencv_grid(scene.image); }));
    ours.push_back(seconds_of([&] { search = find_pattern(scene.image, pattern); }));
  }
  std::ranges::sort(ours);
  std::ranges::sort(theirs);
  std::vector<Vector2d> found;
  for (const PatternPoint& p : search.points) found.push_back(p.centre_px);
  state.counters["circles"] = static_cast<double>(found.size());
  state.counters["opencv_over_ours"] = theirs[3] / ours[3];
  state.counters["rms_px"] = scene.rms(found);
  state.counters["opencv_rms_px"] = scene.rms(opencv);
  if (found.size() != 225 || opencv.size() != 225 || !(scene.rms(found) <= scene.rms(opencv)))
    state.SkipWithError("the grid is wrong, or less exact than OpenCV's");
}
BENCHMARK(grid_ours)->Unit(benchmark::kMillisecond);

void grid_opencv(benchmark::State& state) {
  std::vector<Vector2d> found;
  for (auto _ : state) found = opencv_grid(grid_scene().image);
  if (found.size() != 225) state.SkipWithError("225 circles expected");
}
BENCHMARK(grid_opencv)->Unit(benchmark::kMillisecond);

/// A thousand round blobs between the circles.
void pattern_among_false_blobs(benchmark::State& state) {
  static const Image image = [] {
    Image cluttered = pattern_image();
    const ImageView clean = pattern_image();
    Random random(1, "bench: false blobs");
    for (int drawn = 0; drawn < 1000;) {
      const double radius = random.uniform(2.6, 6.0);
      const int reach = static_cast<int>(radius) + 5;
      const int u = static_cast<int>(random.uniform(reach, clean.width - reach)),
                v = static_cast<int>(random.uniform(reach, clean.height - reach));
      bool free = true;
      for (int dv = -reach; dv <= reach && free; ++dv)
        for (int du = -reach; du <= reach && free; ++du) free = cluttered.row(v + dv)[u + du] < 60;
      if (!free && random.uniform() < 0.999) continue;  // a few may touch
      for (int dv = -reach; dv <= reach; ++dv)
        for (int du = -reach; du <= reach; ++du) {
          const double inside = radius - std::hypot(du, dv);
          if (inside > 0)
            cluttered.row(v + dv)[u + du] =
                static_cast<std::uint8_t>(25 + 180 * std::min(1.0, inside));
        }
      ++drawn;
    }
    return cluttered;
  }();
  PatternSearch search;
  for (auto _ : state) search = find_pattern(image, view().rig().pattern);
  view().world().mount(Payload::kCirclePattern);
  int wrong = 0;
  for (const PatternPoint& c : search.points)
    if ((c.centre_px - view().pixel_of({c.on_pattern_mm.x(), c.on_pattern_mm.y(), 0})).norm() > 1)
      ++wrong;
  state.counters["candidates"] = search.candidates;
  state.counters["circles"] = static_cast<double>(search.points.size());
  state.counters["wrong"] = wrong;
  if (wrong > 0 || search.points.size() < 150) state.SkipWithError("the pattern is wrong");
}
BENCHMARK(pattern_among_false_blobs)->Unit(benchmark::kMillisecond);

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
