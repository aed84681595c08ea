#include "drivers/sim/sc300.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <string>
#include <string_view>
#include <utility>

#include "src/core/errors.h"

namespace turntable::sim {
namespace {

constexpr std::string_view kLetters = "XYZ";
constexpr std::string_view kRegisters = "VFA";
constexpr std::size_t kLongestCommand = 64;
constexpr std::int64_t kLargest = 99'999'999;  // guess: of a way and of a speed

/// The error replies. The manual calls them errors 0 and 1; what they mean is a guess.
constexpr const char* kUnknown = "E0";  // no such command, or ill-formed
constexpr const char* kNotNow = "E1";   // well-formed, but not allowed now or not with this value
constexpr const char* kNoDrive = "ER";  // the drive cannot: emergency stop or alarm

/// Ends the handling of a command.
struct Refused {
  const char* reply;
};

/// Digits, perhaps with a minus before them.
std::int64_t whole(std::string_view text) {
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) throw Refused{kUnknown};
  return value;
}

std::int64_t at_least(std::int64_t least, std::string_view text) {
  const std::int64_t value = whole(text);
  if (value < least || value > kLargest) throw Refused{kNotNow};
  return value;
}

/// One channel: its registers, and the axis it drives. The controller knows of pulses only.
struct Channel {
  Channel(char name, AxisModel& model) : letter(name), axis(model) {
    const AxisConfig& config = axis.config();
    const auto pulses = [&](double value) { return std::llround(value / config.per_step()); };
    top_speed = pulses(config.speed);
    initial_speed = pulses(config.initial_speed);
    acceleration = pulses(config.acceleration);
  }

  Ramp ramp() const {
    const double per_pulse = axis.per_step();
    return {static_cast<double>(initial_speed) * per_pulse,
            static_cast<double>(top_speed) * per_pulse,
            static_cast<double>(acceleration) * per_pulse};
  }
  /// Guess: there is no home speed, so the top speed it is, and the initial one for the last bit, or a
  /// tenth where that is 0.
  Ramp home_ramp() const {
    Ramp ramp = this->ramp();
    if (ramp.initial_speed == 0) ramp.initial_speed = 0.1 * ramp.speed;
    return ramp;
  }
  std::int64_t counter(Time now) const {
    return std::llround(axis.counter_position(now) / axis.per_step());
  }
  std::string position(Time now) const { return fmt::format("?{},{}\r", letter, counter(now)); }

  char letter;
  AxisModel& axis;
  std::int64_t top_speed, initial_speed, acceleration;  // V, F, A: pulses/s, pulses/s^2
  bool answer_due = false;                              ///< of a move or a homing
};

class Sc300 final : public ControllerSimulator {
 public:
  explicit Sc300(const SimulatorSetup& setup);

 protected:
  void receive(std::string_view bytes, Time now) override;
  void happen(Time now) override;
  std::optional<Time> next_own() const override;
  void power_up(Time now) override;
  std::string refusal(const std::string& text) override {
    return (text.empty() ? kNotNow : text) + "\r";
  }
  void forget_input() override {
    pending_.clear();
    overlong_ = false;
  }

 private:
  void take(const std::string& command, Time now);
  std::string answer(const std::string& command, const Request& request, Time now);
  void begin_move(Channel& channel, std::int64_t way, Time now);
  Request request_of(const std::string& command) const;
  bool moving(Time now) const;
  Channel& channel(char letter);
  Channel& idle_channel(char letter, Time now);

  std::vector<std::unique_ptr<Channel>> channels_;
  std::string pending_;
  bool overlong_ = false;
};

Sc300::Sc300(const SimulatorSetup& setup) : ControllerSimulator(setup) {
  for (const auto& axis : axes()) {
    const AxisConfig& config = axis->config();
    const char letter =
        config.channel.size() != 1
            ? '\0'
            : static_cast<char>(std::toupper(static_cast<unsigned char>(config.channel[0])));
    if (letter == '\0' || kLetters.find(letter) == std::string_view::npos)
      throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(config.id)),
                        fmt::format("found \"{}\", allowed on an SC300: X, Y, Z.", config.channel));
    channels_.push_back(std::make_unique<Channel>(letter, *axis));
  }
}

// ---- what happens, and when

std::optional<Time> Sc300::next_own() const {
  std::optional<Time> next;
  for (const auto& c : channels_)
    if (c->answer_due)
      if (const auto end = c->axis.ends_at(); end && (!next || *end < *next)) next = *end;
  return next;
}

/// A move or a homing is answered when it has ended, however it has. Guess: also after a stop.
void Sc300::happen(Time now) {
  for (const auto& c : channels_) {
    if (!c->answer_due || c->axis.moving(now)) continue;
    c->answer_due = false;
    const AxisId id = c->axis.config().id;
    if (!loses_completion(id)) send_deferred(id, c->position(now));
  }
}

/// Guess: the registers outlive a power cycle; the counters do not.
void Sc300::power_up(Time) {
  for (const auto& c : channels_) c->answer_due = false;
}

bool Sc300::moving(Time now) const {
  return std::ranges::any_of(channels_, [&](const auto& c) { return c->axis.moving(now); });
}

void Sc300::receive(std::string_view bytes, Time now) {
  for (const char c : bytes) {
    if (c != '\r') {  // a line feed is as good as any other letter, and spoils the command
      if (pending_.size() < kLongestCommand)
        pending_ += c;
      else
        overlong_ = true;
      continue;
    }
    std::string command = std::exchange(pending_, {});
    if (std::exchange(overlong_, false)) command = "\n";  // whatever it was, it is unknown
    take(command, now);
  }
}

ControllerSimulator::Request Sc300::request_of(const std::string& command) const {
  const std::string verb = command.substr(0, command.find(','));
  Request request{verb.empty() ? "cr" : verb, verb == command ? "get" : "set", {}};
  char letter = verb.size() == 2 ? verb[1] : '\0';
  if (verb.size() == 3 && verb.starts_with("SP")) {
    request.kind = "stop";
    letter = verb[2];
  } else if (verb.size() == 2) {
    if (verb[0] == '?') request.kind = "status";
    if (verb[0] == '+' || verb[0] == '-') request.kind = "move";
    if (verb[0] == 'H') request.kind = "home";
    if (kRegisters.find(verb[1]) != kRegisters.npos) letter = verb[0];  // "XV"
  }
  for (const OutputConfig& output : config().outputs)
    if (command == output.on_text || command == output.off_text) request.kind = "set";
  for (const auto& c : channels_)
    if (c->letter == letter) request.axis = c->axis.config().id;
  return request;
}

void Sc300::take(const std::string& command, Time now) {
  const Request request = request_of(command);
  serve(request, now, [&]() -> std::string {
    if (!config().answers_while_moving && request.kind != "stop" && moving(now)) return "";
    for (const OutputConfig& output : config().outputs)
      for (const bool on : {true, false})
        if (command == (on ? output.on_text : output.off_text)) {
          switch_output(output.name, on);
          return "OK\r";
        }
    try {
      return answer(command, request, now);
    } catch (const Refused& refused) {
      return std::string(refused.reply) + "\r";
    }
  });
}

// ---- what the commands mean

Channel& Sc300::channel(char letter) {
  if (kLetters.find(letter) == std::string_view::npos) throw Refused{kUnknown};
  for (const auto& c : channels_)
    if (c->letter == letter) return *c;
  throw Refused{kNotNow};  // no stage on this channel
}

Channel& Sc300::idle_channel(char letter, Time now) {
  Channel& c = channel(letter);
  if (c.axis.moving(now)) throw Refused{kNotNow};
  return c;
}

std::string Sc300::answer(const std::string& command, const Request& request, Time now) {
  if (command.empty()) return "OK\r";
  if (command == "VE") return "SC300_V1.0\r";
  if (command == "TY") return "SC300\r";
  if (command == "ID") return "ID0000\r";
  const std::size_t comma = command.find(',');
  const bool has_value = comma != std::string::npos;
  const std::string_view value = has_value ? std::string_view(command).substr(comma + 1) : "";
  const std::string_view verb = std::string_view(command).substr(0, comma);

  if (request.kind == "stop") {
    if (has_value) throw Refused{kUnknown};
    channel(verb[2]).axis.stop(now);
    return "OK\r";  // guess: the facts only say that something is answered
  }
  if (verb.size() != 2) throw Refused{kUnknown};
  if (request.kind == "status") {
    if (has_value) throw Refused{kUnknown};
    return channel(verb[1]).position(now);
  }
  if (request.kind == "move" || request.kind == "home") {
    if (has_value != (request.kind == "move")) throw Refused{kUnknown};
    if (request.kind == "move" && !value.empty() && value[0] == '-')
      throw Refused{kUnknown};  // the sign is the command
    const std::int64_t way = request.kind == "move" ? at_least(1, value) : 0;
    Channel& c = idle_channel(verb[1], now);
    if (emergency_stop() || alarm(c.axis.config().id)) throw Refused{kNoDrive};
    if (request.kind == "home")
      c.axis.home(now, c.home_ramp());
    else
      begin_move(c, verb[0] == '-' ? -way : way, now);
    c.answer_due = true;
    defer_answer(c.axis.config().id);
    return "";
  }
  // The registers: "VX,20000" writes what "XV" reads.
  const auto reg = [](Channel& c, char name) -> std::int64_t& {
    if (name == 'V') return c.top_speed;
    if (name == 'F') return c.initial_speed;
    if (name == 'A') return c.acceleration;
    throw Refused{kUnknown};
  };
  if (has_value) {
    const std::int64_t pulses = at_least(verb[0] == 'F' ? 0 : 1, value);  // "FX,0" is used
    reg(idle_channel(verb[1], now), verb[0]) = pulses;
    return "OK\r";
  }
  return fmt::format("{},{}\r", verb, reg(channel(verb[0]), verb[1]));  // guess: the verb is echoed
}

/// Ends at a limit switch, at once if that is on already.
void Sc300::begin_move(Channel& c, std::int64_t way, Time now) {
  if (way > 0 ? c.axis.upper_switch(now) : c.axis.lower_switch(now)) way = 0;
  c.axis.move_to(now, static_cast<double>(c.counter(now) + way) * c.axis.per_step(), c.ramp());
}

}  // namespace

std::unique_ptr<ControllerSimulator> simulate_sc300(const SimulatorSetup& setup) {
  return std::make_unique<Sc300>(setup);
}

}  // namespace turntable::sim
