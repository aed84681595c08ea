// Errors against the turntable and what is said about them.
//   R_rel(k) = R(k) R(0)^T
//   e = Euler(R_measured_rel) - Euler(R_true_rel)   per axis in the gimbal's order, in (-180, 180]
//   RMSE per axis = sqrt(mean e^2),  total RMSE = sqrt(pitch^2 + roll^2 + yaw^2) of the axis RMSEs
//   maximum = the error of largest magnitude with its sign (the first of them)
// Source: X. Guo et al. 2019, Tables 3-5. Beyond the paper: geodesic angle |log(R_true^T
// R_measured)|, mean (bias) and standard deviation apart, 95th percentile, failed poses. Degrees.
// Golden numbers: statistics.json. Domain: finite errors. Of no errors at all every statistic is
// NaN, and the poses and failures are still counted.
#pragma once

#include <cstddef>
#include <functional>
#include <span>

#include "src/core/random.h"
#include "src/geometry/gimbal.h"
#include "src/geometry/rotation.h"

namespace turntable {

/// Error of one pose, deg.
struct PoseError {
  double pitch_deg = 0.0;
  double roll_deg = 0.0;
  double yaw_deg = 0.0;
  double geodesic_deg = 0.0;  ///< in [0, 180]
};

struct AxisStatistics {
  double max_signed_deg;  ///< the error of largest magnitude
  double rmse_deg;
  double mean_deg;                ///< bias
  double standard_deviation_deg;  ///< about the mean, n - 1; NaN for a single pose
};

struct GeodesicStatistics {
  double max_deg;
  double rmse_deg;
  double mean_deg;
  double median_deg;
  double percentile95_deg;
};

struct ErrorStatistics {
  AxisStatistics pitch, roll, yaw;
  double rmse_total_deg;
  GeodesicStatistics geodesic;
  std::size_t poses;   ///< all that were to be measured, failed ones included
  std::size_t failed;  ///< of them

  /// Share of poses that failed, in [0, 1]; 0 of no poses.
  double failed_share() const {
    return poses == 0 ? 0.0 : static_cast<double>(failed) / static_cast<double>(poses);
  }
};

/// R(k) R(0)^T: the rotation since the initial pose, in the frame of the rows of R.
Matrix3d relative_attitude(const Matrix3d& R_k, const Matrix3d& R_0);

/// Error of a measured rotation, both relative to the same initial pose and in the plane frame.
PoseError pose_error(const Gimbal& gimbal, const Matrix3d& R_measured_rel,
                     const Matrix3d& R_true_rel);

/// @param values any order, need not be sorted; @return NaN if empty.
double mean(std::span<const double> values);
/// About the mean, n - 1. @return NaN for fewer than two values.
double standard_deviation(std::span<const double> values);
/// sqrt(mean of squares); NaN if empty.
double root_mean_square(std::span<const double> values);
/// The value of largest magnitude, with its sign; the first of several. NaN if empty.
double max_signed(std::span<const double> values);
/// `share` in [0, 1], interpolated linearly between order statistics (the median is share 0.5). NaN
/// if empty.
double percentile(std::span<const double> values, double share);

struct Interval {
  double lower, upper;
};
/// A statistic with its 95 % interval; NaN where there is nothing to state.
struct WithInterval {
  double value;
  Interval interval;
};

/// 95 % interval of a statistic of `count` independent things, by drawing them again with
/// replacement (percentile bootstrap; B. Efron, R. Tibshirani, An Introduction to the Bootstrap,
/// 1993, ch. 13). `statistic` gets indices into them, `count` of them, some more than once.
/// @return NaN for fewer than two things. The same seed gives the same interval.
Interval bootstrap_interval(std::size_t count,
                            const std::function<double(std::span<const std::size_t>)>& statistic,
                            Random random, int resamples = 1000);

/// Root of the sum of squares of the three axis RMSEs.
double total_rmse(double pitch_deg, double roll_deg, double yaw_deg);

/// @param errors of the poses that have an attitude; @param failed number of poses that have none.
ErrorStatistics error_statistics(std::span<const PoseError> errors, std::size_t failed);

}  // namespace turntable
