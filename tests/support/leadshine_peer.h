// A Leadshine drive in PR mode written from the manuals' pages and from other people's programs, and
// not from our simulator: own register table, own checksum, own motion (constant speed). It decelerates
// past its origin, may home by itself when it is switched on, may meet a limit switch, and answers a
// spoilt frame with exception 08, as its manual says.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "protocols/line.h"
#include "src/core/clock.h"

namespace turntable {

struct DriveManners {
  const char* name = "";
  Time reply{std::chrono::milliseconds{7}};  ///< as the manual's table says for 38400 baud
  bool echo = false;                         ///< of the adapter
  Time second_half{};                        ///< an answer comes in two parts, so far apart
  bool home_done_at_switch = false;          ///< it says so before it goes on to the stop position
  Time pause_at_switch{};                    ///< and stands there for so long
  std::string noise{};                       ///< before each answer
  int spoilt_every = 0;  ///< each so manieth request arrives spoilt, but for triggers
};

class LeadshinePeer final : public Actor {
 public:
  LeadshinePeer(Line line, int slave, DriveManners manners)
      : line_(std::move(line)), slave_(slave), manners_(std::move(manners)) {
    for (int a = 0x0000; a <= 0x000F; ++a) words[a] = 0;
    for (int a = 0x0144; a <= 0x0152; ++a) words[a] = 0;
    words[0x0157] = 0;
    for (int a = 0x6000; a <= 0x6019; ++a) words[a] = 0;
    for (int a = 0x6200; a <= 0x627F; ++a) words[a] = 0;
    words[0x0001] = 10000;
    words[0x0145] = 0x88;
    words[0x0147] = 0x25;
    words[0x0149] = 0x26;
    words[0x014B] = 0xA7;
    words[0x2203] = 0;
    words[0x6006] = words[0x6008] = 0;
    words[0x600A] = 0x0004;
    words[0x600F] = 200;
    words[0x6010] = 50;
    words[0x6011] = words[0x6012] = words[0x6016] = words[0x6017] = 100;
  }

  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override {
    std::optional<Time> next;
    if (!due_.empty()) next = due_.front().first;
    if (!legs_.empty() && (!next || legs_.front().end < *next)) next = legs_.front().end;
    return next;
  }
  void act(Time now) override {
    std::array<char, 256> buffer;
    input_.append(buffer.data(), line_.read_available(buffer, now));
    advance(now);
    while (take_frame(now)) {
    }
    while (!due_.empty() && due_.front().first <= now) {
      line_.write_available(due_.front().second, now);
      due_.erase(due_.begin());
    }
  }

  /// It is switched off and on: everything that was not saved is gone, and so is the reference.
  void switch_on(Time now) {
    words = saved;
    legs_.clear();
    position_ = 5000;  // wherever it stands counts as something
    home_done_ = false;
    if ((words[0x6000] & 4) != 0) home(now);
  }
  double position(Time now) { return advance(now), here(now); }
  bool running(Time now) { return advance(now), !legs_.empty() && legs_.front().moves; }

  std::map<int, int> words, saved{};
  std::optional<double> upper_switch{};        ///< pulses; where a path ends by itself
  std::vector<int> triggers{};                 ///< written to 0x6002
  std::vector<std::pair<int, int>> written{};  ///< to all others: address, value
  int requests = 0;
  bool spoils_triggers = false;

 private:
  struct Leg {
    Time begin, end;
    double from, to;
    bool moves = true;
  };

  static unsigned crc(std::string_view bytes) {
    unsigned crc = 0xFFFF;
    for (const char c : bytes) {
      crc ^= static_cast<unsigned char>(c);
      for (int bit = 0; bit < 8; ++bit) crc = (crc & 1u) != 0 ? (crc >> 1u) ^ 0xA001u : crc >> 1u;
    }
    return crc;
  }
  static void put(std::string& bytes, int word) {
    bytes += static_cast<char>(static_cast<unsigned>(word) >> 8u & 0xFFu);
    bytes += static_cast<char>(static_cast<unsigned>(word) & 0xFFu);
  }
  int at(std::size_t i) const { return static_cast<unsigned char>(input_[i]); }
  int word_at(std::size_t i) const { return at(i) * 256 + at(i + 1); }

  bool take_frame(Time now) {
    if (input_.size() < 8) return false;
    const int function = at(1);
    const std::size_t length = function == 16 ? 9 + static_cast<std::size_t>(at(6)) : 8;
    if (input_.size() < length) return false;
    const std::string frame = input_.substr(0, length);
    const int to = at(0), address = word_at(2), count = word_at(4);
    std::vector<int> values;
    if (function == 6) values = {count};
    for (int i = 0; function == 16 && i < count; ++i)
      values.push_back(word_at(7 + 2 * static_cast<std::size_t>(i)));
    input_.erase(0, length);
    if (manners_.echo) line_.write_available(frame, now);
    if (to != slave_) return true;
    ++requests;
    std::string reply{static_cast<char>(to)};
    const auto exception = [&](int code) {
      reply += static_cast<char>(function | 0x80);
      reply += static_cast<char>(code);
    };
    const bool is_trigger = function == 6 && address == 0x6002;
    const bool spoilt = is_trigger
                            ? spoils_triggers
                            : manners_.spoilt_every > 0 && requests % manners_.spoilt_every == 0;
    if (crc(frame) != 0 || spoilt) {
      exception(0x08);
    } else if (function != 3 && function != 6 && function != 16) {
      exception(0x01);
    } else if (!known(address, function == 6 ? 1 : count, function == 3)) {
      exception(0x02);
    } else if (function == 3) {
      reply += '\x03';
      reply += static_cast<char>(2 * count);
      for (int i = 0; i < count; ++i) put(reply, read(address + i, now));
    } else {
      for (std::size_t i = 0; i < values.size(); ++i)
        write(address + static_cast<int>(i), values[i], now);
      reply += frame.substr(1, 5);
    }
    const unsigned sum = crc(reply);
    reply += static_cast<char>(sum & 0xFFu);
    reply += static_cast<char>(sum >> 8u);
    reply = manners_.noise + reply;
    const std::size_t half = manners_.second_half > Time{} ? reply.size() / 2 : reply.size();
    due_.emplace_back(now + manners_.reply, reply.substr(0, half));
    if (half < reply.size())
      due_.emplace_back(now + manners_.reply + manners_.second_half, reply.substr(half));
    return true;
  }

  bool known(int address, int count, bool to_read) const {
    for (int a = address; a < address + count; ++a) {
      const bool readable = (a >= 0x1003 && a <= 0x1015) || (a >= 0x1044 && a <= 0x1047) ||
                            a == 0x2203 || a == 0x0179 || a == 0x601D ||
                            (a >= 0x602A && a <= 0x602E);
      if (!words.contains(a) && a != 0x6002 && a != 0x1801 && !(to_read && readable)) return false;
    }
    return true;
  }

  int read(int address, Time now) {
    const auto half = [&](double pulses) {
      const auto bits = static_cast<std::uint32_t>(static_cast<std::int32_t>(std::lround(pulses)));
      return static_cast<int>(address % 2 == 0 ? bits >> 16u : bits & 0xFFFFu);
    };
    const bool runs = running(now);
    switch (address) {
      case 0x1003:
        return (words[0x000F] == 1 ? 2 : 0) | (runs ? 4 : 0) | (!runs && done_ ? 0x30 : 0) |
               (home_done_ ? 0x40 : 0);
      case 0x1014:
      case 0x1015:
        return half(here(now) * 65536 / words[0x0001]);
      case 0x1046:
        return runs ? 0 : 0xFFFF;
      case 0x0179:
        return upper_switch && here(now) >= *upper_switch ? 0x0002 : 0;
      case 0x601D:
        return warning_;
      case 0x602A:
      case 0x602B:
      case 0x602C:
      case 0x602D:
        return half(here(now));
      case 0x6002:
        return runs ? 0x100 : 0;
      default:
        return words.contains(address) ? words[address] : 0;
    }
  }

  void write(int address, int value, Time now) {
    if (address == 0x1801) {
      if (value == 0x2211) saved = words;
      return;
    }
    if (address != 0x6002) {
      words[address] = value;
      written.emplace_back(address, value);
      if (address != 0x6207 || value != 0x10) return;
    }
    triggers.push_back(value);
    if (value == 0x10) path(now);
    if (value == 0x20) home(now);
    if (value == 0x40) stop(now);
  }

  double pair(int address) {
    return static_cast<std::int32_t>(static_cast<std::uint32_t>(words[address]) << 16u |
                                     static_cast<std::uint32_t>(words[address + 1]));
  }
  double pulses_per_second(int rpm) { return rpm / 60.0 * words[0x0001]; }

  double here(Time now) const {
    if (legs_.empty() || now < legs_.front().begin) return position_;
    const Leg& leg = legs_.front();
    const double all = seconds(leg.end - leg.begin), gone = seconds(now - leg.begin);
    return all <= 0 || gone >= all ? leg.to : leg.from + (leg.to - leg.from) * gone / all;
  }
  void advance(Time now) {
    while (!legs_.empty() && legs_.front().end <= now) {
      position_ = legs_.front().to;
      legs_.erase(legs_.begin());
      if (homing_legs_ > 0 &&
          --homing_legs_ == homing_tail_) {  // just come to rest past the origin
        const double shift = origin_ - pair(0x600B);
        position_ -= shift;
        for (Leg& leg : legs_) leg.from -= shift, leg.to -= shift;
        if (manners_.home_done_at_switch) home_done_ = true;
      }
      if (legs_.empty()) {
        if (homing_) home_done_ = true;
        homing_ = false;
        done_ = true;
      }
    }
  }
  void leg(double to, double per_second, Time now) {
    const Time begin = legs_.empty() ? now : legs_.back().end;
    const double from = legs_.empty() ? here(now) : legs_.back().to;
    legs_.push_back({begin, begin + from_seconds(std::abs(to - from) / per_second), from, to});
  }
  void begin(Time now) {
    position_ = here(now);
    legs_.clear();
    homing_legs_ = 0;
    homing_ = done_ = false;
    warning_ = 0;
  }
  void path(Time now) {
    begin(now);
    double to = pair(0x6201) + (words[0x6200] == 0x41 ? position_ : 0);
    if (upper_switch && to > *upper_switch) {
      to = *upper_switch;
      warning_ = 0x0200;
    }
    leg(to, pulses_per_second(words[0x6203]), now);
  }
  void home(Time now) {
    begin(now);
    home_done_ = false;
    homing_ = true;
    origin_ = position_ - 700;
    constexpr double kOvershoot = 13;
    leg(origin_ - 300, pulses_per_second(words[0x600F]), now);
    leg(origin_ + kOvershoot, pulses_per_second(words[0x6010]), now);
    homing_legs_ = 2;
    homing_tail_ = 0;
    if ((words[0x600A] & 2) == 0) return;
    if (manners_.pause_at_switch > Time{}) {
      const double at = legs_.back().to;
      legs_.push_back(
          {legs_.back().end, legs_.back().end + manners_.pause_at_switch, at, at, false});
      ++homing_legs_, ++homing_tail_;
    }
    leg(origin_ - pair(0x600B) + pair(0x600D), pulses_per_second(words[0x600F]), now);
    ++homing_legs_, ++homing_tail_;
  }
  void stop(Time now) {
    if (legs_.empty()) return;
    const Leg last = legs_.front();
    const double per_second =
        (last.to - last.from) / std::max(1e-9, seconds(last.end - last.begin));
    begin(now);
    const Time within = std::chrono::milliseconds{words[0x6017]};
    legs_.push_back(
        {now, now + within, position_, position_ + std::round(per_second * seconds(within) / 2)});
  }

  Line line_;
  int slave_;
  DriveManners manners_;
  std::string input_;
  std::vector<std::pair<Time, std::string>> due_;
  std::vector<Leg> legs_;
  double position_ = 5000, origin_ = 0;
  int homing_legs_ = 0, homing_tail_ = 0, warning_ = 0;
  bool homing_ = false, home_done_ = false, done_ = false;
};

inline void PrintTo(const DriveManners& manners, std::ostream* out) { *out << manners.name; }

}  // namespace turntable
