// What a result owes its being to: program, machine, files, devices.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "src/record/plan.h"

namespace turntable {

/// Program, version, commit, compiler, libraries, host.
nlohmann::json program_provenance();

/// What of two programs differs: "version: 0.1.0, now 0.2.0". Keys that one of them lacks do not
/// count.
std::vector<std::string> program_changes(const nlohmann::json& then);

/// Of a run, for its start document: the program, the command and the folder it was given in, hashes of every file the plan was made
/// from, the calibration if it came from elsewhere, and limits, speeds and camera settings as they
/// are used, defaults filled in. Keys have neither "." nor "/" (event model).
/// @param calibration calibration.json of the run if it does not follow from the run itself; else
/// empty
nlohmann::json run_provenance(const RigFile& rig, const Plan& plan, const std::string& command,
                              const std::filesystem::path& calibration);

}  // namespace turntable
