// Faults as values, given to a simulator.
#pragma once

#include <string>

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
  kErrorReply,      ///< the command is refused with `text`
  kReset,           ///< power cycle `delay_s` after the command
  kStuckAxis,       ///< pulses stop `delay_s` after the command, on the axis the command names
  kBlockedTable,    ///< the same, but the controller counts on: only a camera can see it
  kUnplugged,       ///< the line closes `delay_s` after the command
};

struct Fault {
  FaultKind kind{};
  std::string verb{};  ///< as in "GoPosition", any case; empty = every command
  int nth = 1;         ///< from the n-th such command on, counted from 1
  int times = 1;       ///< for so many of them; -1 = for ever
  double delay_s = 0.0;
  std::string text{};  ///< kErrorReply: "E02"; kGarbage: the noise
};

}  // namespace turntable::sim
