// Zolix ZC300: Modbus RTU (RS-232, USB or RS-485, 115200 8N1) or Modbus TCP through a gateway; three
// channels X Y Z of one slave. Facts with their sources: protocols/README.md.
//
//   status    one read of 30012..30021: moving flags, switch and alarm bits, positions of all axes. It
//             is a pulse counter (open loop): it says what was sent to the motor, not where the table is.
//   home      the opcode [69h, axis], in two registers and without a direction. It leaves the counter as it
//             is: where the homing can have succeeded, 0.0 is written into 30059.. and read back.
//   move      |target| into 30114.., read back until it is right, then the opcode [64h, axis, P or N]
//             exactly once, in a write of exactly three registers. The controller cuts targets off at
//             0.001 and then rounds to pulses: finer pulses than that are not all within reach.
//   settings  read in two blocks and compared on connection; what differs is written by `configure` into
//             volatile memory, never saved to flash: a power cycle brings back what was in flash. Of a
//             rotary axis the drive ratio makes the scale, and the lead is 360.
//
// An answer takes 60 ms, so exchanges are few: three on connection, three for a move, and a status read of
// one axis serves the others. Two more of its habits shape the driver:
//
// - It sometimes misses the request right after one of its motions has ended. Everything but a motion
//   command is said again. A motion command is held back while another axis is about to end its own motion
//   (predicted from distance and speeds), until a status read shows that it has. While another axis homes,
//   whose end cannot be predicted, none is given at all.
// - Its counter is 0 after power-up, which may be where an axis was. So a homing leaves a mark: an
//   acceleration that is a few hundredths of a percent lower. It is read before each move, and when an axis
//   that homes or is homed is seen to stand at 0: another one means that the power was off, and the
//   reference is lost. Before it is homed again, the settings are compared again. What that cannot notice is
//   in protocols/README.md. A home command whose acknowledgement is lost counts only if the axis is then seen
//   to move.
#pragma once

#include <array>
#include <memory>
#include <string_view>

#include "drivers/controller.h"

namespace turntable {

/// @throws ConfigError for a channel that the controller does not have.
std::unique_ptr<Controller> open_zolix_zc300(ControllerSetup setup);

/// Asks slave 1 who is there, by queries alone. @return what to call it; empty if it is no ZC300.
std::string identify_zolix_zc300(SharedLine line, Clock& clock);

/// What this driver assumes and nobody has confirmed: `ControllerModel::unconfirmed`.
inline constexpr std::array kUnconfirmedZc300{
    std::string_view{
        "An axis is taken as homed when its moving flag falls after the homing, no limit switch is "
        "on and the controller was not switched off meanwhile; its home switch bit counts only "
        "where it has shown both levels, as it floats high where nothing is wired."},
    std::string_view{
        "Of a rotary axis the drive ratio (30090) makes the scale, 360 / (pulses per revolution x "
        "ratio) degrees per pulse; whether the controller uses the lead (30084) as well is "
        "unknown, so both are set. Check the angle of the first move."},
    std::string_view{
        "An absolute move (64h) takes its magnitude from the distance register (30114) and its "
        "sign from the direction letter; the vendor's library does so, but one laboratory saw no "
        "motion after 64h (it had written the target elsewhere)."},
    std::string_view{"The distance of a move to 0 is sent as 0.00001, which the manual's range "
                     "(more than 0 pulses) may refuse."},
    std::string_view{"An acceleration that is 0.02 to 0.06 % lower, which a power cycle takes "
                     "back, is how the program notices that the controller was switched off; "
                     "nobody has tried it, and a saving to flash by another program hides it."},
    std::string_view{
        "A limit switch bit that is on ends a move in that direction and not in the other one."}};

}  // namespace turntable
