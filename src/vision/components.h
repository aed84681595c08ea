// Connected bright (or dark) regions of a grey image. One pass over the pixels finds the range and
// the extreme of every tile of 64 x 8 pixels; only tiles that can hold foreground are looked at again.
//   threshold T = min + c (max - min), the coefficient c chosen by the range max - min
// (paper, figure 5). Runs of pixels beyond T are joined into 8-connected components.
// Own code, because a labelled image is never needed and costs most of the time (bench "vision").
#pragma once

#include <cstdint>
#include <vector>

#include "src/core/image.h"

namespace turntable {

struct GreyRange {
  int min = 0;
  int max = 0;
  int peak_to_peak() const { return max - min; }
};

/// What one pass over an image leaves behind.
struct GreyScan {
  bool bright = true;  ///< what is searched
  GreyRange range;
  std::vector<std::uint8_t> tiles;  ///< largest (of dark regions: smallest) grey, row-major
};

/// An empty image has the range 0 to 0 and no tiles.
GreyScan scan_greys(ImageView image, bool bright);

/// Smallest and largest grey value.
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
/// (row-major). Time grows with the pixels in tiles that hold foreground, whatever they show.
/// @param scan of the same image; it says whether bright or dark regions are searched.
/// @param max_components more than that and the search ends early, with the rest left out (hostile
/// images).
std::vector<Component> find_components(ImageView image, const GreyScan& scan, double threshold,
                                       std::size_t max_components = 20000);
/// The same with a pass of its own.
std::vector<Component> find_components(ImageView image, double threshold, bool bright,
                                       std::size_t max_components = 20000);

}  // namespace turntable
