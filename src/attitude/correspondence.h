// Which spot is which point of the target, without a prediction: hypotheses from three points,
// judged by the rays of all.
//   1. Hypothesis: three points of the target against every ordered triple of spots (P3P, p3p.h).
//   2. Pruning: the tilt, the turn and the height that are allowed; every other point must have a
//      spot near where the hypothesis puts it.
//   3. Fit to four points, then to all that are matched (R, T by Levenberg-Marquardt):
//        S = sum_t |r_t|^2,  r_t = perpendicular miss of R P_t + T from its ray, mm
//      and the fit is acceptable if S / sigma^2 is below the 0.9999 quantile of chi^2, 2k - 6
//      degrees of freedom for k points; points join it within 5 sigma of the fit before.
//   4. Rank by Q = S / sigma^2 + 25 (n - k): a hidden point costs what one at the gate would.
//   5. Chance: random spots over an area A would fit k points this well, on the average,
//        2 (n - k_min + 1) C(n, k) m!/(m-k)! (pi S / A)^(k-3) / (k-3)!
//      times, for m spots, n points: the volume of the ball of misses in the k - 3 points that the
//      pose does not absorb, for each number of points from k_min = `min_points` on.
// Sources: Fischler & Bolles, CACM 24 (1981) 381-395 (poses from the fewest points, judged by the
// others); Moisan & Stival, IJCV 57 (2004) 201-218 (number of false alarms). S is a least-squares
// minimum because the test needs one: the fixed point of AOPIT is not, and it hangs on M0's ray,
// while M0 may be hidden here. Symbols:
//   P_t -> target.points(), mm    A -> bounding box of the spots half-way between the planes, mm^2
//
// Ambiguity. A different assignment is one that gives some point another spot. It rivals the best
// if Q_second - Q_best < 16 max(1, s^2), s^2 being the best's own S / (sigma^2 dof): less than four
// standard deviations apart, with sigma as the caller or as the best fit says, whichever is larger.
// For four points seen this is rms_second < 4 rms_best at most, and rms_second < 2 sigma at least.
// Chance above `max_chance` is ambiguous as well. Points whose spots may be exchanged without harm
// to the fit are ambiguous although the pose is hardly touched: compare the two poses.
//
// Work: at most 48 spots are looked at, the first ones (brightest first is the detector's order);
// when no point may be hidden one triple of points decides, 48^3 hypotheses of about 1 us. When
// points may be hidden, triples of points are tried until a fit leaves no doubt or a million
// hypotheses are spent: complete up to 8 points; beyond, a fit is missed if every triple tried has
// a hidden point.
//
// Domain: targets that are not coplanar and whose +z side shines at the camera, and
// bundles that nearly meet in one point at z above the target, or are parallel; what they miss it
// by at the target widens the search, and the fit uses the rays as they are. Outside: rays that
// diverge towards +z, and matched points that are coplanar, are kNoFit. Rays that are not finite
// are spots of no point. Parallel rays leave position z undefined (NaN).
#pragma once

#include <limits>
#include <numbers>
#include <span>
#include <string_view>
#include <vector>

#include "src/attitude/target.h"
#include "src/geometry/ray.h"

namespace turntable {

enum class CorrespondenceStatus { kMatched, kAmbiguous, kTooFewSpots, kNoFit };
/// "matched", "ambiguous", "too_few_spots", "no_fit".
std::string_view correspondence_status_name(CorrespondenceStatus status);

/// Spots that are looked at; further ones are left out.
constexpr int kMaxCorrespondenceSpots = 48;

struct CorrespondenceOptions {
  /// Standard deviation of each coordinate of a ray where it passes the target, mm; positive. What
  /// the target's points are wrong by counts too: too small a value makes nearly symmetric targets
  /// look certain.
  double sigma_mm = 0.02;
  /// Points that must be seen, 4 or more; 0 asks for all of them.
  int min_points = 0;
  /// Accidental fits as good as the best that random spots may be expected to make.
  double max_chance = 0.01;
  /// Largest angle between the target's z axis, along which its LEDs shine, and the plane's.
  double max_tilt_rad = 0.5 * std::numbers::pi;
  /// Attitudes within `max_turn_rad` of `R_near` are looked for; pi allows every one. A target with
  /// a symmetry needs this.
  Matrix3d R_near = Matrix3d::Identity();
  double max_turn_rad = std::numbers::pi;
  /// Range of the position's z, mm.
  double min_height_mm = -std::numeric_limits<double>::infinity();
  double max_height_mm = std::numeric_limits<double>::infinity();
};

/// One assignment and the pose that explains it best.
struct AssignedPose {
  std::vector<int> spot_of_point;  ///< index into the rays per point; -1: not seen
  Matrix3d R_plane_from_target;
  Vector3d position_mm;  ///< of the target's first point, plane frame, as in Solution
  double rms_mm = 0.0;   ///< of the misses |r_t| of the matched points
};

struct Correspondence {
  CorrespondenceStatus status = CorrespondenceStatus::kTooFewSpots;
  /// Best first, then the best different one that is known: the rival if ambiguous, the margin if
  /// matched. Empty if there is no acceptable fit; one if nothing else came near.
  std::vector<AssignedPose> ranked;
  /// Accidental fits as good as the first, expected of random spots; 0 without a fit.
  double chance = 0.0;
};

Correspondence correspond(const TargetModel& target, std::span<const Ray> rays,
                          const RayPlanes& planes, const CorrespondenceOptions& options);

}  // namespace turntable
