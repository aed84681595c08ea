#include "drivers/controller_description.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>

#include "controller_descriptions.h"
#include "protocols/ascii_dialog.h"
#include "src/core/errors.h"
#include "src/core/json_document.h"

namespace turntable {
namespace {

using Kind = WordMeaning::Kind;

struct NamedMeaning {
  std::string_view name;
  Kind kind;
  bool with_text;  ///< "fault: the drive is off"
};
constexpr NamedMeaning kMeanings[] = {
    {"nothing", Kind::kNothing, false},
    {"moving", Kind::kMoving, false},
    {"ended", Kind::kEnded, false},
    {"lower_limit", Kind::kLowerLimit, false},
    {"upper_limit", Kind::kUpperLimit, false},
    {"limit", Kind::kLimit, false},
    {"not_homed", Kind::kNotHomed, false},
    {"fault", Kind::kFault, true},
    {"refused", Kind::kRefused, true},
    {"busy", Kind::kBusy, false},
};

struct Quantity {
  std::string_view name;
  double AxisConfig::*value;
};
constexpr Quantity kQuantities[] = {
    {"speed", &AxisConfig::speed},
    {"acceleration", &AxisConfig::acceleration},
    {"initial_speed", &AxisConfig::initial_speed},
    {"home_speed", &AxisConfig::home_speed},
    {"upper", &AxisConfig::upper},
    {"lower", &AxisConfig::lower},
};

constexpr std::array<std::string_view, 6> kBuiltIn{"axis", "value", "values", "id", "any", "text"};

std::string without_end_blanks(std::string_view text) {
  const std::size_t begin = std::min(text.find_first_not_of(' '), text.size());
  text.remove_prefix(begin);
  while (text.ends_with(' ')) text.remove_suffix(1);
  return std::string(text);
}

class DescriptionReader {
 public:
  DescriptionReader(const Json& json, const std::string& name) : json_(json), file_(name) {}

  ControllerDescription read() {
    ControllerDescription d;
    d.name = file_;
    d.title = json_.at("title");
    d.untried = json_.value("untried", true);
    for (const Json& source : json_.at("sources")) d.sources.push_back(source);
    for (const Json& note : json_.value("notes", Json::array())) d.notes.push_back(note);
    d.channels = json_.value("channels", std::vector<std::string>{});
    read_line(d);
    read_words(d);
    read_position(d);
    if (json_.contains("accepted"))
      d.accepted = accepted_ = templates("/accepted", json_.at("accepted"), kReply);
    if (json_.contains("refused")) d.refused = templates("/refused", json_.at("refused"), kReply);
    if (json_.contains("unasked")) d.unasked = templates("/unasked", json_.at("unasked"), kReply);
    read_commands(d);
    return d;
  }

 private:
  enum Part { kSend, kSendValue, kReply, kReplyValue, kReplyText, kReplyStatus };

  [[noreturn]] void fail(const std::string& pointer, const std::string& message) const {
    throw ConfigError(file_, pointer, message);
  }

  void read_line(ControllerDescription& d) const {
    const Json line = json_.value("line", Json::object());
    d.baud = line.value("baud", 9600);
    d.reply_timeout_s = line.value("reply_timeout_ms", 1000.0) / 1000.0;
    const auto end = [](const std::string& text) {
      return text == "CR" ? "\r" : text == "LF" ? "\n" : text == "CRLF" ? "\r\n" : text;
    };
    d.command_end = end(line.value("command_end", "CR"));
    d.answer_end = end(line.value("answer_end", "CR"));
    d.answer_skips = line.value("answer_skips", 0u);
    d.echo = line.value("echo", false);
    d.lrc = line.value("checksum", "none") == "zaber_lrc";
  }

  void read_words(ControllerDescription& d) {
    const Json lists = json_.value("words", Json::object());
    for (const auto& [place, list] : lists.items()) {
      const std::string at = "/words/" + place;
      if (std::ranges::find(kBuiltIn, place) != kBuiltIn.end())
        fail(at, fmt::format("has the name of a place that means something else already ({}). "
                             "Choose another name, here and in the templates.",
                             fmt::join(kBuiltIn, ", ")));
      for (const auto& [word, meaning] : list.items())
        d.words[place][upper(word)] = meaning_of(at + "/" + word, meaning);
      word_places_.push_back(place);
    }
  }

  WordMeaning meaning_of(const std::string& at, const std::string& text) const {
    const std::size_t colon = text.find(':');
    const std::string name = without_end_blanks(text.substr(0, colon));
    const std::string said =
        colon == text.npos ? std::string() : without_end_blanks(text.substr(colon + 1));
    const auto* row = std::ranges::find(kMeanings, name, &NamedMeaning::name);
    if (row == std::end(kMeanings) || row->with_text == said.empty()) {
      std::string allowed;
      for (const NamedMeaning& m : kMeanings)
        allowed += fmt::format("{}\"{}{}\"", allowed.empty() ? "" : ", ", m.name,
                               m.with_text ? ": <what to tell a person>" : "");
      fail(at, fmt::format("found \"{}\", allowed: {}. Say what the word means.", text, allowed));
    }
    return {row->kind, said};
  }

  ControllerDescription::Numbers numbers(const Json& n) const {
    return {n.at("unit") == "pulses", n.value("factor", 1.0), n.value("decimals", 0)};
  }

  void read_position(ControllerDescription& d) const {
    const Json& p = json_.at("position");
    d.position = numbers(p);
    d.wraps = p.value("wraps_at", 0.0);
    d.absolute = p.value("reference", "home") == "absolute";
    d.still_s = json_.value("still_ms", 0.0) / 1000.0;
  }

  TextTemplate parsed(const std::string& at, const std::string& text, Part part) const {
    TextTemplate result;
    try {
      result = TextTemplate(text);
    } catch (const std::invalid_argument& e) {
      fail(at, fmt::format("found \"{}\": {}.", text, e.what()));
    }
    std::vector<std::string> allowed{"axis", "id"};
    if (part == kSendValue || part == kReplyValue || part == kReplyStatus)
      allowed.emplace_back("value");
    if (part == kReplyStatus) allowed.emplace_back("values");
    if (part == kReplyText) allowed.emplace_back("text");
    if (part != kSend && part != kSendValue) {
      allowed.emplace_back("any");
      allowed.insert(allowed.end(), word_places_.begin(), word_places_.end());
    }
    int many = 0;
    for (const std::string& place : result.places()) {
      if (std::ranges::find(allowed, place) == allowed.end())
        fail(at,
             fmt::format("found \"{}\" with the place {{{}}}, allowed here: {{{}}}. Correct it, "
                         "or list its words under /words/{}.",
                         text, place, fmt::join(allowed, "}, {"), place));
      const bool open_ended = place == "any" || place == "text" || place == "values";
      if (open_ended && ++many > 2)
        fail(at, fmt::format(
                     "found \"{}\" with {{any}}, {{text}} or {{values}} three times, allowed: two "
                     "of them.",
                     text));
    }
    if (result.empty()) fail(at, "is empty. State the text, or leave the key out.");
    return result;
  }

  std::vector<TextTemplate> templates(const std::string& at, const Json& texts, Part part) const {
    std::vector<TextTemplate> all;
    if (texts.is_string()) {
      all.push_back(parsed(at, texts, part));
    } else {
      for (std::size_t i = 0; i < texts.size(); ++i)
        all.push_back(parsed(fmt::format("{}/{}", at, i), texts.at(i), part));
    }
    return all;
  }

  ControllerDescription::Exchange exchange(const std::string& at, const Json& e, Part send,
                                           Part reply) const {
    ControllerDescription::Exchange result;
    result.send = parsed(at + "/send", e.at("send"), send);
    if (!e.contains("reply")) {
      if (accepted_.empty())
        fail(at,
             "has no \"reply\", and the file has no \"accepted\" that would stand for it. Say what "
             "the controller answers; if it answers nothing, \"reply\": [].");
      result.replies = accepted_;
    } else {
      result.replies = templates(at + "/reply", e.at("reply"), reply);
    }
    return result;
  }

  void require_place(const std::string& at, const TextTemplate& text, std::string_view place,
                     const std::string& why) const {
    if (!text.has(place))
      fail(at, fmt::format("found \"{}\", allowed: with the place {{{}}}: {}", text.text(), place,
                           why));
  }

  /// More than one channel, as far as the file says.
  bool several(const ControllerDescription& d) const { return d.channels.size() != 1; }

  void read_commands(ControllerDescription& d) {
    const Json& c = json_.at("commands");
    const std::string at = "/commands";
    const auto one = [&](const std::string& name, Part send, Part reply) {
      return c.contains(name) ? exchange(at + "/" + name, c.at(name), send, reply)
                              : ControllerDescription::Exchange{};
    };
    d.identify = one("identify", kSend, kReplyText);
    d.move = one("move", kSendValue, kReply);
    d.home = one("home", kSend, kReply);
    d.stop = one("stop", kSend, kReply);
    d.stop_now = one("stop_now", kSend, kReply);
    require_place(at + "/move/send", d.move.send, "value", "that is where the goal goes.");
    const std::string which =
        "without it the controller could not tell which axis is meant. If it has one axis only, "
        "say so: "
        "\"channels\": [\"1\"].";
    if (several(d)) {
      require_place(at + "/move/send", d.move.send, "axis", which);
      if (d.home) require_place(at + "/home/send", d.home.send, "axis", which);
    }
    if (d.identify && d.identify.replies.empty())
      fail(at + "/identify/reply", "is empty. A question has an answer.");
    if (d.home && d.absolute)
      fail(at + "/home",
           "found with /position/reference \"absolute\", where going to 0 stands for "
           "homing. Remove one of them.");
    if (!d.home && !d.absolute)
      fail(at,
           "has no \"home\". Add it; or, if the controller knows its positions after it was "
           "switched on, say so: /position/reference \"absolute\".");

    const Json& status = c.at("status");
    bool tells = false;
    for (std::size_t i = 0; i < status.size(); ++i) {
      const std::string here = fmt::format("{}/status/{}", at, i);
      d.status.push_back(exchange(here, status.at(i), kSend, kReplyStatus));
      const ControllerDescription::Exchange& e = d.status.back();
      if (e.replies.empty()) fail(here + "/reply", "is empty. A question has an answer.");
      for (std::size_t k = 0; k < e.replies.size(); ++k) {
        tells = tells || e.replies[k].has("value") || e.replies[k].has("values");
        if (e.replies[k].has("values") && d.channels.empty())
          fail(here + "/reply",
               "has {values}, and the file does not say whose they are. List the "
               "\"channels\" in the order in which the controller tells them.");
        if (several(d) && e.replies[k].has("value") && !e.send.has("axis"))
          require_place(here + "/send", e.send, "axis", which);
      }
    }
    if (!tells)
      fail(at + "/status",
           "has no reply with {value} or {values}: nothing tells the position. Add the "
           "question for it.");
    if (d.still_s == 0 && !d.has_meaning(Kind::kEnded))
      fail("/still_ms",
           "is missing, and no word means \"ended\": nothing tells that a motion has ended. "
           "Add the words, or say how long an axis has to stand still for it.");

    for (std::size_t i = 0; c.contains("setup") && i < c.at("setup").size(); ++i)
      d.setup.push_back(
          exchange(fmt::format("{}/setup/{}", at, i), c.at("setup").at(i), kSend, kReply));
    for (std::size_t i = 0; c.contains("settings") && i < c.at("settings").size(); ++i)
      d.settings.push_back(setting(fmt::format("{}/settings/{}", at, i), c.at("settings").at(i)));
  }

  ControllerDescription::Setting setting(const std::string& at, const Json& s) const {
    ControllerDescription::Setting result;
    result.name = s.at("name");
    result.of = s.value("of", "");
    result.text = s.value("text", "");
    const bool number = !result.of.empty();
    if (number == !result.text.empty())
      fail(at,
           "found both or neither of \"of\" and \"text\", allowed: \"of\" with a quantity of the "
           "axis, "
           "or \"text\" with what the setting has to be.");
    if (number) {
      if (!s.contains("unit"))
        fail(at, "has no \"unit\". State \"axis\" (mm and deg) or \"pulses\".");
      result.numbers = numbers(s);
    }
    if (!s.contains("ask") && !s.contains("set"))
      fail(at, "has neither \"ask\" nor \"set\", allowed: one of them or both.");
    if (s.contains("ask")) {
      result.ask = exchange(at + "/ask", s.at("ask"), kSend, number ? kReplyValue : kReplyText);
      for (const TextTemplate& reply : result.ask.replies)
        require_place(at + "/ask/reply", reply, number ? "value" : "text",
                      "that is where the setting stands.");
      if (result.ask.replies.empty())
        fail(at + "/ask/reply", "is empty. A question has an answer.");
    }
    if (s.contains("set")) {
      result.set = exchange(at + "/set", s.at("set"), number ? kSendValue : kSend, kReply);
      if (number)
        require_place(at + "/set/send", result.set.send, "value",
                      "that is where the setting goes.");
    }
    return result;
  }

  const Json& json_;
  std::string file_;
  std::vector<std::string> word_places_;
  std::vector<TextTemplate> accepted_;
};

}  // namespace

std::string ControllerDescription::Numbers::shown(double value, const AxisConfig& axis) const {
  std::string text =
      fmt::format("{:.{}f}", factor * (pulses ? value / axis.per_step() : value), decimals);
  if (text.starts_with('-') && text.find_first_not_of("-0.") == text.npos) text.erase(0, 1);
  return text;
}

double ControllerDescription::Numbers::value(double number, const AxisConfig& axis) const {
  return number / factor * (pulses ? axis.per_step() : 1.0);
}

double ControllerDescription::Numbers::step(const AxisConfig& axis) const {
  const double least = value(std::pow(10.0, -decimals), axis);
  return pulses && least <= axis.per_step() * (1 + 1e-9) ? 0.0 : least;
}

std::string ControllerDescription::Setting::wanted(const AxisConfig& axis) const {
  if (of.empty()) return text;
  const auto* quantity = std::ranges::find(kQuantities, of, &Quantity::name);
  return numbers.shown(axis.*(quantity->value), axis);
}

bool ControllerDescription::has_meaning(Kind kind) const {
  return std::ranges::any_of(words, [&](const auto& list) {
    return std::ranges::any_of(list.second, [&](const auto& w) { return w.second.kind == kind; });
  });
}

std::vector<std::string> ControllerDescription::unconfirmed() const {
  std::vector<std::string> sentences;
  if (untried)
    sentences.push_back(
        fmt::format("All of it: the description \"{}\" ({}) was written from {} and was never "
                    "tried on a real one.",
                    name, title, fmt::join(sources, "; ")));
  sentences.insert(sentences.end(), notes.begin(), notes.end());
  return sentences;
}

ControllerDescription parse_description(const std::string& text, const std::string& name) {
  const Json json = parse_json(text, name, "controller-description");
  return DescriptionReader(json, name).read();
}

std::vector<std::string> shipped_descriptions() {
  std::vector<std::string> names;
  for (const auto& [stem, text] : embedded::controller_descriptions()) names.emplace_back(stem);
  return names;
}

ControllerDescription load_description(const ControllerConfig& controller) {
  const std::string& wanted = controller.description;
  if (wanted.ends_with(".json"))
    return parse_description(
        controller.description_text.empty() ? read_text(wanted) : controller.description_text,
        wanted);
  for (const auto& [stem, text] : embedded::controller_descriptions())
    if (stem == wanted) return parse_description(std::string(text), wanted);
  throw ConfigError(
      "rig", fmt::format("/controllers/{}/description", controller.name),
      fmt::format(
          "{}, allowed: {}, or a file of yours that ends in .json, relative to the rig file "
          "(drivers/README.md says how to write one).",
          wanted.empty() ? "is missing" : fmt::format("found \"{}\"", wanted),
          fmt::join(shipped_descriptions(), ", ")));
}

void check_axis(const ControllerDescription& description, const AxisConfig& axis) {
  const auto same = [&](const std::string& c) { return upper(c) == upper(axis.channel); };
  if (!description.channels.empty() && std::ranges::none_of(description.channels, same))
    throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(axis.id)),
                      fmt::format("found \"{}\", allowed on {}: {}.", axis.channel,
                                  description.name, fmt::join(description.channels, ", ")));
  const double half = description.wraps / 2;
  if (description.wraps > 0 && axis.kind == StageKind::kRotary &&
      (axis.lower <= -half || axis.upper >= half))
    throw ConfigError(
        "rig", fmt::format("/axes/{}/limits_{}", axis_name(axis.id), axis.unit()),
        fmt::format(
            "found [{:g}, {:g}], allowed with {}: within ({:g}, {:g}) {}. Its positions begin "
            "again there.",
            axis.lower, axis.upper, description.name, -half, half, axis.unit()));
}

}  // namespace turntable
