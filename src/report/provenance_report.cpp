#include "src/report/provenance_report.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "src/core/json_document.h"
#include "src/evaluation/calibration_set.h"
#include "src/record/sha256.h"
#include "src/report/table.h"

namespace turntable {
namespace {

std::string row(std::string_view what, const std::string& text) {
  return fmt::format("| {} | {} |\n", what, text);
}

/// "turntable 0.1.0, commit 0123456789ab, compiler 12.2.0"
std::string program_text(const Json& p) {
  return fmt::format("{} {}, commit {}{}, compiler {}", p.value("program", "turntable"),
                     p.value("version", "?"), p.value("commit", "?"),
                     p.value("modified", false) ? " and changes to it" : "",
                     p.value("compiler", "?"));
}

/// As it was given, and the folder that its paths are relative to.
std::string command_text(const Json& p) {
  const std::string command = markdown_text("turntable " + p.value("command", "?"));
  const std::string folder = p.value("folder", "");
  return folder.empty() ? command : fmt::format("{} in {}", command, markdown_text(folder));
}

std::string libraries_text(const Json& p) {
  std::vector<std::string> names;
  const Json libraries = p.value("libraries", Json::object());
  for (const auto& [name, version] : libraries.items())
    names.push_back(fmt::format("{} {}", name, version.get<std::string>()));
  return fmt::format("{}", fmt::join(names, ", "));
}

std::string calibration_row(const Results& results) {
  if (const std::string other = other_calibration_text(results); !other.empty()) return other;
  return fmt::format("{}, SHA-256 `{}`",
                     calibrates_itself(results.record) ? "from the run's own sweep"
                                                       : "the one that the run began with",
                     sha256_hex(results.calibration_json));
}

std::string run_table(const Results& results, const Json& start, const Json& p) {
  const RunRecord& record = results.record;
  std::string md = "| what | value |\n|---|---|\n";
  md += row("plan", fmt::format("{}, {} poses, SHA-256 `{}`", record.plan.name,
                                record.plan.poses.size(), start.value("plan_sha256", "?")));
  md += row("run", start.value("uid", "?"));
  for (std::size_t s = 0; s < record.sessions.size(); ++s) {
    const RunSession& session = record.sessions[s];
    const Json of_session = Json::parse(session.start_document).value("provenance", Json::object());
    const std::string which = s == 0 ? "" : fmt::format(" (session {})", s + 1);
    md += row("began" + which, session.began_utc);
    md += row("command" + which, command_text(of_session));
    // Said again only if somebody went on with another one.
    if (s == 0 || program_text(of_session) != program_text(p))
      md += row("program" + which, program_text(of_session));
    if (s == 0 || of_session.value("host", "") != p.value("host", ""))
      md += row("computer" + which, markdown_text(of_session.value("host", "")));
    for (const std::string& change :
         of_session.value("accepted_changes", std::vector<std::string>{}))
      md += row("accepted change" + which, markdown_text(change));
  }
  md += row("libraries", libraries_text(p));
  md += row("calibration", calibration_row(results));
  if (start.value("simulated", false))
    md += row("seed of the simulation", fmt::format("{}", p.value("seed", Json()).dump()));
  for (const std::string& device : start.value("devices", std::vector<std::string>{}))
    md += row("device", markdown_text(device));
  md += row("images archived", start.value("archive", "?"));
  return md + "\n";
}

std::string axes_table(const Json& axes) {
  std::string md =
      "| axis | stage | controller | limits | step | speed, initial speed, acceleration | "
      "approached from one side by | "
      "tolerance | settles | retries |\n|---|---|---|---|---|---|---|---|--:|--:|\n";
  for (const auto& [name, axis] : axes.items()) {
    const std::string unit = axis.value("unit", "");
    const auto number = [&, &axis = axis](const char* key) { return axis.value(key, 0.0); };
    md += fmt::format(
        "| {} | {} | {} {} | {:g} to {:g} {} | {:g} {} | {:g} {}/s, {:g} {}/s, {:g} {}/s² | {:g} "
        "{} | "
        "{:g} {} | {:g} s | {} |\n",
        name, markdown_text(axis.value("stage", "")), markdown_text(axis.value("controller", "")),
        markdown_text(axis.value("channel", "")), number("lower"), number("upper"), unit,
        number("units_per_step"), unit, number("speed"), unit, number("initial_speed"), unit,
        number("acceleration"), unit, number("backlash"), unit, number("tolerance"), unit,
        number("settle_s"), axis.value("retries", 0));
  }
  return md + "\n";
}

std::string camera_text(const Json& camera) {
  std::string md =
      fmt::format("Camera: {}, {} x {} px, {}, trigger \"{}\"", camera.value("model", "?"),
                  camera.value("width_px", 0), camera.value("height_px", 0),
                  camera.value("pixel_format", "?"), camera.value("trigger", "?"));
  md += camera.contains("exposure_us")
            ? fmt::format(", exposure {:g} us", camera.at("exposure_us").get<double>())
            : ", exposure as the camera was set";
  md += camera.contains("gain") ? fmt::format(", gain {:g}", camera.at("gain").get<double>())
                                : ", gain as the camera was set";
  return md + ".\n\n";
}

std::string files_table(const Json& p) {
  std::string md = "| file | SHA-256 |\n|---|---|\n";
  const auto file = [&](const Json& frozen) {
    md += fmt::format("| {} | `{}` |\n", markdown_text(frozen.value("file", "")),
                      frozen.value("sha256", ""));
  };
  if (p.contains("rig")) file(p.at("rig"));
  for (const Json& source : p.value("sources", Json::array())) file(source);
  return md + "\n";
}

}  // namespace

std::string other_calibration_text(const Results& results) {
  const std::string given = given_calibration_sha256(results.record),
                    used = sha256_hex(results.calibration_json);
  const bool own = calibrates_itself(results.record);
  if (own ? is_of_own_sweep(results.calibration, results.record) : given.empty() || given == used)
    return {};
  return fmt::format("another one than {}: that of {}, SHA-256 `{}`",
                     own ? std::string("the run's own sweep gives")
                         : fmt::format("the run began with (SHA-256 `{}`)", given),
                     markdown_text(results.calibration.source), used);
}

std::string provenance_text(const Results& results) {
  const RunRecord& record = results.record;
  std::string md = "## Provenance\n\n";
  if (record.start_document.empty()) {
    md += "The journal has no start document.\n\n";
  } else {
    const Json start = Json::parse(record.start_document);
    const Json p = start.value("provenance", Json::object());
    md += run_table(results, start, p);
    if (p.contains("axes")) md += axes_table(p.at("axes"));
    if (p.contains("camera")) md += camera_text(p.at("camera"));
    md += files_table(p);
  }
  for (const ClockStep& step : record.clock_steps)
    md += fmt::format("- times of day are not of one clock: journal {}\n", clock_step_text(step));
  return md;
}

}  // namespace turntable
