#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>

#include "src/core/errors.h"
#include "src/imaging/irt.h"

namespace turntable {
namespace {

/// Points whose noise comes out of the fit more than this many times as large somewhere between them
/// do not carry the order. With good coverage it is below 1 everywhere.
constexpr double kMostNoiseGain = 3.0;
constexpr double kPointsPerTerm = 1.5;
constexpr double kOutlierSigmas = 6.0;
/// A circle this near is neither a wrong match nor smeared; where noise is lower still, the model's
/// own error shows.
constexpr double kNeverOutlierPx = 0.1;
/// Median length of a two-dimensional normal error, in standard deviations.
constexpr double kMedianLength = 1.1774;
/// Condition number beyond which the normal equations, even refined, say nothing.
constexpr double kWorstCondition = 3e6;

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

/// Twice the area of a polygon, signed.
double doubled_area(const std::vector<Vector2d>& polygon) {
  double sum = 0.0;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector2d &p = polygon[i], &q = polygon[(i + 1) % polygon.size()];
    sum += p.x() * q.y() - p.y() * q.x();
  }
  return sum;
}

// Every product goes through one of these two: each further kind of operand would be compiled anew.
Eigen::MatrixXd times(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) { return a * b; }
Eigen::MatrixXd transposed_times(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  return a.transpose() * b;
}

int terms_of(int order) { return (order + 1) * (order + 2) / 2; }

/// The points of one height, and what they say: weight (phi ((1 - lambda) c_a + lambda c_b) - xy).
struct PlaneRows {
  double z_mm = 0.0, lambda = 0.0;
  std::vector<std::size_t> index;  ///< into the points given
  Eigen::MatrixXd phi;             ///< points x terms
  Eigen::MatrixXd on_plane;        ///< points x 2
  Eigen::ArrayXd weight;           ///< 0 = left out

  Eigen::Index used() const { return (weight > 0.0).count(); }
  /// The part of (x_a.., x_b..) that counts at this height.
  Eigen::MatrixXd here(const Eigen::MatrixXd& c) const {
    const Eigen::Index n = phi.cols();
    return (1.0 - lambda) * c.topRows(n) + lambda * c.bottomRows(n);
  }
  /// Variances of phi * here(c) for rows phi, given the cofactor matrix of c.
  Eigen::ArrayXd variances(const Eigen::MatrixXd& rows, const Eigen::MatrixXd& cofactor) const {
    const Eigen::MatrixXd K = here(here(cofactor).transpose());
    return times(rows, K).cwiseProduct(rows).rowwise().sum();
  }
  Eigen::MatrixXd residuals(const Eigen::MatrixXd& c) const {
    return times(phi, here(c)) - on_plane;
  }
};

std::vector<PlaneRows> rows_of(std::span<const PlanePoint> points, RayPlanes planes, int order,
                               ImageSize size) {
  std::map<double, std::vector<std::size_t>> by_height;
  for (std::size_t i = 0; i < points.size(); ++i) by_height[points[i].z_mm].push_back(i);
  std::vector<PlaneRows> out;
  double phi[64];
  for (const auto& [z, index] : by_height) {
    PlaneRows plane;
    plane.z_mm = z;
    plane.lambda = (z - planes.a_mm) / (planes.b_mm - planes.a_mm);
    const auto count = static_cast<Eigen::Index>(index.size());
    plane.phi.resize(count, terms_of(order));
    plane.on_plane.resize(count, 2);
    plane.weight.setOnes(count);
    for (Eigen::Index i = 0; i < count; ++i) {
      const PlanePoint& p = points[index[static_cast<std::size_t>(i)]];
      IrtModel::basis(p.pixel_px, size, order, phi);
      for (Eigen::Index k = 0; k < plane.phi.cols(); ++k) plane.phi(i, k) = phi[k];
      plane.on_plane(i, 0) = p.on_plane_mm.x();
      plane.on_plane(i, 1) = p.on_plane_mm.y();
    }
    plane.index = index;
    out.push_back(std::move(plane));
  }
  return out;
}

struct Solution {
  Eigen::MatrixXd coefficients;  ///< (x_a.., x_b..) and (y_a.., y_b..): 2 terms x 2
  Eigen::MatrixXd cofactor;      ///< (A^T W^2 A)^-1
  double condition = INFINITY;   ///< of W A; infinite = not determined
  std::size_t undetermined = 0;  ///< then: the plane whose points say least
};

/// Normal equations in the orthogonal basis, refined by their own residuals: as good as QR where the
/// condition is (Bjorck 1987, corrected seminormal equations), and their eigenvalues tell the rest.
Solution solve(const std::vector<PlaneRows>& rows) {
  const Eigen::Index n = rows.front().phi.cols();
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(2 * n, 2 * n);
  std::vector<Eigen::MatrixXd> weighted;  // W^2 phi
  for (const PlaneRows& plane : rows) {
    weighted.push_back(plane.weight.square().matrix().asDiagonal() * plane.phi);
    const Eigen::MatrixXd G = transposed_times(weighted.back(), plane.phi);
    const double la = plane.lambda, mu = 1.0 - la;
    normal.topLeftCorner(n, n) += mu * mu * G;
    normal.bottomLeftCorner(n, n) += mu * la * G;
    normal.bottomRightCorner(n, n) += la * la * G;
  }
  Solution out;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(normal);  // reads the lower half
  const Eigen::VectorXd& d = eigen.eigenvalues();
  const double condition = std::sqrt(d(2 * n - 1) / std::max(d(0), 0.0));
  if (!(condition < kWorstCondition)) {
    const Eigen::MatrixXd unseen = eigen.eigenvectors().col(0);
    const auto share = [&](const PlaneRows& plane) { return plane.here(unseen).norm(); };
    out.undetermined =
        static_cast<std::size_t>(std::ranges::max_element(rows, {}, share) - rows.begin());
    return out;
  }
  out.condition = condition;
  const Eigen::MatrixXd half =
      d.cwiseSqrt().cwiseInverse().asDiagonal() * eigen.eigenvectors().transpose();
  out.cofactor = transposed_times(half, half);
  out.coefficients = Eigen::MatrixXd::Zero(2 * n, 2);
  for (int pass = 0; pass < 3; ++pass) {
    Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(2 * n, 2);
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const Eigen::MatrixXd g = transposed_times(weighted[k], rows[k].residuals(out.coefficients));
      rhs.topRows(n) += (1.0 - rows[k].lambda) * g;
      rhs.bottomRows(n) += rows[k].lambda * g;
    }
    out.coefficients -= times(out.cofactor, rhs);
  }
  return out;
}

std::vector<Vector2d> pixels_of(const PlaneRows& plane, std::span<const PlanePoint> points) {
  std::vector<Vector2d> out;
  for (std::size_t i = 0; i < plane.index.size(); ++i)
    if (plane.weight(static_cast<Eigen::Index>(i)) > 0.0)
      out.push_back(points[plane.index[i]].pixel_px);
  return out;
}

std::vector<Vector2d> domain_of(const std::vector<PlaneRows>& rows,
                                std::span<const PlanePoint> points) {
  std::vector<Vector2d> domain = convex_hull(pixels_of(rows.front(), points));
  for (const PlaneRows& plane : rows)
    domain = intersection(domain, convex_hull(pixels_of(plane, points)));
  return domain;
}

IrtModel model_of(const Solution& s, std::vector<Vector2d> domain, RayPlanes planes, int order,
                  ImageSize size) {
  const Eigen::Index n = terms_of(order);
  Eigen::MatrixX4d c(n, 4);
  c << s.coefficients.topRows(n), s.coefficients.bottomRows(n);
  return IrtModel(size, planes, order, c, std::move(domain));
}

/// Basis functions at the corners of a polygon and at a grid inside it.
Eigen::MatrixXd sampled_basis(const IrtModel& polygon_owner) {
  std::vector<Vector2d> pixels = polygon_owner.domain_hull_px();
  Vector2d low = Vector2d::Constant(INFINITY), high = -low;
  for (const Vector2d& p : pixels) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  constexpr int kSteps = 15;
  if (!pixels.empty())
    for (int i = 0; i < kSteps; ++i)
      for (int j = 0; j < kSteps; ++j) {
        const Vector2d p = low + (high - low).cwiseProduct(Vector2d(i + 0.5, j + 0.5) / kSteps);
        if (polygon_owner.in_domain(p)) pixels.push_back(p);
      }
  Eigen::MatrixXd out(static_cast<Eigen::Index>(pixels.size()), terms_of(polygon_owner.order()));
  double phi[64];
  for (Eigen::Index i = 0; i < out.rows(); ++i) {
    IrtModel::basis(pixels[static_cast<std::size_t>(i)], polygon_owner.image_size(),
                    polygon_owner.order(), phi);
    for (Eigen::Index k = 0; k < out.cols(); ++k) out(i, k) = phi[k];
  }
  return out;
}

std::vector<FittedPlane> describe(const std::vector<PlaneRows>& rows, const Solution& s,
                                  const IrtModel& model, std::span<const PlanePoint> points) {
  const Eigen::MatrixXd inside = sampled_basis(model);
  std::vector<Vector2d> all;
  std::vector<FittedPlane> out;
  for (const PlaneRows& plane : rows) {
    const std::vector<Vector2d> pixels = pixels_of(plane, points);
    all.insert(all.end(), pixels.begin(), pixels.end());
    FittedPlane p;
    p.z_mm = plane.z_mm;
    p.points = static_cast<int>(pixels.size());
    p.coverage = doubled_area(convex_hull(pixels));
    if (inside.rows() > 0)
      p.noise_gain = std::sqrt(plane.variances(inside, s.cofactor).maxCoeff() *
                               plane.weight.square().sum() / p.points);
    out.push_back(p);
  }
  const double whole = doubled_area(convex_hull(all));
  for (FittedPlane& p : out) p.coverage /= whole;
  return out;
}

/// The plane whose points do not carry the order, if there is one.
const FittedPlane* weakest(const std::vector<FittedPlane>& planes) {
  const auto worst = std::ranges::max_element(planes, {}, &FittedPlane::noise_gain);
  return worst->noise_gain > kMostNoiseGain ? &*worst : nullptr;
}

/// A sentence about the planes whose points are too few for the order; empty if there are none. On
/// two planes each carries its own map; on more they share the work.
std::string too_few(const std::vector<PlaneRows>& rows, int order) {
  const auto too_few_on = [&](Eigen::Index used, double per_term, const std::string& where) {
    const double needed = std::ceil(per_term * terms_of(order));
    if (static_cast<double>(used) >= needed) return std::string();
    return fmt::format("order {} needs at least {:.0f} points on {}, found {}", order, needed,
                       where, used);
  };
  Eigen::Index all = 0;
  for (const PlaneRows& plane : rows) {
    all += plane.used();
    if (rows.size() != 2) continue;
    const std::string message = too_few_on(plane.used(), kPointsPerTerm,
                                           fmt::format("the plane z = {:.6g} mm", plane.z_mm));
    if (!message.empty()) return message;
  }
  return too_few_on(all, 2 * kPointsPerTerm, fmt::format("its {} planes", rows.size()));
}

/// Highest order below `order` that can be fitted; 0 if none.
int carried_order(std::span<const PlanePoint> points, RayPlanes planes, int order, ImageSize size) {
  while (--order > 0) {
    const std::vector<PlaneRows> rows = rows_of(points, planes, order, size);
    if (!too_few(rows, order).empty()) continue;
    const Solution s = solve(rows);
    if (std::isinf(s.condition)) continue;
    const IrtModel model = model_of(s, domain_of(rows, points), planes, order, size);
    if (weakest(describe(rows, s, model, points)) == nullptr) break;
  }
  return order;
}

double median(std::vector<double> v) {
  const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::ranges::nth_element(v, middle);
  return *middle;
}

/// Sets the weights of outliers to 0 and returns their indices. One at a time, the worst first: an
/// outlier pulls the fit away from its neighbours, which are innocent. What its absence does to all
/// the others follows from the cofactor matrix (Sherman & Morrison 1950), without another fit.
std::vector<std::size_t> remove_outliers(std::vector<PlaneRows>& rows, Solution s,
                                         const IrtModel& model, std::size_t points, int order) {
  const Vector2d middle(0.5 * model.image_size().width, 0.5 * model.image_size().height);
  const double never_mm = kNeverOutlierPx * model.mm_per_px(middle, model.planes().a_mm);
  std::vector<Eigen::MatrixXd> residuals;
  std::vector<Eigen::ArrayXd> leverages;
  for (const PlaneRows& plane : rows) {
    residuals.push_back(plane.residuals(s.coefficients));
    leverages.push_back(plane.variances(plane.phi, s.cofactor) * plane.weight.square());
  }
  std::vector<std::size_t> out;
  for (;;) {
    std::vector<double> lengths;
    std::size_t worst_plane = 0;
    Eigen::Index worst = -1;
    double worst_length = 0.0;
    for (std::size_t k = 0; k < rows.size(); ++k)
      for (Eigen::Index i = 0; i < rows[k].weight.size(); ++i) {
        const double weight = rows[k].weight(i);
        if (weight <= 0.0) continue;
        const double miss_mm = residuals[k].row(i).norm();
        // In standard deviations of this residual: a point of high leverage draws the fit to itself.
        const double length = weight * miss_mm / std::sqrt(std::max(1.0 - leverages[k](i), 1e-9));
        lengths.push_back(length);
        if (miss_mm > never_mm && length > worst_length) {
          worst_plane = k;
          worst = i;
          worst_length = length;
        }
      }
    if (worst < 0 || worst_length <= kOutlierSigmas * median(lengths) / kMedianLength) return out;

    PlaneRows& plane = rows[worst_plane];
    out.push_back(plane.index[static_cast<std::size_t>(worst)]);
    if (out.size() * 10 > points)
      throw Error(fmt::format(
          "{} of {} points do not fit a model of order {}: not an outlier problem. Look at the "
          "images and at the plane positions.",
          out.size(), points, order));
    const Eigen::MatrixXd K = plane.here(s.cofactor);  // terms x 2 terms
    const Eigen::MatrixXd gain = transposed_times(K, plane.phi.row(worst).transpose());
    const double factor = plane.weight(worst) * plane.weight(worst) /
                          std::max(1.0 - leverages[worst_plane](worst), 1e-9);
    const Eigen::MatrixXd miss = residuals[worst_plane].row(worst);
    plane.weight(worst) = 0.0;
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const Eigen::MatrixXd change = times(rows[k].phi, rows[k].here(gain));
      residuals[k] += factor * times(change, miss);
      leverages[k] += factor * rows[k].weight.square() * change.array().square();
    }
    s.cofactor += factor * times(gain, gain.transpose());
  }
}

}  // namespace

IrtFit fit_irt(std::span<const PlanePoint> points, RayPlanes planes, int order, ImageSize size) {
  if (order < 1 || order > 9)
    throw Error(fmt::format("polynomial order: found {}, allowed: 1 to 9.", order));
  if (!(planes.a_mm < planes.b_mm))
    throw Error(
        fmt::format("planes at {} mm and {} mm: two different heights are needed, the lower first.",
                    planes.a_mm, planes.b_mm));
  std::vector<PlaneRows> rows = rows_of(points, planes, order, size);
  if (rows.size() < 2)
    throw Error(fmt::format(
        "the ray model needs points on two planes, found {}.",
        rows.empty() ? "none"
                     : fmt::format("all {} at z = {:.6g} mm", points.size(), rows.front().z_mm)));
  const auto refuse = [&](const std::string& why) {
    const int carried = carried_order(points, planes, order, size);
    throw Error(fmt::format(
        "{}; the points carry {}. Show more of the pattern or lower the order.", why,
        carried > 0 ? fmt::format("order {} at most", carried) : "no ray model at all"));
  };
  const auto solved = [&] {
    if (const std::string why = too_few(rows, order); !why.empty()) refuse(why);
    Solution s = solve(rows);
    if (std::isinf(s.condition))
      refuse(
          fmt::format("the points on the plane z = {:.6g} mm do not determine a model of order {}: "
                      "they cover too narrow a strip",
                      rows[s.undetermined].z_mm, order));
    return s;
  };
  const bool stated = std::ranges::all_of(points, [](const auto& p) { return p.sigma_px > 0.0; });
  const auto weigh = [&](const auto& sigma_mm) {
    for (PlaneRows& plane : rows)
      for (Eigen::Index i = 0; i < plane.weight.size(); ++i)
        if (plane.weight(i) > 0.0)
          plane.weight(i) = 1.0 / sigma_mm(points[plane.index[static_cast<std::size_t>(i)]]);
  };

  IrtFit fit;
  if (stated) weigh([](const PlanePoint& p) { return p.sigma_px; });
  Solution s = solved();
  fit.model = model_of(s, {}, planes, order, size);
  for (const std::size_t i : remove_outliers(rows, s, fit.model, points.size(), order))
    fit.outliers.push_back(points[i]);
  if (stated)  // The first fit knows the local scale well enough for weights.
    weigh(
        [&](const PlanePoint& p) { return p.sigma_px * fit.model.mm_per_px(p.pixel_px, p.z_mm); });
  if (stated || !fit.outliers.empty()) s = solved();
  fit.model = model_of(s, domain_of(rows, points), planes, order, size);
  fit.condition = s.condition;
  fit.planes = describe(rows, s, fit.model, points);
  if (const FittedPlane* plane = weakest(fit.planes))
    refuse(fmt::format(
        "the {} points on the plane z = {:.6g} mm do not determine a model of order {}: "
        "between them it is {:.3g} times as uncertain as they are (allowed: {})",
        plane->points, plane->z_mm, order, plane->noise_gain, kMostNoiseGain));

  double sum = 0.0, sum_weighted = 0.0, sum_left_out = 0.0;
  for (const PlaneRows& plane : rows) {
    const Eigen::MatrixXd residuals = plane.residuals(s.coefficients);
    const Eigen::ArrayXd variances = plane.variances(plane.phi, s.cofactor);
    for (Eigen::Index i = 0; i < variances.size(); ++i) {
      const double w2 = plane.weight(i) * plane.weight(i);
      if (w2 <= 0.0) continue;
      PointStatistics p;
      p.index = plane.index[static_cast<std::size_t>(i)];
      p.residual_mm = residuals.row(i).transpose();
      p.leverage = w2 * variances(i);
      p.left_out_mm = p.residual_mm / (1.0 - p.leverage);
      sum += p.residual_mm.squaredNorm();
      sum_weighted += w2 * p.residual_mm.squaredNorm();
      sum_left_out += p.left_out_mm.squaredNorm();
      fit.max_mm = std::max(fit.max_mm, p.residual_mm.norm());
      fit.max_leverage = std::max(fit.max_leverage, p.leverage);
      fit.used.push_back(p);
    }
  }
  std::ranges::sort(fit.used, {}, &PointStatistics::index);
  fit.points = static_cast<int>(fit.used.size());
  const double n = fit.points, freedom = 2.0 * (n - 2.0 * terms_of(order));
  fit.rms_mm = std::sqrt(sum / n);
  fit.loo_rms_mm = std::sqrt(sum_left_out / n);
  fit.sigma_mm = std::sqrt(sum / freedom);
  if (stated) fit.chi2_per_dof = sum_weighted / freedom;
  fit.model.set_covariance((stated ? std::max(1.0, fit.chi2_per_dof) : sum / freedom) * s.cofactor);
  return fit;
}

}  // namespace turntable
