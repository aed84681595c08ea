// A controller's text language as a file describes it (drivers/README.md says how to write one): which
// line asks for what, what the answers look like and what their words mean.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/text_template.h"
#include "src/core/rig_file.h"

namespace turntable {

/// What a word of an answer stands for.
struct WordMeaning {
  enum class Kind {
    kNothing,
    kMoving,
    kEnded,
    kLowerLimit,
    kUpperLimit,
    kLimit,     ///< one of the two
    kNotHomed,  ///< the controller does not know where the axis is
    kFault,     ///< emergency stop, alarm: `text` says what
    kRefused,   ///< the command: `text` says why
    kBusy,      ///< the command, for the moment
  };
  Kind kind = Kind::kNothing;
  std::string text;
};

struct ControllerDescription {
  /// A line that is said, and what it is answered by.
  struct Exchange {
    TextTemplate send;
    std::vector<TextTemplate> replies;  ///< any of them; empty: no answer is due
    explicit operator bool() const { return !send.empty(); }
  };
  /// Between the axis' unit, or pulses, and the controller's numbers.
  struct Numbers {
    bool pulses = false;  ///< false: mm and deg
    double factor = 1.0;  ///< of the controller's number
    int decimals = 0;     ///< sent and told
    std::string shown(double value, const AxisConfig& axis) const;
    double value(double number, const AxisConfig& axis) const;
    /// The least difference, in the axis' unit; 0 = a pulse, or less.
    double step(const AxisConfig& axis) const;
  };
  struct Setting {
    std::string name;
    std::string of;    ///< a quantity of the axis: "speed", "upper", ...; empty: `text`
    std::string text;  ///< what it has to be
    Numbers numbers;
    Exchange ask, set;  ///< either may be missing: it cannot be read, or not be written
    /// As it is sent. @param axis as its controller sees it.
    std::string wanted(const AxisConfig& axis) const;
  };

  std::string name;  ///< of the shipped description, or the file
  std::string title;
  bool untried = true;
  std::vector<std::string> sources, notes;

  int baud = 9600;
  double reply_timeout_s = 1.0;
  std::string command_end = "\r", answer_end = "\r";
  std::size_t answer_skips = 0;  ///< letters at the beginning of each answer that say nothing
  bool echo = false;
  bool lrc = false;  ///< Zaber's check sum after a colon

  std::vector<std::string> channels;  ///< that it has, in the order of {values}; empty: any
  Numbers position;
  double wraps = 0.0;     ///< told angles begin again after so much, deg; 0 = never
  bool absolute = false;  ///< positions need no homing: going to 0 stands for it
  double still_s = 0.0;   ///< standing so long ends a motion; 0 = a word does

  Exchange identify, move, home, stop, stop_now;
  std::vector<Exchange> status, setup;
  std::vector<Setting> settings;
  std::vector<TextTemplate> accepted, refused, unasked;
  std::map<std::string, std::map<std::string, WordMeaning>>
      words;  ///< by place and word, upper case

  /// What to call it, and that nobody has tried it: plain sentences.
  std::vector<std::string> unconfirmed() const;
  bool has_meaning(WordMeaning::Kind kind) const;
};

/// The description that a controller of a rig file names.
/// @throws ConfigError for a name that is not shipped, a file that cannot be read or does not make sense:
/// it names the file, the place, what was found and what is allowed.
ControllerDescription load_description(const ControllerConfig& controller);

/// @param name stands for the file in messages.
ControllerDescription parse_description(const std::string& text, const std::string& name);

/// Names of those that are built into the program.
std::vector<std::string> shipped_descriptions();

/// What of an axis does not go with the description.
/// @throws ConfigError "rig" for a channel that it has not, limits beyond where positions begin again.
void check_axis(const ControllerDescription& description, const AxisConfig& axis);

}  // namespace turntable
