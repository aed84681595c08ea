// What a run was taken with, so that somebody else can judge it or take it again. From the journal's start
// documents.
#pragma once

#include <string>

#include "src/report/results.h"

namespace turntable {

/// The section "Provenance" of report.md: plan, program, libraries, devices; every axis and the camera as they were
/// set; every file that the plan was made of, with its hash; further sessions; what is odd about the clock.
std::string provenance_text(const Results& results);

/// That the results rest on another calibration than the run began with or gives itself; empty if they do not.
std::string other_calibration_text(const Results& results);

}  // namespace turntable
