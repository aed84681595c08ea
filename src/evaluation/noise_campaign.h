// What noise in the images does to the errors: the paper's simulation of 4.2.3 (figures 17 and 18).
// Zero-mean Gaussian noise of some standard deviations is added to the archived images of one
// scenario, rounded and clipped to 8 bit; spots are found anew, with the threshold from the image's
// own peak-to-peak range, and everything behind them is that of `evaluate`. The paper calls the numbers
// a variance in pixels; the call that it quotes takes a standard deviation in grey levels, and so do
// these.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "src/core/image.h"
#include "src/core/random.h"
#include "src/evaluation/evaluate.h"

namespace turntable {

struct NoiseOptions {
  std::vector<double> sigmas_grey;  ///< above 0, rising
  std::uint64_t seed = 1;
  std::string scenario;  ///< name
};

/// The scenario that noise is added to. @param name empty: the one of Table 5 that turns three axes,
/// else the one that turns most. @throws ConfigError, with those that could be named: not in the run,
/// or images that were not archived.
std::string noise_scenario(const RunRecord& record, const RunFolder& folder,
                           const std::string& name);

/// Gaussian noise of `sigma_grey` on every pixel, rounded and clipped to 8 bit.
Image with_noise(ImageView image, double sigma_grey, Random random);

/// Spots of the images with noise: all that it takes to evaluate them.
struct NoisySpots {
  NoiseOptions options;
  /// By pose (index in the plan) and exposure; then one list for 0, the image as it was archived, and
  /// one for every sigma. Images without any spot may be left out.
  std::map<std::pair<std::size_t, std::size_t>, std::vector<SpotList>> images;
  /// Cut-outs of one LED, 0 and every sigma (`NoiseDetail`); empty if the spots were read from a file.
  std::vector<Image> cutouts;

  std::size_t levels() const { return options.sigmas_grey.size() + 1; }
  double sigma_grey(std::size_t level) const {
    return level == 0 ? 0.0 : options.sigmas_grey[level - 1];
  }
};

/// Adds noise and finds spots, on all cores; every image is read once. The noise of an image follows
/// from seed, pose id, exposure and sigma alone. @param progress images
/// @throws ConfigError: images that are missing, altered or of another size than the calibration's.
NoisySpots find_noisy_spots(
    const RunRecord& record, const RunFolder& folder, const RigFile& rig,
    const Calibration& calibration, const NoiseOptions& options,
    const std::function<void(std::size_t done, std::size_t total)>& progress);

/// noise_spots.csv: one row per spot, numbers with all their digits. @throws RecordError.
void write_noise_spots(const NoisySpots& spots, const std::filesystem::path& file);
/// @throws ConfigError: missing, damaged, or not of these options and this plan.
NoisySpots read_noise_spots(const std::filesystem::path& file, const NoiseOptions& options,
                            const Plan& plan);

struct NoiseLevel {
  double sigma_grey = 0.0;
  Evaluation evaluation;  ///< of the scenario alone
  /// Stated uncertainty of the matched spots, each coordinate; NaN if none states one.
  double median_spot_sigma_px = 0.0;
  /// What the noise did to them: rms change of each coordinate against sigma 0. Noise that the image
  /// cannot show, for it is clipped at black, is not in what spots state.
  double spot_shift_px = 0.0;
};

/// One LED of one pose at every level: the brightest of the first pose that was taken.
struct NoiseDetail {
  std::size_t pose = 0;                             ///< index in the plan
  int left = 0, top = 0;                            ///< of the cut-out, px
  int side = 0;                                     ///< width and height, px
  std::vector<Image> cutouts;                       ///< by level; empty if they are not at hand
  std::vector<std::optional<Vector2d>> centres_px;  ///< spot found there, by level
};

struct NoiseCampaign {
  NoiseOptions options;
  std::vector<NoiseLevel> levels;     ///< 0 first
  std::optional<NoiseDetail> detail;  ///< nothing if no spot was ever found
};

/// @param how solvers; where spots come from is not looked at
NoiseCampaign evaluate_noise(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                             const Calibration& calibration, const EvaluateOptions& how,
                             const NoisySpots& spots);

/// noise_poses.csv: poses.csv with the sigma in front. @throws RecordError.
void write_noise_poses(const NoiseCampaign& campaign, const Plan& plan,
                       const std::filesystem::path& file);

}  // namespace turntable
