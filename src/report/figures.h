// Figures 12 to 16 of the paper, from a run.
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include "src/evaluation/evaluate.h"
#include "src/record/run_folder.h"
#include "src/report/drawing.h"

namespace turntable {

/// The scenario of figures that show one only: that of table 5, else the first that turns most axes.
/// Nothing without an attitude scenario.
std::optional<std::size_t> widest_scenario(const Plan& plan);

/// Where a scale ends that all solvers share: at the largest of their values, but at three times their
/// median at most, so that a solver that misses by far does not flatten all the others.
/// @param of_solvers one value each, not negative; @return 0 of none.
double common_limit(const std::vector<double>& of_solvers);
/// For a caption, if a value lies beyond such a scale.
inline constexpr const char* kBeyondScale = " What lies beyond the scale is drawn at its end.";

/// Figure 12: spots in the images, with crosses and serial numbers, of the first and the outermost
/// poses of `widest_scenario`. Writes figure12_<scenario>.csv and figure12_<scenario>_<panel>.png into
/// the folder of figures. Nothing if no image of such a pose is there. @throws RecordError.
std::optional<Draft> spots_draft(const RunFolder& folder, const RunRecord& record,
                                 const Evaluation& evaluation);

/// Writes <folder>/*.csv for:
///   figure13_<scenario>        the turntable's motion (figure 13)
///   figure14_<scenario>        errors against the angle, scenarios that turn one axis (figure 14)
///   figure15_<scenario>        error of every pose over the angles, scenarios that turn several
///                              (figures 15, 16)
///   figure16_<scenario>        mean error over the plane of two angles, scenarios that turn three
/// @throws RecordError.
std::vector<Draft> attitude_drafts(const std::filesystem::path& folder, const RunRecord& record,
                                   const Evaluation& evaluation);

}  // namespace turntable
