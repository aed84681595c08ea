// Sub-pixel centres of bright or dark discs under uneven light.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "src/core/image.h"
#include "src/vision/components.h"

namespace turntable {

/// The image of a disc, nearly an ellipse.
struct Circle {
  Eigen::Vector2d centre_px;  ///< centroid of the disc's image; not yet the image of its centre
  double sigma_px = 0.0;      ///< standard uncertainty of the centre, per coordinate
  double radius_px = 0.0;     ///< of the circle of the same area
  int area_px = 0;            ///< pixels beyond the local half-way level
  PixelBox box;
  /// Ellipse x^T shape^-1 x = 1 about the centre, px^2.
  Eigen::Matrix2d shape_px2 = Eigen::Matrix2d::Identity();
};

struct CircleOptions {
  double electrons_per_grey = 0.0;  ///< shot noise; 0 = measured inside each disc
  double min_contrast_grey = 20.0;  ///< disc against ground
  int min_area_px = 20;
  double max_aspect = 3.0;
  double min_roundness = 0.85;  ///< area against that of the ellipse of the same second moments
};

struct CircleSearch {
  std::vector<Circle> circles;  ///< in the order of their first pixels, row-major
  int cut_by_border = 0;        ///< left out, because not all of the edge is in the image
  int rejected = 0;             ///< regions large enough but not round
};

/// Discs that are bright on a dark ground (or dark on bright) and lie wholly inside the image.
/// Nothing is thrown; an image without contrast holds no circles.
CircleSearch find_circles(ImageView image, bool bright, const CircleOptions& options = {});

}  // namespace turntable
