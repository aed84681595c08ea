// Sums over clusters of poses, and the intervals of what is made of them: poses of the same angles
// share their systematic error, so that clusters are drawn again and not poses (cluster bootstrap;
// A. C. Davison, D. V. Hinkley, Bootstrap Methods and their Application, 1997, 3.8).
#pragma once

#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>
#include <vector>

#include "src/core/axis.h"
#include "src/evaluation/statistics.h"

namespace turntable {

inline double error_of(const PoseError& e, AxisId axis) {
  return axis == AxisId::kPitch ? e.pitch_deg : axis == AxisId::kRoll ? e.roll_deg : e.yaw_deg;
}

/// pitch^2 + roll^2 + yaw^2, deg^2.
inline double squared_error(const PoseError& e) {
  return e.pitch_deg * e.pitch_deg + e.roll_deg * e.roll_deg + e.yaw_deg * e.yaw_deg;
}

/// Sum and number of something over the poses of a cluster.
struct ClusterSum {
  double sum = 0.0;
  double count = 0.0;
  void add(double x) {
    sum += x;
    count += 1.0;
  }
};

inline double cluster_mean(const ClusterSum& s) { return s.sum / s.count; }
/// Of a sum of squares.
inline double cluster_rms(const ClusterSum& s) { return std::sqrt(s.sum / s.count); }

/// `over` all clusters, and its interval by drawing them again.
template <class Over>
WithInterval with_bootstrap(std::size_t clusters, const Over& over) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  std::vector<std::size_t> all(clusters);
  std::iota(all.begin(), all.end(), std::size_t{0});
  const double whole = over(all);
  if (!std::isfinite(whole)) return {kNone, {kNone, kNone}};
  return {whole, bootstrap_interval(clusters, over, Random(1, "scenario statistics"))};
}

/// `value(sums)` of columns of which each has one `ClusterSum` a cluster, some of them empty. NaN if
/// a column has nothing at all.
template <std::size_t N, class Value>
WithInterval clustered(const std::array<std::vector<ClusterSum>, N>& columns, const Value& value) {
  const auto over = [&](std::span<const std::size_t> drawn) {
    std::array<ClusterSum, N> sums{};
    for (std::size_t c = 0; c < N; ++c)
      for (const std::size_t g : drawn) {
        sums[c].sum += columns[c][g].sum;
        sums[c].count += columns[c][g].count;
      }
    for (const ClusterSum& s : sums)
      if (s.count == 0.0) return std::numeric_limits<double>::quiet_NaN();
    return static_cast<double>(value(sums));
  };
  return with_bootstrap(columns.front().size(), over);
}

}  // namespace turntable
