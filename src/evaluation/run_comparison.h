// Two runs side by side, before and after a change: what differs between them, and what that made of
// the errors. Poses are matched by scenario name, role, repeat and the angles and place that they were
// sent to, never by their number; of several visits of one place the first with the first.
//   change = RMSE(other) - RMSE(first), below zero: the other run is better
// It is taken over pairs of poses that both runs have measured, if at least half of the poses that the
// run with fewer has measured have a partner; else over all poses of either run, unpaired. Intervals
// are 95 %, by drawing angles again, each with its poses of both runs (clustered_bootstrap.h): errors
// that angles share are in them, those that a whole run shares (calibration, initial pose) are not.
// Where a run has measured no pose of a scenario, nothing is compared and every change is NaN.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "src/core/json_document.h"
#include "src/evaluation/evaluate.h"
#include "src/evaluation/scenario_statistics.h"

namespace turntable {

/// How much of a scenario both runs have: poses to be judged, as planned.
struct CommonScenario {
  std::string name;
  std::size_t both = 0, only_first = 0, only_other = 0;
};

struct RunChange {
  std::string scenario;
  const Solver* solver = nullptr;
  bool paired = false;
  std::size_t first_poses = 0, other_poses = 0;    ///< that the RMSEs are over
  std::size_t first_failed = 0, other_failed = 0;  ///< of all poses of the scenario: no attitude
  double first_rmse_deg = Solution::kNaN, other_rmse_deg = Solution::kNaN;
  WithInterval change_deg{};
  WithInterval change_share{};  ///< of the first RMSE: RMSE(other) / RMSE(first) - 1
  std::array<WithInterval, 3> bias_change_deg{};  ///< change of the mean error, by `kToldAxes`
  ChangeVerdict verdict() const { return change_verdict(change_share, 1.0); }
};

struct RunComparison {
  std::vector<CommonScenario> scenarios;
  std::vector<std::string> only_first, only_other;  ///< scenarios, and "solver <name>"
  std::vector<RunChange> changes;                   ///< by scenario of the first run, then solver
};

/// @param first, other with the plans that they are of
RunComparison compare_runs(const Evaluation& first, const Plan& first_plan, const Evaluation& other,
                           const Plan& other_plan);

/// Something that is not the same in two runs.
struct RunFact {
  std::string what;   ///< "rig file", "scenario", "calibration", "program"
  std::string place;  ///< JSON pointer, or the name of what differs
  std::string first, other;
};

/// Where two values of JSON differ, by JSON pointer in their order; "-" for what one of them lacks.
std::vector<RunFact> json_differences(const std::string& what, const Json& first,
                                      const Json& other);

/// What the plans tell: every field of the rig files, and scenario files by name and SHA-256.
/// @throws ConfigError: a rig file that is no JSON.
std::vector<RunFact> plan_differences(const Plan& first, const Plan& other);

}  // namespace turntable
