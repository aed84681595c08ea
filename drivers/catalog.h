// Controllers and cameras by model name. A new one is a file pair beside this and one row here; a
// controller's simulator is the same in drivers/sim, and a test asserts that the two tables agree.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/camera.h"
#include "drivers/controller.h"

namespace turntable {

struct ControllerModel {
  std::string_view model;
  int default_baud;
  double reply_timeout_s;  ///< that the rig file need not state
  bool modbus;             ///< so that it can stand behind a Modbus gateway
  /// In the axis' unit: the least step that a motion can be told, and that a position is told in; 0 = the
  /// controller speaks in pulses. Sources: protocols/README.md.
  double sent_step, told_step;
  std::string_view own_key;  ///< of the optional keys of the rig file, the one that it looks at
  std::unique_ptr<Controller> (*open)(ControllerSetup);  ///< talks to nobody yet
  /// Asks who is there, by queries alone; empty if it is another model, or nobody.
  std::string (*identify)(SharedLine, Clock&);
  /// What the program assumes of the model and no manual, other program on a real device or recording
  /// confirms, one plain sentence each: a person looks at it in the first steps on a new rig. Kept in
  /// agreement with protocols/README.md.
  std::span<const std::string_view> unconfirmed{};
};

std::span<const ControllerModel> controller_models();

/// The model's, and what its description says of itself. @throws ConfigError for an unknown model, or
/// description.
std::vector<std::string> unconfirmed_of(const ControllerConfig& controller);

/// @throws ConfigError for an unknown model.
bool speaks_modbus(const ControllerConfig& controller);

/// @throws ConfigError for an unknown model, a Modbus gateway before a controller that does not
/// speak Modbus, or a key that the model does not use.
void check_controller(const ControllerConfig& controller);

/// Looks at all controllers of a rig together. Those that name the same line share it, if they speak
/// Modbus, state the same line set-up and have different slaves.
/// @throws ConfigError as `check_controller`, and for controllers that cannot share their line.
void check_controllers(const RigFile& rig);

/// Fills in what the models of the controllers say about the rig's axes: steps that can be sent and
/// told, and with them windows that the rig file does not state.
/// @throws ConfigError as `check_controllers`, and for a window that is finer than its controller.
void know_controllers(RigFile& rig);

/// @throws ConfigError for an unknown model or channel.
std::unique_ptr<Controller> open_controller(ControllerSetup setup);

/// Opens a controller's serial or TCP line (a simulated one has two ends: `line_pair`), so that it can
/// be opened again. @param log sees every byte. @throws LineError, TimeoutError.
SharedLine open_line(const ControllerConfig& controller, const WireLog& log = {});

/// Asks, model by model and by queries alone, who is at a line that nobody else has.
/// @param open opens it as the model needs it. @return what answered, or why nobody did.
std::string identify(Clock& clock, const std::function<Line(const ControllerModel&)>& open);

struct CameraModel {
  std::string_view model;
  std::unique_ptr<Camera> (*open)(CameraSetup);
  std::vector<std::string> (*find)();  ///< those that are there, one line each; nullptr = unknown
};

std::span<const CameraModel> camera_models();

/// @throws ConfigError for an unknown model, DeviceError if the camera is not there or cannot be
/// set up as the rig file says.
std::unique_ptr<Camera> open_camera(CameraSetup setup);

}  // namespace turntable
