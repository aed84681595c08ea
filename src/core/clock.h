// Time as a parameter. `SystemClock` is the wall; `ManualClock` lets hours of simulated motion pass
// in seconds, the same way every time, because it owns both the time and whoever lives at the other
// end of the lines: while somebody waits, it lets those actors answer, and advances to the next
// thing that happens.
#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

namespace turntable {

/// Time since the clock's own start.
using Time = std::chrono::nanoseconds;

constexpr double seconds(Time t) { return std::chrono::duration<double>(t).count(); }
constexpr Time from_seconds(double s) {
  return std::chrono::duration_cast<Time>(std::chrono::duration<double>(s));
}

class Clock {
 public:
  virtual ~Clock() = default;
  virtual Time now() const = 0;
  /// Waits until `fd` has bytes (or its peer is gone: reading then says so) or `deadline` passes.
  /// @return true if a read would not block.
  virtual bool wait_readable(int fd, Time deadline) = 0;
  virtual void sleep_until(Time deadline) = 0;
  /// How long the computer has slept since the clock's start: time that `now` does not count.
  virtual Time asleep() const { return Time{0}; }
  void sleep_for(Time duration) { sleep_until(now() + duration); }
};

/// Monotonic wall time. Waits end early when an interrupt at level 2 arrives (core/interrupt.h).
class SystemClock final : public Clock {
 public:
  /// @param speed > 0: so many seconds of this clock pass in one by the wall. Other than 1 only for
  /// simulated devices, and then on both ends of the line.
  explicit SystemClock(double speed = 1.0);
  Time now() const override;
  bool wait_readable(int fd, Time deadline) override;
  void sleep_until(Time deadline) override;
  Time asleep() const override;
  /// How long that is by the wall, at most 20 ms.
  std::chrono::milliseconds slice_of(Time wait) const;

 private:
  std::chrono::steady_clock::time_point start_;
  Time asleep_at_start_;
  double speed_;
};

/// Somebody at the far end of a descriptor: a simulated device, a listening socket.
class Actor {
 public:
  virtual ~Actor() = default;
  /// Descriptor to watch; -1 for none.
  virtual int descriptor() const = 0;
  /// When the actor next has something to do by itself; nothing if it only answers.
  virtual std::optional<Time> next_due() const = 0;
  /// Reads what has arrived and does what is due. Must not block.
  virtual void act(Time now) = 0;
};

/// Virtual time, owned by the waiting side. Safe to call from several threads; actors run one at a
/// time.
class ManualClock final : public Clock {
 public:
  Time now() const override;
  bool wait_readable(int fd, Time deadline) override;
  void sleep_until(Time deadline) override;

  /// The actor must outlive the clock or be detached.
  void attach(Actor& actor);
  void detach(Actor& actor);
  /// For lines that the system delivers a moment later (ptys, TCP): while `in_flight` says true,
  /// time stands still, for at most a second by the wall.
  void set_in_flight(std::function<bool()> in_flight);

 private:
  void settle();  ///< lets every actor answer until all are quiet at the present time

  std::recursive_mutex mutex_;
  std::atomic<Time> now_{Time{0}};  ///< read without the lock: also by whoever an actor waits for
  std::vector<Actor*> actors_;
  std::function<bool()> in_flight_;
};

/// Runs actors in real time until an interrupt: the same simulators, for people (`turntable
/// simulate`). `actors` is read afresh on every turn, so an actor may add or remove others.
void serve(SystemClock& clock, const std::vector<Actor*>& actors);

/// Wall-clock UTC, ISO 8601 with milliseconds: "2026-01-31T12:00:00.000Z".
std::string utc_now();
/// The same for file names: "20260131T120000Z".
std::string utc_now_compact();

}  // namespace turntable
