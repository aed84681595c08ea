#include "src/attitude/target.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace turntable {
namespace {

using Vectors = TargetModel::Columns;  // 3 x (n-1), columns M0Mt

Vectors vectors_from_first(std::span<const Vector3d> points_mm) {
  Vectors G(3, static_cast<Eigen::Index>(points_mm.size()) - 1);
  for (Eigen::Index t = 0; t < G.cols(); ++t)
    G.col(t) = points_mm[static_cast<std::size_t>(t) + 1] - points_mm[0];
  return G;
}

/// Of G^T G: its eigenvalues are the squares of G's singular values. Three unknowns and thicknesses
/// above a hundredth leave twelve digits.
Eigen::SelfAdjointEigenSolver<Matrix3d> spread_of(const Vectors& vectors) {
  Matrix3d sum = Matrix3d::Zero();
  for (Eigen::Index t = 0; t < vectors.cols(); ++t)
    sum += vectors.col(t) * vectors.col(t).transpose();
  return Eigen::SelfAdjointEigenSolver<Matrix3d>(sum);
}

/// Singular value `which`, counted from the smallest, over the largest.
double share_of(const Eigen::SelfAdjointEigenSolver<Matrix3d>& spread, Eigen::Index which) {
  const auto& squares = spread.eigenvalues();
  return squares(2) > 0.0 ? std::sqrt(std::max(squares(which), 0.0) / squares(2)) : 0.0;
}

}  // namespace

std::string TargetModel::refusal(std::span<const Vector3d> points_mm) {
  if (points_mm.size() < 4)
    return fmt::format("a target needs at least four points; {} given", points_mm.size());
  if (points_mm.size() > static_cast<std::size_t>(kMaxTargetPoints))
    return fmt::format("a target may have up to {} points; {} given", kMaxTargetPoints,
                       points_mm.size());
  for (std::size_t t = 0; t < points_mm.size(); ++t)
    if (!points_mm[t].allFinite())
      return fmt::format("target point {} (counted from 0) is not a finite position", t);
  const double width = share_of(spread_of(vectors_from_first(points_mm)), 1);
  if (!(width >= kMinThickness))
    return fmt::format(
        "the target points are on one line or nearly so: the middle singular value of the vectors "
        "from the first point is {:.2g} of the largest, at least {} is needed; move a point away "
        "from the line",
        width, kMinThickness);
  return {};
}

TargetModel::TargetModel(std::span<const Vector3d> points_mm) {
  if (const std::string reason = refusal(points_mm); !reason.empty())
    throw std::invalid_argument(reason);
  vectors_ = vectors_from_first(points_mm);
  points_.resize(3, vectors_.cols() + 1);
  for (Eigen::Index t = 0; t < points_.cols(); ++t)
    points_.col(t) = points_mm[static_cast<std::size_t>(t)];
  const Eigen::SelfAdjointEigenSolver<Matrix3d> spread = spread_of(vectors_);
  radius_mm_ = std::sqrt(vectors_.colwise().squaredNorm().maxCoeff());
  thickness_ = share_of(spread, 0);
  normal_ = spread.eigenvectors().col(0);
  Vector3d inverse = spread.eigenvalues().cwiseInverse();
  if (coplanar()) inverse.x() = 0.0;
  const Matrix3d square = spread.eigenvectors() * inverse.asDiagonal() *
                          spread.eigenvectors().transpose();  // of the pseudo-inverse
  pseudo_inverse_.resize(3, vectors_.cols());
  for (Eigen::Index t = 0; t < vectors_.cols(); ++t)
    pseudo_inverse_.col(t) = square * vectors_.col(t);
}

}  // namespace turntable
