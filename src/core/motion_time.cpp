#include "src/core/motion_time.h"

#include <algorithm>
#include <cmath>

namespace turntable {

double trapezoid_seconds(const AxisConfig& axis, double distance) {
  const double d = std::abs(distance);
  if (d == 0.0) return 0.0;
  const double v0 = std::min(axis.initial_speed, axis.speed);
  const double v = axis.speed;
  const double a = axis.acceleration;
  const double ramps = (v * v - v0 * v0) / a;
  if (d >= ramps) return 2.0 * (v - v0) / a + (d - ramps) / v;
  return 2.0 * (std::sqrt(v0 * v0 + a * d) - v0) / a;
}

bool takes_overshoot(const AxisConfig& axis, double from, double to) {
  const double d = to - from;
  return axis.backlash != 0.0 && d != 0.0 &&
         (std::abs(d) > std::abs(axis.backlash) || d * axis.backlash < 0.0);
}

double move_seconds(const AxisConfig& axis, double from, double to) {
  if (!takes_overshoot(axis, from, to)) return trapezoid_seconds(axis, to - from);
  return trapezoid_seconds(axis, to - axis.backlash - from) +
         trapezoid_seconds(axis, axis.backlash);
}

}  // namespace turntable
