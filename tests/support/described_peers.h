// Controllers that drivers/described describes, written from other sources than the descriptions.
#pragma once

#include <fmt/format.h>

#include <cmath>
#include <string>
#include <string_view>
#include <vector>

#include "tests/support/text_peer.h"

namespace turntable {

/// A one-axis table of Ideal Aerosmith as the public scripts of a validation suite for Bosch gyroscopes
/// (send, wait for ">", "?" is an error, the echo may come before the value) and the public control panel
/// for a 1270VS ("\r\n>\r\n" after every command) know it. The description is from a third program; MOV,
/// VEL, ACL and STA with values are in that one alone and are taken from there.
class AerosmithPeer final : public TextPeer {
 public:
  AerosmithPeer(Line line, Manners manners) : TextPeer(std::move(line), std::move(manners)) {
    mute_reports = true;
    axes_['1'].to = 23.5;  // where somebody left it
  }
  double speed = 10, way_home = 3.25;
  bool echo_in_answer = false;   ///< "PPO 12.5"
  std::string deaf_to, mute_to;  ///< commands that begin so are not heard, or not answered

 protected:
  std::string take(const std::string& command, Time now) override {
    if (!deaf_to.empty() && command.starts_with(deaf_to)) return {};
    const std::string answer = carry_out(command, now);
    return !mute_to.empty() && command.starts_with(mute_to) ? std::string() : answer;
  }
  std::string carry_out(const std::string& command, Time now) {
    if (command.empty()) return ">";
    const std::string verb = command.substr(0, 3),
                      rest = command.size() > 3 ? command.substr(3) : "";
    const auto value = [&] { return std::stod(rest); };
    const bool number =
        !rest.empty() && rest.find_first_not_of("0123456789.-") == std::string::npos;
    if (command == "PPO") {
      const double turn = std::fmod(axes_['1'].at(now) + 720.0, 360.0);
      return fmt::format("{}{:.4f}\r>", echo_in_answer ? "PPO " : "", turn);
    }
    if (command == "STA") return "0\r>";
    if (command == "STO") {
      Moving& axis = axes_['1'];
      axis.to = axis.at(now);
      axis.arrives = now;
      homing_ = false;
      return ">";
    }
    if (command == "HOM") {
      homing_ = true;
      go('1', axes_['1'].at(now) - way_home, 5, now);
      return ">";
    }
    if (verb == "MOV" && number) {
      go('1', value(), speed, now);
      return ">";
    }
    if (verb == "VEL" && number) {
      speed = value();
      return ">";
    }
    if (verb == "ACL" && number) return ">";
    return "?\r>";
  }
  std::string arrived(char, Time) override {
    if (homing_) axes_['1'] = {};
    homing_ = false;
    return {};
  }
  bool stops(const std::string& command) const override { return command == "STO"; }

 private:
  bool homing_ = false;
};

/// An Acutrol as its public clients know it: IEAv-EFO/acutrol3000 in Python and williamsea/Acutrol in C#
/// (IEEE-488: nothing answers a command), AcutronicRobotics/acutrol in Python (TCP: eight letters before
/// every answer, "OK" for a command). The description is from the maker's manual. Demands are loaded and
/// take effect in position mode; with the interlock open nothing does.
class AcutrolPeer final : public TextPeer {
 public:
  AcutrolPeer(Line line, Manners manners) : TextPeer(std::move(line), std::move(manners)) {
    mute_reports = true;
    command_end_ = '\n';
    for (const char axis : {'1', '2'}) axes_[axis].to = 350.0;  // of a turn
  }
  bool tcp = false;
  bool fault = false;  ///< of the interlock
  std::map<char, double> rate{{'1', 50.0}, {'2', 50.0}}, acceleration{{'1', 100.0}, {'2', 100.0}};
  std::map<char, bool> closed;

 protected:
  std::string take(const std::string& line, Time now) override {
    std::string answers;
    for (std::size_t at = 0; at < line.size();) {
      const std::size_t end = std::min(line.find(';', at), line.size());
      const std::string answer = one(line.substr(at, end - at), now);
      if (!answer.empty()) answers += (answers.empty() ? "" : ";") + answer;
      at = end + 1;
    }
    if (answers.empty() && tcp) answers = "OK";
    return answers.empty() ? "" : (tcp ? "00000001" : "") + answers;
  }
  std::string arrived(char, Time) override { return {}; }
  bool stops(const std::string&) const override { return false; }

 private:
  static bool means(std::string_view word, std::string_view whole) {
    return !word.empty() && whole.starts_with(word);
  }
  std::string one(std::string text, Time now) {
    for (char& c : text) c = static_cast<char>(c >= 'A' && c <= 'Z' ? c - 'A' + 'a' : c);
    if (text == "*idn?") return "Acutronic R&D USA,Acutrol3000,0,A8800";
    std::vector<std::string> words;  // ":read:position? 1" -> read, position?, 1
    for (const char c : text) {
      if (c == ':' || c == ' ' || c == ',')
        words.emplace_back();
      else if (!words.empty())
        words.back() += c;
    }
    std::erase(words, "");
    if (words.size() < 2) return {};
    const bool asks = text.find('?') != std::string::npos;
    for (std::string& word : words) std::erase(word, '?');
    const char axis =
        words[means(words[0], "limit") ? std::min<std::size_t>(3, words.size() - 1)
                                       : std::min<std::size_t>(2, words.size() - 1)][0];
    if (means(words[0], "interlock")) {
      if (asks) return fault ? "Fault" : closed[axis] ? "Closed" : "Open";
      closed[axis] = means(words[1], "close");
    } else if (means(words[0], "read") && means(words[1], "position")) {
      const double turn = std::fmod(axes_[axis].at(now) + 720.0, 360.0);
      return fmt::format("{:.5f}", turn);
    } else if (means(words[0], "demand") && means(words[1], "position") && words.size() > 3) {
      demand_[axis] = std::stod(words[3]);
      act_on_demand(axis, now);
    } else if (means(words[0], "mode")) {
      in_position_mode_[axis] = means(words[1], "position");
      if (in_position_mode_[axis]) {
        act_on_demand(axis, now);
      } else {
        Moving& moving = axes_[axis];
        moving.to = moving.at(now);
        moving.arrives = now;
      }
    } else if (means(words[0], "limit") && words.size() > 3) {
      auto& limits = means(words[1], "rate") ? rate : acceleration;
      if (asks) return fmt::format("{:.4f}", limits[axis]);
      limits[axis] = std::stod(words[4]);
    }
    return {};
  }
  void act_on_demand(char axis, Time now) {
    if (!in_position_mode_[axis] || !closed[axis] || fault) return;
    const double here = axes_[axis].at(now);
    go(axis, here + std::remainder(demand_[axis] - here, 360.0), rate[axis],
       now);  // the shortest way
  }

  std::map<char, double> demand_;
  std::map<char, bool> in_position_mode_;
};

}  // namespace turntable
