// Time and way of a move, from a rig file alone: plans are made without devices.
//   distance d, start speed v0, speed v, acceleration a; both ramps together take r = (v^2 - v0^2)/a
//   d >= r:  t = 2 (v - v0)/a + (d - r)/v
//   d <  r:  peak^2 = v0^2 + a d,  t = 2 (peak - v0)/a
// Used by the motion loop for its deadlines and by the plan for its estimate.
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
