#include "src/vision/pattern.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <set>

#include "src/vision/board.h"
#include "src/vision/circles.h"
#include "src/vision/lattice.h"

namespace turntable {
namespace {

using Eigen::Matrix2i;
using Eigen::Vector2d;
using Eigen::Vector2i;

constexpr std::size_t kFewestCircles = 12;  ///< a lattice of fewer proves too little

/// Circles on one lattice, each with its size against that of the small ones.
struct SeenLattice {
  std::vector<Circle> circles;
  std::vector<Vector2i> at;
  std::vector<double> size;  ///< area on the pattern over the median's
};

/// Leaves the members of the lattice that one smooth map explains. A rim circle draws the map to
/// itself, so residuals count as studentised, r / sqrt(1 - leverage). A member that stands off the
/// map by more than its own noise and the others' scatter is less certain than it claims (dirt at
/// its edge, a shadow): its sigma becomes its left-out residual.
/// @return kFound, kNoLattice or kInconsistent.
PatternStatus check_lattice(std::vector<LatticeNode>& nodes, std::vector<Circle>& circles,
                            PatternMap& map) {
  constexpr double kMostLeverage = 0.98;  // beyond, a residual says nothing of its point
  constexpr double kDoubt = 4.0;          // sigmas, or medians: rarer than 1 in 3000 by noise
  constexpr double kFarSteps = 0.01;      // with a residual up to here no member is left out
  constexpr double kSmoothSteps = 0.02;   // rms of what is left; more is not one lattice
  // Residuals of two neighbours that differ by more are a break, and so many a seam. A sheet that
  // buckles, or a shadow's edge on a circle, breaks one circle's neighbourhood: four.
  constexpr double kBreakSteps = 0.05;
  constexpr int kSeam = 6;
  std::vector<bool> keep(nodes.size(), true);
  std::vector<Vector2d> off(nodes.size());  // in lattice steps
  std::vector<Vector2d> at, px;
  std::vector<double> sizes, allowance(nodes.size()), own(nodes.size(), 1.0);  // own: 1 - leverage
  double usual = 0.0;
  for (int pass = 0; pass < 6; ++pass) {
    at.clear();
    px.clear();
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      if (!keep[i]) continue;
      at.push_back(nodes[i].at.cast<double>());
      px.push_back(circles[nodes[i].circle].centre_px);
    }
    if (at.size() < kFewestCircles || !map.fit(at, px)) return PatternStatus::kNoLattice;
    sizes.clear();
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      const PatternMap::Taylor f = map.at(nodes[i].at.cast<double>());
      const Circle& c = circles[nodes[i].circle];
      off[i] = f.J.inverse() * (c.centre_px - f.px);
      allowance[i] =
          std::max(kFarSteps, 5.0 * c.sigma_px / std::min(f.J.col(0).norm(), f.J.col(1).norm()));
      own[i] =
          keep[i] ? 1.0 - std::min(kMostLeverage, map.leverage(nodes[i].at.cast<double>())) : 1.0;
      if (keep[i]) sizes.push_back(off[i].norm() / std::sqrt(own[i]));
    }
    const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    usual = *middle;
    bool changed = false;
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      const bool good = off[i].norm() / std::sqrt(own[i]) <=
                        std::max(allowance[i], 10.0 * usual);  // paper buckles at its corners
      changed = changed || good != keep[i];
      keep[i] = good;
    }
    if (!changed) break;
  }
  // A part that is shifted as a whole: a seam between those that fit, or neighbours that are off,
  // and off alike.
  int breaks = 0, alike = 0;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    int n = 0;
    for (std::size_t j = 0; j < nodes.size(); ++j) {
      if (keep[i] != keep[j] || (nodes[i].at - nodes[j].at).cwiseAbs().sum() != 1) continue;
      const double jump = (off[i] - off[j]).norm();
      if (!keep[i] && jump < 0.25 * off[i].norm()) ++n;
      if (keep[i] && i < j &&
          jump > std::max(kBreakSteps, 1.5 * std::max(allowance[i], allowance[j])))
        ++breaks;
    }
    if (n >= 2) ++alike;
  }
  double sum = 0.0;
  std::vector<LatticeNode> good;
  for (std::size_t i = 0; i < nodes.size(); ++i)
    if (keep[i]) {
      Circle& c = circles[nodes[i].circle];
      const double left_out_px = (c.centre_px - map(nodes[i].at.cast<double>())).norm() / own[i];
      const double step_px =
          std::sqrt(std::abs(map.at(nodes[i].at.cast<double>()).J.determinant()));
      if (left_out_px * std::sqrt(own[i]) > kDoubt * std::max(c.sigma_px, usual * step_px))
        c.sigma_px = std::max(c.sigma_px, std::sqrt(0.5) * left_out_px);
      sum += off[i].squaredNorm();
      good.push_back(nodes[i]);
    }
  nodes = std::move(good);
  if (nodes.size() < kFewestCircles) return PatternStatus::kNoLattice;
  if (breaks >= kSeam || alike >= 3 ||
      std::sqrt(sum / static_cast<double>(nodes.size())) > kSmoothSteps)
    return PatternStatus::kInconsistent;
  return PatternStatus::kFound;
}

/// Circles of the image on one lattice, checked.
PatternStatus see_lattice(ImageView image, const PatternConfig& pattern,
                          const PatternOptions& options, PatternSearch& search, SeenLattice& out) {
  CircleOptions circle_options;
  circle_options.electrons_per_grey = options.electrons_per_grey;
  CircleSearch seen = find_circles(image, pattern.bright, circle_options);
  search.candidates = static_cast<int>(seen.circles.size());
  search.cut_by_border = seen.cut_by_border;
  if (seen.circles.empty()) return PatternStatus::kNoContrast;
  const double radius = pattern.radius_mm / pattern.spacing_mm;
  std::vector<LatticeNode> nodes = grow_lattice(
      seen.circles, {radius, std::max(radius, pattern.direction_radius_mm / pattern.spacing_mm)});
  if (nodes.size() < kFewestCircles) return PatternStatus::kNoLattice;
  PatternMap map;
  if (const PatternStatus s = check_lattice(nodes, seen.circles, map); s != PatternStatus::kFound)
    return s;

  std::vector<double> sorted;
  for (const LatticeNode& node : nodes) {
    const Circle& c = seen.circles[node.circle];
    out.circles.push_back(c);
    out.at.push_back(node.at);
    out.size.push_back(c.radius_px * c.radius_px /
                       std::abs(map.at(node.at.cast<double>()).J.determinant()));
  }
  sorted = out.size;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  for (double& size : out.size) size /= *middle;
  return PatternStatus::kFound;
}

/// A disc that is larger or smaller than it is drawn has something at its edge, and its centre is
/// uncertain by as much. @param drawn area over that of the small circles.
void doubt_by_size(Circle& c, double size, double drawn) {
  constexpr double kPrinted = 0.04;  // of the radius: patterns are drawn no better
  const double off_px = c.radius_px * std::abs(1.0 - std::sqrt(drawn / size));
  if (off_px > std::max(5.0 * c.sigma_px, kPrinted * c.radius_px))
    c.sigma_px = std::max(c.sigma_px, std::sqrt(0.5) * off_px);
}

/// A way to read the lattice as the drawn pattern: drawn = turn * seen + shift.
struct Reading {
  Matrix2i turn = Matrix2i::Identity();
  Vector2i shift = Vector2i::Zero();
  int hits = 0;            ///< bigger circles where they are drawn
  int contradictions = 0;  ///< bigger where a small one is drawn, or the reverse
  int off_pattern = 0;
  int score() const { return hits - contradictions - off_pattern; }
  bool mirrored() const { return turn(0, 0) * turn(1, 1) - turn(0, 1) * turn(1, 0) < 0; }
};

bool on_pattern(const Vector2i& from_origin, const PatternConfig& p) {
  const int column = from_origin.x() + p.origin_column, row = from_origin.y() + p.origin_row;
  return column >= 0 && row >= 0 && column < p.columns && row < p.rows;
}

PatternSearch find_directed_circles(ImageView image, const PatternConfig& pattern,
                                    const PatternOptions& options) {
  PatternSearch search;
  SeenLattice seen;
  search.status = see_lattice(image, pattern, options, search, seen);
  if (search.status != PatternStatus::kFound) return search;

  // Size in the logarithm: 0 = small, 1 = bigger as drawn; in between neither is said.
  enum class Size { kSmall, kUnclear, kBig };
  const double step = 2.0 * std::log(pattern.direction_radius_mm / pattern.radius_mm);
  std::vector<Size> sizes;
  std::vector<std::size_t> big;
  for (std::size_t i = 0; i < seen.at.size(); ++i) {
    const double size = std::log(seen.size[i]) / step;
    sizes.push_back(size > 0.6 ? Size::kBig : size < 0.4 ? Size::kSmall : Size::kUnclear);
    if (sizes.back() == Size::kBig) big.push_back(i);
    doubt_by_size(seen.circles[i], seen.size[i],
                  std::exp(step * std::clamp(std::round(size), 0.0, 1.0)));
  }
  if (big.size() < 3) {
    search.status = PatternStatus::kDirectionCirclesMissing;
    return search;
  }
  if (big.size() > 16) {  // no pattern of ours
    search.status = PatternStatus::kAmbiguous;
    return search;
  }

  // Where bigger ones are drawn, by place.
  std::vector<bool> drawn_big(static_cast<std::size_t>(pattern.columns * pattern.rows), false);
  const auto place = [&](const Vector2i& from_origin) {
    return static_cast<std::size_t>((from_origin.y() + pattern.origin_row) * pattern.columns +
                                    from_origin.x() + pattern.origin_column);
  };
  for (const auto& drawn : pattern.direction_circles) drawn_big[place({drawn[0], drawn[1]})] = true;

  std::vector<Reading> readings;
  std::set<std::array<int, 3>> tried;
  for (int k = 0; k < 8; ++k) {
    const int c = std::array{1, 0, -1, 0}[static_cast<std::size_t>(k % 4)],
              s = std::array{0, 1, 0, -1}[static_cast<std::size_t>(k % 4)];
    Matrix2i turn;
    turn << c, -s, s, c;
    if (k >= 4) turn.col(0) *= -1;
    for (const std::size_t b : big)
      for (const auto& drawn : pattern.direction_circles) {
        Reading r;
        r.turn = turn;
        r.shift = Vector2i(drawn[0], drawn[1]) - turn * seen.at[b];
        if (!tried.insert({k, r.shift.x(), r.shift.y()}).second) continue;
        for (std::size_t i = 0; i < seen.at.size(); ++i) {
          const Vector2i at = r.turn * seen.at[i] + r.shift;
          if (!on_pattern(at, pattern)) {
            ++r.off_pattern;
            continue;
          }
          const bool should_be_big = drawn_big[place(at)];
          if (sizes[i] == Size::kBig) ++(should_be_big ? r.hits : r.contradictions);
          if (sizes[i] == Size::kSmall && should_be_big) ++r.contradictions;
        }
        readings.push_back(r);
      }
  }
  std::ranges::stable_sort(readings, std::ranges::greater{}, &Reading::score);
  const Reading& best = readings.front();
  const int stray = std::max(2, static_cast<int>(seen.at.size()) / 30);
  const bool close = readings.size() > 1 && readings[1].score() > best.score() - 2;
  if (best.hits < 3 || best.contradictions > 0 || best.off_pattern > stray || close) {
    search.status = PatternStatus::kAmbiguous;
    return search;
  }
  if (best.mirrored()) {
    search.status = PatternStatus::kMirrored;
    return search;
  }

  std::vector<BoardPoint> points;
  std::vector<double> radii;
  const Vector2i origin(pattern.origin_column, pattern.origin_row);
  for (std::size_t i = 0; i < seen.at.size(); ++i) {
    const Vector2i at = best.turn * seen.at[i] + best.shift;
    if (!on_pattern(at, pattern)) continue;
    points.push_back({at + origin, seen.circles[i]});
    radii.push_back(drawn_big[place(at)] ? pattern.direction_radius_mm : pattern.radius_mm);
  }
  finish_board(points, radii, pattern, options, search);
  return search;
}

PatternSearch find_circle_grid(ImageView image, const PatternConfig& pattern,
                               const PatternOptions& options) {
  PatternSearch search;
  SeenLattice seen;
  search.status = see_lattice(image, pattern, options, search, seen);
  if (search.status != PatternStatus::kFound) return search;

  for (std::size_t i = 0; i < seen.at.size(); ++i)
    doubt_by_size(seen.circles[i], seen.size[i], 1.0);

  // Every window of the grid's size, upright or turned by a quarter, that is full of circles.
  Vector2i low = seen.at.front(), high = low;
  for (const Vector2i& at : seen.at) {
    low = low.cwiseMin(at);
    high = high.cwiseMax(at);
  }
  const Vector2i extent = high - low + Vector2i::Ones();
  std::vector<int> member(
      static_cast<std::size_t>(extent.x()) * static_cast<std::size_t>(extent.y()), -1);
  const auto cell = [&](int c, int r) -> int& {
    return member[static_cast<std::size_t>(r) * static_cast<std::size_t>(extent.x()) +
                  static_cast<std::size_t>(c)];
  };
  for (std::size_t i = 0; i < seen.at.size(); ++i)
    cell(seen.at[i].x() - low.x(), seen.at[i].y() - low.y()) = static_cast<int>(i);
  const bool square = pattern.columns == pattern.rows;
  std::vector<BoardPoint> points;
  int full = 0;
  for (int turned = 0; turned < (square ? 1 : 2); ++turned) {
    const int wide = turned ? pattern.rows : pattern.columns,
              high_rows = turned ? pattern.columns : pattern.rows;
    for (int r0 = 0; r0 + high_rows <= extent.y(); ++r0)
      for (int c0 = 0; c0 + wide <= extent.x(); ++c0) {
        std::vector<BoardPoint> window;
        for (int r = 0; r < high_rows; ++r)
          for (int c = 0; c < wide; ++c) {
            const int i = cell(c0 + c, r0 + r);
            if (i < 0) {
              r = high_rows;
              break;
            }
            // A quarter turn keeps the lattice right-handed.
            window.push_back({turned ? Vector2i(r, wide - 1 - c) : Vector2i(c, r),
                              seen.circles[static_cast<std::size_t>(i)]});
          }
        if (static_cast<int>(window.size()) < wide * high_rows) continue;
        ++full;
        points = std::move(window);
      }
  }
  if (full != 1) {
    search.status = full == 0 ? PatternStatus::kIncomplete : PatternStatus::kAmbiguous;
    return search;
  }
  search.half_turn_ambiguous = true;
  search.quarter_turn_ambiguous = square;
  turn_upright(points, pattern.columns, pattern.rows, square);
  finish_board(points, std::vector<double>(points.size(), pattern.radius_mm), pattern, options,
               search);
  return search;
}

}  // namespace

std::string_view pattern_status_name(PatternStatus status) {
  switch (status) {
    case PatternStatus::kFound:
      return "found";
    case PatternStatus::kNoContrast:
      return "no pattern: too little contrast";
    case PatternStatus::kNoLattice:
      return "nothing stands like the pattern";
    case PatternStatus::kInconsistent:
      return "the points do not lie on one smooth lattice: bent, shifted or seen twice";
    case PatternStatus::kDirectionCirclesMissing:
      return "fewer than three of the four bigger circles were seen";
    case PatternStatus::kAmbiguous:
      return "the pattern's direction is ambiguous";
    case PatternStatus::kMirrored:
      return "the pattern appears mirrored: its y direction is stated wrongly in the rig file";
    case PatternStatus::kIncomplete:
      return "not all of the pattern is in view, which has no direction circles";
  }
  return "?";
}

PatternSearch find_pattern(ImageView image, const PatternConfig& pattern,
                           const PatternOptions& options) {
  using Find = PatternSearch (*)(ImageView, const PatternConfig&, const PatternOptions&);
  struct Kind {
    PatternKind kind;
    Find find;
  };
  constexpr std::array<Kind, 4> kKinds{{{PatternKind::kCircles, find_directed_circles},
                                        {PatternKind::kCircleGrid, find_circle_grid},
                                        {PatternKind::kAsymmetricCircles, find_asymmetric_circles},
                                        {PatternKind::kChessboard, find_chessboard}}};
  if (image.empty()) return {};
  return std::ranges::find(kKinds, pattern.kind, &Kind::kind)->find(image, pattern, options);
}

}  // namespace turntable
