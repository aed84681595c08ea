#include "src/vision/centroid.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

namespace turntable {
namespace {

constexpr double kRoundingVariance = 1.0 / 12.0;
constexpr double kClippedShare = 0.01;  // of the ground: from here on its noise is seen cut off
constexpr int kMaxSteps = 20;
constexpr double kEnoughPx = 1e-3;  // Newton's next step would be about its square

struct Ground {
  double grey = 0.0;
  double variance = 0.0;  ///< as it is seen; rounding to whole greys included
  double whole_variance =
      0.0;  ///< without the cut at black or white: of what lies well away from it
};

PixelBox widened(const PixelBox& box, int margin) {
  return {box.left - margin, box.top - margin, box.right + margin, box.bottom + margin};
}

bool inside(const PixelBox& box, ImageView image) {
  return box.left >= 0 && box.top >= 0 && box.right < image.width && box.bottom < image.height;
}

/// Mean and variance of the rim of a box, without what lies far from its median: a neighbour's light.
Ground ground_of_rim(ImageView image, const PixelBox& box, bool bright) {
  std::array<int, 256> histogram{};
  int count = 0;
  for (int v = box.top; v <= box.bottom; ++v) {
    const std::uint8_t* row = image.row(v);
    const bool whole_row = v == box.top || v == box.bottom;
    for (int u = box.left; u <= box.right; u += whole_row ? 1 : std::max(1, box.right - box.left)) {
      ++histogram[row[u]];
      ++count;
    }
  }
  const auto quantile = [&](double share) {
    int below = 0;
    for (std::size_t g = 0; g < 256; ++g)
      if ((below += histogram[g]) >= share * count) return static_cast<int>(g);
    return 255;
  };
  // The quartiles of a normal distribution lie 1.349 standard deviations apart; rounding moves each
  // by up to half a grey.
  const double reach = 3.5 * (quantile(0.75) - quantile(0.25) + 1) / 1.349;
  const int median = quantile(0.5);
  double n = 0.0, sum = 0.0, sum_squares = 0.0;
  for (int g = 0; g < 256; ++g) {
    const double k = histogram[static_cast<std::size_t>(g)], off = g - median;
    if (std::abs(off) > reach) continue;
    n += k;
    sum += k * off;
    sum_squares += k * off * off;
  }
  const double mean = sum / n;
  Ground ground;
  ground.grey = median + mean;
  ground.variance =
      std::max((sum_squares - n * mean * mean) / std::max(1.0, n - 1.0), kRoundingVariance);
  ground.whole_variance = ground.variance;
  const std::size_t limit = bright ? 0 : 255;
  const int cut = histogram[limit];
  if (cut > kClippedShare * count && 2 * cut < count) {
    // The half of a normal distribution that is away from the limit is whole, and so is its median,
    // which lies somewhere in its grey level.
    const auto of = [&](int from_limit) {
      return histogram[static_cast<std::size_t>(bright ? from_limit : 255 - from_limit)];
    };
    int level = 0, below = of(0);
    while (2 * (below + of(level + 1)) < count) below += of(++level);
    ++level;
    const double into = (0.5 * count - below) / of(level);  // of the level's width
    const double centre = level - 0.5 + into;
    const int upper_quartile = bright ? quantile(0.75) : 255 - quantile(0.25);
    const double half_reach = 3.5 * (upper_quartile + 0.5 - centre) / 0.6745;
    double half = (1.0 - into) * of(level);
    double squares = half * (1.0 - into) * (1.0 - into) / 3.0;
    for (int g = level + 1; g < 256 && g - centre <= half_reach; ++g) {
      half += of(g);
      squares += of(g) * (g - centre) * (g - centre);
    }
    ground.whole_variance = std::max(ground.variance, squares / half);
  }
  return ground;
}

}  // namespace

std::optional<Centroid> windowed_centroid(ImageView image, const Component& component, bool bright,
                                          double electrons_per_grey) {
  const PixelBox box = widened(component.box, kCentroidMarginPx);
  if (!inside(box, image)) return std::nullopt;
  const Ground ground = ground_of_rim(image, box, bright);
  const double sign = bright ? 1.0 : -1.0;
  const double shot = electrons_per_grey > 0.0 ? sign / electrons_per_grey : 0.0;
  const double a2 = component.area_px / (2.0 * std::numbers::pi);

  // Within the box, from its left top corner; the Gaussian is a product of one along each axis.
  const int width = box.width(), height = box.height();
  std::vector<double> window(static_cast<std::size_t>(width));
  Eigen::Vector2d c(0.5 * (width - 1), 0.5 * (height - 1));
  const auto window_at = [&](double d) { return std::exp(-d * d / (2.0 * a2)); };
  const auto look = [&](auto&& at_pixel) {  // at_pixel(weight, du, dv, contrast)
    for (int i = 0; i < width; ++i) window[static_cast<std::size_t>(i)] = window_at(i - c.x());
    for (int j = 0; j < height; ++j) {
      const std::uint8_t* row = image.row(box.top + j) + box.left;
      const double dv = j - c.y(), down = window_at(dv);
      for (int i = 0; i < width; ++i)
        at_pixel(down * window[static_cast<std::size_t>(i)], i - c.x(), dv,
                 sign * (row[i] - ground.grey));
    }
  };

  Eigen::Matrix2d J;
  bool converged = false;
  for (int k = 0; k < kMaxSteps && !converged; ++k) {
    double s = 0, su = 0, sv = 0, suu = 0, suv = 0, svv = 0;
    look([&](double w, double du, double dv, double g) {
      const double wg = w * g;
      s += wg;
      su += wg * du;
      sv += wg * dv;
      suu += wg * du * du;
      suv += wg * du * dv;
      svv += wg * dv * dv;
    });
    J << s - suu / a2, -suv / a2, -suv / a2, s - svv / a2;
    // Not a peak: Newton would go away from it.
    if (!(J.determinant() > 0.0) || !(J.trace() > 0.0)) return std::nullopt;
    const Eigen::Vector2d step = J.inverse() * Eigen::Vector2d(su, sv);
    converged = step.norm() < kEnoughPx;
    c += step / std::max(1.0, step.norm());
    if (!(c.x() >= kCentroidMarginPx - 0.5 && c.x() <= width - kCentroidMarginPx - 0.5 &&
          c.y() >= kCentroidMarginPx - 0.5 && c.y() <= height - kCentroidMarginPx - 0.5))
      return std::nullopt;
  }
  if (!converged) return std::nullopt;

  // From the ground up to two standard deviations above it, less and less of the noise is cut off.
  const double hidden = ground.whole_variance - ground.variance;
  const double rise = hidden > 0.0 ? 1.0 / (2.0 * std::sqrt(ground.whole_variance)) : 0.0;
  double weights = 0, light = 0, light_variance = 0, vuu = 0, vuv = 0, vvv = 0;
  look([&](double w, double du, double dv, double g) {
    const double variance =
        w * w *
        std::max(ground.variance + hidden * std::clamp(rise * g, 0.0, 1.0) + shot * g,
                 kRoundingVariance);
    weights += w;
    light += w * g;
    light_variance += variance;
    vuu += variance * du * du;
    vuv += variance * du * dv;
    vvv += variance * dv * dv;
  });
  Eigen::Matrix2d V;
  V << vuu, vuv, vuv, vvv;
  const Eigen::Matrix2d inverse = J.inverse();
  Centroid out;
  out.centre_px = c + Eigen::Vector2d(box.left, box.top);
  const bool clipped = component.extreme == (bright ? 255 : 0);
  out.sigma_px =
      std::hypot(std::sqrt(0.5 * (inverse * V * inverse).trace()), clipped ? kClippedSigmaPx : 0.0);
  out.noise_grey = std::sqrt(ground.variance);
  out.contrast_grey = light / weights;
  out.snr = light / std::sqrt(light_variance);
  return out;
}

}  // namespace turntable
