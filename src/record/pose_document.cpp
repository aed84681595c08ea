#include "src/record/pose_document.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

namespace turntable {
namespace {

struct AxisKeys {
  std::string position, target, missed, retries, overshot;
};

AxisKeys keys_of(AxisId id) {
  const auto name = axis_name(id);
  const auto unit = axis_unit(id);
  return {fmt::format("{}_{}", name, unit), fmt::format("{}_target_{}", name, unit),
          fmt::format("{}_missed", name), fmt::format("{}_retries", name),
          fmt::format("{}_overshot", name)};
}

Json spots_json(const std::optional<std::vector<TakenSpot>>& spots) {
  if (!spots) return nullptr;
  Json rows = Json::array();
  for (const TakenSpot& s : *spots)
    rows.push_back({s.u_px, s.v_px, s.sigma_px, s.peak_grey, s.area_px, s.saturated});
  return rows;
}

std::optional<std::vector<TakenSpot>> spots_from(const Json& rows) {
  if (rows.is_null()) return std::nullopt;
  std::vector<TakenSpot> spots;
  for (const Json& row : rows)
    spots.push_back({row.at(0).get<double>(), row.at(1).get<double>(), row.at(2).get<double>(),
                     row.at(3).get<double>(), row.at(4).get<int>(), row.at(5).get<bool>()});
  return spots;
}

}  // namespace

Json pose_data(const TakenPose& taken, std::string_view scenario_name) {
  const PlannedPose& p = taken.planned;
  Json data{{"pose_id", p.id},
            {"pose_index", p.index},
            {"scenario", scenario_name},
            {"role", role_name(p.role)},
            {"repeat", p.repeat},
            {"point", p.point},
            {"rig_time_s", taken.rig_time_s},
            {"motion_s", taken.phases.motion_s},
            {"settle_s", taken.phases.settle_s},
            {"trigger_s", taken.phases.trigger_s},
            {"transfer_s", taken.phases.transfer_s},
            {"image_files", Json::array()},
            {"image_sha256", Json::array()},
            {"frame_ids", Json::array()},
            {"exposed_s", Json::array()},
            {"spots", Json::array()},
            {"retakes", Json::array()},
            {"complaints", Json::array()}};
  for (const AxisId id : kAllAxes) {
    const AxisKeys keys = keys_of(id);
    const AxisReadback& axis = taken.axis(id);
    data[keys.position] = axis.position;
    data[keys.target] = p.target(id);
    data[keys.missed] = axis.missed;
    data[keys.retries] = axis.retries;
    data[keys.overshot] = axis.overshot;
  }
  for (const TakenImage& image : taken.images) {
    data["image_files"].push_back(image.file);
    data["image_sha256"].push_back(image.sha256);
    data["frame_ids"].push_back(image.frame_id);
    data["exposed_s"].push_back(image.exposed_s);
    data["spots"].push_back(spots_json(image.spots));
    data["retakes"].push_back(image.retakes);
    data["complaints"].push_back(image.complaint);
  }
  return data;
}

Json pose_data_keys(const TakenPose& example) {
  Json keys = Json::object();
  const auto add = [&keys](const std::string& key, const char* source, const char* dtype,
                           std::string_view units) {
    keys[key] = {{"source", source}, {"dtype", dtype}, {"shape", Json::array()}};
    if (!units.empty()) keys[key]["units"] = units;
  };
  for (const char* key : {"pose_id", "scenario", "role"}) add(key, "plan", "string", "");
  for (const char* key : {"pose_index", "repeat", "point"}) add(key, "plan", "integer", "");
  for (const char* key : {"rig_time_s", "motion_s", "settle_s", "trigger_s", "transfer_s"})
    add(key, "rig clock", "number", "s");
  for (const AxisId id : kAllAxes) {
    const AxisKeys names = keys_of(id);
    const std::string source = fmt::format("axis:{}", axis_name(id));
    add(names.position, source.c_str(), "number", axis_unit(id));
    add(names.target, "plan", "number", axis_unit(id));
    add(names.missed, source.c_str(), "boolean", "");
    add(names.retries, source.c_str(), "integer", "");
    add(names.overshot, source.c_str(), "boolean", "");
  }
  for (const char* key : {"image_files", "image_sha256", "frame_ids", "exposed_s", "spots",
                          "retakes", "complaints"}) {
    add(key, "camera", "array", "");
    keys[key]["shape"] = {example.images.size()};
  }
  keys["exposed_s"]["units"] = "s";
  return keys;
}

TakenPose pose_from_data(const Json& data) {
  TakenPose taken;
  for (const AxisId id : kAllAxes) {
    const AxisKeys keys = keys_of(id);
    taken.axis(id) = {data.at(keys.position).get<double>(), data.at(keys.missed).get<bool>(),
                      data.at(keys.retries).get<int>(), data.at(keys.overshot).get<bool>()};
  }
  taken.rig_time_s = data.at("rig_time_s");
  taken.phases = {data.at("motion_s"), data.at("settle_s"), data.at("trigger_s"),
                  data.at("transfer_s")};
  for (std::size_t i = 0; i < data.at("frame_ids").size(); ++i)
    taken.images.push_back({data.at("image_files").at(i), data.at("image_sha256").at(i),
                            data.at("frame_ids").at(i), data.at("exposed_s").at(i),
                            spots_from(data.at("spots").at(i)), data.at("retakes").at(i),
                            data.at("complaints").at(i)});
  return taken;
}

}  // namespace turntable
