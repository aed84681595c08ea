// A taken pose as the data of a journal event, and back. Flat keys with units, so that a table of
// all events is a table of all poses.
#pragma once

#include <string_view>

#include "src/record/run_folder.h"

namespace turntable {

Json pose_data(const TakenPose& taken, std::string_view scenario_name);
/// The event model's description of every key of `pose_data`.
Json pose_data_keys(const TakenPose& example);
/// All but `planned`. @throws nlohmann::json::exception if keys are missing or of the wrong type.
TakenPose pose_from_data(const Json& data);

}  // namespace turntable
