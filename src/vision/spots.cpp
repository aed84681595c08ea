#include "src/vision/spots.h"

#include <algorithm>

#include "src/vision/centroid.h"

namespace turntable {
namespace {

/// Reach of a point spread beyond the threshold contour.
constexpr int kMarginPx = 3;

bool spot_like(const Component& c, const SpotOptions& options) {
  if (c.touches_border || c.area_px < options.min_area_px || c.area_px > options.max_area_px)
    return false;
  const double w = c.box.width(), h = c.box.height();
  return std::max(w, h) <= options.max_aspect * std::min(w, h) &&
         c.area_px >= options.min_fill * w * h;
}

}  // namespace

SpotSearch find_spots(ImageView image, const SpotOptions& options) {
  SpotSearch search;
  if (image.empty()) return search;
  search.range = grey_range(image);
  search.threshold = choose_threshold(search.range, true);
  if (search.range.peak_to_peak() < options.min_peak_to_peak) return search;

  for (const Component& component : find_components(image, search.threshold, true)) {
    Centroid centroid;
    if (!spot_like(component, options) ||
        !contrast_centroid(image, component, true, kMarginPx, centroid)) {
      ++search.rejected;
      continue;
    }
    search.spots.push_back({centroid.centre_px, centroid.sigma_px,
                            static_cast<double>(component.extreme), component.area_px,
                            component.extreme == 255, component.box});
  }
  std::ranges::stable_sort(search.spots, std::ranges::greater{}, &Spot::peak_grey);
  return search;
}

}  // namespace turntable
