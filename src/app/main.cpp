// Composition root: command line -> verbs -> exit codes.
#include <fmt/format.h>
#include <malloc.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <iostream>
#include <new>
#include <string_view>

#include "src/app/commands.h"
#include "src/attitude/solver.h"
#include "src/core/errors.h"
#include "src/core/file_errors.h"
#include "src/core/interrupt.h"
#include "version.h"

namespace {

using namespace turntable;

/// What a JSON number holds exactly, as in rig files.
constexpr std::int64_t kLargestSeed = 9007199254740991;

constexpr const char* kExitCodes =
    "Exit codes: 0 done; 2 bad input, nothing moved; 3 device or disk trouble, axes stopped unless "
    "the message says otherwise;\n4 finished, but some poses failed or an axis missed; 130 "
    "interrupted, axes stopped; 137 killed by a third Ctrl-C, which stops nothing.\n";

/// CLI::Range takes what is not a number for one inside.
CLI::Validator number_in(double least, double most) {
  const std::string allowed = fmt::format("a number from {:g} to {:g}", least, most);
  const auto check = [=](std::string& text) {
    char* rest = nullptr;
    const double number = std::strtod(text.c_str(), &rest);
    const bool is_number = !text.empty() && *rest == '\0';
    return is_number && number >= least && number <= most
               ? std::string()
               : fmt::format("found {}, allowed: {}", text, allowed);
  };
  return CLI::Validator(check, fmt::format("in [{:g} - {:g}]", least, most));
}

/// What is found is quoted in messages, and may be a file without any line end: of a long message its
/// beginning and its end, where the advice stands.
void complain(std::string_view message) {
  constexpr std::size_t kBeginning = 1500, kEnd = 500;
  if (message.size() <= kBeginning + kEnd) {
    spdlog::error("{}", message);
    return;
  }
  const auto inside_letter = [&](std::size_t at) {
    return (static_cast<unsigned char>(message[at]) & 0xC0u) == 0x80u;  // of UTF-8
  };
  std::size_t left = kBeginning, right = message.size() - kEnd;
  while (left > 0 && inside_letter(left)) --left;
  while (right < message.size() && inside_letter(right)) ++right;
  spdlog::error("{} [{} bytes left out] {}", message.substr(0, left), right - left,
                message.substr(right));
}

int guarded(const std::function<int()>& verb) {
  try {
    return verb();
  } catch (const Interrupted& e) {
    complain(e.what());
    return kInterrupted;
  } catch (const ConfigError& e) {
    complain(e.what());
    return kBadInput;
  } catch (const LimitError& e) {
    complain(e.what());
    return kBadInput;
  } catch (const RecordError& e) {
    complain(e.what());
    return kDeviceTrouble;
  } catch (const LineError& e) {
    complain(e.what());
    return kDeviceTrouble;
  } catch (const TimeoutError& e) {
    complain(e.what());
    return kDeviceTrouble;
  } catch (const ProtocolError& e) {
    complain(e.what());
    return kDeviceTrouble;
  } catch (const DeviceError& e) {
    complain(e.what());
    return kDeviceTrouble;
  } catch (const Error& e) {
    complain(e.what());
    return kBadInput;
  } catch (const std::filesystem::filesystem_error& e) {
    complain(file_trouble(e));
    return e.code() == std::errc::filename_too_long ? kBadInput : kDeviceTrouble;
  } catch (const std::bad_alloc&) {
    spdlog::error(
        "There is not enough memory for this. Close other programs, or give it smaller input.");
    return kDeviceTrouble;
  } catch (const std::exception& e) {
    complain(fmt::format(
        "unexpected: {}. This is a defect of the program; the journal of the run, if any, is "
        "intact.",
        e.what()));
    return kDeviceTrouble;
  }
}

/// Every image takes some megabytes for a moment. Given back to the system each time, they come as new pages, and
/// evaluating a run from its images takes twice as long.
void keep_freed_memory() {
  constexpr int kLargestBlock = 32 << 20,  // bytes; the most that glibc takes
      kFree = 256 << 20;
  mallopt(M_MMAP_THRESHOLD, kLargestBlock);
  mallopt(M_TRIM_THRESHOLD, kFree);
}

/// Arguments as a shell would take them again.
std::string command_line(int argc, char** argv) {
  std::string line;
  for (int i = 1; i < argc; ++i) {
    const std::string_view argument = argv[i];
    const bool plain = !argument.empty() && std::ranges::all_of(argument, [](unsigned char c) {
      return std::isalnum(c) || c >= 0x80 ||
             std::string_view("_-+./=:,@%").find(static_cast<char>(c)) != std::string_view::npos;
    });
    line += i == 1 ? "" : " ";
    if (plain) {
      line += argument;
      continue;
    }
    line += '\'';
    for (const char c : argument) line += c == '\'' ? std::string("'\\''") : std::string(1, c);
    line += '\'';
  }
  return line;
}

}  // namespace

int main(int argc, char** argv) {
  keep_freed_memory();
  install_interrupt_handlers();
  // A file that may grow no more is an error of its write, with axes to be stopped and poses to be
  // kept, and not the death of the program.
  std::signal(SIGXFSZ, SIG_IGN);
  // In a file that takes both outputs, complaints stand where they belong.
  std::setvbuf(stdout, nullptr, _IOLBF, BUFSIZ);
  spdlog::set_default_logger(spdlog::stderr_color_mt("turntable"));
  spdlog::set_pattern("turntable: %^%l%$: %v");

  CLI::App app{
      "Drives a turntable test rig, calibrates its camera as rays, and judges attitude solvers "
      "against it."};
  app.name("turntable");
  app.set_version_flag("--version", fmt::format("turntable {} ({}{})", kVersion, kCommit,
                                                kDirty ? ", modified" : ""));
  app.require_subcommand(1);
  app.footer(
      std::string(
          "Examples:\n"
          "  turntable run scenarios/campaigns/quick.json --rig scenarios/rigs/simulated.json\n"
          "  turntable plan scenarios/triaxial_xyz.json --rig scenarios/rigs/simulated.json --csv "
          "poses.csv\n"
          "  turntable evaluate results/runs/20260131T120000Z-quick --solver aopit_ray\n\n") +
      kExitCodes);

  int code = kDone;
  const auto solver_names = [](const char* mark) {
    std::string names;
    for (const Solver& s : kSolvers)
      names += (names.empty() ? "" : ", ") + std::string(s.name) + (s.by_default ? mark : "");
    return names;
  };
  const std::string solvers_help =
      fmt::format("solvers to report: all, or of {} (* = where none is named)", solver_names("*"));
  const std::string image_modes =
      "what to archive of LED images: full, regions (spots with a margin), none";

  PlanArguments plan;
  auto* plan_verb =
      app.add_subcommand("plan", "Check a scenario or campaign against a rig; move nothing");
  plan_verb->add_option("scenario", plan.scenario, "scenario or campaign file")->required();
  plan_verb->add_option("--rig", plan.rig, "rig file")->required();
  plan_verb->add_option("--csv", plan.csv,
                        "write every pose to this file, with its time and where it should be seen");
  plan_verb->add_option("--picture", plan.picture,
                        "draw the way of the turntable to this .svg file, with gnuplot");
  plan_verb->add_option("--out", plan.out, "run folder to be, for the disk space check");
  plan_verb->add_option("--calibration", plan.calibration, "camera calibration instead of a sweep");
  plan_verb->add_option("--images", plan.images, image_modes)->capture_default_str();
  const std::string asks =
      "connect too: set-up, limits, channels and one test exposure; nothing moves";
  plan_verb->add_flag("--ask-devices", plan.ask_devices, asks);
  plan_verb->footer(
      "Example:\n  turntable plan scenarios/campaigns/paper_2019.json --rig "
      "scenarios/rigs/simulated.json");
  plan_verb->callback([&] { code = guarded([&] { return plan_command(plan); }); });

  CalibrateArguments calibrate;
  auto* calibrate_verb = app.add_subcommand(
      "calibrate",
      "Calibrate a camera from a run, a sweep to be taken, images, points or an OpenCV "
      "file");
  calibrate_verb
      ->add_option(
          "source", calibrate.source,
          "run folder, calibration scenario (then a sweep is run), calibration set (images "
          "or points that are there already), calibration.json (printed), or OpenCV camera "
          "(.yml, .xml)")
      ->required();
  calibrate_verb->add_option("--rig", calibrate.rig, "rig file, for a scenario");
  calibrate_verb->add_option("--order", calibrate.order,
                             "runs and calibration sets: polynomial order 1 to 9, or auto: what "
                             "held-out and leave-one-out "
                             "residuals justify (default: as the source says)");
  calibrate_verb
      ->add_option(
          "--planes", calibrate.planes_mm,
          "OpenCV camera: two heights between which its rays are stated, mm, negative = in "
          "front")
      ->delimiter(',');
  calibrate_verb->add_option(
      "--out", calibrate.out,
      "folder for calibration.json, calibration.md, figures, tables and OpenCV files (default: "
      "results/calibrations/<name>); run folder for a scenario");
  calibrate_verb->footer(
      "Examples:\n  turntable calibrate scenarios/calibration_sweep.json --rig "
      "scenarios/rigs/simulated.json\n"
      "  turntable calibrate results/runs/20260131T120000Z-quick --order auto --out results/order\n"
      "  turntable calibrate my_board.json\n"
      "  turntable calibrate camera.yml --planes -800,-600\n"
      "  turntable calibrate scenarios/calibrations/paper_table1.json");
  calibrate_verb->callback([&] { code = guarded([&] { return calibrate_command(calibrate); }); });

  const auto takes_poses = [](CLI::App& verb, TakeArguments& a) {
    verb.add_option("--wire-log", a.wire_log, "append every byte on every line to this file");
    verb.add_option("--speed", a.speed, "of the clock, for devices served by \"simulate --speed\"")
        ->check(number_in(0.01, 100.0));
    verb.add_flag("--configure", a.configure,
                  "write the rig file's set-up into the controllers first");
    verb.add_flag("--assume-mounted", a.assume_mounted,
                  "do not ask when the payload has to be changed");
  };
  const auto without_pdf = [](CLI::App& verb, bool& no_pdf) {
    verb.add_flag("--no-pdf", no_pdf, "do not print the page as PDF beside it (with Chromium)")
        ->envname("TURNTABLE_NO_PDF");
  };
  RunArguments run;
  run.command_line = command_line(argc, argv);
  auto* run_verb = app.add_subcommand(
      "run", "Run a scenario or campaign: move, trigger, calibrate, evaluate, report");
  run_verb->add_option("scenario", run.scenario, "scenario or campaign file")->required();
  run_verb->add_option("--rig", run.rig, "rig file")->required();
  run_verb->add_option("--out", run.out, "run folder (default: results/runs/<UTC>-<name>)");
  run_verb->add_option("--solver", run.solvers, solvers_help)->delimiter(',');
  run_verb->add_option("--calibration", run.calibration, "camera calibration instead of a sweep");
  run_verb->add_option("--beside", run.beside,
                       "earlier run, such as one with another lens: the report sets its table of "
                       "cameras and solvers beside this one's");
  run_verb->add_option("--images", run.images, image_modes)->capture_default_str();
  takes_poses(*run_verb, run);
  without_pdf(*run_verb, run.no_pdf);
  run_verb->add_flag("--dry-run", run.dry_run, "check everything, move nothing, write nothing");
  run_verb->add_flag("--ask-devices", run.ask_devices, asks);
  run_verb->footer(
      std::string(
          "Examples:\n"
          "  turntable run scenarios/campaigns/quick.json --rig scenarios/rigs/simulated.json\n"
          "  turntable run scenarios/uniaxial_z.json --rig scenarios/rigs/ideal.json --solver "
          "aopit,aopit_ray\n\n") +
      "Ctrl-C finishes the pose and pauses; Enter, or \"turntable resume RUN\", goes on. A second "
      "one "
      "stops the axes and ends\nthe run, which \"turntable resume RUN\" takes up again; a third "
      "one "
      "kills. SIGTERM is the second at once.\n" +
      kExitCodes);
  run_verb->callback([&] { code = guarded([&] { return run_command(run); }); });

  ResumeArguments resume;
  resume.command_line = command_line(argc, argv);
  auto* resume_verb = app.add_subcommand(
      "resume", "Go on with a run that was paused, interrupted, or killed by whatever");
  resume_verb->add_option("run", resume.run, "run folder")->required();
  resume_verb
      ->add_option("--overlap", resume.overlap,
                   "poses before the break that are taken again, beside those that count, to see "
                   "what the break has changed")
      ->capture_default_str()
      ->check(CLI::Range(0, 1000));
  resume_verb->add_option("--solver", resume.solvers, solvers_help)->delimiter(',');
  resume_verb->add_option(
      "--line", resume.lines,
      "where a controller is to be found now, as NAME=PORT or NAME=HOST:PORT, for example "
      "mc1=/dev/ttyUSB1; may be given several times, and the journal says so");
  resume_verb->add_flag("--accept-changes", resume.accept_changes,
                        "go on although files or devices differ from those at the start; the "
                        "journal says so");
  takes_poses(*resume_verb, resume);
  resume_verb->footer(
      std::string("Example:\n  turntable resume results/runs/20260131T120000Z-quick\n\n"
                  "Poses are told by their ids: none is taken twice, none is left out, except that "
                  "poses whose images are missing or\naltered are taken again. Plan, files and "
                  "devices have to be those of the start.\n") +
      kExitCodes);
  resume_verb->callback([&] { code = guarded([&] { return resume_command(resume); }); });

  VerifyArguments verify;
  auto* verify_verb = app.add_subcommand(
      "verify",
      "Check a run against its hashes, evaluate it again and compare every table; change nothing");
  verify_verb->add_option("run", verify.run, "run folder")->required();
  verify_verb->add_flag("--record-only", verify.record_only,
                        "plan, journal and images only: do not evaluate again");
  verify_verb->footer(
      "Example:\n  turntable verify results/runs/20260131T120000Z-quick\n\nCalibration, poses.csv "
      "and tables are made again in a temporary folder (TMPDIR) and compared byte for byte;\n"
      "figures and the report are not. Exit code 4 if anything is damaged or differs.");
  verify_verb->callback([&] { code = guarded([&] { return verify_command(verify); }); });

  EvaluateArguments evaluate;
  auto* evaluate_verb = app.add_subcommand(
      "evaluate", "Make everything after the images again: calibration, poses.csv, tables, report");
  evaluate_verb->add_option("run", evaluate.run, "run folder")->required();
  evaluate_verb->add_option("--solver", evaluate.solvers, solvers_help)->delimiter(',');
  evaluate_verb->add_option("--calibration", evaluate.calibration, "another camera calibration");
  auto* noise =
      evaluate_verb
          ->add_option("--noise", evaluate.noise_grey,
                       "also add Gaussian noise of these standard deviations, grey levels, to the "
                       "archived images of one scenario, and evaluate them again")
          ->delimiter(',')
          ->check(number_in(0.01, 255.0));
  evaluate_verb
      ->add_option("--scenario", evaluate.noise_scenario,
                   "that noise is added to (default: the one of Table 5, else with most axes)")
      ->needs(noise);
  evaluate_verb->add_option("--noise-seed", evaluate.noise_seed, "of the noise")
      ->check(CLI::Range(std::int64_t{0}, kLargestSeed))
      ->capture_default_str()
      ->needs(noise);
  evaluate_verb->footer(
      "Examples:\n  turntable evaluate results/runs/20260131T120000Z-quick --solver "
      "posit,aopit_ray\n"
      "  turntable evaluate results/runs/20260131T120000Z-paper_2019 --noise 5,10,20,30\n"
      "Noise (paper, 4.2.3): tables/noise, figures 17 and 18, noise_poses.csv. The noise of an "
      "image "
      "follows from\nseed, pose and sigma alone. Without --noise, what an earlier evaluation "
      "stored of "
      "it is removed.");
  evaluate_verb->callback([&] { code = guarded([&] { return evaluate_command(evaluate); }); });

  ReportArguments report;
  auto* report_verb = app.add_subcommand(
      "report",
      "Write tables, figures and report (HTML, PDF, Markdown) again from stored points; or set two "
      "runs side by side");
  report_verb
      ->add_option(
          "runs", report.runs,
          "run folder; or two, A and B, whose errors are compared: before and after a change")
      ->required()
      ->expected(1, 2);
  report_verb->add_option("--beside", report.beside,
                          "of one run: others whose cameras and solvers its tables have beside its "
                          "own");
  report_verb->add_option(
      "--out", report.out,
      "of two runs: folder to write to (default: A/compare_<name and uid of B>)");
  without_pdf(*report_verb, report.no_pdf);
  report_verb->footer(
      "Examples:\n  turntable report results/runs/20260131T120000Z-quick\n"
      "  turntable report results/runs/20260131T120000Z-quick --beside "
      "results/runs/20260131T110000Z-non_central\n"
      "  turntable report results/runs/20260131T120000Z-before "
      "results/runs/20260201T120000Z-after\n"
      "Two runs: what differs between them, RMSE of both with the difference and its interval, "
      "bias, "
      "failed poses;\nposes are matched by scenario, repeat and planned angles. Neither run is "
      "changed, "
      "but for the folder in A.");
  report_verb->callback([&] { code = guarded([&] { return report_command(report); }); });

  IdentifyArguments identify;
  auto* identify_verb = app.add_subcommand(
      "identify",
      "What a run tells about its rig: mounting, axes, stage and target, with uncertainties");
  identify_verb->add_option("run", identify.run, "run folder")->required();
  identify_verb->add_option("--rig-out", identify.rig_out,
                            "write the run's rig file to this new file, with what was determined");
  identify_verb->add_option("--target-out", identify.target_out,
                            "write the target to this new file, with its points as determined");
  identify_verb->footer(
      "Examples:\n  turntable identify results/runs/20260131T120000Z-quick\n"
      "  turntable identify results/runs/20260131T120000Z-quick --rig-out lab_identified.json "
      "--target-out target_12.json\n"
      "What the run does not determine is held at its drawing, and neither file changes it. Both "
      "name "
      "the run.\nThe lean of the stage's travel belongs to the calibration, not to a rig file: it "
      "is "
      "printed only.\n"
      "Exit code 2 if the run has too few poses.");
  identify_verb->callback([&] { code = guarded([&] { return identify_command(identify); }); });

  StudyArguments study;
  auto* study_verb = app.add_subcommand(
      "study", "How good the solvers are for a target and a camera, on synthetic points; no rig");
  study_verb->add_option(
      "--target", study.target,
      "target file, or rig file whose target is studied (default: the published target, and two "
      "more to compare with)");
  study_verb->add_option("--focal", study.focal_px, "focal length, px")
      ->check(number_in(10.0, 1e6))
      ->capture_default_str();
  study_verb
      ->add_option(
          "--image-size", study.image_size_px,
          "width,height of the image, px: the field ends at half the width; pupils walk so "
          "far over it")
      ->delimiter(',')
      ->expected(2)
      ->check(CLI::Range(16, 65536))
      ->capture_default_str();
  study_verb->add_option("--distance", study.distance_mm, "camera to target, mm")
      ->check(number_in(1.0, 1e6))
      ->capture_default_str();
  study_verb->add_option("--poses", study.poses, "per row of the noise study")
      ->check(CLI::Range(40, 1000000))
      ->capture_default_str();
  study_verb->add_option("--seed", study.seed, "of poses and noise")
      ->check(CLI::Range(std::int64_t{0}, kLargestSeed))
      ->capture_default_str();
  study_verb
      ->add_option("--solver", study.solvers,
                   "solvers to study, named as for evaluate (default: all but those on raw pixels, "
                   "which equal the undistorted ones here)")
      ->delimiter(',');
  study_verb->add_option(
      "--out", study.out,
      "folder for study.md, tables, figures (default: results/studies/<target>)");
  study_verb->footer(
      "Examples:\n  turntable study\n"
      "  turntable study --target scenarios/targets/corner_75mm.json --focal 2400 --image-size "
      "1920,1200 "
      "--distance 800 --poses 2000\n"
      "  turntable study --solver ml_ray,aopit_ray --seed 7 --out results/studies/two");
  study_verb->callback([&] { code = guarded([&] { return study_command(study); }); });

  DevicesArguments devices;
  auto* devices_verb = app.add_subcommand(
      "devices", "List serial ports, what answers there without moving it, and cameras");
  devices_verb->add_option("--port", devices.ports, "ask at this port or pty too");
  devices_verb->add_option("--tcp", devices.hosts, "ask at this serial server too, host:port");
  devices_verb->add_flag("--list", devices.listed_only, "only list, send nothing to anybody");
  devices_verb->footer(
      "Example:\n  turntable devices --tcp 10.0.0.7:4001\n"
      "Only queries are sent, to each port in every known language. Ports that another turntable "
      "has, or that are open\nexclusively, are left alone; if other instruments are connected, "
      "--list asks nobody.");
  devices_verb->callback([&] { code = guarded([&] { return devices_command(devices); }); });

  const auto by_hand = [](CLI::App& verb, HandArguments& a) {
    verb.add_option("--rig", a.rig, "rig file")->required();
    verb.add_option("--wire-log", a.wire_log, "append every byte on every line to this file");
    verb.add_option("--speed", a.speed, "of the clock, for devices served by \"simulate --speed\"")
        ->check(number_in(0.01, 100.0));
  };
  HandArguments status;
  auto* status_verb =
      app.add_subcommand("status", "Say how the controllers are set up and where the axes stand");
  by_hand(*status_verb, status);
  status_verb->footer(
      "Example:\n  turntable status --rig scenarios/rigs/lab_example.json\n"
      "Exit code 3 if the set-up differs from the rig file's. A rig in use is not asked.");
  status_verb->callback([&] { code = guarded([&] { return status_command(status); }); });

  HomeArguments home;
  auto* home_verb = app.add_subcommand("home", "Find the home switches, one axis after the other");
  home_verb->add_option("axes", home.axes, "stage, yaw, roll, pitch (default: all)");
  by_hand(*home_verb, home);
  home_verb->add_flag("--configure", home.configure,
                      "write the rig file's set-up into the controllers first");
  home_verb->footer(
      "Example:\n  turntable home yaw pitch --rig scenarios/rigs/lab_example.json\n"
      "Ctrl-C stops the axes at once.");
  home_verb->callback([&] { code = guarded([&] { return home_command(home); }); });

  MoveArguments move;
  auto* move_verb = app.add_subcommand("move", "Move axes, all at the same time");
  move_verb->add_option("targets", move.targets, "axis and value, mm or deg; several pairs")
      ->required();
  by_hand(*move_verb, move);
  move_verb->add_flag("--relative", move.relative, "values are from where the axis stands");
  auto* home_first = move_verb->add_flag("--home", move.home, "home these axes first");
  move_verb
      ->add_flag("--homed", move.homed,
                 "I vouch: homed since the controllers were switched on, nothing wrong since")
      ->excludes(home_first);
  move_verb->footer(
      "Examples:\n  turntable move yaw 10 pitch -5 --home --rig scenarios/rigs/lab_example.json\n"
      "  turntable move stage 2.5 --relative --homed --rig scenarios/rigs/lab_example.json\n"
      "Limits hold, overshoot included. Ctrl-C stops the axes at once.");
  move_verb->callback([&] { code = guarded([&] { return move_command(move); }); });

  HandArguments stop;
  std::filesystem::path run_to_stop;
  auto* stop_verb =
      app.add_subcommand("stop", "Stop all axes, and whoever moves them, also in another process");
  auto* stopped_run = stop_verb->add_option("run", run_to_stop, "run folder that is being taken");
  by_hand(*stop_verb, stop);
  stop_verb->get_option("--rig")->required(false)->excludes(stopped_run);
  stop_verb->footer(
      "Examples:\n  turntable stop --rig scenarios/rigs/lab_example.json\n"
      "  turntable stop results/runs/20260131T120000Z-quick\n"
      "Exit code 3 if anything is not known to stand.");
  stop_verb->callback([&] {
    code = guarded([&] {
      if (run_to_stop.empty() && stop.rig.empty())
        throw ConfigError("stop", "", "needs a run folder or --rig FILE.");
      return run_to_stop.empty() ? stop_command(stop) : tell_command(run_to_stop, "stop");
    });
  });

  std::filesystem::path run_to_pause;
  auto* pause_verb = app.add_subcommand(
      "pause", "Let a run that is being taken wait after its pose, until \"resume\"");
  pause_verb->add_option("run", run_to_pause, "run folder")->required();
  pause_verb->footer("Example:\n  turntable pause results/runs/20260131T120000Z-quick");
  pause_verb->callback(
      [&] { code = guarded([&] { return tell_command(run_to_pause, "pause"); }); });

  SimulateArguments simulate;
  auto* simulate_verb = app.add_subcommand(
      "simulate",
      "Serve the simulated devices of a rig in real time: controllers on ptys and TCP "
      "ports, a gige camera on loopback");
  simulate_verb->add_option("rig", simulate.rig, "rig file")->required();
  simulate_verb->add_option("--links", simulate.links,
                            "folder for links to the ptys, named after the controllers");
  simulate_verb->add_option("--faults", simulate.faults, "what is to go wrong, a fault file");
  simulate_verb->add_option("--speed", simulate.speed, "times as fast as real devices")
      ->check(number_in(0.01, 100.0));
  simulate_verb->footer(
      "Examples:\n  turntable simulate scenarios/rigs/simulated.json --links /tmp/rig\n"
      "  turntable simulate scenarios/rigs/simulated.json --links /tmp/rig --speed 10 --faults "
      "scenarios/faults/example.json");
  simulate_verb->callback([&] { code = guarded([&] { return simulate_command(simulate); }); });

  const auto measuring = [&solver_names](CLI::App& verb, AttitudeArguments& a, bool images) {
    verb.add_option("--calibration", a.calibration, "camera calibration (calibration.json)")
        ->required();
    verb.add_option("--target", a.target, "target file (scenarios/targets), or a rig file")
        ->required();
    verb.add_option("--solver", a.solver,
                    fmt::format("default {}; of {}", default_solver().name, solver_names("")));
    verb.add_option("--camera", a.camera,
                    "camera model of the calibration: irt (the rays), pinhole, brown, rational, "
                    "fisheye (default: what the solver wants)");
    verb.add_flag("--robust", a.robust,
                  "more than four points: leave out those that contradict the others");
    verb.add_option("--within", a.within_deg,
                    "look for attitudes within so many degrees of --near, up to 180: for targets "
                    "that look the same after a turn");
    verb.add_option("--near", a.near_deg, "with --within: yaw,roll,pitch, deg (default: 0,0,0)")
        ->delimiter(',');
    if (images)
      verb.add_option("--electrons-per-grey", a.electrons_per_grey,
                      "of the camera, so that shot noise counts in the uncertainties")
          ->check(number_in(0.0, 1e6));
  };
  const auto putting = [](CLI::App& verb, AttitudeArguments& a) {
    verb.add_option("--out", a.out, "file to write (default: standard output)");
    verb.add_option("--format", a.format, "csv or json")
        ->check(CLI::IsMember({"csv", "json"}))
        ->capture_default_str();
  };
  const std::string attitudes =
      R"(One line per %: status (results/README.md lists them, and every column); the target in the
plane frame as rotation vector, quaternion and yaw, roll, pitch; x, y, z of its first point there;
standard uncertainties std_*; chi2, dof, misfit; residual; in_domain (0: outside the calibrated
area); left_out (points that --robust left out, counted from 0); message.
  Pixels: u right, v down, (0, 0) is the centre of the first pixel. Plane frame: x, y in the
  calibration's plane, z towards the camera; the target's rotation in it is
  Rz(yaw) Ry(roll) Rx(pitch). std_r*_deg are of small turns about its x, y, z.
  std_* and chi2 need solver ml_ray and sigmas of the spots (column sigma_px; images state theirs).
  std_* count spots, calibration and target as far as each states its own; chi2 counts the spots.
  misfit, of every solver: squared residuals over what all three let expect (not stated: 0.1 px,
  0.1 % of the target's radius); about 1 is right, above 30 there is no attitude (does_not_fit).
  dof is 2 n - 6. residual_mm: rms distance from the rays; residual_px, of pinhole solvers: rms
  reprojection, with --camera irt that of the rays' directions.
)";
  const auto of_each = [&attitudes](const std::string& what) {
    std::string text = attitudes;
    return text.replace(text.find('%'), 1, what);
  };

  SolveArguments solve;
  auto* solve_verb = app.add_subcommand("solve", "Attitudes from a table of image points");
  solve_verb
      ->add_option("points", solve.points,
                   "CSV with columns u_px, v_px; optional frame, point (from 0; without it spots "
                   "are in any order), sigma_px; - = standard input")
      ->required();
  measuring(*solve_verb, solve, false);
  putting(*solve_verb, solve);
  solve_verb->footer(
      "Examples:\n  turntable solve points.csv --calibration calibration.json --target "
      "scenarios/targets/published.json\n"
      "  turntable solve points.csv --calibration calibration.json --target rig.json --solver "
      "posit "
      "--camera irt --format json\n\n" +
      of_each("frame") +
      "Exit codes: 0 done; 2 bad input; 3 the output could not be written; 4 some frames have no "
      "attitude; 130 interrupted,\nthe frames done are written.\n");
  solve_verb->callback([&] { code = guarded([&] { return solve_command(solve); }); });

  MeasureArguments measure;
  auto* measure_verb = app.add_subcommand("measure", "Attitudes from images of the target");
  measure_verb->add_option("images", measure.images, "images, or folders of them")->required();
  measuring(*measure_verb, measure, true);
  putting(*measure_verb, measure);
  measure_verb->footer(
      "Examples:\n  turntable measure shot.png --calibration calibration.json --target "
      "scenarios/targets/published.json\n"
      "  turntable measure shots/ --calibration calibration.json --target rig.json --out "
      "attitudes.csv\n\n" +
      of_each("image") +
      "Exit codes: 0 done; 2 bad input; 3 the output could not be written; 4 some images have no "
      "attitude; 130 interrupted,\nthe images done are written.\n");
  measure_verb->callback([&] { code = guarded([&] { return measure_command(measure); }); });

  TrackArguments track;
  auto* track_verb = app.add_subcommand(
      "track", "Follow the target live: one line per frame of a camera or folder");
  track_verb
      ->add_option("source", track.source,
                   "folder of images, or rig file (its camera alone is opened; no axis is touched)")
      ->required();
  measuring(*track_verb, track, true);
  track_verb->add_option("--frames", track.frames, "end after so many (default: all)")
      ->check(CLI::Range(1, 1000000000));
  track_verb->add_flag("--follow", track.follow, "folder: wait for new images until Ctrl-C");
  track_verb->footer(
      "Examples:\n  turntable track shots/ --follow --calibration calibration.json --target "
      "scenarios/targets/published.json\n"
      "  turntable track scenarios/rigs/lab_modbus_gige.json --frames 1000 --calibration "
      "calibration.json --target rig.json\n\n" +
      of_each("frame") +
      "With time and latency_ms (image in memory to attitude). Ctrl-C ends with exit code 0.\n"
      "Exit codes: 0 done; 2 bad input; 3 camera trouble, or the output could not be "
      "written;\n4 some frames have no attitude.\n");
  track_verb->callback([&] { code = guarded([&] { return track_command(track); }); });

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    const int parsed = app.exit(e);
    return parsed == 0 ? kDone : kBadInput;
  }
  return code;
}
