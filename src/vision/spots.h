// LED spots: bright, round, unsaturated components with sub-pixel centres.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "src/core/image.h"
#include "src/vision/components.h"

namespace turntable {

struct Spot {
  Eigen::Vector2d centre_px;
  double sigma_px =
      0.0;  ///< standard uncertainty of each coordinate, from the noise around the spot
  double peak_grey = 0.0;
  int area_px = 0;
  bool saturated = false;  ///< some pixels at 255: the centre is less certain than it looks
  PixelBox box;
};

struct SpotOptions {
  int min_area_px = 6;
  int max_area_px = 4000;
  double max_aspect = 2.5;    ///< of the bounding box
  double min_fill = 0.4;      ///< area / bounding box; a disc fills 0.785
  int min_peak_to_peak = 20;  ///< below this the image holds no spot
};

struct SpotSearch {
  GreyRange range;
  double threshold = 0.0;
  std::vector<Spot> spots;  ///< brightest first
  int rejected = 0;         ///< components that failed a gate
};

/// Never throws on any content; an image without spots gives an empty list.
SpotSearch find_spots(ImageView image, const SpotOptions& options = {});

}  // namespace turntable
