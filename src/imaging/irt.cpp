#include "src/imaging/irt.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr int kMaxOrder = 12;
constexpr int kMaxTerms = (kMaxOrder + 1) * (kMaxOrder + 2) / 2;

/// P_0..P_order at t.
void legendre(double t, int order, double* out) {
  out[0] = 1.0;
  if (order >= 1) out[1] = t;
  for (int k = 1; k < order; ++k)
    out[k + 1] = ((2 * k + 1) * t * out[k] - k * out[k - 1]) / (k + 1);
}

/// Pixel to [-1, 1].
double normalised(double pixel, int extent) { return (2.0 * pixel - (extent - 1)) / (extent - 1); }

/// Row k: coefficients of P_k in powers of t.
Eigen::MatrixXd legendre_in_powers(int order) {
  Eigen::MatrixXd L = Eigen::MatrixXd::Zero(order + 1, order + 1);
  L(0, 0) = 1.0;
  if (order >= 1) L(1, 1) = 1.0;
  for (int k = 1; k < order; ++k)
    for (int p = 0; p <= k + 1; ++p)
      L(k + 1, p) = ((p > 0 ? (2 * k + 1) * L(k, p - 1) : 0.0) - k * L(k - 1, p)) / (k + 1);
  return L;
}

/// Row n: coefficients of t^n in P_k, by  (2k+1) t P_k = (k+1) P_k+1 + k P_k-1.
Eigen::MatrixXd powers_in_legendre(int order) {
  Eigen::MatrixXd T = Eigen::MatrixXd::Zero(order + 1, order + 1);
  T(0, 0) = 1.0;
  for (int n = 0; n < order; ++n)
    for (int k = 0; k <= n; ++k) {
      T(n + 1, k + 1) += T(n, k) * (k + 1) / (2 * k + 1);
      if (k > 0) T(n + 1, k - 1) += T(n, k) * k / (2 * k + 1);
    }
  return T;
}

/// Row n: coefficients of (offset + scale x)^n in powers of x.
Eigen::MatrixXd binomials(int order, double offset, double scale) {
  Eigen::MatrixXd B = Eigen::MatrixXd::Zero(order + 1, order + 1);
  B(0, 0) = 1.0;
  for (int n = 1; n <= order; ++n)
    for (int p = 0; p <= n; ++p)
      B(n, p) = offset * B(n - 1, p) + (p > 0 ? scale * B(n - 1, p - 1) : 0.0);
  return B;
}

/// Rewrites sum c_rs f_r(u) f_s(v) in other functions:  f_r = sum_p U(r, p) g_p  and likewise V for
/// v.
Eigen::MatrixX4d change_basis(const Eigen::MatrixX4d& c, int order, const Eigen::MatrixXd& U,
                              const Eigen::MatrixXd& V) {
  const auto terms = IrtModel::terms(order);
  Eigen::MatrixX4d out = Eigen::MatrixX4d::Zero(c.rows(), 4);
  for (std::size_t i = 0; i < terms.size(); ++i)
    for (std::size_t j = 0; j < terms.size(); ++j) {
      const auto [r, s] = terms[i];
      const auto [p, q] = terms[j];
      if (p <= r && q <= s)
        out.row(static_cast<Eigen::Index>(j)) +=
            U(r, p) * V(s, q) * c.row(static_cast<Eigen::Index>(i));
    }
  return out;
}

/// Pixels of a grid over the whole image, row by row.
std::vector<Vector2d> image_grid(ImageSize size, int steps) {
  std::vector<Vector2d> out;
  const double last = std::max(1, steps - 1);
  for (int j = 0; j < steps; ++j)
    for (int i = 0; i < steps; ++i)
      out.emplace_back(i * (size.width - 1.0) / last, j * (size.height - 1.0) / last);
  return out;
}

std::vector<MapPoint> map_of(const IrtModel& model, int steps,
                             const std::function<double(const Vector2d&)>& value) {
  std::vector<MapPoint> out;
  for (const Vector2d& p : image_grid(model.image_size(), steps))
    out.push_back({p, value(p), model.in_domain(p)});
  return out;
}

}  // namespace

IrtModel::IrtModel(ImageSize size, RayPlanes planes, int order, Eigen::MatrixX4d coefficients,
                   std::vector<Vector2d> domain_hull_px)
    : size_(size),
      planes_(planes),
      order_(order),
      coefficients_(std::move(coefficients)),
      hull_(std::move(domain_hull_px)) {}

std::vector<std::pair<int, int>> IrtModel::terms(int order) {
  std::vector<std::pair<int, int>> out;
  for (int r = 0; r <= order; ++r)
    for (int s = 0; r + s <= order; ++s) out.emplace_back(r, s);
  return out;
}

void IrtModel::basis(const Vector2d& pixel_px, ImageSize size, int order, double* out) {
  double pu[kMaxOrder + 1], pv[kMaxOrder + 1];
  legendre(normalised(pixel_px.x(), size.width), order, pu);
  legendre(normalised(pixel_px.y(), size.height), order, pv);
  for (int r = 0; r <= order; ++r)
    for (int s = 0; r + s <= order; ++s) *out++ = pu[r] * pv[s];
}

Ray IrtModel::ray(const Vector2d& pixel_px) const {
  double phi[kMaxTerms];
  basis(pixel_px, size_, order_, phi);
  const Eigen::Index n = coefficients_.rows();
  const double* c = coefficients_.data();
  Ray out;
  for (Eigen::Index i = 0; i < n; ++i) {
    out.at_a.x() += phi[i] * c[i];
    out.at_a.y() += phi[i] * c[i + n];
    out.at_b.x() += phi[i] * c[i + 2 * n];
    out.at_b.y() += phi[i] * c[i + 3 * n];
  }
  return out;
}

void IrtModel::set_covariance(Eigen::MatrixXd covariance) {
  const Eigen::Index size = 2 * coefficients_.rows();
  if (covariance.size() != 0 && (covariance.rows() != size || covariance.cols() != size))
    throw Error(
        fmt::format("covariance of a ray model of order {}: found {} x {}, needed: {} x {}.",
                    order_, covariance.rows(), covariance.cols(), size, size));
  covariance_ = std::move(covariance);
}

Eigen::Matrix2d IrtModel::ray_covariance(const Vector2d& pixel_px) const {
  if (covariance_.size() == 0) return Eigen::Matrix2d::Constant(NAN);
  double phi[kMaxTerms];
  basis(pixel_px, size_, order_, phi);
  const Eigen::Index n = coefficients_.rows();
  double sum[2][2] = {};  // the lower triangle, and its columns run in memory
  for (int p = 0; p < 2; ++p)
    for (int q = p; q < 2; ++q)
      for (Eigen::Index j = 0; j < n; ++j) {
        const double* column = &covariance_(q * n, p * n + j);
        double dot = 0.0;
        for (Eigen::Index i = 0; i < n; ++i) dot += phi[i] * column[i];
        sum[q][p] += phi[j] * dot;
      }
  Eigen::Matrix2d out;
  out << sum[0][0], sum[1][0], sum[1][0], sum[1][1];
  return out;
}

Eigen::MatrixXd IrtModel::joint_ray_covariance(std::span<const Vector2d> pixels_px) const {
  const auto n = static_cast<Eigen::Index>(pixels_px.size()), terms = coefficients_.rows();
  if (covariance_.size() == 0) return Eigen::MatrixXd::Constant(2 * n, 2 * n, NAN);
  Eigen::MatrixXd phi = Eigen::MatrixXd::Zero(2 * terms, 2 * n);
  for (Eigen::Index t = 0; t < n; ++t) {
    basis(pixels_px[static_cast<std::size_t>(t)], size_, order_, &phi(0, t));
    phi.block(terms, n + t, terms, 1) = phi.block(0, t, terms, 1);
  }
  return phi.transpose() * covariance_ * phi;
}

double IrtModel::sigma_mm(const Vector2d& pixel_px, double z_mm) const {
  const Eigen::Matrix2d C = ray_covariance(pixel_px);
  const double lambda = (z_mm - planes_.a_mm) / (planes_.b_mm - planes_.a_mm), mu = 1.0 - lambda;
  // max lets NaN through.
  return std::sqrt(
      std::max(mu * mu * C(0, 0) + 2.0 * mu * lambda * C(0, 1) + lambda * lambda * C(1, 1), 0.0));
}

double IrtModel::determinant(const Vector2d& pixel_px, double z_mm) const {
  const auto at = [&](double du, double dv) {
    return ray(pixel_px + Vector2d(du, dv)).at(z_mm, planes_);
  };
  const Vector2d du = at(0.5, 0) - at(-0.5, 0), dv = at(0, 0.5) - at(0, -0.5);
  return du.x() * dv.y() - du.y() * dv.x();
}

double IrtModel::mm_per_px(const Vector2d& pixel_px, double z_mm) const {
  return std::sqrt(std::abs(determinant(pixel_px, z_mm)));
}

bool IrtModel::in_domain(const Vector2d& pixel_px) const {
  for (std::size_t i = 0; i < hull_.size(); ++i) {
    const Vector2d edge = hull_[(i + 1) % hull_.size()] - hull_[i];
    const Vector2d to = pixel_px - hull_[i];
    if (edge.x() * to.y() - edge.y() * to.x() < 0) return false;
  }
  return hull_.size() >= 3;
}

Eigen::MatrixX4d IrtModel::monomials(VDirection v) const {
  // t_u = -1 + 2 u / (w - 1);  v down: t_v = -1 + 2 v / (h - 1);  v up: t_v = 1 - 2 v' / (h - 1)
  const double su = 2.0 / (size_.width - 1), sv = 2.0 / (size_.height - 1);
  const Eigen::MatrixXd L = legendre_in_powers(order_);
  const Eigen::MatrixXd U = L * binomials(order_, -1.0, su);
  const Eigen::MatrixXd V =
      L * (v == VDirection::kDown ? binomials(order_, -1.0, sv) : binomials(order_, 1.0, -sv));
  return change_basis(coefficients_, order_, U, V);
}

IrtModel IrtModel::from_monomials(ImageSize size, RayPlanes planes, int order,
                                  const Eigen::MatrixX4d& monomials, VDirection v,
                                  std::vector<Vector2d> domain_hull_px) {
  // u = (w - 1) (1 + t) / 2
  const double hu = 0.5 * (size.width - 1), hv = 0.5 * (size.height - 1);
  const Eigen::MatrixXd P = powers_in_legendre(order);
  const Eigen::MatrixXd U = binomials(order, hu, hu) * P;
  const Eigen::MatrixXd V =
      (v == VDirection::kDown ? binomials(order, hv, hv) : binomials(order, hv, -hv)) * P;
  return IrtModel(size, planes, order, change_basis(monomials, order, U, V),
                  std::move(domain_hull_px));
}

std::vector<Vector2d> IrtModel::grid() const {
  std::vector<Vector2d> out = image_grid(size_, 21);
  std::erase_if(out, [&](const Vector2d& p) { return !in_domain(p); });
  return out;
}

std::pair<double, double> IrtModel::jacobian_range() const {
  double low = INFINITY, high = -INFINITY;
  for (const Vector2d& p : grid())
    for (const double z : {planes_.a_mm, planes_.b_mm}) {
      const double det = determinant(p, z);
      low = std::min(low, det);
      high = std::max(high, det);
    }
  return {low, high};
}

std::pair<Vector3d, double> IrtModel::bundle_centre() const {
  // Least squares over rays: sum (I - d d^T) (c - p) = 0.
  Matrix3d A = Matrix3d::Zero();
  Vector3d b = Vector3d::Zero();
  const auto pixels = grid();
  const auto projector = [&](const Ray& r) -> Matrix3d {
    const Vector3d d = Vector3d(r.slope(planes_).x(), r.slope(planes_).y(), 1.0).normalized();
    return Matrix3d::Identity() - d * d.transpose();
  };
  for (const Vector2d& p : pixels) {
    const Ray r = ray(p);
    A += projector(r);
    b += projector(r) * Vector3d(r.at_a.x(), r.at_a.y(), planes_.a_mm);
  }
  const Vector3d centre = A.inverse() * b;
  double sum = 0.0;
  for (const Vector2d& p : pixels) sum += std::pow(distance_mm(centre, ray(p), planes_), 2);
  return {centre, std::sqrt(sum / static_cast<double>(std::max<std::size_t>(1, pixels.size())))};
}

std::vector<MapPoint> sigma_map(const IrtModel& model, double z_mm, int steps) {
  return map_of(model, steps, [&](const Vector2d& p) { return model.sigma_mm(p, z_mm); });
}

std::vector<MapPoint> bundle_map(const IrtModel& model, int steps) {
  const Vector3d centre = model.bundle_centre().first;
  return map_of(model, steps, [&](const Vector2d& p) {
    return distance_mm(centre, model.ray(p), model.planes());
  });
}

void check_handedness(const IrtModel& model, const std::string& name) {
  const auto [low, high] = model.jacobian_range();
  if (!(low <= high)) throw ConfigError(name, "", "the calibration covers no part of the image.");
  if (low > 0.0)
    throw ConfigError(name, "",
                      fmt::format("the calibration is left-handed: det d(x,y)/d(u,v) = "
                                  "{:.3g}..{:.3g} mm^2/px^2, allowed: < 0 "
                                  "(y up, z towards the camera, v down the image). Attitudes would "
                                  "come out mirrored. If the "
                                  "coefficients count v upwards, state \"v_direction\": \"up\"; if "
                                  "the points of a calibration set do, \"v_counts\": \"up\"; if "
                                  "the pattern's y runs down, correct its direction circles.",
                                  low, high));
  if (high >= 0.0)
    throw ConfigError(
        name, "",
        fmt::format("the map from pixel to plane folds over: det d(x,y)/d(u,v) = {:.3g}..{:.3g} "
                    "mm^2/px^2 changes its sign. Lower the order or add points.",
                    low, high));
}

Vector2d residual_mm(const IrtModel& model, const PlanePoint& point) {
  return model.ray(point.pixel_px).at(point.z_mm, model.planes()) - point.on_plane_mm;
}

}  // namespace turntable
