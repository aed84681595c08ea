#include "drivers/sim/mc600.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include "src/core/errors.h"

namespace turntable::sim {
namespace {

constexpr std::string_view kLetters = "XYZT";
constexpr std::size_t kLongestCommand = 128;

/// The error replies. Their meaning is not in the pages at hand; this is the likely one.
constexpr const char* kUnknown = "E01";  // no such command, or ill-formed
constexpr const char* kNotNow = "E02";   // well-formed, but not allowed now or not with this value

/// Ends the handling of a command.
struct Refused {
  const char* reply;
};

char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }
char upper(char c) { return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c; }

std::string lower(std::string_view text) {
  std::string s(text);
  std::ranges::transform(s, s.begin(), [](char c) { return lower(c); });
  return s;
}

std::string upper(std::string_view text) {
  std::string s(text);
  std::ranges::transform(s, s.begin(), [](char c) { return upper(c); });
  return s;
}

/// Plain decimals only: "-45000.1", no exponent.
double number(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), value, std::chars_format::fixed);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    throw Refused{kUnknown};
  return value;
}

double positive(std::string_view text) {
  const double value = number(text);
  if (value <= 0) throw Refused{kNotNow};
  return value;
}

std::string shown(double value) {
  std::string s = fmt::format("{:.5f}", value);
  s.erase(s.find_last_not_of('0') + 1);
  if (s.ends_with('.')) s.pop_back();
  return s == "-0" ? "0" : s;
}

char one_of(std::string_view text, std::string_view allowed) {
  if (text.size() != 1 || allowed.find(upper(text[0])) == std::string_view::npos)
    throw Refused{kUnknown};
  return upper(text[0]);
}

using Arguments = std::vector<std::string_view>;

Arguments split(std::string_view text) {
  Arguments parts;
  while (!text.empty()) {
    const std::size_t comma = text.find(',');
    parts.push_back(text.substr(0, comma));
    if (comma == std::string_view::npos) return parts;
    text.remove_prefix(comma + 1);
    if (text.empty()) parts.emplace_back();
  }
  return parts;
}

/// One channel: how the controller is set up, and the axis it drives. The controller thinks in
/// pulses; what it makes of them in mm or deg depends on its settings, what the stage makes of them
/// does not.
struct Channel {
  Channel(char name, AxisModel& model) : letter(name), axis(model) {
    const AxisConfig& config = axis.config();
    const bool rotary = config.kind == StageKind::kRotary;
    style = rotary ? 'R' : 'T';
    unit = rotary ? 'd' : 'm';
    steps_per_rev = config.steps_per_rev;
    drive_ratio = config.drive_ratio;
    pitch = config.lead_mm;
    distance = config.upper - config.lower;
    const double per_pulse = scale();
    initial_speed = config.initial_speed / per_pulse;
    speed = config.speed / per_pulse;
    acceleration = config.acceleration / per_pulse;
    home_speed = config.home_speed / per_pulse;
    limits_on = true;
    positive_limit = std::llround(config.upper / per_pulse);
    negative_limit = std::llround(config.lower / per_pulse);
  }

  /// In the unit that is set, per pulse.
  double scale() const {
    if (unit == 's') return 1.0;
    if (style == 'R') return 360.0 / (drive_ratio * steps_per_rev);
    return (unit == 'u' ? 1000.0 : 1.0) * pitch / steps_per_rev;
  }
  Ramp ramp(double cruise) const {
    const double per_pulse = axis.per_step();
    return {initial_speed * per_pulse, cruise * per_pulse, acceleration * per_pulse};
  }
  double pulses(Time now) const { return std::round(axis.counter_position(now) / axis.per_step()); }
  bool within_limits(double target_pulses) const {
    return !limits_on || (target_pulses >= static_cast<double>(negative_limit) - 0.5 &&
                          target_pulses <= static_cast<double>(positive_limit) + 0.5);
  }

  char letter;
  AxisModel& axis;
  char style = 'R', unit = 'd';
  double steps_per_rev = 1600, drive_ratio = 180, pitch = 4, distance = 360;
  double initial_speed = 800, speed = 8000, acceleration = 12000,
         home_speed = 4000;  // pulses/s, pulses/s^2
  bool limits_on = false;
  long long positive_limit = 0, negative_limit = 0;  // pulses
  int home_mode = 2;
  char work_state = 'O';
  double offset = 0, user_origin = 0;  // pulses
  bool way_back_due = false;           ///< of a homing, by `offset`
  bool on_way_back = false;
  bool completion_due = false;
};

class Mc600 final : public ControllerSimulator {
 public:
  explicit Mc600(const SimulatorSetup& setup);

 protected:
  void receive(std::string_view bytes, Time now) override;
  void happen(Time now) override;
  std::optional<Time> next_own() const override;
  void power_up(Time now) override;
  std::string refusal(const std::string& text) override { return text + "\r"; }
  void forget_input() override {
    pending_.clear();
    overlong_ = false;
  }

 private:
  void take(std::string_view command, Time now);
  std::string answer(std::string_view verb, const Arguments& arguments, Time now);
  std::string answer_query(std::string_view verb, const Arguments& arguments, Time now);
  void set(std::string_view verb, Channel& channel, std::string_view value, Time now);
  bool is_channel_setting(std::string_view verb) const;
  void go_position(const Arguments& a, Time now);
  void go_home(Channel& channel, Time now);
  void go_interpolated(const Arguments& a, std::size_t count, Time now);
  Channel& channel(std::string_view letter);
  Channel& idle_channel(std::string_view letter, Time now);

  std::vector<std::unique_ptr<Channel>> channels_;
  std::string pending_;
  bool overlong_ = false;
};

Mc600::Mc600(const SimulatorSetup& setup) : ControllerSimulator(setup) {
  for (const auto& axis : axes()) {
    const AxisConfig& config = axis->config();
    if (config.channel.size() != 1 ||
        kLetters.find(upper(config.channel[0])) == std::string_view::npos)
      throw ConfigError(
          "rig", fmt::format("/axes/{}/channel", axis_name(config.id)),
          fmt::format("found \"{}\", allowed on an MC600: X, Y, Z, T.", config.channel));
    channels_.push_back(std::make_unique<Channel>(upper(config.channel[0]), *axis));
  }
}

// ---- what happens, and when

std::optional<Time> Mc600::next_own() const {
  std::optional<Time> next;
  for (const auto& c : channels_)
    if (c->completion_due)
      if (const auto end = c->axis.ends_at(); end && (!next || *end < *next)) next = *end;
  return next;
}

void Mc600::happen(Time now) {
  for (const auto& c : channels_) {
    if (!c->completion_due || c->axis.moving(now)) continue;
    if (std::exchange(c->on_way_back, false)) c->axis.set_counter(now, 0);
    if (std::exchange(c->way_back_due, false) && c->axis.homed(now)) {
      c->on_way_back = true;
      c->axis.move_to(now, c->offset * c->axis.per_step(), c->ramp(c->home_speed));
      if (c->axis.moving(now)) continue;
    }
    c->completion_due = false;
    if (loses_completion(c->axis.config().id)) continue;
    send(fmt::format("{} {},OK\r", c->letter, shown(c->pulses(now) * c->scale())));
  }
}

void Mc600::power_up(Time) {
  for (const auto& c : channels_) c->completion_due = c->way_back_due = c->on_way_back = false;
}

void Mc600::receive(std::string_view bytes, Time now) {
  for (const char c : bytes) {
    if (c == '\n') continue;
    if (c != '\r') {
      if (pending_.size() < kLongestCommand)
        pending_ += c;
      else
        overlong_ = true;
      continue;
    }
    const std::string command = std::exchange(pending_, {});
    if (std::exchange(overlong_, false))
      send(std::string(kUnknown) + "\r");
    else if (!command.empty())
      take(command, now);
  }
}

void Mc600::take(std::string_view command, Time now) {
  const std::size_t space = command.find(' ');
  const std::string verb = lower(command.substr(0, space));
  const std::string_view rest = space == std::string_view::npos ? "" : command.substr(space + 1);
  const Arguments arguments = split(rest);

  Request request{verb, verb.ends_with('?') || verb == "hello" ? "get" : "set"};
  if (verb == "position?") request.kind = "status";
  if (verb == "goposition" || verb == "goorigion" || verb.starts_with("gointerpolation"))
    request.kind = "move";
  if (verb == "gohome" || verb == "gonaxishome") request.kind = "home";
  if (verb == "stop") request.kind = "stop";
  for (const auto& c : channels_)
    if (!arguments.empty() && arguments[0].size() == 1 && upper(arguments[0][0]) == c->letter)
      request.axis = c->axis.config().id;
  serve(request, now, [&] {
    for (const OutputConfig& output : config().outputs)
      for (const bool on : {true, false})
        if (command == (on ? output.on_text : output.off_text)) {
          switch_output(output.name, on);
          return std::string("OK\r");
        }
    if ((request.kind == "move" || request.kind == "home") &&
        (emergency_stop() || (request.axis && alarm(*request.axis))))
      return std::string(kNotNow) + "\r";
    try {
      return answer(verb, arguments, now) + "\r";
    } catch (const Refused& refusal) {
      return std::string(refusal.reply) + "\r";
    }
  });
}

// ---- what the commands mean

Channel& Mc600::channel(std::string_view letter) {
  const char wanted = one_of(letter, kLetters);
  for (const auto& c : channels_)
    if (c->letter == wanted) return *c;
  throw Refused{kNotNow};  // no stage on this channel
}

Channel& Mc600::idle_channel(std::string_view letter, Time now) {
  Channel& c = channel(letter);
  if (c.axis.moving(now)) throw Refused{kNotNow};
  return c;
}

std::string Mc600::answer(std::string_view verb, const Arguments& a, Time now) {
  if (verb.ends_with('?')) return answer_query(verb.substr(0, verb.size() - 1), a, now);
  const auto expect = [&](std::size_t count) {
    if (a.size() != count) throw Refused{kUnknown};
  };
  if (verb == "hello") {
    expect(0);
    return "OK";
  }
  if (verb == "goposition") {
    expect(5);
    go_position(a, now);
    return "READY";
  }
  if (verb == "gohome") {
    expect(1);
    go_home(idle_channel(a[0], now), now);
    return "READY";
  }
  if (verb == "goorigion") {
    expect(1);
    Channel& c = idle_channel(a[0], now);
    if (!c.within_limits(0)) throw Refused{kNotNow};
    c.axis.move_to(now, 0.0, c.ramp(c.speed));
    c.completion_due = true;
    return "READY";
  }
  if (verb == "gonaxishome") {
    expect(4);
    std::vector<Channel*> chosen;
    for (std::size_t i = 0; i < 4; ++i)
      if (one_of(a[i], "YN") == 'Y') chosen.push_back(&idle_channel(kLetters.substr(i, 1), now));
    if (chosen.empty()) throw Refused{kUnknown};
    for (Channel* c : chosen) go_home(*c, now);
    return "READY";
  }
  if (verb == "gointerpolationline2" || verb == "gointerpolationline3") {
    go_interpolated(a, verb.back() == '2' ? 2 : 3, now);
    return "READY";
  }
  if (verb == "stop") {
    expect(1);
    Channel& c = channel(a[0]);
    c.way_back_due = c.on_way_back = false;
    c.axis.stop(now);
    return "OK";
  }
  if (verb == "loaddefault") {
    expect(0);
    for (const auto& c : channels_)
      if (c->axis.moving(now)) throw Refused{kNotNow};
    for (const auto& c : channels_) {
      const bool rotary = c->style == 'R';
      c->unit = rotary ? 'd' : 'm';
      c->steps_per_rev = 1600;
      c->drive_ratio = 180;
      c->pitch = 4;
      c->initial_speed = 800;
      c->speed = 8000;
      c->acceleration = 12000;
      c->home_speed = 4000;
      c->limits_on = false;
      c->home_mode = 2;
      c->offset = 0;
    }
    return "OK";
  }
  if (!is_channel_setting(verb)) throw Refused{kUnknown};
  expect(2);
  set(verb, idle_channel(a[0], now), a[1], now);
  return "OK";
}

bool Mc600::is_channel_setting(std::string_view verb) const {
  constexpr std::array<std::string_view, 18> kSettings{
      "setunit",          "setspeed",         "setinitspeed",         "setaccspeed",
      "sethomespeed",     "setstagestyle",    "setstagepitch",        "setstagestepsrev",
      "setstagedriverat", "setstagedistance", "setuserorigin",        "setorigin",
      "setsechhomemode",  "setuserlimitable", "setuserpositivelimit", "setoffset",
      "setdriverat",      "setstageworkstate"};
  return std::ranges::find(kSettings, verb) != kSettings.end() || verb == "setusernegativelimit";
}

void Mc600::set(std::string_view verb, Channel& c, std::string_view value, Time now) {
  const auto pulses_of = [&](double v) { return v / c.scale(); };
  if (verb == "setunit") {
    const char unit = lower(one_of(value, "MUSD"));
    if (unit != 's' && (unit == 'd') != (c.style == 'R'))
      throw Refused{kNotNow};  // degrees of a slide?
    c.unit = unit;
  } else if (verb == "setspeed") {
    c.speed = pulses_of(positive(value));
  } else if (verb == "setinitspeed") {
    c.initial_speed = pulses_of(positive(value));
  } else if (verb == "setaccspeed") {
    c.acceleration = pulses_of(positive(value));
  } else if (verb == "sethomespeed") {
    c.home_speed = pulses_of(positive(value));
  } else if (verb == "setstagestyle") {
    c.style = one_of(value, "TR");
    if (c.unit != 's') c.unit = c.style == 'R' ? 'd' : 'm';
  } else if (verb == "setstagepitch") {
    c.pitch = positive(value);
  } else if (verb == "setstagestepsrev") {
    c.steps_per_rev = positive(value);
  } else if (verb == "setstagedriverat" || verb == "setdriverat") {
    c.drive_ratio = positive(value);
  } else if (verb == "setstagedistance") {
    c.distance = positive(value);
  } else if (verb == "setuserorigin") {
    c.user_origin = std::round(pulses_of(number(value)));
    c.axis.set_counter(now, c.user_origin * c.axis.per_step());
  } else if (verb == "setorigin") {
    one_of(value, "P");
  } else if (verb == "setsechhomemode") {
    if (value.size() != 1 || value[0] < '0' || value[0] > '9') throw Refused{kUnknown};
    if (value[0] != '2') throw Refused{kNotNow};  // the stages here have photo-switches
    c.home_mode = value[0] - '0';
  } else if (verb == "setoffset") {
    c.offset = std::round(pulses_of(number(value)));
  } else if (verb == "setstageworkstate") {
    c.work_state = one_of(value, "OC");
  } else if (verb == "setuserlimitable") {
    c.limits_on = one_of(value, "ED") == 'E';
  } else if (verb == "setuserpositivelimit") {
    c.positive_limit = std::llround(pulses_of(number(value)));
  } else {
    c.negative_limit = std::llround(pulses_of(number(value)));
  }
}

std::string Mc600::answer_query(std::string_view verb, const Arguments& a, Time now) {
  if (verb != "position" && !is_channel_setting(verb)) throw Refused{kUnknown};
  if (a.size() != 1) throw Refused{kUnknown};
  const Channel& c = channel(a[0]);
  const double scale = c.scale();
  std::string value;
  if (verb == "position")
    value = shown(c.pulses(now) * scale);
  else if (verb == "setunit")
    value = c.unit;
  else if (verb == "setspeed")
    value = shown(c.speed * scale);
  else if (verb == "setinitspeed")
    value = shown(c.initial_speed * scale);
  else if (verb == "setaccspeed")
    value = shown(c.acceleration * scale);
  else if (verb == "sethomespeed")
    value = shown(c.home_speed * scale);
  else if (verb == "setstagestyle")
    value = c.style;
  else if (verb == "setstagepitch")
    value = shown(c.pitch);
  else if (verb == "setstagestepsrev")
    value = shown(c.steps_per_rev);
  else if (verb == "setoffset")
    value = shown(c.offset * scale);
  else if (verb == "setuserorigin")
    value = shown(c.user_origin * scale);
  else if (verb == "setorigin")
    value = 'P';
  else if (verb == "setstageworkstate")
    value = c.work_state;
  else if (verb == "setstagedriverat" || verb == "setdriverat")
    value = shown(c.drive_ratio);
  else if (verb == "setstagedistance")
    value = shown(c.distance);
  else if (verb == "setsechhomemode")
    value = shown(c.home_mode);
  else if (verb == "setuserlimitable")
    value = c.limits_on ? 'E' : 'D';
  else if (verb == "setuserpositivelimit")
    value = shown(static_cast<double>(c.positive_limit) * scale);
  else
    value = shown(static_cast<double>(c.negative_limit) * scale);
  return fmt::format("{}? {},{},OK", upper(verb), c.letter, value);
}

void Mc600::go_position(const Arguments& a, Time now) {
  const char loop = one_of(a[1], "OC"), kind = one_of(a[2], "AR"), sign = one_of(a[3], "PN");
  const double magnitude = number(a[4]);
  if (magnitude < 0) throw Refused{kUnknown};  // the sign is the letter before
  Channel& c = idle_channel(a[0], now);
  if (loop == 'C') throw Refused{kNotNow};  // there is no encoder on these stages
  double target = std::round(magnitude / c.scale()) * (sign == 'N' ? -1.0 : 1.0);
  if (kind == 'R') target += c.pulses(now);
  if (!c.within_limits(target)) throw Refused{kNotNow};
  c.axis.move_to(now, target * c.axis.per_step(), c.ramp(c.speed));
  c.completion_due = true;
}

void Mc600::go_home(Channel& c, Time now) {
  c.axis.home(now, c.ramp(c.home_speed));
  c.way_back_due = c.offset != 0;
  c.completion_due = true;
}

/// A straight line through the axes, absolute: the one with the longest way sets the time, the
/// others scale.
void Mc600::go_interpolated(const Arguments& a, std::size_t count, Time now) {
  if (a.size() != 2 * count) throw Refused{kUnknown};
  struct Part {
    Channel* channel;
    double target, seconds;
  };
  std::vector<Part> parts;
  for (std::size_t i = 0; i < count; ++i) {
    const double value = number(a[2 * i + 1]);
    Channel& c = idle_channel(a[2 * i], now);
    for (const Part& other : parts)
      if (other.channel == &c) throw Refused{kUnknown};
    const double target = std::round(value / c.scale());
    if (!c.within_limits(target)) throw Refused{kNotNow};
    const double way = std::abs(target - c.pulses(now)) * c.axis.per_step();
    parts.push_back({&c, target, Trapezoid(way, c.ramp(c.speed)).duration()});
  }
  const double longest = std::ranges::max(parts, {}, &Part::seconds).seconds;
  for (const Part& part : parts) {
    Channel& c = *part.channel;
    Ramp ramp = c.ramp(c.speed);
    // Speeds by k and acceleration by k^2 stretch the profile's time by 1/k and keep its shape.
    if (const double k = part.seconds / longest; part.seconds > 0)
      ramp = {ramp.initial_speed * k, ramp.speed * k, ramp.acceleration * k * k};
    c.axis.move_to(now, part.target * c.axis.per_step(), ramp);
    c.completion_due = true;
  }
}

}  // namespace

std::unique_ptr<ControllerSimulator> simulate_mc600(const SimulatorSetup& setup) {
  return std::make_unique<Mc600>(setup);
}

}  // namespace turntable::sim
