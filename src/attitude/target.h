// What the solvers know of the target, prepared once per target and not per image.
//   G (n-1 x 3) has the rows M0Mt, H = pinv(G) (3 x n-1), so that a = H (G a) for every a.
// Source: DeMenthon & Davis 1995, "object matrix"; X. Guo et al. 2019, eq. 18.
//   M0 -> points()[0], G^T -> vectors(), H -> pseudo_inverse(); mm, and 1/mm for H.
// Domain: 4 to 32 points that span space, or a plane: then H is the pseudo-inverse of rank 2 and
// H^T n = 0 for the plane's normal n. Points on a line are refused when the target is built.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>

#include "src/geometry/rotation.h"

namespace turntable {

/// Points a target may have. Everything sized by it lives on the stack: a solve allocates nothing.
constexpr int kMaxTargetPoints = 32;
/// A target whose smallest singular value is less than this share of its largest counts as
/// coplanar: H would amplify noise along the normal a hundred times. If the middle one is, as a line.
constexpr double kMinThickness = 0.01;

class TargetModel {
 public:
  using Columns = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::ColMajor, 3, kMaxTargetPoints>;

  /// Why `points_mm` cannot serve as a target, as a sentence; empty if it can.
  static std::string refusal(std::span<const Vector3d> points_mm);

  /// @param points_mm in the target frame; the first one is M0, to which the solvers refer
  /// positions.
  /// @throws std::invalid_argument with the text of `refusal`.
  explicit TargetModel(std::span<const Vector3d> points_mm);

  /// Number of points, n.
  int size() const { return static_cast<int>(points_.cols()); }
  /// Number of vectors M0Mt, n - 1.
  int vector_count() const { return size() - 1; }
  /// 3 x n, mm.
  const Columns& points() const { return points_; }
  /// 3 x (n-1): column t-1 is M0Mt, mm.
  const Columns& vectors() const { return vectors_; }
  /// 3 x (n-1): H, 1/mm.
  const Columns& pseudo_inverse() const { return pseudo_inverse_; }
  /// Longest |M0Mt|, mm: the length that tolerances are judged by.
  double radius_mm() const { return radius_mm_; }
  /// Smallest over largest singular value of G, in [0, 1].
  double thickness() const { return thickness_; }
  /// The points lie in a plane, or nearly so (kMinThickness): two attitudes may look alike.
  bool coplanar() const { return thickness_ < kMinThickness; }
  /// Unit normal of the plane that fits the vectors M0Mt best, either sign.
  const Vector3d& normal() const { return normal_; }

 private:
  Columns points_, vectors_, pseudo_inverse_;
  double radius_mm_ = 0.0;
  double thickness_ = 0.0;
  Vector3d normal_;
};

}  // namespace turntable
