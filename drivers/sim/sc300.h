// Zolix SC300, written from the manual's facts (protocols/README.md) and never from the driver.
// What the facts leave open is a guess and called one in sc300.cpp.
#pragma once

#include <memory>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

std::unique_ptr<ControllerSimulator> simulate_sc300(const SimulatorSetup& setup);

}  // namespace turntable::sim
