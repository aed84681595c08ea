// A controller that a file describes: its text language (drivers/controller_description.h) under the same
// motion loop, limits and stops as every other controller. Positions are absolute moves; a motion command
// is said once, whatever becomes of its answer.
//
// A controller that says that it does not know where an axis is has been reset: a homing that ends so has
// failed, and a move that goes on so is in trouble. Where no word tells the end of a motion, standing still
// for the stated time does; a homing that was neither acknowledged nor seen to move does not count.
#pragma once

#include <array>
#include <memory>
#include <string_view>

#include "drivers/controller.h"

namespace turntable {

/// @throws ConfigError for a description that is missing or makes no sense, a channel that it has not.
std::unique_ptr<Controller> open_described_text(ControllerSetup setup);

/// What is described cannot be told from others: nobody is asked.
std::string identify_described_text(SharedLine line, Clock& clock);

/// What this driver assumes and nobody has confirmed: `ControllerModel::unconfirmed`. What the description
/// says of itself comes on top.
inline constexpr std::array kUnconfirmedDescribed{
    std::string_view{"The controller hears questions and stops while an axis moves."},
    std::string_view{
        "A command whose sending broke off is ended with \"!\", which the controller is "
        "taken to refuse instead of carrying out what it had heard."}};

}  // namespace turntable
