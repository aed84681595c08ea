#include "src/vision/spots.h"

#include <algorithm>
#include <optional>

#include "src/vision/centroid.h"

namespace turntable {
namespace {

bool round_enough(const Component& c, const SpotOptions& options) {
  const double w = c.box.width(), h = c.box.height();
  return std::max(w, h) <= options.max_aspect * std::min(w, h) &&
         c.area_px >= options.min_fill * w * h;
}

bool near_border(const PixelBox& box, ImageView image) {
  return std::min({box.left, box.top, image.width - 1 - box.right, image.height - 1 - box.bottom}) <
         kCentroidMarginPx;
}

}  // namespace

SpotSearch find_spots(ImageView image, const SpotOptions& options) {
  SpotSearch search;
  if (image.empty()) return search;
  const GreyScan scan = scan_greys(image, true);
  search.range = scan.range;
  search.threshold = choose_threshold(search.range, true);
  if (search.range.peak_to_peak() < options.min_peak_to_peak) return search;

  SpotRejections& rejected = search.rejected;
  for (const Component& component : find_components(image, scan, search.threshold)) {
    const bool saturated = component.extreme == 255;
    if (component.area_px < options.min_area_px || component.area_px > options.max_area_px) {
      ++rejected.area;
    } else if (!round_enough(component, options)) {
      ++rejected.shape;
    } else if (near_border(component.box, image)) {
      ++rejected.border;
    } else if (saturated && !options.keep_saturated) {
      ++rejected.saturated;
    } else if (const std::optional<Centroid> c =
                   windowed_centroid(image, component, true, options.electrons_per_grey);
               !c) {
      ++rejected.shape;
    } else if (!(c->snr >= options.min_snr)) {
      ++rejected.faint;
    } else {
      search.spots.push_back({c->centre_px, c->sigma_px, static_cast<double>(component.extreme),
                              component.area_px, c->snr, saturated, component.box});
    }
  }
  std::ranges::stable_sort(search.spots, std::ranges::greater{}, &Spot::peak_grey);
  return search;
}

}  // namespace turntable
