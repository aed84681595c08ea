// Zolix ZC300, written from the manual's facts (protocols/README.md) and never from the driver.
//
// Three channels X, Y, Z, of which those without a stage are there in the registers alone. Answers take 57 to
// 73 ms. Homing does not touch the counter; reserved registers read 0 and refuse writes. What the facts leave
// open is decided here and assumed: model text padded with zeros; enabled at power-up, outputs off; settings
// of an axis that moves are refused with 06; a motion of an axis whose driver gave up, or that has no stage,
// with 09; homing is allowed on a limit switch; one in twenty ends of a motion loses the next request,
// however late it comes; the lead makes nothing of the scale of a rotary stage.
#pragma once

#include <memory>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

/// @throws ConfigError for a channel that the controller does not have.
std::unique_ptr<ControllerSimulator> simulate_zc300(const SimulatorSetup& setup);

}  // namespace turntable::sim
