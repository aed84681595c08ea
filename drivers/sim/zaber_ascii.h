// Zaber motion controllers in their ASCII protocol, for a rig file's model "described": written from other
// people's programs and not from the description (drivers/described/zaber_ascii.json), so that the two can
// be wrong in different ways. Sources: the maker's MATLAB toolbox with its tests (message numbers, check
// sums, refusals), freudenthal/ArduinoZaberMaster (flags and reasons of refusal).
//
//   "/1 2 07 move abs 10000:C5"  address, axis, message number and check sum, the last two if wanted
//   "@01 2 07 OK BUSY -- 0"      taken or not (OK, RJ), moving or not, warning flag, data or reason
//
// Positions are microsteps. A command whose check sum is wrong is not answered. Settings stay when the
// power goes. Guesses: it starts from standing still; a new move takes the place of the one under way;
// a homing approaches the switch for the last time at a tenth of limit.approach.maxspeed.
#pragma once

#include <memory>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

std::unique_ptr<ControllerSimulator> simulate_zaber_ascii(const SimulatorSetup& setup);

}  // namespace turntable::sim
