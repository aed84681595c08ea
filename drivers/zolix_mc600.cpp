#include "drivers/zolix_mc600.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include "drivers/axis_controller.h"
#include "protocols/ascii_dialog.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

constexpr Time kQuiet = milliseconds{50};
constexpr Time kResync = milliseconds{300};
constexpr Time kIdentify = milliseconds{500};
constexpr Time kOddReply = milliseconds{300};  // an axis that stands still so long was not sent off
constexpr Time kLastPoll = milliseconds{100};
constexpr Time kKeeping = milliseconds{400};
constexpr std::string_view kChannels = "XYZT";

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

/// "E01", "E02", "E03" have been seen; any E with two digits is one, and so is "ERR...".
bool is_error(std::string_view reply) {
  const auto digit = [](char c) { return c >= '0' && c <= '9'; };
  const std::string text = upper(reply);
  return text.starts_with("ERR") ||
         (text.size() == 3 && text[0] == 'E' && digit(text[1]) && digit(text[2]));
}

/// Half of the last digit that is shown: "12.3" -> 0.05.
double half_digit(std::string_view text) {
  const std::size_t point = text.find('.');
  const std::size_t digits = point == text.npos ? 0 : text.size() - point - 1;
  return 0.5 * std::pow(10.0, -static_cast<double>(digits));
}

/// "<head><value>,OK" -> value; `head` and `text` tidy.
std::optional<std::string> value_between(std::string_view text, std::string_view head) {
  constexpr std::string_view kTail = ",OK";
  if (!text.starts_with(head) || !text.ends_with(kTail) ||
      text.size() <= head.size() + kTail.size())
    return std::nullopt;
  return std::string(text.substr(head.size(), text.size() - head.size() - kTail.size()));
}

class Mc600 final : public AxisController {
 public:
  explicit Mc600(ControllerSetup setup);

 protected:
  std::string observe(std::vector<std::string>& differences) override;
  void write_setup() override;
  Acknowledgement start_move(const Channel& channel, Steps from, Steps to) override;
  Acknowledgement start_home(const Channel& channel) override;
  AxisStatus<Steps> status(const Channel& channel, Time deadline) override;
  void send_stop(const Channel& channel, bool immediate) override;
  void switch_output(const OutputConfig& output, bool on) override;

 private:
  struct Setting {
    const char* verb;  ///< "SetSpeed"
    std::string value;
    bool known_to_all = true;  ///< false: some controllers may have no such command
  };
  /// What an axis was told last.
  struct Task {
    std::string command, odd_reply;  ///< the latter if it was neither an OK nor a refusal
    Time sent{0};
    std::optional<Steps> from, to;  ///< nothing as long as it is not known
    bool ended = false;             ///< its completion line has come
  };

  bool take_completion(std::string_view line);
  [[noreturn]] static void refused(const std::string& who, const std::string& command,
                                   std::string_view reply);
  std::string ask(const std::string& command, const AsciiDialog::Predicate& accept);
  std::string query(const Channel& channel, const std::string& verb, Time deadline = Time::max());
  std::optional<std::string> query_if_known(const Channel& channel, const std::string& verb);
  void command(const std::string& who, const std::string& text);
  Acknowledgement command_motion(const Channel& channel, Task task);
  /// Whether it was told to move, and nothing has been heard of the end yet.
  bool moves(const Channel& channel) const {
    const auto guard = lock();
    const Task& task = tasks_[channel.index];
    return !task.command.empty() && !task.ended;
  }
  void check_reply(const Channel& channel, const std::string& text, Steps position);
  static std::vector<Setting> settings(const AxisConfig& config);

  AsciiDialog dialog_;
  std::vector<Task> tasks_;  ///< by channel
};

Mc600::Mc600(ControllerSetup setup)
    : AxisController(setup),
      dialog_(line(), clock(), [this](std::string_view line) { return take_completion(line); }),
      tasks_(channels().size()) {
  require_letters(kChannels);
  require_outputs(true);
  dialog_.drop_echo();
}

/// "X 12.345,OK", sent by the controller itself when a motion has ended.
bool Mc600::take_completion(std::string_view line) {
  const std::string text = tidy(line);
  if (text.size() < 2 || text[1] != ' ' || kChannels.find(text[0]) == std::string_view::npos)
    return false;
  const auto value = value_between(text, text.substr(0, 2));
  if (!value || !parse_number(*value)) return false;
  for (const Channel& channel : channels())
    if (letter(channel) == text[0]) tasks_[channel.index].ended = true;
  return true;
}

void Mc600::refused(const std::string& who, const std::string& command, std::string_view reply) {
  throw DeviceError(
      fmt::format("{}: \"{}\" was refused with {}. The manual pages at hand do not define the "
                  "codes; E01 and E02 are believed to mean an unknown or ill-formed command, and "
                  "one that is not allowed now or whose value is not.",
                  who, command, upper(reply)));
}

std::string Mc600::ask(const std::string& command, const AsciiDialog::Predicate& accept) {
  const auto guard = lock();
  if (!dialog_.in_step() && !gives_way()) dialog_.resync(kQuiet, kResync);
  dialog_.hear_out([this] { return gives_way(); });
  return dialog_.ask(command, reply_timeout(), accept, [this] { return gives_way(); });
}

std::string Mc600::query(const Channel& channel, const std::string& verb, Time deadline) {
  const std::string text = fmt::format("{}? {}", verb, letter(channel));
  const std::string head = tidy(text) + ",";
  std::string reply = retried(deadline, [&] {
    return ask(text, [&](std::string_view line) {
      return is_error(line) || value_between(tidy(line), head).has_value();
    });
  });
  if (is_error(reply)) refused(where(channel), text, reply);
  return *value_between(tidy(reply), head);
}

/// Nothing where the controller has no such command.
std::optional<std::string> Mc600::query_if_known(const Channel& channel, const std::string& verb) {
  try {
    return query(channel, verb);
  } catch (const GaveWay&) {
    throw;
  } catch (const DeviceError&) {
  } catch (const TimeoutError&) {
  } catch (const ProtocolError&) {
  }
  return std::nullopt;
}

/// What may be said again: settings, outputs.
void Mc600::command(const std::string& who, const std::string& text) {
  const std::string reply = retried(Time::max(), [&] {
    return ask(text, [](std::string_view line) { return is_error(line) || upper(line) == "OK"; });
  });
  if (is_error(reply)) refused(who, text, reply);
}

Acknowledgement Mc600::command_motion(const Channel& channel, Task task) {
  // Nothing of the past may be taken for the end of this motion.
  if (!dialog_.in_step()) dialog_.resync(kQuiet, kResync);
  dialog_.pump();
  require_no_stop(channel);
  task.sent = clock().now();
  const std::string command = task.command;
  tasks_[channel.index] = std::move(task);
  try {
    const std::string reply = ask(command, [](std::string_view line) {
      return is_error(line) || upper(line) == "READY" || upper(line) == "OK";
    });
    if (is_error(reply)) refused(where(channel), command, reply);
    return Acknowledgement::kReceived;
  } catch (const TimeoutError&) {
    return Acknowledgement::kLost;
  } catch (const ProtocolError& error) {
    tasks_[channel.index].odd_reply = error.what();
    return Acknowledgement::kLost;
  }
}

Acknowledgement Mc600::start_move(const Channel& channel, Steps from, Steps to) {
  // The sign is a letter and the number a magnitude: other drivers disagree about "P,-5".
  Task task;
  task.command = fmt::format("GoPosition {},O,A,{},{}", letter(channel), to.count < 0 ? 'N' : 'P',
                             number(std::abs(channel.unit(to))));
  task.from = from;
  task.to = to;
  return command_motion(channel, std::move(task));
}

Acknowledgement Mc600::start_home(const Channel& channel) {
  Task task;
  task.command = fmt::format("GoHome {}", letter(channel));
  return command_motion(channel, std::move(task));
}

/// An answer that nobody has heard of, or a position with too few digits, is told as what it is
/// before the motion loop calls it a stall.
void Mc600::check_reply(const Channel& channel, const std::string& text, Steps position) {
  Task& task = tasks_[channel.index];
  if (!task.from) task.from = position;
  if (!task.odd_reply.empty() && !task.ended && position == *task.from &&
      clock().now() - task.sent >= kOddReply + reply_timeout())
    throw DeviceError(
        fmt::format("{}: {} The axis has not moved since.", where(channel), task.odd_reply));
  if (!task.ended || !task.to) return;
  const double off = std::abs(channel.unit(position) - channel.unit(*task.to));
  if (off > std::max(channel.config.tolerance, channel.config.per_step()) &&
      off <= half_digit(text) + 1e-9)
    throw DeviceError(fmt::format(
        "{}: after \"{}\" the controller says that it stands at \"{}\", with {} digits after the "
        "point: too few to tell whether it is within the window of {:g} {}. Choose a unit or a "
        "setting of the controller with more digits, or a wider tolerance in the rig file.",
        where(channel), task.command, text,
        text.find('.') == text.npos ? 0 : text.size() - text.find('.') - 1,
        channel.config.tolerance, channel.config.unit()));
}

AxisStatus<Steps> Mc600::status(const Channel& channel, Time deadline) {
  const bool moved = moves(channel);  // when it is asked; the answer may come after the end
  std::string text;
  double position = 0;
  AxisStatus<Steps> status;
  try {
    position = retried(deadline, [&] {
      text = query(channel, "Position", Time{0});
      const auto value = parse_number(text);
      if (!value)
        throw ProtocolError(
            fmt::format("{}: its position, {}, is not a number", where(channel), in_quotes(text)));
      return *value;
    });
  } catch (const DeviceError&) {
    // Whether it tells positions while it moves nobody has said. Until the end is due, perhaps not.
    if (!moved || clock().now() + kLastPoll >= deadline) throw;
    status.motion = Motion::kMoving;
    return status;
  }
  const auto guard = lock();
  status.position = channel.steps(position);
  check_reply(channel, text, *status.position);
  if (tasks_[channel.index].ended) status.motion = Motion::kEnded;
  return status;
}

void Mc600::send_stop(const Channel& channel, bool) {  // there is only one kind
  // No time for a resync. Whether the axis halts is seen by its position, so any kind of answer
  // will do.
  for (int i = 1; i <= attempts(); ++i) {
    const std::string reply = retried(Time::max(), [&] {
      return dialog_.ask(
          fmt::format("Stop {}", letter(channel)), reply_timeout(),
          [](std::string_view line) { return is_error(line) || upper(line) == "OK"; });
    });
    if (!is_error(reply)) return;  // refused: it was garbled, perhaps
  }
}

void Mc600::switch_output(const OutputConfig& output, bool on) {
  command(fmt::format("output {} of {}", output.name, config().name),
          on ? output.on_text : output.off_text);
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
  all.push_back({"SetHomeSpeed", number(config.home_speed)});
  all.push_back({"SetUserPositiveLimit", number(config.upper)});
  all.push_back({"SetUserNegativeLimit", number(config.lower)});
  all.push_back({"SetUserLimitAble", "E"});
  // A way back after homing, whose end counts as 0 then.
  all.push_back({"SetOffset", "0", false});
  return all;
}

std::string Mc600::observe(std::vector<std::string>& differences) {
  const std::string reply = retried(Time::max(), [&] {
    return ask("Hello",
               [](std::string_view line) { return is_error(line) || upper(line) == "OK"; });
  });
  if (is_error(reply))
    refused(fmt::format("controller {} on {}", config().name, line_name()), "Hello", reply);
  std::string unanswered;
  for (const Channel& channel : channels())
    for (const Setting& setting : settings(channel.config)) {
      const std::optional<std::string> answer = setting.known_to_all
                                                    ? query(channel, setting.verb)
                                                    : query_if_known(channel, setting.verb);
      if (!answer) {
        unanswered += fmt::format("; does not answer {}? {}", setting.verb, letter(channel));
        continue;
      }
      const std::string& value = *answer;
      const auto wanted_number = parse_number(setting.value), found_number = parse_number(value);
      const bool same = wanted_number && found_number ? std::abs(*wanted_number - *found_number) <=
                                                            1e-5 + 1e-6 * std::abs(*wanted_number)
                                                      : upper(setting.value) == value;
      if (!same)
        differences.push_back(difference(
            channel, fmt::format("{}? {}", setting.verb, letter(channel)), setting.value, value));
    }
  return "answers Hello; it does not tell its version" + unanswered;
}

void Mc600::write_setup() {
  bool keeps = false;
  for (const Channel& channel : channels())
    for (const Setting& setting : settings(channel.config)) {
      const std::string text =
          fmt::format("{} {},{}", setting.verb, letter(channel), setting.value);
      try {
        command(where(channel), text);
      } catch (const DeviceError&) {
        if (!setting.known_to_all) continue;
        // Other programs wait so long between settings; it may be busy keeping the one before.
        keeps = true;
        clock().sleep_for(kKeeping);
        command(where(channel), text);
      }
    }
  if (keeps) clock().sleep_for(kKeeping);
}

}  // namespace

std::unique_ptr<Controller> open_zolix_mc600(ControllerSetup setup) {
  return std::make_unique<Mc600>(std::move(setup));
}

std::string identify_zolix_mc600(SharedLine line, Clock& clock) {
  AsciiDialog dialog(std::move(line), clock, {});
  dialog.drop_echo();
  dialog.resync(kQuiet, kResync);  // what others may have said to it before
  try {
    dialog.ask("Hello", kIdentify, [](std::string_view reply) { return upper(reply) == "OK"; });
    return "Zolix MC600";
  } catch (const TimeoutError&) {
  } catch (const ProtocolError&) {
  }
  return {};
}

}  // namespace turntable
