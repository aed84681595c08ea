#include "src/attitude/oi_ray.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "src/attitude/ray_start.h"

namespace turntable {
namespace {

/// Of the start: the iteration goes on from it, and takes what is left in its own steps.
constexpr double kOrthogonalStartTolerance = 1e-3;
/// Ratio of changes that the stop rule believes at most: beyond it the ratio is rounding.
constexpr double kSlowestRatio = 0.999;
/// Determinant of the mean of 1 - V_t below which T along the rays stays where it is: the square of
/// the rays' opening, which is then under a microradian.
constexpr double kTooParallel = 1e-13;

class OrthogonalIteration {
 public:
  OrthogonalIteration(const TargetModel& target, const Observation& observation)
      : n_(target.size()) {
    Matrix3d sum = Matrix3d::Zero();
    mean_.setZero();
    for (int t = 0; t < n_; ++t) {
      const auto i = static_cast<std::size_t>(t);
      const Ray& ray = observation.rays[i];
      p_[i] = t == 0 ? Vector3d(Vector3d::Zero()) : Vector3d(target.vectors().col(t - 1));
      c_[i] << ray.at_a, observation.planes.a_mm;
      Vector3d g;
      g << ray.slope(observation.planes), 1.0;
      v_[i] = g.normalized();
      sum += Matrix3d::Identity() - v_[i] * v_[i].transpose();
      mean_ += p_[i] / n_;
    }
    if (sum.determinant() > kTooParallel * n_ * n_ * n_) {
      inverse_ = sum.inverse();
    } else {
      inverse_.setZero();
      inverse_.topLeftCorner<2, 2>() = sum.topLeftCorner<2, 2>().inverse();
    }
  }

  /// Refines `pose` in at most options.max_iterations - `spent` passes, which are added to `total`.
  /// @return converged, not converged or degenerate.
  SolveStatus refine(RayPose& pose, const SolveOptions& options, int spent, int& total) const {
    place(pose);
    double last = 0.0;
    for (int pass = spent; pass < options.max_iterations; ++pass) {
      ++total;
      Matrix3d M = Matrix3d::Zero();
      for (std::size_t t = 0; t < static_cast<std::size_t>(n_); ++t) {
        const Vector3d foot = c_[t] + v_[t] * v_[t].dot(pose.R * p_[t] + pose.T - c_[t]);
        M.noalias() += (foot - pose.T) * (p_[t] - mean_).transpose();
      }
      if (!M.allFinite()) return SolveStatus::kDegenerate;
      const Matrix3d R = nearest_rotation(M);
      double change = 0.0;
      for (std::size_t t = 1; t < static_cast<std::size_t>(n_); ++t)
        change = std::max(change, ((R - pose.R) * p_[t]).norm());
      pose.R = R;
      place(pose);
      if (!pose.T.allFinite()) return SolveStatus::kDegenerate;
      const double ratio = last > 0.0 ? std::min(change / last, kSlowestRatio) : kSlowestRatio;
      if (change < options.tolerance * (1.0 - ratio)) return SolveStatus::kConverged;
      last = change;
    }
    return SolveStatus::kNotConverged;
  }

  /// E, mm^2.
  double misfit(const RayPose& pose) const {
    double sum = 0.0;
    for (std::size_t t = 0; t < static_cast<std::size_t>(n_); ++t)
      sum += miss(pose, t).squaredNorm();
    return sum;
  }

 private:
  Vector3d miss(const RayPose& pose, std::size_t t) const {
    const Vector3d x = pose.R * p_[t] + pose.T - c_[t];
    return x - v_[t] * v_[t].dot(x);
  }

  /// T <- T(R), as a step from T: rounding is then that of the step.
  void place(RayPose& pose) const {
    Vector3d sum = Vector3d::Zero();
    for (std::size_t t = 0; t < static_cast<std::size_t>(n_); ++t) sum += miss(pose, t);
    pose.T -= inverse_ * sum;
  }

  int n_;
  std::array<Vector3d, kMaxTargetPoints> p_, c_, v_;
  Vector3d mean_;
  Matrix3d inverse_;  ///< of sum 1 - V_t; without z if the rays are parallel
};

}  // namespace

Solution solve_oi_ray(const TargetModel& target, const Observation& observation,
                      const SolveOptions& options) {
  Solution solution;
  const RayStart start =
      start_on_rays(target, observation, std::max(options.tolerance, kOrthogonalStartTolerance),
                    options.max_iterations);
  solution.status = start.status;
  solution.iterations = start.iterations;
  if (start.count == 0) return solution;

  const OrthogonalIteration iteration(target, observation);
  std::array<RayEnd, kMaxRayStarts> ends;
  for (std::size_t c = 0; c < start.count; ++c) {
    ends[c].pose = start.poses[c];
    ends[c].status = iteration.refine(ends[c].pose, options, start.iterations, solution.iterations);
    ends[c].misfit = iteration.misfit(ends[c].pose);
  }
  const auto rms = [&](const RayEnd& end) { return std::sqrt(end.misfit / target.size()); };
  const Ranking ranking = rank(std::span(ends).first(start.count));
  const RayEnd& best = ends[ranking.best];
  solution.status = ranking.status;
  solution.R = solution.rows_ijk = best.pose.R;
  solution.position_mm = best.pose.T;
  solution.residual = rms(best);
  if (ranking.has_rival()) {
    const RayEnd& other = ends[ranking.rival];
    solution.rival = Rival{other.pose.R, other.pose.T, rms(other)};
  }
  if (!solution.R.allFinite() || !std::isfinite(solution.residual))
    solution.status = SolveStatus::kDegenerate;
  if (start.height_undefined()) {
    if (solution.status == SolveStatus::kConverged) solution.status = SolveStatus::kHeightUndefined;
    solution.position_mm.z() = Solution::kNaN;
    if (solution.rival) solution.rival->position_mm.z() = Solution::kNaN;
  }
  return solution;
}

}  // namespace turntable
