#include "src/vision/pattern.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "src/vision/centroid.h"

namespace turntable {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kMarginPx = 3;
constexpr double kLatticeTolerance =
    0.15;  ///< of the spacing, between a circle and its lattice point
constexpr int kScoringReach =
    5;  ///< lattice steps around the bigger circles in which namings compete

struct Blob {
  Vector2d centre_px;
  double sigma_px;
  double mass_px;
  PixelBox box;
  double size_ratio = 1.0;  ///< area against the median of the neighbours'
};

Matrix3d to_eigen(const cv::Mat& m) {
  Matrix3d out;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out(i, j) = m.at<double>(i, j);
  return out;
}

Vector2d apply(const Matrix3d& H, const Vector2d& p) { return (H * p.homogeneous()).hnormalized(); }

std::vector<Blob> find_blobs(ImageView image, bool bright, PatternSearch& search) {
  std::vector<Blob> blobs;
  const GreyRange range = grey_range(image);
  if (range.peak_to_peak() < 20) return blobs;
  // Half way between ground and circle, where blur moves no edge.
  const double threshold = 0.5 * (range.min + range.max);
  for (const Component& c : find_components(image, threshold, bright)) {
    const double w = c.box.width(), h = c.box.height();
    if (c.area_px < 20 || std::max(w, h) > 3.0 * std::min(w, h) || c.area_px < 0.5 * w * h)
      continue;
    Centroid centroid;
    if (c.touches_border || !contrast_centroid(image, c, bright, kMarginPx, centroid)) {
      ++search.cut_by_border;
      continue;
    }
    blobs.push_back({centroid.centre_px, centroid.sigma_px, static_cast<double>(c.area_px), c.box});
  }
  search.candidates = static_cast<int>(blobs.size());
  return blobs;
}

/// Area of each blob against the median of its eight nearest neighbours: perspective cancels.
void compare_with_neighbours(std::vector<Blob>& blobs) {
  std::vector<std::pair<double, double>> near;  // distance, area
  for (Blob& blob : blobs) {
    near.clear();
    for (const Blob& other : blobs)
      if (&other != &blob)
        near.emplace_back((other.centre_px - blob.centre_px).squaredNorm(), other.mass_px);
    const std::size_t k = std::min<std::size_t>(8, near.size());
    if (k == 0) continue;
    std::ranges::nth_element(near, near.begin() + static_cast<std::ptrdiff_t>(k) - 1);
    std::ranges::nth_element(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(k / 2),
                             near.begin() + static_cast<std::ptrdiff_t>(k), {},
                             &std::pair<double, double>::second);
    blob.size_ratio = blob.mass_px / near[k / 2].second;
  }
}

struct Naming {
  Matrix3d H_px_from_lattice = Matrix3d::Identity();
  int score = 0;
  bool mirrored = false;
};

/// How many circles near the bigger ones fall on free lattice points.
int score_of(const Matrix3d& H_lattice_from_px, const std::vector<Blob>& blobs,
             const PatternConfig& pattern) {
  int score = 0;
  for (const Blob& blob : blobs) {
    const Vector2d at = apply(H_lattice_from_px, blob.centre_px);
    const Vector2d lattice(std::round(at.x()), std::round(at.y()));
    if (!((at - lattice).cwiseAbs().maxCoeff() < kLatticeTolerance)) continue;
    const double column = lattice.x() + pattern.origin_column,
                 row = lattice.y() + pattern.origin_row;
    if (column < 0 || row < 0 || column >= pattern.columns || row >= pattern.rows) continue;
    const auto near =
        std::ranges::any_of(pattern.direction_circles, [&](const std::array<int, 2>& d) {
          return std::abs(d[0] - lattice.x()) + std::abs(d[1] - lattice.y()) <= kScoringReach;
        });
    if (near) ++score;
  }
  return score;
}

/// All ways to name four of the locally biggest blobs; the best two.
std::pair<Naming, Naming> best_namings(const std::vector<Blob>& blobs,
                                       const PatternConfig& pattern) {
  std::vector<std::size_t> big;
  for (std::size_t i = 0; i < blobs.size(); ++i)
    if (blobs[i].size_ratio > 1.25) big.push_back(i);
  std::ranges::sort(
      big, [&](std::size_t a, std::size_t b) { return blobs[a].size_ratio > blobs[b].size_ratio; });
  if (big.size() > 7) big.resize(7);

  std::array<cv::Point2f, 4> lattice;
  for (std::size_t i = 0; i < 4; ++i)
    lattice[i] = cv::Point2f(static_cast<float>(pattern.direction_circles[i][0]),
                             static_cast<float>(pattern.direction_circles[i][1]));
  std::pair<Naming, Naming> best;
  const auto n = big.size();
  for (std::size_t a = 0; a < n; ++a)
    for (std::size_t b = 0; b < n; ++b)
      for (std::size_t c = 0; c < n; ++c)
        for (std::size_t d = 0; d < n; ++d) {
          if (a == b || a == c || a == d || b == c || b == d || c == d) continue;
          std::array<cv::Point2f, 4> px;
          for (std::size_t i = 0; const std::size_t k : {a, b, c, d})
            px[i++] = cv::Point2f(static_cast<float>(blobs[big[k]].centre_px.x()),
                                  static_cast<float>(blobs[big[k]].centre_px.y()));
          const Matrix3d H = to_eigen(cv::getPerspectiveTransform(lattice, px));
          if (!H.allFinite() || !(std::abs(H.determinant()) > 1e-12)) continue;
          Naming naming;
          naming.H_px_from_lattice = H;
          naming.score = score_of(H.inverse(), blobs, pattern);
          // y of the pattern runs up, v of the image down: seen from its front the lattice is
          // turned over once.
          const Vector2d o = apply(H, {0, 0}), x = apply(H, {1, 0}) - o, y = apply(H, {0, 1}) - o;
          naming.mirrored = x.x() * y.y() - x.y() * y.x() > 0;
          if (naming.score > best.first.score) {
            best.second = best.first;
            best.first = naming;
          } else if (naming.score > best.second.score) {
            best.second = naming;
          }
        }
  return best;
}

using Assignment = std::map<std::array<int, 2>, std::size_t>;  // lattice (row, column) -> blob

/// Blobs on lattice points under H; a point claimed twice goes to the nearer blob.
Assignment assign(const Matrix3d& H_px_from_lattice, const std::vector<Blob>& blobs,
                  const PatternConfig& pattern, double reach) {
  const Matrix3d inverse = H_px_from_lattice.inverse();
  Assignment assignment;
  std::map<std::array<int, 2>, double> miss;
  for (std::size_t i = 0; i < blobs.size(); ++i) {
    const Vector2d at = apply(inverse, blobs[i].centre_px);
    if (!at.allFinite() || at.cwiseAbs().maxCoeff() > 1000) continue;
    const int column = static_cast<int>(std::lround(at.x())),
              row = static_cast<int>(std::lround(at.y()));
    const double off = (at - Vector2d(column, row)).cwiseAbs().maxCoeff();
    if (off > kLatticeTolerance || at.norm() > reach) continue;
    if (column + pattern.origin_column < 0 || column + pattern.origin_column >= pattern.columns ||
        row + pattern.origin_row < 0 || row + pattern.origin_row >= pattern.rows)
      continue;
    const std::array key{row, column};
    if (const auto it = miss.find(key); it != miss.end() && it->second <= off) continue;
    miss[key] = off;
    assignment[key] = i;
  }
  return assignment;
}

std::optional<Matrix3d> fit_homography(const Assignment& assignment,
                                       const std::vector<Blob>& blobs) {
  std::vector<cv::Point2d> lattice, px;
  for (const auto& [key, blob] : assignment) {
    lattice.emplace_back(key[1], key[0]);
    px.emplace_back(blobs[blob].centre_px.x(), blobs[blob].centre_px.y());
  }
  if (lattice.size() < 4) return std::nullopt;
  const cv::Mat H = cv::findHomography(lattice, px);
  if (H.empty()) return std::nullopt;
  return to_eigen(H);
}

/// Image of the centre minus centre of the image, for a circle of `radius` (in lattice units) under
/// H. The dual conic of the circle about c is  C* = T diag(r^2, r^2, -1) T^T  (up to sign), its
/// image H C* H^T, and the centre of a conic is the pole of the line at infinity: C* (0, 0, 1)^T.
Vector2d centre_bias_px(const Matrix3d& H, const Vector2d& centre, double radius) {
  Matrix3d T = Matrix3d::Identity();
  T.col(2).head<2>() = centre;
  const Matrix3d dual =
      T * Vector3d(radius * radius, radius * radius, -1.0).asDiagonal() * T.transpose();
  const Vector3d pole = (H * dual * H.transpose()).col(2);
  return apply(H, centre) - pole.hnormalized();
}

}  // namespace

std::string_view pattern_status_name(PatternStatus status) {
  switch (status) {
    case PatternStatus::kFound:
      return "found";
    case PatternStatus::kNoContrast:
      return "no circles: too little contrast";
    case PatternStatus::kDirectionCirclesMissing:
      return "the four bigger circles were not seen";
    case PatternStatus::kAmbiguous:
      return "the pattern's direction is ambiguous";
    case PatternStatus::kMirrored:
      return "the pattern appears mirrored: its y direction is stated wrongly in the rig file";
  }
  return "?";
}

PatternSearch find_pattern(ImageView image, const PatternConfig& pattern) {
  PatternSearch search;
  if (image.empty()) return search;
  std::vector<Blob> blobs = find_blobs(image, pattern.bright, search);
  if (blobs.empty()) return search;
  if (blobs.size() > 4000) {  // not a pattern; and the search below is quadratic
    search.status = PatternStatus::kAmbiguous;
    return search;
  }
  compare_with_neighbours(blobs);
  const auto [first, second] = best_namings(blobs, pattern);
  if (first.score < 12) {
    search.status = PatternStatus::kDirectionCirclesMissing;
    return search;
  }
  if (second.score > 0.7 * first.score) {
    search.status = PatternStatus::kAmbiguous;
    return search;
  }
  if (first.mirrored) {
    search.status = PatternStatus::kMirrored;
    return search;
  }

  // Four points carry a homography only so far: grow outwards, refitting on what is certain.
  Matrix3d H = first.H_px_from_lattice;
  Assignment assignment;
  const double last_reach = std::hypot(pattern.columns, pattern.rows);
  for (double reach = kScoringReach;; reach *= 1.6) {
    assignment = assign(H, blobs, pattern, reach);
    const auto refined = fit_homography(assignment, blobs);
    if (!refined) {
      search.status = PatternStatus::kDirectionCirclesMissing;
      return search;
    }
    H = *refined;
    if (reach > last_reach) break;
  }
  assignment = assign(H, blobs, pattern, last_reach);

  const auto is_direction = [&](const std::array<int, 2>& key) {
    return std::ranges::find(pattern.direction_circles, std::array{key[1], key[0]}) !=
           pattern.direction_circles.end();
  };
  // Wrong indexing must be impossible to miss: the bigger circles, and only they, are big.
  int contradictions = 0;
  for (const auto& [key, i] : assignment)
    if (is_direction(key) != (blobs[i].size_ratio > 1.25)) ++contradictions;
  if (contradictions > 1 + static_cast<int>(assignment.size()) / 50) {
    search.status = PatternStatus::kAmbiguous;
    return search;
  }

  for (const auto& [key, i] : assignment) {
    const Blob& blob = blobs[i];
    const double radius = is_direction(key) ? pattern.direction_radius_mm : pattern.radius_mm;
    IndexedCircle circle;
    circle.column = key[1];
    circle.row = key[0];
    circle.centre_px = blob.centre_px + centre_bias_px(H, Vector2d(circle.column, circle.row),
                                                       radius / pattern.spacing_mm);
    circle.sigma_px = blob.sigma_px;
    circle.box = blob.box;
    search.circles.push_back(circle);
  }
  search.unexplained = search.candidates - static_cast<int>(assignment.size());
  search.status = PatternStatus::kFound;
  return search;
}

}  // namespace turntable
