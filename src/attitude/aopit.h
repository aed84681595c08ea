// AOPIT as published: attitude from orthographic projection with iteration, on the rays of a
// two-plane calibration.
//   eq. 19        xi_t = d_t^a + (x_t^b - x_t^a) d_t^a / ((b - m) d_t^a + (m - a) d_t^b) eps_t,
//                 eta_t the same with y
//   eq. 15-18     I = H xi,  J = H eta,  s_x = |I|,  s_y = |J|,  i = I/s_x,  j = J/s_y,  k = i x j
//   eq. 8 and 10  m s (d^b - d^a) = (b - a) d^a - s (b d^a - a d^b),  s = s_x in the x rows,
//                 s_y in the y rows
//   eq. 13 and 14 eps_t = M0Mt . k,  n_t = m + eps_t
// Source: X. Guo et al., ISA Transactions 2019, doi:10.1016/j.isatra.2019.05.009, eq. 7-22 and
// figure 5. Symbols:
//   M_t^a, M_t^b -> observation.rays[t]   points of ray t on planes a and b, mm, plane frame
//   d_t^a, d_t^b -> d_a, d_b              2-vectors from M0's ray, mm
//   H            -> target.pseudo_inverse(), 3 x (n-1), 1/mm
//   xi, eta      -> xi                    orthographic projection of M0Mt, scaled to plane a, mm
//   m            -> m, position_mm.z()    height of M0, mm
//   eps_t        -> eps[t-1]              height of Mt above M0, mm
//   i, j, k      -> rows_ijk              rows of R_plane_from_target before orthonormalising
// Stop when max |change of eps| < tolerance (mm) and m has settled too: a symmetric target under
// the camera has the right eps from the first pass on, and m not yet. The paper does not say which
// t gives m: the least-squares m over all t and both axes is taken.
//
// Eq. 19 divides 0 by 0 when a point shares its x (or y) with M0. For a central camera with centre
// at height h every pair of rays opens linearly, d^z ~ h - z, so d^a / d^m = (h - a) / (h - m) = s
// for every point and axis: s (of the previous pass) is the limit, and it is used where |d^m| is
// below 1e-6 of the largest. Above that the published quotient stands. Image noise of a central
// camera moves d^a and d^m alike and cancels; errors that differ from plane to plane (the
// calibration's own) are amplified without bound near the 0/0: 10 um on each plane made 126 of 300
// solves fail where a point shared M0's x exactly, and aopit_ray stayed within 0.07 deg.
//
// Domain: central cameras (eq. 12 and one common scale hold only there). On a non-central camera
// the answer is biased (up to 0.27 deg for a pupil that walks 500 mm/rad^2, tilts up to 35 deg):
// use aopit_ray. Outside: coincident rays or rays in one plane are kDegenerate, parallel rays
// kHeightUndefined, no convergence kNotConverged.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

Solution solve_aopit(const TargetModel& target, const Observation& observation,
                     const SolveOptions& options);

}  // namespace turntable
