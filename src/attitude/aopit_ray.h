// AOPIT on general rays: the same iteration, exact for any bundle and without eq. 19's division.
//   lateral vector M0 -> Mt = d_t^a + g_t eps_t + (g_t - g_0) w,  w = m - a,  linear in w
//   I(w) = I0 + w I1:  [I0 J0] = H [d_t^a + g_t eps_t],  [I1 J1] = H [g_t - g_0]
//   |I(w)|^2 + |J(w)|^2 = 2:  A w^2 + B w + C = 0 with
//     A = |I1|^2 + |J1|^2,  B = 2 (I0.I1 + J0.J1),  C = |I0|^2 + |J0|^2 - 2
//   i = I/|I|,  j = J/|J|,  k = i x j,  eps_t = M0Mt . k
// Source: extension of X. Guo et al. 2019 (eq. 7-22), which leaves non-central cameras to future
// work. Symbols:
//   M_t^a, M_t^b -> observation.rays[t]   points of ray t on planes a and b, mm, plane frame
//   d_t^a        -> bundle.d_a[t-1]       2-vector from M0's ray on plane a, mm
//   g_t          -> bundle.g[t-1]         slope of ray t, 1
//   H            -> target.pseudo_inverse(), 3 x (n-1), 1/mm
//   w            -> w                     height of M0 above plane a, mm
//   eps_t        -> eps[t-1]              height of Mt above M0, mm
//   i, j, k      -> rows_ijk              rows of R_plane_from_target before orthonormalising
// Stop when max |change of eps| < tolerance (mm).
//
// The root: both lie symmetrically about w* = -B / 2A, where the bundle is narrowest (the camera).
// The object is on plane a's side of it: the root nearer to w = 0, which is the smaller one when z
// points to the camera. It is computed as -2 C / (B + sign(B) sqrt(B^2 - 4 A C)), without
// cancellation.
//
// Domain: any bundle, central or not. Parallel rays (I1 = J1 = 0) leave the attitude defined and
// the height not; when the rays would meet more than 1000 target radii away, w is left at 0 (a
// central bundle's w only scales I and J, which are normalised anyway, so that noise in w cannot
// reach the attitude) and the status is kHeightUndefined. Outside: no real root at the last pass
// (the rays are nowhere close enough together for the target), coincident rays and rays in one
// plane are kDegenerate; no convergence is kNotConverged.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

Solution solve_aopit_ray(const TargetModel& target, const Observation& observation,
                         const SolveOptions& options);

}  // namespace turntable
