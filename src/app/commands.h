// The verbs of the command line. Each returns an exit code and throws for everything that main
// turns into one.
#pragma once

#include <filesystem>
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
  std::filesystem::path scenario, rig, csv, out;
  std::filesystem::path calibration;
  std::string images = "regions";
};
int plan_command(const PlanArguments& a);

struct RunArguments {
  std::filesystem::path scenario, rig, out, calibration, wire_log;
  std::vector<std::string> solvers;
  std::string images = "regions";
  bool dry_run = false, configure = false, assume_mounted = false;
};
int run_command(const RunArguments& a);

struct CalibrateArguments {
  std::filesystem::path source;  ///< run folder, calibration scenario, or calibration file
  std::filesystem::path rig, out;
  int order = 0;
};
int calibrate_command(const CalibrateArguments& a);

struct EvaluateArguments {
  std::filesystem::path run, calibration;
  std::vector<std::string> solvers;
};
int evaluate_command(const EvaluateArguments& a);

int report_command(const std::vector<std::filesystem::path>& runs);

struct SimulateArguments {
  std::filesystem::path rig, links;
};
int simulate_command(const SimulateArguments& a);

}  // namespace turntable
