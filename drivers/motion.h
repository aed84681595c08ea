// The one motion loop, for every controller: a controller supplies a handful of hooks (`AxisPort`),
// the rules of a move are here. In order: soft limits including the overshoot, before any byte
// leaves; homed and configured, or nothing moves; one-sided approach; each command sent once; a
// deadline from distance, speed and ramps, and a stall watchdog; in-position window held for the
// settle time; retries, then a flagged miss. Limit switches, emergency stop and alarms end a move
// and lose the reference. Positions are never wrapped: limits and cable range of a rotary axis
// count from home.
#pragma once

#include <atomic>
#include <mutex>
#include <optional>
#include <string>

#include "src/core/axis.h"
#include "src/core/clock.h"
#include "src/core/rig_file.h"

namespace turntable {

enum class Motion { kMoving, kEnded, kUnknown };

template <class Q>
struct AxisStatus {
  std::optional<Q> position;  ///< nothing while the controller cannot tell
  Motion motion = Motion::kUnknown;
  bool lower_limit = false, upper_limit = false;  ///< limit switches that are on
  std::string fault{};  ///< emergency stop, alarm: what, and what to do; empty = none
};

/// Whether the controller said that it took a motion command. `kLost`: no (clear) answer; it may be
/// moving.
enum class Acknowledgement { kReceived, kLost };

/// What a controller's driver has to supply for one axis. No function retries a motion command.
template <class Q>
class AxisPort {
 public:
  virtual ~AxisPort() = default;
  /// Serialises all that is said to the controller; the loop holds it from "may this still start?"
  /// to the command, so that nothing starts after a stop.
  virtual std::unique_lock<std::recursive_mutex> lock() = 0;
  /// @throws DeviceError if motion is blocked: not connected, or the configuration differs.
  virtual void require_ready() const = 0;
  /// False while the controller takes no motion command because another of its axes moves. Bounded.
  virtual bool free() { return true; }
  /// @throws DeviceError if refused, LineError.
  virtual Acknowledgement start_move(Q from, Q to) = 0;
  virtual Acknowledgement start_home() = 0;
  /// Called when a homing has ended and the axis stands: lets the place count as 0 where homing alone
  /// does not. @return true if the position has changed by that. @throws DeviceError if the homing cannot
  /// have succeeded.
  virtual bool count_from_home() { return false; }
  /// Reads, retrying a bounded number of times and not past `deadline`.
  /// @throws TimeoutError, ProtocolError, DeviceError, LineError.
  virtual AxisStatus<Q> status(Time deadline) = 0;
  /// May be sent again. @param immediate without deceleration, where the controller can.
  /// @throws TimeoutError, DeviceError, LineError.
  virtual void send_stop(bool immediate) = 0;
};

/// Times of the loop, s.
struct MotionTiming {
  double poll = 0.04;   ///< between two status reads of an axis
  double margin = 2.0;  ///< of a deadline, beside 1.2 times the motion itself
  double stall = 1.0;   ///< without any change of position
  double reply_timeout = 1.0;
};

template <class Q>
class MotionAxis final : public Axis<Q> {
 public:
  /// `port` and `clock` must outlive the axis.
  MotionAxis(const AxisConfig& config, AxisPort<Q>& port, Clock& clock, MotionTiming timing = {});

  const std::string& name() const override { return name_; }
  AxisLimits<Q> limits() const override {
    return {{config_.reach_lower()}, {config_.reach_upper()}};
  }
  void check(Q target) const override;
  bool homed() const override { return homed_; }
  void home() override;
  void start(Q target) override;
  /// Waits until this axis' next status read is due (one poll interval at most), then carries the
  /// move on.
  bool advance() override;
  Arrival<Q> arrival() const override;
  Q position() override;
  std::string condition() override;
  double move_seconds(Q from, Q to) const override;
  void stop() override;

  /// A person vouches that the axis was homed since the controller was switched on, and that nothing
  /// has gone wrong since.
  void trust_reference() { homed_ = true; }

  /// True once the axis was seen to stand and has not been told to move since.
  bool stands() const { return stands_; }

  /// The parts of `stop`, for a controller that stops several axes: forbid all, send all, verify all.
  /// What was asked for before never starts after `forbid`.
  void forbid() { ++stops_; }
  void begin_stop();
  void finish_stop();

  /// Time within which one command over `distance` has to end, s.
  double deadline_seconds(Q distance) const;
  double home_deadline_seconds() const;
  /// Length of the stage: homing never has to go farther.
  double home_span() const;

 private:
  enum class Phase { kIdle, kWaiting, kMoving, kSettling, kArrived, kHoming };

  struct Move {
    Q goal{};              ///< on the pulse grid
    std::optional<Q> via;  ///< where the overshoot ends, while that is still to be reached
    Q leg_start{}, leg_goal{};
    Time leg_began{0}, deadline{0};  ///< while waiting: since when, and for how long
    Time asleep_before{0};           ///< the computer, until the leg began
    Time due{0};                     ///< when the leg should have ended
    Acknowledgement acknowledged{};
    Q last_position{};
    Time last_change{0};
    std::optional<Time> ended_since;  ///< the controller has said so, at one place
    int odd_reads = 0;                ///< in a row, of places where the axis cannot be
    std::optional<Time> inside_since, outside_since;
    unsigned generation = 0;
  };

  double stall_seconds() const;
  bool same_pulse(Q a, Q b) const { return scale_.to_steps(a) == scale_.to_steps(b); }
  bool within(Q a, Q b) const { return abs(a - b).value <= config_.tolerance + 1e-9; }
  Q goal_on_grid(Q target) const;
  std::string shown(Q q) const;
  void throw_if_stopped(unsigned generation) const;
  AxisStatus<Q> read_status();
  AxisStatus<Q> heeded_status();
  void check_trouble(const AxisStatus<Q>& status, double direction) const;
  void begin_approach(Q from);
  void begin_leg(Q from, Q to);
  void send_leg();
  void schedule_poll();
  void wait_for_turn();
  bool carry_on(const AxisStatus<Q>& status);
  bool leg_ended(const AxisStatus<Q>& status, Time now);
  bool plausible(Q position, Time now) const;
  bool odd_place(Q position) const;
  double slack() const;
  bool settled(Q position, Time now);
  void find_home(unsigned generation);
  void lose_reference();
  template <class F>
  auto guarded(unsigned generation, F&& action);

  AxisConfig config_;
  std::string name_;
  AxisPort<Q>* port_;
  Clock* clock_;
  MotionTiming timing_;
  StepScale<Q> scale_;

  std::atomic<bool> homed_{false};
  std::atomic<unsigned> stops_{
      0};  ///< bumped by every stop: what was asked before it never starts after it

  std::atomic<bool> stands_{false};

  // Guarded by port_->lock(), and so is what is written to the one above.
  Phase phase_ = Phase::kIdle;
  Move move_;
  Arrival<Q> arrival_;
  Time next_poll_{0};
  std::string lost_because_;     ///< the emergency stop or alarm that the reference was lost with
  std::optional<Q> left_at_;     ///< where the last move ended
  bool approach_known_ = false;  ///< the last move ended in the final direction
};

extern template class MotionAxis<Millimetres>;
extern template class MotionAxis<Degrees>;

/// Carries on several moves until all have arrived. The first exception leaves the others moving:
/// stop them.
template <class... Axes>
void wait_all(Axes&... axes) {
  for (bool all = false; !all;) {
    all = true;
    ((all = axes.advance() && all), ...);
  }
}

}  // namespace turntable
