// Handedness: y of the pattern runs up and v of the image down, so that d(u, v)/d(x, y) of a pattern
// seen from its front has a negative determinant. Boards that carry no marks are counted to make it so
// where that is one of their symmetries.
// Corner of a chessboard: every image gradient near it is at right angles to the line to it,
//   sum g g^T (q - corner) = 0  (Foerstner & Guelch 1987),  cov = s^2 (sum g g^T)^-1,
// s^2 the mean square of g^T (q - corner) over the window: the scatter that is really there.
#include "src/vision/board.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "src/vision/lattice.h"

namespace turntable {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector2i;

cv::Mat as_cv(ImageView image) {
  return cv::Mat(image.height, image.width, CV_8U, const_cast<std::uint8_t*>(image.data),
                 static_cast<std::size_t>(image.stride));
}

/// Map through all points in lattice steps; nothing if there is none.
std::optional<PatternMap> map_of(std::span<const BoardPoint> points) {
  std::vector<Vector2d> at, px;
  for (const BoardPoint& p : points) {
    at.push_back(p.at.cast<double>());
    px.push_back(p.circle.centre_px);
  }
  PatternMap map;
  if (!map.fit(at, px)) return std::nullopt;
  return map;
}

Vector2d middle_of(int columns, int rows) { return {0.5 * (columns - 1), 0.5 * (rows - 1)}; }

/// Standard uncertainty of a corner, px; nothing if its window leaves the image.
std::optional<double> corner_sigma(ImageView image, const Vector2d& corner, int half) {
  const int u0 = static_cast<int>(std::lround(corner.x())),
            v0 = static_cast<int>(std::lround(corner.y()));
  if (u0 - half < 1 || v0 - half < 1 || u0 + half > image.width - 2 || v0 + half > image.height - 2)
    return std::nullopt;
  Matrix2d G = Matrix2d::Zero();
  double square = 0.0;
  int n = 0;
  for (int v = v0 - half; v <= v0 + half; ++v)
    for (int u = u0 - half; u <= u0 + half; ++u) {
      const Vector2d g(0.5 * (image.row(v)[u + 1] - image.row(v)[u - 1]),
                       0.5 * (image.row(v + 1)[u] - image.row(v - 1)[u]));
      G += g * g.transpose();
      const double miss = g.dot(Vector2d(u, v) - corner);
      square += miss * miss;
      ++n;
    }
  if (!(G.determinant() > 0.0)) return std::nullopt;
  return std::sqrt(square / (n - 2) * 0.5 * G.inverse().trace());
}

}  // namespace

void turn_upright(std::vector<BoardPoint>& points, int columns, int rows, bool quarter_turns) {
  const auto map = map_of(points);
  if (!map) return;
  const Matrix2d J = map->at(middle_of(columns, rows)).J;
  // Direction of the old frame that lies nearest to u: +x, +y, -x or -y.
  int turns = J(0, 0) < 0.0 ? 2 : 0;
  if (quarter_turns && J.col(1).normalized().cwiseAbs().x() > J.col(0).normalized().cwiseAbs().x())
    turns = J(0, 1) < 0.0 ? 3 : 1;
  for (BoardPoint& p : points) {
    const int c = p.at.x(), r = p.at.y();
    p.at = turns == 0   ? Vector2i(c, r)
           : turns == 1 ? Vector2i(r, columns - 1 - c)
           : turns == 2 ? Vector2i(columns - 1 - c, rows - 1 - r)
                        : Vector2i(rows - 1 - r, c);
  }
}

void finish_board(std::span<const BoardPoint> points, std::span<const double> radius_mm,
                  const PatternConfig& pattern, const PatternOptions& options,
                  PatternSearch& search) {
  search.status = PatternStatus::kNoLattice;
  const auto map = map_of(points);
  if (!map) return;
  double sum = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const BoardPoint& p = points[i];
    const PatternMap::Taylor f = map->at(p.at.cast<double>());
    sum += (f.px - p.circle.centre_px).squaredNorm();
    PatternPoint out;
    out.column = p.at.x() - pattern.origin_column;
    out.row = p.at.y() - pattern.origin_row;
    out.on_pattern_mm = pattern.spacing_mm * Vector2d(out.column, out.row);
    out.centre_px = p.circle.centre_px;
    if (options.correct_centres)
      out.centre_px -= centroid_bias_px(f, radius_mm[i] / pattern.spacing_mm);
    out.sigma_px = p.circle.sigma_px;
    out.box = p.circle.box;
    search.points.push_back(out);
  }
  std::ranges::sort(search.points, {}, [](const PatternPoint& p) {
    return std::array{p.row, p.column};
  });
  search.lattice_rms_px = std::sqrt(sum / (2.0 * static_cast<double>(points.size())));
  search.unexplained = search.candidates - static_cast<int>(points.size());
  search.status = PatternStatus::kFound;
}

PatternSearch find_asymmetric_circles(ImageView image, const PatternConfig& pattern,
                                      const PatternOptions& options) {
  PatternSearch search;
  CircleOptions circle_options;
  circle_options.electrons_per_grey = options.electrons_per_grey;
  const CircleSearch seen = find_circles(image, pattern.bright, circle_options);
  search.candidates = static_cast<int>(seen.circles.size());
  search.cut_by_border = seen.cut_by_border;
  if (seen.circles.empty()) return search;
  search.status = PatternStatus::kNoLattice;
  if (seen.circles.size() > 1000) return search;  // OpenCV's search is worse than quadratic
  std::vector<cv::Point2f> candidates, named;
  for (const Circle& c : seen.circles)
    candidates.emplace_back(static_cast<float>(c.centre_px.x()),
                            static_cast<float>(c.centre_px.y()));
  try {
    if (!cv::findCirclesGrid(candidates, {pattern.columns, pattern.rows}, named,
                             cv::CALIB_CB_ASYMMETRIC_GRID, nullptr,
                             cv::CirclesGridFinderParameters()))
      return search;
  } catch (const cv::Exception&) {  // it asserts on some constellations that are no grid
    return search;
  }

  std::vector<BoardPoint> points;
  for (std::size_t k = 0; k < named.size(); ++k) {
    const auto match = std::ranges::find(candidates, named[k]);
    if (match == candidates.end()) return search;
    const int row = static_cast<int>(k) / pattern.columns,
              j = static_cast<int>(k) % pattern.columns;
    points.push_back({{2 * j + row % 2, row},
                      seen.circles[static_cast<std::size_t>(match - candidates.begin())]});
  }
  const int columns = 2 * pattern.columns, rows = pattern.rows;
  const auto map = map_of(points);
  if (!map) return search;
  if (map->at(middle_of(columns, rows)).J.determinant() > 0.0) {
    if (rows % 2 == 0) {
      search.status = PatternStatus::kMirrored;
      return search;
    }
    for (BoardPoint& p : points) p.at.y() = rows - 1 - p.at.y();  // a symmetry of the grid
  }
  search.half_turn_ambiguous = rows % 2 == 0;
  if (search.half_turn_ambiguous) turn_upright(points, columns, rows, false);
  finish_board(points, std::vector<double>(points.size(), pattern.radius_mm), pattern, options,
               search);
  return search;
}

PatternSearch find_chessboard(ImageView image, const PatternConfig& pattern,
                              const PatternOptions& options) {
  PatternSearch search;
  if (image.empty()) return search;
  std::vector<cv::Point2f> corners;
  const int columns = pattern.columns, rows = pattern.rows;
  if (!cv::findChessboardCornersSB(as_cv(image), {columns, rows}, corners,
                                   cv::CALIB_CB_NORMALIZE_IMAGE) ||
      corners.size() != static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows)) {
    const GreyRange range = grey_range(image);
    search.status =
        range.peak_to_peak() < 20 ? PatternStatus::kNoContrast : PatternStatus::kNoLattice;
    return search;
  }
  search.candidates = static_cast<int>(corners.size());
  std::vector<BoardPoint> points;
  for (std::size_t k = 0; k < corners.size(); ++k) {
    BoardPoint p;
    p.at = {static_cast<int>(k) % columns, static_cast<int>(k) / columns};
    p.circle.centre_px = {corners[k].x, corners[k].y};
    points.push_back(p);
  }
  const auto map = map_of(points);
  if (!map) {
    search.status = PatternStatus::kNoLattice;
    return search;
  }
  const bool down = map->at(middle_of(columns, rows)).J.determinant() > 0.0;
  for (BoardPoint& p : points) {
    const Matrix2d J = map->at(p.at.cast<double>()).J;
    const double step = std::min(J.col(0).norm(), J.col(1).norm());
    const int half = std::clamp(static_cast<int>(0.3 * step), 2, 8);
    // The search leaves a bias of some 0.03 px (0.2 px rms with CALIB_CB_ACCURACY); Foerstner's
    // point has none.
    std::vector<cv::Point2f> corner{
        {static_cast<float>(p.circle.centre_px.x()), static_cast<float>(p.circle.centre_px.y())}};
    cv::cornerSubPix(as_cv(image), corner, {half, half}, {-1, -1},
                     {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 40, 1e-3});
    p.circle.centre_px = {corner[0].x, corner[0].y};
    p.circle.sigma_px = corner_sigma(image, p.circle.centre_px, half).value_or(0.5);
    const int u = static_cast<int>(std::lround(p.circle.centre_px.x())),
              v = static_cast<int>(std::lround(p.circle.centre_px.y()));
    p.circle.box = {u - half, v - half, u + half, v + half};
    if (down) p.at.y() = rows - 1 - p.at.y();
  }
  const bool square = columns == rows;
  search.half_turn_ambiguous = (columns + rows) % 2 == 0;
  search.quarter_turn_ambiguous = square && columns % 2 == 0;
  turn_upright(points, columns, rows, search.quarter_turn_ambiguous);
  if (!search.quarter_turn_ambiguous && (square || !search.half_turn_ambiguous)) {
    // The colours decide: grey in the middle of the first square against its neighbour in x.
    const auto turned = map_of(points);
    if (!turned) return search;
    const auto grey = [&](double x, double y) {
      const Vector2d p = (*turned)(Vector2d(x, y));
      const int u = std::clamp(static_cast<int>(std::lround(p.x())), 0, image.width - 1),
                v = std::clamp(static_cast<int>(std::lround(p.y())), 0, image.height - 1);
      return image.row(v)[u];
    };
    if (grey(0.5, 0.5) > grey(1.5, 0.5))
      for (BoardPoint& p : points)
        p.at = square ? Vector2i(p.at.y(), columns - 1 - p.at.x())
                      : Vector2i(columns - 1 - p.at.x(), rows - 1 - p.at.y());
    if (square) search.half_turn_ambiguous = true;
  }
  finish_board(points, std::vector<double>(points.size(), 0.0), pattern, options, search);
  return search;
}

}  // namespace turntable
