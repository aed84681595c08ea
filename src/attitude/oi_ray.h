// Orthogonal iteration on rays: the pose whose points lie nearest to their rays in space.
//   V_t  = v_t v_t^T,   v_t = (g_t, 1) / |(g_t, 1)|          projector onto ray t's direction
//   E    = sum_t |(1 - V_t)(R p_t + T - c_t)|^2 -> min       squared distances from the rays, mm^2
//   T(R) = -(sum_t 1 - V_t)^-1 sum_t (1 - V_t)(R p_t - c_t)  linear, closed form
//   q_t  = c_t + V_t (R p_t + T(R) - c_t)                    foot of point t on its ray
//   R   <- argmin sum_t |q_t - q - R p_t|^2                  absolute orientation, by SVD
// Source: C.-P. Lu, G. Hager, E. Mjolsness, Fast and globally convergent pose estimation from video
// images, IEEE TPAMI 22 (2000) 610-622; there c_t is the one centre of the camera, here
// any point of the ray, so that the bundle may be any. Symbols:
//   p_t -> target.vectors(), mm; M0 itself has vector 0      q -> mean of q_t
//   c_t -> (observation.rays[t].at_a, a), mm                 g_t -> its slope
//   T   -> position_mm, origin of M0, mm                     sqrt(E / n) -> residual, mm
// E never grows from pass to pass; it starts from start_on_rays and converges linearly, each change
// of R about rho times the last one. Stop when what is still to come, change / (1 - rho), with change
// the largest |R' p_t - R p_t| and rho the ratio of the last two (0.999 at most and at the first
// pass), is below the tolerance (mm): so the pose is that near to the limit, however slow the way: about
// 40 to 90 passes, several hundred for a plane seen from within 30 deg of its normal, and without end
// where noise makes it look frontal (kNotConverged). Each start has max_iterations of its own.
//
// Points in a plane: from both poses of start_on_rays; the one of smaller E is the answer, the other
// one its rival, and it is kAmbiguous if their rms distances differ by less than a factor of four
// (`rank`: the method knows nothing of the noise).
//
// Domain: any bundle. Every point's distance weighs the same, wherever the image's noise makes it
// larger: some percent above the bound on deep targets. Rays that open by less than a
// microradian leave T_z as it is; where the start says that they are too parallel to tell the height,
// it serves as a scale and is stated as NaN, kHeightUndefined. Outside: no pose to start from is the start's status, what does
// not stay finite is kDegenerate.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

Solution solve_oi_ray(const TargetModel& target, const Observation& observation,
                      const SolveOptions& options);

}  // namespace turntable
