// Imaging ray-tracking model (IRT): a camera as two polynomial maps from pixel to plane.
//   x_p(u, v) = sum_{r+s<=q} C^p_rs u^r v^s,   y_p = sum D^p_rs u^r v^s,   p in {a, b}
// (paper eq. 1, 3, 4).
// The fit is linear. It is done in products of Legendre polynomials of pixels normalised to [-1,
// 1], where the normal equations stay well conditioned (raw pixels at q = 5: 1e16), and reaches
// directly the least-squares solution that the paper reaches by Levenberg-Marquardt. Raw monomials
// are made only to print a table.
//   paper       here
//   q           order            r, s   powers of u, v
//   C, D        columns 0, 2 (x on a, b) and 1, 3 (y on a, b) of the coefficients
// Points on more than two planes all enter: x(z) = x_a + (x_b - x_a) (z - a) / (b - a), linear in
// the coefficients. With the row phi of basis functions and lambda = (z - a) / (b - a), a point
// gives a = [(1 - lambda) phi, lambda phi], the same for x and y, and the statistics are those of
// linear least squares (Draper & Smith, Applied Regression Analysis, 3rd ed., ch. 5, 8):
//   weight        w = 1 / (sigma_px . mm per px), or 1 where the points state no uncertainty
//   covariance    s^2 (A^T W^2 A)^-1,  s^2 = max(1, chi^2 / dof) (Birge 1932), or the residuals' variance
//   leverage      h_i = w_i^2 a_i (A^T W^2 A)^-1 a_i^T;   left out: residual_i / (1 - h_i)
// The covariance holds the noise of the points. What a polynomial of this order cannot follow shows
// in held-out planes and in chi^2 alone.
// Units: px, mm. Domain: the pixels inside the convex hull of the calibrated ones on every fitted
// plane; `in_domain` tells, `ray` and its uncertainty answer everywhere.
#pragma once

#include <Eigen/Core>
#include <cmath>
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
  /// Standard uncertainty of each pixel coordinate. 0 = unknown; if it is so for one point, all weigh the same.
  double sigma_px = 0.0;
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

  /// Covariance of the coefficients (x_a.., x_b..) of one coordinate, mm^2, 2 terms x 2 terms, rows
  /// by `terms(order)`; that of y is the same. Empty if not known.
  const Eigen::MatrixXd& covariance() const { return covariance_; }
  /// @throws Error if the matrix is neither empty nor 2 terms x 2 terms.
  void set_covariance(Eigen::MatrixXd covariance);
  /// Covariance of the ray's (value on a, value on b) of one coordinate, mm^2; NaN without covariance.
  Eigen::Matrix2d ray_covariance(const Vector2d& pixel_px) const;
  /// The same of several rays together, which share the coefficients: (values on a, then values on b),
  /// 2n x 2n.
  Eigen::MatrixXd joint_ray_covariance(std::span<const Vector2d> pixels_px) const;
  /// Standard uncertainty of the ray's x, and of its y, at height z, mm; NaN without covariance.
  double sigma_mm(const Vector2d& pixel_px, double z_mm) const;
  /// Local scale at height z: sqrt|det d(x,y)/d(u,v)|.
  double mm_per_px(const Vector2d& pixel_px, double z_mm) const;

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
  /// The basis functions P_r(u) P_s(v) at a pixel, by `terms(order)`.
  static void basis(const Vector2d& pixel_px, ImageSize size, int order, double* out);

  /// det d(x,y)/d(u,v) on planes a and b, mm^2/px^2, over a grid of the domain: smallest and
  /// largest. A right-handed plane frame (y up, z towards the camera, v down) has negative values
  /// only.
  std::pair<double, double> jacobian_range() const;
  /// Point nearest to all rays of a grid over the domain, and the rms distance of the rays from it,
  /// mm.
  std::pair<Vector3d, double> bundle_centre() const;

 private:
  std::vector<Vector2d> grid() const;
  double determinant(const Vector2d& pixel_px, double z_mm) const;

  ImageSize size_{};
  RayPlanes planes_{};
  int order_ = 0;
  Eigen::MatrixX4d coefficients_;
  std::vector<Vector2d> hull_;
  Eigen::MatrixXd covariance_;
};

/// A value of a map over the image.
struct MapPoint {
  Vector2d pixel_px = Vector2d::Zero();
  double value = 0.0;
  bool in_domain = false;
};
/// `IrtModel::sigma_mm` at height z over steps x steps pixels of the whole image, row by row.
std::vector<MapPoint> sigma_map(const IrtModel& model, double z_mm, int steps);
/// Perpendicular distance of each ray from `IrtModel::bundle_centre`, mm: 0 everywhere for a central
/// camera.
std::vector<MapPoint> bundle_map(const IrtModel& model, int steps);

/// @throws ConfigError (file `name`) if the model is left-handed, folds over, or covers no part of
/// the image, with what to do; it is then never used.
void check_handedness(const IrtModel& model, const std::string& name);

/// A plane whose points cover less of what all planes show is a strip: it limits the domain.
constexpr double kStripCoverage = 0.5;

/// What one plane of a fit contributes.
struct FittedPlane {
  double z_mm = 0.0;
  int points = 0;         ///< used
  double coverage = 0.0;  ///< area of its hull over that of the hull of all planes' points, 0..1
  /// Largest standard uncertainty of the model at this height inside the domain, in those of the
  /// plane's points: below 1 where they determine it well.
  double noise_gain = 0.0;

  bool is_strip() const { return coverage < kStripCoverage; }
};

/// A used point's residual, that of a fit without the point, and its leverage.
struct PointStatistics {
  std::size_t index = 0;  ///< into the points given
  Vector2d residual_mm = Vector2d::Zero();
  Vector2d left_out_mm = Vector2d::Zero();
  double leverage = 0.0;  ///< 0..1: how much of the point's own error the fit follows
};

struct IrtFit {
  IrtModel model;                    ///< with covariance
  std::vector<PlanePoint> outliers;  ///< left out of the fit, by name
  double sigma_mm = 0.0;      ///< rms residual per coordinate with the fit's degrees of freedom
  int points = 0;             ///< used
  double condition = 0.0;     ///< of the weighted design matrix
  double chi2_per_dof = NAN;  ///< observed over stated variance of the points; NaN if not stated
  double rms_mm = 0.0, max_mm = 0.0;  ///< residual lengths of the used points
  double loo_rms_mm = 0.0;            ///< the same, each of a fit without the point
  double max_leverage = 0.0;
  std::vector<FittedPlane> planes;    ///< by height
  std::vector<PointStatistics> used;  ///< in the order of the points given
};

/// Least squares with outliers removed, the worst first: more than 6 robust standard deviations and
/// 0.1 px off, at most a tenth of the points.
/// @throws Error if the points do not carry the order: fewer than 1.5 points per coefficient and
/// plane, or a plane whose points do not determine it; the message names the plane and the order
/// that it carries.
IrtFit fit_irt(std::span<const PlanePoint> points, RayPlanes planes, int order, ImageSize size);

/// Point of the ray at the point's height minus the point, mm.
Vector2d residual_mm(const IrtModel& model, const PlanePoint& point);

}  // namespace turntable
