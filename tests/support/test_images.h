// Small synthetic images.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "src/core/image.h"
#include "src/core/random.h"

namespace turntable {

struct BlobAt {
  double u, v, sigma_px, peak_grey;
};

/// Gaussian blobs on a noisy ground.
inline Image blobs(ImageSize size, const std::vector<BlobAt>& at, double background, double noise,
                   Random random) {
  Image image(size, 0);
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u) {
      double grey = background + noise * random.normal();
      for (const BlobAt& b : at) {
        const double r2 = (u - b.u) * (u - b.u) + (v - b.v) * (v - b.v);
        if (r2 < 36 * b.sigma_px * b.sigma_px)
          grey += b.peak_grey * std::exp(-0.5 * r2 / (b.sigma_px * b.sigma_px));
      }
      image.row(v)[u] = static_cast<std::uint8_t>(std::clamp(std::lround(grey), 0L, 255L));
    }
  return image;
}

}  // namespace turntable
