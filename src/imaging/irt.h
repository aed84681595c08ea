// Imaging ray-tracking model (IRT): a camera as two polynomial maps from pixel to plane.
//   x_p(u, v) = sum_{r+s<=q} C^p_rs u^r v^s,   y_p = sum D^p_rs u^r v^s,   p in {a, b}
// (paper eq. 1, 3, 4).
// The fit is linear. It is done in products of Legendre polynomials of pixels normalised to [-1,
// 1], where the normal equations stay well conditioned (raw pixels at q = 5: 1e16), by QR, which
// reaches the least-squares solution that the paper reaches by Levenberg-Marquardt. Raw monomials
// are made only to print a table.
//   paper       here
//   q           order            r, s   powers of u, v
//   C, D        columns 0, 2 (x on a, b) and 1, 3 (y on a, b) of the coefficients
// Points on more than two planes all enter: x(z) = x_a + (x_b - x_a) (z - a) / (b - a), linear in
// the coefficients. Units: px, mm. Domain: the pixels inside the convex hull of the calibrated
// ones on every fitted plane; `in_domain` tells, `ray` answers everywhere.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "src/core/image.h"
#include "src/geometry/ray.h"

namespace turntable {

/// One circle seen on one plane.
struct PlanePoint {
  Vector2d pixel_px = Vector2d::Zero();
  Vector2d on_plane_mm = Vector2d::Zero();
  double z_mm = 0.0;
  int column = 0, row = 0;  ///< its name, for reports
};

/// Whether v of a file's coefficients runs down the image, as everywhere in this project, or up.
enum class VDirection { kDown, kUp };

class IrtModel {
 public:
  IrtModel() = default;
  /// @param coefficients terms x 4 (x_a, y_a, x_b, y_b) in the Legendre basis, rows by
  /// `terms(order)`.
  IrtModel(ImageSize size, RayPlanes planes, int order, Eigen::MatrixX4d coefficients,
           std::vector<Vector2d> domain_hull_px);

  /// Ray of a pixel; cheap, defined everywhere, but see `in_domain`.
  Ray ray(const Vector2d& pixel_px) const;
  bool in_domain(const Vector2d& pixel_px) const;

  ImageSize image_size() const { return size_; }
  const RayPlanes& planes() const { return planes_; }
  int order() const { return order_; }
  const Eigen::MatrixX4d& coefficients() const { return coefficients_; }
  const std::vector<Vector2d>& domain_hull_px() const { return hull_; }

  /// The same model as coefficients of u^r v^s in raw pixels (columns as above, rows by
  /// `terms(order)`).
  Eigen::MatrixX4d monomials(VDirection v) const;
  static IrtModel from_monomials(ImageSize size, RayPlanes planes, int order,
                                 const Eigen::MatrixX4d& monomials, VDirection v,
                                 std::vector<Vector2d> domain_hull_px);

  /// (r, s) of each coefficient row: r + s <= order, by r, then s.
  static std::vector<std::pair<int, int>> terms(int order);

  /// det d(x,y)/d(u,v) on planes a and b, mm^2/px^2, over a grid of the domain: smallest and
  /// largest. A right-handed plane frame (y up, z towards the camera, v down) has negative values
  /// only.
  std::pair<double, double> jacobian_range() const;
  /// Point nearest to all rays of a grid over the domain, and the rms distance of the rays from it,
  /// mm.
  std::pair<Vector3d, double> bundle_centre() const;

 private:
  std::vector<Vector2d> grid() const;

  ImageSize size_{};
  RayPlanes planes_{};
  int order_ = 0;
  Eigen::MatrixX4d coefficients_;
  std::vector<Vector2d> hull_;
};

/// @throws ConfigError (file `name`) if the model is left-handed, folds over, or covers no part of
/// the image, with what to do; it is then never used.
void check_handedness(const IrtModel& model, const std::string& name);

struct IrtFit {
  IrtModel model;
  std::vector<PlanePoint> outliers;  ///< left out of the fit, by name
  double sigma_mm = 0.0;  ///< rms residual per coordinate with the fit's degrees of freedom
  int points = 0;         ///< used
};

/// Least squares with outliers removed, the worst first: more than 6 robust standard deviations and
/// 0.1 px off, at most a tenth of the points.
/// @throws Error if the points do not carry the order: fewer than 1.5 points per coefficient and
/// plane, or a numerically singular system; the message says what order they would carry.
IrtFit fit_irt(std::span<const PlanePoint> points, RayPlanes planes, int order, ImageSize size);

/// Point of the ray at the point's height minus the point, mm.
Vector2d residual_mm(const IrtModel& model, const PlanePoint& point);

}  // namespace turntable
