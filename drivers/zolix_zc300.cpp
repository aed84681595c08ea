#include "drivers/zolix_zc300.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <optional>

#include "drivers/axis_controller.h"
#include "protocols/modbus_master.h"
#include "src/core/motion_time.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using Words = std::vector<std::uint16_t>;

// Registers by the manual's numbers, which count from 1: one less on the wire.
constexpr int kModel = 30001, kModelCount = 10;  // with serial number and firmware
constexpr int kStatus = 30012, kStatusCount = 10;
constexpr int kOpcode = 30050, kToken = 30054;
constexpr int kTarget = 30114;
std::uint16_t wire(int number) { return static_cast<std::uint16_t>(number - 1); }

constexpr std::uint16_t kMoveTo = 0x64, kSlowStop = 0x67, kHalt = 0x68, kHome = 0x69;
constexpr std::uint16_t kPositive = 'P', kNegative = 'N';

// In mm or deg.
constexpr double kPerUnit = 1000;  // targets are cut off to 0.001
constexpr double kUnder = 1e-5;    // added, so that the cut leaves what was meant
constexpr double kFarthest = 1e6;  // beyond it a position is noise
constexpr int kTargetAttempts = 3;
constexpr std::int64_t kStill = 2;  // pulses that an axis at rest may seem to have gone

// How far off a predicted end may be.
constexpr double kGuard_s = 0.06, kGuardOfMotion = 0.01;
constexpr Time kGuardPoll = milliseconds{10};
constexpr Time kIdentify = milliseconds{200};

constexpr const char* kPowerCycled = "the controller was switched off and on again";

std::uint32_t word32(const Words& words, std::size_t at) {
  return static_cast<std::uint32_t>(words[at]) << 16u | words[at + 1];
}
double real(const Words& words, std::size_t at) { return std::bit_cast<float>(word32(words, at)); }
std::array<std::uint16_t, 2> words_of(std::uint32_t value) {
  return {static_cast<std::uint16_t>(value >> 16u), static_cast<std::uint16_t>(value & 0xFFFFu)};
}

std::string model_in(const Words& words) {
  std::string model;
  for (std::size_t i = 0; i < 7; ++i)
    for (const int c : {words[i] >> 8, words[i] & 0xFF})
      if (c > ' ' && c < 0x7F) model += static_cast<char>(c);
  return model;
}

const char* meaning(int code) {
  switch (code) {
    case 0x01:
      return "it does not know the function";
    case 0x02:
      return "it has no such register for that function";
    case 0x03:
      return "wrong number of registers";
    case 0x04:
      return "it could not save: an axis is moving";
    case 0x05:
      return "the value is not allowed";
    case 0x06:
      return "the axis is already moving";
    case 0x07:
      return "a limit switch is on in that direction; find out why, and home the axis";
    case 0x08:
      return "the emergency stop is pressed; release it";
    case 0x09:
      return "the axis is not enabled";
    case 0x0A:
      return "unknown opcode (or, from a gateway: no way to that slave)";
    default:
      return "a reason that the manual pages at hand do not define";
  }
}

class Zc300 final : public AxisController {
 public:
  explicit Zc300(ControllerSetup setup);

 protected:
  std::string observe(std::vector<std::string>& differences) override;
  void write_setup() override;
  bool free(const Channel& channel) override;
  Acknowledgement start_move(const Channel& channel, Steps from, Steps to) override;
  Acknowledgement start_home(const Channel& channel) override;
  AxisStatus<Steps> status(const Channel& channel, Time deadline) override;
  bool may_be_homed(const Channel& channel) override;
  void send_stop(const Channel& channel, bool immediate) override;
  void switch_output(const OutputConfig& output, bool on) override;
  /// Each axis that ends its motion meanwhile costs one.
  int attempts() const override { return 3 + static_cast<int>(channels().size()); }

 private:
  struct Setting {
    enum class Width { kWord, kLong, kFloat };
    int number;
    const char* name;
    Width width;
    double value;
    double tolerance = 0.0;
  };
  /// What one status read tells of all three axes.
  struct Snapshot {
    std::array<bool, 3> moving{};
    unsigned bits = 0;
    std::array<double, 3> position{};
  };
  /// What this driver knows of a channel beside what the controller tells.
  struct Known {
    std::uint16_t token = 0;   ///< in 30054 when the channel was homed; 0 = it was not
    bool homing = false;       ///< a home command was given, and not yet seen to have succeeded
    std::optional<Time> ends;  ///< predicted, of the last motion
    Time guard{0};
  };

  static std::size_t number_of(const Channel& channel) {
    return static_cast<std::size_t>(letter(channel) - 'X');
  }
  static std::uint16_t code_of(const Channel& channel) {
    return static_cast<std::uint16_t>(0x31 + number_of(channel));
  }
  static std::vector<Setting> settings(const Channel& channel);

  int slave() const { return config().address; }
  std::string itself() const {
    return fmt::format("controller {} on {}", config().name, line_name());
  }
  template <class F>
  auto exchange(const std::string& who, const std::string& what, F&& action);
  Words holding(const std::string& who, int number, int count, Time deadline = Time::max());
  void write_words(const std::string& who, int number, std::span<const std::uint16_t> words);
  double read(const Channel& channel, const Setting& setting);
  Snapshot look(const Channel& channel, Time deadline = Time::max());
  std::uint16_t token(const std::string& who, Time deadline = Time::max()) {
    return holding(who, kToken, 1, deadline)[0];
  }
  bool homed(const Channel& channel);
  void join_session(const Channel& channel);
  void write_target(const Channel& channel, double target);
  Snapshot wait_for_ends(const Channel& channel);
  Acknowledgement command(const Channel& channel, std::uint16_t opcode, std::uint16_t direction);

  ModbusMaster master_;
  std::vector<Known> known_;  ///< by channel
  std::uint16_t token_ = 0;   ///< what this driver has put into 30054; 0 = nothing yet
};

Zc300::Zc300(ControllerSetup setup)
    : AxisController(setup),
      master_(line(), clock(),
              config().line.kind == LineConfig::Kind::kModbusTcp ? ModbusMaster::Framing::kTcp
                                                                 : ModbusMaster::Framing::kRtu,
              reply_timeout(), [this] { return gives_way(); }),
      known_(channels().size()) {
  require_letters("XYZ");
  require_outputs(false);
}

// ---- exchanges

/// One exchange, with the line to itself; a refusal gets its name.
template <class F>
auto Zc300::exchange(const std::string& who, const std::string& what, F&& action) {
  const auto guard = lock();
  try {
    return action();
  } catch (const ModbusException& refusal) {
    throw DeviceError(fmt::format("{}: {} was refused with {:02X}: {}. ({})", who, what,
                                  refusal.code(), meaning(refusal.code()), refusal.what()));
  }
}

Words Zc300::holding(const std::string& who, int number, int count, Time deadline) {
  return retried(deadline, [&] {
    return exchange(who, fmt::format("reading register {}", number),
                    [&] { return master_.read_holding(slave(), wire(number), count); });
  });
}

/// What may be said again: settings, outputs, the target.
void Zc300::write_words(const std::string& who, int number, std::span<const std::uint16_t> words) {
  retried(Time::max(), [&] {
    exchange(who, fmt::format("writing register {}", number), [&] {
      if (words.size() == 1)
        master_.write_register(slave(), wire(number), words[0], ModbusMaster::Repeat::kAllowed);
      else
        master_.write_registers(slave(), wire(number), words, ModbusMaster::Repeat::kAllowed);
    });
  });
}

/// Only of a channel's own axis is the position looked at: those without a stage may say anything.
Zc300::Snapshot Zc300::look(const Channel& channel, Time deadline) {
  return retried(deadline, [&] {
    const Words words = exchange(where(channel), "reading the status", [&] {
      return master_.read_input(slave(), wire(kStatus), kStatusCount);
    });
    Snapshot seen;
    for (std::size_t i = 0; i < 3; ++i) {
      seen.moving[i] = words[i] != 0;
      seen.position[i] = real(words, 4 + 2 * i);
    }
    seen.bits = words[3];
    const double here = seen.position[number_of(channel)];
    if (std::max({words[0], words[1], words[2]}) > 1 || !(std::abs(here) < kFarthest))  // or NaN
      throw ProtocolError(fmt::format("{}: a status that cannot be: moving {} {} {}, position {}",
                                      where(channel), words[0], words[1], words[2], here));
    return seen;
  });
}

// ---- set-up

/// In the order in which they are written: what gives later values their unit comes first. Speeds
/// are kept in whole pulses.
std::vector<Zc300::Setting> Zc300::settings(const Channel& channel) {
  using enum Setting::Width;
  const AxisConfig& config = channel.config;
  const bool rotary = config.kind == StageKind::kRotary;
  const int n = static_cast<int>(number_of(channel));
  const double lead = rotary ? 360.0 / config.drive_ratio : config.lead_mm;
  const auto speed = [&](int number, const char* name, double value) {
    return Setting{number + 2 * n, name, kFloat, value,
                   0.6 * config.per_step() + 1e-6 * std::abs(value)};
  };
  return {{30072 + n, "unit", kWord, rotary ? 2.0 : 1.0},
          {30075 + 2 * n, "pulses per revolution", kLong, config.steps_per_rev},
          {30081 + n, "stage type", kWord, rotary ? 1.0 : 0.0},
          {30084 + 2 * n, "lead", kFloat, lead, 1e-6 * lead},
          speed(30123, "initial speed", config.initial_speed),
          speed(30129, "cruise speed", config.speed),
          speed(30135, "acceleration", config.acceleration),
          speed(30099, "home speed", config.home_speed),
          {30105 + n, "home mode", kWord, 3.0},  // the home switch
          {30120 + n, "stop mode", kWord, 1.0},  // decelerates
          {30066 + n, "enable", kWord, 1.0}};
}

double Zc300::read(const Channel& channel, const Setting& setting) {
  const bool one = setting.width == Setting::Width::kWord;
  const Words words = holding(where(channel), setting.number, one ? 1 : 2);
  if (one) return words[0];
  return setting.width == Setting::Width::kFloat ? real(words, 0) : word32(words, 0);
}

std::string Zc300::observe(std::vector<std::string>& differences) {
  const Words words = retried(Time::max(), [&] {
    return exchange(itself(), "asking for the model",
                    [&] { return master_.read_input(slave(), wire(kModel), kModelCount); });
  });
  const std::string model = model_in(words);
  if (!model.starts_with("ZC300"))
    throw DeviceError(
        fmt::format("{}: slave {} is not a ZC300: it calls itself \"{}\". Check the rig file's "
                    "line, address and model.",
                    itself(), slave(), model));
  for (const Channel& channel : channels())
    for (const Setting& setting : settings(channel)) {
      const double found = read(channel, setting);
      if (!(std::abs(found - setting.value) <= setting.tolerance))
        differences.push_back(
            difference(channel, fmt::format("register {} ({})", setting.number, setting.name),
                       fmt::format("{:.7g}", setting.value), fmt::format("{:.7g}", found)));
    }
  return fmt::format("{} serial {} firmware {:.1f}", model, word32(words, 7), 0.1 * words[9]);
}

void Zc300::write_setup() {
  for (const Channel& channel : channels())
    for (const Setting& setting : settings(channel)) {
      if (setting.width == Setting::Width::kWord) {
        const auto word = static_cast<std::uint16_t>(setting.value);
        write_words(where(channel), setting.number, {&word, 1});
      } else {
        write_words(where(channel), setting.number,
                    words_of(setting.width == Setting::Width::kFloat
                                 ? std::bit_cast<std::uint32_t>(static_cast<float>(setting.value))
                                 : static_cast<std::uint32_t>(std::lround(setting.value))));
      }
    }
}

// ---- power cycles

bool Zc300::homed(const Channel& channel) {
  const AxisId id = channel.config.id;
  return channel.config.kind == StageKind::kLinear ? linear_axis(id)->homed()
                                                   : rotary_axis(id)->homed();
}

/// Before an axis is homed: makes sure that 30054 holds a number of this driver's. Where it has been
/// lost, the settings may have been too.
void Zc300::join_session(const Channel& channel) {
  Known& known = known_[channel.index];
  const std::uint16_t found = token(where(channel));
  if (token_ == 0 || found != token_) {
    if (token_ != 0)
      if (const auto differences = connect(); !differences.empty())
        throw DeviceError(fmt::format(
            "{}: the controller was switched off and on, and is now set up differently "
            "from the rig file, so nothing will be moved: {}{}. Let it be configured "
            "from the rig file.",
            where(channel), differences.front(),
            differences.size() > 1 ? fmt::format(", and {} more", differences.size() - 1) : ""));
    const std::uint16_t next = std::max(token_, found);
    token_ = next == std::numeric_limits<std::uint16_t>::max()
                 ? std::uint16_t{1}
                 : static_cast<std::uint16_t>(next + 1);
    write_words(where(channel), kToken, {&token_, 1});
  }
  known.token = token_;
}

/// Whoever homed an axis since power-up has left a number.
bool Zc300::may_be_homed(const Channel& channel) {
  const std::uint16_t found = token(where(channel));
  if (found == 0) return false;
  token_ = known_[channel.index].token = found;
  return true;
}

// ---- motion

/// Another axis that homes ends at a time that nobody can predict, and the command would be missed.
bool Zc300::free(const Channel& channel) {
  const auto homes = [&](const Channel& other) {
    return other.index != channel.index && known_[other.index].homing;
  };
  if (std::ranges::none_of(channels(), homes)) return true;
  const Snapshot seen = look(channel);
  return std::ranges::none_of(channels(), [&](const Channel& other) {
    return homes(other) && seen.moving[number_of(other)];
  });
}

/// A glitch on the line has been seen to send an axis far away: the target is read back, and nothing
/// moves before it is right. What the controller keeps in pulses reads back within half a pulse.
void Zc300::write_target(const Channel& channel, double target) {
  const int number = kTarget + 2 * static_cast<int>(number_of(channel));
  double wanted = std::round(std::abs(target) * kPerUnit) / kPerUnit;
  const double tolerance = 0.5 * channel.config.per_step() + 2 * kUnder + 2e-7 * wanted;
  float sent = static_cast<float>(wanted + kUnder);
  while (sent < wanted) sent = std::nextafter(sent, std::numeric_limits<float>::infinity());
  for (int attempt = 1;; ++attempt) {
    write_words(where(channel), number, words_of(std::bit_cast<std::uint32_t>(sent)));
    const double found = real(holding(where(channel), number, 2), 0);
    if (std::abs(found - wanted) <= tolerance) return;
    if (attempt == kTargetAttempts)
      throw DeviceError(
          fmt::format("{}: register {} (target): wanted {:.7g}, found {:.7g} after {} attempts. "
                      "Nothing was moved. Check cable and termination, and whether another program "
                      "talks to the controller.",
                      where(channel), number, sent, found, attempt));
  }
}

/// Returns when no other axis is within the guard of its predicted end: that is over, and a read has
/// been there to be missed; or it is some way off. Bounded by twice the longest guard and a read.
/// @return that read. @throws TimeoutError if a stop waits: nothing must start then.
Zc300::Snapshot Zc300::wait_for_ends(const Channel& channel) {
  for (;;) {
    const auto about_to_end = [&](const Channel& other) {
      const Known& known = known_[other.index];
      return other.index != channel.index && known.ends &&
             clock().now() > *known.ends - known.guard && clock().now() < *known.ends + known.guard;
    };
    const Snapshot seen = look(channel);
    require_no_stop(channel);
    if (std::ranges::none_of(channels(), [&](const Channel& other) {
          return seen.moving[number_of(other)] && about_to_end(other);
        }))
      return seen;
    clock().sleep_for(kGuardPoll);
  }
}

/// Sends a motion command, once.
Acknowledgement Zc300::command(const Channel& channel, std::uint16_t opcode,
                               std::uint16_t direction) {
  const std::array<std::uint16_t, 3> block{opcode, code_of(channel), direction};
  try {
    exchange(where(channel), fmt::format("opcode {:02X}h", opcode),
             [&] { master_.write_registers(slave(), wire(kOpcode), block); });
    return Acknowledgement::kReceived;
  } catch (const TimeoutError&) {
    return Acknowledgement::kLost;
  } catch (const ProtocolError&) {
    return Acknowledgement::kLost;
  }
}

Acknowledgement Zc300::start_move(const Channel& channel, Steps from, Steps to) {
  Known& known = known_[channel.index];
  const double target = channel.unit(to);
  write_target(channel, target);
  if (token(where(channel)) != known.token)
    throw DeviceError(fmt::format("{}: {}. Nothing was moved. Home the axis again.", where(channel),
                                  kPowerCycled));
  const double here = wait_for_ends(channel).position[number_of(channel)];
  if (std::abs(channel.steps(here).count - from.count) > kStill)
    throw DeviceError(
        fmt::format("{}: stands at {:.7g} and no more at {:.7g}: the controller was "
                    "reset or moved by hand. Nothing was moved. Home the axis again.",
                    where(channel), here, channel.unit(from)));
  const double takes_s = trapezoid_seconds(channel.config, target - channel.unit(from));
  known.homing = false;
  known.ends = clock().now() + from_seconds(takes_s);
  known.guard = from_seconds(kGuard_s + kGuardOfMotion * takes_s);
  return command(channel, kMoveTo, target < 0 ? kNegative : kPositive);
}

Acknowledgement Zc300::start_home(const Channel& channel) {
  join_session(channel);
  wait_for_ends(channel);
  known_[channel.index].homing = true;
  known_[channel.index].ends.reset();
  const Acknowledgement answer = command(channel, kHome, kNegative);
  // A command that was never heard would leave the counter at 0 and the axis at rest, which is what
  // a finished homing looks like.
  if (answer == Acknowledgement::kLost && !look(channel).moving[number_of(channel)])
    throw TimeoutError(
        fmt::format("{}: did not acknowledge the command to home, and does not move. It was not "
                    "sent again. Home the axis again.",
                    where(channel)));
  return answer;
}

AxisStatus<Steps> Zc300::status(const Channel& channel, Time deadline) {
  const std::size_t n = number_of(channel);
  const Snapshot seen = look(channel, deadline);
  AxisStatus<Steps> status;
  status.position = channel.steps(seen.position[n]);
  status.motion = seen.moving[n] ? Motion::kMoving : Motion::kEnded;
  status.upper_limit = (seen.bits >> 3 * n & 1u) != 0;
  status.lower_limit = (seen.bits >> 3 * n & 2u) != 0;
  if ((seen.bits >> 9 & 1u) != 0)
    status.fault = "the emergency stop is pressed; release it";
  else if ((seen.bits >> (10 + n) & 1u) != 0)
    status.fault =
        "the driver of the axis reports an alarm; find out why, and switch it off and on";
  if (!status.fault.empty() || status.position->count != 0) return status;

  // As after homing, and as after power-up.
  std::optional<std::uint16_t> expected;
  {
    const auto guard = lock();
    Known& known = known_[channel.index];
    if (homed(channel)) known.homing = false;
    if (homed(channel) || known.homing) expected = known.token;
  }
  if (expected && token(where(channel), deadline) != *expected) {
    const auto guard = lock();
    known_[channel.index].homing = false;
    status.fault = kPowerCycled;
  }
  return status;
}

void Zc300::send_stop(const Channel& channel, bool immediate) {
  const ModbusMaster::Urgent urgent(master_);
  const std::array<std::uint16_t, 2> block{immediate ? kHalt : kSlowStop, code_of(channel)};
  retried(Time::max(), [&] {
    try {
      master_.write_registers(slave(), wire(kOpcode), block, ModbusMaster::Repeat::kAllowed);
    } catch (const ModbusException&) {
      // Whether the axis halts is seen by its position, so any kind of answer will do.
    }
  });
  Known& known = known_[channel.index];
  known.homing = false;
  const double half_s = 0.5 * channel.config.speed / channel.config.acceleration;  // or sooner
  known.ends = clock().now() + from_seconds(half_s);
  known.guard = from_seconds(half_s + kGuard_s);
}

void Zc300::switch_output(const OutputConfig& output, bool on) {
  const std::string who = fmt::format("output {} of {}", output.name, config().name);
  retried(Time::max(), [&] {
    exchange(who, fmt::format("writing wire register {}", *output.register_at), [&] {
      master_.write_register(output.slave, static_cast<std::uint16_t>(*output.register_at),
                             on ? output.on_value : output.off_value,
                             ModbusMaster::Repeat::kAllowed);
    });
  });
}

}  // namespace

std::unique_ptr<Controller> open_zolix_zc300(ControllerSetup setup) {
  return std::make_unique<Zc300>(std::move(setup));
}

std::string identify_zolix_zc300(SharedLine line, Clock& clock) {
  ModbusMaster master(std::move(line), clock, ModbusMaster::Framing::kRtu, kIdentify);
  for (int attempt = 0; attempt < 2; ++attempt) {  // it may miss one request
    try {
      const std::string model = model_in(master.read_input(1, wire(kModel), kModelCount));
      return model.starts_with("ZC300") ? "Zolix " + model : "";
    } catch (const TimeoutError&) {
    } catch (const ProtocolError&) {
    } catch (const ModbusException&) {
      return {};
    }
  }
  return {};
}

}  // namespace turntable
