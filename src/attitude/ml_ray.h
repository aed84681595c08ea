// Maximum likelihood on rays: the pose under which the spots are most probable, and how uncertain it
// is.
//   X_t = exp([delta]x) R M0Mt + T
//   m_t = (X_t)_xy - ray_t(z of X_t)          in-plane miss of point t, mm
//   r_t = S_t(z of X_t)^-1 m_t                the same in standard deviations of its spot, 2-vector
//   chi^2 = sum_t |r_t|^2 -> min,   N = J^T J,  J = d r / d(delta, T),   covariance = N^-1
// Gauss-Newton from start_on_rays, damped (Levenberg-Marquardt) where a step makes chi^2 larger. To
// first order in the spots' noise r_t is the image-plane residual over its standard deviation,
// whatever the camera: S_t(z) n is what noise n of the spot does to the ray at height z.
// Source: mathematics of the rig, section 6; Levenberg 1944, Marquardt 1963. Symbols:
//   M0Mt    -> target.vectors(), mm; M0 itself has vector 0
//   S_t(z)  -> observation.spreads[t].at(z), 2 x 2, mm per standard deviation. Without spreads it is
//              a perpendicular miss of 1 mm; chi^2 and the covariance are then not stated
//   delta   -> left perturbation, rad, plane frame      T -> position_mm, origin of M0, mm
// Stop when |delta| radius < tolerance (mm), or, with spreads, when a step makes chi^2 smaller by less
// than 1e-7, a three-thousandth of a standard deviation; this step is taken, so that what is left is
// about a hundredth of it. Each start has max_iterations of its own.
//
// Points in a plane, and flat targets: all poses of start_on_rays are refined, the one of smallest
// chi^2 is the answer, the next best of another attitude its rival. It is kAmbiguous if chi^2 of the
// two differ by less than 16 max(1, chi^2 / dof) of the better: less than four standard deviations.
// Without spreads: if the rms miss differs by less than a factor of four.
// Other targets: where chi^2 ends above its 0.9999 quantile, the planar starts are tried as well.
// Robust, with spreads and more than four points: while chi^2 is above its 0.999 quantile, the point
// without which it is smallest is left out, until four are left; every trial starts afresh, since the
// start is not robust. A chi^2 that is still too large says that the points contradict each other.
//
// Domain: any bundle. Where the start says that the rays are too parallel to tell the height, T_z is
// free to serve as a scale, a ridge of 1e-13 in N keeps it where it means nothing, and it is stated as
// NaN, kHeightUndefined. Outside: no pose to start from is the start's status; rays that do not determine the pose
// (pivot of N below 1e-14 of the largest) are kDegenerate.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

Solution solve_ml_ray(const TargetModel& target, const Observation& observation,
                      const SolveOptions& options);

}  // namespace turntable
