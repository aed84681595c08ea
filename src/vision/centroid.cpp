#include "src/vision/centroid.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace turntable {
namespace {

/// Median and noise from a histogram of grey values.
struct Ground {
  double median = 0.0;
  double noise = 0.0;
};

Ground ground_of(const std::array<int, 256>& histogram, int count) {
  const auto quantile = [&](double share) {
    // Interpolated inside the grey level, as if its values were spread evenly over it.
    const double wanted = share * count;
    double below = 0.0;
    for (std::size_t g = 0; g < 256; ++g) {
      if (below + histogram[g] >= wanted && histogram[g] > 0)
        return static_cast<double>(g) - 0.5 + (wanted - below) / histogram[g];
      below += histogram[g];
    }
    return 255.0;
  };
  // The quartiles of a normal distribution lie 1.349 standard deviations apart.
  return {quantile(0.5),
          std::max((quantile(0.75) - quantile(0.25)) / 1.349, 1.0 / std::sqrt(12.0))};
}

}  // namespace

bool contrast_centroid(ImageView image, const Component& component, bool bright, int margin_px,
                       Centroid& out) {
  const PixelBox box{component.box.left - margin_px, component.box.top - margin_px,
                     component.box.right + margin_px, component.box.bottom + margin_px};
  if (box.left < 0 || box.top < 0 || box.right >= image.width || box.bottom >= image.height)
    return false;

  std::array<int, 256> rim{};
  int rim_count = 0;
  for (int v = box.top; v <= box.bottom; ++v) {
    const std::uint8_t* row = image.row(v);
    const bool whole_row = v == box.top || v == box.bottom;
    for (int u = box.left; u <= box.right; u += whole_row ? 1 : std::max(1, box.right - box.left)) {
      ++rim[row[u]];
      ++rim_count;
    }
  }
  const Ground ground = ground_of(rim, rim_count);
  const double floor = 2.0 * ground.noise;
  const double sign = bright ? 1.0 : -1.0;

  double sum = 0.0, sum_u = 0.0, sum_v = 0.0, peak = 0.0;
  double count = 0.0, count_uu = 0.0;
  const double mid_u = 0.5 * (box.left + box.right), mid_v = 0.5 * (box.top + box.bottom);
  for (int v = box.top; v <= box.bottom; ++v) {
    const std::uint8_t* row = image.row(v);
    for (int u = box.left; u <= box.right; ++u) {
      const double w = sign * (row[u] - ground.median);
      if (w < floor) continue;
      const double du = u - mid_u, dv = v - mid_v;
      sum += w;
      sum_u += w * du;
      sum_v += w * dv;
      peak = std::max(peak, w);
      count += 1.0;
      count_uu += du * du + dv * dv;
    }
  }
  if (!(sum > 0.0) || !(peak > 0.0)) return false;
  const double cu = sum_u / sum, cv = sum_v / sum;
  const double spread = count_uu - count * (cu * cu + cv * cv);
  out.centre_px = {mid_u + cu, mid_v + cv};
  out.sigma_px = ground.noise * std::sqrt(std::max(0.0, 0.5 * spread)) / sum;
  out.contrast_grey = peak;
  out.mass_px = sum / peak;
  return true;
}

}  // namespace turntable
