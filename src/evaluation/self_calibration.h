// The rig estimated from a campaign: every value of `RigModel`, and the random error of every arrival
// of an axis, by least squares over all LEDs of all poses:
//   minimise  sum |r_ki|^2 / f^2 + sum ((v - drawing) / sd)^2 + sum e^2
//   r_ki      miss of LED i from its ray at pose k, in standard deviations of its spot (ray_residual.h)
//   e         error of an arrival in its standard deviations, shared by all poses taken until the
//             axis moves again
//   f         noise factor: root of chi2 over degrees of freedom, where it is above 1 (Birge 1932), or
//             at any value where the spots' uncertainty is only assumed
// Levenberg-Marquardt by Ceres (http://ceres-solver.org); J of the linearised model:
//   covariance = (J^T J)^-1, priors and arrivals included: the GUM's (JCGM 100:2008) combination of
//   what drawings state and what images say
// Source: mathematics of the rig, section 7; R. T. Birge, Phys. Rev. 40 (1932) 207.
// Units: those of RigModel. Domain: errors within several tolerances of the drawings.
//
// What the camera is uncertain by is not in these uncertainties. Above all, the plane frame is where the
// pattern lay in its sweep, and that arrival of the rotary axes had an error too: it is in X and in the
// stage's squareness, as the errors of the stage's arrivals at the pattern's planes are in its scale.
//
// A value of which the images say next to nothing (standard uncertainty above kHeldAbove of its prior)
// is not determined: it is held at its drawing, keeps its prior, and the others are estimated with it
// there; their uncertainties still count that it may be elsewhere.
#pragma once

#include <string_view>
#include <vector>

#include "src/attitude/solver.h"
#include "src/evaluation/evaluate.h"
#include "src/evaluation/rig_model.h"

namespace turntable {

/// One image of the target, as self-calibration takes it.
struct RigSighting {
  TablePosition at;                ///< read back
  ArrivalNumbers arrivals{};       ///< `arrival_numbers`
  std::vector<Ray> rays;           ///< one per LED
  std::vector<RaySpread> spreads;  ///< likewise
};

/// What self-calibration sees of a run.
struct RigSightings {
  RayPlanes planes;
  std::vector<RigSighting> poses;
  std::vector<std::size_t> places;  ///< of each in Evaluation::poses
  bool noise_stated = true;  ///< false: spots have kAssumedSpotSigmaPx, for want of anything better
};
/// Of every pose whose LEDs were all matched inside the calibrated area and whose axes arrived.
RigSightings rig_sightings(const RunRecord& record, const RigFile& rig,
                           const Calibration& calibration, const Evaluation& evaluation);

constexpr double kHeldAbove = 0.9;
constexpr double kWeakAbove = 0.5;

enum class Verdict {
  kDetermined,
  kWeak,  ///< standard uncertainty above kWeakAbove of the prior's: the drawing still matters
  kHeld,  ///< above kHeldAbove of it: not determined, held at the drawing
};
std::string_view verdict_name(Verdict verdict);  ///< "determined", "weakly determined", "held"

/// Twice the stated noise of the spots: twenty-odd percent is what statements of noise miss by.
constexpr double kMisfitAbove = 2.0;

struct SelfCalibration {
  Eigen::VectorXd values;       ///< by `RigModel::parameters`
  Eigen::VectorXd sd;           ///< standard uncertainties, likewise
  Eigen::MatrixXd correlation;  ///< likewise
  std::vector<Verdict> verdicts;
  std::size_t poses = 0, arrivals = 0;  ///< that entered; errors of arrivals that were estimated
  int iterations = 0;
  bool converged = false;
  double chi2 = 0.0;  ///< with the stated uncertainties, f = 1
  double dof = 0.0;   ///< image residuals: values and arrivals have one prior each
  double noise_factor =
      1.0;  ///< f, by which chi2 comes to dof; arrivals keep what is stated of them
  bool noise_stated = true;  ///< else f is of an assumed one

  /// Whether the run shows what no parameter describes, as a periodic error of an axis.
  bool has_misfit() const { return noise_stated && noise_factor > kMisfitAbove; }
  bool held(Eigen::Index i) const {
    return verdicts[static_cast<std::size_t>(i)] == Verdict::kHeld;
  }
};

/// Fewest poses that self-calibration is tried with.
constexpr std::size_t kMinSightings = 10;

/// Deterministic, in one thread.
/// @param use which poses of `sightings`; empty: all
/// @throws Error: fewer than kMinSightings poses.
SelfCalibration self_calibrate(const RigModel& model, const RigSightings& sightings,
                               std::span<const std::size_t> use = {});

/// The values alone, from some of the poses, with those held and the noise factor that all the poses
/// have given: what cross-validation does again and again.
Eigen::VectorXd recalibrate(const RigModel& model, const RigSightings& sightings,
                            std::span<const std::size_t> use, const SelfCalibration& whole);

}  // namespace turntable
