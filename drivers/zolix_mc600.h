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
    std::string_view{"E01 and E02 are taken as refusals; their meaning is in no source at hand."},
    std::string_view{
        "Queries are answered while axes move, and a stop is answered by its own line."},
    std::string_view{"Homing leaves the position at 0."}};

}  // namespace turntable
