// Where the uncertainty of a pose by maximum likelihood (ml_ray.h) comes from: spots, rays, target.
//   theta = (delta, T),  r(theta, e) = r(theta, 0) + B e for errors e of an input with covariance E
//   d theta = -N^-1 J^T B e,   covariance = M E M^T,  M = N^-1 J^T B
//     spots    B = -1, E = 1: the covariance is N^-1
//     rays     B_t = -W_t (1 - l_t, l_t) per coordinate, l_t = (z_t - a) / (b - a), e = values on a, b
//     target   B_t = d r / d X_t R, e = error of M_t minus error of M0 (T is where M0 really is)
// Source: GUM (JCGM 100:2008), 5.1.2 and 5.2; J of the linearised model, as in cramer_rao.h. Symbols:
//   J, W_t, d r / d X_t -> ray_residual.h;  units mm, rad
// Spots differ from image to image. Rays and target stay what they are: their part of the errors is
// common to all images of the same attitude, and averaging does not make it smaller.
// Domain: small errors; checked against Monte Carlo (JCGM 101:2008) in the tests.
#pragma once

#include <Eigen/Core>

#include "src/attitude/solver.h"

namespace turntable {

/// What a source is not stated for is an empty matrix.
struct UncertaintySources {
  /// Of (values on a of each ray, then values on b), 2n x 2n, mm^2; the same for x and y, which are
  /// independent.
  Eigen::MatrixXd rays_mm2;
  /// Of the target's points (x, y, z of M0, of M1, ...), 3n x 3n, mm^2, target frame.
  Eigen::MatrixXd target_mm2;
};

/// Each as `Solution::covariance`: (delta, T), rad^2, rad mm, mm^2. Zero for a source not stated.
struct PoseUncertainty {
  Matrix6d spots = Matrix6d::Zero();
  Matrix6d rays = Matrix6d::Zero();
  Matrix6d target = Matrix6d::Zero();

  Matrix6d total() const { return spots + rays + target; }
};

/// @param solution of `solve_ml_ray` from this observation, with a covariance; points it left out
/// count nowhere. Anything else gives NaN.
PoseUncertainty propagate_uncertainty(const TargetModel& target, const Observation& observation,
                                      const Solution& solution, const UncertaintySources& sources);

}  // namespace turntable
