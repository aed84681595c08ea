// Leadshine RS-485 steppers (DM2C, EM2RS, CS2RS, iEM-RS and their like) in PR mode: Modbus RTU,
// usually 38400 8N1, or the same behind a Modbus TCP gateway. One drive per axis; the "controller"
// of a rig file is the bus, and an axis' channel the address of its drive, "1" to "31".
//
//   move   block 0x6200..0x6207 (path 0): absolute, position, rpm, ramps; read back; 0x6002 <- 0x10
//   home   0x6002 <- 0x20     stop   0x6002 <- 0x40, with the deceleration of 0x6017
//   state  0x1003 (fault, enabled, running, done bits), then the position 0x602A/2B in pulses
//
// The drive knows whole rpm and whole ms per 1000 rpm only: a speed or an acceleration that this
// would change by more than 2 % is refused. A limit switch is seen as a halt short of the goal, with
// a warning in 0x601D where the drive has that register. Its set-up may be gone after a power cycle,
// so it is compared again before each homing. Sources: protocols/README.md.
#pragma once

#include <array>
#include <memory>
#include <string_view>

#include "drivers/controller.h"

namespace turntable {

std::unique_ptr<Controller> open_leadshine_pr(ControllerSetup setup);

/// Asks slaves 1 to 8 who is there, by queries alone. @return what to call them; empty if none of
/// them answers as such a drive does.
std::string identify_leadshine_pr(SharedLine line, Clock& clock);

/// What this driver assumes and nobody has confirmed: `ControllerModel::unconfirmed`.
inline constexpr std::array kUnconfirmedLeadshine{
    std::string_view{"The home-done bit of 0x1003 is set at the stop position and not at the "
                     "switch already (the driver waits half a second for the way back), stays set "
                     "while a path runs, and nothing but a power cycle or a homing clears it."},
    std::string_view{
        "The milliseconds of 0x6017 are what a stop takes from whatever speed, and not "
        "from the highest: watch the first stop."},
    std::string_view{"Bit n - 1 of 0x0179 is input n; whether an input that is normally closed is "
                     "turned round there is unknown. It is used in messages only."},
    std::string_view{"A halt short of the goal is a limit switch if 0x601D says 0x020P; without "
                     "that register it is only a halt."},
    std::string_view{"A stop during homing halts the motor and leaves home-done clear."},
    std::string_view{
        "What happens to a trigger in alarm, when disabled, or beyond a soft limit is unknown."}};

}  // namespace turntable
