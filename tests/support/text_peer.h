// Controllers of text lines written from what other people's programs say to real ones and hear from
// them, and not from our simulators: with the manners that a line or a firmware may have. Own
// arithmetic, own motion (constant speed, no ramps), so that a mistake that driver and simulator
// share is not shared a third time.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "protocols/line.h"
#include "src/core/clock.h"

namespace turntable {

struct Manners {
  const char* name = "";
  bool echo = false;            ///< of each command, by the adapter or by the device
  const char* line_end = "\r";  ///< of what it says
  bool lower_case = false, blanks = false;
  std::string banner{};  ///< said when somebody connects
  Time reply{std::chrono::milliseconds{60}};
  Time second_half{};                ///< an answer comes in two parts, so far apart
  int busy_every = 0;                ///< each so manieth question is not heard at all
  bool silent_while_moving = false;  ///< and forgets what it is asked then
  std::string busy{};                ///< or says so, but to a stop
};

class TextPeer : public Actor {
 public:
  TextPeer(Line line, Manners manners) : line_(std::move(line)), manners_(std::move(manners)) {
    if (!manners_.banner.empty()) say(Time{0}, Time{0}, manners_.banner);
  }
  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override {
    std::optional<Time> next;
    for (const Saying& saying : due_)
      if (!next || saying.at < *next) next = saying.at;
    for (const auto& [letter, axis] : axes_)
      if (axis.report_due && (!next || axis.arrives < *next)) next = axis.arrives;
    return next;
  }
  void act(Time now) override {
    std::array<char, 256> buffer;
    input_.append(buffer.data(), line_.read_available(buffer, now));
    for (std::size_t end; (end = input_.find(command_end_)) != std::string::npos;
         input_.erase(0, end + 1)) {
      const std::string command = input_.substr(0, end);
      heard.push_back(command);
      if (manners_.echo) line_.write_available(command + manners_.line_end, now);
      if (manners_.busy_every > 0 && command.find('?') != std::string::npos &&
          ++questions_ % manners_.busy_every == 0)
        continue;
      if (manners_.silent_while_moving && moving(now) && !stops(command)) continue;
      if (!manners_.busy.empty() && moving(now) && !stops(command)) {
        say(now, manners_.reply, manners_.busy);
        continue;
      }
      if (const std::string answer = take(command, now); !answer.empty())
        say(now, manners_.reply, answer);
    }
    for (auto& [letter, axis] : axes_)
      if (axis.report_due && now >= axis.arrives) {
        axis.report_due = false;
        const std::string report = arrived(letter, now);
        if (!mute_reports) say(now, Time{0}, report);
      }
    std::ranges::stable_sort(due_, {}, &Saying::at);
    while (!due_.empty() && due_.front().at <= now) {
      line_.write_available(due_.front().bytes, now);
      due_.erase(due_.begin());
    }
  }
  bool moving(Time now) const {
    return std::ranges::any_of(axes_, [&](const auto& a) { return now < a.second.arrives; });
  }
  double place(char letter, Time now) { return axes_[letter].at(now); }
  std::ptrdiff_t said(const std::string& command) const {
    return std::ranges::count(heard, command);
  }

  std::vector<std::string> heard;
  bool mute_reports = false;  ///< it does not say by itself that an axis has come to rest

 protected:
  /// @return what is said to it, without the line's end; several lines with '\r' between.
  virtual std::string take(const std::string& command, Time now) = 0;
  /// What it says by itself when an axis has come to rest.
  virtual std::string arrived(char letter, Time now) = 0;
  virtual bool stops(const std::string& command) const = 0;

  struct Moving {
    double from = 0, to = 0, per_second = 1;
    Time began{0}, arrives{0};
    bool report_due = false;
    double at(Time t) const {
      const double gone = per_second * seconds(t - began);
      if (t >= arrives || gone >= std::abs(to - from)) return to;
      return from + (to < from ? -gone : gone);
    }
  };
  void go(char letter, double to, double per_second, Time now) {
    Moving& axis = axes_[letter];
    axis.from = axis.at(now);
    axis.to = to;
    axis.per_second = per_second;
    axis.began = now;
    axis.arrives = now + from_seconds(std::abs(to - axis.from) / per_second);
    axis.report_due = true;
  }
  void halt(char letter, Time now) {
    Moving& axis = axes_[letter];
    axis.to = std::round(axis.at(now));
    axis.arrives = now;
  }
  std::map<char, Moving> axes_;
  char command_end_ = '\r';

 private:
  struct Saying {
    Time at;
    std::string bytes;
  };
  void say(Time now, Time after, const std::string& text) {
    std::string line;
    for (const char c : text + "\r") {
      if (c == '\r')
        line += std::string(manners_.blanks ? "  " : "") + manners_.line_end;
      else if (manners_.lower_case)
        line += static_cast<char>(c >= 'A' && c <= 'Z' ? c - 'A' + 'a' : c);
      else
        line += c;
      if (manners_.blanks && c == ',') line += ' ';
    }
    const std::size_t half = manners_.second_half > Time{} ? line.size() / 2 : line.size();
    // A line that has begun is said to its end; else a report may come before an answer that is due.
    const bool in_parts = manners_.second_half > Time{};
    const Time at = in_parts ? std::max(now + after, free_at_) : now + after;
    free_at_ = half < line.size() ? at + manners_.second_half : at;
    due_.push_back({at, line.substr(0, half)});
    if (half < line.size()) due_.push_back({free_at_, line.substr(half)});
  }

  Line line_;
  Manners manners_;
  std::string input_;
  std::vector<Saying> due_;
  int questions_ = 0;
  Time free_at_{0};
};

inline void PrintTo(const Manners& manners, std::ostream* out) { *out << manners.name; }

/// An SC300 as geyuuu/pySC300, smartlink and DF4IAH/RF-Lab know it. Pulses.
class Sc300Peer final : public TextPeer {
 public:
  using TextPeer::TextPeer;
  std::string type = "SC300-1B", version = "SC300_V1.0";
  std::map<std::string, std::string> registers{};  ///< "VX" -> "20000"
  double way_home = 700;                           ///< pulses

 protected:
  std::string take(const std::string& c, Time now) override {
    if (c.empty()) return "OK";
    if (c == "VE") return version;
    if (c == "TY") return type;
    if (c == "ID") return "ID0000";
    const std::size_t comma = c.find(',');
    const std::string head = c.substr(0, comma);
    const std::string value = comma == std::string::npos ? "" : c.substr(comma + 1);
    if (head.size() == 3 && head.starts_with("SP")) {
      halt(head[2], now);
      return "OK";
    }
    if (head.size() != 2) return "ER";
    const auto counter = [&](char letter) {
      return fmt::format("?{},{}", letter, std::lround(axes_[letter].at(now)));
    };
    const bool axis_last = std::string_view("XYZ").find(head[1]) != std::string_view::npos;
    if (head[0] == '?' && axis_last) return counter(head[1]);
    if ((head[0] == '+' || head[0] == '-') && axis_last && !value.empty()) {
      const double way = std::stod(value) * (head[0] == '-' ? -1 : 1);
      go(head[1], axes_[head[1]].at(now) + way, speed(head[1]), now);
      return "";
    }
    if (head[0] == 'H' && axis_last) {
      homing_ = head[1];
      go(head[1], axes_[head[1]].at(now) - way_home, speed(head[1]), now);
      return "";
    }
    if (axis_last && !value.empty()) {  // "VX,20000"
      registers[head] = value;
      return "OK";
    }
    const std::string reversed{head[1], head[0]};  // "XV" asks for VX
    if (const auto found = registers.find(reversed); found != registers.end())
      return head + "," + found->second;
    return "ER";
  }
  std::string arrived(char letter, Time) override {
    if (homing_ == letter) {
      homing_ = 0;
      axes_[letter] = {};
    }
    return fmt::format("?{},{}", letter, std::lround(axes_[letter].to));
  }
  bool stops(const std::string& command) const override { return command.starts_with("SP"); }

 private:
  double speed(char letter) { return std::stod(registers[std::string("V") + letter]); }
  char homing_ = 0;
};

/// An MC600 as KYKY's CommMC600 and aooppp/fiber-fp know it. The unit it was told.
class Mc600Peer final : public TextPeer {
 public:
  using TextPeer::TextPeer;
  std::map<std::string, std::string> settings{};  ///< "SETSPEED X" -> "25"
  int decimals = 5;
  Time keeping{};  ///< for how long it refuses everything after it was told a setting
  std::map<std::string, std::string> replies{};  ///< to particular commands, whatever they are

 protected:
  std::string take(const std::string& command, Time now) override {
    if (const auto found = replies.find(command); found != replies.end()) return found->second;
    std::string c = command;
    for (char& x : c) x = static_cast<char>(x >= 'a' && x <= 'z' ? x - 'a' + 'A' : x);
    if (c.empty()) return "";
    if (now < kept_) return "E02";
    if (c == "HELLO") return "OK";
    const std::size_t space = c.find(' ');
    if (space == std::string::npos || space + 1 >= c.size()) return "E01";
    const std::string verb = c.substr(0, space);
    const char letter = c[space + 1];
    const std::string rest = c.size() > space + 3 ? c.substr(space + 3) : "";
    if (verb == "POSITION?")
      return fmt::format("POSITION? {},{:.{}f},OK", letter, axes_[letter].at(now), decimals);
    if (verb == "STOP") {
      Moving& axis = axes_[letter];
      axis.to = axis.at(now);
      axis.arrives = now;
      return "OK";
    }
    if (verb == "GOHOME") {
      homing_ = letter;
      go(letter, axes_[letter].at(now) - 2, 5, now);
      return "READY";
    }
    if (verb == "GOPOSITION") {  // "O,A,P,12.5"
      if (rest.size() < 7) return "E01";
      const double value = std::stod(rest.substr(6)) * (rest[4] == 'N' ? -1 : 1);
      go(letter, rest[2] == 'R' ? axes_[letter].at(now) + value : value,
         std::stod(settings[std::string("SETSPEED ") + letter]), now);
      return "READY";
    }
    if (verb.ends_with('?')) {
      const std::string key = verb.substr(0, verb.size() - 1) + " " + letter;
      const auto found = settings.find(key);
      return found == settings.end() ? "E01"
                                     : fmt::format("{} {},{},OK", verb, letter, found->second);
    }
    if (!rest.empty() && verb.starts_with("SET")) {
      settings[verb + " " + letter] = rest;
      kept_ = now + keeping;
      return "OK";
    }
    return "E01";
  }
  std::string arrived(char letter, Time now) override {
    if (homing_ == letter) {
      homing_ = 0;
      axes_[letter] = {};
    }
    return fmt::format("{} {:.{}f},OK", letter, axes_[letter].at(now), decimals);
  }
  bool stops(const std::string& command) const override {
    return command.starts_with("Stop") || command.starts_with("STOP");
  }

 private:
  char homing_ = 0;
  Time kept_{0};
};

}  // namespace turntable
