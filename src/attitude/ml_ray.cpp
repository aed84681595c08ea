#include "src/attitude/ml_ray.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "src/attitude/chi_square.h"
#include "src/attitude/ray_residual.h"
#include "src/attitude/ray_start.h"

namespace turntable {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;

/// Of the start, mm: a step corrects more than what is then left.
constexpr double kStartTolerance = 0.05;
constexpr double kMinPivot = 1e-14;
/// Of chi^2: the step to it is a three-thousandth of a standard deviation.
constexpr double kSmallGain = 1e-7;

/// What a pose comes to: chi^2, its gradient and N, in (delta radius, T), all mm.
struct Normal {
  double chi2 = 0.0;
  Matrix6d N;
  Vector6d gradient;
};

class Refinement {
 public:
  Refinement(const TargetModel& target, const Observation& observation, bool height_undefined)
      : n_(target.size()),
        a_(observation.planes.a_mm),
        radius_(target.radius_mm()),
        height_undefined_(height_undefined),
        stated_(!observation.spreads.empty()) {
    for (int t = 0; t < n_; ++t) {
      const auto i = static_cast<std::size_t>(t);
      sighted_[i] = Sighted(observation.rays[i],
                            observation.spreads.empty() ? nullptr : &observation.spreads[i],
                            observation.planes);
      p_[i] = t == 0 ? Vector3d(Vector3d::Zero()) : Vector3d(target.vectors().col(t - 1));
    }
  }

  void leave_out(int t, bool out) { out ? left_out_ |= 1u << t : left_out_ &= ~(1u << t); }
  std::uint32_t left_out() const { return left_out_; }
  bool uses(int t) const { return (left_out_ >> t & 1u) == 0; }
  int unknowns() const { return height_undefined_ ? 5 : 6; }

  Normal normal(const RayPose& pose) const {
    Normal out;
    Matrix3d dd = Matrix3d::Zero(), td = dd, tt = dd;
    Vector3d gd = Vector3d::Zero(), gt = gd;
    for (int t = 0; t < n_; ++t) {
      if (!uses(t)) continue;
      const auto index = static_cast<std::size_t>(t);
      const Vector3d q = pose.R * p_[index], X = q + pose.T;
      const RayResidual residual = sighted_[index].residual(X, X.z() - a_);
      const Vector3d lever = q / radius_;
      // J = [lever x x, x] for the rows x of d r / d X: everything follows from sum x x^T by cross
      // products.
      const Vector3d x_0 = residual.row(0), x_1 = residual.row(1);
      const Matrix3d xx = x_0 * x_0.transpose() + x_1 * x_1.transpose();
      Matrix3d xd;
      for (Eigen::Index i = 0; i < 3; ++i) xd.row(i) = lever.cross(xx.col(i)).transpose();
      for (Eigen::Index i = 0; i < 3; ++i) dd.col(i) += lever.cross(xd.col(i));
      td += xd;
      tt += xx;
      const Vector3d force = residual.r(0) * x_0 + residual.r(1) * x_1;
      gd += lever.cross(force);
      gt += force;
      out.chi2 += residual.r.squaredNorm();
    }
    out.N.topLeftCorner<3, 3>() = dd;
    out.N.bottomLeftCorner<3, 3>() = td;
    out.N.topRightCorner<3, 3>() = td.transpose();
    out.N.bottomRightCorner<3, 3>() = tt;
    out.gradient.head<3>() = gd;
    out.gradient.tail<3>() = gt;
    // Parallel rays know nothing of T_z, nearly parallel ones let it serve as a scale.
    if (height_undefined_) out.N(5, 5) += 1e1 * kMinPivot * out.N(4, 4);
    return out;
  }

  /// Refines `pose`; `passes` counts on. @return converged, not converged or degenerate.
  SolveStatus refine(RayPose& pose, Normal& at, const SolveOptions& options, int& passes) const {
    at = normal(pose);
    double damping = 0.0;
    while (passes < options.max_iterations) {
      ++passes;
      Matrix6d damped = at.N;
      if (damping > 0.0) damped.diagonal() *= 1.0 + damping;
      const Eigen::LLT<Matrix6d> factor(damped);
      if (!determined(factor)) return SolveStatus::kDegenerate;
      const Vector6d step = -factor.solve(at.gradient);
      RayPose trial{rotation_from_vector(step.head<3>() / radius_) * pose.R,
                    pose.T + step.tail<3>()};
      const Normal then = normal(trial);
      if (!std::isfinite(then.chi2)) return SolveStatus::kDegenerate;
      const bool last = step.head<3>().norm() < options.tolerance ||
                        (stated_ && damping == 0.0 && -step.dot(at.gradient) < kSmallGain);
      if (then.chi2 <= at.chi2 || last) {
        // Rounding may make the last step's chi^2 larger.
        pose = trial;
        at = then;
        if (last) return SolveStatus::kConverged;
        damping = damping > 1e-6 ? 0.1 * damping : 0.0;
      } else {
        damping = std::max(10.0 * damping, 1e-3);
      }
    }
    return SolveStatus::kNotConverged;
  }

  bool determined(const Eigen::LLT<Matrix6d>& factor) const {
    const auto pivots = factor.matrixLLT().diagonal();
    return factor.info() == Eigen::Success &&
           pivots.minCoeff() > std::sqrt(kMinPivot) * pivots.maxCoeff();
  }

  /// Of (delta, T); NaN if undetermined.
  Matrix6d covariance(const Normal& at) const {
    const Eigen::LLT<Matrix6d> factor(at.N);
    if (!determined(factor)) return Matrix6d::Constant(Solution::kNaN);
    // N = L L^T, N^-1 = K^T K with K = L^-1, a column at a time.
    const auto& L = factor.matrixLLT();
    Matrix6d K = Matrix6d::Zero();
    for (Eigen::Index j = 0; j < 6; ++j) {
      K(j, j) = 1.0 / L(j, j);
      for (Eigen::Index i = j + 1; i < 6; ++i) {
        double sum = 0.0;
        for (Eigen::Index k = j; k < i; ++k) sum += L(i, k) * K(k, j);
        K(i, j) = -sum / L(i, i);
      }
    }
    Matrix6d covariance = K.transpose().lazyProduct(K);
    covariance.topRows<3>() /= radius_;
    covariance.leftCols<3>() /= radius_;
    if (height_undefined_) {
      covariance.row(5).setConstant(Solution::kNaN);
      covariance.col(5).setConstant(Solution::kNaN);
    }
    return covariance;
  }

 private:
  int n_;
  double a_, radius_;
  bool height_undefined_, stated_;
  std::uint32_t left_out_ = 0;
  std::array<Sighted, kMaxTargetPoints> sighted_;
  std::array<Vector3d, kMaxTargetPoints> p_;  ///< M0Mt, mm
};

/// Leaves out the points that contradict the others, as the header says.
void drop_outliers(Refinement& refinement, const TargetModel& target, const SolveOptions& options,
                   RayPose& pose, Normal& at, int& passes) {
  int kept = target.size();
  while (kept > 4 &&
         at.chi2 > chi2_quantile(2.0 * kept - refinement.unknowns(), kNormalQuantile999)) {
    int worst = -1;
    RayPose best_pose = pose;
    Normal best;
    for (int t = 0; t < target.size(); ++t) {
      if (!refinement.uses(t)) continue;
      refinement.leave_out(t, true);
      RayPose trial = pose;
      Normal without;
      int spent = 0;
      if (refinement.refine(trial, without, options, spent) == SolveStatus::kConverged &&
          (worst < 0 || without.chi2 < best.chi2)) {
        worst = t;
        best_pose = trial;
        best = without;
      }
      passes += spent;
      refinement.leave_out(t, false);
    }
    if (worst < 0) return;
    refinement.leave_out(worst, true);
    pose = best_pose;
    at = best;
    --kept;
  }
}

double residual_mm(const TargetModel& target, const Observation& observation, const RayPose& pose,
                   const Refinement& refinement) {
  double sum = 0.0;
  int count = 0;
  for (int t = 0; t < target.size(); ++t) {
    if (!refinement.uses(t)) continue;
    const Vector3d X = pose.R * (target.points().col(t) - target.points().col(0)) + pose.T;
    const double miss =
        distance_mm(X, observation.rays[static_cast<std::size_t>(t)], observation.planes);
    sum += miss * miss;
    ++count;
  }
  return std::sqrt(sum / count);
}

}  // namespace

Solution solve_ml_ray(const TargetModel& target, const Observation& observation,
                      const SolveOptions& options) {
  Solution solution;
  const bool stated = !observation.spreads.empty();
  if (stated && observation.spreads.size() != observation.rays.size()) return solution;
  for (const RaySpread& spread : observation.spreads)
    if (!spread.at_a.allFinite() || !spread.at_b.allFinite()) return solution;
  const RayStart start = start_on_rays(
      target, observation, std::max(options.tolerance, kStartTolerance), options.max_iterations);
  solution.status = start.status;
  solution.iterations = start.iterations;
  if (start.count == 0) return solution;

  Refinement refinement(target, observation, start.height_undefined());
  std::array<RayEnd, 2> ends;
  std::array<Normal, 2> normals;
  for (std::size_t c = 0; c < static_cast<std::size_t>(start.count); ++c) {
    ends[c].pose = start.poses[c];
    int passes = start.iterations;  // a start has max_iterations of its own
    ends[c].status = refinement.refine(ends[c].pose, normals[c], options, passes);
    solution.iterations += passes - start.iterations;
    ends[c].misfit = normals[c].chi2;
  }
  const Ranking ranking =
      rank(ends, start.count, stated ? 2.0 * target.size() - refinement.unknowns() : 0.0);
  solution.status = ranking.status;
  RayPose pose = ends[ranking.best].pose;
  Normal at = normals[ranking.best];
  if (ranking.has_rival) {
    const RayPose& other = ends[1 - ranking.best].pose;
    solution.rival = Rival{other.R, other.T, residual_mm(target, observation, other, refinement)};
  }
  if (options.robust && stated && solution.status == SolveStatus::kConverged) {
    drop_outliers(refinement, target, options, pose, at, solution.iterations);
    solution.left_out = refinement.left_out();
  }

  solution.R = solution.rows_ijk = pose.R;
  solution.position_mm = pose.T;
  solution.residual = residual_mm(target, observation, pose, refinement);
  if (!solution.R.allFinite() || !solution.position_mm.allFinite() ||
      !std::isfinite(solution.residual))
    solution.status = SolveStatus::kDegenerate;
  if (stated) {
    solution.covariance = refinement.covariance(at);
    solution.chi2 = at.chi2;
  }
  if (start.height_undefined() && solution.status == SolveStatus::kConverged)
    solution.status = SolveStatus::kHeightUndefined;
  if (start.height_undefined()) solution.position_mm.z() = Solution::kNaN;
  return solution;
}

}  // namespace turntable
