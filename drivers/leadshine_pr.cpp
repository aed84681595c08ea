#include "drivers/leadshine_pr.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "drivers/axis_controller.h"
#include "protocols/modbus_master.h"

namespace turntable {
namespace {

using Words = std::vector<std::uint16_t>;

// Registers.
constexpr std::uint16_t kStatus = 0x1003;
constexpr Time kIdentify = std::chrono::milliseconds{100};
constexpr int kIdentifiedSlaves = 8;
constexpr Time kPositionEvery = std::chrono::milliseconds{100};
constexpr std::uint16_t kAlarm = 0x2203;
constexpr std::uint16_t kTrigger = 0x6002;
constexpr std::uint16_t kStopRamp = 0x6017;
constexpr std::uint16_t kPosition = 0x602A;
constexpr std::uint16_t kPath0 = 0x6200;
constexpr std::uint16_t kInputFunctions = 0x0144;  // seven of two words, the high one first
constexpr std::uint16_t kInputs = 0x0179;
constexpr std::uint16_t kWarning = 0x601D;
constexpr int kInputCount = 7;

// Functions of an input, but for bit 7: normally closed.
constexpr unsigned kUpperLimit = 0x25, kLowerLimit = 0x26, kHomeSwitch = 0x27;

// Bits of kStatus.
constexpr unsigned kFault = 1u << 0u;
constexpr unsigned kEnabled = 1u << 1u;
constexpr unsigned kRunning = 1u << 2u;
constexpr unsigned kHomeDone = 1u << 6u;

// Values of kTrigger.
constexpr std::uint16_t kRunPath0 = 0x10;
constexpr std::uint16_t kHome = 0x20;
constexpr std::uint16_t kStop = 0x40;

constexpr std::uint16_t kAbsolute = 0x0001;  ///< mode of a path

constexpr int kLastSlave = 31;
constexpr double kLeastPulses = 200, kMostPulses = 51200;  // per revolution
constexpr double kMostOfWord = 32767;
constexpr double kRounding = 0.02;           // of a speed or an acceleration
constexpr std::uint16_t kLimitRamp_ms = 50;  // there is little room behind a limit switch
constexpr Time kOnToStopPosition = std::chrono::milliseconds{500};
constexpr int kBadCrc = 0x08;  // exception: the request arrived spoilt

std::string_view exception_meaning(int code) {
  switch (code) {
    case 0x01:
      return "it does not know this function";
    case 0x02:
      return "it has no such register. This program needs a drive with PR paths; \"CL57RS\", for "
             "one, is two products with two register maps";
    case 0x03:
      return "it does not allow this value";
    case 0x04:
      return "the value is over a limit, or it cannot do that now";
    case kBadCrc:
      return "the request arrived spoilt";
    default:
      return "a code that its manuals do not list";
  }
}

std::string_view alarm_meaning(int code) {
  switch (code) {
    case 0x0001:
      return "overcurrent";
    case 0x0002:
      return "overvoltage";
    case 0x0020:
      return "position following error";
    case 0x0040:
      return "current sampling";
    case 0x0080:
      return "the shaft cannot be locked";
    case 0x0100:
      return "parameter tuning";
    case 0x0200:
      return "parameter memory";
    default:
      return "not in the pages at hand; an emergency stop or limit input is a possible cause";
  }
}

std::uint32_t joined(std::uint16_t high, std::uint16_t low) {
  return static_cast<std::uint32_t>(high) << 16u | low;
}
std::uint16_t high(std::uint32_t value) { return static_cast<std::uint16_t>(value >> 16u); }
std::uint16_t low(std::uint32_t value) { return static_cast<std::uint16_t>(value & 0xFFFFu); }

/// What a register, or a pair H L of them, has to hold. Bits outside the mask are not our business.
struct Setting {
  const char* what;
  std::uint16_t address;
  int words;
  std::uint32_t wanted;
  std::uint32_t mask = ~0u;

  std::string shown(std::uint32_t value) const {
    if (std::has_single_bit(mask)) return (value & mask) != 0 ? "on" : "off";
    if (mask != ~0u) return fmt::format("0x{:04X}", value & mask);
    return words == 2 ? fmt::format("{}", static_cast<std::int32_t>(value))
                      : fmt::format("{}", value);
  }
};

/// One drive, as the rig file wants it.
struct Drive {
  int slave = 0;
  std::uint16_t rpm = 0, ramp_ms = 0, stop_ms = 0;
  std::vector<Setting> settings;  ///< by rising address, as neighbours are read at once
  bool homing = false;            ///< asked to home, and not yet seen to have done it
  Time seen_at{0};                ///< when its position was last read
  bool home_begun = false;        ///< its home-done bit is no longer of an earlier time
  std::optional<Time> home_said;  ///< since when it says that it is at rest and homed
  std::optional<Steps> goal;      ///< of the path that it runs, unless it was stopped
  bool ran = false;               ///< has been seen on the way there
};

/// A whole number for a register. `exact` is what `value` (`key` of the rig file, in `unit`) comes
/// to; `inverse` if the register falls when the value rises.
std::uint16_t whole(const AxisConfig& axis, const char* key, double value, const char* unit,
                    double exact, const char* register_unit, bool inverse) {
  const double rounded = std::clamp(std::round(exact), 1.0, kMostOfWord);
  if (std::abs(rounded - exact) <= kRounding * std::abs(exact))
    return static_cast<std::uint16_t>(rounded);
  throw ConfigError(
      "rig", fmt::format("/axes/{}/{}", axis_name(axis.id), key),
      fmt::format("{:g} {}{} is {:.4g} {}, and the drive takes whole numbers from 1 to {:g}. The "
                  "nearest that is possible is {:.6g} {}{}.",
                  value, axis.unit(), unit, exact, register_unit, kMostOfWord,
                  inverse ? value * exact / rounded : value * rounded / exact, axis.unit(), unit));
}

int slave_of(const AxisConfig& axis, const std::string& model) {
  const std::string& text = axis.channel;
  int slave = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), slave);
  if (error != std::errc() || end != text.data() + text.size() || text[0] == '0' || slave < 1 ||
      slave > kLastSlave)
    throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(axis.id)),
                      fmt::format("found \"{}\", allowed on {}: the drive's address, \"1\" to "
                                  "\"{}\".",
                                  text, model, kLastSlave));
  return slave;
}

/// @throws ConfigError for what the drive cannot be set to.
Drive planned(const AxisController::Channel& channel, const std::string& model) {
  const AxisConfig& axis = channel.config;
  const std::string pointer = fmt::format("/axes/{}", axis_name(axis.id));
  Drive drive;
  drive.slave = slave_of(axis, model);
  if (axis.steps_per_rev < kLeastPulses || axis.steps_per_rev > kMostPulses ||
      axis.steps_per_rev != std::round(axis.steps_per_rev))
    throw ConfigError("rig", pointer + "/steps_per_rev",
                      fmt::format("found {:g}, allowed on {}: whole numbers from {:g} to {:g}.",
                                  axis.steps_per_rev, model, kLeastPulses, kMostPulses));
  const auto limit = [&](double value, const char* key) {
    const std::int64_t pulses = channel.steps(value).count;
    if (std::abs(pulses) > std::numeric_limits<std::int32_t>::max())
      throw ConfigError(
          "rig", pointer + "/" + key,
          fmt::format("{:g} {} is more pulses than the drive can count.", value, axis.unit()));
    return static_cast<std::uint32_t>(static_cast<std::int32_t>(pulses));
  };
  const double rpm = 60.0 / (axis.per_step() * axis.steps_per_rev);  // of one unit per second
  const auto speed = [&](const char* key, double value) {
    return whole(axis, key, value, "/s", value * rpm, "rpm", false);
  };
  drive.rpm = speed("speed", axis.speed);
  // Of a stop it is the time that counts, from whatever speed: at most the planned deceleration.
  drive.stop_ms = static_cast<std::uint16_t>(
      std::clamp(std::round(1000 * axis.speed / axis.acceleration), 1.0, kMostOfWord));
  drive.ramp_ms = whole(axis, "acceleration", axis.acceleration, "/s^2",
                        1e6 / (axis.acceleration * rpm), "ms per 1000 rpm", true);
  const std::uint32_t fast = speed("home_speed", axis.home_speed);
  const auto slow = static_cast<std::uint32_t>(
      std::clamp(std::round(axis.initial_speed * rpm), 1.0, static_cast<double>(fast)));
  drive.settings = {
      {"pulses per revolution", 0x0001, 1, static_cast<std::uint32_t>(axis.steps_per_rev)},
      {"enabled by software", 0x000F, 1, 1},
      {"soft limits", 0x6000, 1, 0x0002, 0x0002},
      {"homes by itself when it is switched on, so that the table moves without being asked",
       0x6000, 1, 0, 0x0004},
      {"upper soft limit, pulses", 0x6006, 2, limit(axis.upper, "upper")},
      {"lower soft limit, pulses", 0x6008, 2, limit(axis.lower, "lower")},
      // Having found the origin the motor decelerates past it; only with bit 1 it comes back.
      {"homes on the origin switch, and goes to the stop position then", 0x600A, 1, 0x0006, 0x0006},
      {"position at the origin, pulses", 0x600B, 2, 0},
      {"position to go to after homing, pulses", 0x600D, 2, 0},
      {"fast homing speed, rpm", 0x600F, 1, fast},
      {"slow homing speed, rpm", 0x6010, 1, slow},
      {"homing acceleration, ms", 0x6011, 1, drive.ramp_ms},
      {"homing deceleration, ms", 0x6012, 1, drive.ramp_ms},
      {"deceleration at a limit, ms", 0x6016, 1, std::min(drive.stop_ms, kLimitRamp_ms)},
      {"deceleration of a stop, ms", kStopRamp, 1, drive.stop_ms}};
  return drive;
}

class LeadshinePr final : public AxisController {
 public:
  explicit LeadshinePr(ControllerSetup setup);

 protected:
  std::string observe(std::vector<std::string>& differences) override;
  void write_setup() override;
  Acknowledgement start_move(const Channel& channel, Steps from, Steps to) override;
  Acknowledgement start_home(const Channel& channel) override;
  AxisStatus<Steps> status(const Channel& channel, Time deadline) override;
  bool may_be_homed(const Channel& channel) override;
  void send_stop(const Channel& channel, bool immediate) override;
  void switch_output(const OutputConfig& output, bool on) override;

 private:
  Drive& drive(const Channel& channel) { return drives_[channel.index]; }
  template <class Who, class What, class F>
  auto said(Who&& who, What&& what, F&& exchange, bool again = true);
  Words read(const Channel& channel, std::uint16_t address, int words, Time deadline = Time::max());
  void write(const std::string& who, int slave, std::uint16_t address,
             std::span<const std::uint16_t> values);
  void write(const Channel& channel, std::uint16_t address, std::uint16_t value) {
    write(where(channel), drive(channel).slave, address, {&value, 1});
  }
  Acknowledgement trigger(const Channel& channel, std::uint16_t value);
  std::vector<std::string> compared(const Channel& channel);
  bool referenced(const Channel& channel);
  bool halted_short(const Channel& channel, Steps position, bool home_done);
  std::optional<Words> read_if_known(const Channel& channel, std::uint16_t address, int words);
  std::string inputs_told(const Channel& channel);
  std::string limit_told(const Channel& channel);

  ModbusMaster master_;
  std::vector<Drive> drives_;  ///< by channel
};

LeadshinePr::LeadshinePr(ControllerSetup setup)
    : AxisController(setup),
      master_(line(), clock(),
              config().line.kind == LineConfig::Kind::kModbusTcp ? ModbusMaster::Framing::kTcp
                                                                 : ModbusMaster::Framing::kRtu,
              reply_timeout(), [this] { return gives_way(); }) {
  require_outputs(false);
  for (const Channel& channel : channels()) drives_.push_back(planned(channel, config().model));
}

// ---- exchanges

/// Gives a refusal the name of what was refused; a request that arrived spoilt may be said again.
/// @param who, what make the words for it; polling must not make words that nobody reads.
/// @param again whether the exchange is one that may be repeated.
template <class Who, class What, class F>
auto LeadshinePr::said(Who&& who, What&& what, F&& exchange, bool again) {
  const auto guard = lock();
  try {
    return exchange();
  } catch (const ModbusException& refusal) {
    const std::string message =
        fmt::format("{}: {} was refused with exception {:02X}: {}.", who(), what(), refusal.code(),
                    exception_meaning(refusal.code()));
    if (refusal.code() == kBadCrc && again) throw ProtocolError(message);
    throw DeviceError(message);
  }
}

Words LeadshinePr::read(const Channel& channel, std::uint16_t address, int words, Time deadline) {
  const int slave = drive(channel).slave;
  return retried(deadline, [&] {
    return said([&] { return where(channel); },
                [&] { return fmt::format("reading register 0x{:04X}", address); },
                [&] { return master_.read_holding(slave, address, words); });
  });
}

/// What may be said again: never the trigger of a motion.
void LeadshinePr::write(const std::string& who, int slave, std::uint16_t address,
                        std::span<const std::uint16_t> values) {
  retried(Time::max(), [&] {
    said([&] { return who; },
         [&] {
           return fmt::format("writing 0x{:04X} to register 0x{:04X}", fmt::join(values, " "),
                              address);
         },
         [&] {
           if (values.size() == 1)
             master_.write_register(slave, address, values[0], ModbusMaster::Repeat::kAllowed);
           else
             master_.write_registers(slave, address, values, ModbusMaster::Repeat::kAllowed);
         });
  });
}

Acknowledgement LeadshinePr::trigger(const Channel& channel, std::uint16_t value) {
  try {
    said([&] { return where(channel); },
         [&] { return fmt::format("writing 0x{:04X} to register 0x{:04X}", value, kTrigger); },
         [&] { master_.write_register(drive(channel).slave, kTrigger, value); }, false);
    return Acknowledgement::kReceived;
  } catch (const TimeoutError&) {
    return Acknowledgement::kLost;
  } catch (const ProtocolError&) {
    return Acknowledgement::kLost;
  }
}

// ---- set-up

/// One line for each setting that is not as the rig file says.
std::vector<std::string> LeadshinePr::compared(const Channel& channel) {
  std::vector<std::string> differences;
  const std::vector<Setting>& settings = drive(channel).settings;
  for (auto first = settings.begin(); first != settings.end();) {
    int words = 0;
    auto last = first;
    for (; last != settings.end() && last->address <= first->address + words; ++last)
      words = last->address - first->address + last->words;  // two may share a register
    const std::uint16_t begin = first->address;
    const Words found = read(channel, begin, words);
    for (; first != last; ++first) {
      const auto at = static_cast<std::size_t>(first->address - begin);
      const std::uint32_t value = first->words == 2 ? joined(found[at], found[at + 1]) : found[at];
      if (((value ^ first->wanted) & first->mask) != 0)
        differences.push_back(
            difference(channel, fmt::format("register 0x{:04X} ({})", first->address, first->what),
                       first->shown(first->wanted), first->shown(value)));
    }
  }
  return differences;
}

std::string LeadshinePr::observe(std::vector<std::string>& differences) {
  std::string slaves = "slaves", alarms;
  for (const Channel& channel : channels()) {
    std::ranges::move(compared(channel), std::back_inserter(differences));
    slaves += fmt::format(" {}", drive(channel).slave);
    if (const int alarm = read(channel, kAlarm, 1)[0]; alarm != 0)
      alarms += fmt::format("; slave {} has alarm 0x{:04X} ({})", drive(channel).slave, alarm,
                            alarm_meaning(alarm));
    const auto functions = read_if_known(channel, kInputFunctions, 2 * kInputCount);
    if (functions && std::ranges::none_of(*functions, [](std::uint16_t word) {
          return (word & 0x7Fu) == kHomeSwitch;
        }))
      alarms += fmt::format(
          "; slave {} has no input that is set up as the home switch (0x27 in one of the registers "
          "0x0145 to 0x0151, which counts after saving and switching off and on), so that homing "
          "would not find it",
          drive(channel).slave);
  }
  return slaves + alarms;
}

void LeadshinePr::write_setup() {
  for (const Channel& channel : channels())
    for (const Setting& setting : drive(channel).settings) {
      std::uint32_t value = setting.wanted;
      if (setting.mask != ~0u) value |= read(channel, setting.address, 1)[0] & ~setting.mask;
      const std::array words{high(value), low(value)};
      write(where(channel), drive(channel).slave, setting.address,
            std::span(words).last(static_cast<std::size_t>(setting.words)));
    }
}

// ---- motion

Acknowledgement LeadshinePr::start_move(const Channel& channel, Steps, Steps to) {
  const Drive& d = drive(channel);
  const auto position = static_cast<std::uint32_t>(static_cast<std::int32_t>(to.count));
  const std::array<std::uint16_t, 8> block{
      kAbsolute, high(position), low(position), d.rpm, d.ramp_ms, d.ramp_ms, 0, 0};
  write(where(channel), d.slave, kPath0, block);
  const Words kept = read(channel, kPath0, static_cast<int>(block.size()));
  for (std::size_t i = 0; i < block.size(); ++i)
    if (kept[i] != block[i])
      throw DeviceError(
          fmt::format("{}: register 0x{:04X} (path 0): wanted 0x{:04X}, found 0x{:04X}. The drive "
                      "does not keep "
                      "what it is told, so nothing was moved. Check for another master on the bus.",
                      where(channel), kPath0 + i, block[i], kept[i]));
  require_no_stop(channel);
  drive(channel).goal = to;
  drive(channel).ran = false;
  return trigger(channel, kRunPath0);
}

Acknowledgement LeadshinePr::start_home(const Channel& channel) {
  if (const auto differences = compared(channel); !differences.empty())
    throw DeviceError(fmt::format(
        "{} is not set up any more as it was, so it will not be moved:\n  {}\nIt may have been "
        "switched off and on since. Let it be configured from the rig file again.",
        where(channel), fmt::join(differences, "\n  ")));
  require_no_stop(channel);
  Drive& d = drive(channel);
  d.homing = true;
  d.goal.reset();
  d.ran = false;
  d.home_said.reset();
  const Acknowledgement acknowledged = trigger(channel, kHome);
  d.home_begun = acknowledged == Acknowledgement::kReceived;
  return acknowledged;
}

/// Whether its positions are believed at present.
bool LeadshinePr::referenced(const Channel& channel) {
  if (const auto* axis = linear_axis(channel.config.id)) return axis->homed();
  return rotary_axis(channel.config.id)->homed();
}

/// Nothing where the drive has no such register; some of the relatives lack those that only explain.
std::optional<Words> LeadshinePr::read_if_known(const Channel& channel, std::uint16_t address,
                                                int words) {
  try {
    return read(channel, address, words);
  } catch (const DeviceError&) {
    return std::nullopt;
  }
}

/// Whether the last path or homing has come to an end elsewhere, and not by a stop of ours. True
/// once.
bool LeadshinePr::halted_short(const Channel& channel, Steps position, bool home_done) {
  const auto guard = lock();
  Drive& d = drive(channel);
  if (!d.ran || (d.homing ? home_done : !d.goal || position == *d.goal)) return false;
  d.goal.reset();
  d.ran = false;
  return true;
}

/// What the drive itself says of a halt short of the goal; empty if it is nothing.
std::string LeadshinePr::limit_told(const Channel& channel) {
  const auto warning = read_if_known(channel, kWarning, 1);
  if (!warning) return {};
  const int word = warning->front();
  const std::string place = fmt::format("(warning 0x{:04X} in register 0x{:04X}{})", word, kWarning,
                                        inputs_told(channel));
  if (word >= 0x0200 && word <= 0x020F)
    return fmt::format(
        "the drive says that it met a limit switch on the way {}. Find out why it came there "
        "within "
        "its soft limits. It stands",
        place);
  if (word == 0x0100 || word == 0x0102)
    return fmt::format(
        "the drive says that its homing failed, at a limit switch perhaps {}. Check the home "
        "switch. It stands",
        place);
  return {};
}

/// "; input 3, set up as the upper limit switch, is on". That the bits are the inputs in their order
/// is what one other program goes by; whether a normally closed one is inverted nobody says.
std::string LeadshinePr::inputs_told(const Channel& channel) {
  const auto functions = read_if_known(channel, kInputFunctions, 2 * kInputCount);
  const auto inputs = read_if_known(channel, kInputs, 1);
  std::string told;
  for (int i = 0; functions && inputs && i < kInputCount; ++i) {
    const unsigned function = (*functions)[static_cast<std::size_t>(2 * i + 1)] & 0x7Fu;
    const bool on = ((inputs->front() >> static_cast<unsigned>(i)) & 1u) != 0;
    if (function == kUpperLimit || function == kLowerLimit)
      told += fmt::format("; input {}, set up as the {} limit switch, reads {}", i + 1,
                          function == kUpperLimit ? "upper" : "lower", on ? "on" : "off");
  }
  return told;
}

AxisStatus<Steps> LeadshinePr::status(const Channel& channel, Time deadline) {
  // In this order: a drive that has ended stands where it is then asked to be.
  const unsigned word = read(channel, kStatus, 1, deadline)[0];
  const bool running = (word & kRunning) != 0, home_done = (word & kHomeDone) != 0;
  AxisStatus<Steps> status;
  // On the way the position serves the watchdog alone, and the line is busy enough.
  if (Drive& seen = drive(channel); !running || clock().now() - seen.seen_at >= kPositionEvery) {
    const Words position = read(channel, kPosition, 2, deadline);
    status.position = Steps{static_cast<std::int32_t>(joined(position[0], position[1]))};
    const auto guard = lock();
    seen.seen_at = clock().now();
  }
  if ((word & kFault) != 0) {
    const int alarm = read(channel, kAlarm, 1, deadline)[0];
    status.fault = fmt::format(
        "the drive has stopped with alarm 0x{:04X} ({}). Remove the cause, and clear the alarm "
        "with "
        "0x1111 in register 0x1801 or by switching the drive off and on. It stands",
        alarm, alarm_meaning(alarm));
  } else if ((word & kEnabled) == 0) {
    status.fault =
        "the drive is not enabled. Check its enable input, and register 0x000F, which configuring "
        "sets to 1. It stands";
  } else if (!running && !home_done && referenced(channel)) {
    status.fault =
        "the drive was switched off and on again, or another master has used it: it no longer says "
        "that it has been homed. It counts itself";
  } else if (!running && halted_short(channel, *status.position, home_done)) {
    status.fault = limit_told(channel);
  }
  const auto guard = lock();
  Drive& d = drive(channel);
  d.ran |= running;
  d.home_begun = d.home_begun || running || !home_done;
  // Some may say so at the switch already, before they go on to the stop position.
  if (!home_done || running || !d.home_begun)
    d.home_said.reset();
  else if (!d.home_said)
    d.home_said = clock().now();
  if (d.home_said && ((status.position && status.position->count == 0) ||
                      clock().now() - *d.home_said >= kOnToStopPosition))
    d.homing = false;
  status.motion = running ? Motion::kMoving : d.homing ? Motion::kUnknown : Motion::kEnded;
  return status;
}

bool LeadshinePr::may_be_homed(const Channel& channel) {
  return (read(channel, kStatus, 1)[0] & kHomeDone) != 0;
}

void LeadshinePr::send_stop(const Channel& channel, bool immediate) {
  const ModbusMaster::Urgent urgent(master_);
  drive(channel).goal.reset();
  drive(channel).ran = false;
  if (!immediate) return write(channel, kTrigger, kStop);
  Attempts tried;
  tried([&] { write(channel, kStopRamp, 0); });  // else it halts as slowly as before
  tried([&] { write(channel, kTrigger, kStop); });
  tried([&] { write(channel, kStopRamp, drive(channel).stop_ms); });
  tried.rethrow();
}

/// An output that is one bit of a register leaves the others as they are.
void LeadshinePr::switch_output(const OutputConfig& output, bool on) {
  const std::string who = fmt::format("output {} of {}", output.name, config().name);
  const auto address = static_cast<std::uint16_t>(*output.register_at);
  std::uint16_t value = on ? output.on_value : output.off_value;
  if (!output.bit) return write(who, output.slave, address, {&value, 1});
  retried(Time::max(), [&] {
    said([&] { return who; },
         [&] { return fmt::format("switching bit {} of register 0x{:04X}", *output.bit, address); },
         [&] {
           const std::uint16_t others = master_.read_holding(output.slave, address, 1)[0];
           value = static_cast<std::uint16_t>((others & ~output.mask()) | output.bits(on));
           master_.write_register(output.slave, address, value, ModbusMaster::Repeat::kAllowed);
         });
  });
}

}  // namespace

std::unique_ptr<Controller> open_leadshine_pr(ControllerSetup setup) {
  return std::make_unique<LeadshinePr>(std::move(setup));
}

std::string identify_leadshine_pr(SharedLine line, Clock& clock) {
  ModbusMaster master(std::move(line), clock, ModbusMaster::Framing::kRtu, kIdentify);
  std::string slaves;
  for (int slave = 1; slave <= kIdentifiedSlaves; ++slave) {
    try {
      master.read_holding(slave, kStatus, 1);
      master.read_holding(slave, kPosition, 2);
      slaves += fmt::format(" {}", slave);
    } catch (const TimeoutError&) {
    } catch (const ProtocolError&) {
    } catch (const ModbusException&) {
    }
  }
  return slaves.empty() ? "" : "Leadshine drives in PR mode, slaves" + slaves;
}

}  // namespace turntable
