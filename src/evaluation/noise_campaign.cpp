#include "src/evaluation/noise_campaign.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numbers>

#include "src/core/errors.h"
#include "src/core/parallel.h"
#include "src/evaluation/measure_spots.h"
#include "src/record/csv.h"
#include "src/record/number_table.h"

namespace turntable {
namespace {

constexpr int kCutoutPx = 41;  ///< an LED with its background

/// Noise in whole grey levels. Greys are whole numbers, so that rounding the sum is adding the rounded
/// noise; its distribution is a table, exact to 2^-32, and a draw costs a nanosecond.
class GreyNoise {
 public:
  explicit GreyNoise(double sigma) : reach_(static_cast<int>(std::ceil(6.5 * sigma)) + 1) {
    for (int n = -reach_; n <= reach_; ++n)
      below_.push_back(
          n == reach_
              ? std::ldexp(1.0, 32)
              : std::ldexp(0.5 * std::erfc(-(n + 0.5) / (sigma * std::numbers::sqrt2)), 32));
    std::size_t i = 0;
    for (std::size_t start = 0; start < kStarts; ++start) {
      while (std::ldexp(static_cast<double>(start), 32 - kStartBits) >= below_[i]) ++i;
      start_.push_back(static_cast<std::uint16_t>(i));
    }
  }
  /// @param bits 32 random ones
  int operator()(std::uint32_t bits) const {
    std::size_t i = start_[bits >> (32 - kStartBits)];
    while (bits >= below_[i]) ++i;
    return static_cast<int>(i) - reach_;
  }

 private:
  static constexpr int kStartBits = 12;
  static constexpr std::size_t kStarts = 1u << kStartBits;
  int reach_;
  std::vector<double> below_;         ///< 2^32 times the probability of n or less, from -reach_
  std::vector<std::uint16_t> start_;  ///< where to begin to look, by the first bits
};

/// Poses of a scenario that were taken, in the plan's order.
std::vector<const TakenPose*> taken_of(const RunRecord& record, std::size_t scenario) {
  std::vector<const TakenPose*> out;
  for (const TakenPose& pose : record.poses)
    if (pose.planned.scenario == scenario) out.push_back(&pose);
  return out;
}

bool archived(const RunRecord& record, std::size_t scenario) {
  const std::vector<const TakenPose*> taken = taken_of(record, scenario);
  return !taken.empty() && std::ranges::all_of(taken, [](const TakenPose* pose) {
    return std::ranges::none_of(pose->images,
                                [](const TakenImage& image) { return image.file.empty(); });
  });
}

std::size_t scenario_named(const Plan& plan, const std::string& name) {
  return static_cast<std::size_t>(std::ranges::find(plan.scenarios, name, &ScenarioInfo::name) -
                                  plan.scenarios.begin());
}

/// The pose that the cut-outs are of; nullptr if there is none.
const TakenPose* detail_pose(const RunRecord& record, std::size_t scenario) {
  for (const TakenPose* pose : taken_of(record, scenario))
    if (pose->planned.role == PoseRole::kMeasure && !pose->images.empty()) return pose;
  return nullptr;
}

/// Left or top of a cut-out around a coordinate that lies within `size`.
int cutout_from(double centre_px, int size) {
  return std::clamp(static_cast<int>(std::lround(centre_px)) - kCutoutPx / 2, 0,
                    std::max(0, size - kCutoutPx));
}

Image cutout(ImageView image, const Vector2d& centre_px) {
  const int left = cutout_from(centre_px.x(), image.width),
            top = cutout_from(centre_px.y(), image.height);
  const int width = std::min(kCutoutPx, image.width), height = std::min(kCutoutPx, image.height);
  Image out({width, height}, 0);
  for (int v = 0; v < height; ++v) std::copy_n(image.row(top + v) + left, width, out.row(v));
  return out;
}

/// Of all matched spots; NaN if none states an uncertainty.
double median_sigma_px(const Evaluation& evaluation) {
  std::vector<double> sigmas;
  for (const EvaluatedPose& pose : evaluation.poses)
    for (const Eigen::Matrix2d& covariance : pose.covariances_px2)
      sigmas.push_back(std::sqrt(covariance(0, 0)));
  return percentile(sigmas, 0.5);
}

/// Rms change of the matched spots' coordinates; NaN if no pose was matched in both.
double shift_px(const Evaluation& before, const Evaluation& after) {
  std::vector<double> shifts;
  for (std::size_t i = 0; i < after.poses.size(); ++i) {
    const auto &from = before.poses[i].points_px, &to = after.poses[i].points_px;
    for (std::size_t k = 0; k < std::min(from.size(), to.size()); ++k)
      for (const double d : {to[k].x() - from[k].x(), to[k].y() - from[k].y()}) shifts.push_back(d);
  }
  return root_mean_square(shifts);
}

std::optional<NoiseDetail> detail_of(const RunRecord& record, std::size_t scenario,
                                     const NoisySpots& spots, const ImageSize& size) {
  const TakenPose* pose = detail_pose(record, scenario);
  if (pose == nullptr) return {};
  const auto found = spots.images.find({pose->planned.index, 0});
  if (found == spots.images.end() || found->second.front().centres_px.empty()) return {};
  const Vector2d at = found->second.front().centres_px.front();
  NoiseDetail detail;
  detail.pose = pose->planned.index;
  detail.side = std::min({kCutoutPx, size.width, size.height});
  detail.left = cutout_from(at.x(), size.width);
  detail.top = cutout_from(at.y(), size.height);
  detail.cutouts = spots.cutouts;
  for (const SpotList& list : found->second) {
    std::optional<Vector2d>& centre = detail.centres_px.emplace_back();
    for (const Vector2d& c : list.centres_px)
      if (c.x() >= detail.left && c.x() < detail.left + detail.side && c.y() >= detail.top &&
          c.y() < detail.top + detail.side && (!centre || (c - at).norm() < (*centre - at).norm()))
        centre = c;
  }
  return detail;
}

}  // namespace

std::string noise_scenario(const RunRecord& record, const RunFolder& folder,
                           const std::string& name) {
  std::vector<std::string> choices;
  std::size_t best = record.plan.scenarios.size();
  const auto rank = [&](std::size_t s) {
    const ScenarioInfo& info = record.plan.scenarios[s];
    return std::pair(info.axes.size() == 3 && info.table == 5, info.axes.size());
  };
  for (std::size_t s = 0; s < record.plan.scenarios.size(); ++s) {
    if (record.plan.scenarios[s].kind != ScenarioKind::kAttitude || !archived(record, s)) continue;
    choices.push_back(record.plan.scenarios[s].name);
    if (best == record.plan.scenarios.size() || rank(s) > rank(best)) best = s;
  }
  if (choices.empty())
    throw ConfigError(folder.root().string(), "",
                      "has no attitude scenario whose images were archived, and noise is added to "
                      "images. Run it again with --images regions or full.");
  if (name.empty()) return record.plan.scenarios[best].name;
  if (std::ranges::find(choices, name) == choices.end())
    throw ConfigError(
        "--scenario", "",
        fmt::format("found \"{}\", allowed: {} (attitude scenarios of {} whose images "
                    "were archived).",
                    name, fmt::join(choices, ", "), folder.root().string()));
  return name;
}

Image with_noise(ImageView image, double sigma_grey, Random random) {
  const GreyNoise noise(sigma_grey);
  Image out({image.width, image.height}, 0);
  const auto grey = [](int value) { return static_cast<std::uint8_t>(std::clamp(value, 0, 255)); };
  for (int v = 0; v < image.height; ++v) {
    const std::uint8_t* from = image.row(v);
    std::uint8_t* to = out.row(v);
    for (int u = 0; u < image.width; u += 2) {  // two pixels a draw
      const std::uint64_t bits = random();
      to[u] = grey(from[u] + noise(static_cast<std::uint32_t>(bits >> 32)));
      if (u + 1 < image.width)
        to[u + 1] = grey(from[u + 1] + noise(static_cast<std::uint32_t>(bits)));
    }
  }
  return out;
}

NoisySpots find_noisy_spots(
    const RunRecord& record, const RunFolder& folder, const RigFile& rig,
    const Calibration& calibration, const NoiseOptions& options,
    const std::function<void(std::size_t done, std::size_t total)>& progress) {
  NoisySpots out;
  out.options = options;
  const std::size_t scenario = scenario_named(record.plan, options.scenario);
  struct Exposure {
    const TakenPose* pose;
    std::size_t k;
  };
  std::vector<Exposure> exposures;
  for (const TakenPose* pose : taken_of(record, scenario))
    for (std::size_t k = 0; k < pose->images.size(); ++k) exposures.push_back({pose, k});
  const TakenPose* shown = detail_pose(record, scenario);

  std::vector<std::vector<SpotList>> found(exposures.size());
  std::atomic<std::size_t> done{0};
  parallel_for(exposures.size(), [&](std::size_t i) {
    const auto& [pose, k] = exposures[i];
    const Image image = load_calibrated_image(folder, pose->images[k], calibration);
    for (std::size_t level = 0; level < out.levels(); ++level) {
      const double sigma = out.sigma_grey(level);
      const std::string stream = fmt::format("noise {} {} {}", pose->planned.id, k, sigma);
      const Image noisy =
          level == 0 ? image : with_noise(image, sigma, Random(options.seed, stream));
      found[i].push_back(spots_in(noisy, rig.camera.electrons_per_grey));
      if (pose == shown && k == 0 && !found[i].front().centres_px.empty())
        out.cutouts.push_back(cutout(noisy, found[i].front().centres_px.front()));
    }
    if (progress) progress(++done, exposures.size());
  });
  for (std::size_t i = 0; i < exposures.size(); ++i)
    out.images[{exposures[i].pose->planned.index, exposures[i].k}] = std::move(found[i]);
  return out;
}

void write_noise_spots(const NoisySpots& spots, const std::filesystem::path& file) {
  Csv csv({"sigma_grey", "index", "image", "u_px", "v_px", "sigma_px"});
  for (std::size_t level = 0; level < spots.levels(); ++level)
    for (const auto& [key, lists] : spots.images)
      for (std::size_t i = 0; i < lists[level].centres_px.size(); ++i) {
        const Vector2d& c = lists[level].centres_px[i];
        csv.text(fmt::format("{}", spots.sigma_grey(level)));
        csv.integer(static_cast<std::int64_t>(key.first));
        csv.integer(static_cast<std::int64_t>(key.second));
        for (const double x : {c.x(), c.y(), lists[level].sigmas_px[i]})
          csv.text(fmt::format("{}", x));
        csv.end_row();
      }
  csv.write(file);
}

NoisySpots read_noise_spots(const std::filesystem::path& file, const NoiseOptions& options,
                            const Plan& plan) {
  NoisySpots out;
  out.options = options;
  const NumberTable table =
      read_number_table(file, {"sigma_grey", "index", "image", "u_px", "v_px", "sigma_px"});
  const std::size_t scenario = scenario_named(plan, options.scenario);
  for (std::size_t row = 0; row < table.rows(); ++row) {
    const auto number = [&](const char* name) { return table.at(name)[row]; };
    std::size_t level = 0;
    while (level < out.levels() && out.sigma_grey(level) != number("sigma_grey")) ++level;
    const double index = number("index"), image = number("image");
    const bool whole =
        index >= 0 && index == std::floor(index) && image >= 0 && image == std::floor(image);
    if (level == out.levels() || !whole || index >= static_cast<double>(plan.poses.size()) ||
        plan.poses[static_cast<std::size_t>(index)].scenario != scenario)
      throw ConfigError(
          file.string(), fmt::format("line {}", table.lines[row]),
          fmt::format("found sigma {}, pose {}, image {}, which is none of the noise that "
                      "evaluation.json tells of (scenario {}, sigma 0, {}). Make it anew with "
                      "\"turntable evaluate --noise\".",
                      number("sigma_grey"), index, image, options.scenario,
                      fmt::join(options.sigmas_grey, ", ")));
    std::vector<SpotList>& lists =
        out.images[{static_cast<std::size_t>(index), static_cast<std::size_t>(image)}];
    lists.resize(out.levels());
    lists[level].centres_px.emplace_back(number("u_px"), number("v_px"));
    lists[level].sigmas_px.push_back(number("sigma_px"));
  }
  return out;
}

NoiseCampaign evaluate_noise(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                             const Calibration& calibration, const EvaluateOptions& how,
                             const NoisySpots& spots) {
  NoiseCampaign out;
  out.options = spots.options;
  const std::size_t scenario = scenario_named(record.plan, spots.options.scenario);
  for (std::size_t level = 0; level < spots.levels(); ++level) {
    EvaluateOptions options;
    options.solvers = how.solvers;
    options.all_solvers = how.all_solvers;
    options.scenario = scenario;
    options.spots_of = [&, level](const TakenPose& pose, std::size_t k) {
      const auto found = spots.images.find({pose.planned.index, k});
      return found == spots.images.end() ? SpotList{} : found->second[level];
    };
    Evaluation evaluation = evaluate(record, folder, rig, calibration, options);
    const double median = median_sigma_px(evaluation);
    const double shift = level == 0 ? 0.0 : shift_px(out.levels.front().evaluation, evaluation);
    out.levels.push_back({spots.sigma_grey(level), std::move(evaluation), median, shift});
  }
  out.detail = detail_of(record, scenario, spots, calibration.irt.image_size());
  return out;
}

void write_noise_poses(const NoiseCampaign& campaign, const Plan& plan,
                       const std::filesystem::path& file) {
  std::vector<EvaluationVariant> variants;
  for (const NoiseLevel& level : campaign.levels)
    variants.push_back({fmt::format("{}", level.sigma_grey), &level.evaluation});
  write_poses_csv("sigma_grey", variants, plan, file);
}

}  // namespace turntable
