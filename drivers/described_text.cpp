#include "drivers/described_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "drivers/axis_controller.h"
#include "drivers/controller_description.h"
#include "protocols/ascii_dialog.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using Kind = WordMeaning::Kind;
using Exchange = ControllerDescription::Exchange;

constexpr Time kQuiet = milliseconds{50};
constexpr Time kResync = milliseconds{300};
constexpr unsigned kLargestId = 99;
// Of a pulse: a servo that holds its place tells a little more and a little less.
constexpr double kSamePlace = 0.75;

/// Zaber's: all letters but the first, and this, add up to a multiple of 256.
unsigned lrc_of(std::string_view line) {
  unsigned sum = 0;
  for (const char c : line.substr(std::min<std::size_t>(1, line.size())))
    sum += static_cast<unsigned char>(c);
  return (256u - sum % 256u) % 256u;
}

class DescribedText final : public AxisController {
 public:
  explicit DescribedText(ControllerSetup setup);

 protected:
  std::string observe(std::vector<std::string>& differences) override;
  void write_setup() override;
  Acknowledgement start_move(const Channel& channel, Steps from, Steps to) override;
  Acknowledgement start_home(const Channel& channel) override;
  bool count_from_home(const Channel& channel) override;
  AxisStatus<Steps> status(const Channel& channel, Time deadline) override;
  bool may_be_homed(const Channel& channel) override;
  bool positions_are_absolute() const override { return description_.absolute; }
  void send_stop(const Channel& channel, bool immediate) override;
  void switch_output(const OutputConfig& output, bool on) override;

 private:
  enum class Task { kNone, kMove, kHome };
  /// What is known of an axis since it was last told something.
  struct State {
    Task task = Task::kNone;
    bool acknowledged = false;
    bool moved = false;              ///< seen to
    bool not_homed = false;          ///< the controller says so
    std::optional<Steps> position;   ///< as last told
    std::optional<double> rests_at;  ///< since `since`, in the axis' unit
    Time since{0};
  };
  /// An answer: what stands in its places, and what its words mean.
  struct Heard {
    TextTemplate::Places places;
    std::vector<WordMeaning> words;
    bool refused = false;
    std::string line;  ///< as it came
    std::string said;  ///< what it answers
  };

  State& state(const Channel& channel) { return states_[channel.index]; }
  std::string who() const { return fmt::format("controller {} on {}", config().name, line_name()); }
  bool is_unasked(std::string_view line) const;
  std::optional<std::string> content(std::string_view line) const;
  std::optional<Heard> understood(std::string_view line, const Exchange& exchange,
                                  const TextTemplate::Places& given) const;
  std::vector<WordMeaning> meanings(const Heard& heard) const;
  std::string said(const Exchange& exchange, TextTemplate::Places& places);
  Heard say(const Exchange& exchange, TextTemplate::Places places, bool patient = true);
  [[noreturn]] static void refuse(const std::string& whom, const Heard& heard);
  Heard command(const std::string& whom, const Exchange& exchange,
                const TextTemplate::Places& places, Time deadline = Time::max());
  Acknowledgement begin(const Channel& channel, const Exchange& exchange, Task task, Steps to);
  template <class F>
  void for_each_meant(const Exchange& exchange, F&& action) const;
  static TextTemplate::Places axis_of(const Channel& channel) {
    return {{"axis", channel.config.channel}};
  }
  double told_position(const Channel& channel, const Heard& heard) const;
  Steps on_pulse(State& state, const Channel& channel, double told) const;
  Motion motion(State& state, const Channel& channel, double told, bool says_moving,
                bool says_ended);

  ControllerDescription description_;
  AsciiDialog dialog_;
  std::vector<State> states_;  ///< by channel
  unsigned id_ = 0;
};

DescribedText::DescribedText(ControllerSetup setup)
    : AxisController(setup),
      description_(load_description(config())),
      dialog_(line(), clock(), [this](std::string_view line) { return is_unasked(line); }),
      states_(channels().size()) {
  require_outputs(true);
  for (const OutputConfig& output : config().outputs)
    for (const std::string& text : {output.on_text, output.off_text})
      if (text.find_first_of("{}") != text.npos)
        throw ConfigError(
            "rig", fmt::format("/controllers/{}/outputs/{}", config().name, output.name),
            fmt::format("found \"{}\", allowed: texts without braces, said as they are.", text));
  for (const Channel& channel : channels()) check_axis(description_, channel.config);
  dialog_.set_ends(description_.command_end, description_.answer_end);
  if (description_.echo) dialog_.drop_echo();
}

// ---- lines and what they say

/// Without what says nothing; nothing at all if the check sum is wrong.
std::optional<std::string> DescribedText::content(std::string_view line) const {
  line.remove_prefix(std::min(description_.answer_skips, line.size()));
  const std::size_t colon = line.rfind(':');
  if (description_.lrc && colon != line.npos && colon + 3 == line.size()) {
    if (upper(line.substr(colon + 1)) != fmt::format("{:02X}", lrc_of(line.substr(0, colon))))
      return std::nullopt;
    line = line.substr(0, colon);
  }
  return std::string(line);
}

/// Sees every line first. Without what it may be told of, nobody waits for it.
bool DescribedText::is_unasked(std::string_view line) const {
  const auto text = content(line);
  if (!text) return false;
  return std::ranges::any_of(description_.unasked, [&](const TextTemplate& unasked) {
    return std::ranges::any_of(channels(), [&](const Channel& channel) {
      TextTemplate::Places given = axis_of(channel);
      given["id"] = "";
      return unasked.find(*text, given).has_value();
    });
  });
}

std::optional<DescribedText::Heard> DescribedText::understood(
    std::string_view line, const Exchange& exchange, const TextTemplate::Places& given) const {
  const auto text = content(line);
  if (!text) return std::nullopt;
  for (const TextTemplate& refusal : description_.refused)
    if (auto places = refusal.find(*text, given))
      return Heard{std::move(*places), {}, true, std::string(line), {}};
  for (const TextTemplate& reply : exchange.replies)
    if (auto places = reply.find(*text, given))
      return Heard{std::move(*places), {}, false, std::string(line), {}};
  return std::nullopt;
}

std::vector<WordMeaning> DescribedText::meanings(const Heard& heard) const {
  std::vector<WordMeaning> all;
  for (const auto& [place, list] : description_.words) {
    const auto word = heard.places.find(place);
    if (word == heard.places.end()) continue;
    auto meaning = list.find(upper(word->second));
    // A number among words is the answer to another question.
    if (meaning == list.end() && !plain_number(word->second)) meaning = list.find("*");
    if (meaning == list.end())
      throw ProtocolError(fmt::format(
          "{}: the answer {} has {} for {{{}}}, which the description {} does not know. Add the "
          "word to "
          "/words/{} there if the controller's manual has it; else check baud rate and cable.",
          who(), in_quotes(heard.line), in_quotes(word->second), place, description_.name, place));
    all.push_back(meaning->second);
  }
  return all;
}

/// The line for an exchange; what it has to be answered with is added to `places`.
std::string DescribedText::said(const Exchange& exchange, TextTemplate::Places& places) {
  id_ = id_ % kLargestId + 1;
  places["id"] = fmt::format("{}", id_);
  if (!places.contains("axis")) places["axis"] = "";
  std::string text = exchange.send.fill(places);
  if (description_.lrc) text += fmt::format(":{:02X}", lrc_of(text));
  return text;
}

/// Once. @param patient false: there is no time for a way back into step.
DescribedText::Heard DescribedText::say(const Exchange& exchange, TextTemplate::Places places,
                                        bool patient) {
  const auto guard = lock();
  if (patient) {
    if (!dialog_.in_step() && !gives_way()) dialog_.resync(kQuiet, kResync);
    dialog_.hear_out([this] { return gives_way(); });
  }
  const std::string text = said(exchange, places);
  if (exchange.replies.empty()) {
    dialog_.tell(text, reply_timeout());
    return {};
  }
  std::optional<Heard> heard;
  const auto accept = [&](std::string_view line) {
    heard = understood(line, exchange, places);
    return heard.has_value();
  };
  if (patient)
    dialog_.ask(text, reply_timeout(), accept, [this] { return gives_way(); });
  else
    dialog_.ask(text, reply_timeout(), accept);
  heard->said = text;
  heard->words = meanings(*heard);
  return std::move(*heard);
}

void DescribedText::refuse(const std::string& whom, const Heard& heard) {
  std::string why;
  for (const WordMeaning& word : heard.words)
    if (!word.text.empty()) why += (why.empty() ? "" : "; ") + word.text;
  throw DeviceError(fmt::format("{}: \"{}\" was refused with {}{}.", whom, heard.said,
                                in_quotes(heard.line), why.empty() ? "" : ", that is: " + why));
}

/// What may be said again: questions and settings.
DescribedText::Heard DescribedText::command(const std::string& whom, const Exchange& exchange,
                                            const TextTemplate::Places& places, Time deadline) {
  Heard heard = retried(deadline, [&] {
    Heard answer = say(exchange, places);
    if (answer.refused && std::ranges::any_of(answer.words, [](const WordMeaning& word) {
          return word.kind == Kind::kBusy;
        }))
      throw BusyError(fmt::format("{}: \"{}\" was answered by {}: the controller is busy", whom,
                                  answer.said, in_quotes(answer.line)));
    return answer;
  });
  if (heard.refused) refuse(whom, heard);
  return heard;
}

// ---- motion

Acknowledgement DescribedText::begin(const Channel& channel, const Exchange& exchange, Task task,
                                     Steps to) {
  // Nothing of the past may be taken for the answer to this.
  if (!dialog_.in_step()) dialog_.resync(kQuiet, kResync);
  dialog_.pump();
  require_no_stop(channel);
  State& s = state(channel);
  const auto position = s.position;
  s = State{};
  s.task = task;
  s.position = position;
  s.since = clock().now();
  TextTemplate::Places places = axis_of(channel);
  places["value"] = description_.position.shown(channel.unit(to), channel.config);
  try {
    const Heard heard = say(exchange, places);
    if (heard.refused) refuse(where(channel), heard);
    s.acknowledged = !exchange.replies.empty();
    return s.acknowledged ? Acknowledgement::kReceived : Acknowledgement::kLost;
  } catch (const TimeoutError&) {
    return Acknowledgement::kLost;
  } catch (const ProtocolError&) {
    return Acknowledgement::kLost;
  }
}

Acknowledgement DescribedText::start_move(const Channel& channel, Steps, Steps to) {
  return begin(channel, description_.move, Task::kMove, to);
}

Acknowledgement DescribedText::start_home(const Channel& channel) {
  if (description_.absolute) return begin(channel, description_.move, Task::kHome, Steps{0});
  return begin(channel, description_.home, Task::kHome, Steps{0});
}

/// A homing whose end cannot be told from its never having begun does not count: better homed twice
/// than not.
bool DescribedText::count_from_home(const Channel& channel) {
  const State& s = state(channel);
  if (s.not_homed)
    throw DeviceError(
        fmt::format("{}: homing has ended, and the controller still says that it does not know "
                    "where the axis is. "
                    "Check the home switch, and for a reset; then home it again.",
                    where(channel)));
  if (!description_.absolute && !s.acknowledged && !s.moved)
    throw DeviceError(fmt::format(
        "{}: the homing was not acknowledged, and the axis was not seen to move. Home it "
        "again.",
        where(channel)));
  return false;
}

bool DescribedText::may_be_homed(const Channel& channel) {
  status(channel, clock().now() + reply_timeout());
  return !state(channel).not_homed;
}

/// @return in the axis' unit.
double DescribedText::told_position(const Channel& channel, const Heard& heard) const {
  std::string text;
  if (const auto one = heard.places.find("value"); one != heard.places.end()) {
    text = one->second;
  } else {
    constexpr std::string_view kBetween = ",; ";
    const std::string& all = heard.places.at("values");
    const auto mine = std::ranges::find_if(description_.channels, [&](const std::string& c) {
      return upper(c) == upper(channel.config.channel);
    });
    auto left = mine - description_.channels.begin();
    std::size_t at = all.find_first_not_of(kBetween);
    for (; left > 0 && at != all.npos; --left)
      at = all.find_first_not_of(kBetween, std::min(all.find_first_of(kBetween, at), all.size()));
    if (at != all.npos)
      text = all.substr(at, std::min(all.find_first_of(kBetween, at), all.size()) - at);
  }
  const auto number = plain_number(text);
  if (!number)
    throw ProtocolError(fmt::format("{}: its position in {} is not a number", where(channel),
                                    in_quotes(heard.line)));
  const double told = description_.position.value(*number, channel.config);
  const bool turns = channel.config.kind == StageKind::kRotary && description_.wraps > 0;
  return turns ? std::remainder(told, description_.wraps) : told;
}

/// The pulse that was told last as long as the axis is nearer to it than to be sure of another.
Steps DescribedText::on_pulse(State& s, const Channel& channel, double told) const {
  const double pulses = told / channel.config.per_step();
  if (!s.position || std::abs(pulses - static_cast<double>(s.position->count)) > kSamePlace)
    s.position = channel.steps(told);
  return *s.position;
}

Motion DescribedText::motion(State& s, const Channel& channel, double told, bool says_moving,
                             bool says_ended) {
  const Time now = clock().now();
  const double jitter = kSamePlace * std::max(channel.config.per_step(), channel.config.told_step);
  if (!s.rests_at || std::abs(told - *s.rests_at) > jitter) {
    s.moved = s.moved || s.rests_at.has_value();
    s.rests_at = told;
    s.since = now;
  }
  s.moved = s.moved || says_moving;
  if (says_moving) return Motion::kMoving;
  if (says_ended) return Motion::kEnded;
  if (description_.still_s > 0 && now - s.since >= from_seconds(description_.still_s))
    return Motion::kEnded;
  return Motion::kUnknown;
}

AxisStatus<Steps> DescribedText::status(const Channel& channel, Time deadline) {
  AxisStatus<Steps> result;
  std::optional<double> told;
  bool moving = false, ended = false, not_homed = false;
  for (const Exchange& question : description_.status) {
    const Heard heard = command(where(channel), question, axis_of(channel), deadline);
    if (heard.places.contains("value") || heard.places.contains("values"))
      told = told_position(channel, heard);
    for (const WordMeaning& word : heard.words) {
      moving = moving || word.kind == Kind::kMoving;
      ended = ended || word.kind == Kind::kEnded;
      not_homed = not_homed || word.kind == Kind::kNotHomed;
      const bool some = word.kind == Kind::kLimit;
      result.lower_limit = result.lower_limit || some || word.kind == Kind::kLowerLimit;
      result.upper_limit = result.upper_limit || some || word.kind == Kind::kUpperLimit;
      if (word.kind == Kind::kFault && result.fault.empty()) result.fault = word.text;
    }
  }
  const auto guard = lock();
  State& s = state(channel);
  s.not_homed = not_homed;
  if (told) {
    result.position = on_pulse(s, channel, *told);
    result.motion = motion(s, channel, *told, moving, ended);
  }
  if (not_homed && s.task == Task::kMove && result.fault.empty()) {
    result.fault =
        "the controller does not know any more where the axis is: it was reset or switched off";
    s.task = Task::kNone;  // told once: homing has to be possible again
  }
  return result;
}

void DescribedText::send_stop(const Channel& channel, bool immediate) {
  const Exchange& exchange =
      immediate && description_.stop_now ? description_.stop_now : description_.stop;
  // Whether the axis halts is seen by its position, so any kind of answer will do.
  for (int i = 1; i <= attempts(); ++i) {
    const bool refused = retried(Time::max(), [&] {
      try {
        return say(exchange, axis_of(channel), false).refused;
      } catch (const DeviceError&) {
        return true;
      }
    });
    if (!refused) return;
  }
}

void DescribedText::switch_output(const OutputConfig& output, bool on) {
  const Exchange exchange{TextTemplate(on ? output.on_text : output.off_text),
                          description_.accepted};
  command(fmt::format("output {} of {}", output.name, config().name), exchange, {});
}

// ---- set-up

/// For each channel where the line names one, else once.
template <class F>
void DescribedText::for_each_meant(const Exchange& exchange, F&& action) const {
  for (const Channel& channel : channels()) {
    action(channel);
    if (!exchange.send.has("axis")) return;
  }
}

std::string DescribedText::observe(std::vector<std::string>& differences) {
  std::string details =
      fmt::format("as described by {} ({})", description_.name, description_.title);
  if (description_.identify)
    for_each_meant(description_.identify, [&](const Channel& channel) {
      const Heard heard = command(where(channel), description_.identify, axis_of(channel));
      const auto text = heard.places.find("text");
      details += fmt::format("; {} says {}", channel.config.channel,
                             in_quotes(text == heard.places.end() ? heard.line : text->second));
    });
  for (const ControllerDescription::Setting& setting : description_.settings) {
    if (!setting.ask) {
      details += fmt::format("; {} cannot be read", setting.name);
      continue;
    }
    for_each_meant(setting.ask, [&](const Channel& channel) {
      const Heard heard = command(where(channel), setting.ask, axis_of(channel));
      const std::string wanted = setting.wanted(channel.config);
      const std::string& found = heard.places.at(setting.of.empty() ? "text" : "value");
      const auto wanted_number = plain_number(wanted), found_number = plain_number(found);
      const double least = std::pow(10.0, -setting.numbers.decimals);
      const bool same = wanted_number && found_number
                            ? std::abs(*wanted_number - *found_number) < 0.51 * least
                            : upper(wanted) == upper(found);
      if (!same) differences.push_back(difference(channel, setting.name, wanted, found));
    });
  }
  return details;
}

void DescribedText::write_setup() {
  for (const Exchange& step : description_.setup)
    for_each_meant(
        step, [&](const Channel& channel) { command(where(channel), step, axis_of(channel)); });
  for (const ControllerDescription::Setting& setting : description_.settings)
    if (setting.set)
      for_each_meant(setting.set, [&](const Channel& channel) {
        TextTemplate::Places places = axis_of(channel);
        places["value"] = setting.wanted(channel.config);
        command(where(channel), setting.set, places);
      });
}

}  // namespace

std::unique_ptr<Controller> open_described_text(ControllerSetup setup) {
  return std::make_unique<DescribedText>(std::move(setup));
}

std::string identify_described_text(SharedLine, Clock&) { return {}; }

}  // namespace turntable
