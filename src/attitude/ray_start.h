// Where refinements on rays start from.
//   points in space    the pose of aopit_ray, one
//   flat targets       (thickness below 0.15, in no plane) that one, which creeps, swings or ends at a
//                      wrong pose there, and the two of the plane that fits the points
//   points in a plane  scaled orthography along the rays, two: with H of rank 2 the rows are known but
//                      for their parts along the plane's normal n,
//                        i = I + alpha n,  j = J + beta n,  alpha^2 = 1 - |I|^2,  beta^2 = 1 - |J|^2,
//                        alpha beta = -I.J
//                      with I = H d / s, J likewise. Both signs of (alpha, beta) serve; the scale s
//                      that admits them is the larger singular value of [H d_x, H d_y].
// Source: aopit_ray.h; D. Oberkampf, D. DeMenthon, L. Davis, Iterative pose estimation using coplanar
// feature points, CVIU 63 (1996) 495-511, section 3, here on rays. Symbols:
//   d   -> bundle.d_a, 2-vectors from M0's ray on plane a, mm
//   s   -> separation on plane a over that at M0's height, 1; from it and the opening of the bundle,
//          its height
// Of a flat target (1 - n n^T) H stands for H. Domain: as aopit_ray; planes not seen edge-on. A start need
// not be near: the refinement decides.
#pragma once

#include <array>

#include "src/attitude/solver.h"

namespace turntable {

/// x = R (p - M0) + T in the plane frame.
struct RayPose {
  Matrix3d R;
  Vector3d T;
};

constexpr std::size_t kMaxRayStarts = 3;

struct RayStart {
  SolveStatus status = SolveStatus::kInvalidInput;  ///< has poses if converged or height undefined
  std::size_t count = 0;
  std::array<RayPose, kMaxRayStarts> poses;
  int iterations = 0;

  /// The rays are too parallel to tell the height; T.z is one that fits and not a measurement.
  bool height_undefined() const { return status == SolveStatus::kHeightUndefined; }
};

/// @param tolerance_mm of the iteration of aopit_ray.
RayStart start_on_rays(const TargetModel& target, const Observation& observation,
                       double tolerance_mm, int max_iterations);
/// The two of the plane that fits the points, whatever the target: where others have led nowhere.
RayStart planar_start(const TargetModel& target, const Observation& observation);

/// Where the refinement of a start ended.
struct RayEnd {
  RayPose pose;
  double misfit = Solution::kNaN;  ///< what was minimised: chi^2, or a sum of squares
  SolveStatus status = SolveStatus::kDegenerate;
};

struct Ranking {
  std::size_t best = 0;
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  std::size_t rival = kNone;  ///< the next best of another attitude, converged or not
  /// Of the best; kAmbiguous if it converged and the rival explains the sightings nearly as well.
  SolveStatus status = SolveStatus::kDegenerate;

  bool has_rival() const { return rival != kNone; }
};

/// Which end is the answer: the one of smallest misfit that is not degenerate. If it did not
/// converge, the others are no answer either: they explain the sightings worse. Two tell the attitude
/// apart if their misfits differ by 16 max(1, best / dof): four standard deviations, of the noise
/// stated or, if the misfit shows more, of that.
/// @param ends at least one. @param dof degrees of freedom of chi^2; 0 if the noise is not known and
/// the misfit any sum of squares: then by a factor of 16 (of four in its root).
Ranking rank(std::span<const RayEnd> ends, double dof = 0.0);

}  // namespace turntable
