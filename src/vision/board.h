// Boards that OpenCV indexes, and what all boards share: order, handedness, corrected centres.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "src/vision/circles.h"
#include "src/vision/pattern.h"

namespace turntable {

/// A point with its place, counted from the corner of the pattern with the least x and y.
struct BoardPoint {
  Eigen::Vector2i at;  ///< column, row
  Circle circle;
};

/// Turns a columns x rows board so that x points most nearly along u: by half turns, or by quarter
/// turns too (square boards).
void turn_upright(std::vector<BoardPoint>& points, int columns, int rows, bool quarter_turns);

/// Fills points (sorted, centres corrected by `radius_mm`, one per point, 0 for a corner) and
/// lattice_rms_px, and sets the status: kFound, or kNoLattice if no smooth map carries the points.
void finish_board(std::span<const BoardPoint> points, std::span<const double> radius_mm,
                  const PatternConfig& pattern, const PatternOptions& options,
                  PatternSearch& search);

/// Asymmetric circle grid: row i holds `columns` circles at lattice columns 2j + i % 2, spacing_mm is
/// the lattice step (half the distance within a row). Circles are ours, cv::findCirclesGrid names
/// them. Odd rows: unique; even rows: half_turn_ambiguous.
PatternSearch find_asymmetric_circles(ImageView image, const PatternConfig& pattern,
                                      const PatternOptions& options);

/// Inner corners of a chessboard, columns x rows, by cv::findChessboardCornersSB (Duda & Frese
/// 2018), refined by cv::cornerSubPix. Uncertainty: the scatter of the gradients about the corner. Where columns + rows is odd the
/// colours tell the half turn: the square next to the corner with the least x and y, between the
/// first four inner corners, is the dark one.
PatternSearch find_chessboard(ImageView image, const PatternConfig& pattern,
                              const PatternOptions& options);

}  // namespace turntable
