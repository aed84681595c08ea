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
//
// And whether a pose fits what is seen within all that is stated of spots, rays and target:
//   chi2 = |r(theta)|^2,   Sigma = 1 + B_rays E_rays B_rays^T + B_target E_target B_target^T
//   expected = E[chi2] = trace((1 - J N^-1 J^T) Sigma),   dof = 2n - 6
// With spots alone Sigma = 1, expected = dof, and chi2 is chi^2. Otherwise chi2 is a weighted sum of
// squares, which is judged by its expectation: misfit = chi2 / expected, about 1 for a right pose.
// A sum of few terms strays most: with a single one, misfit > 30 has the probability 4e-8.
// Source: F. E. Satterthwaite, Biometrics Bulletin 2(6) (1946) 110-114, scaling by the expectation.
// The expectation is that of the pose by maximum likelihood; other solvers' lie above it.
//
// Domain: small errors; checked against Monte Carlo (JCGM 101:2008) in the tests. Outside it, as for
// points in a wrong order, chi2 / expected is large and nothing more.
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

/// How well a pose explains a sighting. Numbers that do not exist are NaN.
struct Fit {
  double chi2 = Solution::kNaN;      ///< sum of squared residuals, in standard deviations of spots
  double expected = Solution::kNaN;  ///< of chi2, if everything stated holds
  int dof = 0;                       ///< residuals minus parameters; 5 parameters without a height

  double misfit() const { return chi2 / expected; }
};

/// Whatever solver the pose is from. Allocates.
/// @param R, T pose in the frame of the rays, as `Solution::R`, `position_mm`; T.z may be NaN (height
/// undefined)
/// @param left_out as `Solution::left_out`: these points count nowhere
Fit judge_fit(const TargetModel& target, const Observation& observation, const Matrix3d& R,
              const Vector3d& T, const UncertaintySources& sources, std::uint32_t left_out = 0);

}  // namespace turntable
