#include "src/attitude/uncertainty.h"

#include <cassert>
#include <cmath>

#include "src/attitude/information.h"
#include "src/attitude/ray_residual.h"

namespace turntable {
namespace {

/// r and its derivatives at a pose, two rows per point; those of points left out are zero.
struct Linearised {
  Eigen::VectorXd r;
  Eigen::MatrixXd J;         ///< 2n x 6
  Eigen::MatrixXd B_x, B_y;  ///< 2n x 2n, of the rays' x and y: values on a, values on b
  Eigen::MatrixXd B_target;  ///< 2n x 3n
  int rows = 0;              ///< that count
};

[[maybe_unused]] bool suits(const UncertaintySources& sources, int n) {
  return (sources.rays_mm2.size() == 0 || sources.rays_mm2.rows() == 2 * n) &&
         (sources.target_mm2.size() == 0 || sources.target_mm2.rows() == 3 * n);
}

Linearised linearise(const TargetModel& target, const Observation& observation, const Matrix3d& R,
                     const Vector3d& T, std::uint32_t left_out) {
  const int n = target.size();
  const double a = observation.planes.a_mm, span = observation.planes.b_mm - a;
  Linearised out;
  out.r = Eigen::VectorXd::Zero(2 * n);
  out.J = Eigen::MatrixXd::Zero(2 * n, 6);
  out.B_x = out.B_y = Eigen::MatrixXd::Zero(2 * n, 2 * n);
  out.B_target = Eigen::MatrixXd::Zero(2 * n, 3 * n);
  for (int t = 0; t < n; ++t) {
    if ((left_out >> t & 1u) != 0) continue;
    const auto index = static_cast<std::size_t>(t);
    const Sighted sighted(observation.rays[index],
                          observation.spreads.empty() ? nullptr : &observation.spreads[index],
                          observation.planes);
    const Vector3d q = R * (target.points().col(t) - target.points().col(0)), X = q + T;
    const RayResidual residual = sighted.residual(X, X.z() - a);
    const double lambda = (X.z() - a) / span;
    for (Eigen::Index i = 0; i < 2; ++i) {
      const Eigen::Index row = 2 * t + i;
      const Vector3d x = residual.row(i);
      out.r(row) = residual.r(i);
      out.J.row(row) << q.cross(x).transpose(), x.transpose();
      out.B_x(row, t) = -(1.0 - lambda) * x.x();
      out.B_x(row, n + t) = -lambda * x.x();
      out.B_y(row, t) = -(1.0 - lambda) * x.y();
      out.B_y(row, n + t) = -lambda * x.y();
      const Eigen::RowVector3d in_target = x.transpose() * R;
      out.B_target.row(row).segment<3>(3 * t) += in_target;
      out.B_target.row(row).head<3>() -= in_target;
    }
    out.rows += 2;
  }
  return out;
}

/// (J^T J)^-1 of (delta, T), lengths of one size inside.
Matrix6d inverse_information(const Linearised& at, double radius_mm) {
  Eigen::Matrix<double, 6, 1> size = Eigen::Matrix<double, 6, 1>::Ones();
  size.head<3>().setConstant(1.0 / radius_mm);
  Matrix6d N = size.asDiagonal() * Matrix6d(at.J.transpose().lazyProduct(at.J)) * size.asDiagonal();
  N(5, 5) += kHeightRidge * N(4, 4);
  return size.asDiagonal() * inverse_of_information(N) * size.asDiagonal();
}

/// The height that a pose without one stands for: nearly parallel rays let it serve as a scale.
Vector3d with_height(const TargetModel& target, const Observation& observation, const Matrix3d& R,
                     Vector3d T, std::uint32_t left_out) {
  if (std::isfinite(T.z())) return T;
  T.z() = observation.planes.a_mm;
  for (int pass = 0; pass < 2; ++pass) {
    const Linearised at = linearise(target, observation, R, T, left_out);
    const Eigen::Matrix<double, 6, 1> gradient = at.J.transpose().lazyProduct(at.r);
    T -= (inverse_information(at, target.radius_mm()) * gradient).tail<3>();
  }
  return T;
}

}  // namespace

PoseUncertainty propagate_uncertainty(const TargetModel& target, const Observation& observation,
                                      const Solution& solution, const UncertaintySources& sources) {
  PoseUncertainty out;
  out.spots = solution.covariance;
  if (!solution.covariance.topLeftCorner<5, 5>().allFinite()) {
    out.rays = out.target = out.spots;
    return out;
  }
  assert(suits(sources, target.size()));
  const bool height = std::isfinite(solution.position_mm.z());
  const Vector3d T =
      with_height(target, observation, solution.R, solution.position_mm, solution.left_out);
  const Linearised at = linearise(target, observation, solution.R, T, solution.left_out);
  const Matrix6d N_inverse =
      height ? solution.covariance : inverse_information(at, target.radius_mm());
  const Eigen::MatrixXd gain = -N_inverse.lazyProduct(at.J.transpose());  // d theta / d r
  const auto add = [&gain](Matrix6d& part, const Eigen::MatrixXd& B, const Eigen::MatrixXd& E) {
    // Lazily: the matrices are small, and a blocked product takes longer to compile than to run.
    const Eigen::MatrixXd M = gain.lazyProduct(B), ME = M.lazyProduct(E);
    part += ME.lazyProduct(M.transpose());
  };
  if (sources.rays_mm2.size() > 0) {
    add(out.rays, at.B_x, sources.rays_mm2);
    add(out.rays, at.B_y, sources.rays_mm2);
  }
  if (sources.target_mm2.size() > 0) add(out.target, at.B_target, sources.target_mm2);
  if (!height)
    for (Matrix6d* part : {&out.rays, &out.target}) {
      part->row(5).setConstant(Solution::kNaN);
      part->col(5).setConstant(Solution::kNaN);
    }
  return out;
}

Fit judge_fit(const TargetModel& target, const Observation& observation, const Matrix3d& R,
              const Vector3d& T, const UncertaintySources& sources, std::uint32_t left_out) {
  assert(suits(sources, target.size()));
  const Linearised at =
      linearise(target, observation, R, with_height(target, observation, R, T, left_out), left_out);
  Eigen::MatrixXd Sigma = Eigen::MatrixXd::Zero(at.r.size(), at.r.size());
  for (int t = 0; t < target.size(); ++t)
    if ((left_out >> t & 1u) == 0) Sigma(2 * t, 2 * t) = Sigma(2 * t + 1, 2 * t + 1) = 1.0;
  const auto add = [&Sigma](const Eigen::MatrixXd& B, const Eigen::MatrixXd& E) {
    const Eigen::MatrixXd BE = B.lazyProduct(E);
    Sigma += BE.lazyProduct(B.transpose());
  };
  if (sources.rays_mm2.size() > 0) {
    add(at.B_x, sources.rays_mm2);
    add(at.B_y, sources.rays_mm2);
  }
  if (sources.target_mm2.size() > 0) add(at.B_target, sources.target_mm2);

  Fit out;
  out.chi2 = at.r.squaredNorm();
  out.expected = Sigma.trace();
  out.dof = at.rows;
  // J N^-1 J^T = Q Q^T, Q by Gram-Schmidt, once more for rounding. What depends on the columns
  // before it, to rounding, takes nothing away.
  Eigen::MatrixXd Q = at.J;
  for (Eigen::Index k = 0; k < Q.cols(); ++k) {
    const double length = Q.col(k).norm();
    for (int pass = 0; pass < 2; ++pass)
      for (Eigen::Index j = 0; j < k; ++j) Q.col(k) -= Q.col(j).dot(Q.col(k)) * Q.col(j);
    if (!(Q.col(k).norm() > 1e-9 * length)) {
      Q.col(k).setZero();
      continue;
    }
    Q.col(k).normalize();
    out.expected -= Q.col(k).dot(Eigen::VectorXd(Sigma.lazyProduct(Q.col(k))));
    --out.dof;
  }
  return out;
}

}  // namespace turntable
