// Every table of a run: Tables 1 and 3-5 in the form of the paper, published values beside ours, and
// what goes beyond them. Written by the report, and made again by verify.
#pragma once

#include <vector>

#include "src/report/results.h"
#include "src/report/table.h"

namespace turntable {

/// Writes tables/<name>.{csv,md,tex}: table1 from the calibration; tables 3-5 as far as the run has
/// scenarios for them, and one more per scenario that belongs to none (repeats of several scenarios in
/// one table are numbered on); camera_solver, what the camera model gains and what the solver gains,
/// if there is a pose to tell by; statistics, repeatability, paired (at every level of truth that the
/// run has) and iso230; those of `level_tables`, `budget_tables` and `noise_report`. Removes those from
/// camera_solver on that an earlier evaluation had and this one does not. @throws RecordError.
std::vector<WrittenTable> write_tables(const RunFolder& folder, const Results& results);

}  // namespace turntable
