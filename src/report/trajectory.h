// The way of the turntable: its angles pose by pose and, where several axes turn, their path. Figure
// 13 of the paper, from a run as it went or from a plan before anything moves.
#pragma once

#include <string>
#include <vector>

#include "src/campaign/planning.h"
#include "src/report/drawing.h"

namespace turntable {

/// Part of a picture: offset and size, 0 to 1, origin at the lower left.
struct Panel {
  double x = 0.0, y = 0.0, width = 1.0, height = 1.0;
};

/// gnuplot commands, within a multiplot, for a file whose columns are pose, time, stage_mm, yaw_deg,
/// roll_deg and pitch_deg: angles by pose and beside them, if several of `axes` turn, the path.
/// @param every rows of the file, as gnuplot's `every` takes them (header = row 0)
std::string trajectory_commands(const std::vector<AxisId>& axes, const std::string& every,
                                const Panel& panel);

/// SVG of what a plan asks for: one row per scenario; of an attitude scenario the first repeat, of a
/// calibration the stage and the tilted views.
/// @param times as `pose_times` gives them
/// @throws ConfigError without gnuplot.
std::string plan_picture(const Plan& plan, const std::vector<PhaseTimes>& times);

}  // namespace turntable
