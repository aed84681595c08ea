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

double thickness_of(const Eigen::JacobiSVD<Vectors>& svd) {
  const auto& sigma = svd.singularValues();
  return sigma(0) > 0.0 ? sigma(2) / sigma(0) : 0.0;
}

}  // namespace

std::string TargetModel::refusal(std::span<const Vector3d> points_mm) {
  if (points_mm.size() < 4)
    return fmt::format("a target needs at least four points that are not coplanar; {} given",
                       points_mm.size());
  if (points_mm.size() > static_cast<std::size_t>(kMaxTargetPoints))
    return fmt::format("a target may have up to {} points; {} given", kMaxTargetPoints,
                       points_mm.size());
  for (std::size_t t = 0; t < points_mm.size(); ++t)
    if (!points_mm[t].allFinite())
      return fmt::format("target point {} (counted from 0) is not a finite position", t);
  const double thickness = thickness_of(Eigen::JacobiSVD<Vectors>(vectors_from_first(points_mm)));
  if (!(thickness >= kMinThickness))
    return fmt::format(
        "the target points are coplanar or nearly so: the smallest singular value of the vectors "
        "from "
        "the first point is {:.2g} of the largest, at least {} is needed; move a point out of the "
        "plane",
        thickness, kMinThickness);
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
  pseudo_inverse_ =
      svd.matrixV() * svd.singularValues().cwiseInverse().asDiagonal() * svd.matrixU().transpose();
  radius_mm_ = std::sqrt(vectors_.colwise().squaredNorm().maxCoeff());
  thickness_ = thickness_of(svd);
}

}  // namespace turntable
