#include "src/app/provenance.h"

#include <ceres/version.h>
#include <fmt/format.h>
#include <unistd.h>

#include <Eigen/Core>
#include <boost/version.hpp>
#include <nlohmann/json.hpp>
#include <opencv2/core/version.hpp>

#include "src/core/json_document.h"
#include "src/record/sha256.h"
#include "version.h"

namespace turntable {
namespace {

std::string dotted(int major, int minor, int patch) {
  return fmt::format("{}.{}.{}", major, minor, patch);
}

Json axis_settings(const AxisConfig& axis) {
  return {{"unit", axis.unit()},
          {"reach_lower", axis.reach_lower()},
          {"reach_upper", axis.reach_upper()},
          {"stage", axis.stage_model},
          {"controller", axis.controller},
          {"channel", axis.channel},
          {"units_per_step", axis.per_step()},
          {"lower", axis.lower},
          {"upper", axis.upper},
          {"speed", axis.speed},
          {"initial_speed", axis.initial_speed},
          {"acceleration", axis.acceleration},
          {"home_speed", axis.home_speed},
          {"backlash", axis.backlash},
          {"tolerance", axis.tolerance},
          {"settle_s", axis.settle_s},
          {"retries", axis.retries}};
}

Json camera_settings(const CameraConfig& camera) {
  const bool by_line = camera.trigger.source == TriggerConfig::Source::kLine;
  Json json{{"model", camera.model},
            {"width_px", camera.image_size.width},
            {"height_px", camera.image_size.height},
            {"pixel_format", camera.pixel_format},
            {"offset_px", camera.offset_px},
            {"trigger", by_line ? camera.trigger.line : "software"},
            {"frame_timeout_s", camera.frame_timeout_s},
            {"retries", camera.retries}};
  // Without a value the camera stays as it is set.
  if (camera.exposure_us) json["exposure_us"] = *camera.exposure_us;
  if (camera.gain) json["gain"] = *camera.gain;
  return json;
}

}  // namespace

Json program_provenance() {
  char host[256] = "unknown";
  ::gethostname(host, sizeof host - 1);
  return {
      {"program", "turntable"},
      {"version", kVersion},
      {"commit", kCommit},
      {"modified", kDirty},
      {"compiler", __VERSION__},
      {"host", host},
      {"libraries",
       {{"opencv", CV_VERSION},
        {"ceres", CERES_VERSION_STRING},
        {"eigen", dotted(EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION)},
        {"boost", dotted(BOOST_VERSION / 100000, BOOST_VERSION / 100 % 1000, BOOST_VERSION % 100)},
        {"nlohmann_json", dotted(NLOHMANN_JSON_VERSION_MAJOR, NLOHMANN_JSON_VERSION_MINOR,
                                 NLOHMANN_JSON_VERSION_PATCH)},
        {"fmt", dotted(FMT_VERSION / 10000, FMT_VERSION / 100 % 100, FMT_VERSION % 100)},
        {"aravis", kAravisVersion},
        {"libmodbus", kModbusVersion}}}};
}

std::vector<std::string> program_changes(const Json& then) {
  std::vector<std::string> changes;
  const Json now = program_provenance();
  const auto text = [](const Json& value) {
    return value.is_string() ? value.get<std::string>() : value.dump();
  };
  for (const auto& [key, value] : now.items())
    if (then.contains(key) && then.at(key) != value)
      changes.push_back(fmt::format("{} {}, now {}", key, text(then.at(key)), text(value)));
  return changes;
}

Json run_provenance(const RigFile& rig, const Plan& plan, const std::string& command,
                    const std::filesystem::path& calibration) {
  Json p = program_provenance();
  p["command"] = command;
  std::error_code removed;  // the folder may be gone: then none is said
  p["folder"] = std::filesystem::current_path(removed).string();
  p["simulated"] = rig.simulated();
  if (rig.simulated()) p["seed"] = rig.simulation->seed;
  const auto file = [](const FrozenText& frozen) {
    return Json{{"file", frozen.file}, {"sha256", frozen.sha256}};
  };
  p["rig"] = file(plan.rig);
  p["sources"] = Json::array();
  for (const FrozenText& source : plan.sources) p["sources"].push_back(file(source));
  if (!calibration.empty()) p["calibration_sha256"] = sha256_hex(read_text(calibration));
  for (const auto& [id, axis] : rig.axes) p["axes"][axis_name(id)] = axis_settings(axis);
  p["camera"] = camera_settings(rig.camera);
  return p;
}

}  // namespace turntable
