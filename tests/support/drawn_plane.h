// Images of a plane whose grey values are known everywhere, for what the simulated rig does not draw.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "src/core/image.h"
#include "src/core/random.h"

namespace turntable {

/// Grey image of `grey(point on the plane)` under the homography H (plane -> pixel): the mean over
/// 5 x 5 places of each pixel's square, noise added.
template <class Grey>
Image draw_plane(ImageSize size, const Eigen::Matrix3d& H_px_from_plane, Grey&& grey, double noise,
                 Random random) {
  const Eigen::Matrix3d back = H_px_from_plane.inverse();
  Image image(size, 0);
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u) {
      double sum = 0.0;
      for (int j = -2; j <= 2; ++j)
        for (int i = -2; i <= 2; ++i) {
          const Eigen::Vector2d at =
              (back * Eigen::Vector3d(u + 0.2 * i, v + 0.2 * j, 1.0)).hnormalized();
          sum += grey(at);
        }
      const double value = sum / 25.0 + noise * random.normal();
      image.row(v)[u] = static_cast<std::uint8_t>(std::clamp(std::lround(value), 0L, 255L));
    }
  return image;
}

/// Light that falls off over the image; `share(u, v)` of it is left.
template <class Share>
Image under_light(Image image, Share&& share) {
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u)
      image.row(v)[u] = static_cast<std::uint8_t>(std::lround(image.row(v)[u] * share(u, v)));
  return image;
}

/// Gaussian noise for many images of one size, from one table: a million draws, read from another
/// place for each image.
class NoiseTable {
 public:
  explicit NoiseTable(Random random) : random_(random), table_(1 << 20) {
    for (float& x : table_) x = static_cast<float>(random_.normal());
  }
  Image add_to(const Image& image, double sigma) {
    Image out = image;
    const std::size_t start = random_() % table_.size();
    for (std::size_t i = 0; i < out.pixels.size(); ++i) {
      const float x = table_[(start + i) % table_.size()];
      const float grey = static_cast<float>(out.pixels[i]) + static_cast<float>(sigma) * x + 0.5f;
      out.pixels[i] = static_cast<std::uint8_t>(std::clamp(grey, 0.0f, 255.0f));
    }
    return out;
  }

 private:
  Random random_;
  std::vector<float> table_;
};

}  // namespace turntable
