#include "drivers/sim/leadshine.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "drivers/sim/modbus_framer.h"
#include "src/core/errors.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;
using Words = std::map<std::uint16_t, std::uint16_t>;

constexpr int kBroadcast = 0, kLastSlave = 31;
constexpr int kInputs = 7, kOutputs = 3;  ///< of a drive

// Exceptions.
constexpr int kNoFunction = 0x01, kNoRegister = 0x02, kBadValue = 0x03, kGatewayTargetSilent = 0x0B;

constexpr std::uint16_t kOvercurrent = 0x0001, kEmergencyInput = 0x1000;
constexpr std::uint16_t kNothingSaved = 0x1111, kSaved = 0x5555;
constexpr Time kJogRepeat = milliseconds{50};
constexpr double kEncoderCounts = 65536;  ///< per revolution, of an iCL-RS
constexpr Time kSpeedWindow = milliseconds{20};

/// Ends the handling of a request.
struct Refused {
  int exception;
};

std::uint16_t high(std::int64_t value) {
  return static_cast<std::uint16_t>(static_cast<std::uint32_t>(value) >> 16u);
}
std::uint16_t low(std::int64_t value) {
  return static_cast<std::uint16_t>(static_cast<std::uint32_t>(value) & 0xFFFFu);
}

void put(Words& words, std::uint16_t address, std::int64_t value) {
  words[address] = high(value);
  words[static_cast<std::uint16_t>(address + 1)] = low(value);
}

/// Parameters are pairs whose low word is at the odd address.
bool parameter(std::uint16_t address) { return address < 0x1000; }

Words factory_words(int slave) {
  Words words;
  const auto parameters = [&](int first, int last, std::uint16_t value) {
    for (int a = first; a <= last; a += 2) put(words, static_cast<std::uint16_t>(a - 1), value);
  };
  parameters(0x0001, 0x0001, 10000);
  parameters(0x0003, 0x0003, 0);
  parameters(0x0007, 0x0007, 0);
  parameters(0x0005, 0x0005, 1);     // source of the control mode
  parameters(0x0009, 0x0009, 1499);  // inductance, uH
  parameters(0x000F, 0x000F, 1);
  parameters(0x00A1, 0x00A1, 15);  // command filter, 0.1 ms
  parameters(0x0145, 0x0151, 0);
  parameters(0x0157, 0x015B, 0);
  parameters(0x0167, 0x0169, 0);  // brake
  parameters(0x0191, 0x0191, 10);
  parameters(0x0197, 0x0197, 100);  // current that locks the shaft, %
  parameters(0x01BD, 0x01BD, 4);
  parameters(0x01BF, 0x01BF, static_cast<std::uint16_t>(slave));
  parameters(0x01C1, 0x01C1, 4);     // data format
  parameters(0x01D1, 0x01D1, 500);   // ms until the standby current
  parameters(0x01D3, 0x01D3, 50);    // standby current, %
  parameters(0x01E1, 0x01E1, 60);    // jog, rpm
  parameters(0x01E3, 0x01E5, 100);   // jog: pause, time
  parameters(0x01E7, 0x01E7, 100);   // jog: ramp
  parameters(0x0233, 0x0233, 4000);  // encoder
  words[0x6000] = 0;
  words[0x6001] = 0;
  for (std::uint16_t a = 0x6006; a <= 0x601A; ++a) words[a] = 0;
  for (const int a : {0x6011, 0x6012, 0x6016, 0x6017}) words[static_cast<std::uint16_t>(a)] = 100;
  for (std::uint16_t a = 0x6200; a < 0x6280; ++a) words[a] = 0;
  return words;
}

std::uint16_t to_word(double value) {
  return static_cast<std::uint16_t>(std::clamp<long>(std::lround(value), 1, 32767));
}

/// As the rig of `axis` is described in the facts.
Words rig_words(const AxisConfig& axis, int slave) {
  Words words = factory_words(slave);
  const double rpm = 60.0 / (axis.per_step() * axis.steps_per_rev);
  const std::uint16_t ramp = to_word(1e6 / (axis.acceleration * rpm));
  const std::uint16_t fast = to_word(axis.home_speed * rpm);
  words[0x0001] = static_cast<std::uint16_t>(axis.steps_per_rev);
  words[0x0145] = 0x88;  // enable, normally closed, as from the factory
  words[0x0147] = 0x25;
  words[0x0149] = 0x26;
  words[0x014B] = 0x27;
  words[0x6000] = 0x0002;
  put(words, 0x6006, std::llround(axis.upper / axis.per_step()));
  put(words, 0x6008, std::llround(axis.lower / axis.per_step()));
  words[0x600A] = 0x0006;
  words[0x600F] = fast;
  words[0x6010] = std::min(fast, to_word(axis.initial_speed * rpm));
  words[0x6011] = words[0x6012] = ramp;
  words[0x6017] = to_word(1000 * axis.speed / axis.acceleration);
  words[0x6016] = std::min<std::uint16_t>(words[0x6017], 50);
  return words;
}

/// What a register may hold.
bool allowed(std::uint16_t address, std::uint16_t value) {
  if (parameter(address) && address % 2 == 0) return value == 0;
  switch (address) {
    case 0x0001:
      return value >= 200 && value <= 51200;
    case 0x0003:
      return value == 0 || value == 2;
    case 0x0007:
    case 0x000F:
      return value <= 1;
    case 0x00A1:
      return value <= 512;
    case 0x01BD:
      return value <= 6;
    case 0x01BF:
      return value >= 1 && value <= kLastSlave;
    case 0x1801:
      return value == 0x1111 || value == 0x1122 || value == 0x2211 || value == 0x2233 ||
             value == 0x2222 || value == 0x2244 || value == 0x4001 || value == 0x4002;
    case 0x6002:
      return (value >= 0x10 && value <= 0x1F) || value == 0x20 || value == 0x21 || value == 0x40;
    default:
      return true;
  }
}

struct Drive {
  AxisModel* axis;
  int slave;
  Words words, saved;  ///< now, and what a power cycle brings back
  enum class Doing { kNothing, kPath, kHome } doing = Doing::kNothing;
  std::int64_t goal = 0;        ///< of a path, pulses
  unsigned commands = 0;        ///< motions so far
  bool home_done = false;       ///< also the way to the stop position
  std::uint16_t trigger = 0;    ///< last written to 0x6002
  std::uint16_t warning = 0;    ///< 0x601D
  Words inputs{};               ///< functions of the inputs, as they were at power-up
  bool switch_to_come = false;  ///< has moved, and met no limit switch since
  std::uint16_t alarm = 0;      ///< until it is cleared
  std::uint16_t save_word = kNothingSaved;
  int jog = 0;  ///< direction
  Time jog_until{0};

  std::uint16_t at(std::uint16_t address) const { return words.at(address); }
  std::int32_t pair(std::uint16_t address) const {
    return static_cast<std::int32_t>(static_cast<std::uint32_t>(at(address)) << 16u |
                                     at(static_cast<std::uint16_t>(address + 1)));
  }
  /// Way of the table in one revolution of the motor, in the direction that counts as positive.
  double per_revolution() const {
    const AxisConfig& config = axis->config();
    return config.per_step() * config.steps_per_rev * (at(0x0007) == 1 ? -1 : 1);
  }
  double per_pulse() const { return per_revolution() / at(0x0001); }
  std::int64_t pulses(Time t) const {
    return std::llround(axis->counter_position(t) / per_pulse());
  }
  double rpm(Time t) const {
    const Time before = std::max(t - kSpeedWindow, Time{0});
    if (before == t || !axis->moving(t)) return 0;
    return static_cast<double>(pulses(t) - pulses(before)) / at(0x0001) * 60 / seconds(t - before);
  }
  Ramp ramp(double rpm, int ms, double initial_rpm = 0) const {
    const double turn = std::abs(per_revolution());
    return {initial_rpm / 60 * turn, rpm / 60 * turn, 1e6 / std::max(ms, 1) / 60 * turn};
  }
  bool soft_limits() const { return (at(0x6000) & 0x0002u) != 0; }
  /// Bit n - 1: input n. Guess: as the switch is, whether it counts as closed or open.
  std::uint16_t input_word(Time t, bool emergency_stop) const {
    unsigned word = 0;
    for (int i = 0; i < kInputs; ++i) {
      const auto function = inputs.at(static_cast<std::uint16_t>(0x0145 + 2 * i));
      const unsigned what = function & 0x7Fu;
      const bool on = (what == 0x25 && axis->upper_switch(t)) ||
                      (what == 0x26 && axis->lower_switch(t)) ||
                      (what == 0x27 && axis->home_switch(t)) || (what == 0x22 && emergency_stop);
      if (on) word |= 1u << static_cast<unsigned>(i);
    }
    return static_cast<std::uint16_t>(word);
  }
};

class Leadshine final : public ControllerSimulator {
 public:
  Leadshine(const SimulatorSetup& setup, LeadshineGuesses guesses);

 protected:
  void receive(std::string_view bytes, Time now) override;
  void power_up(Time now) override;
  std::string refusal(const std::string&) override { return {}; }  // each request makes its own
  void forget_input() override { framer_.forget(); }

 private:
  void take(const ModbusRequest& request, Time now);
  std::string carry_out(Drive& drive, const ModbusRequest& request, Time now);
  std::uint16_t alarm_of(Drive& drive, Time now);
  bool able(Drive& drive, Time now) { return drive.at(0x000F) == 1 && alarm_of(drive, now) == 0; }
  std::uint16_t status_of(Drive& drive, Time now);
  std::uint16_t read(Drive& drive, std::uint16_t address, Time now);
  void write(Drive& drive, std::uint16_t address, std::uint16_t value, Time now);
  void control(Drive& drive, std::uint16_t word, Time now);
  void trigger(Drive& drive, std::uint16_t word, Time now);
  void note_limit(Drive& drive, Time now);
  void begin(Drive& drive, Drive::Doing doing);
  void run_path(Drive& drive, int path, Time now);
  void run_on(Drive& drive, int direction, Ramp ramp, Time now);
  void home(Drive& drive, Time now);
  void jog(Drive& drive, int direction, Time now);

  bool gateway_;
  LeadshineGuesses guesses_;
  ModbusFramer framer_;
  std::vector<Drive> drives_;
};

Leadshine::Leadshine(const SimulatorSetup& setup, LeadshineGuesses guesses)
    : ControllerSimulator(setup),
      gateway_(setup.controller.line.kind == LineConfig::Kind::kModbusTcp),
      guesses_(guesses),
      framer_(gateway_) {
  for (const auto& axis : axes()) {
    const std::string& channel = axis->config().channel;
    int slave = 0;
    const auto [end, error] =
        std::from_chars(channel.data(), channel.data() + channel.size(), slave);
    if (error != std::errc() || end != channel.data() + channel.size() || slave < 1 ||
        slave > kLastSlave)
      throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(axis->config().id)),
                        fmt::format("found \"{}\", simulated: slaves 1 to 31.", channel));
    Drive drive;
    drive.axis = axis.get();
    drive.slave = slave;
    drive.words = rig_words(axis->config(), slave);
    for (const OutputConfig& output : config().outputs)
      if (output.register_at && output.slave == slave)
        drive.words.emplace(static_cast<std::uint16_t>(*output.register_at), output.off_value);
    drive.saved = drive.inputs = drive.words;
    drives_.push_back(std::move(drive));
  }
}

void Leadshine::power_up(Time now) {
  for (Drive& drive : drives_) {
    drive.words = drive.inputs = drive.saved;
    drive.slave = drive.at(0x01BF);
    drive.doing = Drive::Doing::kNothing;
    drive.alarm = 0;
    drive.save_word = kNothingSaved;
    drive.jog = 0;
    drive.home_done = false;
    drive.trigger = drive.warning = 0;
    ++drive.commands;
    if ((drive.at(0x6000) & 0x0004u) != 0) home(drive, now);  // nobody has asked for that
  }
}

// ---- requests

void Leadshine::receive(std::string_view bytes, Time now) {
  framer_.feed(bytes, now, silence());
  while (const auto request = framer_.next()) take(*request, now);
}

/// The word that triggers something, if the request writes one: to 0x6002, or as the last of path
/// 0's block, which is then run at once.
std::optional<std::uint16_t> trigger_in(const ModbusRequest& request) {
  for (std::size_t i = 0; i < request.values.size(); ++i) {
    const std::size_t address = request.address + i;
    if (address == 0x6002 || (address == 0x6207 && request.values[i] == 0x0010))
      return request.values[i];
  }
  return std::nullopt;
}

ControllerSimulator::Request told(const ModbusRequest& request) {
  ControllerSimulator::Request r;
  r.verb = request.function == 6
               ? fmt::format("0x{:04X}=0x{:02X}", request.address, request.values[0])
               : fmt::format("fc{:02}", request.function);
  const auto reads = [&](int address) {
    return request.address <= address && address < request.address + request.count;
  };
  if (request.values.empty()) {
    r.kind = reads(0x1003) || reads(0x602A) ? "status" : "get";
    return r;
  }
  const int trigger = trigger_in(request).value_or(0);
  const bool jogs = request.address == 0x1801 && (request.values[0] & 0xFF00u) == 0x4000;
  r.kind = jogs || (trigger >= 0x10 && trigger <= 0x1F) ? "move"
           : trigger == 0x20                            ? "home"
           : trigger == 0x40                            ? "stop"
                                                        : "set";
  return r;
}

void Leadshine::take(const ModbusRequest& request, Time now) {
  Request noted = told(request);
  if (request.slave == kBroadcast) {
    serve(std::move(noted), now, [&] {
      if (!request.values.empty())
        for (Drive& drive : drives_) carry_out(drive, request, now);
      return std::string();
    });
    return;
  }
  const auto drive = std::ranges::find(drives_, request.slave, &Drive::slave);
  if (drive == drives_.end()) {
    if (gateway_) send(framer_.exception(request, kGatewayTargetSilent));
    return;
  }
  noted.axis = drive->axis->config().id;
  serve(
      std::move(noted), now, [&] { return carry_out(*drive, request, now); },
      [&](const std::string& text) {
        int code = 0;
        const auto end = text.data() + text.size();
        const bool number = std::from_chars(text.data(), end, code, 16).ptr == end;
        return framer_.exception(request, number && code > 0 && code <= 0xFF ? code : 0x04);
      });
}

std::string Leadshine::carry_out(Drive& drive, const ModbusRequest& request, Time now) {
  constexpr std::size_t kMostRegisters = 125;
  try {
    if (request.function != 3 && request.function != 6 && request.function != 16)
      throw Refused{kNoFunction};
    if (request.function == 3) {
      if (request.count == 0 || request.count > kMostRegisters) throw Refused{kBadValue};
      std::vector<std::uint16_t> values;
      for (int i = 0; i < request.count; ++i)
        values.push_back(read(drive, static_cast<std::uint16_t>(request.address + i), now));
      return framer_.words(request, values);
    }
    if (request.function == 16 && (request.count == 0 || request.count != request.values.size()))
      throw Refused{kBadValue};
    const auto each = [&](auto&& action) {
      for (std::size_t i = 0; i < request.values.size(); ++i)
        action(static_cast<std::uint16_t>(request.address + i), request.values[i]);
    };
    each([&](std::uint16_t address, std::uint16_t value) {  // all, or nothing
      if (address != 0x1801 && address != 0x6002 && !drive.words.contains(address))
        throw Refused{kNoRegister};
      if (!allowed(address, value)) throw Refused{kBadValue};
    });
    each([&](std::uint16_t address, std::uint16_t value) { write(drive, address, value, now); });
    return framer_.confirmation(request);
  } catch (const Refused& refused) {
    return framer_.exception(request, refused.exception);
  }
}

// ---- registers

std::uint16_t Leadshine::alarm_of(Drive& drive, Time now) {
  if (guesses_.limit_alarm != 0 && drive.switch_to_come && !drive.axis->moving(now) &&
      (drive.axis->lower_switch(now) || drive.axis->upper_switch(now))) {
    drive.switch_to_come = false;
    drive.alarm = guesses_.limit_alarm;
  }
  if (emergency_stop()) return kEmergencyInput;
  if (drive.alarm != 0) return drive.alarm;
  return alarm(drive.axis->config().id) ? kOvercurrent : 0;
}

std::uint16_t Leadshine::status_of(Drive& drive, Time now) {
  const bool alarmed = alarm_of(drive, now) != 0, moving = drive.axis->moving(now);
  const bool done =
      !moving && ((drive.doing == Drive::Doing::kPath && drive.pulses(now) == drive.goal) ||
                  (drive.doing == Drive::Doing::kHome && drive.home_done));
  return static_cast<std::uint16_t>(
      (alarmed ? 0x01 : 0) | (!alarmed && drive.at(0x000F) == 1 ? 0x02 : 0) | (moving ? 0x04 : 0) |
      (done ? 0x30 : 0) | (drive.home_done ? 0x40 : 0));
}

std::uint16_t Leadshine::read(Drive& drive, std::uint16_t address, Time now) {
  const auto half = [&](std::int64_t value) { return address % 2 == 0 ? high(value) : low(value); };
  note_limit(drive, now);
  switch (address) {
    case 0x0176:
    case 0x0178:
    case 0x017A:
    case 0x017B:  // outputs
    case 0x0186:
    case 0x0187:  // switches on its case
    case 0x01FE:
    case 0x0200:
      return 0;
    case 0x0177:
      return 240;  // of the supply, 0.1 V
    case 0x0179:
      return drive.input_word(now, emergency_stop());
    case 0x01FF:
    case 0x0201:
      return 100;  // version, firmware
    case 0x1001:
      return 0;
    case 0x1003:
      return status_of(drive, now);
    case 0x1010:  // following error
    case 0x1011:
      return 0;
    case 0x1012:
    case 0x1013:
      return half(drive.pulses(now));
    case 0x1014:
    case 0x1015:  // of the encoder, which has a scale of its own
      return half(
          std::llround(static_cast<double>(drive.pulses(now)) / drive.at(0x0001) * kEncoderCounts));
    case 0x1044:
    case 0x1045:
    case 0x1046:
    case 0x1047:
      return half(std::lround(drive.rpm(now)));
    case 0x1801:
      return 0;
    case 0x601C:
      return 0;
    case 0x601D:
      return drive.warning;
    case 0x602E:
      return drive.input_word(now, emergency_stop());
    case 0x6002:  // 0x010P: path P runs, 0x000P: it is there
      return static_cast<std::uint16_t>((drive.axis->moving(now) ? 0x100u : 0u) |
                                        (drive.trigger & 0x0Fu));
    case 0x1901:
      return std::exchange(drive.save_word, kNothingSaved);
    case 0x2203:
      return alarm_of(drive, now);
    case 0x602A:
    case 0x602B:
    case 0x602C:
    case 0x602D:
      return half(drive.pulses(now));
    default:
      if (const auto word = drive.words.find(address); word != drive.words.end())
        return word->second;
      if (address > 0x1003 && address < 0x1016) return 0;  // a client reads these as one block
      throw Refused{kNoRegister};
  }
}

void Leadshine::write(Drive& drive, std::uint16_t address, std::uint16_t value, Time now) {
  if (address == 0x1801) return control(drive, value, now);
  if (address == 0x6002) return trigger(drive, value, now);
  drive.words[address] = value;
  if (address == 0x6207 && value == 0x0010) trigger(drive, value, now);
  if (address == 0x000F && value == 0) drive.axis->stop(now, true);
  for (const OutputConfig& output : config().outputs)
    if (output.register_at == address && output.slave == drive.slave &&
        (value == output.on_value || value == output.off_value))
      switch_output(output.name, value == output.on_value);
}

void Leadshine::control(Drive& drive, std::uint16_t word, Time now) {
  switch (word) {
    case 0x1111:
      drive.alarm = 0;
      clear_alarm(drive.axis->config().id);
      return;
    case 0x2211:
      drive.saved = drive.words;
      drive.save_word = kSaved;
      return;
    case 0x2233:
      for (const auto& [address, value] : factory_words(drive.slave)) drive.words[address] = value;
      drive.saved = drive.words;
      return;
    case 0x4001:
    case 0x4002:
      return jog(drive, word == 0x4001 ? 1 : -1, now);
    default:
      return;  // the history of alarms is not kept
  }
}

// ---- motion

void Leadshine::trigger(Drive& drive, std::uint16_t word, Time now) {
  drive.trigger = word;
  if (word == 0x40) {
    drive.doing = Drive::Doing::kNothing;
    drive.jog = 0;
    const int ms = drive.at(0x6017);
    drive.axis->stop(now, ms == 0, ms / 1000.0);
  } else if (word == 0x20) {
    home(drive, now);
  } else if (word == 0x21) {
    if (!drive.axis->moving(now)) drive.axis->set_counter(now, 0.0);
  } else {
    run_path(drive, word - 0x10, now);
  }
}

/// A path or a homing that met a limit switch has left a warning.
void Leadshine::note_limit(Drive& drive, Time now) {
  if (drive.doing == Drive::Doing::kNothing || drive.axis->moving(now) ||
      !(drive.axis->lower_switch(now) || drive.axis->upper_switch(now)))
    return;
  if (drive.doing == Drive::Doing::kHome && !drive.home_done) drive.warning = 0x0100;
  if (drive.doing == Drive::Doing::kPath && drive.pulses(now) != drive.goal)
    drive.warning = static_cast<std::uint16_t>(0x0200 + (drive.trigger & 0x0Fu));
}

void Leadshine::begin(Drive& drive, Drive::Doing doing) {
  drive.doing = doing;
  drive.warning = 0;
  drive.jog = 0;
  drive.switch_to_come = true;
  ++drive.commands;
}

void Leadshine::run_path(Drive& drive, int path, Time now) {
  const auto base = static_cast<std::uint16_t>(0x6200 + 8 * path);
  const auto word = [&](int i) { return drive.at(static_cast<std::uint16_t>(base + i)); };
  const int mode = word(0), rpm = static_cast<std::int16_t>(word(3));
  if (!able(drive, now) || rpm == 0) return;
  const Ramp ramp = drive.ramp(std::abs(rpm), std::max(word(4), word(5)));
  if (mode == 0x0002) {
    begin(drive, Drive::Doing::kNothing);
    return run_on(drive, rpm > 0 ? 1 : -1, ramp, now);
  }
  if (mode != 0x0001 && mode != 0x0041) return;
  const std::int64_t goal =
      drive.pair(static_cast<std::uint16_t>(base + 1)) + (mode == 0x0041 ? drive.pulses(now) : 0);
  begin(drive, Drive::Doing::kNothing);
  if (drive.soft_limits() && (goal > drive.pair(0x6006) || goal < drive.pair(0x6008))) return;
  if (goal != static_cast<std::int32_t>(goal)) return;
  drive.doing = Drive::Doing::kPath;
  drive.goal = goal;
  drive.axis->move_to(now, static_cast<double>(goal) * drive.per_pulse(), ramp);
}

/// Until something stops it: a soft limit, or the end of the mechanics.
void Leadshine::run_on(Drive& drive, int direction, Ramp ramp, Time now) {
  const AxisModel& axis = *drive.axis;
  const double far = 2 * (axis.hard_upper() - axis.hard_lower());
  const double sign = drive.per_pulse() > 0 ? 1 : -1;
  const double goal = drive.soft_limits()
                          ? drive.pair(direction > 0 ? 0x6006 : 0x6008) * drive.per_pulse()
                          : axis.counter_position(now) + direction * sign * far;
  drive.axis->move_to(now, goal, ramp);
}

void Leadshine::home(Drive& drive, Time now) {
  const int fast = drive.at(0x600F), slow = drive.at(0x6010);
  if (!able(drive, now) || fast == 0 || slow == 0) return;
  begin(drive, Drive::Doing::kHome);
  drive.home_done = false;
  const Ramp ramp = drive.ramp(fast, std::max(drive.at(0x6011), drive.at(0x6012)), slow);
  // The switch is seen in full motion. Whole pulses, and at least one.
  const double halt = ramp.initial_speed * ramp.initial_speed / (2 * ramp.acceleration);
  const double overshoot =
      std::max(1.0, std::ceil(halt / drive.axis->per_step() - 1e-6)) * drive.axis->per_step();
  const bool goes_on = (drive.at(0x600A) & 0x0002u) != 0;
  const double origin = drive.pair(0x600B) * drive.per_pulse();
  const double stop_at = drive.pair(0x600D) * drive.per_pulse();
  drive.axis->home(now, ramp, (drive.at(0x600A) & 0x0001u) != 0 ? -overshoot : overshoot,
                   goes_on ? std::optional(stop_at - origin) : std::nullopt);
  const auto end = drive.axis->ends_at();
  if (!end) return;
  later(*end, [&drive, origin, command = drive.commands](Time t) {
    if (drive.commands != command || !drive.axis->homed(t)) return;
    drive.axis->set_counter(t, drive.axis->counter_position(t) + origin);
    drive.home_done = true;
  });
}

void Leadshine::jog(Drive& drive, int direction, Time now) {
  if (!able(drive, now)) return;
  if (drive.jog != direction) {
    begin(drive, Drive::Doing::kNothing);
    drive.jog = direction;
    run_on(drive, direction, drive.ramp(std::max<int>(drive.at(0x01E1), 1), 100), now);
  }
  drive.jog_until = now + kJogRepeat;
  later(drive.jog_until, [&drive](Time t) {
    if (drive.jog == 0 || t < drive.jog_until) return;
    drive.jog = 0;
    drive.axis->stop(t);
  });
}

}  // namespace

std::unique_ptr<ControllerSimulator> simulate_leadshine(const SimulatorSetup& setup,
                                                        LeadshineGuesses guesses) {
  return std::make_unique<Leadshine>(setup, guesses);
}

}  // namespace turntable::sim
