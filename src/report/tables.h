// Tables 1 and 3-5 in the form of the paper, published values beside ours, as CSV and Markdown.
#pragma once

#include <string>
#include <vector>

#include "src/evaluation/camera_comparison.h"
#include "src/evaluation/cross_validation.h"
#include "src/evaluation/evaluate.h"
#include "src/imaging/calibration.h"
#include "src/record/run_folder.h"
#include "src/report/table.h"

namespace turntable {

/// Writes tables/<name>.{csv,md,tex}: table1 from the calibration; tables 3-5 as far as the run has
/// scenarios for them, and one more per scenario that belongs to none (repeats of several scenarios in
/// one table are numbered on); camera_solver, what the camera model gains and what the solver gains,
/// if there is a pose to tell by; statistics, repeatability, paired (at every level of truth that the
/// run has) and iso230. @param cameras this run's comparison first, then those of runs that are set
/// beside it. @throws RecordError.
std::vector<WrittenTable> write_tables(const RunFolder& folder, const Plan& plan,
                                       const Evaluation& evaluation, const Calibration& calibration,
                                       const std::vector<CameraComparison>& cameras,
                                       const TruthLevels& levels);

}  // namespace turntable
