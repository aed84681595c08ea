// From a rig file to a rig: the one place that knows real and simulated devices alike.
#pragma once

#include <filesystem>

#include "src/core/rig.h"

namespace turntable {

struct OpenRigOptions {
  bool configure = false;          ///< write the rig file's set-up into the controllers before use
  bool assume_mounted = false;     ///< do not ask for a person when the payload changes
  std::filesystem::path wire_log;  ///< every byte on every line, with time; empty = none
};

/// Opens lines, controllers and camera, and verifies the controllers' set-up against the rig file.
/// Moves nothing. On simulated lines the rig runs on a ManualClock: hours pass in seconds, the same
/// way every time.
/// @throws ConfigError (unknown model, simulated and real controllers mixed), LineError,
/// TimeoutError, DeviceError (set-up differs, every difference named).
Rig open_rig(const RigFile& file, const OpenRigOptions& options = {});

/// `turntable simulate`: the rig's controllers in real time on ptys (and TCP ports where the rig
/// file names one) until interrupted. @param links folder for symbolic links named after the
/// controllers; empty = none.
void simulate_rig(const RigFile& file, const std::filesystem::path& links);

}  // namespace turntable
