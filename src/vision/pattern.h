// Calibration patterns: what is seen, which point of the pattern it is, and where its centre is imaged.
#pragma once

#include <Eigen/Core>
#include <string_view>
#include <vector>

#include "src/core/rig_file.h"
#include "src/vision/components.h"

namespace turntable {

struct PatternPoint {
  int column = 0, row = 0;        ///< lattice position from the origin point
  Eigen::Vector2d on_pattern_mm;  ///< x to the right and y up, seen from the front
  Eigen::Vector2d centre_px;      ///< image of the circle's centre, or of the corner
  double sigma_px = 0.0;          ///< standard uncertainty, per coordinate
  PixelBox box;
};

enum class PatternStatus {
  kFound,
  kNoContrast,
  kNoLattice,                ///< too few points that stand like the pattern's
  kInconsistent,             ///< a lattice in pieces that do not continue each other
  kDirectionCirclesMissing,  ///< fewer than three of the four bigger circles
  kAmbiguous,                ///< more than one reading, or a circle that contradicts the only one
  kMirrored,
  kIncomplete,  ///< of a grid without direction circles: not all of it
};
std::string_view pattern_status_name(PatternStatus status);

struct PatternSearch {
  PatternStatus status = PatternStatus::kNoContrast;
  std::vector<PatternPoint> points;  ///< by row, then column; empty unless found
  int candidates = 0;                ///< circles (or corners) seen
  int cut_by_border = 0;             ///< left out
  int unexplained = 0;               ///< candidates that are no point of the pattern
  /// The pattern looks the same after half a turn (a quarter, if square). The reading whose x points
  /// most nearly along u was taken.
  bool half_turn_ambiguous = false;
  bool quarter_turn_ambiguous = false;
  double lattice_rms_px = 0.0;  ///< points about one smooth map, per coordinate
};

struct PatternOptions {
  double electrons_per_grey = 0.0;  ///< shot noise; 0 = measured inside each circle
  bool correct_centres = true;      ///< false leaves centroids, to show the bias
};

/// Finds the pattern of `pattern.kind`; ambiguity is an answer (`status`), never a guess.
///
/// `circles`: circles (circles.h) become one lattice from neighbour to neighbour (lattice.h), whose
/// members are checked against one smooth map. Direction comes from the constellation of the bigger
/// ones: of all turns, shifts and reflections one must explain at least three of them with no
/// circle against it, and the next best must be clearly worse. The rest of the pattern may be out of
/// view or covered.
/// `circle_grid`: the same lattice of equal circles; exactly one window of columns x rows must be
/// full.
/// `asymmetric_circles`, `chessboard`: board.h.
///
/// The centroid of a disc's image is not the image of its centre; the difference follows from the
/// smooth map (lattice.h) and is taken out.
PatternSearch find_pattern(ImageView image, const PatternConfig& pattern,
                           const PatternOptions& options = {});

}  // namespace turntable
