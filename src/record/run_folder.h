// One run, one folder: what was asked (plan.json), what happened (journal.jsonl, images/), what
// follows from it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "src/core/image.h"
#include "src/record/journal.h"
#include "src/record/plan.h"

namespace turntable {

struct RigFile;

/// Paths of a run. A plain value; `create` and `open` check what is on disk.
class RunFolder {
 public:
  /// Makes the folder with the plan in it, and before it the calibration that the run is given, if any. One that was
  /// killed before it had its plan counts as empty.
  /// @throws ConfigError if `root` exists and is not an empty folder, RecordError if it cannot be written.
  static RunFolder create(const std::filesystem::path& root, const Plan& plan,
                          const std::string& calibration = {});
  /// @throws ConfigError if `root` exists and is not an empty folder.
  static void require_new(const std::filesystem::path& root);
  /// @throws ConfigError if `root` holds no plan.json.
  static RunFolder open(const std::filesystem::path& root);
  /// What processes left behind that were killed, or could not even remove a file, while they wrote.
  void remove_temporary_files() const;
  /// results/runs/<UTC>-<name>
  static std::filesystem::path default_root(const std::string& name);
  /// The same run, with everything that follows from it in another folder: to make it again beside
  /// what is stored.
  RunFolder with_outputs_in(std::filesystem::path outputs) const;

  const std::filesystem::path& root() const { return root_; }
  std::filesystem::path plan() const { return root_ / "plan.json"; }
  std::filesystem::path journal() const { return root_ / "journal.jsonl"; }
  std::filesystem::path images() const { return root_ / "images"; }
  std::filesystem::path calibration() const { return outputs_ / "calibration.json"; }
  /// What the run was given when it began, kept once it is evaluated with another one.
  std::filesystem::path given_calibration() const { return root_ / "given_calibration.json"; }
  std::filesystem::path evaluation() const { return outputs_ / "evaluation.json"; }
  std::filesystem::path poses() const { return outputs_ / "poses.csv"; }
  std::filesystem::path noise_spots() const { return outputs_ / "noise_spots.csv"; }
  std::filesystem::path noise_poses() const { return outputs_ / "noise_poses.csv"; }
  std::filesystem::path tables() const { return outputs_ / "tables"; }
  std::filesystem::path figures() const { return outputs_ / "figures"; }
  std::filesystem::path report() const { return outputs_ / "report.md"; }

 private:
  explicit RunFolder(std::filesystem::path root) : root_(std::move(root)), outputs_(root_) {}
  std::filesystem::path root_, outputs_;
};

/// How one axis stood when a pose was taken; unit of the axis.
struct AxisReadback {
  double position = 0.0;
  bool missed = false;  ///< outside the tolerance after all retries
  int retries = 0;
  bool overshot = false;  ///< approached from the far side
};

/// A spot as the worker saw it in the whole image, before anything was masked.
struct TakenSpot {
  double u_px = 0.0, v_px = 0.0;
  double sigma_px = 0.0;
  double peak_grey = 0.0;
  int area_px = 0;
  bool saturated = false;
};

struct TakenImage {
  std::string file;    ///< relative to the run folder ("images/..."); empty if not archived
  std::string sha256;  ///< of the file; empty if not archived
  std::uint64_t frame_id = 0;
  double exposed_s = 0.0;                       ///< start of exposure on the rig's clock
  std::optional<std::vector<TakenSpot>> spots;  ///< LED target only; brightest first
  int retakes = 0;  ///< exposures beside this one that were found bad at once
  std::string complaint =
      {};  ///< what is wrong with this one, after the last retake; empty = nothing
};

/// Where a pose's time went, on the rig's clock.
struct PosePhases {
  double motion_s = 0.0, settle_s = 0.0;
  double trigger_s = 0.0;  ///< up to the beginning of an exposure, retakes and lost frames included
  double transfer_s = 0.0;  ///< from there until the frame was in hand
};

struct TakenPose {
  PlannedPose planned;
  AxisReadback stage, yaw, roll, pitch;
  std::vector<TakenImage> images;
  double rig_time_s = 0.0;  ///< when the axes had settled, on the rig's clock
  PosePhases phases;

  AxisReadback& axis(AxisId id);
  const AxisReadback& axis(AxisId id) const;
  GimbalAngles angles() const;  ///< read back, rad
  bool missed() const { return stage.missed || yaw.missed || roll.missed || pitch.missed; }
};

/// The rig's channels at one moment.
struct TelemetryReading {
  double rig_time_s = 0.0;
  std::vector<std::optional<double>> values;  ///< by channel; nothing if unreadable
  std::string trouble;                        ///< why a channel could not be read
};

struct TelemetryChannel {
  std::string name, unit;
};

/// The channels of one session. Each session has a rig clock of its own.
struct SessionTelemetry {
  std::vector<TelemetryChannel> channels;  ///< in alphabetical order
  std::vector<TelemetryReading> readings;  ///< values in the order of `channels`
};

/// A person or a channel made the run wait, or let it go on.
struct Interruption {
  std::string what;  ///< "pause", "suspend", "resume", "sleep"
  std::string reason;
  std::string utc;
  /// Of the last pose or reading before it: what a suspension is decided by. Nothing if there is none.
  std::optional<double> rig_time_s;
};

/// What one process did of a run, from a start document on. A run that was resumed has several.
struct RunSession {
  std::string uid;                    ///< of the start document
  std::string start_document;         ///< JSON text
  std::string began_utc, last_utc;    ///< of its first line and the last one before the stop
  std::map<std::string, int> events;  ///< number by stream
  std::string exit_status;            ///< empty: it was killed and wrote no stop document
  std::string reason;
  std::vector<Interruption> interruptions;
  /// Where its time went, s by phase, as the journal's stream "time" has it. A session that could not
  /// write that, for it was killed, has the sums of its poses' phases: what belongs to no pose is
  /// unknown then.
  std::map<std::string, double> time;
  bool whole_time = false;  ///< `time` is from the stream "time"
};

/// The wall clock against the machine's monotonic one: somebody set it, or the machine slept. Order is
/// by the journal's lines and never by the time of day, so that this harms nothing but ages.
struct ClockStep {
  std::uint64_t line = 0;        ///< of the journal: the first one after it
  std::string from_utc, to_utc;  ///< of the line before, and of this one
  double step_s = 0.0;           ///< beyond what passed; below zero = set back
};
/// "line 12: the wall clock was set back by 3600.0 s, from ... to ..."
std::string clock_step_text(const ClockStep& step);

/// Plan and journal joined, without what was measured: what it takes to go on with a run or to check
/// it, however many poses it has.
struct RunState {
  Plan plan;
  /// By place in the plan: the journal's line with the pose that counts, of a pose taken twice the
  /// later one; 0 = not taken.
  std::vector<std::uint64_t> line_of_pose;
  std::string
      start_document;       ///< JSON text of the first start document (provenance); empty if none
  std::string exit_status;  ///< of the last stop document: "success", "abort", "fail"; empty if
                            ///< there is none
  std::string reason;       ///< why it ended
  std::optional<std::string> torn;  ///< a last line that was cut off, if so
  std::vector<RunSession> sessions;
  std::vector<ClockStep> clock_steps;
  JournalReadout journal;

  std::size_t poses_taken() const;
  bool complete() const { return poses_taken() == plan.poses.size(); }
};

/// With what was measured.
struct RunRecord : RunState {
  std::vector<TakenPose> poses;  ///< taken ones that count, in the plan's order
  /// Poses that a resumed session took again beside those that count, to see what has changed.
  std::vector<TakenPose> overlaps;
  std::vector<SessionTelemetry> telemetry;  ///< by session; empty ones if the rig has no channels
};

/// Called for every line with a pose, in the journal's order.
using VisitPose = std::function<void(TakenPose pose, bool overlap)>;
/// Called for every reading of the channels, in the journal's order. @param session from 0
using VisitReading = std::function<void(
    std::size_t session, const std::vector<TelemetryChannel>& channels, TelemetryReading reading)>;
/// In memory that grows neither with the poses, apart from the plan, nor with the readings. @throws ConfigError: damaged
/// plan or journal, an event whose pose is not in the plan.
RunState read_run_state(const RunFolder& folder, const VisitPose& visit = {},
                        const VisitReading& visit_reading = {});
/// All of it. @throws ConfigError as above.
RunRecord read_run(const RunFolder& folder);

/// SHA-256 of the calibration that the run was given when it began; empty if it was given none.
std::string given_calibration_sha256(const RunState& run);
/// Where the calibration is that the run was given: in `calibration` or in `given_calibration`, by its hash; the former
/// if neither is it, or if the run was given none.
std::filesystem::path first_calibration(const RunFolder& folder, const RunState& run);
/// A file that the plan names. A relative name counts from the folder that the run was started in; if its folder is not
/// there (the project was moved), or the journal does not say where that was, from the current one.
std::filesystem::path source_file(const RunState& run, const std::filesystem::path& name);
/// The rig file that the run began with, from its own copy; files that it names count from where it lay. @throws ConfigError.
RigFile rig_of(const RunState& run);

/// Reads an archived image and checks its hash. @throws ConfigError: altered, missing, or never
/// archived.
Image load_image(const RunFolder& folder, const TakenImage& image);

}  // namespace turntable
