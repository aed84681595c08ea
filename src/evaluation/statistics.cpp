#include "src/evaluation/statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "src/core/units.h"

namespace turntable {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::vector<double> column(std::span<const PoseError> errors, double PoseError::*member) {
  std::vector<double> out;
  out.reserve(errors.size());
  for (const PoseError& e : errors) out.push_back(e.*member);
  return out;
}

AxisStatistics axis_statistics(std::span<const double> errors) {
  return {max_signed(errors), root_mean_square(errors), mean(errors), standard_deviation(errors)};
}

}  // namespace

Matrix3d relative_attitude(const Matrix3d& R_k, const Matrix3d& R_0) {
  return R_k * R_0.transpose();
}

PoseError pose_error(const Gimbal& gimbal, const Matrix3d& R_measured_rel,
                     const Matrix3d& R_true_rel) {
  const GimbalAngles measured = gimbal.angles(R_measured_rel);
  const GimbalAngles truth = gimbal.angles(R_true_rel);
  const auto error = [&](AxisId axis) {
    return wrap(deg_from_rad(measured[axis] - truth[axis]), 360.0);
  };
  return {error(AxisId::kPitch), error(AxisId::kRoll), error(AxisId::kYaw),
          deg_from_rad(geodesic_angle(R_true_rel, R_measured_rel))};
}

double mean(std::span<const double> values) {
  if (values.empty()) return kNaN;
  double sum = 0.0;
  for (const double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

double standard_deviation(std::span<const double> values) {
  if (values.size() < 2) return kNaN;
  const double m = mean(values);
  double sum = 0.0;
  for (const double v : values) sum += (v - m) * (v - m);
  return std::sqrt(sum / static_cast<double>(values.size() - 1));
}

double root_mean_square(std::span<const double> values) {
  if (values.empty()) return kNaN;
  double sum = 0.0;
  for (const double v : values) sum += v * v;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

double max_signed(std::span<const double> values) {
  if (values.empty()) return kNaN;
  double largest = values.front();
  for (const double v : values)
    if (std::abs(v) > std::abs(largest)) largest = v;
  return largest;
}

double percentile(std::span<const double> values, double share) {
  if (values.empty()) return kNaN;
  std::vector<double> sorted(values.begin(), values.end());
  std::ranges::sort(sorted);
  const double place = std::clamp(share, 0.0, 1.0) * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return std::lerp(sorted[below], sorted[above], place - static_cast<double>(below));
}

Interval bootstrap_interval(std::size_t count,
                            const std::function<double(std::span<const std::size_t>)>& statistic,
                            Random random, int resamples) {
  if (count < 2) return {kNaN, kNaN};
  std::vector<std::size_t> drawn(count);
  std::vector<double> values;
  for (int k = 0; k < resamples; ++k) {
    for (std::size_t& i : drawn)
      i = static_cast<std::size_t>(random.uniform() * static_cast<double>(count));
    // A resample may have drawn nothing that the statistic could be of.
    if (const double value = statistic(drawn); std::isfinite(value)) values.push_back(value);
  }
  return {percentile(values, 0.025), percentile(values, 0.975)};
}

double total_rmse(double pitch_deg, double roll_deg, double yaw_deg) {
  return std::hypot(pitch_deg, roll_deg, yaw_deg);
}

ErrorStatistics error_statistics(std::span<const PoseError> errors, std::size_t failed) {
  ErrorStatistics out{};
  out.pitch = axis_statistics(column(errors, &PoseError::pitch_deg));
  out.roll = axis_statistics(column(errors, &PoseError::roll_deg));
  out.yaw = axis_statistics(column(errors, &PoseError::yaw_deg));
  out.rmse_total_deg = total_rmse(out.pitch.rmse_deg, out.roll.rmse_deg, out.yaw.rmse_deg);
  const std::vector<double> angles = column(errors, &PoseError::geodesic_deg);
  out.geodesic = {max_signed(angles), root_mean_square(angles), mean(angles),
                  percentile(angles, 0.5), percentile(angles, 0.95)};
  out.poses = errors.size() + failed;
  out.failed = failed;
  return out;
}

}  // namespace turntable
