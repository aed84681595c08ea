// Detection: a pixel is foreground beyond the half-way level between the least and the greatest grey
// of its surroundings (tiles, widened by one tile and interpolated), so that light may fall off
// over the image. Noise is met by a 3 x 3 mean first; the centre is taken from the image itself.
//
// Centre: with the ground g(x) and the plateau p(x) as planes, fitted outside and inside the edge,
//   w(x) = (grey(x) - g(x)) / (p(x) - g(x)),   w := 1 inside, w := 0 outside a ring along the edge
//   centre = sum w x / sum w
// Light that varies linearly over the disc scales disc and ground alike and leaves w as it is; a
// plain centroid is drawn towards the light. Only the ring carries noise into the centre, unlike in
// a centroid over the whole region, and no threshold enters. The ring reaches 2.5 standard deviations
// of the edge's blur to either side; a symmetric blur moves no centroid.
//   blur    s = sqrt(pi) sum_ring w (1 - w) / circumference   (Gaussian: int Phi (1 - Phi) = 1/sqrt(pi))
//   sigma^2 = 1/(2 (c W)^2) tr[ sum_ring x x^T var(grey) + D S_g^-1 D var_g + B S_p^-1 B var_p ]
//   B = sum_ring w x x^T,  D = sum_ring (1 - w) x x^T,  S_g, S_p = sum x x^T of the planes' pixels
// with c the contrast, W = sum w, var_g and var_p the variances of the residuals about the planes
// (never below 1/12 grey^2: rounding), var(grey) between them by w; the last two terms are the
// planes' own uncertainties of slope. Derived here; the idea of normalising by fitted planes follows the
// grey-moment operators (Tabatabai & Mitchell 1984, doi:10.1109/TPAMI.1984.4767502).
// Domain: radius from about 2.5 px; discs without a plateau (radius below the blur) are taken with
// parallel planes. Ground must be free of neighbours within about 2 px of the ring.
#include "src/vision/circles.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

namespace turntable {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kTile = 16;  ///< px; a window of three tiles is what a half-way level is taken from
/// Of a disc's size; a centre less exact than this is a flaw of noise, not a disc.
constexpr double kLeastExact = 0.05;
constexpr double kRoundingVariance = 1.0 / 12.0;
/// How far w may lie outside [0, 1]: more than noise does, less than the glint of a rough dot's rim.
constexpr double kBeyond = 0.25;
/// Unmarked pixels of a row that do not end a disc: scratches and grain of a real one.
constexpr int kScratch = 2;

/// Standard deviation of the noise, from second differences along every 16th row (median, so that
/// edges do not count).
double noise_of(ImageView image) {
  std::array<int, 1024> histogram{};
  int count = 0;
  for (int v = 0; v < image.height; v += 16) {
    const std::uint8_t* row = image.row(v);
    for (int u = 1; u + 1 < image.width; u += 3) {
      ++histogram[static_cast<std::size_t>(std::abs(row[u - 1] - 2 * row[u] + row[u + 1]))];
      ++count;
    }
  }
  int below = 0;
  for (std::size_t d = 0; d < histogram.size(); ++d) {
    below += histogram[d];
    if (2 * below >= count) return static_cast<double>(d) / (0.6745 * std::sqrt(6.0));
  }
  return 0.0;
}

struct Tiles {
  int across = 0, down = 0;
  std::vector<double> level;  ///< half-way level
  double& at(int i, int j) { return level[static_cast<std::size_t>(j * across + i)]; }
};

/// Half-way level of each tile; empty without contrast.
Tiles half_way_levels(ImageView image, double noise, const CircleOptions& options) {
  Tiles tiles;
  tiles.across = (image.width + kTile - 1) / kTile;
  tiles.down = (image.height + kTile - 1) / kTile;
  const auto count = static_cast<std::size_t>(tiles.across * tiles.down);
  std::vector<std::uint8_t> low(count, 255), high(count, 0);
  const auto width = static_cast<std::size_t>(image.width);
  std::vector<std::uint8_t> least_of(width), most_of(width);  // of each column of the tile row
  for (int j = 0; j < tiles.down; ++j) {
    std::ranges::fill(least_of, std::uint8_t{255});
    std::ranges::fill(most_of, std::uint8_t{0});
    std::uint8_t *least = least_of.data(), *most = most_of.data();
    for (int v = j * kTile; v < std::min(image.height, (j + 1) * kTile); ++v) {
      const std::uint8_t* p = image.row(v);
      for (std::size_t u = 0; u < width; ++u) least[u] = std::min(least[u], p[u]);
      for (std::size_t u = 0; u < width; ++u) most[u] = std::max(most[u], p[u]);
    }
    for (std::size_t u = 0; u < width; ++u) {
      const std::size_t k = static_cast<std::size_t>(j * tiles.across) + u / kTile;
      low[k] = std::min(low[k], least[u]);
      high[k] = std::max(high[k], most[u]);
    }
  }

  std::vector<double> contrast(count);
  tiles.level.assign(count, -1.0);
  double greatest = 0.0;
  for (int j = 0; j < tiles.down; ++j)
    for (int i = 0; i < tiles.across; ++i) {
      int least = 255, most = 0;
      for (int jj = std::max(0, j - 1); jj <= std::min(tiles.down - 1, j + 1); ++jj)
        for (int ii = std::max(0, i - 1); ii <= std::min(tiles.across - 1, i + 1); ++ii) {
          const auto k = static_cast<std::size_t>(jj * tiles.across + ii);
          least = std::min<int>(least, low[k]);
          most = std::max<int>(most, high[k]);
        }
      const auto k = static_cast<std::size_t>(j * tiles.across + i);
      contrast[k] = most - least;
      tiles.level[k] = 0.5 * (least + most);
      greatest = std::max(greatest, contrast[k]);
    }
  // Ground alone, or the inside of a large disc, knows no half-way level; it takes its neighbours'.
  const double enough = std::max({options.min_contrast_grey, 10.0 * noise, 0.2 * greatest});
  if (greatest < enough) return {};
  for (std::size_t k = 0; k < count; ++k)
    if (contrast[k] < enough) tiles.level[k] = -1.0;
  for (bool open = true; open;) {
    open = false;
    const std::vector<double> known = tiles.level;
    for (int j = 0; j < tiles.down; ++j)
      for (int i = 0; i < tiles.across; ++i) {
        if (tiles.at(i, j) >= 0) continue;
        double sum = 0.0;
        int n = 0;
        for (int jj = std::max(0, j - 1); jj <= std::min(tiles.down - 1, j + 1); ++jj)
          for (int ii = std::max(0, i - 1); ii <= std::min(tiles.across - 1, i + 1); ++ii) {
            const double level = known[static_cast<std::size_t>(jj * tiles.across + ii)];
            if (level >= 0) sum += level, ++n;
          }
        if (n > 0) tiles.at(i, j) = sum / n;
        open = true;
      }
  }
  return tiles;
}

/// 255 where the image is beyond the half-way level, else 0.
void mark_foreground(ImageView image, Tiles& tiles, bool bright, Image& out) {
  constexpr int kBand = 8;  // rows that share a level
  std::vector<std::uint8_t> level(static_cast<std::size_t>(image.width));
  const auto split = [](int at, int end, int& first) {  // between the centres of two tiles
    const double x = std::clamp((at + 0.5) / kTile - 0.5, 0.0, end - 1.0);
    first = std::min(static_cast<int>(x), std::max(0, end - 2));
    return x - first;
  };
  for (int v = 0; v < image.height; ++v) {
    if (v % kBand == 0) {
      int j = 0;
      const double down = split(v + kBand / 2, tiles.down, j);
      const int j1 = std::min(j + 1, tiles.down - 1);
      const auto along = [&](int i) {
        return (1 - down) * tiles.at(i, j) + down * tiles.at(i, j1);
      };
      for (int u = 0; u < image.width; u += kBand) {
        int i = 0;
        const double across = split(u + kBand / 2, tiles.across, i);
        const int i1 = std::min(i + 1, tiles.across - 1);
        const auto grey =
            static_cast<std::uint8_t>((1 - across) * along(i) + across * along(i1) + 0.5);
        std::fill_n(level.begin() + u, std::min(kBand, image.width - u), grey);
      }
    }
    const std::uint8_t* p = image.row(v);
    const std::uint8_t* l = level.data();
    std::uint8_t* o = out.row(v);
    if (bright)
      for (int u = 0; u < image.width; ++u) o[u] = p[u] > l[u] ? 255 : 0;
    else
      for (int u = 0; u < image.width; ++u) o[u] = p[u] < l[u] ? 255 : 0;
  }
}

struct Ellipse {
  Vector2d centre;
  Matrix2d shape;  ///< x^T shape^-1 x = 1
  double major = 0.0, minor = 0.0;
  double angle_cos = 1.0, angle_sin = 0.0;

  Ellipse(const Vector2d& c, const Matrix2d& s) : centre(c), shape(s) {
    const double mean = 0.5 * (s(0, 0) + s(1, 1)), half = 0.5 * (s(0, 0) - s(1, 1));
    const double spread = std::hypot(half, s(0, 1));
    major = std::sqrt(std::max(0.0, mean + spread));
    minor = std::sqrt(std::max(0.0, mean - spread));
    const double angle = 0.5 * std::atan2(s(0, 1), half);
    angle_cos = std::cos(angle);
    angle_sin = std::sin(angle);
  }
  double area() const { return std::numbers::pi * major * minor; }
  double circumference() const {  // Ramanujan 1914
    return std::numbers::pi *
           (3 * (major + minor) - std::sqrt((3 * major + minor) * (major + 3 * minor)));
  }
};

/// Rows and chords of an ellipse whose half-axes are longer by `by_px`; empty if they vanish.
class Chords {
 public:
  Chords(const Ellipse& e, double by_px) : centre_(e.centre) {
    const double a = e.major + by_px, b = e.minor + by_px;
    if (a <= 0.0 || b <= 0.0) return;
    const double c = e.angle_cos, s = e.angle_sin;
    const double xx = a * a * c * c + b * b * s * s, xy = (a * a - b * b) * c * s;
    yy_ = a * a * s * s + b * b * c * c;
    half_width_ = std::sqrt(xx);
    slope_ = xy / yy_;
    flat_ = a * a * b * b / yy_;
  }
  int top() const { return static_cast<int>(std::ceil(centre_.y() - std::sqrt(yy_))); }
  int bottom() const { return static_cast<int>(std::floor(centre_.y() + std::sqrt(yy_))); }
  bool inside(ImageView image) const {
    return centre_.x() - half_width_ >= 0 && centre_.x() + half_width_ <= image.width - 1 &&
           top() >= 0 && bottom() < image.height;
  }
  /// Pixels [left, right] of row v; left > right where there are none.
  void chord(int v, int& left, int& right) const {
    const double y = v - centre_.y();
    const double rest = yy_ > 0.0 ? 1.0 - y * y / yy_ : -1.0;
    const double middle = centre_.x() + slope_ * y;
    if (rest < 0.0) {
      left = static_cast<int>(std::ceil(middle));
      right = left - 1;
      return;
    }
    const double half = std::sqrt(rest * flat_);
    left = static_cast<int>(std::ceil(middle - half));
    right = static_cast<int>(std::floor(middle + half));
  }

 private:
  Vector2d centre_;
  double yy_ = 0.0, slope_ = 0.0, flat_ = 0.0, half_width_ = 0.0;
};

/// Least-squares plane through grey values.
class PlaneFit {
 public:
  /// Pixels [left, right] of a row; coordinates are u - u0 and y.
  void add(const std::uint8_t* row, int left, int right, int u0, int y) {
    if (left > right) return;
    int g1 = 0, g2 = 0, xg = 0;
    for (int u = left; u <= right; ++u) {
      const int g = row[u];
      g1 += g;
      g2 += g * g;
      xg += (u - u0) * g;
    }
    const double n = right - left + 1, m = 0.5 * (left + right) - u0;
    n_ += n;
    x_ += n * m;
    y_ += n * y;
    xx_ += n * (m * m + (n * n - 1.0) / 12.0);
    xy_ += n * m * y;
    yy_ += n * y * y;
    g_ += g1;
    xg_ += xg;
    yg_ += static_cast<double>(g1) * y;
    gg_ += g2;
  }
  /// The same without the pixels that are marked.
  void add_unmarked(const std::uint8_t* row, const std::uint8_t* mark, int left, int right, int u0,
                    int y) {
    while (left <= right) {
      int end = left;
      while (end <= right && mark[end] == 0) ++end;
      add(row, left, end - 1, u0, y);
      left = end + 1;
    }
  }
  double count() const { return n_; }
  /// (level at the origin, slope in x, slope in y).
  Vector3d solve() const {
    Matrix3d A;
    A << n_, x_, y_, x_, xx_, xy_, y_, xy_, yy_;
    return A.inverse() * Vector3d(g_, xg_, yg_);
  }
  double mean() const { return g_ / n_; }
  double mean_of(const Vector3d& plane) const {
    return plane[0] + (plane[1] * x_ + plane[2] * y_) / n_;
  }
  /// Variance of the residuals about a plane from `solve`.
  double variance(const Vector3d& plane) const {
    return std::max(kRoundingVariance, (gg_ - plane[0] * g_ - plane[1] * xg_ - plane[2] * yg_) /
                                           std::max(1.0, n_ - 3.0));
  }
  /// sum x x^T about the pixels' own middle.
  Matrix2d scatter() const {
    Matrix2d s;
    s << xx_ - x_ * x_ / n_, xy_ - x_ * y_ / n_, xy_ - x_ * y_ / n_, yy_ - y_ * y_ / n_;
    return s;
  }

 private:
  double n_ = 0, x_ = 0, y_ = 0, xx_ = 0, xy_ = 0, yy_ = 0;
  double g_ = 0, xg_ = 0, yg_ = 0, gg_ = 0;
};

struct Measured {
  Vector2d centre;
  double sigma = 0.0;
  double area = 0.0;
  double blur = 0.0;
};

/// One pass of the estimator above on the ring of half-width `ring` along the ellipse.
/// @return false if there is too little ground or no contrast.
bool measure(ImageView image, ImageView marked, const Ellipse& e, double ring, double sign,
             const CircleOptions& options, Measured& out) {
  constexpr double kGroundWidth = 3.0;
  constexpr int kFewForPlane = 16;
  const Chords inner(e, -ring), outer(e, ring), ground_end(e, ring + kGroundWidth);
  const int u0 = static_cast<int>(std::lround(e.centre.x())),
            v0 = static_cast<int>(std::lround(e.centre.y()));

  struct Row {
    int inner_left, inner_right, outer_left, outer_right;
  };
  const int top = outer.top(), bottom = outer.bottom();
  std::array<Row, 512> rows;
  if (bottom - top >= static_cast<int>(rows.size())) return false;

  PlaneFit ground, plateau;
  const int plateau_step =
      1 + static_cast<int>(std::max(0.0, e.minor - ring) / 8.0);  // enough pixels
  for (int v = std::max(0, ground_end.top()); v <= std::min(image.height - 1, ground_end.bottom());
       ++v) {
    const std::uint8_t* row = image.row(v);
    const std::uint8_t* mark = marked.row(v);  // of neighbours
    int l, r;
    ground_end.chord(v, l, r);
    l = std::max(0, l);
    r = std::min(image.width - 1, r);
    if (v < top || v > bottom) {
      ground.add_unmarked(row, mark, l, r, u0, v - v0);
      continue;
    }
    Row& chord = rows[static_cast<std::size_t>(v - top)];
    outer.chord(v, chord.outer_left, chord.outer_right);
    ground.add_unmarked(row, mark, l, chord.outer_left - 1, u0, v - v0);
    ground.add_unmarked(row, mark, std::max(l, chord.outer_right + 1), r, u0, v - v0);
    inner.chord(v, chord.inner_left, chord.inner_right);
    if (chord.inner_left > chord.inner_right) {  // the ring fills the row
      chord.inner_left = chord.outer_right + 1;
      chord.inner_right = chord.outer_right;
    } else if (v % plateau_step == 0) {
      plateau.add(row, chord.inner_left, chord.inner_right, u0, v - v0);
    }
  }
  if (ground.count() < 12) return false;
  const Vector3d g = ground.solve();
  if (!g.allFinite()) return false;
  const double ground_variance = ground.variance(g);

  Vector3d c = Vector3d::Zero();  // contrast p - g, times sign > 0
  double plateau_variance = ground_variance;
  const bool sloped = plateau.count() >= kFewForPlane;
  if (sloped) {
    const Vector3d p = plateau.solve();
    plateau_variance = plateau.variance(p);
    c = p - g;
  } else if (plateau.count() > 0) {
    c[0] = plateau.mean() - ground.mean_of(g);
  } else {  // no plateau: the brightest pixel, which scales w and moves no centre
    const std::uint8_t middle = image.row(v0)[u0];
    c[0] = middle - g[0];
  }
  if (!(sign * c[0] > 0.5 * options.min_contrast_grey)) return false;
  if (options.electrons_per_grey > 0.0)
    plateau_variance =
        std::max(kRoundingVariance, ground_variance + c[0] / options.electrons_per_grey);

  double W = 0, Wx = 0, Wy = 0;                   // sums of w, w x, w y
  double n = 0, edge = 0;                         // ring: pixels, sum w (1 - w)
  Matrix2d all = Matrix2d::Zero(), bright = all;  // ring: sum x x^T, sum w x x^T
  for (int v = top; v <= bottom; ++v) {
    const Row& chord = rows[static_cast<std::size_t>(v - top)];
    const std::uint8_t* row = image.row(v);
    const double y = v - v0;
    const double g_row = g[0] + g[2] * y, c_row = c[0] + c[2] * y;
    double w0 = 0, w1 = 0, w2 = 0, ww = 0;  // sums of w, w x, w x^2, w^2 along the row
    const auto along = [&](int left, int right) {
      for (int u = left; u <= right; ++u) {
        const double x = u - u0;
        const double fill = (row[u] - (g_row + g[1] * x)) / (c_row + c[1] * x);
        const double w = std::clamp(fill, -kBeyond, 1.0 + kBeyond);
        w0 += w;
        w1 += w * x;
        w2 += w * x * x;
        ww += w * w;
      }
      const double k = std::max(0, right - left + 1), m = 0.5 * (left + right) - u0;
      n += k;
      all(0, 0) += k * (m * m + (k * k - 1.0) / 12.0);
      all(0, 1) += k * m * y;
      all(1, 1) += k * y * y;
    };
    along(chord.outer_left, chord.inner_left - 1);
    along(chord.inner_right + 1, chord.outer_right);
    edge += w0 - ww;
    bright(0, 0) += w2;
    bright(0, 1) += w1 * y;
    bright(1, 1) += w0 * y * y;
    const int filled = chord.inner_right - chord.inner_left + 1;
    if (filled > 0) {
      w0 += filled;
      w1 += filled * (0.5 * (chord.inner_left + chord.inner_right) - u0);
    }
    W += w0;
    Wx += w1;
    Wy += w0 * y;
  }
  if (!(W > 0.0)) return false;

  const double mean_variance = 0.5 * (ground_variance + plateau_variance);
  const double cc = c[0] * c[0];
  all(1, 0) = all(0, 1);
  bright(1, 0) = bright(0, 1);
  const Matrix2d dark = all - bright;
  const auto by_slope = [](const Matrix2d& lever, const PlaneFit& plane) {
    return (lever * plane.scatter().inverse() * lever).trace();
  };
  double variance =
      ground_variance * (dark.trace() + by_slope(dark, ground)) + plateau_variance * bright.trace();
  if (sloped) variance += plateau_variance * by_slope(bright, plateau);
  out.centre = Vector2d(u0 + Wx / W, v0 + Wy / W);
  out.sigma = std::sqrt(variance / (2.0 * cc)) / W;
  out.area = W;
  out.blur = std::sqrt(std::numbers::pi) * std::max(0.0, edge + n * mean_variance / cc) /
             e.circumference();
  return out.centre.allFinite() && std::isfinite(out.sigma);
}

/// End of the marked run that holds pixel u, in the direction of `step`, scratches bridged.
int run_end(const std::uint8_t* row, int u, int step, const PixelBox& box) {
  for (int ahead = 1; ahead <= kScratch + 1; ++ahead) {
    const int next = u + ahead * step;
    if (next < box.left || next > box.right) break;
    if (row[next] != 0) {
      u = next;
      ahead = 0;
    }
  }
  return u;
}

/// Ellipse of a marked region, from the chord of each row.
/// @return false unless the region is convex enough for one chord per row, and round.
bool ellipse_of(ImageView marked, const Component& c, const CircleOptions& options, Ellipse& out) {
  const PixelBox& box = c.box;
  const int middle = (box.top + box.bottom) / 2;
  int left0 = box.left, right0 = box.left - 1;
  {
    const std::uint8_t* row = marked.row(middle);
    for (int u = box.left; u <= box.right; ++u) {  // the longest run of the middle row
      if (row[u] == 0) continue;
      const int end = run_end(row, u, 1, box);
      if (end - u > right0 - left0) left0 = u, right0 = end;
      u = end;
    }
    if (right0 < left0) return false;
  }
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  const auto add = [&](int left, int right, int v) {
    const double k = right - left + 1, m = 0.5 * (left + right) - box.left, dy = v - middle;
    n += k;
    x += k * m;
    y += k * dy;
    xx += k * (m * m + (k * k - 1) / 12.0);
    xy += k * m * dy;
    yy += k * dy * dy;
  };
  add(left0, right0, middle);
  for (const int step : {-1, 1}) {
    int left = left0, right = right0;
    for (int v = middle + step; v >= box.top && v <= box.bottom; v += step) {
      const std::uint8_t* row = marked.row(v);
      int l = left, r = right;
      while (l <= right && row[l] == 0) ++l;
      if (l > right) break;
      while (row[r] == 0) --r;
      l = run_end(row, l, -1, box);
      r = run_end(row, r, 1, box);
      add(l, r, v);
      left = l;
      right = r;
    }
  }
  x /= n;
  y /= n;
  Matrix2d shape;
  shape << xx / n - x * x, xy / n - x * y, xy / n - x * y, yy / n - y * y;
  out = Ellipse({box.left + x, middle + y}, 4.0 * shape);
  return out.minor > 0.5 && out.major < options.max_aspect * out.minor &&
         n > options.min_roundness * out.area() && std::abs(n - c.area_px) < 0.2 * n;
}

}  // namespace

CircleSearch find_circles(ImageView image, bool bright, const CircleOptions& options) {
  CircleSearch search;
  if (image.empty()) return search;
  constexpr double kQuietGrey = 5.0;  // below, single pixels seldom cross the half-way level
  double noise = noise_of(image);
  cv::Mat smooth;
  ImageView seen = image;
  if (noise > kQuietGrey) {
    cv::blur(cv::Mat(image.height, image.width, CV_8U, const_cast<std::uint8_t*>(image.data),
                     static_cast<std::size_t>(image.stride)),
             smooth, {3, 3});
    seen = {smooth.data, image.width, image.height, static_cast<std::ptrdiff_t>(smooth.step)};
    noise /= 3.0;
  }
  Tiles tiles = half_way_levels(seen, noise, options);
  if (tiles.level.empty()) return search;
  Image marked(image.size(), 0);
  mark_foreground(seen, tiles, bright, marked);

  struct Region {
    Component component;
    Ellipse ellipse;
  };
  std::vector<Region> regions;
  for (const Component& c : find_components(marked, 127.0, true)) {
    if (c.area_px < options.min_area_px) continue;
    const double w = c.box.width(), h = c.box.height();
    const bool compact =
        std::max(w, h) <= options.max_aspect * std::min(w, h) && c.area_px >= 0.4 * w * h;
    Ellipse e(Vector2d::Zero(), Matrix2d::Identity());
    if (compact && c.touches_border)
      ++search.cut_by_border;
    else if (compact && ellipse_of(marked, c, options, e))
      regions.push_back({c, e});
    else
      ++search.rejected;
  }

  // The blur is the lens's: the median over some circles, seen through a wide ring.
  const double sign = bright ? 1.0 : -1.0;
  std::vector<double> blurs;
  const std::size_t stride = std::max<std::size_t>(1, regions.size() / 24);
  for (std::size_t i = 0; i < regions.size(); i += stride) {
    const Ellipse& e = regions[i].ellipse;
    Measured m;
    const double wide = std::min(4.0, 0.7 * e.minor);
    if (Chords(e, wide).inside(image) && measure(image, marked, e, wide, sign, options, m))
      blurs.push_back(m.blur);
  }
  double ring = 2.0;
  if (!blurs.empty()) {
    const auto middle = blurs.begin() + static_cast<std::ptrdiff_t>(blurs.size() / 2);
    std::nth_element(blurs.begin(), middle, blurs.end());
    ring = std::clamp(2.5 * *middle + 0.25, 1.25, 8.0);
  }

  search.circles.reserve(regions.size());
  for (const Region& region : regions) {
    Ellipse e = region.ellipse;
    Measured m;
    bool good = false, cut = false;
    for (int pass = 0; pass < 3; ++pass) {
      if (!Chords(e, ring).inside(image)) {
        cut = true;
        break;
      }
      good = measure(image, marked, e, ring, sign, options, m);
      if (!good) break;
      const double scale = m.area / e.area();
      const bool settled =
          (m.centre - e.centre).norm() < 0.25 && std::abs(std::sqrt(scale) - 1.0) * e.major < 0.35;
      if (settled || !(scale > 0.3 && scale < 3.0)) break;
      e = Ellipse(m.centre, e.shape * scale);
    }
    if (cut)
      ++search.cut_by_border;
    else if (!good || m.sigma > kLeastExact * std::sqrt(m.area))
      ++search.rejected;
    else
      search.circles.push_back({m.centre, m.sigma, std::sqrt(m.area / std::numbers::pi),
                                region.component.area_px, region.component.box, e.shape});
  }
  return search;
}

}  // namespace turntable
