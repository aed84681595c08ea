// The three levels of truth side by side, judged on poses that had no part in the estimate: in each of
// some folds alignment and self-calibration use the other folds' poses, and errors are taken on the
// held-out ones.
//
// Folds are made of whole arrivals of the outermost axis that a scenario turns: all poses that share
// the random error of such an arrival are held out together. Single poses drawn at random would share
// it with poses that were used: the estimate could follow an error that is none of the rig's, and would
// be praised for it. Which arrivals go together is drawn, with a seed of its own, so that no fold loses
// one end of a range.
//
// At level "self-calibrated" solvers get the estimated target and, where the calibration was made on
// the stage, a camera without the stage's lean; the truth is the estimated gimbal at the read-back
// angles. At each level errors are relative to the initial pose (statistics.h).
//
// Bound (Cramer-Rao, of unbiased estimates from one image and one initial image): with C_k of the pose
// by maximum likelihood from its spots' noise (ml_ray.h) and R = R_k R_0^T
//   C_rel = C_k + R C_0 R^T,   axis errors: diag(E C_rel E^T),   E = d Euler / d delta
// and, where repeatability is counted, with the turntable's own arrival errors on top: those that k and
// 0 share act by their difference alone.
// Source: mathematics of the rig, sections 6 to 8. Units: deg.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "src/evaluation/scenario_statistics.h"
#include "src/evaluation/self_calibration.h"
#include "src/evaluation/truth.h"

namespace turntable {

/// One scenario, solver and level: held-out poses of all repeats together.
struct LevelRow {
  std::size_t scenario = 0;
  const Solver* solver = nullptr;
  TruthLevel level{};
  ErrorStatistics statistics;  ///< poses: those that are judged; failed: without attitude here
};

/// What the noise of spots allows, as RMSE; deg.
struct LevelBound {
  std::size_t scenario = 0;
  std::size_t poses = 0;     ///< as judged
  std::size_t left_out = 0;  ///< of the scenario: not matched, outside the domain, an axis missed
  double pitch_deg = 0.0, roll_deg = 0.0, yaw_deg = 0.0, total_deg = 0.0;
  double total_with_repeatability_deg = 0.0;
};

struct CrossValidation {
  int folds = 0;
  std::size_t groups = 0;          ///< arrivals that were dealt out
  std::vector<LevelRow> rows;      ///< by scenario, solver, level
  std::vector<LevelBound> bounds;  ///< by scenario

  /// Errors by level (kTruthLevels), solver, and place in `poses`; nothing without an attitude.
  std::array<std::vector<std::vector<std::optional<PoseError>>>, std::size(kTruthLevels)> errors;
  std::vector<std::size_t> poses;  ///< that are judged: places in Evaluation::poses
};

/// The evaluation with the held-out errors of one level: what any statistic can be taken of. Poses
/// that are not judged are not in it, but reference poses are.
Evaluation at_level(const Evaluation& evaluation, const CrossValidation& judged, TruthLevel level);

/// Five, or as many as there are arrivals to deal out.
constexpr int kFolds = 5;

/// @param whole of all the sightings: what it holds is held in each fold
/// @throws Error: fewer than two arrivals to deal out, or too few poses in a fold.
CrossValidation cross_validate(const Plan& plan, const RigFile& rig, const Calibration& calibration,
                               const Evaluation& evaluation, const RigModel& model,
                               const RigSightings& sightings, const SelfCalibration& whole);

/// Statistics at one level of truth.
struct LevelStatistics {
  TruthLevel level{};
  std::vector<ScenarioStatistics> scenarios;
  std::vector<PairedComparison> pairs;
};

/// Everything that a run tells about its rig.
struct TruthLevels {
  std::optional<RigModel> model;  ///< nothing where the run is too small: `why_not`
  SelfCalibration found;          ///< of all the poses
  CrossValidation judged;         ///< no rows where it cannot be done: `why_not`
  std::string why_not;            ///< what is missing and why, a sentence; empty if nothing is
};
TruthLevels truth_levels(const RunRecord& record, const RigFile& rig,
                         const Calibration& calibration, const Evaluation& evaluation);

/// As published over all poses; the others, if there are any, over the held-out poses that they are
/// judged on.
std::vector<LevelStatistics> level_statistics(const Evaluation& evaluation,
                                              const TruthLevels& levels);

}  // namespace turntable
