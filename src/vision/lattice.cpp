// Bias of a disc's centroid. The image of a disc D of radius r about c, evenly bright, has the
// centroid  int_D f |det J| / int_D |det J|.  With f(c + d) = f + J d + (d^T f'' d)/2 and
// |det J|(c + d) = |det J| (1 + d . q),  q = grad log |det J|,  and the mean of d d^T over a disc,
// r^2/4 I:
//   centroid - f(c) = r^2/8 (f_xx + f_yy) + r^2/4 J q + O(r^4),   q_x = tr(J^-1 J_x)
// For f a homography this is the expansion of the exact shift of an ellipse's centre (Heikkila &
// Silven 1997, doi:10.1109/CVPR.1997.609468, eq. 12); for any smooth f it includes the lens, which
// Heikkila 2000 (doi:10.1109/34.879788, section 3.2) integrates numerically. f is fitted to all
// circles at once, so that the correction brings no noise of its own; that the fit is made to the
// uncorrected centres changes f by the bias itself, a second-order effect on its derivatives.
#include "src/vision/lattice.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <unordered_map>

namespace turntable {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector2i;
using Eigen::Vector3d;

constexpr double kNeighbourTolerance = 0.2;  ///< in lattice steps, of a predicted neighbour
constexpr double kGapTolerance = 0.12;       ///< the same across a gap, where less is known
constexpr int kGapSteps = 3;

/// Circles in square cells, for what lies near a place.
class Cells {
 public:
  explicit Cells(std::span<const Circle> circles) {
    Vector2d low = circles.front().centre_px, high = low;
    for (const Circle& c : circles) {
      low = low.cwiseMin(c.centre_px);
      high = high.cwiseMax(c.centre_px);
    }
    low_ = low;
    const Vector2d extent = (high - low).cwiseMax(1.0);
    cell_ = std::max(4.0, std::sqrt(extent.prod() / static_cast<double>(circles.size())));
    across_ = static_cast<int>(extent.x() / cell_) + 1;
    down_ = static_cast<int>(extent.y() / cell_) + 1;
    // Counting sort: the circles of each cell stand together.
    first_.assign(static_cast<std::size_t>(across_ * down_) + 1, 0);
    for (const Circle& c : circles) ++first_[cell_of(c.centre_px) + 1];
    for (std::size_t k = 1; k < first_.size(); ++k) first_[k] += first_[k - 1];
    order_.resize(circles.size());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    for (std::size_t i = 0; i < circles.size(); ++i)
      order_[next[cell_of(circles[i].centre_px)]++] = i;
  }
  /// Calls use(index) for at least all circles within `reach` px of `at`.
  template <class Use>
  void near(const Vector2d& at, double reach, Use&& use) const {
    const auto clip = [&](double x, int end) {
      return static_cast<int>(std::clamp(std::floor(x / cell_), 0.0, end - 1.0));
    };
    const int i0 = clip(at.x() - reach - low_.x(), across_),
              i1 = clip(at.x() + reach - low_.x(), across_);
    const int j0 = clip(at.y() - reach - low_.y(), down_),
              j1 = clip(at.y() + reach - low_.y(), down_);
    for (int j = j0; j <= j1; ++j)
      for (std::size_t k = first_[static_cast<std::size_t>(j * across_ + i0)];
           k < first_[static_cast<std::size_t>(j * across_ + i1) + 1]; ++k)
        use(order_[k]);
  }

 private:
  std::size_t cell_of(const Vector2d& p) const {
    const int i = std::min(across_ - 1, static_cast<int>((p.x() - low_.x()) / cell_));
    const int j = std::min(down_ - 1, static_cast<int>((p.y() - low_.y()) / cell_));
    return static_cast<std::size_t>(j * across_ + i);
  }
  Vector2d low_;
  double cell_ = 1.0;
  int across_ = 1, down_ = 1;
  std::vector<std::size_t> first_, order_;
};

constexpr std::array<std::array<int, 2>, 8> kAround{
    {{1, 0}, {0, 1}, {-1, 0}, {0, -1}, {1, 1}, {-1, 1}, {-1, -1}, {1, -1}}};

class Grower {
 public:
  Grower(std::span<const Circle> circles, const LatticeShape& shape)
      : circles_(circles), shape_(shape), cells_(circles) {}

  std::vector<LatticeNode> grow() {
    std::vector<LatticeNode> best;
    for (const int wanted : {7, 5}) {
      std::size_t left = circles_.size();
      std::vector<bool> seen(circles_.size(), false);
      for (std::size_t i = 0; i < circles_.size() && left > best.size(); ++i, --left) {
        if (seen[i]) continue;
        const auto J = seed(i, wanted);
        if (!J) continue;
        std::vector<LatticeNode> nodes = grow_from(i, *J);
        for (const LatticeNode& node : nodes) seen[node.circle] = true;
        if (nodes.size() > best.size()) best = std::move(nodes);
        const auto covered = static_cast<std::size_t>(std::ranges::count(seen, true));
        if (circles_.size() - covered <= best.size()) break;  // nothing larger can be left
      }
      if (best.size() >= 9) break;
    }
    return best;
  }

 private:
  /// Steps of a lattice in which circle i has `wanted` of its eight neighbours. The ellipse gives
  /// the local metric: in it, neighbours stand at right angles and equally far whatever the tilt.
  std::optional<Matrix2d> seed(std::size_t i, int wanted) const {
    const Circle& c = circles_[i];
    const Matrix2d metric = c.shape_px2.inverse();
    // The circle itself may be a bigger one.
    const double least = 0.8 / shape_.largest_radius, most = 1.25 / shape_.radius;
    struct Near {
      Vector2d d;
      double steps;
    };
    std::array<Near, 32> near;
    std::size_t count = 0;
    const double reach = most * std::sqrt(c.shape_px2.trace());
    cells_.near(c.centre_px, reach, [&](std::size_t k) {
      if (k == i || count == near.size()) return;
      const Vector2d d = circles_[k].centre_px - c.centre_px;
      const double steps = std::sqrt(d.dot(metric * d));
      if (steps <= 1.6 * most && comparable(c.radius_px, circles_[k].radius_px))
        near[count++] = {d, steps};
    });
    std::optional<Matrix2d> best;
    double best_score = wanted - 1e-9;
    for (std::size_t p = 0; p < count; ++p)
      for (std::size_t q = 0; q < count; ++q) {
        if (p == q || near[p].steps < least || near[p].steps > most) continue;
        const Vector2d &a = near[p].d, &b = near[q].d;
        if (a.x() * b.y() - a.y() * b.x() >= 0) continue;  // rows run up where columns run right
        if (near[q].steps < 0.75 * near[p].steps || near[q].steps > 1.33 * near[p].steps) continue;
        if (std::abs(a.dot(metric * b)) > 0.35 * near[p].steps * near[q].steps) continue;
        Matrix2d J;
        J << a, b;
        const Matrix2d inverse = J.inverse();
        double score = 0;
        for (std::size_t k = 0; k < count; ++k) {
          const Vector2d at = inverse * near[k].d;
          const Vector2d whole(std::round(at.x()), std::round(at.y()));
          if (whole.cwiseAbs().maxCoeff() != 1.0) continue;
          const double off = (at - whole).norm();
          if (off < kNeighbourTolerance) score += 1.0 - 0.1 * off;
        }
        if (score > best_score) {
          best_score = score;
          best = J;
        }
      }
    return best;
  }

  /// Whether two neighbours may be circles of one pattern.
  bool comparable(double r, double other) const {
    const double ratio = std::max(r, other) / std::min(r, other);
    return ratio < 1.4 * shape_.largest_radius / shape_.radius;
  }
  /// Whether a circle has the size that the local scale asks for.
  bool fits(const Circle& c, const Matrix2d& J) const {
    const double steps = c.radius_px / std::sqrt(std::abs(J.determinant()));
    return steps > 0.7 * shape_.radius && steps < 1.4 * shape_.largest_radius;
  }

  static std::int64_t key(const Vector2i& at) {
    return static_cast<std::int64_t>(at.x()) * 1000003 + at.y();
  }

  std::vector<LatticeNode> grow_from(std::size_t start, const Matrix2d& J) {
    std::vector<LatticeNode> nodes{{start, Vector2i::Zero(), J}};
    std::unordered_map<std::int64_t, std::size_t> place{{key(Vector2i::Zero()), 0}};
    std::vector<bool> placed(circles_.size(), false);
    placed[start] = true;
    std::size_t next = 0;
    for (;;) {
      for (; next < nodes.size(); ++next) {
        refine(nodes, place, next);
        for (std::size_t e = 0; e < 4; ++e) {
          const LatticeNode from = nodes[next];
          const Vector2i step(kAround[e][0], kAround[e][1]);
          const Vector2i at = from.at + step;
          if (place.contains(key(at))) continue;
          const Vector2d expected =
              circles_[from.circle].centre_px + from.px_per_step * step.cast<double>();
          const Matrix2d inverse = from.px_per_step.inverse();
          const double reach = kNeighbourTolerance * from.px_per_step.norm();
          double least = kNeighbourTolerance;
          std::optional<std::size_t> found;
          cells_.near(expected, reach, [&](std::size_t k) {
            const double off = (inverse * (circles_[k].centre_px - expected)).norm();
            if (off >= least || placed[k] || !fits(circles_[k], from.px_per_step)) return;
            least = off;
            found = k;
          });
          if (found) put(nodes, place, placed, *found, at, from.px_per_step);
        }
      }
      if (!cross_gap(nodes, place, placed)) return nodes;
    }
  }

  using Place = std::unordered_map<std::int64_t, std::size_t>;

  static void put(std::vector<LatticeNode>& nodes, Place& place, std::vector<bool>& placed,
                  std::size_t circle, const Vector2i& at, const Matrix2d& J) {
    place[key(at)] = nodes.size();
    placed[circle] = true;
    nodes.push_back({circle, at, J});
  }

  /// Steps of a node from its placed neighbours: both sides, or one; else as inherited.
  void refine(std::vector<LatticeNode>& nodes, const Place& place, std::size_t i) const {
    LatticeNode& node = nodes[i];
    const Vector2d& here = circles_[node.circle].centre_px;
    for (int axis = 0; axis < 2; ++axis) {
      const Vector2i step = axis == 0 ? Vector2i(1, 0) : Vector2i(0, 1);
      const auto after = place.find(key(node.at + step)), before = place.find(key(node.at - step));
      const auto centre = [&](const auto& it) {
        return circles_[nodes[it->second].circle].centre_px;
      };
      if (after != place.end() && before != place.end())
        node.px_per_step.col(axis) = 0.5 * (centre(after) - centre(before));
      else if (after != place.end())
        node.px_per_step.col(axis) = centre(after) - here;
      else if (before != place.end())
        node.px_per_step.col(axis) = here - centre(before);
    }
  }

  /// Places the circles that lie on the lattice as seen from the nearest placed one, beyond missing
  /// neighbours.
  bool cross_gap(std::vector<LatticeNode>& nodes, Place& place, std::vector<bool>& placed) {
    if (nodes.size() < 9 || nodes.size() == circles_.size()) return false;
    double reach = 0.0;
    std::vector<std::size_t> node_of(circles_.size(), circles_.size());
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      refine(nodes, place, i);
      node_of[nodes[i].circle] = i;
      reach = std::max(reach, nodes[i].px_per_step.colwise().norm().maxCoeff());
    }
    bool any = false;
    const std::size_t settled = nodes.size();
    for (std::size_t k = 0; k < circles_.size(); ++k) {
      if (placed[k]) continue;
      double least = INFINITY;
      std::size_t nearest = circles_.size();
      cells_.near(circles_[k].centre_px, kGapSteps * reach, [&](std::size_t other) {
        const double d = (circles_[other].centre_px - circles_[k].centre_px).squaredNorm();
        if (node_of[other] < settled && d < least) least = d, nearest = node_of[other];
      });
      if (nearest >= settled) continue;
      const LatticeNode from = nodes[nearest];
      if (!fits(circles_[k], from.px_per_step)) continue;
      const Vector2d steps =
          from.px_per_step.inverse() * (circles_[k].centre_px - circles_[from.circle].centre_px);
      const Vector2i whole(static_cast<int>(std::lround(steps.x())),
                           static_cast<int>(std::lround(steps.y())));
      const int far = whole.cwiseAbs().maxCoeff();
      if (far < 1 || far > kGapSteps || (steps - whole.cast<double>()).norm() > kGapTolerance ||
          place.contains(key(from.at + whole)))
        continue;
      put(nodes, place, placed, k, from.at + whole, from.px_per_step);
      any = true;
    }
    return any;
  }

  std::span<const Circle> circles_;
  LatticeShape shape_;
  Cells cells_;
};

constexpr std::size_t kMostTerms = 21;
constexpr std::size_t terms_of(int degree) {
  return static_cast<std::size_t>((degree + 1) * (degree + 2) / 2);
}

/// Monomials x^a y^b with a + b <= degree, their first and second derivatives.
struct Monomials {
  using Row = std::array<double, kMostTerms>;
  Row value, x, y, xx, xy, yy;
  Monomials(const Vector2d& p, int degree) {
    std::array<double, 8> px{0, 0, 1}, py{0, 0, 1};  // powers, from the -2nd; those below 0 vanish
    for (std::size_t k = 3; k < 8; ++k) px[k] = px[k - 1] * p.x(), py[k] = py[k - 1] * p.y();
    std::size_t i = 0;
    for (int d = 0; d <= degree; ++d)
      for (int b = 0; b <= d; ++b, ++i) {
        const int a = d - b;
        const auto ka = static_cast<std::size_t>(a), kb = static_cast<std::size_t>(b);
        value[i] = px[ka + 2] * py[kb + 2];
        x[i] = a * px[ka + 1] * py[kb + 2];
        y[i] = b * px[ka + 2] * py[kb + 1];
        xx[i] = a * (a - 1) * px[ka] * py[kb + 2];
        xy[i] = a * b * px[ka + 1] * py[kb + 1];
        yy[i] = b * (b - 1) * px[ka + 2] * py[kb];
      }
  }
};

/// Normal equations of at most kMostTerms unknowns for K right sides, built row by row.
template <std::size_t K>
class Normal {
 public:
  explicit Normal(std::size_t unknowns) : n_(unknowns) {}
  void add(const double* row, const std::array<double, K>& right) {
    for (std::size_t i = 0; i < n_; ++i) {
      for (std::size_t j = 0; j <= i; ++j) A_[i][j] += row[i] * row[j];
      for (std::size_t k = 0; k < K; ++k) b_[i][k] += row[i] * right[k];
    }
  }
  /// One column per right side, then the inverse of the normal matrix.
  Eigen::MatrixXd solve() const {
    const auto n = static_cast<Eigen::Index>(n_), k_end = static_cast<Eigen::Index>(K);
    Eigen::MatrixXd A(n, n), b(n, k_end + n);
    b.rightCols(n).setIdentity();
    for (std::size_t i = 0; i < n_; ++i) {
      const auto r = static_cast<Eigen::Index>(i);
      for (std::size_t j = 0; j <= i; ++j) {
        const auto c = static_cast<Eigen::Index>(j);
        A(r, c) = A(c, r) = A_[i][j];
      }
      for (std::size_t k = 0; k < K; ++k) b(r, static_cast<Eigen::Index>(k)) = b_[i][k];
    }
    return A.ldlt().solve(b);
  }

 private:
  std::size_t n_;
  std::array<std::array<double, kMostTerms>, kMostTerms> A_{};
  std::array<std::array<double, K>, kMostTerms> b_{};
};

/// Middle and half-extent of points, to bring them to about [-1, 1].
void normalise(std::span<const Vector2d> points, Vector2d& middle, double& scale) {
  Vector2d low = points.front(), high = low;
  for (const Vector2d& p : points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  middle = 0.5 * (low + high);
  scale = std::max(0.5 * (high - low).maxCoeff(), 1e-9);
}

}  // namespace

std::vector<LatticeNode> grow_lattice(std::span<const Circle> circles, const LatticeShape& shape) {
  if (circles.size() < 6) return {};
  return Grower(circles, shape).grow();
}

bool PatternMap::fit(std::span<const Vector2d> on_pattern, std::span<const Vector2d> px) {
  if (on_pattern.size() < 6 || on_pattern.size() != px.size()) return false;
  normalise(on_pattern, middle_, scale_);
  normalise(px, px_middle_, px_scale_);
  degree_ = 0;
  bend_.fill(Vector2d::Zero());

  // u (1 + h7 x + h8 y) = h1 x + h2 y + h3. Weighted by the last denominator, the second and third
  // pass minimise the distance in the image and not the algebraic one.
  H_.setIdentity();
  for (int pass = 0; pass < 3; ++pass) {
    Normal<1> normal(8);
    for (std::size_t i = 0; i < px.size(); ++i) {
      const Vector2d p = (on_pattern[i] - middle_) / scale_, q = (px[i] - px_middle_) / px_scale_;
      const double w = pass == 0 ? 1.0 : 1.0 / (H_(2, 0) * p.x() + H_(2, 1) * p.y() + 1.0);
      const double x = w * p.x(), y = w * p.y();
      normal.add(std::array{x, y, w, 0.0, 0.0, 0.0, -x * q.x(), -y * q.x()}.data(), {w * q.x()});
      normal.add(std::array{0.0, 0.0, 0.0, x, y, w, -x * q.y(), -y * q.y()}.data(), {w * q.y()});
    }
    const Eigen::MatrixXd h = normal.solve();
    if (!h.allFinite()) return false;
    H_ << h(0), h(1), h(2), h(3), h(4), h(5), h(6), h(7), 1.0;
    for (const Vector2d& point : on_pattern) {
      const Vector2d p = (point - middle_) / scale_;
      if (!(H_(2, 0) * p.x() + H_(2, 1) * p.y() + 1.0 > 0.05)) return false;  // behind the camera
    }
  }
  if (!(std::abs(H_.determinant()) > 1e-9)) return false;
  degree_ = px.size() < 30 ? 0 : px.size() < 90 ? 3 : 5;
  basis_ = std::max(degree_, 2);  // a homography bends about as much as a quadratic
  Normal<2> normal(terms_of(basis_));
  for (std::size_t i = 0; i < px.size(); ++i) {
    const Vector2d h = (H_ * ((on_pattern[i] - middle_) / scale_).homogeneous()).hnormalized();
    const Vector2d left = (px[i] - px_middle_) / px_scale_ - h;
    normal.add(Monomials(h, basis_).value.data(), {left.x(), left.y()});
  }
  const Eigen::MatrixXd solved = normal.solve();
  if (!solved.allFinite()) return false;
  if (degree_ > 0)
    for (std::size_t i = 0; i < terms_of(degree_); ++i)
      bend_[i] = solved.row(static_cast<Eigen::Index>(i)).head<2>();
  inverse_ = solved.rightCols(solved.rows());
  return true;
}

double PatternMap::leverage(const Vector2d& on_pattern) const {
  const Vector2d h = (H_ * ((on_pattern - middle_) / scale_).homogeneous()).hnormalized();
  const Monomials m(h, basis_);
  const Eigen::Map<const Eigen::VectorXd> row(m.value.data(), inverse_.rows());
  return row.dot(inverse_ * row);
}

PatternMap::Taylor PatternMap::at(const Vector2d& on_pattern) const {
  const Vector2d p = (on_pattern - middle_) / scale_;
  const Vector3d q = H_ * p.homogeneous();
  const double d = q.z();
  const Eigen::RowVector2d slope = H_.row(2).head<2>();
  // Homography by the quotient rule: h = N/D, h_i = (N_i - h D_i)/D, h_ij = -(h_i D_j + h_j D_i)/D.
  const Vector2d h = q.head<2>() / d;
  const Matrix2d Jh = (H_.topLeftCorner<2, 2>() - h * slope) / d;
  const Vector2d hx = Jh.col(0), hy = Jh.col(1);
  const Vector2d hxx = -2.0 * hx * slope(0) / d, hyy = -2.0 * hy * slope(1) / d,
                 hxy = -(hx * slope(1) + hy * slope(0)) / d;

  // Lens f = h + b(h) by the chain rule.
  Vector2d value = h, uu = Vector2d::Zero(), uv = uu, vv = uu;
  Matrix2d L = Matrix2d::Identity();
  if (degree_ > 0) {
    const Monomials m(h, degree_);
    for (std::size_t i = 0; i < terms_of(degree_); ++i) {
      value += m.value[i] * bend_[i];
      L.col(0) += m.x[i] * bend_[i];
      L.col(1) += m.y[i] * bend_[i];
      uu += m.xx[i] * bend_[i];
      uv += m.xy[i] * bend_[i];
      vv += m.yy[i] * bend_[i];
    }
  }
  const auto second = [&](const Vector2d& a, const Vector2d& b, const Vector2d& ab) -> Vector2d {
    return uu * a.x() * b.x() + uv * (a.x() * b.y() + a.y() * b.x()) + vv * a.y() * b.y() + L * ab;
  };
  const double by = px_scale_ / scale_, by2 = by / scale_;
  Taylor t;
  t.px = px_middle_ + px_scale_ * value;
  t.J = by * L * Jh;
  t.xx = by2 * second(hx, hx, hxx);
  t.xy = by2 * second(hx, hy, hxy);
  t.yy = by2 * second(hy, hy, hyy);
  return t;
}

Vector2d centroid_bias_px(const PatternMap::Taylor& f, double radius) {
  const Matrix2d inverse = f.J.inverse();
  Matrix2d J_x, J_y;
  J_x << f.xx, f.xy;
  J_y << f.xy, f.yy;
  const Vector2d q((inverse * J_x).trace(), (inverse * J_y).trace());
  return radius * radius * (0.125 * (f.xx + f.yy) + 0.25 * f.J * q);
}

}  // namespace turntable
