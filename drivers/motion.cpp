#include "drivers/motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/core/motion_time.h"
#include "src/core/stage_spec.h"

namespace turntable {
namespace {

/// A stop came from elsewhere: the move has ended, but nothing is wrong with the axis.
class Stopped : public DeviceError {
 public:
  using DeviceError::DeviceError;
};

// Room for the time that a read takes on the line, and for positions shown with fewer digits than a
// pulse needs.
constexpr double kLatency_s = 0.1;
constexpr double kSlackPulses = 10;
constexpr int kOddReads = 3;               // a late answer to an earlier question looks odd once
constexpr double kExpectedLate_s = 0.002;  // pulses are counted in whole ones, and bytes take time
constexpr double kHaltPoll_s = 0.02;
constexpr double kHalted_s = 0.05;

}  // namespace

template <class Q>
MotionAxis<Q>::MotionAxis(const AxisConfig& config, AxisPort<Q>& port, Clock& clock,
                          MotionTiming timing)
    : config_(config),
      name_(axis_name(config.id)),
      port_(&port),
      clock_(&clock),
      timing_(timing),
      scale_{{config.per_step()}} {
  config_.tolerance = std::max(config_.tolerance, config_.finest_window());
}

// ---- what may be asked, and how long it takes

template <class Q>
std::string MotionAxis<Q>::shown(Q q) const {
  return fmt::format("{:.6g} {}", q.value, Q::unit());
}

template <class Q>
void MotionAxis<Q>::check(Q target) const {
  constexpr double kRounding = 1e-9;
  const double b = config_.backlash;
  const double lower = config_.reach_lower() + std::max(b, 0.0);
  const double upper = config_.reach_upper() + std::min(b, 0.0);
  if (target.value >= lower - kRounding && target.value <= upper + kRounding)
    return;  // false for NaN
  const bool cable = target.value < lower ? config_.cable_lower > config_.lower
                                          : config_.cable_upper < config_.upper;
  const std::string_view bound = cable ? "cable range" : "limits";
  std::string room;
  if (b != 0.0)
    room = fmt::format(" ({} [{:g}, {:g}] less the overshoot of {:g} for the one-sided approach)",
                       bound, config_.reach_lower(), config_.reach_upper(), std::abs(b));
  else if (cable)
    room = fmt::format(" ({})", bound);
  throw LimitError(fmt::format(
      "axis {}: asked for {}, allowed [{:g}, {:g}] {}{}. Nothing was sent. Ask for "
      "less, or widen the {} in the rig file if the {} allows it.",
      name_, shown(target), lower, upper, Q::unit(), room, bound, cable ? "cable" : "stage"));
}

template <class Q>
double MotionAxis<Q>::move_seconds(Q from, Q to) const {
  return same_pulse(from, to) ? 0.0 : turntable::move_seconds(config_, from.value, to.value);
}

template <class Q>
double MotionAxis<Q>::deadline_seconds(Q distance) const {
  return 1.2 * trapezoid_seconds(config_, distance.value) + timing_.margin + timing_.reply_timeout;
}

template <class Q>
double MotionAxis<Q>::home_span() const {
  double span = config_.upper - config_.lower;
  if (const StageSpec* spec = find_stage_spec(config_.stage_model))
    span = std::max(span, spec->travel_upper - spec->travel_lower);
  return span;
}

template <class Q>
double MotionAxis<Q>::home_deadline_seconds() const {
  const double span = home_span();
  // Across all the stage once, and slowly back to the switch.
  const double slow = std::min(config_.initial_speed, config_.home_speed);
  return 1.2 * span / config_.home_speed + config_.home_speed / slow + 5 * timing_.margin;
}

template <class Q>
double MotionAxis<Q>::stall_seconds() const {
  const double slowest = std::min(config_.initial_speed, config_.speed);
  return timing_.stall + 3 * timing_.poll + (slowest > 0 ? 2 * config_.per_step() / slowest : 0.0);
}

/// The grid must not lead outside a limit, which the controller may enforce too.
template <class Q>
Q MotionAxis<Q>::goal_on_grid(Q target) const {
  const double goal = config_.on_grid(target.value);
  if (goal > config_.reach_upper()) return {config_.on_grid(goal - config_.least_move())};
  if (goal < config_.reach_lower()) return {config_.on_grid(goal + config_.least_move())};
  return {goal};
}

// ---- guards

template <class Q>
void MotionAxis<Q>::throw_if_stopped(unsigned generation) const {
  if (stops_ != generation)
    throw Stopped(fmt::format("axis {}: the motion was stopped before its end", name_));
}

template <class Q>
void MotionAxis<Q>::lose_reference() {
  const auto lock = port_->lock();
  homed_ = false;
  phase_ = Phase::kIdle;
  left_at_.reset();
  approach_known_ = false;
}

/// After any trouble nobody knows any more where the axis stands. A stop or an interrupt is no
/// trouble, and neither is an exchange that gave way to a stop.
template <class Q>
template <class F>
auto MotionAxis<Q>::guarded(unsigned generation, F&& action) {
  try {
    return action();
  } catch (const Stopped&) {
    throw;
  } catch (const Interrupted&) {
    throw;
  } catch (const GaveWay& e) {  // to a stop of this axis, or of another one on the line
    throw_if_stopped(generation);
    const auto lock = port_->lock();
    phase_ = Phase::kIdle;
    throw Stopped(fmt::format("axis {}: {}", name_, e.what()));
  } catch (...) {
    lose_reference();
    throw;
  }
}

/// What must not be while the axis moves in `direction` (sign; 0 = it does not).
template <class Q>
void MotionAxis<Q>::check_trouble(const AxisStatus<Q>& status, double direction) const {
  const std::string place = status.position ? " at " + shown(*status.position) : std::string();
  if (!status.fault.empty())
    throw DeviceError(
        fmt::format("axis {}: {}{}. Then home the axis again.", name_, status.fault, place));
  if ((status.upper_limit && direction > 0) || (status.lower_limit && direction < 0))
    throw DeviceError(fmt::format(
        "axis {}: the {} limit switch is on{}. Find out why the axis came there within its soft "
        "limits [{:g}, {:g}] {}; then home it again.",
        name_, direction > 0 ? "upper" : "lower", place, config_.lower, config_.upper, Q::unit()));
}

template <class Q>
AxisStatus<Q> MotionAxis<Q>::read_status() {
  const Time deadline = clock_->now() + from_seconds(3 * timing_.reply_timeout + timing_.margin);
  for (;;) {
    try {
      if (auto status = port_->status(deadline); status.position) return status;
    } catch (const GaveWay&) {
    }
    if (clock_->now() >= deadline)
      throw TimeoutError(
          fmt::format("axis {}: the controller does not say where it stands", name_));
    clock_->sleep_for(from_seconds(timing_.poll));
  }
}

/// Whoever reads an emergency stop or an alarm, the reference is lost with it.
template <class Q>
AxisStatus<Q> MotionAxis<Q>::heeded_status() {
  AxisStatus<Q> status = read_status();
  const auto lock = port_->lock();
  if (!status.fault.empty()) {
    homed_ = false;
    lost_because_ = status.fault;
  }
  if (status.motion == Motion::kEnded && (phase_ == Phase::kIdle || phase_ == Phase::kArrived))
    stands_ = true;
  return status;
}

template <class Q>
Q MotionAxis<Q>::position() {
  return guarded(stops_, [&] { return *heeded_status().position; });
}

template <class Q>
std::string MotionAxis<Q>::condition() {
  const auto status = port_->status(clock_->now() + from_seconds(timing_.reply_timeout));
  std::string text = status.motion == Motion::kMoving ? "moves" : "";
  const auto add = [&](std::string_view words) {
    text += fmt::format("{}{}", text.empty() ? "" : ", ", words);
  };
  if (status.lower_limit) add("lower limit switch is on");
  if (status.upper_limit) add("upper limit switch is on");
  if (!status.fault.empty()) add(status.fault);
  return text;
}

// ---- moving

template <class Q>
void MotionAxis<Q>::start(Q target) {
  const unsigned generation = stops_;
  check(target);
  port_->require_ready();
  {
    const auto lock = port_->lock();
    if (!homed_)
      throw DeviceError(fmt::format(
          "axis {}: not homed{}, so {} cannot be found. Home it first; a reference is lost by a "
          "power cycle, a timeout or any error while moving.",
          name_, lost_because_.empty() ? "" : " (" + lost_because_ + ")", shown(target)));
    if (phase_ != Phase::kIdle && phase_ != Phase::kArrived)
      throw DeviceError(
          fmt::format("axis {}: asked for {} while still moving to {}. Wait or stop first.", name_,
                      shown(target), shown(move_.goal)));
  }
  guarded(generation, [&] {
    AxisStatus<Q> status = heeded_status();
    for (int i = 1; i < kOddReads && left_at_ && !within(*status.position, *left_at_); ++i) {
      clock_->sleep_for(from_seconds(timing_.poll));
      status = heeded_status();
    }
    check_trouble(status, 0.0);
    const Q from = *status.position;
    const auto lock = port_->lock();
    throw_if_stopped(generation);
    if ((phase_ != Phase::kIdle && phase_ != Phase::kArrived) || !homed_)
      throw Stopped(
          fmt::format("axis {}: asked for {}, but it is moved from elsewhere, or its reference was "
                      "lost meanwhile. Nothing was sent.",
                      name_, shown(target)));
    if (left_at_ && !within(from, *left_at_))
      throw DeviceError(
          fmt::format("axis {}: was left at {} and now stands at {} without having been asked: the "
                      "controller was reset or moved by hand. Home it again.",
                      name_, shown(*left_at_), shown(from)));
    arrival_ = {from, target};
    move_ = {};
    move_.goal = goal_on_grid(target);
    move_.generation = generation;
    if (same_pulse(from, move_.goal) && (approach_known_ || config_.backlash == 0.0)) {
      phase_ = Phase::kArrived;
      left_at_ = from;
      return;
    }
    check_trouble(status, (move_.goal - from).value);
    begin_approach(from);
  });
}

template <class Q>
void MotionAxis<Q>::begin_approach(Q from) {
  // A short move in the final direction needs no overshoot, provided that the one before ended like
  // that too.
  const bool direct = !takes_overshoot(config_, from.value, move_.goal.value) &&
                      (approach_known_ || config_.backlash == 0.0);
  approach_known_ = false;
  if (direct) return begin_leg(from, move_.goal);
  arrival_.overshot = true;
  move_.via = goal_on_grid(move_.goal - Q{config_.backlash});
  begin_leg(from, *move_.via);
}

template <class Q>
void MotionAxis<Q>::begin_leg(Q from, Q to) {
  const auto lock = port_->lock();
  move_.leg_start = from;
  move_.leg_goal = to;
  if (port_->free()) return send_leg();
  phase_ = Phase::kWaiting;
  move_.leg_began = clock_->now();
  move_.deadline = move_.leg_began + from_seconds(home_deadline_seconds());
  next_poll_ = move_.leg_began + from_seconds(timing_.poll);
}

template <class Q>
void MotionAxis<Q>::send_leg() {
  const auto lock = port_->lock();  // held from the last look at the stop to the command
  throw_if_stopped(move_.generation);
  const Q from = move_.leg_start, to = move_.leg_goal;
  left_at_.reset();
  phase_ = Phase::kMoving;
  move_.last_position = from;
  move_.leg_began = clock_->now();
  move_.asleep_before = clock_->asleep();
  move_.deadline = move_.leg_began + from_seconds(deadline_seconds(to - from));
  move_.ended_since.reset();
  move_.inside_since.reset();
  move_.outside_since.reset();
  if (!same_pulse(from, to)) stands_ = false;
  move_.acknowledged =
      same_pulse(from, to) ? Acknowledgement::kReceived : port_->start_move(from, to);
  move_.last_change = clock_->now();
  move_.due = move_.last_change + from_seconds(trapezoid_seconds(config_, (to - from).value));
  schedule_poll();
}

/// While an axis moves, its status is read as often as `poll` says, and once more just when it should
/// have ended; if it is late, four times as often for two intervals. A campaign is thousands of
/// moves, and half an interval lost at the end of each is a twentieth of the night.
template <class Q>
void MotionAxis<Q>::schedule_poll() {
  const Time now = clock_->now();
  const Time poll = from_seconds(timing_.poll);
  next_poll_ = now + poll;
  if (phase_ != Phase::kMoving) return;
  const Time expected = move_.due + from_seconds(kExpectedLate_s);
  if (now < expected)
    next_poll_ = std::min(next_poll_, expected);
  else if (now < expected + 2 * poll)
    next_poll_ = now + poll / 4;
}

template <class Q>
void MotionAxis<Q>::wait_for_turn() {
  const auto lock = port_->lock();
  if (port_->free()) return send_leg();
  next_poll_ = clock_->now() + from_seconds(timing_.poll);
  if (clock_->now() > move_.deadline)
    throw TimeoutError(
        fmt::format("axis {}: the controller is still busy with another axis after {:.0f} s", name_,
                    seconds(clock_->now() - move_.leg_began)));
}

template <class Q>
bool MotionAxis<Q>::advance() {
  Time due{0};
  unsigned generation = 0;
  Time deadline{0};
  bool waiting = false;
  {
    const auto lock = port_->lock();
    if (phase_ == Phase::kArrived) return true;
    if (phase_ != Phase::kWaiting && phase_ != Phase::kMoving && phase_ != Phase::kSettling)
      throw Stopped(
          fmt::format("axis {}: no move is under way: it was stopped, or never started", name_));
    waiting = phase_ == Phase::kWaiting;
    due = next_poll_;
    generation = move_.generation;
    deadline = move_.deadline;
  }
  throw_if_stopped(generation);
  clock_->sleep_until(due);
  return guarded(generation, [&] {
    throw_if_stopped(generation);
    if (waiting) {
      wait_for_turn();
      return false;
    }
    AxisStatus<Q> status;
    try {
      status = port_->status(deadline);
    } catch (const GaveWay&) {  // to a stop of another axis, perhaps: the next poll will tell
      throw_if_stopped(generation);
      const auto lock = port_->lock();
      next_poll_ = clock_->now() + from_seconds(timing_.poll);
      return false;
    }
    const auto lock = port_->lock();
    throw_if_stopped(generation);
    schedule_poll();
    return carry_on(status);
  });
}

template <class Q>
bool MotionAxis<Q>::carry_on(const AxisStatus<Q>& status) {
  const Time now = clock_->now();
  check_trouble(status, phase_ == Phase::kMoving ? (move_.leg_goal - move_.leg_start).value : 0.0);
  if (status.position && !plausible(*status.position, now)) {
    if (++move_.odd_reads < kOddReads) return false;
    throw DeviceError(fmt::format(
        "axis {}: stands at {} {:.2f} s after being sent from {} to {}, where it cannot "
        "be: the controller was reset, or is set up differently. Home it again.",
        name_, shown(*status.position), seconds(now - move_.leg_began), shown(move_.leg_start),
        shown(move_.leg_goal)));
  }
  move_.odd_reads = 0;
  if (phase_ == Phase::kMoving) {
    if (!leg_ended(status, now)) return false;
    const Q here = *status.position;
    if (abs(here - move_.leg_goal).value > slack())
      throw DeviceError(fmt::format(
          "axis {}: ended at {} instead of {}: a limit switch, a stop button or a reset "
          "of the controller{}. Find out which, then home it again.",
          name_, shown(here), shown(move_.leg_goal),
          move_.acknowledged == Acknowledgement::kReceived
              ? ""
              : "; or the command was never taken: the controller had not acknowledged it, and it "
                "was not sent again"));
    approach_known_ = (move_.leg_goal - move_.leg_start).value * config_.backlash >= 0;
    if (move_.via) {
      move_.via.reset();
      begin_leg(here, move_.goal);
      return false;
    }
    phase_ = Phase::kSettling;
    move_.deadline = now + from_seconds(5 * config_.settle_s + timing_.margin);
  }
  if (now > move_.deadline)
    throw TimeoutError(
        fmt::format("axis {}: does not settle at {}: it keeps leaving the window of {:g} {}. Check "
                    "for vibration.",
                    name_, shown(move_.goal), config_.tolerance, Q::unit()));
  return status.position && settled(*status.position, now);
}

/// How far off a place may be and still be that place: more than the window, less than trouble.
template <class Q>
double MotionAxis<Q>::slack() const {
  return std::max(10 * config_.tolerance, kSlackPulses * config_.per_step());
}

/// Whether the axis cannot have come there: it was reset, or moved by somebody else.
template <class Q>
bool MotionAxis<Q>::odd_place(Q position) const {
  const auto off = [&](Q place) { return abs(position - place).value > slack(); };
  if (phase_ == Phase::kMoving) {
    const double gone = (position - move_.leg_start).value;
    const double way = (move_.leg_goal - move_.leg_start).value;
    return gone < std::min(way, 0.0) - slack() || gone > std::max(way, 0.0) + slack();
  }
  if (phase_ == Phase::kSettling) return off(move_.last_position);
  return left_at_ && off(*left_at_);
}

/// Whether the move can have brought the axis there by now.
template <class Q>
bool MotionAxis<Q>::plausible(Q position, Time now) const {
  if (phase_ == Phase::kSettling) return abs(position - move_.last_position).value <= slack();
  const double gone = (position - move_.leg_start).value;
  const double way = (move_.leg_goal - move_.leg_start).value;
  // A controller goes on while the computer sleeps, and this clock does not.
  const Time slept = clock_->asleep() - move_.asleep_before;
  const double possible =
      1.1 * config_.speed * (seconds(now - move_.leg_began + slept) + kLatency_s) + slack();
  return gone >= std::min(way, 0.0) - slack() && gone <= std::max(way, 0.0) + slack() &&
         std::abs(gone) <= possible;
}

template <class Q>
bool MotionAxis<Q>::leg_ended(const AxisStatus<Q>& status, Time now) {
  if (status.position) {
    const Q here = *status.position;
    const bool unchanged = same_pulse(here, move_.last_position);
    if (!unchanged) {
      move_.last_position = here;
      move_.last_change = now;
    }
    const bool at_goal = within(here, move_.leg_goal);
    // A controller's "ended" may be left over from the move before: believed where the axis is at
    // its goal or stands still.
    if (!unchanged) move_.ended_since.reset();
    if (status.motion == Motion::kEnded) {
      if (!move_.ended_since) move_.ended_since = now;
      const bool stands = now - *move_.ended_since >= from_seconds(timing_.poll);
      if (at_goal || stands) return true;
    }
    // Where the controller cannot tell, standing still at the goal is the end; but a counter at 0
    // may as well have been reset.
    const bool could_be_reset = abs(move_.leg_goal).value <= slack();
    if (status.motion == Motion::kUnknown && at_goal && !could_be_reset &&
        now - move_.last_change >= from_seconds(2.5 * timing_.poll))
      return true;
    if (now - move_.last_change > from_seconds(stall_seconds()))
      throw TimeoutError(fmt::format(
          "axis {}: {} at {} on the way from {} to {}{}. Check for an obstacle, a limit switch, an "
          "emergency stop or a reset, then home it again.",
          name_, at_goal ? "stands still without being reported as arrived" : "stalled",
          shown(here), shown(move_.leg_start), shown(move_.leg_goal),
          move_.acknowledged == Acknowledgement::kReceived
              ? ""
              : "; the controller had not acknowledged the command, which was not sent again"));
  }
  if (now > move_.deadline)
    throw TimeoutError(fmt::format(
        "axis {}: did not reach {} within {:.1f} s; last seen at {}", name_, shown(move_.leg_goal),
        seconds(move_.deadline - move_.leg_began), shown(move_.last_position)));
  return false;
}

template <class Q>
bool MotionAxis<Q>::settled(Q position, Time now) {
  const Time settle = from_seconds(config_.settle_s);
  const auto arrive = [&](bool missed) {
    arrival_.position = position;
    arrival_.missed = missed;
    left_at_ = position;
    stands_ = true;
    phase_ = Phase::kArrived;
    return true;
  };
  if (within(position, move_.goal)) {
    move_.outside_since.reset();
    if (!move_.inside_since) move_.inside_since = now;
    if (now - *move_.inside_since >= settle) return arrive(false);
    next_poll_ = std::min(next_poll_, *move_.inside_since + settle);
    return false;
  }
  move_.inside_since.reset();
  if (!move_.outside_since) move_.outside_since = now;
  if (now - *move_.outside_since < settle) return false;
  if (arrival_.retries >= config_.retries) return arrive(true);
  ++arrival_.retries;
  begin_approach(position);
  return false;
}

template <class Q>
Arrival<Q> MotionAxis<Q>::arrival() const {
  const auto lock = port_->lock();
  return arrival_;
}

// ---- homing

template <class Q>
void MotionAxis<Q>::home() {
  const unsigned generation = stops_;
  port_->require_ready();
  {
    const auto lock = port_->lock();
    if (phase_ != Phase::kIdle && phase_ != Phase::kArrived)
      throw DeviceError(
          fmt::format("axis {}: asked to home while still moving. Wait or stop first.", name_));
    homed_ = false;
    left_at_.reset();
    approach_known_ = false;
    phase_ = Phase::kHoming;
  }
  try {
    find_home(generation);
  } catch (...) {
    lose_reference();
    throw;
  }
}

template <class Q>
void MotionAxis<Q>::find_home(unsigned generation) {
  const AxisStatus<Q> before = heeded_status();
  check_trouble(before, 0.0);
  const Q start = *before.position;
  Q last = start;
  const double farthest = 1.2 * home_span() + slack();
  Time began = clock_->now();
  Time deadline = began + from_seconds(home_deadline_seconds());
  const auto sent = [&] {
    const auto lock = port_->lock();
    throw_if_stopped(generation);
    if (!port_->free()) return false;
    began = clock_->now();
    deadline = began + from_seconds(home_deadline_seconds());
    stands_ = false;
    port_->start_home();  // a lost acknowledgement shows in the positions
    return true;
  };
  while (!sent()) {
    if (clock_->now() > deadline)
      throw TimeoutError(
          fmt::format("axis {}: not homed: the controller is still busy with another axis", name_));
    clock_->sleep_for(from_seconds(timing_.poll));
  }
  Time last_change = clock_->now();
  bool seen_ended = false;
  for (;;) {
    clock_->sleep_for(from_seconds(timing_.poll));
    throw_if_stopped(generation);
    AxisStatus<Q> status;
    try {
      status = port_->status(deadline);
    } catch (const GaveWay&) {
      continue;
    }
    const Time now = clock_->now();
    check_trouble(status, 0.0);
    if (status.position) {
      if (abs(*status.position - start).value > farthest)
        throw DeviceError(fmt::format(
            "axis {}: homing has gone from {} to {}, farther than the stage is long ({:g} {}), and "
            "not found the switch. Check it, and the pulses per revolution.",
            name_, shown(start), shown(*status.position), home_span(), Q::unit()));
      const bool unchanged = same_pulse(*status.position, last);
      if (!unchanged) {
        last = *status.position;
        last_change = now;
      }
      if (status.motion == Motion::kEnded && unchanged && seen_ended) break;
      seen_ended = status.motion == Motion::kEnded;
      // Without the controller's word, a counter at 0 is no proof: a reset leaves it there too.
      if (now - last_change > from_seconds(stall_seconds()) && status.motion != Motion::kEnded)
        throw TimeoutError(
            fmt::format("axis {}: stands still at {} without being reported as homed. Check the "
                        "home switch, and for an obstacle, an emergency stop or a reset; then home "
                        "it again.",
                        name_, shown(last)));
    }
    if (now > deadline)
      throw TimeoutError(
          fmt::format("axis {}: home not found within {:.0f} s. Check the home switch.", name_,
                      seconds(deadline - began)));
  }
  const bool counts_anew = [&] {
    const auto lock = port_->lock();
    throw_if_stopped(generation);
    return port_->count_from_home();
  }();
  if (counts_anew) {
    const AxisStatus<Q> there = heeded_status();
    check_trouble(there, 0.0);
    last = *there.position;
  }
  if (!within(last, Q{0.0}))
    throw DeviceError(
        fmt::format("axis {}: homing ended at {}, expected 0. Check the home switch and the "
                    "controller's origin.",
                    name_, shown(last)));
  const auto lock = port_->lock();
  throw_if_stopped(generation);
  phase_ = Phase::kIdle;
  left_at_ = last;
  stands_ = true;
  lost_because_.clear();
  homed_ = true;
}

// ---- stopping

template <class Q>
void MotionAxis<Q>::begin_stop() {
  ++stops_;
  const InterruptShield shield;
  guarded(stops_, [&] { port_->send_stop(false); });
}

template <class Q>
void MotionAxis<Q>::finish_stop() {
  const InterruptShield shield;
  guarded(stops_, [&] {
    bool immediate = false, fault = false;
    const auto read = [&] {
      const AxisStatus<Q> status = heeded_status();
      fault = fault || !status.fault.empty();
      return status;
    };
    Q last = *read().position;
    Time since = clock_->now();
    const double slowest = std::min({config_.initial_speed, config_.home_speed, config_.speed});
    const Time halted =
        from_seconds(std::max(kHalted_s, slowest > 0 ? 2 * config_.per_step() / slowest : 0.0));
    const auto time_to_halt = [&] {
      return clock_->now() + from_seconds(1.2 * config_.speed / config_.acceleration +
                                          3 * timing_.poll + timing_.reply_timeout);
    };
    Time deadline = time_to_halt();
    while (clock_->now() - since < halted) {
      clock_->sleep_for(from_seconds(kHaltPoll_s));
      const AxisStatus<Q> status = read();
      const Q here = *status.position;
      if (same_pulse(here, last) && status.motion != Motion::kMoving) continue;
      last = here;
      since = clock_->now();
      if (since <= deadline) continue;
      if (immediate)
        throw DeviceError(fmt::format(
            "axis {}: still moves (at {}) after being told to stop. USE THE EMERGENCY STOP.", name_,
            shown(here)));
      immediate = true;
      port_->send_stop(true);
      deadline = time_to_halt();
    }
    const auto lock = port_->lock();
    // An open-loop axis that is halted without a ramp loses steps.
    if (phase_ == Phase::kHoming || immediate || fault || odd_place(last)) homed_ = false;
    phase_ = Phase::kIdle;
    left_at_ = last;
    stands_ = true;
    approach_known_ = false;
  });
}

template <class Q>
void MotionAxis<Q>::stop() {
  begin_stop();
  finish_stop();
}

template class MotionAxis<Millimetres>;
template class MotionAxis<Degrees>;

}  // namespace turntable
