// Pinhole baselines, by OpenCV: without distortion (what POSIT assumes) and with it (Brown: k1 k2
// p1 p2 k3). Camera frame: x right, y down, z forward. Pixel (0,0) is the centre of the top-left
// pixel.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "src/core/image.h"
#include "src/geometry/rotation.h"

namespace turntable {

struct PinholeModel {
  double fx = 0.0, fy = 0.0, cx = 0.0, cy = 0.0;
  std::array<double, 5>
      distortion{};     ///< k1 k2 p1 p2 k3 in OpenCV's order; all zero without distortion
  double rms_px = 0.0;  ///< reprojection residual of the fit, per point
  int views = 0;
  Matrix3d R_plane_from_camera =
      Matrix3d::Identity();  ///< mean over the views at zero table angles

  bool distorted() const;
  /// Pixel -> normalised coordinates (x, y, 1), distortion taken out.
  Vector2d normalise(const Vector2d& pixel_px) const;
};

/// One view of the flat pattern.
struct PatternView {
  std::vector<Vector2d> pixels_px;
  std::vector<Vector2d> on_pattern_mm;
  bool at_zero = false;  ///< table angles zero: the pattern frame is parallel to the plane frame
};

/// @throws Error with fewer than three views or none at zero angles.
PinholeModel fit_pinhole(std::span<const PatternView> views, ImageSize size, bool with_distortion);

}  // namespace turntable
