// An open byte channel that owns a file descriptor. A serial port, a TCP connection, a pty and one
// end of a socketpair are the same thing from here on: the operating system is the polymorphism.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "src/core/clock.h"

namespace turntable {

enum class Direction { kSent, kReceived };
/// Sees every byte that passes, as it passes.
using WireLog = std::function<void(Direction, std::string_view bytes, Time)>;

class Line {
 public:
  /// Takes over `descriptor` and makes it non-blocking. @param name stands for the line in
  /// messages.
  /// @param owner if given, it closes the descriptor when the line ends (a library's port handle);
  /// otherwise the line closes it.
  Line(int descriptor, std::string name, std::shared_ptr<void> owner = nullptr);
  Line(Line&&) = default;
  Line& operator=(Line&&) = default;

  int descriptor() const { return descriptor_; }
  const std::string& name() const { return name_; }
  void set_log(WireLog log) { log_ = std::move(log); }

  /// Writes everything. @throws TimeoutError, LineError (peer gone).
  void write(std::string_view bytes, Clock& clock, Time deadline);
  /// Waits for at least one byte. @return how many were read.
  /// @throws TimeoutError, LineError (peer gone).
  std::size_t read(std::span<char> buffer, Clock& clock, Time deadline);
  /// Reads what is there without waiting. @param now for the log.
  /// @return 0 if there is nothing. @throws LineError (peer gone).
  std::size_t read_available(std::span<char> buffer, Time now);
  /// Writes what fits without waiting. @return how many bytes. @throws LineError (peer gone).
  std::size_t write_available(std::string_view bytes, Time now);
  /// Throws away what has arrived, 64 KiB at most: a line that is flooded is never empty.
  /// @return number of bytes. @throws LineError (peer gone).
  std::size_t drain(Time now);

  /// When the last byte passed, in either direction; nothing before the first one.
  std::optional<Time> last_byte() const { return last_byte_; }
  /// How long a byte takes on the wire, from the baud rate: what was written is under way for so long.
  /// Zero (the default) where bytes take no time that this program has to know of.
  void set_byte_time(Time time) { byte_time_ = time; }

 private:
  [[noreturn]] void gone(const char* what) const;

  int descriptor_;
  bool socket_;
  std::string name_;
  std::shared_ptr<void> owner_;
  WireLog log_;
  std::optional<Time> last_byte_;
  Time byte_time_{0};
};

/// Two ends of one line inside this process (socketpair): a driver on one, a simulator on the
/// other.
std::pair<Line, Line> line_pair(const std::string& name);

}  // namespace turntable
