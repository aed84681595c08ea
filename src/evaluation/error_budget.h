// Where each hundredth of a degree comes from: an uncertainty budget of the total RMSE, for every
// scenario and solver, at level "as published".
//   e_k      error of pose k against the initial pose of its repeat, as a solver gives it (statistics.h)
//   A_k      d e_k / d (image points of pose k), A'_k likewise of the initial pose; central differences
//   e_k(j)   = A_k du_k(j) + A'_k du_0(j), du the image points' shift by one unit of value j (RigModel)
//   line     of values:  mean square over poses = sum_j sd_j^2 mean_k e_k(j)^2
//            of noise:   mean square            = mean_k (sum sigma^2 |A_k|^2 + the same of A'_k)
//   built to the drawings  = root of the sum of all mean squares                (GUM, JCGM 100:2008, 5.1.2)
//   cross-check            = total RMSE of rigs drawn from the same tolerances, images, solver and all,
//                            nothing linearised                                 (JCGM 101:2008, 7)
// Beside it, what this rig turned out to be: the same lines with the values that self-calibration found,
//   e_k(line) = sum_j (value_j - drawing_j) e_k(j),  and e_k of all of them together, not linearised
// These are numbers and no tolerances: they add up pose by pose and may cancel.
//   predicted total  = root of (mean_k e_k^2 of all together + mean squares of the noise lines)
// Units: deg. Domain: poses with matched image points; a pose that a solver fails is in none
// of its lines.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "src/evaluation/cross_validation.h"
#include "src/evaluation/evaluate.h"
#include "src/evaluation/rig_model.h"
#include "src/evaluation/scenario_statistics.h"

namespace turntable {

enum class Cause {
  kCamera,          ///< what camera model and solver make of perfect image points
  kSpots,           ///< noise of the image points
  kRays,            ///< what the calibration leaves unknown of the rays
  kTarget,          ///< LEDs against their drawing
  kTargetMounting,  ///< target turned on its table
  kAlignment,       ///< gimbal against the plane frame
  kAxes,            ///< angles between the rotary axes
  kStage,           ///< squareness and scale of the stage
  kPlace,           ///< where the target is
  kRepeatability,   ///< random part of each arrival
  kBacklash,        ///< direction of approach
  kQuantisation,    ///< pulses
};
inline constexpr int kCauses = 12;
/// "target geometry".
std::string_view cause_name(Cause cause);

/// Root mean square over poses.
struct Contribution {
  std::array<double, 3> axis_deg{};  ///< by `kToldAxes`
  double total_deg() const;          ///< root of the sum of squares
};

struct BudgetLine {
  Cause cause{};
  std::string amount;  ///< "0.1 mm (/tolerances/target_mm)": how much, and who says so
  Contribution drawn;  ///< as its tolerance lets expect
  std::optional<Contribution>
      found;  ///< as found in this run; the noise lines are the same in both
};

struct ErrorBudget {
  std::size_t scenario = 0;
  const Solver* solver = nullptr;
  std::size_t poses = 0;              ///< that it is of
  std::size_t left_out = 0;           ///< measured, but the solver jumps near them: no derivative
  std::vector<BudgetLine> lines;      ///< by Cause
  Contribution drawn;                 ///< all lines together
  WithInterval monte_carlo_deg{};     ///< rms total RMSE of drawn rigs, and where 95 % of them are
  std::optional<Contribution> found;  ///< predicted of this rig
  Contribution observed;              ///< the table's, over the same poses
};

/// Steps done and their number.
using BudgetProgress = std::function<void(std::size_t done, std::size_t total)>;

struct BudgetInput {
  const RunRecord& record;
  const RigFile& rig;
  const Calibration& calibration;
  const Evaluation& evaluation;  ///< as published
  const RigModel& model;
  /// What self-calibration found; nothing: the lines have no `found`.
  std::optional<Eigen::VectorXd> values;
  /// Root mean square of what the direction of approach does, by scenario and `kToldAxes`, deg
  /// (`backlash_found`).
  std::map<std::size_t, std::array<double, 3>> backlash_deg;
  BudgetProgress progress;
};

/// Rigs that the cross-check draws, and poses of each scenario that it takes.
constexpr int kBudgetDraws = 200;
constexpr std::size_t kBudgetPoses = 60;

/// One per scenario and solver of the evaluation that is there by default (every one, if none is).
/// Parallel; the same for any number of threads.
std::vector<ErrorBudget> error_budgets(const BudgetInput& input);

/// The backlash that is left in the self-calibrated errors: the slope h of the least-squares line of an
/// axis' error against d = direction of approach of the pose minus that of its initial pose, which
/// differ by 0, 1 or 2; |h| times the root mean square of d. Zero where h is within three standard
/// errors of zero. Of the last solver of the table; by scenario and `kToldAxes`, deg.
std::map<std::size_t, std::array<double, 3>> backlash_found(const Evaluation& evaluation,
                                                            const CrossValidation& judged);

/// The same with what the levels of truth found, if they found anything.
std::vector<ErrorBudget> error_budgets(const RunRecord& record, const RigFile& rig,
                                       const Calibration& calibration, const Evaluation& evaluation,
                                       const TruthLevels& levels,
                                       const BudgetProgress& progress = {});

}  // namespace turntable
