// LED spots: bright, round components that stand out of the noise, with sub-pixel centres.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "src/core/image.h"
#include "src/vision/components.h"

namespace turntable {

struct Spot {
  Eigen::Vector2d centre_px;
  /// Standard uncertainty of each coordinate from the noise of the pixels (centroid.h). The centre
  /// is that of the spot; the image of a tilted disc's centre is beside it by
  /// r^2 f tan(tilt) / Z^2.
  double sigma_px = 0.0;
  double peak_grey = 0.0;
  int area_px = 0;
  double snr = 0.0;  ///< light in the centroid's window against its own standard deviation
  /// Some pixels at 255. `sigma_px` is larger then by what clipping does (kClippedSigmaPx); what a
  /// sensor does beyond clipping (blooming) is in no uncertainty.
  bool saturated = false;
  PixelBox box;
};

struct SpotOptions {
  int min_area_px = 6;
  int max_area_px = 4000;
  double max_aspect = 2.5;    ///< of the bounding box
  double min_fill = 0.4;      ///< area / bounding box; a disc fills 0.785
  int min_peak_to_peak = 20;  ///< below this the image holds no spot
  /// Speckle of pure noise that passes the gates before reaches about 9 (tests), an LED at the
  /// noise of its image hundreds.
  double min_snr = 12.0;
  bool keep_saturated = true;       ///< false: they are rejected
  double electrons_per_grey = 0.0;  ///< of the camera; 0 = shot noise is not in the uncertainty
};

/// Components that are no spots, by the first gate that they failed.
struct SpotRejections {
  int border = 0;  ///< nearer to it than kCentroidMarginPx
  int area = 0;
  int shape = 0;  ///< aspect, fill, or no peak
  int saturated = 0;
  int faint = 0;  ///< below the least ratio of signal to noise

  int total() const { return border + area + shape + saturated + faint; }
};

struct SpotSearch {
  GreyRange range;
  double threshold = 0.0;
  std::vector<Spot> spots;  ///< brightest first
  SpotRejections rejected;
};

/// Never throws on any content; an image without spots gives an empty list. Time is bounded by the
/// pixels and not by what they show: components end at a maximal number (find_components), and the
/// window of a centroid grows with the area of its component.
SpotSearch find_spots(ImageView image, const SpotOptions& options = {});

}  // namespace turntable
