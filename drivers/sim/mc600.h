// Zolix MC600, written from the manual's facts (protocols/README.md) and never from the driver.
#pragma once

#include <memory>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

std::unique_ptr<ControllerSimulator> simulate_mc600(const SimulatorSetup& setup);

}  // namespace turntable::sim
