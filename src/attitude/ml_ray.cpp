#include "src/attitude/ml_ray.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "src/attitude/chi_square.h"
#include "src/attitude/information.h"
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

  /// Degrees of freedom of chi^2. Parallel rays leave T_z to the ridge; nearly parallel ones spend it
  /// on their scale.
  double dof(const Normal& at) const {
    const bool ridge_alone = height_undefined_ && at.N(5, 5) < 2.0 * kHeightRidge * at.N(4, 4);
    return 2.0 * n_ - (ridge_alone ? 5.0 : 6.0);
  }

  Normal normal(const RayPose& pose) const {
    Normal out;
    Matrix3d dd = Matrix3d::Zero(), td = dd, tt = dd;
    Vector3d gd = Vector3d::Zero(), gt = gd;
    for (int t = 0; t < n_; ++t) {
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
    if (height_undefined_) out.N(5, 5) += kHeightRidge * out.N(4, 4);
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
    Matrix6d covariance = inverse_of_information(at.N);
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
  std::array<Sighted, kMaxTargetPoints> sighted_;
  std::array<Vector3d, kMaxTargetPoints> p_;  ///< M0Mt, mm
};

double residual_mm(const TargetModel& target, const Observation& observation, const RayPose& pose) {
  double sum = 0.0;
  for (int t = 0; t < target.size(); ++t) {
    const Vector3d X = pose.R * (target.points().col(t) - target.points().col(0)) + pose.T;
    const double miss =
        distance_mm(X, observation.rays[static_cast<std::size_t>(t)], observation.planes);
    sum += miss * miss;
  }
  return std::sqrt(sum / target.size());
}

Solution solve_all_points(const TargetModel& target, const Observation& observation,
                          const SolveOptions& options) {
  Solution solution;
  const bool stated = !observation.spreads.empty();
  const RayStart start = start_on_rays(
      target, observation, std::max(options.tolerance, kStartTolerance), options.max_iterations);
  solution.status = start.status;
  solution.iterations = start.iterations;
  if (start.count == 0) return solution;

  const Refinement refinement(target, observation, start.height_undefined());
  constexpr std::size_t kMost = kMaxRayStarts + 2;
  std::array<RayEnd, kMost> ends;
  std::array<Normal, kMost> normals;
  std::size_t count = 0;
  const auto refine = [&](const RayStart& from) {
    for (std::size_t c = 0; c < from.count; ++c, ++count) {
      ends[count].pose = from.poses[c];
      int passes = from.iterations;  // a start has max_iterations of its own
      ends[count].status = refinement.refine(ends[count].pose, normals[count], options, passes);
      solution.iterations += passes - from.iterations;
      ends[count].misfit = normals[count].chi2;
    }
  };
  const auto ranked = [&] {
    return rank(std::span(ends).first(count), stated ? refinement.dof(normals[0]) : 0.0);
  };
  refine(start);
  Ranking ranking = ranked();
  // A start that has led nowhere: the others are worth their time.
  if (stated && start.count == 1 &&
      !(ends[0].misfit <= chi2_quantile(refinement.dof(normals[0]), kNormalQuantile9999))) {
    refine(planar_start(target, observation));
    ranking = ranked();
  }

  const RayPose& pose = ends[ranking.best].pose;
  const Normal& at = normals[ranking.best];
  solution.status = ranking.status;
  if (ranking.has_rival()) {
    const RayPose& other = ends[ranking.rival].pose;
    solution.rival = Rival{other.R, other.T, residual_mm(target, observation, other)};
  }
  solution.R = solution.rows_ijk = pose.R;
  solution.position_mm = pose.T;
  solution.residual = residual_mm(target, observation, pose);
  if (!solution.R.allFinite() || !solution.position_mm.allFinite() ||
      !std::isfinite(solution.residual))
    solution.status = SolveStatus::kDegenerate;
  if (stated) {
    solution.covariance = refinement.covariance(at);
    solution.chi2 = at.chi2;
    solution.dof = refinement.dof(at);
  }
  if (!start.height_undefined()) return solution;
  if (solution.status == SolveStatus::kConverged) solution.status = SolveStatus::kHeightUndefined;
  solution.position_mm.z() = Solution::kNaN;
  if (solution.rival) solution.rival->position_mm.z() = Solution::kNaN;
  return solution;
}

/// The same without the points of `left_out`; the position is still M0's.
Solution solve_without(std::uint32_t left_out, const TargetModel& target,
                       const Observation& observation, const SolveOptions& options) {
  std::array<Vector3d, kMaxTargetPoints> points;
  std::array<Ray, kMaxTargetPoints> rays;
  std::array<RaySpread, kMaxTargetPoints> spreads;
  std::size_t count = 0;
  for (int t = 0; t < target.size(); ++t) {
    if ((left_out >> t & 1u) != 0) continue;
    points[count] = target.points().col(t);
    rays[count] = observation.rays[static_cast<std::size_t>(t)];
    spreads[count++] = observation.spreads[static_cast<std::size_t>(t)];
  }
  const auto kept = std::span(points).first(count);
  Solution solution;
  solution.status = SolveStatus::kDegenerate;
  if (!TargetModel::refusal(kept).empty()) return solution;
  solution = solve_all_points(
      TargetModel(kept),
      {std::span(rays).first(count), observation.planes, {}, std::span(spreads).first(count)},
      options);
  solution.left_out = left_out;
  if ((left_out & 1u) == 0) return solution;
  // From the first point kept to M0: T + R q, and delta turns q along.
  const Vector3d q = Vector3d(target.points().col(0)) - points[0];
  solution.position_mm += solution.R * q;
  if (solution.rival) solution.rival->position_mm += solution.rival->R * q;
  const Vector3d lever = solution.R * q;
  Matrix6d move = Matrix6d::Identity();  // d(delta, T of M0) / d(delta, T)
  move.bottomLeftCorner<3, 3>() << 0, lever.z(), -lever.y(), -lever.z(), 0, lever.x(), lever.y(),
      -lever.x(), 0;
  solution.covariance = move * solution.covariance * move.transpose();
  return solution;
}

}  // namespace

Solution solve_ml_ray(const TargetModel& target, const Observation& observation,
                      const SolveOptions& options) {
  const bool stated = !observation.spreads.empty();
  if (stated && observation.spreads.size() != observation.rays.size()) return {};
  for (const RaySpread& spread : observation.spreads)
    if (!spread.at_a.allFinite() || !spread.at_b.allFinite()) return {};
  Solution best = solve_all_points(target, observation, options);
  if (!options.robust || !stated) return best;
  const auto fits = [](const Solution& s) {
    return s.chi2 <= chi2_quantile(s.dof, kNormalQuantile999);
  };
  int iterations = best.iterations;
  for (int kept = target.size(); kept > 4 && !fits(best); --kept) {
    Solution next;
    for (int t = 0; t < target.size(); ++t) {
      if ((best.left_out >> t & 1u) != 0) continue;
      const Solution s = solve_without(best.left_out | 1u << t, target, observation, options);
      iterations += s.iterations;
      if (std::isfinite(s.chi2) && !(s.chi2 >= next.chi2)) next = s;
    }
    if (!std::isfinite(next.chi2)) break;
    best = next;
  }
  best.iterations = iterations;
  return best;
}

}  // namespace turntable
