// Axes as a rig file would describe them.
#pragma once

#include <string>

#include "src/core/rig_file.h"

namespace turntable {

constexpr int kForEver = -1;  ///< times of a fault

/// 0.00125 deg per pulse, [-30, 30] deg, 25 deg/s, overshoot 0.5 deg.
inline AxisConfig rotary_axis(AxisId id, const std::string& channel) {
  AxisConfig axis;
  axis.id = id;
  axis.controller = "mc600";
  axis.channel = channel;
  axis.stage_model = "zolix-rak200";
  axis.kind = StageKind::kRotary;
  axis.steps_per_rev = 1600;
  axis.drive_ratio = 180;
  axis.lower = -30;
  axis.upper = 30;
  axis.initial_speed = 1;
  axis.speed = 25;
  axis.acceleration = 50;
  axis.home_speed = 5;
  axis.repeatability = 0.005;
  axis.backlash = 0.5;
  axis.tolerance = 0.001875;
  axis.settle_s = 0.1;
  axis.retries = 2;
  return axis;
}

/// 2.5 um per pulse, [0, 200] mm, 20 mm/s, overshoot 0.05 mm.
inline AxisConfig linear_axis(const std::string& channel) {
  AxisConfig axis = rotary_axis(AxisId::kStage, channel);
  axis.stage_model = "zolix-tsa200";
  axis.kind = StageKind::kLinear;
  axis.drive_ratio = 1;
  axis.lead_mm = 4;
  axis.lower = -1;
  axis.upper = 201;
  axis.speed = 20;
  axis.repeatability = 0.003;
  axis.backlash = 0.05;
  axis.tolerance = 0.00375;
  return axis;
}

inline std::vector<AxisConfig> four_axes() {
  return {linear_axis("X"), rotary_axis(AxisId::kYaw, "Y"), rotary_axis(AxisId::kRoll, "Z"),
          rotary_axis(AxisId::kPitch, "T")};
}

}  // namespace turntable
