// The data behind the paper's figures, one CSV each, and pictures drawn from them by gnuplot where
// it is installed.
#pragma once

#include <string>
#include <vector>

#include "src/core/rig_file.h"
#include "src/evaluation/calibrate.h"
#include "src/evaluation/evaluate.h"
#include "src/record/run_folder.h"

namespace turntable {

struct Figure {
  std::string name;  ///< file stem in figures/
  std::string caption;
  bool drawn = false;  ///< figures/<name>.svg exists
};

/// Writes figures/*.csv and *.gp and draws *.svg:
///   figure10_residuals_<z>mm   residual of every circle of a plane (paper, figure 10)
///   figure13_<scenario>        the turntable's motion (figure 13)
///   figure14_<scenario>        errors against the angle, scenarios that turn one axis (figure 14)
///   figure15_<scenario>        error of every pose over pitch, roll and yaw, scenarios that turn
///   several (figures 15, 16)
/// @param spacing_mm of the pattern. @param points the circles the calibration was made from; empty
/// if it came from elsewhere.
/// @throws RecordError.
std::vector<Figure> write_figures(const RunFolder& folder, const RunRecord& record,
                                  const Evaluation& evaluation, const Calibration& calibration,
                                  const std::vector<PlanePoint>& points, double spacing_mm);

}  // namespace turntable
