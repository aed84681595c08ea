// Three points of known mutual distances seen along three directions from one centre: their ranges.
//   s_i^2 + s_j^2 - 2 s_i s_j b_ij = D_ij^2,   b_ij = y_i . y_j      for ij = 12, 13, 23
// Source: J. A. Grunert 1841; reviewed by Haralick et al., IJCV 13 (1994) 331-356. Solved as in
// M. Persson & K. Nordberg, "Lambda Twist", ECCV 2018: eliminating the right-hand sides leaves two
// conics s^T C_1 s = s^T C_2 s = 0 in the ratios of the ranges. A member C_1 + x C_2 of their
// pencil that is degenerate (one real root x of a cubic) is a pair of lines, and the common points
// are where the lines meet C_1; here the pair is split with the adjugate (J. Richter-Gebert,
// Perspectives on Projective Geometry, 2011, section 11.1), and lines are met by an orthogonal
// basis, so that symmetric configurations divide nothing by zero. Symbols:
//   y_i -> directions (unit vectors)    s_i -> ranges, in the unit of the distances
// Domain: triangles that are triangles, seen under directions that differ. Near the double root (a
// triangle seen at right angles) noise may leave no real solution: the real part of the complex
// pair is answered, the pose that comes closest. Outside the domain: no solution.
#pragma once

#include <array>

#include "src/geometry/rotation.h"

namespace turntable {

struct P3pSolutions {
  int count = 0;  ///< 0 to 4
  std::array<Vector3d, 4> ranges;
};

/// @param distances (D_12, D_13, D_23). Ranges that are not all positive are left out.
P3pSolutions solve_p3p(const Vector3d& y_1, const Vector3d& y_2, const Vector3d& y_3,
                       const Vector3d& distances);

}  // namespace turntable
