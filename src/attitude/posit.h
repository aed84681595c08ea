// POSIT: pose from orthography and scaling with iterations, on normalised pinhole coordinates.
//   x'_t = x_t (1 + e_t) - x_0,   I = H x',   s = (|I| + |J|) / 2,   e_t = (M0Mt . k) / Z0
// Source: D. DeMenthon, L. Davis, Model-based object pose in 25 lines of code, IJCV 15 (1995)
// 123-141; the comparison of X. Guo et al. 2019. Symbols:
//   x_t, y_t -> observation.normalised[t]   normalised image coordinates, 1
//   H        -> target.pseudo_inverse()     3 x (n-1), 1/mm
//   I, J     -> I, J                        i / Z0 and j / Z0, 1/mm
//   e_t      -> e[t-1]                      depth of Mt beyond M0 over Z0, 1
//   Z0       -> position_mm.z()             depth of M0, mm
//   i, j, k  -> rows_ijk                    rows of R_camera_from_target before orthonormalising
// Stop when max |change of e| < tolerance.
// Domain: points in front of a central camera and depths that differ by less than about half the
// distance; the fixed point is the exact pose without noise, and some percent above the Cramer-Rao
// bound with it (the benchmark states how many). Outside: coincident or collinear image points and
// points that end behind the camera are kDegenerate, no convergence is kNotConverged.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

Solution solve_posit(const TargetModel& target, const Observation& observation,
                     const SolveOptions& options);

}  // namespace turntable
