// Time and way of a move, from a rig file alone: plans are made without devices.
//   distance d, start speed v0, speed v, acceleration a; ramps take (v - v0)/a and (v^2 -
//   v0^2)/(2a) each d >= both ramps: t = 2 (v - v0)/a + (d - (v^2 - v0^2)/a)/v       else: peak^2 =
//   v0^2 + a d, t = 2 (peak - v0)/a
#pragma once

#include "src/core/rig_file.h"

namespace turntable {

/// One leg, s. `distance` in the axis' unit, any sign.
double trapezoid_seconds(const AxisConfig& axis, double distance);

/// One-sided approach: a move longer than |backlash| or against its sign goes to `to` - backlash
/// first.
bool takes_overshoot(const AxisConfig& axis, double from, double to);

/// All legs of a move, without settling, s. Zero if there is nothing to do.
double move_seconds(const AxisConfig& axis, double from, double to);

}  // namespace turntable
