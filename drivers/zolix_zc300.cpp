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
constexpr int kOpcode = 30050, kCoordinate = 30059, kOutputs = 30065, kOutputBits = 0x7;
/// All settings, between the registers that the manual reserves; and those that are read before each
/// motion: targets, stop modes and speeds of all axes.
constexpr std::array<std::pair<int, int>, 2> kSettingBlocks{{{30066, 30}, {30099, 42}}};
constexpr int kTarget = 30114, kTargetBlock = 27, kCruise = 30129, kAcceleration = 30135;
constexpr int kLastOfScale = 30095;  // up to here settings change what the later ones mean
std::uint16_t wire(int number) { return static_cast<std::uint16_t>(number - 1); }

constexpr std::uint16_t kMoveTo = 0x64, kSlowStop = 0x67, kHalt = 0x68, kHome = 0x69;
constexpr std::uint16_t kPositive = 'P', kNegative = 'N';

// In mm or deg.
constexpr double kPerUnit = 1000;  // targets are cut off to 0.001
constexpr double kUnder = 1e-5;    // added, so that the cut leaves what was meant
constexpr double kFarthest = 1e6;  // beyond it a position is noise
constexpr int kTargetAttempts = 3;

// Bounds of the controller's settings, speeds in pulses.
constexpr double kMostPulses = 1e7, kMostLead = 1000, kMostRatio = 10000;

// The marks of the acceleration: how many, and how far apart (pulses/s^2, and a part of it).
constexpr int kMarks = 3;
constexpr double kMarkPulses = 2, kMarkPart = 2e-4, kLeastMarked = 100;

// How long a read of the marks proves that the power was not off, and a comparison of the settings that
// they are right before a first homing.
constexpr Time kMarksHold = milliseconds{500}, kComparedHold = std::chrono::seconds{10};
// A status read of one axis may serve the others for so long.
constexpr Time kShared = milliseconds{5};

// How far off a predicted end may be.
constexpr double kGuard_s = 0.06, kGuardOfMotion = 0.01;
constexpr Time kGuardPoll = milliseconds{10}, kOverdue = std::chrono::seconds{2};
constexpr Time kIdentify = milliseconds{400};

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
  bool count_from_home(const Channel& channel) override;
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
    Time asked{0}, read{0};
    unsigned number = 0;  ///< of the read
  };
  /// What this driver knows of a channel beside what the controller tells.
  struct Known {
    int mark = 0;              ///< of its acceleration since it was homed; 0 = it was not
    bool homing = false;       ///< a home command was given, and not yet seen to have succeeded
    std::optional<Time> ends;  ///< predicted, of a motion that was not seen to have ended
    Time guard{0};
    unsigned seen = 0;          ///< the last status read that it was told of
    std::optional<Time> ended;  ///< when it was first told that the last motion had ended
    bool switch_off = false, switch_on = false;  ///< levels that its home switch bit has shown
  };
  /// Holding registers that were read together.
  struct Block {
    int first = 0;
    Words words;
    bool has(int number) const {
      return number >= first && number < first + static_cast<int>(words.size());
    }
    std::size_t at(int number) const { return static_cast<std::size_t>(number - first); }
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
  void write_setting(const Channel& channel, const Setting& setting);
  std::vector<Block> read_settings();
  static double value_in(const std::vector<Block>& blocks, const Setting& setting);
  void check_ranges() const;
  void compare(std::vector<std::string>& differences);
  Snapshot look(const Channel& channel, Time deadline = Time::max());
  std::optional<Snapshot> shared(const Channel& channel);
  static bool plausible(const Channel& channel, const Snapshot& seen);

  static Setting acceleration(const Channel& channel, int mark);
  std::optional<int> mark_in(const Channel& channel, double found) const;
  std::optional<int> mark(const Channel& channel) const;
  Block read_targets(const std::string& who, Time deadline = Time::max());
  bool marked_still(const Channel& channel, Time deadline);
  [[noreturn]] void power_cycled(const Channel& channel) const;
  bool homed(const Channel& channel);
  void put_mark(const Channel& channel);
  void write_target(const Channel& channel, double target);
  void wait_for_ends(const Channel& channel);
  Acknowledgement command(const Channel& channel, std::span<const std::uint16_t> block);

  ModbusMaster master_;
  std::vector<Known> known_;  ///< by channel
  // Guarded by the lock, as all that is here.
  std::optional<Snapshot> seen_;  ///< the last status, while no motion command was given since
  unsigned reads_ = 0;
  std::array<double, 3> accelerations_{};  ///< as they were last read
  Time marks_read_ = Time::min(), compared_ = Time::min();
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
  for (const OutputConfig& output : config().outputs)
    if (output.slave == slave() && (*output.register_at != kOutputs - 1 || output.mask() == 0 ||
                                    (output.mask() & ~kOutputBits) != 0))
      throw ConfigError(
          "rig", fmt::format("/controllers/{}/outputs/{}", config().name, output.name),
          fmt::format("found register {}{}, allowed for the outputs of a ZC300: register {} with "
                      "bit 0, 1 or 2 for OUT1, OUT2, OUT3. No other register switches one.",
                      *output.register_at,
                      output.bit ? fmt::format(" with bit {}", *output.bit) : "", kOutputs - 1));
  check_ranges();
}

/// Before any byte leaves: what the controller would refuse with 05, said in the rig file's words.
void Zc300::check_ranges() const {
  for (const Channel& channel : channels()) {
    const AxisConfig& axis = channel.config;
    const auto refuse = [&](const char* what, double found, const std::string& allowed) {
      throw ConfigError(
          "rig", fmt::format("/axes/{}", axis_name(axis.id)),
          fmt::format("found {} {:.9g}, allowed on a ZC300: {}. Correct the rig file.", what, found,
                      allowed));
    };
    if (!(axis.steps_per_rev > 0 && axis.steps_per_rev < kMostPulses) ||
        axis.steps_per_rev != std::floor(axis.steps_per_rev))
      refuse("pulses per revolution", axis.steps_per_rev, "whole numbers from 1 to 9999999");
    if (axis.kind == StageKind::kLinear && !(axis.lead_mm > 0 && axis.lead_mm < kMostLead))
      refuse("a lead in mm of", axis.lead_mm, "above 0 and below 1000");
    if (axis.kind == StageKind::kRotary && !(axis.drive_ratio > 0 && axis.drive_ratio < kMostRatio))
      refuse("a drive ratio of", axis.drive_ratio, "above 0 and below 10000");
    const double most = (kMostPulses - 1) * axis.per_step();
    const std::string below =
        fmt::format("up to {:.6g} {}/s (below 10^7 pulses)", most, axis_unit(axis.id));
    if (!(axis.speed >= axis.per_step() && axis.speed <= most))
      refuse("a speed of", axis.speed, below);
    if (!(axis.initial_speed >= 0 && axis.initial_speed <= axis.speed))
      refuse("an initial speed of", axis.initial_speed,
             fmt::format("0 to the speed, {:g}", axis.speed));
    if (!(axis.home_speed >= axis.per_step() && axis.home_speed < axis.speed))
      refuse("a home speed of", axis.home_speed, fmt::format("below the speed, {:g}", axis.speed));
    if (!(axis.acceleration >= kLeastMarked * axis.per_step() && axis.acceleration <= most))
      refuse("an acceleration of", axis.acceleration,
             fmt::format("{:.6g} to {:.6g} {}/s^2 (100 to 9999999 pulses)",
                         kLeastMarked * axis.per_step(), most, axis_unit(axis.id)));
  }
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

bool Zc300::plausible(const Channel& channel, const Snapshot& seen) {
  return std::abs(seen.position[number_of(channel)]) < kFarthest;  // false for NaN
}

/// Only of a channel's own axis is the position looked at: those without a stage may say anything.
Zc300::Snapshot Zc300::look(const Channel& channel, Time deadline) {
  return retried(deadline, [&] {
    return exchange(where(channel), "reading the status", [&] {
      seen_.reset();
      const Time asked = clock().now();
      const Words words = master_.read_input(slave(), wire(kStatus), kStatusCount);
      Snapshot seen;
      for (std::size_t i = 0; i < 3; ++i) {
        seen.moving[i] = words[i] != 0;
        seen.position[i] = real(words, 4 + 2 * i);
      }
      seen.bits = words[3];
      seen.asked = asked;
      seen.read = clock().now();
      seen.number = ++reads_;
      if (std::max({words[0], words[1], words[2]}) > 1 || !plausible(channel, seen))
        throw ProtocolError(fmt::format("{}: a status that cannot be: moving {} {} {}, position {}",
                                        where(channel), words[0], words[1], words[2],
                                        seen.position[number_of(channel)]));
      seen_ = seen;
      known_[channel.index].seen = seen.number;
      for (const Channel& other : channels())
        if (!seen.moving[number_of(other)]) known_[other.index].ends.reset();
      return seen;
    });
  });
}

/// What another axis has just read serves this one too, once; but the second look of an axis that
/// settles has to have been asked for after its settle time.
std::optional<Zc300::Snapshot> Zc300::shared(const Channel& channel) {
  const auto guard = lock();
  Known& known = known_[channel.index];
  const Time settle = from_seconds(channel.config.settle_s);
  if (!seen_ || seen_->number == known.seen || clock().now() > seen_->read + kShared ||
      !plausible(channel, *seen_) || (known.ended && seen_->asked < *known.ended + settle))
    return std::nullopt;
  known.seen = seen_->number;
  return seen_;
}

// ---- set-up

/// In the order in which they are written: what gives later values their unit comes first. Speeds
/// are kept in whole pulses.
std::vector<Zc300::Setting> Zc300::settings(const Channel& channel) {
  using enum Setting::Width;
  const AxisConfig& config = channel.config;
  const bool rotary = config.kind == StageKind::kRotary;
  const int n = static_cast<int>(number_of(channel));
  // Of a rotary axis the ratio makes the scale. Should the controller count with the lead too, then as
  // the degrees to one turn of the table; and should it count with the lead alone, moves come out too
  // short and not too long.
  const double lead = rotary ? 360.0 : config.lead_mm;
  const double ratio = rotary ? config.drive_ratio : 1.0;
  const auto speed = [&](int number, const char* name, double value) {
    return Setting{number + 2 * n, name, kFloat, value,
                   0.6 * config.per_step() + 1e-6 * std::abs(value)};
  };
  return {{30072 + n, "unit", kWord, rotary ? 2.0 : 1.0},
          {30075 + 2 * n, "pulses per revolution", kLong, config.steps_per_rev},
          {30081 + n, "stage type", kWord, rotary ? 1.0 : 0.0},
          {30084 + 2 * n, "lead", kFloat, lead, 1e-6 * lead},
          {30090 + 2 * n, "drive ratio", kFloat, ratio, 1e-6 * ratio},
          speed(30123, "initial speed", config.initial_speed),
          speed(30099, "home speed", config.home_speed),
          speed(kCruise, "cruise speed", config.speed),
          acceleration(channel, 0),
          {30105 + n, "home mode", kWord, 3.0},  // the home switch
          {30120 + n, "stop mode", kWord, 1.0},  // decelerates
          {30066 + n, "enable", kWord, 1.0}};
}

void Zc300::write_setting(const Channel& channel, const Setting& setting) {
  if (setting.width == Setting::Width::kWord) {
    const auto word = static_cast<std::uint16_t>(setting.value);
    return write_words(where(channel), setting.number, {&word, 1});
  }
  write_words(where(channel), setting.number,
              words_of(setting.width == Setting::Width::kFloat
                           ? std::bit_cast<std::uint32_t>(static_cast<float>(setting.value))
                           : static_cast<std::uint32_t>(std::lround(setting.value))));
}

/// All of them in two reads, which leave out what the manual reserves.
std::vector<Zc300::Block> Zc300::read_settings() {
  std::vector<Block> blocks;
  for (const auto& [first, count] : kSettingBlocks)
    blocks.push_back({first, holding(itself(), first, count)});
  const Block& last = blocks.back();
  for (std::size_t i = 0; i < 3; ++i)
    accelerations_[i] = real(last.words, last.at(kAcceleration) + 2 * i);
  marks_read_ = clock().now();
  return blocks;
}

double Zc300::value_in(const std::vector<Block>& blocks, const Setting& setting) {
  const Block& block =
      *std::ranges::find_if(blocks, [&](const Block& b) { return b.has(setting.number); });
  const std::size_t at = block.at(setting.number);
  if (setting.width == Setting::Width::kWord) return block.words[at];
  return setting.width == Setting::Width::kFloat ? real(block.words, at) : word32(block.words, at);
}

void Zc300::compare(std::vector<std::string>& differences) {
  const std::vector<Block> blocks = read_settings();
  for (const Channel& channel : channels())
    for (const Setting& setting : settings(channel)) {
      const double found = value_in(blocks, setting);
      const bool agrees = setting.number >= kAcceleration
                              ? mark_in(channel, found).has_value()
                              : std::abs(found - setting.value) <= setting.tolerance;
      if (!agrees)
        differences.push_back(
            difference(channel, fmt::format("register {} ({})", setting.number, setting.name),
                       fmt::format("{:.7g}", setting.value), fmt::format("{:.7g}", found)));
    }
  compared_ = clock().now();
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
  compare(differences);
  return fmt::format("{} serial {} firmware {:.1f}", model, word32(words, 7), 0.1 * words[9]);
}

/// Only what differs, and the scale first, as it changes what the others read. The cruise speed must at
/// no time be below the others: it comes first where it grows.
void Zc300::write_setup() {
  std::vector<bool> rescaled(channels().size());
  for (const bool scale : {true, false}) {
    const std::vector<Block> blocks = read_settings();
    for (const Channel& channel : channels()) {
      Known& known = known_[channel.index];
      if (rescaled[channel.index])
        known.mark = 0;  // a place that was found before means nothing now
      std::vector<Setting> all = settings(channel);
      const auto cruise = std::ranges::find_if(
          all, [](const Setting& s) { return s.number >= kCruise && s.number < kAcceleration; });
      if (cruise->value > value_in(blocks, *cruise))
        std::rotate(
            std::ranges::find_if(all, [](const Setting& s) { return s.number > kLastOfScale; }),
            cruise, cruise + 1);
      for (const Setting& setting : all) {
        if ((setting.number <= kLastOfScale && setting.number >= 30072) != scale) continue;
        const double found = value_in(blocks, setting);
        if (setting.number >= kAcceleration) {
          const auto mark = mark_in(channel, found);
          if (!mark || rescaled[channel.index])
            write_setting(channel, acceleration(channel, known.mark));
        } else if (!(std::abs(found - setting.value) <= setting.tolerance)) {
          write_setting(channel, setting);
          if (scale) rescaled[channel.index] = true;
        }
      }
    }
  }
}

// ---- power cycles

bool Zc300::homed(const Channel& channel) {
  const AxisId id = channel.config.id;
  return channel.config.kind == StageKind::kLinear ? linear_axis(id)->homed()
                                                   : rotary_axis(id)->homed();
}

/// Somewhat less than the rig file's: nothing else that is documented to be volatile can be given a value
/// that neither moves nor hurts anything, and be told from what the flash memory holds.
Zc300::Setting Zc300::acceleration(const Channel& channel, int mark) {
  const AxisConfig& axis = channel.config;
  const double pulses = axis.acceleration / axis.per_step();
  const double step = std::max(kMarkPulses, std::round(kMarkPart * pulses)) * axis.per_step();
  const double value = axis.acceleration - mark * step;
  return {kAcceleration + 2 * static_cast<int>(number_of(channel)), "acceleration",
          Setting::Width::kFloat, value, 0.6 * axis.per_step() + 1e-6 * value};
}

/// Nothing if the acceleration is none of this program's.
std::optional<int> Zc300::mark_in(const Channel& channel, double found) const {
  for (int mark = 0; mark <= kMarks; ++mark) {
    const Setting setting = acceleration(channel, mark);
    if (std::abs(found - setting.value) <= setting.tolerance) return mark;
  }
  return std::nullopt;
}

/// As it was last read.
std::optional<int> Zc300::mark(const Channel& channel) const {
  return mark_in(channel, accelerations_[number_of(channel)]);
}

/// Targets and marks of all axes in one read.
Zc300::Block Zc300::read_targets(const std::string& who, Time deadline) {
  Block block{kTarget, holding(who, kTarget, kTargetBlock, deadline)};
  const auto guard = lock();
  for (std::size_t i = 0; i < 3; ++i)
    accelerations_[i] = real(block.words, block.at(kAcceleration) + 2 * i);
  marks_read_ = clock().now();
  return block;
}

/// Whether the mark of an axis is what it was when the axis was homed. A read of the last moment counts.
bool Zc300::marked_still(const Channel& channel, Time deadline) {
  const auto stale = [&] {
    const auto guard = lock();
    return marks_read_ == Time::min() || clock().now() > marks_read_ + kMarksHold;
  };
  if (stale()) read_targets(where(channel), deadline);
  const auto guard = lock();
  return mark(channel) == known_[channel.index].mark;
}

void Zc300::power_cycled(const Channel& channel) const {
  throw DeviceError(
      fmt::format("{}: {}. Nothing was moved. Home the axis again.", where(channel), kPowerCycled));
}

/// Before an axis is homed. Where the mark has been lost, the settings may have been too.
void Zc300::put_mark(const Channel& channel) {
  Known& known = known_[channel.index];
  read_targets(where(channel));
  const bool lost = known.mark != 0 && mark(channel) != known.mark;
  if (lost || !mark(channel) || compared_ == Time::min() ||
      clock().now() > compared_ + kComparedHold)
    if (const auto differences = connect(); !differences.empty())
      throw DeviceError(fmt::format(
          "{}: {} set up differently from the rig file, so nothing will be moved: {}{}. "
          "Let it be configured from the rig file.",
          where(channel),
          lost ? "the controller was switched off and on, and is now" : "the controller is",
          differences.front(),
          differences.size() > 1 ? fmt::format(", and {} more", differences.size() - 1) : ""));
  const int next = mark(channel).value_or(0) % kMarks + 1;  // never the one that is there
  for (int attempt = 1;; ++attempt) {
    write_setting(channel, acceleration(channel, next));
    read_targets(where(channel));
    if (mark(channel) == next) break;
    if (attempt == kTargetAttempts)
      throw DeviceError(fmt::format(
          "{}: register {} (acceleration) does not keep what is written. Nothing was moved. Check "
          "cable and termination, and whether another program talks to the controller.",
          where(channel), acceleration(channel, next).number));
  }
  known.mark = next;
}

/// Whoever homed an axis since power-up has left a mark.
bool Zc300::may_be_homed(const Channel& channel) {
  read_targets(where(channel));
  known_[channel.index].mark = mark(channel).value_or(0);
  return known_[channel.index].mark != 0;
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
    const Block block = read_targets(where(channel));
    const double found = real(block.words, block.at(number));
    if (std::abs(found - wanted) <= tolerance) return;
    if (attempt == kTargetAttempts)
      throw DeviceError(
          fmt::format("{}: register {} (target): wanted {:.7g}, found {:.7g} after {} attempts. "
                      "Nothing was moved. Check cable and termination, and whether another program "
                      "talks to the controller.",
                      where(channel), number, sent, found, attempt));
  }
}

/// Returns when no other axis is about to end: it has been seen to stand, and a read has been there to be
/// missed; or its predicted end is further off than the guard. An axis that moves on and on is not waited
/// for: its own deadline ends that.
/// @throws TimeoutError if a stop waits: nothing must start then.
void Zc300::wait_for_ends(const Channel& channel) {
  const auto about_to_end = [&](const Channel& other) {
    const Known& known = known_[other.index];
    return other.index != channel.index && known.ends &&
           clock().now() > *known.ends - known.guard && clock().now() < *known.ends + kOverdue;
  };
  while (std::ranges::any_of(channels(), about_to_end)) {
    const Snapshot seen = look(channel);
    if (std::ranges::none_of(channels(), [&](const Channel& other) {
          return seen.moving[number_of(other)] && about_to_end(other);
        }))
      break;
    clock().sleep_for(kGuardPoll);
  }
  require_no_stop(channel);
}

/// Sends a motion command, once.
Acknowledgement Zc300::command(const Channel& channel, std::span<const std::uint16_t> block) {
  Known& known = known_[channel.index];
  known.ended.reset();
  seen_.reset();
  marks_read_ = Time::min();  // what was known before the motion proves nothing after it
  try {
    exchange(where(channel), fmt::format("opcode {:02X}h", block[0]),
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
  if (mark(channel) != known.mark) power_cycled(channel);
  wait_for_ends(channel);
  const double takes_s = trapezoid_seconds(channel.config, target - channel.unit(from));
  known.homing = false;
  known.ends = clock().now() + from_seconds(takes_s);
  known.guard = from_seconds(kGuard_s + kGuardOfMotion * takes_s);
  return command(channel, std::array<std::uint16_t, 3>{kMoveTo, code_of(channel),
                                                       target < 0 ? kNegative : kPositive});
}

Acknowledgement Zc300::start_home(const Channel& channel) {
  put_mark(channel);
  wait_for_ends(channel);
  known_[channel.index].homing = true;
  known_[channel.index].ends.reset();
  const Acknowledgement answer =
      command(channel, std::array<std::uint16_t, 2>{kHome, code_of(channel)});
  // A command that was never heard would leave the axis at rest, which is what a finished homing looks
  // like; and the place where it stands would be made 0.
  if (answer == Acknowledgement::kLost && !look(channel).moving[number_of(channel)]) {
    known_[channel.index].homing = false;
    throw TimeoutError(
        fmt::format("{}: did not acknowledge the command to home, and does not move. It was not "
                    "sent again. Home the axis again.",
                    where(channel)));
  }
  return answer;
}

/// No source says that homing sets the counter to 0, and those who know the controller write it. Only
/// where the homing can have succeeded: a place that is no home must not be made 0.
bool Zc300::count_from_home(const Channel& channel) {
  Known& known = known_[channel.index];
  const std::size_t n = number_of(channel);
  const auto failed = [&](const std::string& why) {
    known.homing = false;
    throw DeviceError(
        fmt::format("{}: not homed: {}. Its counter was left as it is.", where(channel), why));
  };
  if (!known.homing) failed("it was stopped meanwhile");
  const Snapshot seen = look(channel);
  if (seen.moving[n]) failed("it moves again, though it was not asked to");
  if ((seen.bits >> 9 & 1u) != 0) failed("the emergency stop is pressed; release it");
  if ((seen.bits >> (10 + n) & 1u) != 0) failed("the driver of the axis reports an alarm");
  if ((seen.bits >> 3 * n & 3u) != 0)
    failed("it ended on a limit switch, and not on the home switch. Check the home switch");
  // The bit floats where no switch is wired, and so proves nothing alone; where it has shown both levels
  // it comes from a switch.
  const bool on = (seen.bits >> 3 * n & 4u) != 0;
  (on ? known.switch_on : known.switch_off) = true;
  if (known.switch_off && known.switch_on && !on)
    failed(
        "its home switch has been on before and is off now: the homing was ended by something "
        "else. Find out what, and home it again");
  marks_read_ = Time::min();
  if (!marked_still(channel, Time::max())) failed(kPowerCycled);

  const int number = kCoordinate + 2 * static_cast<int>(n);
  for (int attempt = 1;; ++attempt) {
    require_no_stop(channel);
    seen_.reset();
    write_words(where(channel), number, words_of(std::bit_cast<std::uint32_t>(0.0f)));
    const double found = real(holding(where(channel), number, 2), 0);
    if (std::abs(found) <= 0.5 * channel.config.per_step()) break;
    if (attempt == kTargetAttempts)
      failed(
          fmt::format("register {} (position) was written with 0 and reads {:.7g}", number, found));
  }
  known.homing = false;
  return true;
}

AxisStatus<Steps> Zc300::status(const Channel& channel, Time deadline) {
  const std::size_t n = number_of(channel);
  const auto others = shared(channel);
  const Snapshot seen = others ? *others : look(channel, deadline);
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
  bool referenced = false;
  {
    const auto guard = lock();
    Known& known = known_[channel.index];
    ((seen.bits >> 3 * n & 4u) != 0 ? known.switch_on : known.switch_off) = true;
    if (!seen.moving[n] && !known.ended) known.ended = clock().now();
    referenced = known.homing || homed(channel);
  }
  // The counter is 0 after power-up.
  if (!status.fault.empty() || status.position->count != 0 || seen.moving[n] || !referenced)
    return status;
  if (!marked_still(channel, deadline)) {
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
  seen_.reset();
  Known& known = known_[channel.index];
  known.homing = false;
  known.ended.reset();
  const double half_s = 0.5 * channel.config.speed / channel.config.acceleration;  // or sooner
  known.ends = clock().now() + from_seconds(half_s);
  known.guard = from_seconds(half_s + kGuard_s);
}

/// An output that is one bit of a register leaves the others as they are.
void Zc300::switch_output(const OutputConfig& output, bool on) {
  const std::string who = fmt::format("output {} of {}", output.name, config().name);
  const auto address = static_cast<std::uint16_t>(*output.register_at);
  const bool in_part = output.bit || output.slave == slave();
  retried(Time::max(), [&] {
    exchange(who, fmt::format("switching wire register {}", address), [&] {
      std::uint16_t value = on ? output.on_value : output.off_value;
      if (in_part)
        value = static_cast<std::uint16_t>(
            (master_.read_holding(output.slave, address, 1)[0] & ~output.mask()) | output.bits(on));
      master_.write_register(output.slave, address, value, ModbusMaster::Repeat::kAllowed);
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
