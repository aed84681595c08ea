#include "drivers/zolix_mc600.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <charconv>
#include <cmath>
#include <mutex>
#include <optional>

#include "drivers/motion.h"
#include "protocols/ascii_dialog.h"
#include "src/core/errors.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

constexpr int kReadAttempts = 3;
constexpr Time kQuiet = milliseconds{50};
constexpr Time kResync = milliseconds{300};
constexpr std::string_view kChannels = "XYZT";

std::string upper(std::string_view text) {
  std::string s(text);
  for (char& c : s) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  return s;
}

/// As the controller's own examples show numbers: plain decimals, as few as needed, five at most.
std::string number(double value) {
  std::string s = fmt::format("{:.5f}", value);
  s.erase(s.find_last_not_of('0') + 1);
  if (s.ends_with('.')) s.pop_back();
  return s == "-0" ? "0" : s;
}

std::optional<double> parse_number(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), value, std::chars_format::fixed);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    return std::nullopt;
  return value;
}

bool is_error(std::string_view reply) {
  return reply.size() == 3 && (reply[0] == 'E' || reply[0] == 'e') && reply[1] == '0' &&
         reply[2] >= '0' && reply[2] <= '9';
}

/// "<head><value>,OK" -> value; `head` and `text` in upper case.
std::optional<std::string> value_between(std::string_view text, std::string_view head) {
  constexpr std::string_view kTail = ",OK";
  if (!text.starts_with(head) || !text.ends_with(kTail) ||
      text.size() <= head.size() + kTail.size())
    return std::nullopt;
  return std::string(text.substr(head.size(), text.size() - head.size() - kTail.size()));
}

class Mc600;

/// One channel, without its unit.
class Channel {
 public:
  Channel(Mc600& device, AxisConfig config)
      : device_(&device), config_(std::move(config)), letter_(upper(config_.channel)[0]) {}
  virtual ~Channel() = default;
  Channel(const Channel&) = delete;
  Channel& operator=(const Channel&) = delete;

  virtual void begin_stop() = 0;
  virtual void finish_stop() = 0;

  const AxisConfig& config() const { return config_; }
  char letter() const { return letter_; }
  void set_ended(bool ended) { ended_ = ended; }
  bool ended() const { return ended_; }

 protected:
  Mc600* device_;
  AxisConfig config_;
  char letter_;
  bool ended_ = false;  ///< the completion line of the present motion has come
};

template <class Q>
class ChannelAxis final : public Channel, public AxisPort<Q> {
 public:
  ChannelAxis(Mc600& device, AxisConfig config, Clock& clock, MotionTiming timing)
      : Channel(device, std::move(config)), axis_(config_, *this, clock, timing) {}

  Axis<Q>* axis() { return &axis_; }
  void begin_stop() override { axis_.begin_stop(); }
  void finish_stop() override { axis_.finish_stop(); }

  std::unique_lock<std::recursive_mutex> lock() override;
  void require_ready() const override;
  Acknowledgement start_move(Q from, Q to) override;
  Acknowledgement start_home() override;
  AxisStatus<Q> status(Time deadline) override;
  void send_stop(bool immediate) override;

 private:
  MotionAxis<Q> axis_;
};

class Mc600 final : public Controller {
 public:
  explicit Mc600(ControllerSetup setup);

  std::string identity() const override;
  std::vector<std::string> connect() override;
  void configure() override;
  Axis<Millimetres>* linear_axis(AxisId id) override { return find<Millimetres>(id); }
  Axis<Degrees>* rotary_axis(AxisId id) override { return find<Degrees>(id); }
  void stop_all() override;

  // For the channels.
  std::unique_lock<std::recursive_mutex> lock() { return std::unique_lock(mutex_); }
  void require_ready() const;
  Acknowledgement command_motion(Channel& channel, const std::string& command);
  double read_position(const Channel& channel, Time deadline);
  void send_stop(const Channel& channel);

 private:
  struct Setting {
    const char* verb;  ///< "SetSpeed"
    std::string value;
  };

  template <class Q>
  Axis<Q>* find(AxisId id);
  bool take_completion(std::string_view line);
  std::string where(const Channel& channel) const;
  [[noreturn]] void refused(const std::string& who, const std::string& command,
                            std::string_view reply) const;
  std::string ask(const std::string& command, const AsciiDialog::Predicate& accept);
  template <class F>
  auto retried(Time deadline, F&& read);
  std::string query(const Channel& channel, const std::string& verb, Time deadline = Time::max());
  void command(const Channel& channel, const std::string& verb, const std::string& value);
  static std::vector<Setting> settings(const AxisConfig& config);
  std::vector<std::string> differences();

  ControllerConfig config_;
  Clock* clock_;
  mutable std::recursive_mutex mutex_;  ///< the line, and all that is below
  std::atomic<int> stops_waiting_{0};   ///< others end their waiting for them
  AsciiDialog dialog_;
  bool connected_ = false;
  std::vector<std::string> differences_;
  std::vector<std::unique_ptr<Channel>> channels_;
};

// ---- channel

template <class Q>
std::unique_lock<std::recursive_mutex> ChannelAxis<Q>::lock() {
  return device_->lock();
}

template <class Q>
void ChannelAxis<Q>::require_ready() const {
  device_->require_ready();
}

template <class Q>
Acknowledgement ChannelAxis<Q>::start_move(Q, Q to) {
  // The sign is a letter and the number a magnitude: other drivers disagree about "P,-5".
  return device_->command_motion(
      *this, fmt::format("GoPosition {},O,A,{},{}", letter_, to.value < 0 ? 'N' : 'P',
                         number(std::abs(to.value))));
}

template <class Q>
Acknowledgement ChannelAxis<Q>::start_home() {
  return device_->command_motion(*this, fmt::format("GoHome {}", letter_));
}

template <class Q>
AxisStatus<Q> ChannelAxis<Q>::status(Time deadline) {
  const double position = device_->read_position(*this, deadline);
  const auto guard = lock();
  return {Q{position}, ended_ ? Motion::kEnded : Motion::kUnknown};
}

template <class Q>
void ChannelAxis<Q>::send_stop(bool) {
  device_->send_stop(*this);  // there is only one kind
}

// ---- controller

Mc600::Mc600(ControllerSetup setup)
    : config_(std::move(setup.controller)),
      clock_(setup.clock),
      dialog_(std::move(setup.line), *setup.clock,
              [this](std::string_view line) { return take_completion(line); }) {
  MotionTiming timing;
  timing.reply_timeout = config_.reply_timeout_s;
  for (AxisConfig& axis : setup.axes) {
    if (axis.channel.size() != 1 || kChannels.find(upper(axis.channel)) == std::string_view::npos)
      throw ConfigError(
          "rig", fmt::format("/axes/{}/channel", axis_name(axis.id)),
          fmt::format("found \"{}\", allowed on {}: X, Y, Z, T.", axis.channel, config_.model));
    for (const auto& other : channels_)
      if (other->letter() == upper(axis.channel)[0])
        throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(axis.id)),
                          fmt::format("channel {} is already taken by {}.", axis.channel,
                                      axis_name(other->config().id)));
    if (axis.kind == StageKind::kLinear)
      channels_.push_back(
          std::make_unique<ChannelAxis<Millimetres>>(*this, std::move(axis), *clock_, timing));
    else
      channels_.push_back(
          std::make_unique<ChannelAxis<Degrees>>(*this, std::move(axis), *clock_, timing));
  }
}

template <class Q>
Axis<Q>* Mc600::find(AxisId id) {
  for (const auto& channel : channels_)
    if (channel->config().id == id)
      if (auto* axis = dynamic_cast<ChannelAxis<Q>*>(channel.get())) return axis->axis();
  return nullptr;
}

std::string Mc600::identity() const {
  std::string letters;
  for (const auto& channel : channels_) letters += channel->letter();
  return fmt::format("{} \"{}\" on {}, channels {}", config_.model, config_.name,
                     dialog_.line().name(), letters);
}

std::string Mc600::where(const Channel& channel) const {
  return fmt::format("axis {} (channel {} of {} on {})", axis_name(channel.config().id),
                     channel.letter(), config_.name, dialog_.line().name());
}

/// "X 12.345,OK", sent by the controller itself when a motion has ended.
bool Mc600::take_completion(std::string_view line) {
  const std::string text = upper(line);
  if (text.size() < 2 || text[1] != ' ' || kChannels.find(text[0]) == std::string_view::npos)
    return false;
  const auto value = value_between(text, text.substr(0, 2));
  if (!value || !parse_number(*value)) return false;
  for (const auto& channel : channels_)
    if (channel->letter() == text[0]) channel->set_ended(true);
  return true;
}

void Mc600::refused(const std::string& who, const std::string& command,
                    std::string_view reply) const {
  throw DeviceError(
      fmt::format("{}: \"{}\" was refused with {}. The manual pages at hand do not define E01 and "
                  "E02; they are believed to "
                  "mean an unknown or ill-formed command, and one that is not allowed now or whose "
                  "value is not.",
                  who, command, upper(reply)));
}

std::string Mc600::ask(const std::string& command, const AsciiDialog::Predicate& accept) {
  const auto guard = lock();
  if (!dialog_.in_step()) dialog_.resync(kQuiet, kResync);
  return dialog_.ask(command, from_seconds(config_.reply_timeout_s), accept,
                     [this] { return stops_waiting_ > 0; });
}

/// Reads, and writes of settings, may be said again. Motion commands never come here.
template <class F>
auto Mc600::retried(Time deadline, F&& exchange) {
  for (int attempt = 1;; ++attempt) {
    const bool last = attempt == kReadAttempts;
    const auto give_up = [&] { return last || clock_->now() >= deadline; };
    try {
      return exchange();
    } catch (const TimeoutError&) {
      if (give_up()) throw;
    } catch (const ProtocolError&) {
      if (give_up()) throw;
    }
  }
}

std::string Mc600::query(const Channel& channel, const std::string& verb, Time deadline) {
  const std::string text = fmt::format("{}? {}", verb, channel.letter());
  const std::string head = upper(text) + ",";
  std::string reply = retried(deadline, [&] {
    return ask(text, [&](std::string_view line) {
      return is_error(line) || value_between(upper(line), head).has_value();
    });
  });
  if (is_error(reply)) refused(where(channel), text, reply);
  return *value_between(upper(reply), head);
}

void Mc600::command(const Channel& channel, const std::string& verb, const std::string& value) {
  const std::string text = fmt::format("{} {},{}", verb, channel.letter(), value);
  const std::string reply = retried(Time::max(), [&] {
    return ask(text, [](std::string_view line) { return is_error(line) || upper(line) == "OK"; });
  });
  if (is_error(reply)) refused(where(channel), text, reply);
}

Acknowledgement Mc600::command_motion(Channel& channel, const std::string& text) {
  const auto guard = lock();
  // Nothing of the past may be taken for the end of this motion.
  if (!dialog_.in_step()) dialog_.resync(kQuiet, kResync);
  dialog_.pump();
  channel.set_ended(false);
  try {
    const std::string reply = ask(text, [](std::string_view line) {
      return is_error(line) || upper(line) == "READY" || upper(line) == "OK";
    });
    if (is_error(reply)) refused(where(channel), text, reply);
    return Acknowledgement::kReceived;
  } catch (const TimeoutError&) {
    return Acknowledgement::kLost;
  } catch (const ProtocolError&) {
    return Acknowledgement::kLost;
  }
}

double Mc600::read_position(const Channel& channel, Time deadline) {
  return retried(deadline, [&] {
    const std::string text = query(channel, "Position", Time{0});
    const auto value = parse_number(text);
    if (!value)
      throw ProtocolError(fmt::format("{}: position \"{}\" is not a number", where(channel), text));
    return *value;
  });
}

void Mc600::send_stop(const Channel& channel) {
  struct Waiting {
    std::atomic<int>& count;
    explicit Waiting(std::atomic<int>& c) : count(c) { ++count; }
    ~Waiting() { --count; }
  } const waiting(stops_waiting_);
  const auto guard = lock();
  const std::string text = fmt::format("Stop {}", channel.letter());
  // No time for a resync. Whether the axis halts is seen by its position, so any kind of answer
  // will do.
  retried(Time::max(), [&] {
    return dialog_.ask(text, from_seconds(config_.reply_timeout_s),
                       [](std::string_view line) { return is_error(line) || upper(line) == "OK"; });
  });
}

void Mc600::require_ready() const {
  const auto guard = std::unique_lock(mutex_);
  if (!connected_)
    throw DeviceError(
        fmt::format("controller {} on {}: not connected yet", config_.name, dialog_.line().name()));
  if (!differences_.empty())
    throw DeviceError(
        fmt::format("controller {} on {} is set up differently from the rig file, so nothing will "
                    "be moved:\n  {}\nCorrect "
                    "the rig file, or let the controller be configured from it.",
                    config_.name, dialog_.line().name(), fmt::join(differences_, "\n  ")));
}

/// In the order in which they are written: what gives later values their unit comes first.
std::vector<Mc600::Setting> Mc600::settings(const AxisConfig& config) {
  const bool rotary = config.kind == StageKind::kRotary;
  std::vector<Setting> all{{"SetStageStyle", rotary ? "R" : "T"},
                           {"SetUnit", rotary ? "d" : "m"},
                           {"SetStageStepsRev", number(config.steps_per_rev)}};
  if (rotary)
    all.push_back({"SetStageDriveRat", number(config.drive_ratio)});
  else
    all.push_back({"SetStagePitch", number(config.lead_mm)});
  all.push_back({"SetInitSpeed", number(config.initial_speed)});
  all.push_back({"SetSpeed", number(config.speed)});
  all.push_back({"SetAccSpeed", number(config.acceleration)});
  all.push_back({"SetUserPositiveLimit", number(config.upper)});
  all.push_back({"SetUserNegativeLimit", number(config.lower)});
  all.push_back({"SetUserLimitAble", "E"});
  return all;
}

std::vector<std::string> Mc600::differences() {
  std::vector<std::string> found;
  for (const auto& channel : channels_) {
    for (const Setting& setting : settings(channel->config())) {
      const std::string value = query(*channel, setting.verb);
      const auto wanted_number = parse_number(setting.value), found_number = parse_number(value);
      const bool same = wanted_number && found_number ? std::abs(*wanted_number - *found_number) <=
                                                            1e-5 + 1e-6 * std::abs(*wanted_number)
                                                      : upper(setting.value) == value;
      if (!same)
        found.push_back(fmt::format("{}: {}? {}: wanted {}, found {}",
                                    axis_name(channel->config().id), setting.verb,
                                    channel->letter(), setting.value, value));
    }
  }
  return found;
}

std::vector<std::string> Mc600::connect() {
  const auto guard = lock();
  connected_ = false;
  const std::string reply = retried(Time::max(), [&] {
    return ask("Hello",
               [](std::string_view line) { return is_error(line) || upper(line) == "OK"; });
  });
  if (is_error(reply))
    refused(fmt::format("controller {} on {}", config_.name, dialog_.line().name()), "Hello",
            reply);
  differences_ = differences();
  connected_ = true;
  return differences_;
}

void Mc600::configure() {
  const auto guard = lock();
  for (const auto& channel : channels_) {
    for (const Setting& setting : settings(channel->config()))
      command(*channel, setting.verb, setting.value);
    command(*channel, "SetHomeSpeed", number(channel->config().home_speed));
  }
  if (!connect().empty()) require_ready();
}

void Mc600::stop_all() {
  std::exception_ptr first;
  const auto tried = [&](auto&& action) {
    try {
      action();
    } catch (...) {
      if (!first) first = std::current_exception();
    }
  };
  for (const auto& channel : channels_) tried([&] { channel->begin_stop(); });
  for (const auto& channel : channels_) tried([&] { channel->finish_stop(); });
  if (first) std::rethrow_exception(first);
}

}  // namespace

std::unique_ptr<Controller> open_zolix_mc600(ControllerSetup setup) {
  return std::make_unique<Mc600>(std::move(setup));
}

}  // namespace turntable
