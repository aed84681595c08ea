#include "drivers/sim/zaber_ascii.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>

#include "src/core/errors.h"

namespace turntable::sim {
namespace {

constexpr std::size_t kLongestCommand = 80;
constexpr double kSpeedUnit = 1.6384;            // of maxspeed, to microsteps/s
constexpr double kAccelerationUnit = 1.6384e-4;  // of accel, to microsteps/s^2

struct Rejected {
  const char* reason;
};

std::optional<std::int64_t> whole(std::string_view text) {
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::int64_t data(const std::string& text) {
  const auto value = whole(text);
  if (!value) throw Rejected{"BADDATA"};
  return *value;
}

/// What makes the letters and itself add up to nothing, of 256.
std::uint8_t longitudinal_check(std::string_view letters) {
  std::uint8_t sum = 0;
  for (const char c : letters) sum = static_cast<std::uint8_t>(sum + static_cast<std::uint8_t>(c));
  return static_cast<std::uint8_t>(-sum);
}

struct Peripheral {
  Peripheral(std::int64_t device_address, std::int64_t axis_number, AxisModel& model)
      : address(device_address), number(axis_number), axis(model) {
    const AxisConfig& c = axis.config();
    const double step = c.per_step();
    max_speed = std::llround(c.speed / step * kSpeedUnit);
    acceleration = std::llround(c.acceleration / step * kAccelerationUnit);
    approach_speed = std::llround(c.home_speed / step * kSpeedUnit);
    limit_max = std::llround(c.upper / step);
    limit_min = std::llround(c.lower / step);
  }
  double unit_speed(std::int64_t value) const {
    return static_cast<double>(value) / kSpeedUnit * axis.per_step();
  }
  Ramp ramp(std::int64_t speed) const {
    return {0.0, unit_speed(speed),
            static_cast<double>(acceleration) / kAccelerationUnit * axis.per_step()};
  }
  std::int64_t microsteps(Time now) const {
    return std::llround(axis.counter_position(now) / axis.per_step());
  }

  std::int64_t address, number;
  AxisModel& axis;
  std::int64_t max_speed, acceleration, approach_speed, limit_max, limit_min;
};

class ZaberAscii final : public ControllerSimulator {
 public:
  explicit ZaberAscii(const SimulatorSetup& setup);

 protected:
  void receive(std::string_view bytes, Time now) override;
  void power_up(Time) override {}
  std::string refusal(const std::string& text) override {
    return "@01 0 RJ IDLE -- " + (text.empty() ? "BADDATA" : text) + "\r\n";
  }
  void forget_input() override { pending_.clear(); }

 private:
  void take(std::string line, Time now);
  std::string carry_out(Peripheral& p, const std::vector<std::string>& words, Time now);
  std::int64_t* setting(Peripheral& p, const std::string& name);
  std::string_view flag(const Peripheral& p, Time now) const;

  std::vector<std::unique_ptr<Peripheral>> peripherals_;
  std::string pending_;
};

ZaberAscii::ZaberAscii(const SimulatorSetup& setup) : ControllerSimulator(setup) {
  for (const auto& axis : axes()) {
    const AxisConfig& config = axis->config();
    const std::size_t blank = config.channel.find(' ');
    const auto address = whole(std::string_view(config.channel).substr(0, blank));
    const auto number = blank == std::string::npos
                            ? std::nullopt
                            : whole(std::string_view(config.channel).substr(blank + 1));
    if (!address || !number || *address < 1 || *address > 99 || *number < 1 || *number > 9)
      throw ConfigError(
          "rig", fmt::format("/axes/{}/channel", axis_name(config.id)),
          fmt::format("found \"{}\", allowed on a simulated Zaber: a device address from 1 "
                      "to 99 and an axis number from 1 to 9, for example \"1 2\".",
                      config.channel));
    peripherals_.push_back(std::make_unique<Peripheral>(*address, *number, *axis));
  }
}

void ZaberAscii::receive(std::string_view bytes, Time now) {
  for (const char c : bytes) {
    if (c == '\r' || c == '\n') {
      if (!pending_.empty()) take(std::exchange(pending_, {}), now);
    } else if (pending_.size() <= kLongestCommand) {
      pending_ += c;
    }
  }
}

void ZaberAscii::take(std::string line, Time now) {
  if (line.size() > kLongestCommand || !line.starts_with('/')) return;
  line.erase(0, 1);
  if (const std::size_t colon = line.rfind(':'); colon != std::string::npos) {
    if (line.substr(colon + 1) != fmt::format("{:02X}", longitudinal_check(line.substr(0, colon))))
      return;
    line.erase(colon);
  }
  std::istringstream text(line);
  std::vector<std::string> words;
  for (std::string word; text >> word;) words.push_back(word);
  std::vector<std::int64_t> numbers;  // address, axis, message number
  while (!words.empty() && numbers.size() < 3) {
    const auto value = whole(words.front());
    if (!value) break;
    numbers.push_back(*value);
    words.erase(words.begin());
  }
  if (numbers.empty() || words.empty()) return;
  const std::int64_t number = numbers.size() > 1 ? numbers[1] : 0;
  const auto addressed = std::ranges::find_if(
      peripherals_, [&](const auto& p) { return p->address == numbers[0] && p->number == number; });
  const bool device =
      std::ranges::any_of(peripherals_, [&](const auto& p) { return p->address == numbers[0]; });
  if (!device) return;  // nobody of that address

  Request request{words.front(), "set"};
  if (words.front() == "get")
    request.kind = words.size() > 1 && words[1] == "pos" ? "status" : "get";
  if (words.front() == "move" || words.front() == "home") request.kind = words.front();
  if (words.front() == "stop" || words.front() == "estop") request.kind = "stop";
  if (addressed != peripherals_.end()) request.axis = (*addressed)->axis.config().id;
  const auto answer = [&](std::string_view taken, const std::string& what) {
    const std::string id = numbers.size() > 2 ? fmt::format(" {:02}", numbers[2]) : "";
    const bool known = addressed != peripherals_.end();
    return fmt::format("@{:02} {}{} {} {} {} {}\r\n", numbers[0], number, id, taken,
                       known && (*addressed)->axis.moving(now) ? "BUSY" : "IDLE",
                       known ? flag(**addressed, now) : "--", what);
  };
  serve(
      request, now,
      [&] {
        for (const OutputConfig& output : config().outputs)
          for (const bool on : {true, false})
            if ("/" + line == (on ? output.on_text : output.off_text)) {
              switch_output(output.name, on);
              return answer("OK", "0");
            }
        try {
          if (addressed == peripherals_.end()) throw Rejected{"BADAXIS"};
          const std::string what = carry_out(**addressed, words, now);
          return answer("OK", what);
        } catch (const Rejected& rejected) {
          return answer("RJ", rejected.reason);
        }
      },
      [&](const std::string& reason) { return answer("RJ", reason.empty() ? "BADDATA" : reason); });
}

std::string_view ZaberAscii::flag(const Peripheral& p, Time now) const {
  if (emergency_stop()) return "FD";
  if (alarm(p.axis.config().id)) return "FS";
  if (p.axis.homed(now) && (p.axis.lower_switch(now) || p.axis.upper_switch(now))) return "WL";
  return p.axis.homed(now) ? "--" : "WR";
}

std::int64_t* ZaberAscii::setting(Peripheral& p, const std::string& name) {
  if (name == "maxspeed") return &p.max_speed;
  if (name == "accel") return &p.acceleration;
  if (name == "limit.approach.maxspeed") return &p.approach_speed;
  if (name == "limit.max") return &p.limit_max;
  if (name == "limit.min") return &p.limit_min;
  throw Rejected{"BADCOMMAND"};
}

std::string ZaberAscii::carry_out(Peripheral& p, const std::vector<std::string>& words, Time now) {
  const std::string& verb = words.front();
  const auto expect = [&](std::size_t count) {
    if (words.size() != count) throw Rejected{"BADCOMMAND"};
  };
  if (verb == "get") {
    expect(2);
    return fmt::format("{}", words[1] == "pos" ? p.microsteps(now) : *setting(p, words[1]));
  }
  if (verb == "set") {
    expect(3);
    std::int64_t* const value = setting(p, words[1]);
    const std::int64_t wanted = data(words[2]);
    if (!words[1].starts_with("limit.m") && wanted <= 0) throw Rejected{"BADDATA"};
    *value = wanted;
    return "0";
  }
  if (verb == "warnings") {  // lists those that are cleared; what goes on comes back
    expect(2);
    if (words[1] == "clear") clear_alarm(p.axis.config().id);
    return "00";
  }
  if (verb == "stop" || verb == "estop") {
    expect(1);
    p.axis.stop(now, verb == "estop");
    return "0";
  }
  if (emergency_stop() || alarm(p.axis.config().id)) throw Rejected{"STATUSBUSY"};
  if (verb == "home") {
    expect(1);
    Ramp ramp = p.ramp(p.approach_speed);
    ramp.initial_speed = 0.1 * ramp.speed;
    p.axis.home(now, ramp);
    return "0";
  }
  if (verb == "move") {
    expect(3);
    const std::int64_t goal = data(words[2]) + (words[1] == "rel" ? p.microsteps(now) : 0);
    if (words[1] != "abs" && words[1] != "rel") throw Rejected{"BADCOMMAND"};
    if (goal < p.limit_min || goal > p.limit_max) throw Rejected{"BADDATA"};
    p.axis.move_to(now, static_cast<double>(goal) * p.axis.per_step(), p.ramp(p.max_speed));
    return "0";
  }
  throw Rejected{"BADCOMMAND"};
}

}  // namespace

std::unique_ptr<ControllerSimulator> simulate_zaber_ascii(const SimulatorSetup& setup) {
  return std::make_unique<ZaberAscii>(setup);
}

}  // namespace turntable::sim
