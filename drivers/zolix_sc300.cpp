#include "drivers/zolix_sc300.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <utility>

#include "drivers/axis_controller.h"
#include "protocols/ascii_dialog.h"
#include "src/core/motion_time.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

constexpr Time kQuiet = milliseconds{50};
constexpr Time kResync = milliseconds{300};
constexpr Time kListen = milliseconds{10};
constexpr Time kLastPoll = milliseconds{100};
constexpr Time kIdentify = milliseconds{500};
constexpr Time kRefusal = milliseconds{30};  // within which a motion is refused, if it is
constexpr int kDoubt = 2;        // reply timeouts for which a late answer is still expected
constexpr int kSameTwice = 4;    // reads in which two in a row have to agree
constexpr double kRoom_s = 0.5;  // beside the motion itself, until its end is overdue
constexpr std::string_view kChannels = "XYZ";
constexpr std::string_view kType = "SC300";

std::optional<std::int64_t> whole(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// "E0", "E1", "ER".
bool is_error(std::string_view reply) {
  const std::string text = upper(reply);
  return text == "ER" || (text.size() >= 2 && text.size() <= 3 && text[0] == 'E' &&
                          std::all_of(text.begin() + 1, text.end(), is_digit));
}

bool is_ok(std::string_view reply) { return upper(reply) == "OK"; }

/// "SC300", "SC300-1B", "SC300_V1.0", or whatever else a firmware makes of it.
bool is_sc300(std::string_view reply) { return upper(reply).find(kType) != std::string::npos; }

/// "?Y,-123": whose counter it is, and what it says, if that can be read. Noise before it is
/// dropped.
struct CounterLine {
  char letter;
  std::optional<Steps> counter;
};

std::optional<CounterLine> counter_line(std::string_view line) {
  const std::size_t begin = line.rfind('?');
  if (begin == line.npos || line.size() < begin + 2) return std::nullopt;
  const std::string text = tidy(line.substr(begin + 1));
  if (kChannels.find(text[0]) == kChannels.npos) return std::nullopt;
  CounterLine found{text[0], {}};
  if (text.size() > 2 && text[1] == ',')
    if (const auto value = whole(std::string_view(text).substr(2))) found.counter = Steps{*value};
  return found;
}

class Sc300 final : public AxisController {
 public:
  explicit Sc300(ControllerSetup setup);

 protected:
  std::string observe(std::vector<std::string>& differences) override;
  void write_setup() override;
  bool free(const Channel& channel) override;
  Acknowledgement start_move(const Channel& channel, Steps from, Steps to) override;
  Acknowledgement start_home(const Channel& channel) override;
  AxisStatus<Steps> status(const Channel& channel, Time deadline) override;
  void send_stop(const Channel& channel, bool immediate) override;
  void switch_output(const OutputConfig& output, bool on) override;

 private:
  /// What an axis was last told to do, until it is told something else.
  struct Task {
    std::string command;
    std::optional<Steps> from;        ///< of a move; nothing for a homing
    Time overdue{0};                  ///< when its end should have been reported
    bool stopped = false;             ///< by us: where it ends says nothing
    std::optional<Steps> reported{};  ///< by a line owed to no question
    std::optional<Steps> swapped{};   ///< or by the one before, if that one was the answer
    bool answered = false;            ///< by a controller that does not while anything moves
    std::optional<std::string> refusal{};
    std::optional<Steps> seen{};  ///< the counter, first
    std::optional<Steps> last{};  ///< and last
    bool still = false;           ///< it was the same twice
    bool moved = false;           ///< it has been seen elsewhere since
  };
  struct State {
    std::optional<Task> task;
    std::vector<Time> questions;   ///< for the counter, still owed an answer; when they were sent
    Time in_doubt_until{0};        ///< one of them was not answered in time
    std::optional<Steps> at_rest;  ///< the counter when last read, if nothing was started since
  };
  enum class Waiting { kNot, kForQuiet, kForAnswer };
  /// While somebody waits for an answer, the lines that may be it are left to him.
  class Awaiting {
   public:
    Awaiting(Sc300& driver, Waiting what, std::optional<std::size_t> counter_of = {})
        : driver_(driver) {
      driver_.waiting_ = what;
      driver_.counter_of_ = counter_of;
    }
    ~Awaiting() {
      driver_.waiting_ = Waiting::kNot;
      driver_.counter_of_.reset();
    }

   private:
    Sc300& driver_;
  };
  struct Setting {
    char name;
    std::int64_t value;  ///< pulses/s, pulses/s^2
  };

  State& state(const Channel& channel) { return states_[channel.index]; }
  static std::vector<Setting> settings(const Channel& channel);
  std::string who() const { return fmt::format("controller {} on {}", config().name, line_name()); }

  bool take_line(std::string_view line);
  void resync();
  void take_counter(const Channel& channel, std::optional<Steps> counter);
  void listen_for_report(const State& state);
  bool hidden(const State& state) const;
  bool still_hidden(State& state);
  [[noreturn]] static void refused(const std::string& who, const std::string& command,
                                   std::string_view reply, std::string_view hint = {});
  std::string ask(const std::string& command, const AsciiDialog::Predicate& accept,
                  std::optional<std::size_t> counter_of = {});
  std::string named(const std::string& command);
  std::int64_t setting(const Channel& channel, char name);
  void command(const std::string& who, const std::string& text);
  Steps counter(const Channel& channel, Time deadline);
  void require_counter(const Channel& channel, Steps expected);
  Acknowledgement begin(const Channel& channel, Task task);

  AsciiDialog dialog_;
  std::vector<State> states_;  ///< by channel
  std::optional<std::size_t> last_started_;
  Time resync_at_{0};  ///< the last one
  Time latency_{0};    ///< the longest that an answer has taken
  Waiting waiting_ = Waiting::kNot;
  std::optional<std::size_t> counter_of_;  ///< what is awaited may be the counter of this channel
};

Sc300::Sc300(ControllerSetup setup)
    : AxisController(setup),
      dialog_(line(), clock(), [this](std::string_view line) { return take_line(line); }),
      states_(channels().size()) {
  require_letters(kChannels);
  require_outputs(true);
  dialog_.drop_echo();
}

// ---- lines, and whose they are

/// Sees every line first. @return true if nobody waits for it.
bool Sc300::take_line(std::string_view line) {
  if (const auto found = counter_line(line)) {
    for (const Channel& channel : channels()) {
      if (letter(channel) != found->letter) continue;
      const bool wanted = counter_of_ == channel.index;
      take_counter(channel, found->counter);
      return !wanted;
    }
    return true;  // a channel that is moved by hand
  }
  if (is_ok(line) && waiting_ == Waiting::kForQuiet)
    for (State& s : states_)
      std::erase_if(s.questions, [&](Time sent) { return sent < resync_at_; });
  if (waiting_ != Waiting::kNot || !is_error(line)) return false;
  // Nothing was asked: the last motion was refused, and it took a while to say so.
  if (last_started_)
    if (auto& task = states_[*last_started_].task; task && !task->stopped && !task->reported)
      task->refusal = std::string(line);
  return true;
}

/// Counts: answers go to the questions in their order; what is left over reports an end.
void Sc300::take_counter(const Channel& channel, std::optional<Steps> value) {
  State& s = state(channel);
  const bool in_doubt = clock().now() < s.in_doubt_until;
  const bool asked = counter_of_ == channel.index;
  if (!in_doubt && s.questions.size() > (asked ? 1u : 0u))
    s.questions.erase(s.questions.begin(), s.questions.end() - (asked ? 1 : 0));
  if (!s.questions.empty()) {
    s.questions.erase(s.questions.begin());
    if (asked) counter_of_.reset();
    return;
  }
  if (!s.task || !value) return;
  // Where a move began is not where it ended, and a homing that nobody saw move has not ended while
  // a late answer may still come: those are lines of the past.
  if (value == s.task->from || (in_doubt && !s.task->from && !s.task->moved)) return;
  s.task->reported = value;
  // Where it began says nothing: a spoilt line must not make a homed axis.
  s.task->swapped = s.task->last == s.task->seen ? std::nullopt : s.task->last;
}

/// Back in step. A controller answers in order: once it has answered this CR, what it has not
/// answered of the questions before never will be.
void Sc300::resync() {
  const Awaiting quiet(*this, Waiting::kForQuiet);
  resync_at_ = clock().now();
  // A CR is answered, but for a controller that hears nothing while it moves.
  const bool deaf =
      !config().answers_while_moving && std::ranges::any_of(states_, [](const State& s) {
        return s.task && !s.task->answered && !s.task->reported;
      });
  dialog_.resync(kQuiet, deaf ? kResync : std::max(kResync, reply_timeout()), is_ok,
                 [this] { return gives_way(); });
}

/// The report of an end may have come between a question and its answer, and been taken for that.
/// If each answer then comes after the next question, they are one behind for ever. So an axis that
/// has come to rest is asked no more until the answer that is left over has had time to come.
void Sc300::listen_for_report(const State& s) {
  const Time end = clock().now() + latency_ + kQuiet;
  while (clock().now() < end) {
    {
      const auto guard = lock();
      if (gives_way()) return;
      dialog_.pump();
      if (!s.task || s.task->reported || s.task->refusal) return;
    }
    clock().sleep_for(std::min(kListen, end - clock().now()));
  }
}

/// Whether a controller that does not answer while it moves is believed to move this axis.
bool Sc300::hidden(const State& s) const {
  return !config().answers_while_moving && s.task && !s.task->answered && !s.task->reported &&
         clock().now() < s.task->overdue;
}

void Sc300::refused(const std::string& who, const std::string& command, std::string_view reply,
                    std::string_view hint) {
  throw DeviceError(
      fmt::format("{}: \"{}\" was refused with {}. The manual pages at hand do not define E0, E1 "
                  "and ER; they are believed to mean an unknown or ill-formed command, one that is "
                  "not allowed now or whose value is not, and a drive that cannot move.{}",
                  who, command, upper(reply), hint));
}

std::string Sc300::ask(const std::string& command, const AsciiDialog::Predicate& accept,
                       std::optional<std::size_t> counter_of) {
  const auto guard = lock();
  if (!dialog_.in_step() && !gives_way()) resync();
  dialog_.hear_out([this] { return gives_way(); });
  if (counter_of) states_[*counter_of].questions.push_back(clock().now());
  const Awaiting awaiting(*this, Waiting::kForAnswer, counter_of);
  try {
    const Time sent = clock().now();
    std::string reply =
        dialog_.ask(command, reply_timeout(), accept, [this] { return gives_way(); });
    latency_ = std::max(latency_, clock().now() - sent);
    return reply;
  } catch (const Error&) {
    if (counter_of) states_[*counter_of].in_doubt_until = clock().now() + kDoubt * reply_timeout();
    throw;
  }
}

/// What may be said again: settings, outputs.
void Sc300::command(const std::string& who, const std::string& text) {
  const std::string reply = retried(Time::max(), [&] {
    return ask(text, [](std::string_view line) { return is_error(line) || is_ok(line); });
  });
  if (is_error(reply)) refused(who, text, reply);
}

Steps Sc300::counter(const Channel& channel, Time deadline) {
  const std::string text = fmt::format("?{}", letter(channel));
  const std::string reply = retried(deadline, [&] {
    return ask(
        text,
        [&](std::string_view line) {
          const auto found = counter_line(line);
          return is_error(line) || (found && found->counter && found->letter == letter(channel));
        },
        channel.index);
  });
  const auto guard = lock();
  State& s = state(channel);
  if (is_error(reply)) {
    if (!s.questions.empty()) s.questions.pop_back();
    const bool late = s.task && !s.task->stopped && !s.task->reported && !s.task->answered;
    refused(where(channel), late ? fmt::format("{}, after {},", text, s.task->command) : text,
            reply,
            late && config().answers_while_moving
                ? " If it answers like this whenever something moves, set answers_while_moving to "
                  "false in the rig file."
                : "");
  }
  s.at_rest = counter_line(reply)->counter;
  if (s.task) {
    s.task->answered = !config().answers_while_moving;
    s.task->moved |= s.task->seen && s.task->seen != s.at_rest;
    s.task->still = s.task->last == s.at_rest;
    s.task->last = s.at_rest;
    if (!s.task->seen) s.task->seen = s.at_rest;
  }
  return *s.at_rest;
}

// ---- motion

/// A move made from a counter that was misread would go anywhere.
void Sc300::require_counter(const Channel& channel, Steps expected) {
  std::optional<Steps> before;
  for (int i = 0; i < kSameTwice; ++i) {
    const Steps now = counter(channel, Time::max());
    if (now == before) {
      if (now == expected) return;
      throw DeviceError(
          fmt::format("{}: its counter stands at {} instead of {} pulses ({:.6g} instead of {:.6g} "
                      "{}): moved by hand, or reset. Nothing was sent. Home it again.",
                      where(channel), now.count, expected.count, channel.unit(now),
                      channel.unit(expected), channel.config.unit()));
    }
    before = now;
  }
  throw ProtocolError(
      fmt::format("{}: its counter reads differently each time although it should stand still. "
                  "Nothing was sent. Check the cable, and that nobody moves it by hand.",
                  where(channel)));
}

/// Sends it once. There is no acknowledgement, only a refusal at once or the report of the end.
Acknowledgement Sc300::begin(const Channel& channel, Task task) {
  State& s = state(channel);
  if (!dialog_.in_step()) resync();
  dialog_.pump();  // nothing of the past may be taken for the end of this motion
  require_no_stop(channel);
  const std::string command = task.command;
  task.seen = s.at_rest;
  s.task = std::move(task);
  last_started_ = channel.index;
  s.at_rest.reset();
  try {
    dialog_.tell(command, reply_timeout());
  } catch (const TimeoutError&) {
    return Acknowledgement::kLost;
  }
  const Time end = clock().now() + kRefusal;
  while (!s.task->refusal && !s.task->reported &&
         clock().wait_readable(dialog_.line().descriptor(), end) && clock().now() < end)
    dialog_.pump();
  dialog_.pump();
  if (const auto refusal = s.task->refusal) {
    s.task.reset();
    refused(where(channel), command, *refusal);
  }
  return s.task->reported ? Acknowledgement::kReceived : Acknowledgement::kLost;
}

Acknowledgement Sc300::start_move(const Channel& channel, Steps from, Steps to) {
  require_counter(channel, from);
  const std::int64_t way = to.count - from.count;
  const double takes = trapezoid_seconds(channel.config, channel.unit(Steps{std::abs(way)}));
  return begin(channel, {.command = fmt::format("{}{},{}", way < 0 ? '-' : '+', letter(channel),
                                                std::abs(way)),
                         .from = from,
                         .overdue = clock().now() + from_seconds(1.05 * takes + kRoom_s)});
}

Acknowledgement Sc300::start_home(const Channel& channel) {
  const AxisConfig& axis = channel.config;
  // Until `status` says how long the loop waits for it.
  const double across = (axis.upper - axis.lower) / axis.home_speed;
  return begin(channel, {.command = fmt::format("H{}", letter(channel)),
                         .from = {},
                         .overdue = clock().now() + from_seconds(2 * across + kRoom_s)});
}

bool Sc300::free(const Channel&) {
  dialog_.pump();
  return std::ranges::none_of(states_, [&](const State& s) { return hidden(s); });
}

/// A controller that does not answer while it moves has not answered: so what was heard was not the
/// end.
bool Sc300::still_hidden(State& s) {
  const auto guard = lock();
  if (config().answers_while_moving || !s.task || s.task->answered) return false;
  s.task->reported.reset();
  return true;
}

AxisStatus<Steps> Sc300::status(const Channel& channel, Time deadline) {
  State& s = state(channel);
  AxisStatus<Steps> status;
  bool at_rest = false;
  {
    const auto guard = lock();
    dialog_.pump();
    if (s.task && s.task->refusal) {
      const Task task = *std::exchange(s.task, {});
      refused(where(channel), task.command, *task.refusal);
    }
    if (hidden(s)) {
      if (!s.task->from && !s.task->stopped)  // a homing: how long that takes, the loop knows
        s.task->overdue = std::max(s.task->overdue, deadline);
      status.motion = Motion::kMoving;
      return status;
    }
    if (std::ranges::any_of(states_, [&](const State& other) { return hidden(other); })) {
      status.position = s.at_rest;
      return status;
    }
    at_rest = s.task && s.task->still && !s.task->stopped && !s.task->reported;
  }
  if (at_rest) listen_for_report(s);
  try {
    status.position = counter(channel, deadline);
  } catch (const GaveWay&) {
    throw;
  } catch (const TimeoutError&) {
    if (!still_hidden(s)) throw;
    status.motion = Motion::kMoving;
    return status;
  } catch (const DeviceError&) {  // or an E1 for "not now"
    if (!still_hidden(s) || clock().now() + kLastPoll >= deadline) throw;
    status.motion = Motion::kMoving;
    return status;
  }
  const auto guard = lock();
  if (s.task && !s.task->stopped && s.task->reported &&
      (s.task->reported == status.position ||
       (s.task->swapped && s.task->swapped == status.position)))
    status.motion = Motion::kEnded;
  return status;
}

void Sc300::send_stop(const Channel& channel, bool) {  // there is only one kind
  // No time for a resync. Whether the axis halts is seen by its counter, so any kind of answer will
  // do: the facts do not say which one it is.
  const AxisConfig& axis = channel.config;
  if (std::optional<Task>& task = state(channel).task) {
    task->stopped = true;
    task->refusal.reset();
    task->overdue = clock().now() + from_seconds(axis.speed / axis.acceleration + kRoom_s);
  }
  for (int i = 1; i <= attempts(); ++i) {
    const std::string reply = retried(Time::max(), [&] {
      const Awaiting awaiting(*this, Waiting::kForAnswer, channel.index);
      return dialog_.ask(fmt::format("SP{}", letter(channel)), reply_timeout(),
                         [](std::string_view line) {
                           return is_error(line) || is_ok(line) || counter_line(line).has_value();
                         });
    });
    if (!is_error(reply)) return;  // refused: it was garbled, perhaps
  }
}

void Sc300::switch_output(const OutputConfig& output, bool on) {
  command(fmt::format("output {} of {}", output.name, config().name),
          on ? output.on_text : output.off_text);
}

// ---- who is there, and how it is set up

/// "SC300_V1.0", or any other text; noise and answers to something else are no names.
std::string Sc300::named(const std::string& command) {
  const auto is_name = [](std::string_view line) {
    return !is_ok(line) && !counter_line(line) && line.size() > 1 &&
           std::ranges::all_of(line, [](char c) { return c >= ' ' && c <= '~'; }) &&
           std::ranges::any_of(line, [](char c) {
             return upper({&c, 1})[0] >= 'A';
           });
  };
  const std::string reply = retried(Time::max(), [&] { return ask(command, is_name); });
  if (is_error(reply)) refused(who(), command, reply);
  return reply;
}

/// Top speed, speed at which a move begins and ends, acceleration.
std::vector<Sc300::Setting> Sc300::settings(const Channel& channel) {
  const AxisConfig& axis = channel.config;
  return {{'V', channel.steps(axis.speed).count},
          {'F', channel.steps(axis.initial_speed).count},
          {'A', channel.steps(axis.acceleration).count}};
}

/// "XV" -> "..,20000": what the two characters are is not known.
std::int64_t Sc300::setting(const Channel& channel, char name) {
  const auto value = [](std::string_view line) {
    const std::string text = tidy(line);
    return text.size() > 3 && text[2] == ',' ? whole(std::string_view(text).substr(3))
                                             : std::nullopt;
  };
  const std::string text = fmt::format("{}{}", letter(channel), name);
  const std::string reply = retried(Time::max(), [&] {
    return ask(text, [&](std::string_view line) { return is_error(line) || value(line); });
  });
  if (is_error(reply)) refused(where(channel), text, reply);
  return *value(reply);
}

std::string Sc300::observe(std::vector<std::string>& differences) {
  // A lone CR ends what may have been half said, and is answered by itself.
  retried(Time::max(), [&] { return ask("", is_ok); });
  const std::string version = named("VE");
  std::string type = named("TY");
  if (!is_sc300(type)) type = named("TY");  // a line that came late
  if (!is_sc300(type) && !is_sc300(version))
    throw DeviceError(fmt::format(
        "{}: says that it is a {} (version {}), expected {}. Correct the model in the rig "
        "file, or the line.",
        who(), in_quotes(type), in_quotes(version), kType));
  const std::string id = named("ID");
  for (const Channel& channel : channels()) {
    for (const auto& [name, wanted] : settings(channel)) {
      std::int64_t found = setting(channel, name);
      if (found != wanted) found = setting(channel, name);  // misread, or a line that came late
      if (found != wanted)
        differences.push_back(difference(channel, fmt::format("{}{}", letter(channel), name),
                                         std::to_string(wanted), std::to_string(found)));
    }
    if (!config().answers_while_moving) counter(channel, Time::max());
  }
  return fmt::format("{} {} {}", type, version, id);
}

void Sc300::write_setup() {
  for (const Channel& channel : channels())
    for (const auto& [name, value] : settings(channel))
      command(where(channel), fmt::format("{}{},{}", name, letter(channel), value));
}

}  // namespace

std::unique_ptr<Controller> open_zolix_sc300(ControllerSetup setup) {
  return std::make_unique<Sc300>(std::move(setup));
}

std::string identify_zolix_sc300(SharedLine line, Clock& clock) {
  AsciiDialog dialog(std::move(line), clock, {});
  dialog.drop_echo();
  dialog.resync(kQuiet, kResync, is_ok);  // what others may have said to it before
  try {
    return "Zolix " + dialog.ask("VE", kIdentify, is_sc300);
  } catch (const TimeoutError&) {
  } catch (const ProtocolError&) {
  }
  return {};
}

}  // namespace turntable
