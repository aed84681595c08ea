#include "src/record/run_folder.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>
#include <unordered_map>

#include "src/core/clock.h"
#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/rig_file.h"
#include "src/core/units.h"
#include "src/record/atomic_file.h"
#include "src/record/folder.h"
#include "src/record/image_archive.h"
#include "src/record/journal.h"
#include "src/record/pose_document.h"
#include "src/record/run_journal.h"
#include "src/record/sha256.h"

namespace turntable {
namespace {

/// What `create` leaves when it is killed, before there is a plan.
bool left_by_create(const RunFolder& folder, const std::filesystem::path& entry) {
  std::error_code error;
  if (entry == folder.images() || entry == folder.tables() || entry == folder.figures())
    return std::filesystem::is_directory(entry, error) && std::filesystem::is_empty(entry, error);
  const auto is_part_of = [](const std::filesystem::path& file, const std::filesystem::path& of) {
    return is_temporary(file) && file.stem() == of.filename();
  };
  if (entry ==
      folder.calibration())  // a file of somebody's own but for the plan that is not there yet
    for (std::filesystem::directory_iterator it(folder.root(), error), end; !error && it != end;
         it.increment(error))
      if (is_part_of(it->path(), folder.plan())) return true;
  return is_part_of(entry, folder.plan()) || is_part_of(entry, folder.calibration());
}

}  // namespace

void RunFolder::require_new(const std::filesystem::path& root) {
  std::error_code error;
  const auto status = std::filesystem::status(root, error);
  if (std::filesystem::exists(status)) {
    if (!std::filesystem::is_directory(status))
      throw ConfigError(root.string(), "", "is a file. Choose a new folder for the run.");
    for (const auto& entry : std::filesystem::directory_iterator(root, error))
      if (!left_by_create(RunFolder(root), entry.path()))
        throw ConfigError(
            root.string(), "",
            "is not empty: a run is never written over another one. Choose a new folder.");
    if (error)
      throw ConfigError(root.string(), "",
                        fmt::format("cannot be read: {}. Choose a new folder.", error.message()));
  }
  require_writable(root, "the run", "--out");
}

RunFolder RunFolder::create(const std::filesystem::path& root, const Plan& plan,
                            const std::string& calibration) {
  require_new(root);
  std::error_code error;
  RunFolder folder(root);
  std::filesystem::remove(folder.calibration(), error);
  remove_temporaries(root);
  const auto parts = {folder.images(), folder.tables(), folder.figures()};
  try {
    for (const auto& path : parts) make_folder(path);
    // The plan's name comes last: with it the folder is a run that can be resumed, and nothing may be missing then.
    StagedFile frozen(folder.plan(), [&](const ByteSink& sink) { write_plan(plan, sink); });
    if (!calibration.empty()) StagedFile(folder.calibration(), calibration).commit();
    frozen.commit();
    sync_folder(root);
  } catch (const RecordError&) {
    // Empty as it was, so that it can be tried again once there is room.
    std::filesystem::remove(folder.plan(), error);
    std::filesystem::remove(folder.calibration(), error);
    for (const auto& path : parts) std::filesystem::remove(path, error);
    throw;
  }
  sync_folder(std::filesystem::absolute(root).parent_path());
  return folder;
}

void RunFolder::remove_temporary_files() const {
  for (const auto& part : {root_, images(), outputs_, tables(), figures()})
    remove_temporaries(part);
}

RunFolder RunFolder::open(const std::filesystem::path& root) {
  RunFolder folder(root);
  std::error_code error;
  if (!std::filesystem::is_regular_file(folder.plan(), error))
    throw ConfigError(root.string(), "",
                      "is no run folder: it holds no plan.json. Name the folder that `run` made.");
  return folder;
}

std::filesystem::path RunFolder::default_root(const std::string& name) {
  return std::filesystem::path("results") / "runs" / (utc_now_compact() + "-" + name);
}

RunFolder RunFolder::with_outputs_in(std::filesystem::path outputs) const {
  RunFolder folder = *this;
  folder.outputs_ = std::move(outputs);
  return folder;
}

AxisReadback& TakenPose::axis(AxisId id) {
  switch (id) {
    case AxisId::kStage:
      return stage;
    case AxisId::kYaw:
      return yaw;
    case AxisId::kRoll:
      return roll;
    case AxisId::kPitch:
      break;
  }
  return pitch;
}

const AxisReadback& TakenPose::axis(AxisId id) const {
  return const_cast<TakenPose&>(*this).axis(id);
}

GimbalAngles TakenPose::angles() const {
  return {rad_from_deg(yaw.position), rad_from_deg(roll.position), rad_from_deg(pitch.position)};
}

std::size_t RunState::poses_taken() const {
  return line_of_pose.size() -
         static_cast<std::size_t>(std::ranges::count(line_of_pose, std::uint64_t{0}));
}

namespace {

/// Compares both clocks from line to line.
class ClockWatch {
 public:
  std::optional<ClockStep> step(const JournalEntry& entry) {
    constexpr double kTolerance_s = 5.0;  // far beyond what a clock is slewed from line to line
    // Another session's first line, or the stop document that it writes for one that was killed: any
    // time may have passed, but none of it backwards, and the monotonic clock may have started again.
    const bool another = entry.name == "start" || entry.name == "stop";
    const double utc_s = unix_time_of(entry.utc);
    const double step_s = utc_s - utc_s_ - (another ? 0.0 : entry.mono_s - mono_s_);
    std::optional<ClockStep> found;
    if (!utc_.empty() && (another ? step_s < -kTolerance_s : std::abs(step_s) > kTolerance_s))
      found = ClockStep{entry.seq, utc_, entry.utc, step_s};
    utc_ = entry.utc;
    utc_s_ = utc_s;
    mono_s_ = entry.mono_s;
    return found;
  }

 private:
  std::string utc_;
  double utc_s_ = 0.0, mono_s_ = 0.0;
};

std::vector<TelemetryChannel> channels_from(const Json& data_keys) {
  std::vector<TelemetryChannel> channels;
  for (const auto& [key, about] : data_keys.items())
    if (key != "rig_time_s" && key != "trouble")
      channels.push_back({key, about.value("units", "")});
  return channels;
}

TelemetryReading reading_from(const Json& data, const std::vector<TelemetryChannel>& channels) {
  TelemetryReading reading{data.at("rig_time_s"), {}, data.at("trouble")};
  for (const TelemetryChannel& channel : channels) {
    const Json& value = data.at(channel.name);
    reading.values.push_back(value.is_null() ? std::nullopt : std::optional(value.get<double>()));
  }
  return reading;
}

void add_phases(std::map<std::string, double>& time, const PosePhases& phases) {
  time["motion_s"] += phases.motion_s;
  time["settle_s"] += phases.settle_s;
  time["trigger_s"] += phases.trigger_s;
  time["transfer_s"] += phases.transfer_s;
}

}  // namespace

std::string clock_step_text(const ClockStep& step) {
  return fmt::format("line {}: the wall clock {} by {:.1f} s, from {} to {}", step.line,
                     step.step_s < 0.0 ? "was set back" : "jumped ahead", std::abs(step.step_s),
                     step.from_utc, step.to_utc);
}

RunState read_run_state(const RunFolder& folder, const VisitPose& visit,
                        const VisitReading& visit_reading) {
  RunState record;
  record.plan = load_plan(folder.plan());
  record.line_of_pose.assign(record.plan.poses.size(), 0);
  std::vector<std::size_t> by_id(record.plan.poses.size());
  std::iota(by_id.begin(), by_id.end(), std::size_t{0});
  const auto id_of = [&](std::size_t i) -> const std::string& { return record.plan.poses[i].id; };
  std::ranges::sort(by_id, {}, id_of);

  const std::string name = folder.journal().string();
  std::unordered_map<std::string, std::string> stream_of;  // by descriptor
  std::vector<TelemetryChannel> channels;                  // of the present session
  std::optional<double> rig_time_s;                        // likewise: the last one that was said
  const auto pose_taken = [&](const JournalEntry& entry, RunSession& session, bool overlap) {
    const Json& data = entry.doc.at("data");
    const auto id = data.at("pose_id").get<std::string>();
    const auto found = std::ranges::lower_bound(by_id, id, {}, id_of);
    if (found == by_id.end() || id_of(*found) != id)
      throw ConfigError(
          name, "",
          fmt::format("line {} records pose {}, which the plan does not know. Plan and journal "
                      "are of different runs; restore the folder from a copy.",
                      entry.seq, id));
    TakenPose pose = pose_from_data(data);
    pose.planned = record.plan.poses[*found];
    rig_time_s = pose.rig_time_s;
    if (!session.whole_time) add_phases(session.time, pose.phases);
    if (!overlap) record.line_of_pose[*found] = entry.seq;
    if (visit) visit(std::move(pose), overlap);
  };
  ClockWatch clocks;
  const auto readout = read_journal(folder.journal(), [&](const JournalEntry& entry) {
    try {
      if (const auto step = clocks.step(entry)) record.clock_steps.push_back(*step);
      if (entry.name == "start") {
        RunSession& session = record.sessions.emplace_back();
        session.uid = entry.doc.at("uid");
        session.start_document = entry.doc.dump();
        session.began_utc = entry.utc;
        if (record.start_document.empty()) record.start_document = session.start_document;
        rig_time_s.reset();
      }
      if (record.sessions.empty())
        throw ConfigError(name, "",
                          fmt::format("line {} comes before any start document.", entry.seq));
      RunSession& session = record.sessions.back();
      if (entry.name != "stop")
        session.last_utc = entry.utc;  // written later for one that was killed
      if (entry.name == "descriptor") {
        stream_of[entry.doc.at("uid")] = entry.doc.at("name");
        if (entry.doc.at("name") == "telemetry")
          channels = channels_from(entry.doc.at("data_keys"));
      } else if (entry.name == "event") {
        const std::string& stream = stream_of[entry.doc.at("descriptor")];
        ++session.events[stream];
        const Json& data = entry.doc.at("data");
        if (stream == "time") {
          session.time = data.get<std::map<std::string, double>>();
          session.whole_time = true;
        } else if (stream == "interruptions") {
          session.interruptions.push_back(
              {data.at("interruption"), data.at("reason"), entry.utc, rig_time_s});
        } else if (stream == "telemetry") {
          rig_time_s = data.at("rig_time_s").get<double>();
          if (visit_reading)
            visit_reading(record.sessions.size() - 1, channels, reading_from(data, channels));
        } else if (data.contains("pose_id")) {
          pose_taken(entry, session, stream == kOverlapStream);
        }
      } else if (entry.name == "stop") {
        session.exit_status = entry.doc.at("exit_status");
        session.reason = entry.doc.value("reason", "");
      }
    } catch (const Json::exception& e) {
      throw ConfigError(
          name, "",
          fmt::format("line {} is not a document of this program: {}", entry.seq, e.what()));
    }
  });
  record.torn = readout.torn;
  record.journal = readout;
  if (!record.sessions.empty()) {
    record.exit_status = record.sessions.back().exit_status;
    record.reason = record.sessions.back().reason;
  }
  return record;
}

RunRecord read_run(const RunFolder& folder) {
  RunRecord record;
  std::vector<TakenPose> taken;  // in the journal's order
  const auto pose_taken = [&](TakenPose pose, bool overlap) {
    (overlap ? record.overlaps : taken).push_back(std::move(pose));
  };
  const auto read = [&record](std::size_t session, const std::vector<TelemetryChannel>& channels,
                              TelemetryReading reading) {
    record.telemetry.resize(session + 1);
    SessionTelemetry& telemetry = record.telemetry.back();
    if (telemetry.readings.empty()) telemetry.channels = channels;
    telemetry.readings.push_back(std::move(reading));
  };
  static_cast<RunState&>(record) = read_run_state(folder, pose_taken, read);
  record.telemetry.resize(record.sessions.size());
  const auto place = [](const TakenPose& pose) { return pose.planned.index; };
  std::ranges::stable_sort(taken, {}, place);
  for (TakenPose& pose : taken) {
    if (!record.poses.empty() && place(record.poses.back()) == place(pose))
      record.poses.back() = std::move(pose);
    else
      record.poses.push_back(std::move(pose));
  }
  return record;
}

std::string given_calibration_sha256(const RunState& run) {
  if (run.start_document.empty()) return {};
  return Json::parse(run.start_document).value("/provenance/calibration_sha256"_json_pointer, "");
}

std::filesystem::path first_calibration(const RunFolder& folder, const RunState& run) {
  const std::string given = given_calibration_sha256(run);
  std::error_code unreadable;
  if (!given.empty() && std::filesystem::exists(folder.given_calibration(), unreadable) &&
      sha256_hex(read_text(folder.given_calibration())) == given)
    return folder.given_calibration();
  return folder.calibration();
}

std::filesystem::path source_file(const RunState& run, const std::filesystem::path& name) {
  if (name.is_absolute() || run.start_document.empty()) return name;
  const std::filesystem::path there =
      Json::parse(run.start_document).value("/provenance/folder"_json_pointer, "") / name;
  std::error_code unreadable;
  return std::filesystem::exists(there.parent_path(), unreadable) ? there : name;
}

RigFile rig_of(const RunState& run) {
  const FrozenText& rig = run.plan.rig;
  return parse_rig_file(rig.text, rig.file, source_file(run, rig.file).parent_path());
}

Image load_image(const RunFolder& folder, const TakenImage& image) {
  if (image.file.empty())
    throw ConfigError(
        folder.root().string(), "",
        "the images of this run were not archived. Run it again with images archived as regions or "
        "in full.");
  const std::filesystem::path file = folder.root() / image.file;
  std::error_code unreadable;
  if (!std::filesystem::exists(file, unreadable))
    throw ConfigError(
        file.string(), "",
        fmt::format(
            "is not there, and the journal has it. Restore it from a copy; \"turntable verify {}\" "
            "tells its pose, and \"turntable resume {}\" takes that again.",
            folder.root().string(), folder.root().string()));
  return load_image(file, image.sha256);
}

}  // namespace turntable
