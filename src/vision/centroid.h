// Sub-pixel centres of small bright or dark regions.
#pragma once

#include <Eigen/Core>

#include "src/core/image.h"
#include "src/vision/components.h"

namespace turntable {

struct Centroid {
  Eigen::Vector2d centre_px;
  double sigma_px =
      0.0;  ///< standard uncertainty per coordinate from the grey noise around the region
  double mass_px = 0.0;  ///< area weighted by contrast: the region's true area, edges included
  double contrast_grey = 0.0;  ///< region against its ground
};

/// Centre of mass of the contrast  w = (grey - ground) * sign  over the component's box widened by
/// `margin_px`.
///   ground  = median of the rim of the widened box
///   noise   = standard deviation of the rim, from its quartiles
///   w < 2 noise counts as ground, so that the many empty pixels add no noise
///   sigma^2 = noise^2 sum |x - centre|^2 / (2 (sum w)^2)
/// Unbiased for a region of even brightness under any symmetric point spread; weights are linear in
/// grey, and the threshold that found the component does not enter the centre.
/// @return false if the widened box leaves the image or there is no contrast.
bool contrast_centroid(ImageView image, const Component& component, bool bright, int margin_px,
                       Centroid& out);

}  // namespace turntable
