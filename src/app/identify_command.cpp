#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "src/app/commands.h"
#include "src/app/outputs.h"
#include "src/core/errors.h"
#include "src/record/atomic_file.h"
#include "src/report/level_tables.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using OrderedJson = nlohmann::ordered_json;

void require_new_file(const fs::path& file, const char* option) {
  if (file.empty()) return;
  if (!fs::is_directory(fs::absolute(file).parent_path()))
    throw ConfigError(
        option, "",
        fmt::format("found {}, allowed: a new file in a folder that is there. Make the folder "
                    "first, or name another one.",
                    file.string()));
  if (fs::exists(file))
    throw ConfigError(
        option, "",
        fmt::format("found {}, which exists, allowed: a new file. Name another one, or "
                    "move this one away.",
                    file.string()));
}

/// As a rig file's digits go.
double rounded(double value, int decimals) {
  const double unit = std::pow(10.0, decimals);
  return std::round(value * unit) / unit + 0.0;
}

OrderedJson numbers(const Vector3d& v, int decimals) {
  return {rounded(v.x(), decimals), rounded(v.y(), decimals), rounded(v.z(), decimals)};
}

/// Root mean square of the standard uncertainties of the target's coordinates, mm.
double target_uncertainty_mm(const RigModel& model, const SelfCalibration& found) {
  double sum = 0.0;
  int count = 0;
  for (int i = 0; i < model.size(); ++i)
    if (model.parameters()[static_cast<std::size_t>(i)].group == ParameterGroup::kTarget) {
      sum += found.sd(i) * found.sd(i);
      ++count;
    }
  return std::sqrt(sum / count);
}

OrderedJson origin_of(const RunFolder& folder, const RunRecord& record) {
  return {{"run", fs::absolute(folder.root()).lexically_normal().filename().string()},
          {"plan_sha256", plan_sha256(record.plan)},
          {"began_utc", record.sessions.empty() ? "" : record.sessions.front().began_utc}};
}

std::string identified(const std::string& title) {
  return title.ends_with(", identified") ? title : title + ", identified";
}

/// JSON for people: what fits a line is on one.
std::string for_people(const OrderedJson& json, std::size_t indent = 0) {
  constexpr std::size_t kLine = 110;
  if (!json.is_structured() || json.empty()) return json.dump();
  const auto joined = [&](const std::string& between, std::size_t deeper) {
    std::string out;
    for (const auto& [key, value] : json.items())
      out += (out.empty() ? "" : between) +
             (json.is_object() ? OrderedJson(key).dump() + ": " : std::string()) +
             for_people(value, deeper);
    return out;
  };
  const char open = json.is_object() ? '{' : '[', close = json.is_object() ? '}' : ']';
  const std::string flat = open + joined(", ", kLine) + close;
  if (indent >= kLine || (indent > 0 && indent + flat.size() <= kLine)) return flat;
  const std::string margin(indent + 2, ' ');
  return open + ("\n" + margin) + joined(",\n" + margin, indent + 2) + "\n" +
         std::string(indent, ' ') + close;
}

/// A path that was relative to the old file, for the new one.
void move_path(OrderedJson& object, const char* key, const fs::path& from, const fs::path& to) {
  if (!object.contains(key)) return;
  const fs::path path = object.at(key).get<std::string>();
  if (path.is_absolute()) return;
  object[key] = fs::relative(from / path, to).string();
  if (!fs::exists(from / path))
    spdlog::warn("\"{}\" in the rig file names {}, which is not there. Correct it.", key,
                 (from / path).lexically_normal().string());
}

std::string corrected_rig(const Results& made, const RigParameters& found,
                          const OrderedJson& origin, const fs::path& out) {
  OrderedJson json = OrderedJson::parse(made.rig.source);
  json["title"] = identified(made.rig.title);
  json["identified_from"] = origin;
  OrderedJson& gimbal = json["gimbal"];
  gimbal["plane_from_gimbal_deg"] = numbers(found.plane_from_gimbal_deg, 4);
  gimbal["axis_tilt_deg"] = numbers(found.axis_tilt_deg, 4);
  OrderedJson& target = json["target"];
  target["offset_mm"] = numbers(found.target_offset_mm, 4);
  target["points_mm"] = OrderedJson::array();
  for (const Vector3d& p : found.target_points_mm) target["points_mm"].push_back(numbers(p, 4));
  target["uncertainty_mm"] =
      rounded(target_uncertainty_mm(*made.levels.model, made.levels.found), 4);
  if (made.rig.simulation) {
    // The simulated rig stays where it is; only what is believed of it changes. Its gimbal centre has
    // no error of its own, and is what the file says.
    const SimulationConfig& truth = *made.rig.simulation;
    OrderedJson& simulation = json["simulation"];
    simulation["target_errors_mm"] = OrderedJson::array();
    for (std::size_t i = 0; i < truth.target_errors_mm.size(); ++i)
      simulation["target_errors_mm"].push_back(numbers(
          truth.target_errors_mm[i] + made.rig.target.points_mm[i] - found.target_points_mm[i], 4));
    simulation["target_offset_error_mm"] = numbers(
        truth.target_offset_error_mm + made.rig.target.offset_mm - found.target_offset_mm, 4);
  } else {
    gimbal["centre_at_stage_zero_mm"] = numbers(found.gimbal_centre_mm, 4);
    json["pattern"]["offset_mm"] = numbers(-found.gimbal_centre_mm, 4);
  }
  const fs::path from = fs::absolute(source_file(made.record, made.record.plan.rig.file))
                            .parent_path(),
                 to = fs::absolute(out).parent_path();
  if (json.contains("calibration"))
    for (const char* key : {"file", "sweep"}) move_path(json["calibration"], key, from, to);
  move_path(json["camera"], "folder", from, to);
  if (json.contains("telemetry"))
    for (auto& [name, channel] : json["telemetry"]["channels"].items())
      move_path(channel, "file", from, to);
  const std::string text = for_people(json) + "\n";
  (void)parse_rig_file(text, out.string(), to);  // what is written can be read
  return text;
}

std::string corrected_target(const Results& made, const RigParameters& found,
                             const OrderedJson& origin) {
  OrderedJson json{{"format", "turntable-target/1"},
                   {"title", identified("Target of " + made.rig.title)},
                   {"identified_from", origin},
                   {"points_mm", OrderedJson::array()}};
  for (const Vector3d& p : found.target_points_mm) json["points_mm"].push_back(numbers(p, 4));
  json["uncertainty_mm"] = rounded(target_uncertainty_mm(*made.levels.model, made.levels.found), 4);
  return for_people(json) + "\n";
}

}  // namespace

int identify_command(const IdentifyArguments& a) {
  const RunFolder folder = RunFolder::open(a.run);
  require_new_file(a.rig_out, "--rig-out");
  require_new_file(a.target_out, "--target-out");
  require_evaluated(folder);
  OutputOptions options;
  options.calibration = folder.calibration();
  options.evaluate.solvers = {&default_solver()};
  options.evaluate.spots = SpotSource::kJournal;
  const Results made = make_results(folder, std::move(options));
  const TruthLevels& levels = made.levels;
  if (!levels.model)
    throw ConfigError(folder.root().string(), "",
                      fmt::format("tells nothing about its rig: {}", levels.why_not));

  fmt::print("{}\n", identified_markdown(*levels.model, levels.found));
  fmt::print("{} poses, chi square per degree of freedom {:.3f}, noise factor {:.2f}{}\n",
             levels.found.poses, levels.found.chi2 / levels.found.dof, levels.found.noise_factor,
             levels.found.converged ? "" : "; NOT CONVERGED");
  for (const LevelRow& row : levels.judged.rows)
    fmt::print("{:<14} {:<18} {:<16} total RMSE {:.4f} deg on held-out poses\n",
               made.record.plan.scenarios[row.scenario].name, row.solver->name,
               truth_level_name(row.level), row.statistics.rmse_total_deg);
  if (!levels.why_not.empty()) spdlog::warn("{}", levels.why_not);
  if (levels.found.has_misfit()) spdlog::warn("{}", misfit_text(levels.found));

  const RigParameters found = levels.model->named(levels.found.values);
  const OrderedJson origin = origin_of(folder, made.record);
  if (!a.rig_out.empty()) {
    write_atomically(a.rig_out, corrected_rig(made, found, origin, a.rig_out));
    fmt::print("rig file: {}\n", a.rig_out.string());
  }
  if (!a.target_out.empty()) {
    write_atomically(a.target_out, corrected_target(made, found, origin));
    fmt::print("target file: {}\n", a.target_out.string());
  }
  return kDone;
}

}  // namespace turntable
