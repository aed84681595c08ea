// Quantiles of chi^2 for tests of fit.
#pragma once

#include <cmath>

namespace turntable {

// Quantiles of the normal distribution that such tests are stated by.
constexpr double kNormalQuantile999 = 3.090;
constexpr double kNormalQuantile9999 = 3.719;

/// Quantile of chi^2 with `dof` > 0 degrees of freedom at the probability of `normal_quantile`.
/// Source: E. B. Wilson, M. M. Hilferty, PNAS 17 (1931) 684-688; within 1 % from 2 degrees on.
inline double chi2_quantile(double dof, double normal_quantile) {
  const double v = 2.0 / (9.0 * dof);
  return dof * std::pow(1.0 - v + normal_quantile * std::sqrt(v), 3);
}

}  // namespace turntable
