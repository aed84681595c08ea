// Stages by name: defaults for axes of a rig file. A new stage on a known controller is one row
// here.
#pragma once

#include <span>
#include <string_view>

namespace turntable {

enum class StageKind { kLinear, kRotary };

/// Units: mm for linear stages, deg for rotary ones. Every value can be overridden by the rig file.
struct StageSpec {
  std::string_view model;
  StageKind kind;
  double steps_per_rev;  ///< pulses per motor revolution (with microstepping)
  double drive_ratio;    ///< motor revolutions per table revolution (rotary); 1 for linear
  double lead_mm;        ///< travel per motor revolution (linear); 0 for rotary
  double travel_lower, travel_upper;
  double initial_speed, speed, acceleration, home_speed;  ///< unit/s, unit/s^2
  double repeatability;  ///< unit, as the data sheet states it: two standard deviations
  double
      backlash;  ///< unit; overshoot of the one-sided approach, sign = final direction of approach
  bool endless;  ///< turns on and on: travel is one turn of it, and only a cable ends it
  std::string_view source;  ///< where the numbers come from

  /// Engineering units per pulse.
  double per_step() const {
    return kind == StageKind::kRotary ? 360.0 / (drive_ratio * steps_per_rev)
                                      : lead_mm / steps_per_rev;
  }
};

std::span<const StageSpec> stage_specs();
/// @return nullptr if there is no such row.
const StageSpec* find_stage_spec(std::string_view model);

}  // namespace turntable
