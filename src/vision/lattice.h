// Square lattices of circles: who is whose neighbour, and one smooth map through all of them.
#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "src/vision/circles.h"

namespace turntable {

struct LatticeNode {
  std::size_t circle = 0;       ///< index into the circles
  Eigen::Vector2i at;           ///< lattice position (column, row), from an arbitrary circle
  Eigen::Matrix2d px_per_step;  ///< local map: one column, one row
};

struct LatticeShape {
  double radius = 0.25;          ///< of the circles, in lattice steps
  double largest_radius = 0.25;  ///< of the bigger ones among them
};

/// The largest lattice that holds together from neighbour to neighbour: circles are reached from a
/// seed, breadth first, each where the local affine map of those before expects it. That follows
/// perspective and distortion, however strong over the whole image, as long as they are weak from
/// step to step. Gaps of up to three steps are crossed; circles of another size than `shape` allows
/// are not looked at. Columns and rows are arbitrary up to turns of 90 degrees and a shift, but
/// counted so that the lattice is not mirrored: rows run up where columns run right (v runs down).
/// Needs a seed with seven of its eight neighbours, or five where there is none.
std::vector<LatticeNode> grow_lattice(std::span<const Circle> circles, const LatticeShape& shape);

/// Pixel from pattern position: a homography, then a polynomial in the image for what the lens adds
/// (degree 5 from 90 points, 3 from 30, none below). Coordinates on the pattern are in any unit.
class PatternMap {
 public:
  /// Linear least squares, the homography (its last element 1) and then the polynomial.
  /// @return false for fewer than 6 points, or points that carry no homography.
  bool fit(std::span<const Eigen::Vector2d> on_pattern, std::span<const Eigen::Vector2d> px);

  struct Taylor {
    Eigen::Vector2d px;
    Eigen::Matrix2d J;           ///< d px / d pattern
    Eigen::Vector2d xx, xy, yy;  ///< second derivatives
  };
  Taylor at(const Eigen::Vector2d& on_pattern) const;
  Eigen::Vector2d operator()(const Eigen::Vector2d& on_pattern) const { return at(on_pattern).px; }
  /// How much of a fitted point's own error the map follows, 0..1 (nearly: the homography's part is
  /// taken as a quadratic's). Without the point its residual r would be r / (1 - leverage).
  double leverage(const Eigen::Vector2d& on_pattern) const;

 private:
  Eigen::Vector2d middle_, px_middle_;
  double scale_ = 1.0, px_scale_ = 1.0;
  Eigen::Matrix3d H_ = Eigen::Matrix3d::Identity();
  int degree_ = 0, basis_ = 2;
  Eigen::MatrixXd inverse_;               ///< of the polynomial's normal matrix
  std::array<Eigen::Vector2d, 21> bend_;  ///< coefficients, normalised px
};

/// Centroid of the image of a disc minus image of its centre, px, to second order in the radius:
///   r^2/8 (f_xx + f_yy) + r^2/4 J grad log |det J|
/// for f the map from pattern to pixels and J its derivative, at the disc's centre.
Eigen::Vector2d centroid_bias_px(const PatternMap::Taylor& f, double radius);

}  // namespace turntable
