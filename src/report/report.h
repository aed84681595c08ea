// report.md: what was measured, how good the camera was, the tables, the figures, and what they do
// not say.
#pragma once

#include <filesystem>

#include "src/evaluation/calibrate.h"
#include "src/evaluation/evaluate.h"

namespace turntable {

/// Writes tables/, figures/ and report.md of a run. @return the report's path. @throws RecordError.
std::filesystem::path write_report(const RunFolder& folder, const RunRecord& record,
                                   const RigFile& rig, const CalibrationResult& calibration,
                                   const Evaluation& evaluation);

}  // namespace turntable
