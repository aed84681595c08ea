#include "src/record/run_journal.h"

#include <nlohmann/json.hpp>

#include "src/record/pose_document.h"

namespace turntable {

RunJournal::RunJournal(const RunFolder& folder, const Json& start)
    : journal_(folder.journal()), run_(new_uid()) {
  begin(start);
}

RunJournal::RunJournal(const RunFolder& folder, const Json& start, const RunState& before)
    : journal_(folder.journal(), before.journal), run_(new_uid()) {
  if (before.sessions.empty()) {
    begin(start);
    return;
  }
  if (const RunSession& last = before.sessions.back(); last.exit_status.empty())
    journal_.append("stop", {{"uid", new_uid()},
                             {"run_start", last.uid},
                             {"time", unix_time_s()},
                             {"exit_status", "fail"},
                             {"reason", "ended without a word: killed, or the power went"},
                             {"num_events", last.events}});
  Json doc = start;
  doc["resumes"] = before.sessions.front().uid;
  begin(std::move(doc));
}

void RunJournal::begin(Json start) {
  start["uid"] = run_;
  start["time"] = unix_time_s();
  journal_.append("start", start);
  sync();
}

void RunJournal::event(const std::string& stream, const Json& data, const Json& data_keys) {
  const double now = unix_time_s();
  // Counted once it is written: after a full disk the rest has to fit what is there.
  auto it = streams_.find(stream);
  if (it == streams_.end()) {
    const std::string descriptor = new_uid();
    journal_.append("descriptor", {{"uid", descriptor},
                                   {"run_start", run_},
                                   {"time", now},
                                   {"name", stream},
                                   {"data_keys", data_keys}});
    it = streams_.emplace(stream, Stream{descriptor, 0}).first;
  }
  Json timestamps = Json::object();
  for (const auto& [key, value] : data.items()) timestamps[key] = now;
  journal_.append("event", {{"uid", new_uid()},
                            {"descriptor", it->second.descriptor},
                            {"seq_num", it->second.events + 1},
                            {"time", now},
                            {"data", data},
                            {"timestamps", timestamps}});
  ++it->second.events;
}

void RunJournal::baseline(const std::array<double, kAllAxes.size()>& positions) {
  Json data = Json::object();
  Json keys = Json::object();
  for (std::size_t i = 0; i < kAllAxes.size(); ++i) {
    const std::string axis(axis_name(kAllAxes[i]));
    const std::string key = axis + "_" + std::string(axis_unit(kAllAxes[i]));
    data[key] = positions[i];
    keys[key] = {{"source", "axis:" + axis},
                 {"dtype", "number"},
                 {"shape", Json::array()},
                 {"units", axis_unit(kAllAxes[i])}};
  }
  event("baseline", data, keys);
  sync();
}

void RunJournal::pose(const TakenPose& taken, std::string_view scenario_name, bool overlap) {
  event(overlap ? std::string(kOverlapStream) : "primary", pose_data(taken, scenario_name),
        pose_data_keys(taken));
}

void RunJournal::telemetry(const TelemetryReading& reading, const TelemetryConfig& config) {
  Json data{{"rig_time_s", reading.rig_time_s}, {"trouble", reading.trouble}};
  Json keys{
      {"rig_time_s",
       {{"source", "rig clock"}, {"dtype", "number"}, {"shape", Json::array()}, {"units", "s"}}},
      {"trouble", {{"source", "rig"}, {"dtype", "string"}, {"shape", Json::array()}}}};
  for (std::size_t i = 0; i < config.channels.size(); ++i) {
    const ChannelConfig& channel = config.channels[i];
    data[channel.name] = reading.values[i] ? Json(*reading.values[i]) : Json(nullptr);
    keys[channel.name] = {{"source", "channel:" + channel.name},
                          {"dtype", "number"},
                          {"shape", Json::array()},
                          {"units", channel.unit}};
  }
  event("telemetry", data, keys);
}

void RunJournal::time(const std::map<std::string, double>& phases_s) {
  Json keys = Json::object();
  for (const auto& [phase, s] : phases_s)
    keys[phase] = {
        {"source", "program"}, {"dtype", "number"}, {"shape", Json::array()}, {"units", "s"}};
  event("time", phases_s, keys);
  sync();
}

void RunJournal::interruption(std::string_view what, const std::string& reason) {
  const auto text = [](const char* source) {
    return Json{{"source", source}, {"dtype", "string"}, {"shape", Json::array()}};
  };
  event("interruptions", {{"interruption", what}, {"reason", reason}},
        {{"interruption", text("operator")}, {"reason", text("operator")}});
  sync();
}

void RunJournal::stop(std::string_view exit_status, const std::string& reason) {
  Json events = Json::object();
  for (const auto& [name, stream] : streams_) events[name] = stream.events;
  journal_.append("stop", {{"uid", new_uid()},
                           {"run_start", run_},
                           {"time", unix_time_s()},
                           {"exit_status", exit_status},
                           {"reason", reason},
                           {"num_events", events}});
  sync();
}

}  // namespace turntable
