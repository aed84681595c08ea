// What a scenario's repeats say together, beyond the tables of the paper: intervals, percentiles,
// repeatability, the direction of approach, whether one solver is really better than another, and,
// where one axis turns, the quantities of ISO 230-2.
//   e^2 of a pose          = pitch^2 + roll^2 + yaw^2 error            (statistics.h)
//   repeatability          = sqrt(sum (e - mean of the same angles)^2 / sum (n - 1))    per axis
//   forward - backward     = e where the axis last moved up less e where it last moved down, at the same
//                            angles; if none were come to both ways, at the same angle of that axis
//                            (direction_effect.h, which has its own interval)
//   change of B against A  = RMSE(B) - RMSE(A), over the poses that both have measured
// Other intervals are 95 %, by drawing angles again with replacement, each with all of its repeats, which
// share their systematic error (cluster bootstrap; A. C. Davison, D. V. Hinkley, Bootstrap Methods
// and their Application, 1997, 3.8). The initial pose of a repeat is in all of its errors alike: the
// repeatability counts it, no interval does.
// They work on any level of truth: errors are those in `Evaluation`. Degrees; NaN where there is
// nothing to state.
#pragma once

#include <array>
#include <optional>
#include <string_view>
#include <vector>

#include "src/evaluation/evaluate.h"
#include "src/evaluation/statistics.h"

namespace turntable {

/// The order in which axes are told: x, y, z of the paper.
inline constexpr std::array kToldAxes{AxisId::kPitch, AxisId::kRoll, AxisId::kYaw};

/// How each told axis last moved before a pose, by the commands: +1 up, -1 down, 0 not yet. By place in
/// `Evaluation::poses`.
std::vector<std::array<int, 3>> approach_directions(const Evaluation& evaluation);

struct AxisDetail {
  double percentile95_deg;                    ///< of |e|
  double repeatability_deg = Solution::kNaN;  ///< NaN unless some angles were visited twice
  WithInterval forward_minus_backward_deg;    ///< NaN unless some angle was come to both ways
};

struct ScenarioStatistics {
  std::size_t scenario = 0;
  const Solver* solver = nullptr;
  int repeats = 0;
  ErrorStatistics pooled;  ///< over all repeats
  WithInterval rmse_total_deg;
  std::array<AxisDetail, 3> axes;  ///< by `kToldAxes`
};

/// One per attitude scenario and solver, in the order of plan and table.
std::vector<ScenarioStatistics> scenario_statistics(const Evaluation& evaluation);

/// What a change of an RMSE says of the one that has changed.
enum class ChangeVerdict { kBetter, kWorse, kSame, kCannotTell, kTooFew, kNothing };
/// By the interval alone: it must not hold zero; the same if it lies within 1 % of `first`, the RMSE
/// before the change; too few if there is no interval, nothing if there is no change, for want of poses.
ChangeVerdict change_verdict(const WithInterval& change, double first);
/// "better", "worse", "the same within 1 %", "not told apart", "too few poses", "not compared"
std::string_view change_verdict_name(ChangeVerdict verdict);

/// Is `other` better than `first`?
struct PairedComparison {
  std::size_t scenario = 0;
  const Solver* first = nullptr;
  const Solver* other = nullptr;
  std::size_t poses = 0;       ///< that both have measured
  std::size_t only_first = 0;  ///< measured by one of the two only: not compared, but counted
  std::size_t only_other = 0;
  WithInterval change_deg;                     ///< below zero: `other` is better
  double share_other_nearer = Solution::kNaN;  ///< of the poses, in [0, 1]; NaN of none

  double first_rmse_deg = Solution::kNaN;  ///< over the same poses

  using Verdict = ChangeVerdict;
  Verdict verdict() const { return change_verdict(change_deg, first_rmse_deg); }
};

/// Every pair of solvers of every scenario.
std::vector<PairedComparison> paired_comparisons(const Evaluation& evaluation);

/// ISO 230-2:2014, 2.11 to 2.23, of a rotary axis that turns alone: deviations of the measured from the
/// commanded angle (as read back), s the estimator of standard deviation over approaches of the same
/// direction. The standard asks for five approaches; `approaches` says how many there were.
struct Iso230 {
  std::size_t scenario = 0;
  const Solver* solver = nullptr;
  AxisId axis{};
  std::size_t positions = 0;
  int approaches = 0;  ///< fewest of one position and direction
  bool bidirectional = false;
  /// A, E and M are ranges over positions: NaN of a single one.
  double accuracy_deg = Solution::kNaN;    ///< A, or A of the one direction there is
  double systematic_deg = Solution::kNaN;  ///< E
  double mean_range_deg =
      Solution::kNaN;  ///< M, of the mean bidirectional deviations; NaN of one direction
  double repeatability_deg =
      Solution::kNaN;  ///< R, the largest 4 s, or 2 s + 2 s + |B|; NaN of a single approach
  double reversal_deg = Solution::kNaN;  ///< B, largest |B_i|; NaN of one direction
};

/// Of scenarios with one axis, for every solver.
std::vector<Iso230> iso230(const Evaluation& evaluation, const Plan& plan);

}  // namespace turntable
