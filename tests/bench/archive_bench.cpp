// What it costs to keep an image: encoding and SHA-256 ("hashed"), and then the file on the medium
// ("synced"). Frames of 1 and 5 Mpx with read noise; `hz` and `cores_at_30hz` say whether a 30 Hz
// camera can be followed. The rows "camera" drive a whole run with a camera that waits for nobody.
// A pixel or a pose that is lost fails, time never does.
#include <benchmark/benchmark.h>
#include <sched.h>

#include <chrono>
#include <cmath>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "src/campaign/planning.h"
#include "src/campaign/runner.h"
#include "src/record/atomic_file.h"
#include "src/record/image_archive.h"
#include "src/record/sha256.h"
#include "src/vision/spots.h"
#include "tests/support/fake_rig.h"
#include "tests/support/simulated_view.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

constexpr double kCameraHz = 30.0;

enum class Scene { kPattern, kLeds };

/// The shipped rig with a lens and a sensor of so many times the pixels per side.
Image render(Scene scene, ImageSize size, double scale) {
  RigFile rig = shipped_rig("simulated");
  rig.camera.image_size = size;
  LensTruth& lens = rig.simulation->lens;
  lens.focal_px *= scale;
  lens.principal_point_px = {0.5 * size.width, 0.5 * size.height};
  SimulatedView view(rig);
  view.stand(120, 10, 5, -5);
  return view.look(scene == Scene::kLeds ? Payload::kLedTarget : Payload::kCirclePattern);
}

const Image& frame(Scene scene, int megapixels) {
  static std::map<std::pair<Scene, int>, Image> frames;
  Image& image = frames[{scene, megapixels}];
  if (image.pixels.empty())
    image = megapixels == 1 ? render(scene, {1024, 1024}, 1.0) : render(scene, {2448, 2048}, 2.0);
  return image;
}

cv::Mat as_cv(const Image& image) {
  return cv::Mat(image.height, image.width, CV_8U, const_cast<std::uint8_t*>(image.pixels.data()));
}

/// A format of OpenCV's, or the archive's own without an extension.
struct Format {
  std::string name, extension;
  std::vector<int> parameters;
};

std::string encode(const Image& image, const Format& format) {
  if (format.extension.empty()) return encode_frame(image);
  std::vector<unsigned char> bytes;
  cv::imencode(format.extension, as_cv(image), bytes, format.parameters);
  return {bytes.begin(), bytes.end()};
}

bool gives_back(std::string bytes, const Image& image) {
  const cv::Mat pixels = cv::imdecode(
      cv::Mat(1, static_cast<int>(bytes.size()), CV_8U, bytes.data()), cv::IMREAD_GRAYSCALE);
  return pixels.type() == CV_8U && pixels.cols == image.width && pixels.rows == image.height &&
         std::memcmp(pixels.data, image.pixels.data(), image.pixels.size()) == 0;
}

void report(benchmark::State& state, const std::string& bytes, const Image& image) {
  state.counters["bytes_per_px"] =
      static_cast<double>(bytes.size()) / static_cast<double>(image.pixels.size());
  // Per second of real time, as the camera counts.
  state.counters["hz"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
  state.counters["cores_at_30hz"] =
      benchmark::Counter(static_cast<double>(state.iterations()) / kCameraHz,
                         benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}

/// @param on_disk also written to a temporary file, synced and renamed
void archive(benchmark::State& state, Scene scene, int megapixels, const Format& format,
             bool on_disk) {
  const Image& image = frame(scene, megapixels);
  const TemporaryFolder folder(std::filesystem::current_path());
  std::string bytes;
  for (auto _ : state) {
    bytes = encode(image, format);
    benchmark::DoNotOptimize(sha256_hex(bytes));
    if (on_disk) StagedFile(folder / "image", bytes).commit();
  }
  report(state, bytes, image);
  if (!gives_back(bytes, image)) state.SkipWithError("pixels are lost");
}

void regions(benchmark::State& state, int megapixels, bool on_disk) {
  const Image& image = frame(Scene::kLeds, megapixels);
  const TemporaryFolder folder(std::filesystem::current_path());
  Image kept;
  std::string bytes;
  for (auto _ : state) {
    std::vector<Region> boxes;
    for (const Spot& s : find_spots(image).spots)
      boxes.push_back({s.box.left, s.box.top, s.box.right, s.box.bottom});
    kept = keep_regions(image, boxes, kRegionMarginPx);
    bytes = encode_png(kept);
    benchmark::DoNotOptimize(sha256_hex(bytes));
    if (on_disk) StagedFile(folder / "image", bytes).commit();
  }
  report(state, bytes, image);
  if (!gives_back(bytes, kept)) state.SkipWithError("pixels are lost");
}

const std::vector<Format>& formats() {
  static const std::vector<Format> all = [] {
    const int level = cv::IMWRITE_PNG_COMPRESSION, strategy = cv::IMWRITE_PNG_STRATEGY;
    const int tiff = cv::IMWRITE_TIFF_COMPRESSION;
    std::vector<Format> out{
        {"archive", "", {}},
        {"png_rle", ".png", {}},
        {"png_huffman", ".png", {strategy, cv::IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY}},
        {"png_fixed", ".png", {strategy, cv::IMWRITE_PNG_STRATEGY_FIXED}},
        {"png_default", ".png", {strategy, cv::IMWRITE_PNG_STRATEGY_DEFAULT}},
        {"png_level0", ".png", {level, 0}},  // a level brings all five filters with it
        {"png_level1", ".png", {level, 1}},
        {"png_level3", ".png", {level, 3}},
        {"tiff_none", ".tiff", {tiff, 1}},
        {"tiff_lzw", ".tiff", {tiff, 5}},
        {"tiff_packbits", ".tiff", {tiff, 32773}},
        {"tiff_deflate", ".tiff", {tiff, 8}},
        {"pgm", ".pgm", {}},
        {"bmp", ".bmp", {}},
    };
    if (cv::haveImageWriter(".webp"))
      out.push_back({"webp", ".webp", {cv::IMWRITE_WEBP_QUALITY, 101}});
    return out;
  }();
  return all;
}

/// Exposes at 30 Hz from its first trigger on; whoever asks too late has missed exposures.
class PacedCamera final : public Camera {
 public:
  PacedCamera(Clock& clock, const Image& image) : clock_(clock), image_(image) {}
  std::string identity() const override { return "30 Hz camera"; }
  ImageSize image_size() const override { return image_.size(); }
  Frame trigger() override {
    const double now = seconds(clock_.now());
    if (frames_ == 0) first_s_ = now;
    const double exposure = std::max(last_ + 1.0, std::ceil((now - first_s_) * kCameraHz));
    if (frames_ > 0) missed += static_cast<int>(exposure - last_) - 1;
    last_ = exposure;
    clock_.sleep_for(from_seconds(first_s_ + exposure / kCameraHz - now));
    return {image_, ++frames_, clock_.now()};
  }
  int missed = 0;

 private:
  Clock& clock_;
  const Image& image_;
  double first_s_ = 0.0, last_ = 0.0;
  std::uint64_t frames_ = 0;
};

constexpr int kPoses = 300;

/// Ten seconds of a target that is turned a little from frame to frame, from where homing leaves it.
Plan plan_of(const RigFile& rig) {
  Json yaw_deg = Json::array();
  for (int i = 0; i < kPoses; ++i) yaw_deg.push_back(1e-3 * i);
  const Json scenario{{"format", "turntable-scenario/1"},
                      {"name", "dwell"},
                      {"title", "Dwell"},
                      {"kind", "attitude"},
                      {"stage_mm", 0},
                      {"ranges", {{{"axis", "yaw"}, {"values_deg", yaw_deg}}}}};
  Campaign campaign;
  campaign.name = campaign.title = "archive";
  campaign.scenarios = {parse_scenario(scenario.dump(), "dwell.json")};
  return plan_campaign(campaign, rig);
}

/// On one core, this thread and all that it starts.
class OneCore {
 public:
  explicit OneCore(bool wanted) {
    sched_getaffinity(0, sizeof before_, &before_);
    if (!wanted) return;
    cpu_set_t one;
    CPU_ZERO(&one);
    for (int cpu = 0; cpu < CPU_SETSIZE && CPU_COUNT(&one) == 0; ++cpu)
      if (CPU_ISSET(cpu, &before_)) CPU_SET(cpu, &one);
    sched_setaffinity(0, sizeof one, &one);
  }
  ~OneCore() { sched_setaffinity(0, sizeof before_, &before_); }
  OneCore(const OneCore&) = delete;
  OneCore& operator=(const OneCore&) = delete;

 private:
  cpu_set_t before_;
};

void camera(benchmark::State& state, int megapixels, ArchiveMode mode, bool one_core) {
  const Image& image = frame(Scene::kLeds, megapixels);
  RigFile rig_file = shipped_rig("simulated");
  rig_file.telemetry = {};
  rig_file.camera.image_size = image.size();
  const Plan plan = plan_of(rig_file);
  const OneCore pinned(one_core);
  SystemClock clock;
  FakeAxis<Millimetres> stage("stage", clock, -1, 200);
  FakeAxis<Degrees> yaw("yaw", clock, -90, 90), roll("roll", clock, -45, 45),
      pitch("pitch", clock, -45, 45);
  PacedCamera device(clock, image);
  Rig rig;
  rig.clock = &clock;
  rig.stage = &stage;
  rig.yaw = &yaw;
  rig.roll = &roll;
  rig.pitch = &pitch;
  rig.camera = &device;
  rig.simulated = true;
  rig.mount = [](Payload) {};
  AcquireOptions options;
  options.archive = mode;

  for (auto _ : state) {
    const TemporaryFolder here(std::filesystem::current_path());
    const RunFolder folder = RunFolder::create(here / "run", plan);
    const AcquireSummary summary = acquire(rig, rig_file, plan, folder, Json::object(), options);
    state.counters["missed_exposures"] = device.missed;
    state.counters["waited_s"] = summary.waited_s;
    state.counters["archive_s"] = summary.archive_s;
    const RunRecord record = read_run(folder);
    if (!record.complete()) state.SkipWithError("poses are lost");
    if (mode == ArchiveMode::kFull)
      for (const TakenPose& pose : record.poses)
        if (load_image(folder, pose.images.at(0)).pixels != image.pixels) {
          state.SkipWithError("pixels are lost");
          break;
        }
  }
}

const int registered = [] {
  for (const int megapixels : {1, 5})
    for (const ArchiveMode mode : {ArchiveMode::kFull, ArchiveMode::kRegions})
      for (const bool one_core : {false, true})
        benchmark::RegisterBenchmark(
            ("camera/" + std::string(archive_mode_name(mode)) + "/" + std::to_string(megapixels) +
             "Mpx/" + (one_core ? "one_core" : "all_cores"))
                .c_str(),
            [=](benchmark::State& state) { camera(state, megapixels, mode, one_core); })
            ->Unit(benchmark::kSecond)
            ->UseRealTime()
            ->Iterations(1);
  for (const int megapixels : {1, 5})
    for (const bool on_disk : {false, true}) {
      const std::string end =
          "/" + std::to_string(megapixels) + "Mpx/" + (on_disk ? "synced" : "hashed");
      const auto add = [&](const std::string& name, auto work) {
        benchmark::RegisterBenchmark((name + end).c_str(), work)
            ->Unit(benchmark::kMillisecond)
            ->UseRealTime();
      };
      for (const Format& format : formats())
        for (const Scene scene : {Scene::kPattern, Scene::kLeds})
          add(format.name + (scene == Scene::kLeds ? "/leds" : "/pattern"),
              [=](benchmark::State& state) { archive(state, scene, megapixels, format, on_disk); });
      add("archive_regions/leds",
          [=](benchmark::State& state) { regions(state, megapixels, on_disk); });
    }
  return 0;
}();

}  // namespace
}  // namespace turntable
