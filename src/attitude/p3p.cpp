#include "src/attitude/p3p.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace turntable {
namespace {

/// rad; the cosines b_ij of directions closer than this are 1 to rounding.
constexpr double kSameDirection = 1e-7;

/// Symmetric: its columns are cross products of the columns of C.
Matrix3d adjugate(const Matrix3d& C) {
  Matrix3d out;
  out << C.col(1).cross(C.col(2)), C.col(2).cross(C.col(0)), C.col(0).cross(C.col(1));
  return out;
}

/// Real roots of x^3 + p x^2 + q x + r; a pair that all but meets counts as a double root.
int cubic_roots(double p, double q, double r, std::array<double, 3>& roots) {
  const double Q = (p * p - 3.0 * q) / 9.0;
  const double R = (2.0 * p * p * p - 9.0 * p * q + 27.0 * r) / 54.0;
  const double shift = -p / 3.0;
  if (R * R < Q * Q * Q) {
    const double theta = std::acos(std::clamp(R / std::sqrt(Q * Q * Q), -1.0, 1.0));
    for (int k = 0; k < 3; ++k)
      roots[static_cast<std::size_t>(k)] =
          -2.0 * std::sqrt(Q) * std::cos((theta + 2.0 * std::numbers::pi * (k - 1)) / 3.0) + shift;
    return 3;
  }
  const double A = -std::copysign(std::cbrt(std::abs(R) + std::sqrt(R * R - Q * Q * Q)), R);
  const double B = A == 0.0 ? 0.0 : Q / A;
  roots[0] = A + B + shift;
  roots[1] = -0.5 * (A + B) + shift;
  return R * R - Q * Q * Q <= 1e-10 * R * R ? 2 : 1;
}

}  // namespace

P3pSolutions solve_p3p(const Vector3d& y_1, const Vector3d& y_2, const Vector3d& y_3,
                       const Vector3d& distances) {
  P3pSolutions out;
  const double closest =
      std::min({(y_1 - y_2).squaredNorm(), (y_1 - y_3).squaredNorm(), (y_2 - y_3).squaredNorm()});
  if (!(closest > kSameDirection * kSameDirection)) return out;
  const double b_12 = y_1.dot(y_2), b_13 = y_1.dot(y_3), b_23 = y_2.dot(y_3);
  const Vector3d a = distances.cwiseAbs2() / distances.squaredNorm();
  Matrix3d M_12, M_13, M_23;
  M_12 << 1, -b_12, 0, -b_12, 1, 0, 0, 0, 0;
  M_13 << 1, 0, -b_13, 0, 0, 0, -b_13, 0, 1;
  M_23 << 0, 0, 0, 0, 1, -b_23, 0, -b_23, 1;
  Matrix3d C_1 = M_12 * a[2] - M_23 * a[0];
  Matrix3d C_2 = M_13 * a[2] - M_23 * a[1];

  // det(C_1 + x C_2) = c_0 + c_1 x + c_2 x^2 + c_3 x^3
  Matrix3d adjugate_1 = adjugate(C_1), adjugate_2 = adjugate(C_2);
  double c_0 = C_1.col(0).dot(adjugate_1.col(0)), c_3 = C_2.col(0).dot(adjugate_2.col(0));
  if (std::abs(c_0) > std::abs(c_3)) {
    std::swap(C_1, C_2);
    std::swap(adjugate_1, adjugate_2);
    std::swap(c_0, c_3);
  }
  const double c_1 = adjugate_1.cwiseProduct(C_2).sum();
  const double c_2 = adjugate_2.cwiseProduct(C_1).sum();
  std::array<double, 3> roots{};
  int root_count = 1;  // both conics degenerate: C_1 is a pair of lines itself
  if (c_3 != 0.0) root_count = cubic_roots(c_2 / c_3, c_1 / c_3, c_0 / c_3, roots);

  // Of the degenerate members the one whose two lines are real and most apart.
  Matrix3d C, dual;
  double apart = 0.0;
  for (int k = 0; k < root_count; ++k) {
    const double x = roots[static_cast<std::size_t>(k)];
    const Matrix3d member = (C_1 + x * C_2) / (1.0 + std::abs(x));
    const Matrix3d member_dual = adjugate(member);
    if (k == 0 || member_dual.trace() < apart) {
      apart = member_dual.trace();
      C = member;
      dual = member_dual;
    }
  }
  Eigen::Index m = 0, row = 0, column = 0;
  dual.diagonal().cwiseAbs().maxCoeff(&m);
  const double meeting = std::sqrt(std::max(0.0, -dual(m, m)));
  if (meeting > 0.0) {
    const Vector3d p = dual.col(m) / meeting;  // where the two lines meet
    C(0, 1) -= p.z(), C(0, 2) += p.y(), C(1, 0) += p.z();
    C(1, 2) -= p.x(), C(2, 0) -= p.y(), C(2, 1) += p.x();
  }
  C.cwiseAbs().maxCoeff(&row, &column);

  for (const Vector3d& line : {Vector3d(C.row(row)), Vector3d(C.col(column))}) {
    // s = e cos(f) + g sin(f) on the line: A cos^2 + 2 B cos sin + D sin^2 = 0
    const Vector3d e = line.unitOrthogonal(), g = line.normalized().cross(e);
    const Matrix3d& conic = C_2;
    const double A = e.dot(conic * e), B = e.dot(conic * g), D = g.dot(conic * g);
    const double root = std::sqrt(std::max(0.0, B * B - A * D));
    const double q = -B - std::copysign(root, B);
    for (const auto& [cosine, sine] : {std::pair{q, A}, std::pair{D, q}}) {
      Vector3d s = cosine * e + sine * g;
      if (s.sum() < 0.0) s = -s;
      if (!(s.minCoeff() > 0.0)) continue;
      const double scale = s.dot(M_12 * s) + s.dot(M_13 * s) + s.dot(M_23 * s);
      if (!(scale > 0.0)) continue;
      s *= std::sqrt(distances.squaredNorm() / scale);
      if (s.allFinite()) out.ranges[static_cast<std::size_t>(out.count++)] = s;
      if (root == 0.0) break;
    }
  }
  return out;
}

}  // namespace turntable
