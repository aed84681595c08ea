// What it costs to keep an image: encoding and SHA-256, and then the file on the medium. One core,
// frames of 1 and 5 Mpx with read noise. Rows say whether a 30 Hz camera can be followed; a format
// that does not give every pixel back fails.
#include <benchmark/benchmark.h>

#include <cstring>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <vector>

#include "src/campaign/archive_worker.h"
#include "src/record/atomic_file.h"
#include "src/record/image_archive.h"
#include "src/record/sha256.h"
#include "src/vision/spots.h"
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

const int registered = [] {
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
              [=](benchmark::State& state) {
                archive(state, scene, megapixels, format, on_disk);
              });
      add("archive_regions/leds",
          [=](benchmark::State& state) { regions(state, megapixels, on_disk); });
    }
  return 0;
}();

}  // namespace
}  // namespace turntable
