#include "src/record/plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <unordered_map>

#include "src/core/errors.h"
#include "src/core/units.h"
#include "src/record/csv.h"
#include "src/record/sha256.h"

namespace turntable {
namespace {

constexpr std::array<std::string_view, 2> kKindNames{"calibration", "attitude"};
constexpr std::array<std::string_view, 6> kRoleNames{"reference", "measure",     "return",
                                                     "plane_fit", "plane_check", "pinhole_view"};

/// Index of a name that the schema has already checked.
template <class Enum, std::size_t N>
Enum from_name(const std::array<std::string_view, N>& names, const std::string& name) {
  return static_cast<Enum>(std::ranges::find(names, name) - names.begin());
}

/// What makes a pose itself; a thousandth of an arc second apart is apart.
std::string pose_key(const PlannedPose& pose, std::string_view scenario_name) {
  return fmt::format("{}|{}|{}|{}|{}|{}|{}|{}", scenario_name, role_name(pose.role),
                     payload_name(pose.payload), fixed(pose.stage_mm, 9), fixed(pose.yaw_deg, 9),
                     fixed(pose.roll_deg, 9), fixed(pose.pitch_deg, 9), pose.repeat);
}

std::string id_of_key(const std::string& key, int occurrence) {
  return sha256_hex(fmt::format("{}|{}", key, occurrence)).substr(0, 16);
}

/// Calls `visit(i, id)` for every pose.
template <class Visit>
void visit_expected_ids(const Plan& plan, const Visit& visit) {
  // By a hash of the key, an eighth of it: two keys in one slot are one in 10^7 plans of a million
  // poses, and would only count visits otherwise than they need be.
  std::unordered_map<std::uint64_t, int> visits;
  for (std::size_t i = 0; i < plan.poses.size(); ++i) {
    const std::string key = pose_key(plan.poses[i], plan.scenario_of(plan.poses[i]).name);
    visit(i, id_of_key(key, visits[std::hash<std::string>{}(key)]++));
  }
}

Json frozen_json(const FrozenText& frozen) {
  return {{"file", frozen.file}, {"sha256", frozen.sha256}, {"text", frozen.text}};
}

Json scenario_json(const ScenarioInfo& s) {
  Json json{{"name", s.name},       {"title", s.title},
            {"file", s.file},       {"kind", scenario_kind_name(s.kind)},
            {"repeats", s.repeats}, {"axes", Json::array()}};
  if (s.table) json["table"] = *s.table;
  if (s.kind == ScenarioKind::kCalibration) json["polynomial_order"] = s.polynomial_order;
  for (const AxisId axis : s.axes) json["axes"].push_back(axis_name(axis));
  return json;
}

Json pose_json(const PlannedPose& p) {
  return {{"id", p.id},
          {"scenario", p.scenario},
          {"role", role_name(p.role)},
          {"payload", payload_name(p.payload)},
          {"repeat", p.repeat},
          {"point", p.point},
          {"stage_mm", p.stage_mm},
          {"yaw_deg", p.yaw_deg},
          {"roll_deg", p.roll_deg},
          {"pitch_deg", p.pitch_deg},
          {"dwell_s", p.dwell_s},
          {"images", p.images}};
}

FrozenText read_frozen(const Json& json, const std::string& name, const std::string& pointer) {
  FrozenText frozen{json.at("file"), json.at("text"), json.at("sha256")};
  if (sha256_hex(frozen.text) != frozen.sha256)
    throw ConfigError(
        name, pointer + "/text",
        "the frozen copy does not match its SHA-256: the plan was edited. Make a new plan from the "
        "changed file instead.");
  return frozen;
}

ScenarioInfo read_scenario(const Json& json) {
  ScenarioInfo s;
  s.name = json.at("name");
  s.title = json.at("title");
  s.file = json.at("file");
  s.kind = from_name<ScenarioKind>(kKindNames, json.at("kind"));
  if (json.contains("table")) s.table = json.at("table").get<int>();
  s.polynomial_order = json.value("polynomial_order", s.polynomial_order);
  s.repeats = json.at("repeats");
  for (const Json& axis : json.at("axes"))
    s.axes.push_back(axis_from_name(axis.get<std::string>()));
  return s;
}

PlannedPose read_pose(const Json& json) {
  PlannedPose p;
  p.id = json.at("id");
  p.scenario = json.at("scenario");
  p.role = from_name<PoseRole>(kRoleNames, json.at("role"));
  p.payload = json.at("payload") == payload_name(Payload::kCirclePattern) ? Payload::kCirclePattern
                                                                          : Payload::kLedTarget;
  p.repeat = json.at("repeat");
  p.point = json.at("point");
  p.stage_mm = json.at("stage_mm");
  p.yaw_deg = json.at("yaw_deg");
  p.roll_deg = json.at("roll_deg");
  p.pitch_deg = json.at("pitch_deg");
  p.dwell_s = json.at("dwell_s");
  p.images = json.at("images");
  return p;
}

}  // namespace

std::string_view scenario_kind_name(ScenarioKind kind) {
  return kKindNames.at(static_cast<std::size_t>(kind));
}

std::string_view role_name(PoseRole role) { return kRoleNames.at(static_cast<std::size_t>(role)); }

double PlannedPose::target(AxisId axis) const {
  switch (axis) {
    case AxisId::kStage:
      return stage_mm;
    case AxisId::kYaw:
      return yaw_deg;
    case AxisId::kRoll:
      return roll_deg;
    case AxisId::kPitch:
      break;
  }
  return pitch_deg;
}

GimbalAngles PlannedPose::angles() const {
  return {rad_from_deg(yaw_deg), rad_from_deg(roll_deg), rad_from_deg(pitch_deg)};
}

FrozenText freeze(std::string file, std::string text) {
  std::string hash = sha256_hex(text);
  return {std::move(file), std::move(text), std::move(hash)};
}

std::string pose_id(const PlannedPose& pose, std::string_view scenario_name, int occurrence) {
  return id_of_key(pose_key(pose, scenario_name), occurrence);
}

void number_poses(Plan& plan) {
  visit_expected_ids(plan, [&](std::size_t i, std::string id) {
    plan.poses[i].index = i;
    plan.poses[i].id = std::move(id);
  });
}

void write_plan(const Plan& plan, const std::function<void(std::string_view)>& write) {
  Json head{{"format", "turntable-plan/1"}, {"name", plan.name},
            {"title", plan.title},          {"rig", frozen_json(plan.rig)},
            {"sources", Json::array()},     {"scenarios", Json::array()}};
  for (const auto& source : plan.sources) head["sources"].push_back(frozen_json(source));
  for (const auto& scenario : plan.scenarios) head["scenarios"].push_back(scenario_json(scenario));
  std::string text = head.dump(1);
  text.resize(text.size() - 2);  // "\n}": the poses follow, a line each
  write(text + ",\n \"poses\": [");
  for (std::size_t i = 0; i < plan.poses.size(); ++i)
    write((i == 0 ? "\n  " : ",\n  ") + pose_json(plan.poses[i]).dump());
  write("\n ]\n}\n");
}

std::string plan_text(const Plan& plan) {
  std::string text;
  write_plan(plan, [&](std::string_view piece) { text += piece; });
  return text;
}

std::string plan_sha256(const Plan& plan) {
  Sha256 hash;
  write_plan(plan, [&](std::string_view piece) { hash.add(piece); });
  return hash.hex();
}

Plan parse_plan(std::string_view text, const std::string& name) {
  Plan plan;
  const Json json = parse_json(text, name, "plan", "poses", [&](const Json& pose, std::size_t i) {
    plan.poses.push_back(read_pose(pose));
    plan.poses.back().index = i;
  });
  plan.name = json.at("name");
  plan.title = json.at("title");
  plan.rig = read_frozen(json.at("rig"), name, "/rig");
  for (std::size_t i = 0; i < json.at("sources").size(); ++i)
    plan.sources.push_back(read_frozen(json.at("sources")[i], name, fmt::format("/sources/{}", i)));
  for (const Json& s : json.at("scenarios")) plan.scenarios.push_back(read_scenario(s));
  for (const PlannedPose& pose : plan.poses)
    if (pose.scenario >= plan.scenarios.size())
      throw ConfigError(name, fmt::format("/poses/{}/scenario", pose.index),
                        fmt::format("found {}, allowed: below {}, the number of scenarios.",
                                    pose.scenario, plan.scenarios.size()));
  visit_expected_ids(plan, [&](std::size_t i, const std::string& id) {
    if (plan.poses[i].id != id)
      throw ConfigError(
          name, fmt::format("/poses/{}/id", i),
          fmt::format("found {}, but the pose's targets give {}: the plan was edited. Change the "
                      "scenario and make a new plan instead.",
                      plan.poses[i].id, id));
  });
  std::vector<std::string_view> ids;
  ids.reserve(plan.poses.size());
  for (const PlannedPose& pose : plan.poses) ids.push_back(pose.id);
  std::ranges::sort(ids);
  if (const auto twice = std::ranges::adjacent_find(ids); twice != ids.end())
    throw ConfigError(name, "/poses", fmt::format("the id {} is there twice.", *twice));
  return plan;
}

Plan load_plan(const std::filesystem::path& file) {
  return parse_plan(read_text(file), file.string());
}

}  // namespace turntable
