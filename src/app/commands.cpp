#include "src/app/commands.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <termios.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>
#include <thread>

#include "src/app/open_rig.h"
#include "src/app/outputs.h"
#include "src/app/progress.h"
#include "src/app/provenance.h"
#include "src/app/rig_lock.h"
#include "src/campaign/planning.h"
#include "src/campaign/runner.h"
#include "src/core/errors.h"
#include "src/core/file_errors.h"
#include "src/core/interrupt.h"
#include "src/evaluation/evaluate.h"
#include "src/record/atomic_file.h"
#include "src/record/sha256.h"
#include "src/record/verify.h"
#include "src/report/trajectory.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

/// The options of --solver. "all" is every row that the camera can serve, which only its calibration
/// tells.
EvaluateOptions solvers_named(const std::vector<std::string>& names) {
  EvaluateOptions options;
  if (names == std::vector<std::string>{"all"}) {
    options.all_solvers = true;
    return options;
  }
  std::vector<const Solver*>& solvers = options.solvers;
  for (const std::string& name : names) {
    const Solver* solver = find_solver(name);
    if (solver == nullptr) {
      std::string known;
      for (const Solver& s : kSolvers) known += (known.empty() ? "" : ", ") + std::string(s.name);
      throw ConfigError("--solver", "",
                        fmt::format("found \"{}\", allowed: {}, or all alone.", name, known));
    }
    if (std::ranges::find(solvers, solver) == solvers.end()) solvers.push_back(solver);
  }
  return options;
}

/// Where the camera calibration of a run comes from.
struct CameraSource {
  std::optional<Calibration> loaded;  ///< otherwise the campaign's own sweep
};

/// Makes sure that a campaign can be evaluated: by its own sweep, by --calibration, or by what the
/// rig file names.
CameraSource provide_calibration(Campaign& campaign, const RigFile& rig, const fs::path& file) {
  CameraSource source;
  const auto is_sweep = [](const Scenario& s) { return s.kind == ScenarioKind::kCalibration; };
  const fs::path& chosen = file.empty() ? rig.calibration.file : file;
  if (!file.empty() || (std::ranges::none_of(campaign.scenarios, is_sweep) && !chosen.empty())) {
    source.loaded = load_calibration(chosen);
    const ImageSize size = source.loaded->irt.image_size();
    if (size != rig.camera.image_size)
      throw ConfigError(
          chosen.string(), "/image_size_px",
          fmt::format(
              "found {} x {} px, allowed: {} x {} px as {} says. Calibrate at the camera's size.",
              size.width, size.height, rig.camera.image_size.width, rig.camera.image_size.height,
              rig.file));
    return source;
  }
  if (std::ranges::any_of(campaign.scenarios, is_sweep)) return source;
  if (rig.calibration.sweep.empty())
    throw ConfigError(
        campaign.file, "",
        fmt::format("has no calibration sweep, and {} names none. Give --calibration FILE, or add "
                    "\"calibration\" to the rig file.",
                    rig.file));
  Scenario sweep = load_scenario(rig.calibration.sweep);
  if (!is_sweep(sweep))
    throw ConfigError(rig.file, "/calibration/sweep",
                      fmt::format("{} is not a calibration scenario.", sweep.file));
  fmt::print("The camera is calibrated first, by {}.\n", sweep.file);
  campaign.scenarios.insert(campaign.scenarios.begin(), std::move(sweep));
  return source;
}

/// A solver that the camera cannot serve is bad input, not a surprise after a night of motion.
void check_solvers(const std::vector<const Solver*>& solvers, const CameraSource& camera,
                   const Plan& plan) {
  const bool tilted = std::ranges::any_of(
      plan.poses, [](const PlannedPose& p) { return p.role == PoseRole::kPinholeView; });
  for (const Solver* solver : solvers) {
    if (solver->sight == Sight::kRays) continue;
    const bool served = !camera.loaded ? tilted
                        : solver->sight == Sight::kPinholeRaw
                            ? camera.loaded->find_central("pinhole") != nullptr
                            : camera.loaded->undistorting() != nullptr;
    if (!served)
      throw ConfigError(
          "--solver", "",
          fmt::format("{} needs a pinhole calibration, and this camera has none. Choose a ray "
                      "solver, or calibrate with pinhole_views.",
                      solver->name));
  }
}

void print_list(const std::vector<std::string>& lines) {
  for (const std::string& line : lines) fmt::print("  {}\n", line);
}

/// The part of a run that has the rig; afterwards it is free for others.
struct Taking {
  const TakeArguments& arguments;
  std::string command;  ///< for other programs
  const RigFile& rig;
  const Plan& plan;
  fs::path root;
  const std::optional<Calibration>& calibration;  ///< given, instead of a sweep of the run's own
  AcquireOptions options = {};
  bool accepts_changes = false;               ///< of a run that goes on
  std::vector<std::string> accepted = {};     ///< what has changed since it began
  std::vector<std::string> other_lines = {};  ///< "mc1=/dev/ttyUSB1"
};

/// A device without the line that it is on, if it is one of those whose line was stated anew.
std::string without_line(const std::string& identity, const std::vector<std::string>& other_lines) {
  for (const std::string& line : other_lines) {
    const std::string head = fmt::format("\"{}\" on ", line.substr(0, line.find('=')));
    const std::size_t begin = identity.find(head), end = identity.find(", channels", begin);
    if (begin != identity.npos && end != identity.npos)
      return identity.substr(0, begin + head.size()) + "its line" + identity.substr(end);
  }
  return identity;
}

/// A run goes on with the devices that it began with. @return what differs.
std::vector<std::string> other_devices(const Rig& rig, const RunState& before,
                                       const std::vector<std::string>& other_lines) {
  std::vector<std::string> differences;
  if (before.start_document.empty()) return differences;
  const auto start = nlohmann::json::parse(before.start_document);
  const auto devices = start.value("devices", std::vector<std::string>{});
  for (std::size_t i = 0; i < std::max(devices.size(), rig.identities.size()); ++i) {
    const std::string then = i < devices.size() ? devices[i] : "nothing";
    const std::string now = i < rig.identities.size() ? rig.identities[i] : "nothing";
    if (without_line(then, other_lines) != without_line(now, other_lines))
      differences.push_back(fmt::format("device: {}; at the start: {}", now, then));
  }
  const std::string camera = start.value("camera", "");
  if (camera != rig.camera->identity())
    differences.push_back(
        fmt::format("camera: {}; at the start: {}", rig.camera->identity(), camera));
  return differences;
}

void refuse_changes(const fs::path& run, const std::vector<std::string>& differences) {
  if (differences.empty()) return;
  throw ConfigError(
      run.string(), "",
      fmt::format("is not what it was when the run began; nothing has moved:\n  {}\n"
                  "Put it back as it was, or give --accept-changes: the run then goes on with its "
                  "own copies of the files, and the journal says what has changed.",
                  fmt::join(differences, "\n  ")));
}

void print_check(const DeviceCheck& check, const RigFile& rig) {
  if (check.frame_s)
    fmt::print("camera: a test exposure came after {:.0f} ms, grey {} to {}\n",
               1000.0 * *check.frame_s, check.darkest, check.brightest);
  if (!check.telemetry) return;
  for (std::size_t i = 0; i < rig.telemetry.channels.size(); ++i) {
    const ChannelConfig& channel = rig.telemetry.channels[i];
    const auto& value = check.telemetry->values[i];
    fmt::print("{}: {}\n", channel.name,
               value ? fmt::format("{:.6g} {}", *value, channel.unit) : "cannot be read");
  }
  if (!check.telemetry->trouble.empty()) spdlog::warn("telemetry: {}", check.telemetry->trouble);
  if (!check.outside.empty())
    spdlog::warn("{}: no pose would be taken before it is back", check.outside);
}

/// Tells a person why nothing moves, once each time, and lets Enter end a pause.
class Waiting {
 public:
  explicit Waiting(fs::path root) : root_(std::move(root)) {}
  void look(const Progress& p) {
    const bool paused = p.phase == "paused";
    if (p.phase != said_ && paused)
      spdlog::info(
          "paused after {} of {} poses. {}\"turntable resume {}\" goes on; Ctrl-C ends it.", p.done,
          p.total, terminal() ? "Enter or " : "", root_.string());
    if (p.phase != said_ && p.phase == "suspended") spdlog::warn("suspended: {}", p.reason);
    if (p.phase != said_ && (said_ == "suspended" || said_ == "paused") && p.phase == "moving")
      spdlog::info("goes on");
    if (p.phase != said_ && paused && terminal()) ::tcflush(STDIN_FILENO, TCIFLUSH);
    said_ = p.phase;
    if (paused && terminal() && entered()) request_pause(false);
  }

 private:
  /// And this program is the one that it listens to.
  static bool terminal() {
    return ::isatty(STDIN_FILENO) != 0 && ::tcgetpgrp(STDIN_FILENO) == ::getpgrp();
  }
  static bool entered() {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    char byte = 0;
    bool line = false;
    while (::poll(&input, 1, 0) > 0 && ::read(STDIN_FILENO, &byte, 1) == 1)
      line = line || byte == '\n';
    return line;
  }
  fs::path root_;
  std::string said_;
};

/// Where the time went, so that people see what is worth making faster.
void print_times(const AcquireSummary& s) {
  const auto row = [&](std::string_view phase, double seconds) {
    if (seconds >= 0.05)
      fmt::print("  {:<34} {:>10.1f} s  {:>5.1f} %\n", phase, seconds, 100.0 * seconds / s.rig_s);
  };
  const double named =
      s.homing_s + s.mount_s + s.motion_s + s.settle_s + s.trigger_s + s.transfer_s + s.held_s;
  fmt::print("time on the rig's clock:\n");
  row("homing", s.homing_s);
  row("changing the payload", s.mount_s);
  row("motion", s.motion_s);
  row("settling", s.settle_s);
  row("triggers", s.trigger_s);
  row("exposure and transfer", s.transfer_s);
  row("paused or suspended", s.held_s);
  row("other", s.rig_s - named);
  fmt::print(
      "  by the wall: archiving {:.1f} s beside the motion, {:.1f} s waited for; looking at "
      "images {:.1f} s\n",
      s.archive_s, s.waited_s, s.inspect_s);
}

/// Everything that devices can be asked without moving or writing anything.
void ask_devices(const TakeArguments& a, const std::string& command, const RigFile& rig_file,
                 const Plan& plan) {
  std::fflush(stdout);
  const RigLock lock(rig_file, command);
  Rig rig = open_rig(rig_file, {false, a.assume_mounted, a.wire_log, a.speed});
  fmt::print("devices:\n");
  print_list(rig.identities);
  print_check(check_devices(rig, rig_file, plan), rig_file);
  fmt::print("The devices allow every pose. Nothing has moved.\n");
}

/// The plan's time as this rig takes it, once it is known.
void print_learned_time(const Plan& plan, const RigFile& rig, double speed) {
  const auto known = known_overheads(pace_key(rig, speed));
  if (!known) return;
  std::vector<std::size_t> all(plan.poses.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  fmt::print("  as this rig takes it: {} (learned from {} poses)\n",
             duration_text(Pace(plan, rig, all, *known).left_s()), known->poses);
}

/// @param folder is there as soon as it has been made.
AcquireSummary take_poses(const Taking& taking, std::optional<RunFolder>& folder) {
  const TakeArguments& a = taking.arguments;
  const RunState* before = taking.options.before;
  // The devices are asked before anything is written or moves.
  std::fflush(stdout);
  const RigLock lock(taking.rig, taking.command, taking.root);
  if (before == nullptr) RunFolder::require_new(taking.root);
  request_pause(false);
  Rig rig = open_rig(taking.rig, {a.configure, a.assume_mounted, a.wire_log, a.speed});
  fmt::print("devices:\n");
  print_list(rig.identities);
  AcquireOptions options = taking.options;
  options.overheads = known_overheads(pace_key(taking.rig, a.speed)).value_or(Overheads{});
  print_check(check_devices(rig, taking.rig, taking.plan, options), taking.rig);
  std::vector<std::string> changes;
  fs::path calibration;  // of the run
  if (before == nullptr) {
    folder = RunFolder::create(taking.root, taking.plan,
                               taking.calibration ? calibration_to_json(*taking.calibration) : "");
    calibration = folder->calibration();
  } else {
    folder = RunFolder::open(taking.root);
    folder->remove_temporary_files();
    calibration = first_calibration(*folder, *before);
    changes = other_devices(rig, *before, taking.other_lines);
    if (!taking.accepts_changes) refuse_changes(taking.root, changes);
    changes.insert(changes.begin(), taking.accepted.begin(), taking.accepted.end());
  }
  nlohmann::json start = run_provenance(taking.rig, taking.plan, taking.arguments.command_line,
                                        taking.calibration ? calibration : fs::path());
  if (!changes.empty()) start["accepted_changes"] = changes;
  if (!taking.other_lines.empty()) start["other_lines"] = taking.other_lines;
  if (!taking.arguments.solvers.empty()) start["solvers"] = taking.arguments.solvers;
  fmt::print("run: {}\n", folder->root().string());
  std::fflush(stdout);
  const auto kept = [&](std::string_view axes) {
    const std::string root = folder->root().string();
    fmt::print(
        "{}What was taken is kept in {}. \"turntable resume {}\" goes on with it, "
        "\"turntable evaluate {}\" evaluates it as it is.\n",
        axes, root, root, root);
  };
  try {
    ProgressLine line("taking poses");
    Waiting waiting(folder->root());
    const AcquireSummary summary =
        acquire(rig, taking.rig, taking.plan, *folder, start, options, [&](const Progress& p) {
          line.update(p.done, p.total, p.phase, p.eta_s);
          waiting.look(p);
        });
    remember_overheads(pace_key(taking.rig, a.speed), summary.overheads);
    return summary;
  } catch (const NotStopped&) {
    kept("");
    throw;
  } catch (const std::exception&) {
    kept("The axes are stopped. ");
    throw;
  }
}

/// Takes the poses and evaluates the run. @return exit code.
int take_and_finish(const Taking& taking, const EvaluateOptions& options,
                    const std::vector<RunFolder>& beside, bool pdf) {
  std::optional<RunFolder> made;
  const AcquireSummary summary = take_poses(taking, made);
  const RunFolder& folder = *made;
  fmt::print("{} poses taken: {} on the rig's clock, {} by the wall\n", summary.poses,
             duration_text(summary.rig_s), duration_text(summary.wall_s));
  print_times(summary);
  if (summary.failed > 0)
    fmt::print("{} poses failed: an axis missed its target, or the target was not seen\n",
               summary.failed);
  if (summary.retakes + summary.trigger_retries + summary.doubtful > 0)
    fmt::print(
        "{} exposures were bad and taken again, {} triggers were repeated; in the end {} poses "
        "beside failed ones have a complaint (see report.md)\n",
        summary.retakes, summary.trigger_retries, summary.doubtful);
  // Another calibration than the run began with stands only if somebody said so.
  const fs::path accepted =
      taking.accepts_changes && taking.calibration ? folder.calibration() : fs::path();
  try {
    const int code = write_outputs(folder, {accepted, options, beside, pdf}, Rewrite::kAll);
    return code == kDone && summary.failed > 0 ? kFailedPoses : code;
  } catch (const Interrupted&) {
    throw;
  } catch (const RecordError&) {
    fmt::print("All poses are taken and kept. \"turntable evaluate {}\" evaluates them.\n",
               folder.root().string());
    throw;
  } catch (const fs::filesystem_error& e) {
    fmt::print("All poses are taken and kept. \"turntable evaluate {}\" evaluates them.\n",
               folder.root().string());
    throw RecordError(file_trouble(e));
  } catch (const std::exception& e) {
    // The rig has done its work and nothing is lost: this is not bad input any more.
    spdlog::error("{}", e.what());
    spdlog::error(
        "The poses were taken, but could not be evaluated; \"turntable evaluate {}\" tries again.",
        folder.root().string());
    return kFailedPoses;
  }
}

/// Files of the plan that have changed since it was frozen.
std::vector<std::string> changed_files(const RunState& run) {
  std::vector<std::string> changes;
  const auto look = [&](const FrozenText& frozen) {
    std::string now;
    try {
      now = read_text(source_file(run, frozen.file));
    } catch (const ConfigError&) {
      return;  // a run may be taken to another computer: its own copy is what counts
    }
    if (now != frozen.text)
      changes.push_back(fmt::format("{}: has changed since the run began", frozen.file));
  };
  look(run.plan.rig);
  for (const FrozenText& source : run.plan.sources) look(source);
  return changes;
}

/// Whoever takes a run evaluates it too, when it is complete.
void refuse_if_taken(const fs::path& run) {
  if (const auto who = tell_run(run, "who"))
    throw ConfigError(run.string(), "",
                      fmt::format("is still being taken by {}. Wait for its end, or stop it with "
                                  "\"turntable stop {}\".",
                                  *who, run.string()));
}

}  // namespace

int plan_command(const PlanArguments& a) {
  if (!a.picture.empty() && a.picture.extension() != ".svg")
    throw ConfigError(
        "--picture", "",
        fmt::format("found {}, allowed: a name that ends in .svg.", a.picture.string()));
  std::error_code error;
  for (const fs::path& out : {a.csv, a.picture})
    for (const fs::path& in : {a.rig, a.scenario, a.calibration})
      if (!out.empty() && fs::equivalent(out, in, error))
        throw ConfigError(out.string(), "",
                          "is an input of this plan and would be written over. Name another file.");
  const RigFile rig = load_rig(a.rig);
  Campaign campaign = load_campaign(a.scenario);
  provide_calibration(campaign, rig, a.calibration);
  const Plan plan = plan_campaign(campaign, rig);
  const PlanReport report = check_plan(plan, rig, {archive_mode_from_name(a.images), a.out});
  fmt::print("{}", plan_summary(plan, report));
  print_learned_time(plan, rig, 1.0);
  const std::vector<OrderTime> orders = order_times(campaign, rig);
  if (!orders.empty()) fmt::print("\n  motion by order of poses (* = as the scenario says):\n");
  for (std::size_t i = 0; i < orders.size(); ++i) {
    if (i == 0 || orders[i].scenario != orders[i - 1].scenario)
      fmt::print("{}  {:<20}", i == 0 ? "" : "\n", campaign.scenarios[orders[i].scenario].name);
    fmt::print("  {}{} {}", pose_order_name(orders[i].order), orders[i].chosen ? "*" : "",
               duration_text(orders[i].motion_s));
  }
  if (!orders.empty()) fmt::print("\n");
  if (!a.csv.empty()) {
    write_plan_csv(plan, rig, a.csv);
    fmt::print("poses: {}\n", a.csv.string());
  }
  if (!a.picture.empty()) {
    write_atomically(a.picture, plan_picture(plan, pose_times(plan, rig)));
    fmt::print("picture: {}\n", a.picture.string());
  }
  if (a.ask_devices) ask_devices({}, fmt::format("plan {}", a.scenario.string()), rig, plan);
  return kDone;
}

int run_command(const RunArguments& a) {
  const RigFile rig_file = load_rig(a.rig);
  Campaign campaign = load_campaign(a.scenario);
  const EvaluateOptions options = solvers_named(a.solvers);
  const CameraSource camera = provide_calibration(campaign, rig_file, a.calibration);
  const ArchiveMode archive = archive_mode_from_name(a.images);
  std::vector<RunFolder> beside;
  for (const fs::path& other : a.beside) {
    beside.push_back(RunFolder::open(other));
    (void)load_calibration(beside.back().calibration());  // now, not after a night
  }
  const Plan plan = plan_campaign(campaign, rig_file);
  if (archive == ArchiveMode::kNone && !camera.loaded && has_calibration_sweep(plan))
    throw ConfigError(
        "--images", "",
        "found \"none\", allowed with a calibration sweep: regions, full. The pattern's "
        "images are what the camera is calibrated from.");
  check_solvers(options.solvers, camera, plan);
  const fs::path root = a.out.empty() ? RunFolder::default_root(plan.name) : a.out;
  const PlanReport report = check_plan(plan, rig_file, {archive, root});
  fmt::print("{}", plan_summary(plan, report));
  print_learned_time(plan, rig_file, a.speed);
  if (a.configure && a.dry_run)
    throw ConfigError(
        "--configure", "",
        "writes into the controllers, and --dry-run writes nothing. Remove the one or "
        "the other.");
  if (a.ask_devices && !a.dry_run)
    throw ConfigError("--ask-devices", "", "is for --dry-run; a run asks them anyway.");
  if (a.ask_devices)
    ask_devices(a, fmt::format("run {} --dry-run", a.scenario.string()), rig_file, plan);
  if (a.dry_run) {
    fmt::print("Dry run: nothing moved, nothing written.\n");
    return kDone;
  }

  Taking taking{a, fmt::format("run {}", a.scenario.string()), rig_file, plan, root, camera.loaded};
  taking.options.archive = archive;
  return take_and_finish(taking, options, beside, !a.no_pdf);
}

int resume_command(const ResumeArguments& a) {
  const RunFolder folder = RunFolder::open(a.run);
  if (const auto who = tell_run(a.run, "resume")) {
    fmt::print("{} takes it, and goes on if it was paused.\n", *who);
    return kDone;
  }
  // A run that was killed before its journal was made has a plan and nothing else.
  RunState before;
  if (fs::exists(folder.journal())) {
    before = read_run_state(folder);
  } else {
    before.plan = load_plan(folder.plan());
    before.line_of_pose.assign(before.plan.poses.size(), 0);
  }
  const Plan& plan = before.plan;
  RigFile rig_file = rig_of(before);
  for (ControllerConfig& controller : rig_file.controllers)
    for (const FrozenText& source : plan.sources)
      if (source.file == controller.description) controller.description_text = source.text;
  const std::vector<std::string> other_lines = put_lines(rig_file, a.lines);
  know_rig(rig_file);
  const nlohmann::json start = before.start_document.empty()
                                   ? nlohmann::json::object()
                                   : nlohmann::json::parse(before.start_document);
  // Those asked for now, those of an evaluation before, or those that the run was begun with.
  EvaluateOptions options = solvers_named(a.solvers);
  if (a.solvers.empty() && !start.empty())
    options.solvers = read_evaluation_record(folder, plan).solvers;
  if (a.solvers.empty() && options.solvers.empty())
    options =
        solvers_named(start.value("/provenance/solvers"_json_pointer, std::vector<std::string>{}));
  if (start.empty())
    spdlog::warn(
        "{}: the run was ended before its journal began, and nothing is known of the options that "
        "it was given: images are archived as regions, and solvers are those of --solver or the "
        "usual ones. To have others, remove the folder and run again.",
        folder.root().string());
  // What the run was given when it began, also if it has a sweep of its own.
  const std::string calibration_sha256 = given_calibration_sha256(before);
  std::optional<Calibration> loaded;
  std::vector<std::string> changes = changed_files(before);
  if (!has_calibration_sweep(plan) || !calibration_sha256.empty() ||
      (start.empty() && fs::exists(folder.calibration()))) {
    const fs::path calibration = first_calibration(folder, before);
    loaded = load_calibration(calibration);
    if (!calibration_sha256.empty() && sha256_hex(read_text(calibration)) != calibration_sha256)
      changes.push_back(
          fmt::format("{}: is not the calibration that the run began with", calibration.string()));
  }

  RunFindings findings;
  {
    ProgressLine line("checking images");
    verify_images(folder, before, findings,
                  [&](std::size_t done, std::size_t total) { line.update(done, total, "poses"); });
  }
  for (const std::string& what : findings.damage) spdlog::warn("{}", what);
  for (const std::size_t index : findings.lost_poses) before.line_of_pose[index] = 0;
  fmt::print(
      "{}: {} of {} poses are there{}.\n", plan.title, before.poses_taken(), plan.poses.size(),
      findings.lost_poses.empty() ? ""
                                  : fmt::format("; {} whose images are lost will be taken again",
                                                findings.lost_poses.size()));
  if (before.complete()) {
    for (const std::string& change : changes) spdlog::warn("{}", change);
    fmt::print("Nothing is left to take.\n");
    const fs::path accepted = a.accept_changes && loaded ? folder.calibration() : fs::path();
    return write_outputs(folder, {accepted, options, {}, false}, Rewrite::kAll);
  }
  Taking taking{a, fmt::format("resume {}", a.run.string()), rig_file, plan, a.run, loaded};
  taking.accepts_changes = a.accept_changes;
  taking.accepted = std::move(changes);
  taking.other_lines = other_lines;
  if (!before.start_document.empty()) {
    if (start.value("plan_sha256", "") != plan_sha256(plan))
      throw ConfigError(folder.plan().string(), "",
                        "is not the plan that the run was started with. Restore it from a copy.");
    taking.options.archive = archive_mode_from_name(start.value("archive", "regions"));
  }
  if (!a.accept_changes) refuse_changes(a.run, taking.accepted);
  taking.options.before = &before;
  taking.options.overlap = a.overlap;
  Plan rest = plan;  // what is still to be checked for room and limits
  const Schedule schedule = schedule_of(plan, taking.options);
  rest.poses.clear();
  for (const auto* list : {&schedule.overlap, &schedule.missing})
    for (const std::size_t index : *list) rest.poses.push_back(plan.poses[index]);
  fmt::print("{}", plan_summary(
                       rest, check_plan(rest, rig_file, {taking.options.archive, folder.root()})));
  return take_and_finish(taking, options, {}, false);
}

int tell_command(const fs::path& run, const std::string& word) {
  (void)RunFolder::open(run);
  const auto who = tell_run(run, word);
  if (!who)
    throw ConfigError(run.string(), "",
                      "nobody takes this run now. \"turntable resume\" goes on with one that ended "
                      "early.");
  if (word == "pause") {
    fmt::print("{} pauses after its pose; \"turntable resume {}\" lets it go on.\n", *who,
               run.string());
    return kDone;
  }
  // It lets go of the run when its axes stand.
  constexpr int kPolls = 300;  // of 0.1 s: a long archive may be behind it
  for (int i = 0; i < kPolls; ++i) {
    if (!tell_run(run, "who")) {
      fmt::print("{} was told to stop and has ended.\n", *who);
      return kDone;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  throw NotStopped(fmt::format("{} was told to stop and has not ended.", *who));
}

int evaluate_command(const EvaluateArguments& a) {
  const RunFolder folder = RunFolder::open(a.run);
  refuse_if_taken(a.run);
  OutputOptions options;
  options.calibration = a.calibration;
  options.evaluate = solvers_named(a.solvers);
  if (!a.noise_grey.empty()) {
    std::vector<double> sigmas = a.noise_grey;
    std::ranges::sort(sigmas);
    const auto repeated = std::ranges::unique(sigmas);
    sigmas.erase(repeated.begin(), repeated.end());
    options.noise = {std::move(sigmas), a.noise_seed, a.noise_scenario};
  }
  return write_outputs(folder, std::move(options), Rewrite::kAll);
}

int report_command(const ReportArguments& a) {
  if (a.runs.size() == 2) {
    if (!a.beside.empty())
      throw ConfigError(
          "--beside", "",
          "sets cameras beside those of one run, and two are given to be compared. Name "
          "one run, or leave it out.");
    return compare_command(a);
  }
  if (!a.out.empty())
    throw ConfigError("--out", "",
                      "is for the comparison of two runs; the report of one lies in its folder.");
  const fs::path& run = a.runs.front();
  const RunFolder folder = RunFolder::open(run);
  refuse_if_taken(run);
  OutputOptions options;
  options.pdf = !a.no_pdf;
  require_evaluated(folder);
  options.calibration = folder.calibration();
  const EvaluationRecord how = read_evaluation_record(folder, load_plan(folder.plan()));
  options.evaluate.solvers = how.solvers;
  options.evaluate.spots = SpotSource::kJournal;
  options.noise = how.noise;
  for (const fs::path& other : a.beside) options.beside.push_back(RunFolder::open(other));
  return write_outputs(folder, std::move(options), Rewrite::kTables);
}

}  // namespace turntable
