// Leadshine RS-485 steppers on one bus, each a slave with an axis, written from the facts
// (protocols/README.md) and never from the driver.
//
// What the facts leave open, and what this simulator does:
//   - a trigger while the drive is disabled or in alarm is confirmed, and nothing moves
//   - so is one whose target lies beyond the soft limits; velocity mode and jog halt at them
//   - a trigger in mid-move takes over at once, from rest
//   - a limit switch halts the axis on the spot, with the done bits clear; see `LeadshineGuesses`
//   - an emergency stop is an input of every drive: alarm 0x1000 while it is pressed
//   - `home done` is lost by a power cycle and by the begin of homing, and by nothing else; with
//     bit 1 of 0x600A it is not set before the stop position is reached
//   - after the origin was seen, the drive decelerates with 0x6012 from the slow speed, one pulse at
//     least; with bit 0 of 0x600A the slow approach is a backward one
//   - one ramp for both ends of a move, the longer; a stop takes 0x6017 ms from whatever speed, and
//     with 0 halts on the spot
//   - functions of inputs count after a power cycle, if they were saved; bit n - 1 of 0x0179 is the
//     switch at input n, whether it is set up as normally closed or not
//   - 0x601D: 0x0100 homing met a limit switch, 0x020P path P did; cleared by the next motion
//   - baud rate and slave address count after a power cycle, if they were saved
// An overflow of the 32 bit position is not simulated: such a path does not move.
#pragma once

#include <cstdint>
#include <memory>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

struct LeadshineGuesses {
  std::uint16_t limit_alarm = 0;  ///< raised by a limit switch, until it is cleared; 0 = none
};

/// @throws ConfigError for a channel that is no slave address.
std::unique_ptr<ControllerSimulator> simulate_leadshine(const SimulatorSetup& setup,
                                                        LeadshineGuesses guesses = {});

}  // namespace turntable::sim
