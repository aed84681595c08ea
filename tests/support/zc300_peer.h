// A ZC300 written from its manual's pages, from what the vendor's library was heard to send, and from
// the notes of laboratories, and not from our simulator: own register table, own checksum, own motion
// (constant speed). It refuses what the manual reserves, counts registers exactly, does not set its
// counter to 0 when it homes, and answers as late as a real one.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <map>
#include <optional>
#include <ostream>
#include <set>
#include <string>
#include <vector>

#include "protocols/line.h"
#include "src/core/clock.h"
#include "tests/support/hex.h"

namespace turntable {

struct Zc300Manners {
  const char* name = "";
  Time reply{std::chrono::milliseconds{65}};  ///< 57 to 73 ms were seen
  Time second_half{};                         ///< an answer comes in two parts, so far apart
  bool echo = false;                          ///< of the adapter
  std::string noise{};                        ///< before each answer
  bool misses_after_motion = false;           ///< the first question after each motion is not heard
  int busy_every = 0;  ///< each so manieth question is answered with 06, by a gateway
};

class Zc300Peer final : public Actor {
 public:
  Zc300Peer(Line line, Zc300Manners manners) : line_(std::move(line)), manners_(manners) {
    for (int n = 0; n < 3; ++n) {  // as it comes from the factory
      words[30066 + n] = 1;
      words[30072 + n] = 1;
      words[30105 + n] = 3;
      put_long(30075 + 2 * n, 1600);
      put_float(30084 + 2 * n, 4);
      put_float(30090 + 2 * n, 1);
      pulses_[30099 + 2 * n] = 2000;
      pulses_[30123 + 2 * n] = 400;
      pulses_[30129 + 2 * n] = 8000;
      pulses_[30135 + 2 * n] = 12000;
    }
    words[30069] = 1;
    saved_ = words;
    saved_pulses_ = pulses_;
  }

  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override {
    if (due_.empty()) return std::nullopt;
    return due_.front().first;
  }
  void act(Time now) override {
    std::array<char, 256> buffer;
    const std::size_t n = line_.read_available(buffer, now);
    if (n > 0 && said_ && now < *said_ + std::chrono::microseconds{1750}) ++too_soon;
    input_.append(buffer.data(), n);
    while (take_frame(now)) {
    }
    while (!due_.empty() && due_.front().first <= now) {
      line_.write_available(due_.front().second, now);
      due_.erase(due_.begin());
      said_ = now;
    }
  }

  /// It is switched off and on: what was not saved is gone, and so are the places.
  void switch_on() {
    words = saved_;
    pulses_ = saved_pulses_;
    axes_ = {};
  }
  /// Where the axis' own counter says that it is, mm or deg.
  double shown(int axis, Time now) { return at(axis, now) * scale(axis); }
  /// Where it is from its home switch, mm or deg.
  double from_home(int axis, Time now) {
    return (at(axis, now) + axes_[index(axis)].offset) * scale(axis);
  }
  bool moving(int axis, Time now) const {
    const auto& motion = axes_[index(axis)];
    return motion.end > now;
  }

  std::map<int, int> words;
  std::vector<std::string> opcodes;    ///< as they were written, in hex
  std::vector<std::string> refused;    ///< questions that it refused, in hex
  int too_soon = 0;                    ///< frames without the silence before them
  std::optional<int> refuses_moves{};  ///< with this exception
  bool deaf_to_opcodes = false;        ///< but for stops
  int unheard = 0;

 private:
  struct Axis {
    double from = 777, to = 777;  ///< pulses, by the counter: it stands anywhere
    Time begin{0}, end{0};
    double offset = 4321;  ///< what the counter lacks from the home switch
    bool was_moving = false;
  };

  static std::size_t index(int axis) { return static_cast<std::size_t>(axis); }
  static double float_of(int high, int low) {
    return std::bit_cast<float>(static_cast<std::uint32_t>(high) << 16u |
                                static_cast<std::uint32_t>(low));
  }
  void put_long(int number, long value) {
    const auto bits = static_cast<std::uint32_t>(value);
    words[number] = static_cast<int>(bits >> 16u);
    words[number + 1] = static_cast<int>(bits & 0xFFFFu);
  }
  void put_float(int number, double value) {
    put_long(number, static_cast<long>(std::bit_cast<std::uint32_t>(static_cast<float>(value))));
  }
  double get_float(int number) { return float_of(words[number], words[number + 1]); }
  double get_long(int number) {
    return static_cast<double>(words[number]) * 65536 + words[number + 1];
  }
  /// mm or deg to a pulse.
  double scale(int axis) {
    if (words[30072 + axis] == 0) return 1;
    const double per_turn = get_long(30075 + 2 * axis);
    return words[30081 + axis] == 1 ? 360 / (per_turn * get_float(30090 + 2 * axis))
                                    : get_float(30084 + 2 * axis) / per_turn;
  }
  double at(int axis, Time now) const {
    const Axis& a = axes_[index(axis)];
    if (now >= a.end) return a.to;
    const double part = seconds(now - a.begin) / seconds(a.end - a.begin);
    return std::round(a.from + part * (a.to - a.from));
  }
  /// Speeds and accelerations: floats that are kept in pulses.
  static bool in_pulses(int number) {
    return (number >= 30099 && number < 30105) || (number >= 30123 && number < 30141);
  }
  static int axis_of(int number) { return (number - 30099) / 2 % 3; }
  static bool reserved(int number) {
    return (number >= 30025 && number <= 30049) || (number >= 30054 && number <= 30058) ||
           (number >= 30096 && number <= 30098);
  }

  bool take_frame(Time now) {
    if (input_.size() < 8) return false;
    const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(input_[i]); };
    const int function = byte(1), first = byte(2) * 256 + byte(3) + 1;
    const std::size_t length = function == 16 ? 9u + byte(6) : 8u;
    if (input_.size() < length) return false;
    const std::string frame = input_.substr(0, length);
    const int slave = byte(0), count = function == 6 ? 1 : byte(4) * 256 + byte(5);
    std::vector<int> values;
    if (function == 6) values = {byte(4) * 256 + byte(5)};
    for (std::size_t i = 7; function == 16 && i + 1 < length - 2; i += 2)
      values.push_back(byte(i) * 256 + byte(i + 1));
    input_.erase(0, length);
    if (manners_.echo) line_.write_available(frame, now);
    const std::string body = frame.substr(0, length - 2);
    if (modbus_checksum(body) != frame.substr(length - 2) || slave != words[30069]) return true;
    bool ended = false;
    for (int axis = 0; axis < 3; ++axis) {
      Axis& a = axes_[index(axis)];
      ended = ended || (a.was_moving && !moving(axis, now));
      a.was_moving = moving(axis, now);
    }
    if (manners_.misses_after_motion && ended) return true;
    const bool question = function == 3 || function == 4;
    std::string reply = frame.substr(0, 2);
    int trouble = 0;
    if (question && manners_.busy_every > 0 && ++questions_ % manners_.busy_every == 0) {
      trouble = 0x06;
    } else if (question) {
      trouble = function == 4 ? readable(first, count, 30001, 30049)
                              : readable(first, count, 30050, 30140);
      reply += static_cast<char>(2 * count);
      for (int i = 0; trouble == 0 && i < count; ++i) {
        const int word = read(first + i, now);
        reply += static_cast<char>(static_cast<unsigned>(word) >> 8u);
        reply += static_cast<char>(static_cast<unsigned>(word) & 0xFFu);
      }
    } else if (function == 6 || function == 16) {
      trouble = readable(first, count, 30050, 30140);
      if (first == 30050 && deaf_to_opcodes && values[0] != 0x67 && values[0] != 0x68)
        return ++unheard, true;
      if (trouble == 0)
        trouble = first == 30050 ? opcode(function, values, now) : write(first, values, now);
      reply += frame.substr(2, 4);
    } else {
      trouble = 0x01;
    }
    if (trouble != 0) {
      if (!(question && trouble == 0x06)) refused.push_back(hex_of(frame));
      reply = {frame[0], static_cast<char>(function | 0x80), static_cast<char>(trouble)};
    }
    reply = manners_.noise + reply + modbus_checksum(reply);
    const std::size_t half = manners_.second_half > Time{} ? reply.size() / 2 : reply.size();
    due_.emplace_back(now + manners_.reply, reply.substr(0, half));
    if (half < reply.size())
      due_.emplace_back(now + manners_.reply + manners_.second_half, reply.substr(half));
    return true;
  }

  static int readable(int first, int count, int least, int most) {
    if (first < least || first + count - 1 > most) return 0x02;
    for (int i = 0; i < count; ++i)
      if (reserved(first + i)) return 0x02;
    return 0;
  }

  int read(int number, Time now) {
    const auto half_of = [&](double value, int base) {
      const auto bits = std::bit_cast<std::uint32_t>(static_cast<float>(value));
      return static_cast<int>((number - base) % 2 == 0 ? bits >> 16u : bits & 0xFFFFu);
    };
    constexpr std::array kModel{'Z', 'C', '3', '0', '0', '-', '3', 'A'};
    if (number <= 30007) {
      const auto i = 2 * static_cast<std::size_t>(number - 30001);
      return i < kModel.size() ? kModel[i] * 256 + kModel[i + 1] : 0;
    }
    if (number == 30009) return 100;
    if (number == 30010) return 11;
    if (number < 30012) return 0;
    if (number <= 30014) return moving(number - 30012, now) ? 1 : 0;
    if (number == 30015) return 0x0104;  // home inputs without a switch float high: X and Z
    if (number <= 30021) return half_of(shown((number - 30016) / 2, now), 30016);
    if (number <= 30024) return words[30072 + number - 30022];
    if (in_pulses(number)) {
      const int start = number - (number - 30099) % 2, axis = axis_of(start);
      return half_of(pulses_[start] * scale(axis), start);
    }
    if (number >= 30059 && number <= 30064) return half_of(shown((number - 30059) / 2, now), 30059);
    return words[number];
  }

  int write(int first, const std::vector<int>& values, Time now) {
    for (std::size_t i = 0; i < values.size(); ++i) {
      const int number = first + static_cast<int>(i);
      const bool place = number >= 30059 && number <= 30064;
      const bool pair = place || in_pulses(number) || (number >= 30075 && number <= 30080) ||
                        (number >= 30084 && number <= 30095) ||
                        (number >= 30114 && number <= 30119);
      if (!pair) {
        words[number] = values[i];
        continue;
      }
      if (i + 1 == values.size()) return 0x03;  // half a number
      const int low = values[++i];
      const double value = float_of(values[i - 1], low);
      if (place) {
        const int axis = (number - 30059) / 2;
        if (moving(axis, now)) return 0x06;
        Axis& a = axes_[index(axis)];
        const double counts = std::round(value / scale(axis));
        a.offset += a.to - counts;
        a.from = a.to = counts;
      } else if (in_pulses(number)) {
        const int axis = axis_of(number);
        const double wanted = value / scale(axis), cruise = pulses_[30129 + 2 * axis];
        if (!(wanted >= 0 && wanted <= 1e7)) return 0x05;
        if (number < 30105 && !(wanted < cruise)) return 0x05;
        if (number >= 30123 && number < 30129 && wanted > cruise) return 0x05;
        pulses_[number] = wanted;
      } else {
        const double most = number < 30081 ? 1e7 : number < 30090 ? 1000 : 10000;
        const double whole = static_cast<double>(values[i - 1]) * 65536 + low;
        const double checked = number < 30081 ? whole : value;
        if (number < 30114 && !(checked > 0 && checked < most)) return 0x05;
        words[number] = values[i - 1];
        words[number + 1] = low;
      }
    }
    return 0;
  }

  int opcode(int function, const std::vector<int>& values, Time now) {
    std::string text;
    for (const int value : values) text += fmt::format("{:02x} ", value);
    const int code = values[0];
    const std::map<int, std::size_t> lengths{{0x64, 3}, {0x65, 3}, {0x66, 3}, {0x67, 2},
                                             {0x68, 2}, {0x69, 2}, {0x6C, 1}, {0x6D, 1}};
    const auto length = lengths.find(code);
    if (length == lengths.end()) return 0x0A;
    if (function != 16 || values.size() != length->second) return 0x03;
    opcodes.push_back(text);
    if (code == 0x6C || code == 0x6D) return 0;
    if (code == 0x68 && values[1] == 0x30) {
      for (int axis = 0; axis < 3; ++axis) halt(axis, now, Time{0});
      return 0;
    }
    if (values[1] < 0x31 || values[1] > 0x33) return 0x05;
    const int axis = values[1] - 0x31;
    if (code == 0x68) return halt(axis, now, Time{0}), 0;
    if (code == 0x67) return halt(axis, now, std::chrono::milliseconds{40}), 0;
    if (refuses_moves) return *refuses_moves;
    if (moving(axis, now)) return 0x06;
    if (words[30066 + axis] == 0) return 0x09;
    const double here = at(axis, now);
    if (code == 0x69) return go(axis, here, -axes_[index(axis)].offset, 30099, now), 0;
    if (values[2] != 0x50 && values[2] != 0x4E) return 0x05;
    const double sign = values[2] == 0x50 ? 1 : -1;
    const double distance = std::trunc(get_float(30114 + 2 * axis) * 1000) / 1000;
    const double pulses = std::round(sign * distance / scale(axis));
    go(axis, here, code == 0x64 ? pulses : here + pulses, 30129, now);
    return 0;
  }
  void go(int axis, double from, double to, int speed, Time now) {
    Axis& a = axes_[index(axis)];
    a.from = from;
    a.to = to;
    a.begin = now;
    a.end = now + from_seconds(std::abs(to - from) / pulses_[speed + 2 * axis]);
    a.was_moving = a.end > now;
  }
  void halt(int axis, Time now, Time within) {
    Axis& a = axes_[index(axis)];
    if (!moving(axis, now)) return;
    const double here = at(axis, now), there = at(axis, now + within);
    a.from = here;
    a.to = there;
    a.begin = now;
    a.end = now + within;
  }

  Line line_;
  Zc300Manners manners_;
  std::map<int, double> pulses_;  ///< speeds and accelerations
  std::map<int, int> saved_;
  std::map<int, double> saved_pulses_;
  std::array<Axis, 3> axes_{};
  std::string input_;
  std::vector<std::pair<Time, std::string>> due_;
  std::optional<Time> said_;
  int questions_ = 0;
};

inline void PrintTo(const Zc300Manners& manners, std::ostream* out) { *out << manners.name; }

}  // namespace turntable
