#include "src/campaign/scenario.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "src/core/errors.h"

namespace turntable {
namespace {

/// Decimal angles such as 3 * 0.1 come out as written.
double tidy(double value) { return std::round(value * 1e9) / 1e9 + 0.0; }

class Reader {
 public:
  Reader(const Json& json, const std::string& name) : json_(json), name_(name) {}

  Scenario read(const std::string& text) const {
    Scenario s;
    s.file = name_;
    s.text = text;
    s.name = json_.at("name");
    s.title = json_.at("title");
    s.kind =
        json_.at("kind") == "calibration" ? ScenarioKind::kCalibration : ScenarioKind::kAttitude;
    s.dwell_s = json_.value("dwell_ms", 0.0) / 1000.0;
    s.repeats = json_.value("repeats", 1);
    check_keys(s.kind);
    if (s.kind == ScenarioKind::kAttitude)
      read_attitude(s);
    else
      read_calibration(s);
    check_size("", static_cast<double>(s.total_poses()));
    if (s.order == PoseOrder::kNearest && s.pose_count() > kMaxNearestPoses)
      fail("/order", fmt::format("found \"nearest\" for {} poses, allowed: up to {}. Choose "
                                 "\"snake\", which is nearly as fast on a grid.",
                                 s.pose_count(), kMaxNearestPoses));
    return s;
  }

 private:
  [[noreturn]] void fail(const std::string& pointer, const std::string& message) const {
    throw ConfigError(name_, pointer.empty() ? "/" : pointer, message);
  }

  /// The schema lists the keys of both kinds; each kind has its own.
  void check_keys(ScenarioKind kind) const {
    static const std::set<std::string> common{"format", "name",     "title",
                                              "kind",   "dwell_ms", "repeats"};
    static const std::set<std::string> attitude{"payload",      "table",          "stage_mm",
                                                "ranges",       "order",          "order_seed",
                                                "return_every", "images_per_pose"};
    static const std::set<std::string> calibration{"planes", "images_per_plane", "polynomial_order",
                                                   "pinhole_views", "return_to_first_plane"};
    const bool is_attitude = kind == ScenarioKind::kAttitude;
    const auto& own = is_attitude ? attitude : calibration;
    for (const auto& [key, value] : json_.items())
      if (!common.contains(key) && !own.contains(key))
        fail(
            "/" + key,
            fmt::format("belongs to {} scenarios, but this one's kind is \"{}\". Remove the key or "
                        "correct the kind.",
                        is_attitude ? "calibration" : "attitude", scenario_kind_name(kind)));
    const std::vector<std::string> required = is_attitude
                                                  ? std::vector<std::string>{"stage_mm", "ranges"}
                                                  : std::vector<std::string>{"planes"};
    for (const auto& key : required)
      if (!json_.contains(key))
        fail("", fmt::format("key \"{}\" is missing; {} scenarios need {}.", key,
                             scenario_kind_name(kind), fmt::join(required, ", ")));
  }

  void check_size(const std::string& pointer, double poses) const {
    if (!(poses <= static_cast<double>(kMaxPoses)))
      fail(pointer,
           fmt::format(
               "found {:.4g} poses, allowed: at most {}. Take a bigger step, a smaller range or "
               "fewer repeats.",
               poses, kMaxPoses));
  }

  void read_attitude(Scenario& s) const {
    if (json_.contains("table")) s.table = json_.at("table").get<int>();
    s.stage_mm = json_.at("stage_mm");
    const std::string order = json_.value("order", "as_written");
    s.order = *std::ranges::find(kPoseOrders, order, pose_order_name);
    s.order_seed = json_.value("order_seed", s.order_seed);
    if (json_.contains("order_seed") && s.order != PoseOrder::kRandom)
      fail("/order_seed", fmt::format("goes with order \"random\"; this one's is \"{}\".", order));
    s.return_every = json_.value("return_every", 0);
    s.images_per_pose = json_.value("images_per_pose", 1);
    const Json& ranges = json_.at("ranges");
    double poses = 1;
    for (std::size_t i = 0; i < ranges.size(); ++i) {
      const std::string at = fmt::format("/ranges/{}", i);
      s.ranges.push_back(range(ranges[i], at));
      const AxisId axis = s.ranges.back().axis;
      for (std::size_t j = 0; j < i; ++j)
        if (s.ranges[j].axis == axis)
          fail(at + "/axis",
               fmt::format("axis {} already has a range at /ranges/{}. Give each axis one range.",
                           axis_name(axis), j));
      poses *= static_cast<double>(s.ranges.back().values_deg.size());
    }
    check_size("/ranges", poses);  // before it can overflow what counts in whole numbers
  }

  AxisRange range(const Json& json, const std::string& at) const {
    AxisRange out{axis_from_name(json.at("axis").get<std::string>()), {}};
    const bool listed = json.contains("values_deg");
    const std::vector<std::string> limits{"start_deg", "stop_deg", "step_deg"};
    for (const auto& key : limits) {
      if (listed && json.contains(key))
        fail(
            at + "/" + key,
            "stands beside values_deg. Give either the angles themselves or start, stop and step.");
      if (!listed && !json.contains(key))
        fail(at, fmt::format(
                     "key \"{}\" is missing. Give start_deg, stop_deg and step_deg, or values_deg.",
                     key));
    }
    if (listed) {
      out.values_deg = json.at("values_deg").get<std::vector<double>>();
      return out;
    }
    const double start = json.at("start_deg"), stop = json.at("stop_deg"),
                 step = json.at("step_deg");
    if (step == 0.0)
      fail(at + "/step_deg",
           "found 0, allowed: any other angle, deg. Give the step between poses.");
    if (start == stop)
      fail(at, fmt::format(
                   "the range is empty: it starts and stops at {} deg. For a single angle write "
                   "\"values_deg\": [{}].",
                   start, start));
    if ((stop - start) * step < 0.0)
      fail(at + "/step_deg",
           fmt::format("found {} deg, which leads away from {} deg when starting at {} deg. "
                       "Change its sign.",
                       step, stop, start));
    const double steps = (stop - start) / step;
    check_size(at, steps + 1.0);
    const double whole = std::round(steps);
    if (std::abs(steps - whole) > 1e-6 || whole < 1.0)
      fail(at, fmt::format("the step of {} deg does not divide the range from {} to {} deg: the "
                           "last angle would be "
                           "{} or {} deg. Stop at one of these or change the step.",
                           step, start, stop, tidy(start + std::floor(steps) * step),
                           tidy(start + std::ceil(steps) * step)));
    for (int i = 0; i <= static_cast<int>(whole); ++i)
      out.values_deg.push_back(tidy(start + i * step));
    return out;
  }

  int polynomial_order() const {
    const auto order = json_.find("polynomial_order");
    if (order == json_.end()) return 5;
    return order->is_string() ? kOrderByResiduals : order->get<int>();
  }

  void read_calibration(Scenario& s) const {
    s.payload = Payload::kCirclePattern;
    s.images_per_plane = json_.value("images_per_plane", 1);
    s.polynomial_order = polynomial_order();
    s.return_to_first_plane = json_.value("return_to_first_plane", false);
    const Json& planes = json_.at("planes");
    int fits = 0;
    for (std::size_t i = 0; i < planes.size(); ++i) {
      const CalibrationPlane plane{planes[i].at("stage_mm"), planes[i].at("use") == "fit"};
      for (std::size_t j = 0; j < i; ++j)
        if (s.planes[j].stage_mm == plane.stage_mm)
          fail(fmt::format("/planes/{}/stage_mm", i),
               fmt::format("found {} mm, which /planes/{} has already. Planes must lie apart.",
                           plane.stage_mm, j));
      s.planes.push_back(plane);
      fits += plane.fit ? 1 : 0;
    }
    if (fits < 2)
      fail("/planes",
           fmt::format(
               "found {} plane(s) with \"use\": \"fit\", allowed: at least 2. A ray needs two "
               "points.",
               fits));
    if (json_.contains("pinhole_views"))
      for (const Json& view : json_.at("pinhole_views"))
        s.pinhole_views.push_back({view.at("stage_mm"), view.value("yaw_deg", 0.0),
                                   view.value("roll_deg", 0.0), view.value("pitch_deg", 0.0)});
  }

  const Json& json_;
  const std::string& name_;
};

}  // namespace

std::size_t Scenario::pose_count() const {
  if (kind == ScenarioKind::kCalibration)
    return planes.size() + pinhole_views.size() + (return_to_first_plane ? 1 : 0);
  std::size_t count = 1;
  for (const AxisRange& range : ranges) count *= range.values_deg.size();
  // No return behind the last one: the next repeat begins at zero anyway.
  const std::size_t returns =
      return_every > 0 ? (count - 1) / static_cast<std::size_t>(return_every) : 0;
  return 1 + count + returns;
}

std::size_t Scenario::total_poses() const {
  const std::size_t again =
      kind == ScenarioKind::kCalibration ? planes.size() : pose_count();  // views and return: once
  return pose_count() + static_cast<std::size_t>(repeats - 1) * again;
}

std::string_view pose_order_name(PoseOrder order) {
  constexpr std::array<std::string_view, 4> kNames{"as_written", "snake", "nearest", "random"};
  return kNames.at(static_cast<std::size_t>(order));
}

Scenario parse_scenario(const std::string& text, const std::string& name) {
  const Json json = parse_json(text, name, "scenario");
  return Reader(json, name).read(text);
}

Scenario load_scenario(const std::filesystem::path& file) {
  return parse_scenario(read_text(file), file.lexically_normal().string());
}

Campaign load_campaign(const std::filesystem::path& file) {
  Campaign campaign;
  campaign.file = file.lexically_normal().string();
  const std::string format = format_of(file);
  if (format == "scenario") {
    campaign.scenarios.push_back(load_scenario(file));
    campaign.name = campaign.scenarios.front().name;
    campaign.title = campaign.scenarios.front().title;
    return campaign;
  }
  campaign.text = read_text(file);
  const Json json = parse_json(campaign.text, campaign.file, "campaign");
  campaign.name = json.at("name");
  campaign.title = json.at("title");
  const Json& steps = json.at("steps");
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const std::string at = fmt::format("/steps/{}", i);
    const auto named = steps[i].at("scenario").get<std::string>();
    const std::filesystem::path path = file.parent_path() / named;
    std::error_code unreadable;  // why, is said by the reader
    const auto status = std::filesystem::status(path, unreadable);
    if (std::filesystem::status_known(status) && !std::filesystem::is_regular_file(status))
      throw ConfigError(
          campaign.file, at + "/scenario",
          fmt::format(
              "found \"{}\", but there is no file {}. Paths are relative to the campaign file.",
              named, path.lexically_normal().string()));
    if (const std::string kind = format_of(path); kind != "scenario")
      throw ConfigError(
          campaign.file, at + "/scenario",
          fmt::format("found \"{}\", which is a {} file, allowed: a scenario file.", named, kind));
    Scenario scenario = load_scenario(path);
    if (steps[i].contains("repeats")) scenario.repeats = steps[i].at("repeats");
    for (std::size_t j = 0; j < campaign.scenarios.size(); ++j)
      if (campaign.scenarios[j].name == scenario.name)
        throw ConfigError(
            campaign.file, at + "/scenario",
            fmt::format(
                "scenario name \"{}\" is already that of /steps/{}. Use \"repeats\" to run a "
                "scenario again, or give this one another name.",
                scenario.name, j));
    campaign.scenarios.push_back(std::move(scenario));
  }
  return campaign;
}

}  // namespace turntable
