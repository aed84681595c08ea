// Sub-pixel centres of small bright or dark regions.
//
// The windowed centroid c is where the contrast, seen through a Gaussian window that moves along
// with c, has its centre of mass (Bertin & Arnouts 1996, SExtractor: XWIN_IMAGE):
//   F(c) = sum_i w_i (x_i - c) g_i = 0,   w_i = exp(-|x_i - c|^2 / (2 a^2)),   a^2 = area / (2 pi)
// by Newton's method, c <- c + J^-1 F, with
//   J = -dF/dc = sum_i w_i g_i (1 - (x_i - c)(x_i - c)^T / a^2)
// and, the noise of the pixels being independent, the law of propagation (GUM, JCGM 100:2008, 5.1):
//   cov c = J^-1 V J^-1,   V = sum_i w_i^2 (x_i - c)(x_i - c)^T var_i
//   var_i = noise^2 + g_i / K                                          (EMVA Standard 1288)
// Ground that is cut off at 0 shows less noise than there is: on the spot it counts as much as the rim's
// upper half has, which is whole, on the ground as much as is seen, and in between in proportion up to two
// standard deviations.
// Window: the a that makes cov c least is the standard deviation s of a Gaussian spot, where the
// estimate reaches the Cramer-Rao bound, and R / sqrt 2 of a sharp disc of radius R. With the area
// above a threshold of 0.3 to 0.5 of the peak, area / (2 pi) is 0.7 to 1.2 s^2 of the one and R^2 / 2
// of the other. In white noise the bound is missed by 4 % at most if the radius is below three times the
// blur, by 11 % at four and by 26 % at 5.6 (a disc of 5 px, blur 0.9 px), where a fit of edges is better.
// Symbols: x_i pixel, px; g_i = sign (grey - ground), grey levels, ground being the mean of the rim
// of the component's box, widened; noise its standard deviation, rounding to whole greys included;
// K electrons per grey level; area of the component, px^2.
// Domain: a centrally symmetric spot (for which c is unbiased) on even ground, alone in the widened
// box. A light beside it draws c towards itself by more than the uncertainty says. Of noise of 10, 20 and
// 30 on ground of 12 (the last with a third of the ground cut off at 0), errors are 1.03, 1.05 and 1.06 times
// what is said, of 30 on ground of 8 and 6 (43 % cut off) 1.11 and 1.19, and more beyond; where more than
// half is cut off, the noise is not known.
// A clipped spot has edges sharper than its optics make them, whose place between the pixels moves c:
// kClippedSigmaPx is added in quadrature, which holds up to three times white and is plenty below;
// pixels at 255 count with the noise they would have there. Below 0.5 grey of noise rounding is no
// longer random, and the error up to 1.4 times what is said. All measured on simulated spots.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "src/core/image.h"
#include "src/vision/components.h"

namespace turntable {

/// Pixels of ground around a component that the centroid looks at; the rim of them is the ground.
inline constexpr int kCentroidMarginPx = 6;

/// Standard uncertainty of a centre, per coordinate, from clipping.
inline constexpr double kClippedSigmaPx = 0.012;

struct Centroid {
  Eigen::Vector2d centre_px;
  double sigma_px = 0.0;    ///< standard uncertainty per coordinate (root mean square of the two)
  double noise_grey = 0.0;  ///< standard deviation of the ground
  double contrast_grey = 0.0;  ///< region against its ground, mean in the window
  double snr = 0.0;            ///< that against its own standard deviation
};

/// Windowed centroid of a component, from its box widened by kCentroidMarginPx.
/// @param electrons_per_grey of the camera; 0 = shot noise not counted.
/// @return nothing if the widened box leaves the image, or the contrast has no peak in the
/// component's box.
std::optional<Centroid> windowed_centroid(ImageView image, const Component& component, bool bright,
                                          double electrons_per_grey);

}  // namespace turntable
