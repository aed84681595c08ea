#include "src/report/pose_data.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "src/core/errors.h"
#include "src/core/parallel.h"
#include "src/record/image_archive.h"
#include "src/report/drawing.h"
#include "src/report/html_report.h"

namespace turntable {
namespace {

constexpr std::size_t kWorst = 12;  ///< poses per default solver whose spots are in the page
constexpr int kCutPx = 40;          ///< side of a spot's picture

/// As few digits as tell `decimals` places; null if not finite.
Json rounded(double value, int decimals) {
  if (!std::isfinite(value)) return nullptr;
  const double scale = std::pow(10.0, decimals);
  return std::round(value * scale) / scale + 0.0;  // no negative zero
}

/// Poses of which the page has pictures.
std::set<std::size_t> pictured(const Evaluation& evaluation) {
  std::set<std::size_t> chosen;
  std::set<std::size_t> scenarios;
  for (const EvaluatedPose& pose : evaluation.poses)
    if (!pose.points_px.empty() && scenarios.insert(pose.planned.scenario).second)
      chosen.insert(pose.planned.index);
  for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
    if (!evaluation.solvers[k]->by_default) continue;
    std::vector<std::pair<double, std::size_t>>
        errors;  // largest first; of equals the earlier pose
    for (const EvaluatedPose& pose : evaluation.poses)
      if (pose.results.size() > k && pose.results[k].measured && !pose.points_px.empty())
        errors.emplace_back(-pose.results[k].error.geodesic_deg, pose.planned.index);
    const std::size_t count = std::min(kWorst, errors.size());
    std::partial_sort(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(count),
                      errors.end());
    for (std::size_t i = 0; i < count; ++i) chosen.insert(errors[i].second);
  }
  return chosen;
}

Json spot_picture(const Image& image, const std::vector<Vector2d>& spots) {
  Image strip({kCutPx * static_cast<int>(spots.size()), kCutPx}, 0);
  Json corners = Json::array();
  for (std::size_t k = 0; k < spots.size(); ++k) {
    const int left = static_cast<int>(std::lround(spots[k].x())) - kCutPx / 2;
    const int top = static_cast<int>(std::lround(spots[k].y())) - kCutPx / 2;
    corners.push_back({left, top});
    for (int v = std::max(0, -top); v < std::min(kCutPx, image.height - top); ++v)
      for (int u = std::max(0, -left); u < std::min(kCutPx, image.width - left); ++u)
        strip.row(v)[static_cast<int>(k) * kCutPx + u] = ImageView(image).row(top + v)[left + u];
  }
  return {{"src", data_uri("image/png", encode_png(strip))},
          {"side", kCutPx},
          {"corners", std::move(corners)}};
}

Json errors_json(const PoseResult& r) {
  if (!r.measured) return r.status;
  return {rounded(r.error.yaw_deg, 5), rounded(r.error.roll_deg, 5), rounded(r.error.pitch_deg, 5),
          rounded(r.error.geodesic_deg, 5)};
}

Json pose_json(const EvaluatedPose& pose, const TakenPose* taken) {
  const PlannedPose& planned = pose.planned;
  Json json{{"i", planned.index},
            {"s", planned.scenario},
            {"r", planned.repeat},
            {"p", planned.point},
            {"a",
             {rounded(pose.read_back_deg.yaw, 4), rounded(pose.read_back_deg.roll, 4),
              rounded(pose.read_back_deg.pitch, 4)}},
            {"e", Json::array()}};
  const TakenImage* image =
      taken == nullptr || taken->images.empty() ? nullptr : &taken->images.front();
  if (image != nullptr && !image->file.empty()) json["f"] = image->file;
  for (const Vector2d& p : pose.points_px)
    json["m"].push_back({rounded(p.x(), 2), rounded(p.y(), 2)});
  if (pose.points_px.empty() && image != nullptr && image->spots)
    for (const TakenSpot& s : *image->spots)
      json["q"].push_back({rounded(s.u_px, 2), rounded(s.v_px, 2)});
  if (!pose.points_px.empty() && !pose.in_domain) json["o"] = 1;
  for (const PoseResult& r : pose.results) json["e"].push_back(errors_json(r));
  return json;
}

}  // namespace

Json pose_data(const RunFolder& folder, const RunRecord& record, const Evaluation& evaluation) {
  Json data{{"solvers", Json::array()}, {"scenarios", Json::array()}, {"poses", Json::array()}};
  for (std::size_t k = 0; k < evaluation.solvers.size(); ++k)
    data["solvers"].push_back({{"name", evaluation.solvers[k]->name},
                               {"colour", solver_colour(k)},
                               {"default", evaluation.solvers[k]->by_default}});
  for (const ScenarioInfo& s : record.plan.scenarios) data["scenarios"].push_back(s.name);

  std::map<std::size_t, const TakenPose*> taken;
  for (const TakenPose& pose : record.poses) taken[pose.planned.index] = &pose;
  const std::set<std::size_t> chosen = pictured(evaluation);
  struct Picture {
    const EvaluatedPose* pose;
    const TakenImage* image;
    Json json = {};
    ImageSize size = {};
  };
  std::vector<Picture> pictures;
  for (const EvaluatedPose& pose : evaluation.poses) {
    if (!pose.taken) continue;
    const auto found = taken.find(pose.planned.index);
    const TakenPose* of = found == taken.end() ? nullptr : found->second;
    data["poses"].push_back(pose_json(pose, of));
    if (chosen.contains(pose.planned.index) && of != nullptr && !of->images.empty() &&
        !of->images.front().file.empty() &&
        std::filesystem::exists(folder.root() / of->images.front().file))
      pictures.push_back({&pose, &of->images.front()});
  }
  parallel_for(pictures.size(), [&](std::size_t i) {
    try {
      const Image image = load_image(folder, *pictures[i].image);
      pictures[i].json = spot_picture(image, pictures[i].pose->points_px);
      pictures[i].size = image.size();
    } catch (
        const ConfigError&) {  // altered or cut off: `verify` says so, and here it is not shown
    }
  });
  data["pictures"] = Json::object();
  for (Picture& p : pictures) {
    if (p.json.is_null()) continue;
    data["image"] = {p.size.width, p.size.height};
    data["pictures"][fmt::format("{}", p.pose->planned.index)] = std::move(p.json);
  }
  return data;
}

}  // namespace turntable
