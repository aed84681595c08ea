#include "src/attitude/target.h"

#include <fmt/format.h>

#include <Eigen/SVD>
#include <cmath>
#include <stdexcept>

namespace turntable {
namespace {

using Vectors = Eigen::MatrixXd;  // n-1 x 3, rows M0Mt; thin SVD asks for dynamic columns

Vectors vectors_from_first(std::span<const Vector3d> points_mm) {
  Vectors G(static_cast<Eigen::Index>(points_mm.size()) - 1, 3);
  for (Eigen::Index t = 0; t < G.rows(); ++t)
    G.row(t) = (points_mm[static_cast<std::size_t>(t) + 1] - points_mm[0]).transpose();
  return G;
}

/// Singular value `which` over the largest.
double share_of(const Eigen::JacobiSVD<Vectors>& svd, Eigen::Index which) {
  const auto& sigma = svd.singularValues();
  return sigma(0) > 0.0 ? sigma(which) / sigma(0) : 0.0;
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
  const double width = share_of(Eigen::JacobiSVD<Vectors>(vectors_from_first(points_mm)), 1);
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
  const Vectors G = vectors_from_first(points_mm);
  const Eigen::JacobiSVD<Vectors> svd(G, Eigen::ComputeThinU | Eigen::ComputeThinV);
  points_.resize(3, G.rows() + 1);
  for (Eigen::Index t = 0; t < points_.cols(); ++t)
    points_.col(t) = points_mm[static_cast<std::size_t>(t)];
  vectors_ = G.transpose();
  radius_mm_ = std::sqrt(vectors_.colwise().squaredNorm().maxCoeff());
  thickness_ = share_of(svd, 2);
  normal_ = svd.matrixV().col(2);
  Vector3d inverse = svd.singularValues().cwiseInverse();
  if (coplanar()) inverse.z() = 0.0;
  pseudo_inverse_ = svd.matrixV() * inverse.asDiagonal() * svd.matrixU().transpose();
}

}  // namespace turntable
