// A line and what everybody who talks on it has to share: whose turn it is, a stop that goes first,
// the silence between frames, whether the last exchange ended well, and the way to open it again.
// Two controllers on one RS-485 adapter have one `SharedLine`; so their exchanges never meet.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "protocols/line.h"
#include "src/core/clock.h"

namespace turntable {

/// A handle: copies of it are the same line. Functions said to be called locked are for whoever holds
/// `lock()`.
class SharedLine {
 public:
  /// A line that cannot be opened again.
  // NOLINTNEXTLINE(google-explicit-constructor): whoever has a line alone need not know of sharing.
  SharedLine(Line line);
  /// Opens the line now, and may do so again. @throws what `open` throws.
  explicit SharedLine(std::function<Line()> open);

  const std::string& name() const;
  /// The line as it is now. Called locked.
  Line& line() const;

  /// The turn to talk. Recursive: one exchange may be part of another.
  std::unique_lock<std::recursive_mutex> lock() const;

  /// While it lives, its owner has the turn, and everybody else's exchanges have given way.
  class Stop {
   public:
    explicit Stop(const SharedLine& line);
    ~Stop();
    Stop(const Stop&) = delete;
    Stop& operator=(const Stop&) = delete;

   private:
    const SharedLine& line_;
    std::unique_lock<std::recursive_mutex> lock_;
  };
  /// True if an exchange should end its waiting because a stop waits for its turn.
  bool gives_way() const;

  /// How long the line has to be silent before a frame, at least: whoever wants the longest silence on
  /// it is heeded. Zero unless somebody wants one.
  void want_silence(Time least) const;
  /// When the last byte passed; nothing before the first one, or while the line is closed. Called locked.
  std::optional<Time> last_byte() const;
  /// Waits until the line has been silent for so long. Called locked, before a frame.
  void await_silence(Clock& clock) const;

  bool can_reopen() const;
  /// Closes the line and opens it again. Called locked. @throws LineError, TimeoutError; it may then
  /// be tried again.
  void reopen() const;
  /// How often it has been opened: whoever sees another number than the last time has lost what was
  /// under way, and may be talking to a device that was switched off meanwhile.
  unsigned times_opened() const;

  /// When the request was sent that has not been answered yet, or was not answered at all: an answer may
  /// still come. Nothing if the last exchange ended well. Called locked.
  std::optional<Time> unanswered_since() const;
  void set_unanswered(std::optional<Time> since) const;
  /// Whether the adapter hands back what is sent, as far as that is known. Called locked.
  std::optional<bool> echoes() const;
  void set_echoes(bool echoes) const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace turntable
