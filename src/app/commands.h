// The verbs of the command line. Each returns an exit code and throws for everything that main
// turns into one.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "src/record/image_archive.h"

namespace turntable {

/// Exit codes, documented in README.md and --help.
enum ExitCode {
  kDone = 0,
  kBadInput = 2,
  kDeviceTrouble = 3,
  kFailedPoses = 4,
  kInterrupted = 130
};

struct PlanArguments {
  std::filesystem::path scenario, rig, csv, picture, out;
  std::filesystem::path calibration;
  std::string images = "regions";
  bool ask_devices = false;  ///< connect and ask what can be asked without moving
};
int plan_command(const PlanArguments& a);

/// What every verb that takes poses takes.
struct TakeArguments {
  std::string command_line;  ///< the verb and what follows it, as a shell would take it again
  std::vector<std::string> solvers;
  std::filesystem::path wire_log;
  bool configure = false, assume_mounted = false;
  double speed = 1.0;
};

struct RunArguments : TakeArguments {
  std::filesystem::path scenario, rig, out, calibration;
  std::vector<std::filesystem::path> beside;  ///< earlier runs whose cameras the report sets beside
  std::string images = "regions";
  bool dry_run = false, ask_devices = false;
  bool no_pdf = false;
};
int run_command(const RunArguments& a);

struct ResumeArguments : TakeArguments {
  std::filesystem::path run;
  std::size_t overlap = 2;
  bool accept_changes = false;
  std::vector<std::string> lines;  ///< "mc1=/dev/ttyUSB1": where controllers are to be found now
};
/// Ends a pause if the run is still being taken; goes on with it otherwise.
int resume_command(const ResumeArguments& a);

/// Tells whoever takes the run. @param word "pause", "stop"
int tell_command(const std::filesystem::path& run, const std::string& word);

struct VerifyArguments {
  std::filesystem::path run;
  bool record_only = false;
};
int verify_command(const VerifyArguments& a);

struct CalibrateArguments {
  /// Run folder, calibration scenario, calibration set, calibration file, or OpenCV camera.
  std::filesystem::path source;
  std::filesystem::path rig, out;
  std::string order;              ///< 1 to 9, "auto", or nothing
  std::vector<double> planes_mm;  ///< of an OpenCV camera
};
int calibrate_command(const CalibrateArguments& a);

struct EvaluateArguments {
  std::filesystem::path run, calibration;
  std::vector<std::string> solvers;
  std::vector<double> noise_grey;  ///< standard deviations to be added to the images
  std::string noise_scenario;      ///< empty = chosen
  std::uint64_t noise_seed = 1;
};
int evaluate_command(const EvaluateArguments& a);

struct ReportArguments {
  std::vector<std::filesystem::path> runs;    ///< one, or two to be compared
  std::vector<std::filesystem::path> beside;  ///< of one: runs whose cameras are set beside its own
  std::filesystem::path out;                  ///< of two: folder; empty = A/compare_<B>
  bool no_pdf = false;
};
int report_command(const ReportArguments& a);
/// Of two runs.
int compare_command(const ReportArguments& a);

struct IdentifyArguments {
  std::filesystem::path run, rig_out, target_out;  ///< empty = not written
};
int identify_command(const IdentifyArguments& a);

// ---- attitudes without a rig (attitude_commands.cpp)

/// What every verb that measures attitudes by itself takes.
struct AttitudeArguments {
  std::filesystem::path calibration, target;  ///< target file, or rig file
  std::string solver;                         ///< empty = `default_solver`
  std::string camera;                         ///< "irt" or a central model; empty = the solver's
  bool robust = false;
  /// Attitudes that are looked for: within so many degrees of these (yaw, roll, pitch; none = 0).
  std::optional<double> within_deg;  ///< none = 180
  std::vector<double> near_deg;
  double electrons_per_grey = 0.0;  ///< of the camera; 0 = shot noise not counted
  std::filesystem::path out;        ///< empty = standard output
  std::string format = "csv";       ///< or "json"
};

struct SolveArguments : AttitudeArguments {
  std::filesystem::path points;  ///< "-" = standard input
};
int solve_command(const SolveArguments& a);

struct MeasureArguments : AttitudeArguments {
  std::vector<std::filesystem::path> images;  ///< files and folders
};
int measure_command(const MeasureArguments& a);

struct TrackArguments : AttitudeArguments {
  std::filesystem::path source;  ///< folder of images, or rig file
  int frames = 0;                ///< 0 = all there are
  bool follow = false;           ///< wait for new images in the folder
};
int track_command(const TrackArguments& a);

struct StudyArguments {
  std::filesystem::path target, out;
  std::vector<std::string> solvers;
  std::size_t poses = 10000;
  std::uint64_t seed = 1;
  double focal_px = 1945.0, distance_mm = 550.0;
  std::vector<int> image_size_px{1024, 1024};  ///< width, height
};
int study_command(const StudyArguments& a);

// ---- the rig by hand (rig_commands.cpp)

/// What every verb that opens a rig by hand takes.
struct HandArguments {
  std::filesystem::path rig, wire_log;
  double speed = 1.0;
  bool homed = false;  ///< a person vouches for the references
};

struct DevicesArguments {
  std::vector<std::string> ports, hosts;  ///< also ask these; "host:port"
  bool listed_only = false;               ///< send nothing to anybody
};
int devices_command(const DevicesArguments& a);

int status_command(const HandArguments& a);

struct HomeArguments : HandArguments {
  std::vector<std::string> axes;  ///< none = all
  bool configure = false;
};
int home_command(const HomeArguments& a);

struct MoveArguments : HandArguments {
  std::vector<std::string> targets;  ///< axis, value, axis, value, ...
  bool relative = false, home = false;
};
int move_command(const MoveArguments& a);

int stop_command(const HandArguments& a);

struct SimulateArguments {
  std::filesystem::path rig, links, faults;
  double speed = 1.0;
};
int simulate_command(const SimulateArguments& a);

}  // namespace turntable
