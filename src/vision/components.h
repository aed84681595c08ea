// Connected bright (or dark) regions of a grey image, in one pass over the pixels.
//   threshold T = min + c (max - min), the coefficient c chosen by the range max - min
// (paper, figure 5). Runs of pixels beyond T are joined into 8-connected components.
// Own code, because a labelled image is never needed and costs most of the time (bench "vision").
#pragma once

#include <vector>

#include "src/core/image.h"

namespace turntable {

struct GreyRange {
  int min = 0;
  int max = 0;
  int peak_to_peak() const { return max - min; }
};

/// Smallest and largest grey value. The image must not be empty.
GreyRange grey_range(ImageView image);

/// Threshold from the image's own peak-to-peak range; weak images need a higher one, relatively, to
/// stay clear of the noise. Pixels are foreground if beyond it (> for bright, < for dark).
double choose_threshold(GreyRange range, bool bright);

/// Pixel rectangle, both ends included.
struct PixelBox {
  int left = 0, top = 0, right = -1, bottom = -1;
  int width() const { return right - left + 1; }
  int height() const { return bottom - top + 1; }
};

struct Component {
  PixelBox box;
  int area_px = 0;
  int extreme = 0;  ///< brightest (darkest) grey value inside
  bool touches_border = false;
};

/// 8-connected components beyond `threshold`, in the order in which their first pixel is met
/// (row-major).
/// @param max_components more than that and the search ends early, with the rest left out (hostile
/// images).
std::vector<Component> find_components(ImageView image, double threshold, bool bright,
                                       std::size_t max_components = 20000);

}  // namespace turntable
