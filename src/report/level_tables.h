// Three levels of truth, and the rig that the third one rests on, as tables and text.
#pragma once

#include <string>
#include <vector>

#include "src/evaluation/cross_validation.h"
#include "src/record/run_folder.h"
#include "src/report/table.h"

namespace turntable {

/// Writes tables/ levels.{csv,md,tex} (solver x scenario x level, on held-out poses), identified.{csv,md,tex}
/// (every parameter of the rig: drawing, estimate, uncertainty, verdict) and
/// identified_correlation.csv; those that the run is too small for are left out. @throws RecordError.
std::vector<WrittenTable> write_level_tables(const RunFolder& folder, const Plan& plan,
                                             const TruthLevels& levels);

/// The sections "Three levels of truth" and "The rig, identified" of report.md.
/// @param written tables of the run, these among them
std::string levels_text(const std::vector<WrittenTable>& written, const TruthLevels& levels);

/// The table of parameters as Markdown: what `turntable identify` prints.
std::string identified_markdown(const RigModel& model, const SelfCalibration& found);

/// What to make of a rig model that does not explain the run; empty if it does.
std::string misfit_text(const SelfCalibration& found);

}  // namespace turntable
