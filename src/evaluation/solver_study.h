// How good the solvers of the table are for a target and a camera, before anybody builds a rig.
// Synthetic, at point level (src/attitude/scene.h): no images, no calibration errors, no wrong matches.
//
// Judged over N poses, per solver, with e the geodesic angle to the truth and b the Cramer-Rao bound
// of the same pose with the true Jacobians of the lens (both deg):
//   RMSE = sqrt(mean e^2),  bound = sqrt(mean b^2)   over the poses with an attitude
//   RMSE / bound with its 95 % interval (bootstrap_interval of the poses, both sums together)
//   normalised squared error  mean delta^T C^-1 delta,  exp([delta]x) R the true rotation, C the
//   solver's own covariance: 3 if C is right (Bar-Shalom, Li & Kirubarajan 2001, section 5.4)
//   median and 95 % quantile of e, and the share of the sum of e^2 that the worst hundredth of the
//   poses has: where it is large, an RMSE is made by a few poses, and neither fewer poses nor their
//   bootstrap know of those that were not drawn
// Success in the study of the basin: an attitude with e <= 10 deg. The limit is the same for every
// noise, since one that grows with the bound lets a poor solver look better in worse images; so noise
// alone fails solvers where b is not well below it (`kNoiseAlone_deg`).
//
// Every pose and its noise are addressed by (seed, what, index): the same for every solver, lens and
// noise, and whatever the number of threads.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "src/attitude/scene.h"
#include "src/evaluation/statistics.h"

namespace turntable {

/// Where the target stands: M0 on the axis half-way between the planes and up to so far from there;
/// the target's z is its face, and the view angle is between z and the camera's axis.
struct PoseRange {
  std::string name;
  double view_low_deg = 0.0, view_high_deg = 35.0;  ///< tilt about any horizontal axis
  double turn_deg = 0.0, turn_spread_deg = 180.0;   ///< about the plane's z, before the tilt
  bool quarter_turns = false;                       ///< turns are exact multiples of 90 deg
  double lateral_mm = 50.0, along_mm = 30.0;        ///< of M0, each way
};

/// What a set of poses is drawn from.
struct StudySetting {
  std::string target;
  std::vector<Vector3d> target_mm;
  PoseRange poses;
  SceneLens lens;
  double noise_px = 0.05;  ///< standard deviation of each image coordinate; 0 = none
};

/// Scene `index` of a setting. Depends on seed, index, the pose range's name and the target's.
TargetScene study_scene(const StudySetting& setting, std::uint64_t seed, std::uint64_t index);

constexpr double kFlipped_deg = 10.0;
/// An rms bound from which noise alone begins to fail a perfect solver: 10 deg are four times it.
constexpr double kNoiseAlone_deg = kFlipped_deg / 4.0;

struct Judgement {
  std::size_t poses = 0;
  std::size_t no_attitude = 0;
  std::size_t flipped = 0;  ///< wrong by more than `kFlipped_deg`
  double rmse_deg = Solution::kNaN;
  double bound_deg = Solution::kNaN;
  double over_bound = Solution::kNaN;  ///< NaN without noise
  Interval over_bound_95{Solution::kNaN, Solution::kNaN};
  double median_deg = Solution::kNaN;
  double percentile95_deg = Solution::kNaN;
  double largest_deg = Solution::kNaN;
  /// Of the sum of squared errors, in [0, 1]: what the worst hundredth of the poses (at least one) has.
  double worst_share = Solution::kNaN;
  double squared_error = Solution::kNaN;  ///< normalised; NaN for solvers without a covariance
  Interval squared_error_95{Solution::kNaN, Solution::kNaN};

  /// More than a third of the sum of squares is the worst hundredth's; Gaussian errors give it a
  /// tenth at most.
  bool heavy_tail() const { return worst_share > 1.0 / 3.0; }
  std::size_t success() const { return poses - no_attitude - flipped; }
  double success_rate() const {
    return poses == 0 ? 0.0 : static_cast<double>(success()) / static_cast<double>(poses);
  }
  /// Wilson's 95 % interval (1927).
  Interval success_95() const;
};

/// @param resamples of the bootstrap; 0 = no intervals. @param done called with the number of poses
/// that were finished, from any thread. @return one per solver.
std::vector<Judgement> judge_solvers(const StudySetting& setting,
                                     std::span<const Solver* const> solvers, std::size_t poses,
                                     std::uint64_t seed, int resamples,
                                     const std::function<void(std::size_t)>& done = {});

struct StudyOptions {
  std::string target = "default";
  std::vector<Vector3d> target_mm = default_target();
  /// Also the 75 mm corner target at 1 m and a target along the axes, to compare with others.
  bool reference_targets = true;
  double focal_px = 1945.0;
  double half_field_px = 512.0;  ///< from the principal point to the edge of the image
  double distance_mm = 550.0;    ///< camera to M0, half-way between the planes and around it
  /// Per row of the noise study; a tenth in the basin, a fortieth in maps.
  std::size_t poses = 10000;
  std::uint64_t seed = 1;
  std::vector<const Solver*> solvers;
};

/// Lenses of the noise study: pupil walk from the axis to the image's edge, mm.
constexpr double kStudyWalks_mm[] = {0.0, 2.0, 12.0, 30.0};
constexpr double kStudyNoises_px[] = {0.05, 0.5};

/// All rows whose answers differ at point level: without distortion `kPinholeRaw` is
/// `kPinholeUndistorted`.
std::vector<const Solver*> study_solvers();

/// Target x pose range x lens x noise.
std::vector<StudySetting> noise_settings(const StudyOptions& options);

struct NoiseRow {
  StudySetting setting;
  double walk_mm;
  std::vector<Judgement> judgements;  ///< per solver
};

enum class Factor { kViewAngle, kDistance, kDepth, kNoise };
constexpr Factor kFactors[] = {Factor::kViewAngle, Factor::kDistance, Factor::kDepth,
                               Factor::kNoise};
std::string_view factor_name(Factor factor);   ///< "view_angle", "distance", "depth_ratio", "noise"
std::string_view factor_unit(Factor factor);   ///< "deg", "mm", "1", "px"
std::string_view factor_label(Factor factor);  ///< with its unit, for axes and headers

/// Around a centre: view angle 30 deg, the options' distance, the target as it is, 0.5 px, central
/// lens. The depth ratio is the target's extent along its z over the largest distance of a point from
/// M0 across it; the target is stretched along z.
StudySetting basin_centre(const StudyOptions& options);
double depth_ratio(std::span<const Vector3d> target_mm);
std::vector<double> factor_values(Factor factor, const StudyOptions& options);
/// Sets one factor. Distances keep the target's place in the image.
void set_factor(StudySetting& setting, Factor factor, double value);

struct BasinRow {
  Factor factor;
  double value;
  std::vector<Judgement> judgements;
};

struct MapRow {
  double view_deg, depth_ratio;
  std::vector<Judgement> judgements;
};

struct SolverStudy {
  StudyOptions options;
  std::vector<NoiseRow> noise;
  std::vector<BasinRow> basin;
  std::vector<MapRow> map;  ///< empty for a target without depth, which cannot be stretched
  std::size_t basin_poses = 0, map_poses = 0;
};

using StudyProgress = std::function<void(std::size_t done, std::size_t total)>;

/// On all cores. `options.solvers` empty = `study_solvers()`.
SolverStudy study(StudyOptions options, const StudyProgress& progress = {});

}  // namespace turntable
