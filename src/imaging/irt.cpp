#include "src/imaging/irt.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <map>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr int kMaxOrder = 12;
constexpr double kOutlierSigmas = 6.0;
/// A circle this near is neither a wrong match nor smeared; where noise is lower still, the model's
/// own error shows.
constexpr double kNeverOutlierPx = 0.1;

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

Eigen::VectorXd basis(const Vector2d& pixel, ImageSize size, int order) {
  double pu[kMaxOrder + 1], pv[kMaxOrder + 1];
  legendre(normalised(pixel.x(), size.width), order, pu);
  legendre(normalised(pixel.y(), size.height), order, pv);
  Eigen::VectorXd row((order + 1) * (order + 2) / 2);
  Eigen::Index i = 0;
  for (int r = 0; r <= order; ++r)
    for (int s = 0; r + s <= order; ++s) row(i++) = pu[r] * pv[s];
  return row;
}

/// Convex hull, counter-clockwise (monotone chain).
std::vector<Vector2d> convex_hull(std::vector<Vector2d> p) {
  std::ranges::sort(p, [](const Vector2d& a, const Vector2d& b) {
    return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
  });
  const auto cross = [](const Vector2d& o, const Vector2d& a, const Vector2d& b) {
    return (a.x() - o.x()) * (b.y() - o.y()) - (a.y() - o.y()) * (b.x() - o.x());
  };
  std::vector<Vector2d> hull;
  for (int pass = 0; pass < 2; ++pass) {
    const std::size_t start = hull.size();
    for (const Vector2d& q : p) {
      while (hull.size() >= start + 2 && cross(hull[hull.size() - 2], hull.back(), q) <= 0)
        hull.pop_back();
      hull.push_back(q);
    }
    hull.pop_back();
    std::ranges::reverse(p);
  }
  return hull;
}

/// The part of a convex polygon inside another one, both counter-clockwise (Sutherland & Hodgman 1974).
std::vector<Vector2d> intersection(std::vector<Vector2d> polygon,
                                   const std::vector<Vector2d>& clip) {
  for (std::size_t i = 0; i < clip.size(); ++i) {
    const Vector2d edge = clip[(i + 1) % clip.size()] - clip[i];
    const auto inside = [&](const Vector2d& p) {
      return edge.x() * (p - clip[i]).y() - edge.y() * (p - clip[i]).x();
    };
    std::vector<Vector2d> kept;
    for (std::size_t k = 0; k < polygon.size(); ++k) {
      const Vector2d &here = polygon[k], &next = polygon[(k + 1) % polygon.size()];
      const double a = inside(here), b = inside(next);
      if (a >= 0) kept.push_back(here);
      if ((a > 0 && b < 0) || (a < 0 && b > 0))
        kept.push_back(here + (next - here) * (a / (a - b)));
    }
    polygon = std::move(kept);
  }
  return polygon;
}

double median(std::vector<double> v) {
  std::ranges::nth_element(v, v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2));
  return v[v.size() / 2];
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

Ray IrtModel::ray(const Vector2d& pixel_px) const {
  double pu[kMaxOrder + 1], pv[kMaxOrder + 1];
  legendre(normalised(pixel_px.x(), size_.width), order_, pu);
  legendre(normalised(pixel_px.y(), size_.height), order_, pv);
  Eigen::RowVector4d sum = Eigen::RowVector4d::Zero();
  Eigen::Index i = 0;
  for (int r = 0; r <= order_; ++r)
    for (int s = 0; r + s <= order_; ++s) sum += pu[r] * pv[s] * coefficients_.row(i++);
  return {{sum(0), sum(1)}, {sum(2), sum(3)}};
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
  // u = (w - 1) (1 + t) / 2; the powers of t then go to Legendre polynomials by a triangular
  // system.
  const double hu = 0.5 * (size.width - 1), hv = 0.5 * (size.height - 1);
  const Eigen::MatrixXd P = legendre_in_powers(order).triangularView<Eigen::Lower>().solve(
      Eigen::MatrixXd::Identity(order + 1, order + 1));
  const Eigen::MatrixXd U = binomials(order, hu, hu) * P;
  const Eigen::MatrixXd V =
      (v == VDirection::kDown ? binomials(order, hv, hv) : binomials(order, hv, -hv)) * P;
  return IrtModel(size, planes, order, change_basis(monomials, order, U, V),
                  std::move(domain_hull_px));
}

std::vector<Vector2d> IrtModel::grid() const {
  std::vector<Vector2d> out;
  constexpr int kSteps = 21;
  for (int i = 0; i < kSteps; ++i)
    for (int j = 0; j < kSteps; ++j) {
      const Vector2d pixel(i * (size_.width - 1.0) / (kSteps - 1),
                           j * (size_.height - 1.0) / (kSteps - 1));
      if (in_domain(pixel)) out.push_back(pixel);
    }
  return out;
}

std::pair<double, double> IrtModel::jacobian_range() const {
  double low = INFINITY, high = -INFINITY;
  for (const Vector2d& p : grid()) {
    const Ray u0 = ray(p - Vector2d(0.5, 0)), u1 = ray(p + Vector2d(0.5, 0));
    const Ray v0 = ray(p - Vector2d(0, 0.5)), v1 = ray(p + Vector2d(0, 0.5));
    for (const auto& [du, dv] :
         {std::pair<Vector2d, Vector2d>(u1.at_a - u0.at_a, v1.at_a - v0.at_a),
          std::pair<Vector2d, Vector2d>(u1.at_b - u0.at_b, v1.at_b - v0.at_b)}) {
      const double det = du.x() * dv.y() - du.y() * dv.x();
      low = std::min(low, det);
      high = std::max(high, det);
    }
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
                                  "the pattern's y runs down, "
                                  "correct its direction circles in the rig file.",
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

IrtFit fit_irt(std::span<const PlanePoint> points, RayPlanes planes, int order, ImageSize size) {
  if (order < 1 || order > 9)
    throw Error(fmt::format("polynomial order: found {}, allowed: 1 to 9.", order));
  if (!(planes.a_mm < planes.b_mm))
    throw Error(
        fmt::format("planes at {} mm and {} mm: two different heights are needed, the lower first.",
                    planes.a_mm, planes.b_mm));
  const Eigen::Index terms = (order + 1) * (order + 2) / 2;
  std::vector<bool> use(points.size(), true);

  IrtFit fit;
  for (;;) {
    const auto used = std::ranges::count(use, true);
    if (static_cast<double>(used) < 3.0 * static_cast<double>(terms)) {
      int carried = 0;
      while (3 * (carried + 2) * (carried + 3) / 2 <= used) ++carried;
      throw Error(fmt::format(
          "order {} needs at least {} points on the two planes, found {}; they carry order {} "
          "at most. Show more of the pattern or lower the order.",
          order, 3 * terms, used, carried));
    }
    Eigen::MatrixXd A(used, 2 * terms);
    Eigen::MatrixX2d rhs(used, 2);
    Eigen::Index row = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (!use[i]) continue;
      const double lambda = (points[i].z_mm - planes.a_mm) / (planes.b_mm - planes.a_mm);
      const Eigen::VectorXd phi = basis(points[i].pixel_px, size, order);
      A.row(row) << (1.0 - lambda) * phi.transpose(), lambda * phi.transpose();
      rhs.row(row++) = points[i].on_plane_mm.transpose();
    }
    const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(A);
    if (qr.rank() < 2 * terms)
      throw Error(fmt::format(
          "the points do not determine a model of order {} (rank {} of {}): they cover too "
          "narrow a strip, or one plane only. Lower the order or show more of the pattern.",
          order, qr.rank(), 2 * terms));
    const Eigen::MatrixX2d solution = qr.solve(rhs);
    Eigen::MatrixX4d c(terms, 4);
    c << solution.topRows(terms), solution.bottomRows(terms);
    std::map<double, std::vector<Vector2d>> pixels;  // by height
    for (std::size_t i = 0; i < points.size(); ++i)
      if (use[i]) pixels[points[i].z_mm].push_back(points[i].pixel_px);
    std::vector<Vector2d> domain = convex_hull(pixels.begin()->second);
    for (const auto& [z, on_plane] : pixels) domain = intersection(domain, convex_hull(on_plane));
    fit.model = IrtModel(size, planes, order, c, domain);
    fit.points = static_cast<int>(used);
    fit.sigma_mm =
        (A * solution - rhs).norm() /
        std::sqrt(2.0 * static_cast<double>(std::max<Eigen::Index>(1, used - 2 * terms)));

    std::vector<double> misses;
    for (std::size_t i = 0; i < points.size(); ++i)
      if (use[i]) misses.push_back(residual_mm(fit.model, points[i]).norm());
    // The median length of a two-dimensional normal error is 1.1774 standard deviations.
    const Vector2d middle(0.5 * size.width, 0.5 * size.height);
    const double mm_per_px =
        (fit.model.ray(middle + Vector2d(1, 0)).at_a - fit.model.ray(middle).at_a).norm();
    const double limit =
        std::max(kOutlierSigmas * median(misses) / 1.1774, kNeverOutlierPx * mm_per_px);
    // One at a time: an outlier pulls the fit away from its neighbours, which are innocent.
    std::size_t worst = points.size();
    double worst_miss = limit;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double miss = use[i] ? residual_mm(fit.model, points[i]).norm() : 0.0;
      if (miss > worst_miss) {
        worst = i;
        worst_miss = miss;
      }
    }
    if (worst == points.size()) return fit;
    use[worst] = false;
    fit.outliers.push_back(points[worst]);
    if (fit.outliers.size() * 10 > points.size())
      throw Error(fmt::format(
          "{} of {} points do not fit a model of order {}: not an outlier problem. Look at the "
          "images and at the plane positions.",
          fit.outliers.size(), points.size(), order));
  }
}

}  // namespace turntable
