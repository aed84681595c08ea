// The circle pattern: every circle found, indexed from the four bigger ones, its centre corrected
// for perspective.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "src/core/rig_file.h"
#include "src/vision/components.h"

namespace turntable {

struct IndexedCircle {
  int column = 0, row = 0;  ///< lattice position from the origin circle
  Eigen::Vector2d centre_px;
  double sigma_px = 0.0;
  PixelBox box;

  /// Place on the pattern, mm.
  Eigen::Vector2d on_pattern_mm(double spacing_mm) const {
    return {column * spacing_mm, row * spacing_mm};
  }
};

enum class PatternStatus { kFound, kNoContrast, kDirectionCirclesMissing, kAmbiguous, kMirrored };
std::string_view pattern_status_name(PatternStatus status);

struct PatternSearch {
  PatternStatus status = PatternStatus::kNoContrast;
  std::vector<IndexedCircle> circles;  ///< by row, then column; empty unless found
  int candidates = 0;                  ///< round components seen
  int cut_by_border = 0;               ///< left out
  int unexplained = 0;                 ///< candidates that fit no lattice position
};

/// Circles are found as components beyond the image's own threshold (components.h), with the
/// centroid of their contrast as centre. That is the centre of the circle's image, an ellipse, and
/// not the image of its centre: the difference follows in closed form from the homography pattern
/// -> image (Heikkila & Silven 1997; dual conic) and is taken out. Directions come from the four
/// bigger circles: every way of naming four of the locally biggest components is tried, and the one
/// under which the others fall on lattice points wins; a close second, or a mirrored winner, is an
/// answer (`status`), never a guess. Domain: distortion below a tenth of the spacing over the
/// pattern.
PatternSearch find_pattern(ImageView image, const PatternConfig& pattern);

}  // namespace turntable
