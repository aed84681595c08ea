// What the two ray solvers share: the rays relative to the ray of M0, and how a solve ends.
//   d_t^p = M_t^p - M_0^p        2-vectors on plane p = a, b, mm
//   g_t   = (M_t^b - M_t^a) / (b - a)   slope
#pragma once

#include <array>

#include "src/attitude/solver.h"

namespace turntable {

/// Bundles whose effective distance (where the rays would meet) is more than this many target radii
/// count as parallel: an error of 0.1 % in scale would then move the height by the target's own
/// radius.
constexpr double kParallelRadii = 1000.0;
/// |I| and |J| are 1 without noise; below this the rays coincide.
constexpr double kMinRow = 1e-6;

/// Index t-1 holds point t; only the first `count` entries are set.
struct RayBundle {
  int count = 0;
  std::array<Vector2d, kMaxTargetPoints - 1> d_a, d_b, g;
  Vector2d g_0;
};

/// @return false if the number of rays is not the target's, a number is not finite, or b <= a.
bool make_bundle(const TargetModel& target, const Observation& observation, RayBundle& bundle);

/// True if the rays are too parallel to tell the height (kParallelRadii).
/// @param relative_slope rms over both axes of the rows I, J that the slopes g_t - g_0 alone make,
/// 1/mm: for a central camera it is one over the distance from plane a.
inline bool nearly_parallel(double relative_slope, const TargetModel& target) {
  return !(relative_slope * target.radius_mm() * kParallelRadii > 1.0);
}

/// Fills R, rows, position and residual from unit rows i, j and the height m of M0 above z = 0, mm.
/// `solution.status` and `solution.iterations` are the caller's; a result that is not finite, or
/// rows that are nearly parallel (kMinSine), become kDegenerate.
void finish_on_rays(const TargetModel& target, const Observation& observation, const Vector3d& i,
                    const Vector3d& j, double m_mm, Solution& solution);

}  // namespace turntable
