// How a run went, beside what it measured: where the rig's time went, what made it wait, which images
// were bad, what the channels of telemetry said. From the journal alone. Times by the wall differ from
// run to run, so that nothing of this goes into tables/.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "src/core/rig_file.h"
#include "src/record/run_folder.h"
#include "src/report/drawing.h"

namespace turntable {

/// Sections of report.md, or nothing where the run has nothing to say.
/// "Time": the dead-time table, session by session.
std::string time_text(const RunRecord& record);
/// "Images checked": images taken again, and the complaints that were left.
std::string images_text(const RunRecord& record);
/// "Telemetry": the channels in numbers.
std::string telemetry_text(const RunRecord& record);
/// Table of what made the run wait, for the section "Sessions"; nothing if nothing did.
std::string interruptions_text(const RunRecord& record);

/// Writes <folder>/*.csv for:
///   dead_time    time by phase, scenario by scenario, and what belongs to no pose
///   telemetry    the channels over the rig's time, with suspensions; if there are any readings
/// @param rig the bands that are drawn beside the channels
/// @throws RecordError.
std::vector<Draft> time_drafts(const std::filesystem::path& folder, const RunRecord& record,
                               const RigFile& rig);

}  // namespace turntable
