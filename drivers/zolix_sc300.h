// Zolix SC300: two-letter commands ended by CR and never by LF, three channels X Y Z on one line
// (RS-232, 19200 8N1), everything in whole pulses.
//
//   "+Y,800" "-Y,800"   relative moves, the only ones there are: absolute ones are made from the
//                       counter, which is read twice before each, for there is no checksum
//   "HY"                home; the counter is 0 afterwards
//   "SPY"               stop
//   "?Y"                the counter: "?Y,-123"
//
// A move or a homing is not acknowledged: its only answer is "?Y,<counter>", when it has ended. That
// looks like the answer to a question for the counter. They are told apart by counting: each question
// is owed one line, in order, and a line that is owed to none reports the end of a motion. It is
// believed if the counter, asked again, stands there. A question that got no answer is owed one for
// two more reply timeouts, or until something said after it was answered. Until it is clear again, a
// homing counts only if the counter was seen to move. A move whose report is lost is ended by standing
// at its goal, a homing never: better homed twice than not.
//
// Whether the controller answers questions while a motor turns is not known; the rig file says
// (`answers_while_moving`). If not, one axis moves at a time, nothing is asked until the deferred
// line has come or should have, and an axis that rests beside a moving one is where it was.
//
// There is no register for home speed, units, limits: the soft limits are those of this program
// alone. The controller counts pulses (open loop): its position says what was sent to the motor, not
// where the table is. Sources and guesses: protocols/README.md.
#pragma once

#include <array>
#include <memory>
#include <string_view>

#include "drivers/controller.h"

namespace turntable {

std::unique_ptr<Controller> open_zolix_sc300(ControllerSetup setup);

/// Asks who is there, by queries alone. @return what to call it; empty if it is no SC300.
std::string identify_zolix_sc300(SharedLine line, Clock& clock);

/// What this driver assumes and nobody has confirmed: `ControllerModel::unconfirmed`.
inline constexpr std::array kUnconfirmedSc300{
    std::string_view{"E0, E1 and ER are taken as refusals; their meaning is in no source at hand."},
    std::string_view{"Whether anything but a stop is heard while an axis moves is what the rig "
                     "file says (answers_while_moving)."},
    std::string_view{"Homing leaves the counter at 0."},
    std::string_view{"A stop is answered by something; any answer is taken."},
    std::string_view{
        "What a limit switch does to a move is unknown: it is seen as a halt short of the goal."}};

}  // namespace turntable
