// PRSOI: scaled orthographic projection along perspective rays, with iteration; POSIT transcribed to
// rays that are each given by two positioning points, and the ancestor of AOPIT.
//   xi_t = d_t^a(x) + s g_t(x) eps_t,   eta_t the same with y
//   I = H xi,  J = H eta,   s = (|I| + |J|) / 2,   i = I/|I|,  j = J/|J|,  k = i x j
//   eps_t = M0Mt . k
//   m - a = (1/s - 1) sum_t d_t^a . (g_t - g_0) / sum_t |g_t - g_0|^2     after the last pass
// Source: P. Sun, C. Sun, W. Li, P. Wang, A new pose estimation algorithm using a
// perspective-ray-based scaled orthographic projection with iteration, PLoS ONE 10(7) (2015)
// e0134029. Written from its abstract and figure captions, which name the two positioning points, the
// approximate ray-based projection by a linear system and its refinement by iteration: the equations
// above are ours and may differ from the paper's in detail. They are eq. 19 of AOPIT (aopit.h) with
// its quotient, which differs from point to point, replaced by one scale for all points and both
// axes, on plane a as the plane of projection. Symbols:
//   d_t^a -> bundle.d_a, 2-vectors from M0's ray on plane a, mm     g_t -> bundle.g, slope
//   s     -> scale, separation on plane a over that at M0's height, 1; the rays' own separation
//            d_t^a + (g_t - g_0)(m - a) = d_t^a / s gives m by least squares over all rays and axes
//   H     -> target.pseudo_inverse(), 3 x (n-1), 1/mm               eps_t -> eps[t-1], mm
//   m     -> position_mm.z(), height of M0, mm                      i, j, k -> rows_ijk
// Stop when max |change of eps| < tolerance (mm) and s has settled to as much of the target's radius
// (as in aopit.h: a symmetric target has the right eps before the right s).
//
// Domain: central cameras, where it is exact and does without AOPIT's 0/0. On others, biased: rays
// that do not meet have no common scale (up to 0.11 deg in 100 poses with a pupil that walks
// 500 mm/rad^2, where aopit errs by up to 0.19). Outside: coincident rays or rays in one plane are
// kDegenerate, parallel rays kHeightUndefined, no convergence kNotConverged, targets in a plane
// kCoplanarTarget.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

Solution solve_prsoi(const TargetModel& target, const Observation& observation,
                     const SolveOptions& options);

}  // namespace turntable
