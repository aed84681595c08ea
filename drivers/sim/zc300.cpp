#include "drivers/sim/zc300.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <map>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/sim/modbus_framer.h"
#include "src/core/errors.h"
#include "src/core/random.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;

// Registers by the manual's numbers, which count from 1.
constexpr int kFirstInput = 30001, kLastInput = 30049;
constexpr int kFirstHolding = 30050, kLastHolding = 30140;
constexpr int kModel = 30001, kSerial = 30008, kFirmware = 30010;
constexpr int kMoving = 30012, kBits = 30015, kPosition = 30016, kUnitNow = 30022;
constexpr int kOpcode = 30050, kLastOfOpcode = 30053;
constexpr int kOutputs = 30065, kOutputCount = 3;
constexpr int kAddress = 30069, kBeeper = 30070, kBacklight = 30071;
/// Registers that the manual reserves, of which nothing is said: they read 0 and take no writes.
constexpr std::array<std::pair<int, int>, 2> kReserved{{{30054, 30058}, {30096, 30098}}};
bool reserved(int number) {
  return std::ranges::any_of(kReserved, [&](const auto& range) {
    return number >= range.first && number <= range.second;
  });
}

constexpr std::string_view kModelText = "ZC300-3A";
constexpr std::uint32_t kSerialNumber = 26017;
constexpr std::uint16_t kFirmwareTimesTen = 12;
constexpr Time kSaveTime = milliseconds{1060};
// As measured on a real device by its user: 57 to 73 ms between a request and its answer.
constexpr double kFastestReply_s = 0.057, kSlowestReply_s = 0.073;
/// How many of the motions that end make the controller miss the next request: a guess, as "one request
/// is missed occasionally" is all that is known.
constexpr double kMissed = 0.05;

// Bounds of values, in pulses where they depend on the unit.
constexpr double kMostPulses = 1e7, kMostLead = 1000, kMostRatio = 10000;
constexpr double kLeastCoordinate = -99999999;

/// Exception codes.
enum Code : int {
  kUnknownFunction = 0x01,
  kNoRegister = 0x02,
  kBadLength = 0x03,
  kNotSaved = 0x04,
  kBadData = 0x05,
  kIsMoving = 0x06,
  kAtLimit = 0x07,
  kEmergency = 0x08,
  kNotEnabled = 0x09,
  kUnknownOpcode = 0x0A
};

/// Ends the handling of a request.
struct Refused {
  int code;
};

/// Per axis: X first, Y and Z after it.
struct Field {
  enum Item {
    kCoordinate,
    kEnable,
    kUnit,
    kPulsesPerRev,
    kStageType,
    kLead,
    kRatio,
    kHomeSpeed,
    kHomeMode,
    kMotionKind,
    kMotionMode,
    kDistance,
    kStopMode,
    kInitialSpeed,
    kSpeed,
    kAcceleration
  };
  int first, words;
  Item item;
};
constexpr std::array<Field, 16> kFields{{{30059, 2, Field::kCoordinate},
                                         {30066, 1, Field::kEnable},
                                         {30072, 1, Field::kUnit},
                                         {30075, 2, Field::kPulsesPerRev},
                                         {30081, 1, Field::kStageType},
                                         {30084, 2, Field::kLead},
                                         {30090, 2, Field::kRatio},
                                         {30099, 2, Field::kHomeSpeed},
                                         {30105, 1, Field::kHomeMode},
                                         {30108, 1, Field::kMotionKind},
                                         {30111, 1, Field::kMotionMode},
                                         {30114, 2, Field::kDistance},
                                         {30120, 1, Field::kStopMode},
                                         {30123, 2, Field::kInitialSpeed},
                                         {30129, 2, Field::kSpeed},
                                         {30135, 2, Field::kAcceleration}}};

/// A field's place: which axis, and its first register.
struct Place {
  const Field* field;
  std::size_t axis;
  int first;
};

std::optional<Place> place_of(int number) {
  for (const Field& field : kFields)
    if (number >= field.first && number < field.first + 3 * field.words) {
      const int axis = (number - field.first) / field.words;
      return Place{&field, static_cast<std::size_t>(axis), field.first + axis * field.words};
    }
  return std::nullopt;
}

std::uint16_t high(std::uint32_t value) { return static_cast<std::uint16_t>(value >> 16u); }
std::uint16_t low(std::uint32_t value) { return static_cast<std::uint16_t>(value & 0xFFFFu); }
std::uint32_t bits_of(double value) {
  return std::bit_cast<std::uint32_t>(static_cast<float>(value));
}
double finite(std::uint32_t raw) {
  const double value = std::bit_cast<float>(raw);
  if (!std::isfinite(value)) throw Refused{kBadData};
  return value;
}
int up_to(std::uint32_t raw, int least, int most) {
  if (raw < static_cast<std::uint32_t>(least) || raw > static_cast<std::uint32_t>(most))
    throw Refused{kBadData};
  return static_cast<int>(raw);
}

/// What is kept in flash. Speeds in pulses/s and the distance in pulses: in mm or deg they depend on
/// what makes the scale. These are the factory's, as far as they are known.
struct Settings {
  int unit = 1;  ///< 0 pulses, 1 mm, 2 deg
  double pulses_per_rev = 1600;
  int stage_type = 0;  ///< 0 linear, 1 rotary
  double lead = 4;     ///< mm per revolution, of a linear stage
  double ratio = 1;    ///< revolutions of the motor to one of a rotary stage
  double initial_speed = 800, speed = 8000, acceleration = 12000, home_speed = 4000;
  int home_mode = 3;       ///< 1 user's origin, 2 negative limit, 3 home switch
  int motion_kind = 0x4A;  ///< 4Ah jog, 43h endless: of the keys on the front
  int motion_mode = 0x52;  ///< 52h relative, 41h absolute: the same
  double distance = 0;
  int stop_mode = 1;  ///< 0 immediate, 1 decelerates

  /// Units per pulse. Whether the lead counts for a rotary stage too is not known: here it does not.
  double scale() const {
    if (unit == 0) return 1.0;
    return stage_type == 1 ? 360.0 / (pulses_per_rev * ratio) : lead / pulses_per_rev;
  }
};

struct Channel {
  AxisModel* axis = nullptr;
  Settings set, saved;
  bool enabled = true;
  bool running = false;
  std::optional<double> coordinate{};  ///< pulses; while a write is being taken

  bool moving(Time now) const { return axis != nullptr && axis->moving(now); }
  double pulses(Time now) const {
    return axis == nullptr ? 0.0 : std::round(axis->counter_position(now) / axis->per_step());
  }
  Ramp ramp(double cruise) const {
    const double per_pulse = axis->per_step();
    // A ramp from standstill: the slow part of a homing has to have some speed.
    const double initial = set.initial_speed > 0 ? set.initial_speed : 0.1 * cruise;
    return {initial * per_pulse, cruise * per_pulse, set.acceleration * per_pulse};
  }
};

class Zc300 final : public ControllerSimulator {
 public:
  explicit Zc300(const SimulatorSetup& setup);

 protected:
  void receive(std::string_view bytes, Time now) override;
  void happen(Time now) override;
  std::optional<Time> next_own() const override;
  void power_up(Time now) override;
  std::string refusal(const std::string& text) override;
  void forget_input() override { framer_.forget(); }
  Time own_reply_delay() override {
    return from_seconds(
        Random(seed_, "zc300 reply", requests_).uniform(kFastestReply_s, kSlowestReply_s));
  }

 private:
  void take(const ModbusRequest& request, Time now);
  Request described(const ModbusRequest& request) const;
  bool is_elsewhere(const ModbusRequest& request) const;
  std::string answer(const ModbusRequest& request, Time now);
  std::string elsewhere(const ModbusRequest& request);
  void tell_outputs(unsigned before, unsigned now);
  std::uint16_t word(int number, Time now) const;
  std::uint16_t status_bits(Time now) const;
  std::uint32_t raw(const Place& place, Time now) const;
  void write(int first, const std::vector<std::uint16_t>& values, Time now);
  void set(Channel& channel, Field::Item item, std::uint32_t raw, Time now) const;
  std::string command(const ModbusRequest& request, Time now);
  std::vector<Channel*> chosen(std::uint16_t axis);
  void begin(const std::vector<Channel*>& channels, int opcode, double sign, Time now);
  bool any_moves(Time now) const {
    return std::ranges::any_of(channels_, [&](const Channel& c) { return c.moving(now); });
  }

  ModbusFramer framer_;
  ModbusRequest current_;
  std::array<Channel, 3> channels_;
  std::array<std::uint16_t, kLastHolding - kFirstHolding + 1> plain_{};  ///< without a meaning here
  int address_, saved_address_;
  /// Of other slaves on the same bus, which an output of the rig file names: by slave and wire address.
  std::map<std::pair<int, int>, std::uint16_t> others_;
  std::uint64_t seed_;
  std::uint64_t requests_ = 0, ends_ = 0;  ///< seen so far: what a draw is addressed by
  bool deaf_ = false;  ///< a motion has just ended, and the next request is missed
};

Zc300::Zc300(const SimulatorSetup& setup)
    : ControllerSimulator(setup),
      framer_(setup.controller.line.kind == LineConfig::Kind::kModbusTcp),
      address_(setup.controller.address),
      saved_address_(address_),
      seed_(setup.seed) {
  for (const OutputConfig& output : setup.controller.outputs)
    if (output.register_at && output.slave != address_)
      others_[{output.slave, *output.register_at}] =
          output.bit ? std::uint16_t{0} : output.off_value;
  for (const auto& axis : axes()) {
    const AxisConfig& config = axis->config();
    constexpr std::string_view kLetters = "XYZxyz";
    const std::size_t at =
        config.channel.size() == 1 ? kLetters.find(config.channel[0]) : std::string_view::npos;
    if (at == std::string_view::npos)
      throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(config.id)),
                        fmt::format("found \"{}\", allowed on a ZC300: X, Y, Z.", config.channel));
    Channel& c = channels_[at % 3];
    c.axis = axis.get();
    const bool rotary = config.kind == StageKind::kRotary;
    c.set.unit = rotary ? 2 : 1;
    c.set.stage_type = rotary ? 1 : 0;
    c.set.pulses_per_rev = config.steps_per_rev;
    c.set.lead = rotary ? 360.0 : config.lead_mm;
    c.set.ratio = rotary ? config.drive_ratio : 1.0;
    const double scale = c.set.scale();
    c.set.initial_speed = std::round(config.initial_speed / scale);
    c.set.speed = std::round(config.speed / scale);
    c.set.acceleration = std::round(config.acceleration / scale);
    c.set.home_speed = std::round(config.home_speed / scale);
    c.saved = c.set;
  }
}

// ---- what happens, and when

std::optional<Time> Zc300::next_own() const {
  std::optional<Time> next;
  for (const Channel& c : channels_)
    if (c.running)
      if (const auto end = c.axis->ends_at(); end && (!next || *end < *next)) next = *end;
  return next;
}

void Zc300::happen(Time now) {
  for (Channel& c : channels_) {
    if (!c.running || c.moving(now)) continue;
    c.running = false;
    if (Random(seed_, "zc300 missed request", ends_++).uniform() < kMissed) deaf_ = true;
  }
}

void Zc300::power_up(Time) {
  for (Channel& c : channels_) {
    AxisModel* const axis = c.axis;
    const Settings saved = c.saved;
    c = {};
    c.axis = axis;
    c.set = c.saved = saved;
  }
  plain_ = {};
  address_ = saved_address_;
  deaf_ = false;
}

void Zc300::receive(std::string_view bytes, Time now) {
  framer_.feed(bytes, now, silence());
  while (const auto request = framer_.next()) take(*request, now);
}

/// Whether an output of the rig file is on that register of another slave on the same bus.
bool Zc300::is_elsewhere(const ModbusRequest& request) const {
  return others_.contains({request.slave, request.address}) && request.function >= 3 &&
         (request.function <= 6 || request.function == 16);
}

ControllerSimulator::Request Zc300::described(const ModbusRequest& request) const {
  Request told{fmt::format("fc{:02}", request.function), "set", {}};
  const auto name_axis = [&](std::size_t index) {
    if (const AxisModel* axis = channels_[index].axis) told.axis = axis->config().id;
  };
  const int first = request.address + 1;
  if (request.function == 3 || request.function == 4) {
    told.kind = request.function == 4 && first <= kMoving && first + request.count > 30021
                    ? "status"
                    : "get";
  } else if (request.function == 16 && first == kOpcode && !request.values.empty()) {
    const int opcode = request.values[0];
    told.verb = fmt::format("0x{:02X}", opcode);
    if (opcode >= 0x64 && opcode <= 0x66) told.kind = "move";
    if (opcode == 0x67 || opcode == 0x68) told.kind = "stop";
    if (opcode == 0x69) told.kind = "home";
    if (request.values.size() > 1 && request.values[1] >= 0x31 && request.values[1] <= 0x33)
      name_axis(request.values[1] - 0x31u);
  }
  if (const auto place = place_of(first)) name_axis(place->axis);
  return told;
}

void Zc300::take(const ModbusRequest& request, Time now) {
  const bool other = request.slave != address_;
  if (other && !is_elsewhere(request)) return;
  current_ = request;
  ++requests_;
  serve(described(request), now, [&]() -> std::string {
    if (!other && std::exchange(deaf_, false)) return {};
    try {
      return other ? elsewhere(request) : answer(request, now);
    } catch (const Refused& refused) {
      return framer_.exception(request, refused.code);
    }
  });
}

/// "08", "0A": what the faults call an exception.
std::string Zc300::refusal(const std::string& text) {
  int code = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), code, 16);
  if (error != std::errc() || end != text.data() + text.size() || code < 1 || code > 0xFF)
    code = kBadData;
  return framer_.exception(current_, code);
}

/// A relay box, say: one holding register.
std::string Zc300::elsewhere(const ModbusRequest& request) {
  std::uint16_t& word = others_.at({request.slave, request.address});
  if (request.function == 3 && request.count == 1) return framer_.words(request, {&word, 1});
  if ((request.function != 6 && request.function != 16) || request.values.size() != 1)
    throw Refused{kUnknownFunction};
  const std::uint16_t before = std::exchange(word, request.values[0]);
  for (const OutputConfig& output : config().outputs) {
    if (output.slave != request.slave || output.register_at != request.address) continue;
    const bool on = (word & output.mask()) == output.bits(true);
    if (on || (word & output.mask()) == output.bits(false))
      if (!output.bit || ((before ^ word) & output.mask()) != 0) switch_output(output.name, on);
  }
  return framer_.confirmation(request);
}

/// Those of the rig file that are on OUT1..3 and have changed.
void Zc300::tell_outputs(unsigned before, unsigned now) {
  for (const OutputConfig& output : config().outputs)
    if (output.slave == config().address && output.register_at == kOutputs - 1 &&
        ((before ^ now) & output.mask()) != 0)
      switch_output(output.name, (now & output.mask()) == output.bits(true));
}

// ---- registers

std::string Zc300::answer(const ModbusRequest& request, Time now) {
  const int first = request.address + 1;
  const auto within = [&](int least, int most, int count) {
    if (first < least || first + count - 1 > most) throw Refused{kNoRegister};
  };
  switch (request.function) {
    case 3:
    case 4: {
      if (request.count < 1 || request.count > 125) throw Refused{kBadLength};
      if (request.function == 4)
        within(kFirstInput, kLastInput, request.count);
      else
        within(kFirstHolding, kLastHolding, request.count);
      std::vector<std::uint16_t> words;
      for (int i = 0; i < request.count; ++i) words.push_back(word(first + i, now));
      return framer_.words(request, words);
    }
    case 6:
      within(kLastOfOpcode + 1, kLastHolding, 1);  // opcodes come by function 16 only
      write(first, request.values, now);
      return framer_.confirmation(request);
    case 16:
      if (request.values.empty() || request.values.size() != request.count)
        throw Refused{kBadLength};
      if (first == kOpcode) return command(request, now);
      within(kLastOfOpcode + 1, kLastHolding, request.count);
      write(first, request.values, now);
      return framer_.confirmation(request);
    default:
      throw Refused{kUnknownFunction};
  }
}

std::uint16_t Zc300::status_bits(Time now) const {
  unsigned bits = 0;
  for (std::size_t i = 0; i < channels_.size(); ++i) {
    const AxisModel* axis = channels_[i].axis;
    if (axis == nullptr || axis->home_switch(now))
      bits |= 4u << 3 * i;  // an open input floats high
    if (axis == nullptr) continue;
    if (axis->upper_switch(now)) bits |= 1u << 3 * i;
    if (axis->lower_switch(now)) bits |= 2u << 3 * i;
    if (alarm(axis->config().id)) bits |= 1u << (10 + i);
  }
  if (emergency_stop()) bits |= 1u << 9;
  return static_cast<std::uint16_t>(bits);
}

std::uint16_t Zc300::word(int number, Time now) const {
  const auto half = [&](int first, std::uint32_t value) {
    return number == first ? high(value) : low(value);
  };
  if (number < kSerial) {
    const auto letter = [&](std::size_t i) -> unsigned {
      return i < kModelText.size() ? static_cast<unsigned char>(kModelText[i]) : 0u;
    };
    const std::size_t at = 2 * static_cast<std::size_t>(number - kModel);
    return static_cast<std::uint16_t>(letter(at) << 8u | letter(at + 1));
  }
  if (number < kFirmware) return half(kSerial, kSerialNumber);
  if (number == kFirmware) return kFirmwareTimesTen;
  if (number >= kMoving && number < kBits)
    return channels_[static_cast<std::size_t>(number - kMoving)].moving(now) ? 1 : 0;
  if (number == kBits) return status_bits(now);
  if (number >= kPosition && number < kUnitNow) {
    const int axis = (number - kPosition) / 2;
    const Channel& c = channels_[static_cast<std::size_t>(axis)];
    return half(kPosition + 2 * axis, bits_of(c.pulses(now) * c.set.scale()));
  }
  if (number >= kUnitNow && number < kUnitNow + 3)
    return static_cast<std::uint16_t>(
        channels_[static_cast<std::size_t>(number - kUnitNow)].set.unit);
  if (number < kFirstHolding) return 0;
  if (number == kAddress) return static_cast<std::uint16_t>(address_);
  if (const auto place = place_of(number)) {
    const std::uint32_t value = raw(*place, now);
    return place->field->words == 1 ? low(value) : half(place->first, value);
  }
  return plain_[static_cast<std::size_t>(number - kFirstHolding)];
}

std::uint32_t Zc300::raw(const Place& place, Time now) const {
  const Channel& c = channels_[place.axis];
  const Settings& s = c.set;
  switch (place.field->item) {
    case Field::kCoordinate:
      return bits_of(c.pulses(now) * s.scale());
    case Field::kEnable:
      return c.enabled ? 1 : 0;
    case Field::kUnit:
      return static_cast<std::uint32_t>(s.unit);
    case Field::kPulsesPerRev:
      return static_cast<std::uint32_t>(s.pulses_per_rev);
    case Field::kStageType:
      return static_cast<std::uint32_t>(s.stage_type);
    case Field::kLead:
      return bits_of(s.lead);
    case Field::kRatio:
      return bits_of(s.ratio);
    case Field::kHomeSpeed:
      return bits_of(s.home_speed * s.scale());
    case Field::kHomeMode:
      return static_cast<std::uint32_t>(s.home_mode);
    case Field::kMotionKind:
      return static_cast<std::uint32_t>(s.motion_kind);
    case Field::kMotionMode:
      return static_cast<std::uint32_t>(s.motion_mode);
    case Field::kDistance:
      return bits_of(s.distance * s.scale());
    case Field::kStopMode:
      return static_cast<std::uint32_t>(s.stop_mode);
    case Field::kInitialSpeed:
      return bits_of(s.initial_speed * s.scale());
    case Field::kSpeed:
      return bits_of(s.speed * s.scale());
    case Field::kAcceleration:
      return bits_of(s.acceleration * s.scale());
  }
  return 0;
}

void Zc300::set(Channel& c, Field::Item item, std::uint32_t raw, Time now) const {
  Settings& s = c.set;
  const auto between_0_and = [&](double most) {
    const double value = finite(raw);
    if (value <= 0 || value >= most) throw Refused{kBadData};
    return value;
  };
  const auto pulses_from = [&](double least) {
    const double pulses = std::round(finite(raw) / s.scale());
    if (pulses < least || pulses >= kMostPulses) throw Refused{kBadData};
    return pulses;
  };
  if (item != Field::kEnable && item != Field::kDistance && c.moving(now)) throw Refused{kIsMoving};
  switch (item) {
    case Field::kCoordinate:
      c.coordinate = std::round(finite(raw) / s.scale());
      if (*c.coordinate <= kLeastCoordinate || *c.coordinate >= kMostPulses)
        throw Refused{kBadData};
      break;
    case Field::kEnable:
      c.enabled = up_to(raw, 0, 1) == 1;
      break;
    case Field::kUnit:
      s.unit = up_to(raw, 0, 2);
      break;
    case Field::kPulsesPerRev:
      s.pulses_per_rev = up_to(raw, 1, static_cast<int>(kMostPulses) - 1);
      break;
    case Field::kStageType:
      s.stage_type = up_to(raw, 0, 1);
      break;
    case Field::kLead:
      s.lead = between_0_and(kMostLead);
      break;
    case Field::kRatio:
      s.ratio = between_0_and(kMostRatio);
      break;
    case Field::kHomeSpeed:
      s.home_speed = pulses_from(1);
      if (s.home_speed >= s.speed) throw Refused{kBadData};
      break;
    case Field::kHomeMode:
      s.home_mode = up_to(raw, 1, 3);
      break;
    case Field::kMotionKind:
      if (raw != 0x4A && raw != 0x43) throw Refused{kBadData};
      s.motion_kind = static_cast<int>(raw);
      break;
    case Field::kMotionMode:
      if (raw != 0x52 && raw != 0x41) throw Refused{kBadData};
      s.motion_mode = static_cast<int>(raw);
      break;
    case Field::kDistance: {
      double value = finite(raw);
      if (value < 0) throw Refused{kBadData};  // the sign is a letter of the command
      if (s.unit != 0) value = std::trunc(value * 1000) / 1000;
      s.distance = std::round(value / s.scale());
      if (s.distance >= kMostPulses) throw Refused{kBadData};
      break;
    }
    case Field::kStopMode:
      s.stop_mode = up_to(raw, 0, 1);
      break;
    case Field::kInitialSpeed:
      s.initial_speed = pulses_from(0);
      if (s.initial_speed > s.speed) throw Refused{kBadData};
      break;
    case Field::kSpeed:
      s.speed = pulses_from(1);
      if (s.speed < s.initial_speed || s.speed <= s.home_speed) throw Refused{kBadData};
      break;
    case Field::kAcceleration:
      s.acceleration = pulses_from(1);
      break;
  }
}

/// All of it or nothing. Half of a pair may be written: the other half stays.
void Zc300::write(int first, const std::vector<std::uint16_t>& values, Time now) {
  auto channels = channels_;
  auto plain = plain_;
  int address = address_;
  const int end = first + static_cast<int>(values.size());
  const auto written = [&](int number) {
    return number >= first && number < end ? values[static_cast<std::size_t>(number - first)]
                                           : word(number, now);
  };
  for (int number = first; number < end; ++number) {
    if (const auto place = place_of(number)) {
      std::uint32_t raw = written(place->first);
      if (place->field->words == 2) raw = raw << 16u | written(place->first + 1);
      set(channels[place->axis], place->field->item, raw, now);
      number = place->first + place->field->words - 1;
    } else if (number == kAddress) {
      address = up_to(written(number), 1, 255);
    } else if (reserved(number)) {
      throw Refused{kNoRegister};
    } else {
      if (number == kOutputs) up_to(written(number), 0, (1 << kOutputCount) - 1);
      if (number == kBeeper) up_to(written(number), 0, 1);
      if (number == kBacklight) up_to(written(number), 0, 255);
      plain[static_cast<std::size_t>(number - kFirstHolding)] = written(number);
    }
  }
  constexpr std::size_t kAt = kOutputs - kFirstHolding;
  const unsigned before = plain_[kAt];
  channels_ = channels;
  plain_ = plain;
  address_ = address;
  tell_outputs(before, plain_[kAt]);
  for (Channel& c : channels_) {
    const auto coordinate = std::exchange(c.coordinate, std::nullopt);
    if (c.axis == nullptr) continue;
    if (coordinate) c.axis->set_counter(now, *coordinate * c.axis->per_step());
    if (!c.enabled && c.moving(now)) c.axis->stop(now, true);
  }
}

// ---- commands

std::vector<Channel*> Zc300::chosen(std::uint16_t axis) {
  if (axis >= 0x31 && axis <= 0x33) return {&channels_[axis - 0x31u]};
  if (axis != 0x30) throw Refused{kBadData};
  std::vector<Channel*> all;
  for (Channel& c : channels_)
    if (c.axis != nullptr) all.push_back(&c);
  return all;
}

std::string Zc300::command(const ModbusRequest& request, Time now) {
  const std::vector<std::uint16_t>& block = request.values;
  const int opcode = block[0];
  if (opcode < 0x64 || opcode > 0x6D || opcode == 0x6A || opcode == 0x6B)
    throw Refused{kUnknownOpcode};
  const bool move = opcode <= 0x66;
  const bool stop = opcode == 0x67 || opcode == 0x68;
  if (block.size() != (move ? 3u : stop || opcode == 0x69 ? 2u : 1u)) throw Refused{kBadLength};
  const std::string done = framer_.confirmation(request);
  if (move) {
    const std::vector<Channel*> channels = chosen(block[1]);
    if (block[2] != 'P' && block[2] != 'N') throw Refused{kBadData};
    begin(channels, opcode, block[2] == 'N' ? -1.0 : 1.0, now);
  } else if (opcode == 0x69) {
    begin(chosen(block[1]), opcode, 1.0, now);
  } else if (stop) {
    if (opcode == 0x67 && block[1] == 0x30) throw Refused{kBadData};  // one axis at a time
    for (Channel* c : chosen(block[1]))
      if (c->axis != nullptr) c->axis->stop(now, opcode == 0x68);
  } else if (opcode == 0x6C) {
    if (any_moves(now)) throw Refused{kIsMoving};
    for (Channel& c : channels_) c.set = c.saved = Settings{};
  } else {
    if (any_moves(now)) throw Refused{kNotSaved};
    for (Channel& c : channels_) c.saved = c.set;
    saved_address_ = address_;
    later(now + kSaveTime, [this, done](Time) { send(done); });
    return {};
  }
  std::ranges::copy(block, plain_.begin());
  return done;
}

void Zc300::begin(const std::vector<Channel*>& channels, int opcode, double sign, Time now) {
  constexpr double kEndless = 1e9;  // pulses; the profile ends at the limit switch
  const auto target = [&](const Channel& c) {
    const double way = sign * (opcode == 0x66 ? kEndless : c.set.distance);
    return opcode == 0x64 ? way : c.pulses(now) + way;
  };
  if (emergency_stop()) throw Refused{kEmergency};
  for (const Channel* c : channels) {
    if (c->axis == nullptr || !c->enabled || alarm(c->axis->config().id))
      throw Refused{kNotEnabled};
    if (c->moving(now)) throw Refused{kIsMoving};
    const double way = target(*c) - c->pulses(now);
    if (opcode != 0x69 &&
        ((way > 0 && c->axis->upper_switch(now)) || (way < 0 && c->axis->lower_switch(now))))
      throw Refused{kAtLimit};
  }
  for (Channel* c : channels) {
    AxisModel& axis = *c->axis;
    c->running = true;
    if (opcode != 0x69)
      axis.move_to(now, target(*c) * axis.per_step(), c->ramp(c->set.speed));
    else if (c->set.home_mode == 3)
      // No source says that this sets the counter to 0, so it does not.
      axis.home(now, c->ramp(c->set.home_speed), 0, std::nullopt, false);
    else
      axis.move_to(now, c->set.home_mode == 2 ? -kEndless * axis.per_step() : 0.0,
                   c->ramp(c->set.home_speed));
  }
}

}  // namespace

std::unique_ptr<ControllerSimulator> simulate_zc300(const SimulatorSetup& setup) {
  return std::make_unique<Zc300>(setup);
}

}  // namespace turntable::sim
