// From a rig file to a rig: the one place that knows real and simulated devices alike.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "src/core/rig.h"

namespace turntable {

struct OpenRigOptions {
  bool configure = false;          ///< write the rig file's set-up into the controllers before use
  bool assume_mounted = false;     ///< do not ask for a person when the payload changes
  std::filesystem::path wire_log;  ///< every byte on every line, with time; empty = none
  double speed = 1.0;              ///< of the clock, for devices served by `simulate --speed`
  bool connect = true;             ///< false: nobody is asked anything, only a stop is possible
};

/// Reads a rig file, and adds what its controllers' models say about its axes. Opens nothing.
/// @throws ConfigError as `load_rig_file`, and for controllers that cannot be as the file says.
RigFile load_rig(const std::filesystem::path& file);
/// The second part of it, for a rig that was read from a run.
void know_rig(RigFile& rig);

/// Puts controllers on other lines: "mc1=/dev/ttyUSB1", "mc1=10.0.0.7:4001". A line is no part of what is
/// measured; who shares it moves along. @return the same, for each controller that moved. @throws ConfigError for what cannot be.
std::vector<std::string> put_lines(RigFile& rig, const std::vector<std::string>& lines);

/// Opens lines, controllers and camera, and verifies the controllers' set-up against the rig file.
/// Moves nothing. On simulated lines the rig runs on a ManualClock: hours pass in seconds, the same
/// way every time.
/// @throws ConfigError (unknown model, simulated and real controllers mixed), LineError,
/// TimeoutError, DeviceError (set-up differs, every difference named).
Rig open_rig(const RigFile& file, const OpenRigOptions& options = {});

/// The same without a camera. @param differences if given, a set-up that differs is told there
/// instead of thrown; motion is blocked then.
Rig open_axes(const RigFile& file, const OpenRigOptions& options = {},
              std::vector<std::string>* differences = nullptr);

/// The camera alone, on its clock: no line is opened and no axis touched, none is in the rig. A
/// simulated one looks at the LED target with all axes at zero.
/// @throws ConfigError: unknown model, a camera that only an output of a controller fires; and what
/// the camera's driver throws.
Rig open_camera_alone(const RigFile& file);

struct ServeOptions {
  std::filesystem::path links;   ///< folder for links to the ptys, named after the controllers
  std::filesystem::path faults;  ///< what is to go wrong (drivers/sim/fault_file.h)
  double speed = 1.0;
};

/// `turntable simulate`: the rig's devices in real time, controllers on ptys (and TCP ports where
/// the rig file names one), until interrupted.
void simulate_rig(const RigFile& file, const ServeOptions& options);

}  // namespace turntable
