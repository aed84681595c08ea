// Zolix MC600: ASCII verbs ended by CR, four channels X Y Z T on one line (RS-232, 19200 8N1).
//
// A move is answered twice: READY at once, and "X 12.345,OK" by itself when it has ended. That
// second line may come between any command and its answer. The controller counts pulses (open
// loop): its position says what was sent to the motor, not where the table is. Sources:
// protocols/README.md.
#pragma once

#include <array>
#include <memory>
#include <string_view>

#include "drivers/controller.h"

namespace turntable {

std::unique_ptr<Controller> open_zolix_mc600(ControllerSetup setup);

/// Asks who is there, by queries alone. @return what to call it; empty if it is no MC600.
std::string identify_zolix_mc600(SharedLine line, Clock& clock);

/// What this driver assumes and nobody has confirmed: `ControllerModel::unconfirmed`.
inline constexpr std::array kUnconfirmedMc600{
    std::string_view{
        "E and two digits, and ERR, are taken as refusals; their meaning is in no source at hand."},
    std::string_view{
        "Positions are told while axes move, or refused until they have come to rest."},
    std::string_view{"A stop is answered OK, and the stopped move by its own line; the driver goes "
                     "by the position."},
    std::string_view{"Homing leaves the position at 0, and SetOffset is a way back after it whose "
                     "end counts as 0: look at the table when it has homed."},
    std::string_view{"A negative place is sent as N and its magnitude; one other program sends P "
                     "and the negative number."},
    std::string_view{"What a limit switch or an emergency stop does to a move is unknown: it is "
                     "seen as a halt short of the goal."}};

}  // namespace turntable
