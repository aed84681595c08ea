// Quantiles of chi^2 for tests of fit.
#pragma once

#include <cmath>
#include <numbers>

namespace turntable {

// Quantiles of the normal distribution that such tests are stated by.
constexpr double kNormalQuantile999 = 3.090;
constexpr double kNormalQuantile9999 = 3.719;

/// Quantile of chi^2 with `dof` > 0 degrees of freedom at the probability of `normal_quantile`.
/// Source: E. B. Wilson, M. M. Hilferty, PNAS 17 (1931) 684-688, within 3 % from 3 degrees on; exact
/// for 2, which is what four points have.
inline double chi2_quantile(double dof, double normal_quantile) {
  if (dof == 2.0) return -2.0 * std::log(0.5 * std::erfc(normal_quantile / std::numbers::sqrt2));
  const double v = 2.0 / (9.0 * dof);
  return dof * std::pow(1.0 - v + normal_quantile * std::sqrt(v), 3);
}

}  // namespace turntable
