// Figures 13 to 16 of the paper, from a run.
#pragma once

#include <filesystem>
#include <vector>

#include "src/evaluation/evaluate.h"
#include "src/record/run_folder.h"
#include "src/report/drawing.h"

namespace turntable {

/// Writes <folder>/*.csv for:
///   figure13_<scenario>        the turntable's motion (figure 13)
///   figure14_<scenario>        errors against the angle, scenarios that turn one axis (figure 14)
///   figure15_<scenario>        error of every pose over pitch, roll and yaw, scenarios that turn
///   several (figures 15, 16)
/// @throws RecordError.
std::vector<Draft> attitude_drafts(const std::filesystem::path& folder, const RunRecord& record,
                                   const Evaluation& evaluation);

}  // namespace turntable
