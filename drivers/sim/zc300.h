// Zolix ZC300, written from the manual's facts (protocols/README.md) and never from the driver.
//
// Three channels X, Y, Z, of which those without a stage are there in the registers alone. What the
// facts leave open is decided here and assumed: model text padded with zeros; enabled at power-up;
// settings of an axis that moves are refused with 06; a motion of an axis whose driver gave up, or
// that has no stage, with 09; homing is allowed on a limit switch; the request that gets lost after
// the end of a motion is the next one, however late it comes.
#pragma once

#include <memory>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

/// @throws ConfigError for a channel that the controller does not have.
std::unique_ptr<ControllerSimulator> simulate_zc300(const SimulatorSetup& setup);

}  // namespace turntable::sim
