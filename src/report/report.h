// report.md and report.html: what was measured, how good the camera was, the tables, the figures,
// and what they do not say.
#pragma once

#include <filesystem>
#include <optional>

#include "src/evaluation/calibration_set.h"
#include "src/evaluation/camera_comparison.h"
#include "src/evaluation/cross_validation.h"
#include "src/evaluation/error_budget.h"
#include "src/evaluation/evaluate.h"
#include "src/evaluation/noise_campaign.h"

namespace turntable {

/// Writes tables/, figures/, report.md and report.html of a run. @param set what the calibration was made from;
/// nothing if it came from elsewhere. @param cameras this run's comparison first, then those of runs
/// that are set beside it. @param noise of the run's images with noise, if that was done
/// @return report.html's path. @throws
/// RecordError.
std::filesystem::path write_report(const RunFolder& folder, const RunRecord& record,
                                   const RigFile& rig, const Calibration& calibration,
                                   const std::optional<CalibrationSet>& set,
                                   const Evaluation& evaluation,
                                   const std::vector<CameraComparison>& cameras,
                                   const TruthLevels& levels,
                                   const std::vector<ErrorBudget>& budgets,
                                   const std::optional<NoiseCampaign>& noise);

}  // namespace turntable
