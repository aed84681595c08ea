// Faults as values, given to a simulator.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace turntable::sim {

enum class FaultKind {
  kSilence,         ///< the command is neither carried out nor answered
  kLostReply,       ///< carried out, the answer is lost
  kGarbage,         ///< noise, then the answer
  kCorruptReply,    ///< the answer with some bytes changed
  kTruncatedReply,  ///< the answer breaks off
  kSplitReply,      ///< the answer comes in two parts, `delay_s` apart
  kLateReply,       ///< the answer comes `delay_s` late
  kDuplicatedLine,  ///< the answer comes twice
  kLostCompletion,  ///< the next completion line is lost
  kErrorReply,      ///< the command is refused with `text`: "E02", or a Modbus exception's number
  kReset,           ///< power cycle `delay_s` after the command
  kStuckAxis,       ///< pulses stop `delay_s` after the command, on the axis the command names
  kBlockedTable,    ///< the same, but the controller counts on: only a camera can see it
  kUnplugged,       ///< the line closes `delay_s` after the command
  kLimitHit,        ///< a limit switch comes on `delay_s` after the command and halts the axis
  kAlarm,           ///< the driver of the axis gives up `delay_s` after the command
  kEmergencyStop,   ///< the button is pressed `delay_s` after the command: everything halts
  kFlood,  ///< from `delay_s` after the command on, noise comes without pause; requests are heard
};

/// "silence", "lost_reply", ...: the names that fault files use.
std::string_view fault_name(FaultKind kind);
/// @return nothing if there is no such fault.
std::optional<FaultKind> fault_from_name(std::string_view name);
std::span<const FaultKind> all_faults();

struct Fault {
  FaultKind kind{};
  /// Which commands: the device's own word ("GoPosition", any case), or what it comes to on every
  /// device ("move", "home", "stop", "status", "set", "get"); empty = every command.
  std::string verb{};
  int nth = 1;    ///< from the n-th such command on, counted from 1
  int times = 1;  ///< for so many of them; -1 = for ever
  double delay_s = 0.0;
  std::string text{};  ///< kErrorReply: "E02"; kGarbage: the noise
};

}  // namespace turntable::sim
