// One motor axis with its table, as functions of time, in the axis' unit (mm or deg). Two
// coordinates:
//
//   counter   what the controller counts: whole pulses from its reference; 0 at power-up
//   true      where the table is, from the home switch
//
//   motor m(t):  trapezoidal profile, initial speed v0 -> speed v with acceleration a -> v0
//   true = m + play + worm + error
//     play    0 while driven forwards, `backlash` while driven backwards, between the two after a
//     reversal worm    amplitude * (sin(2 pi m / period + phase) - sin(phase)), period = one motor
//     revolution error   drawn per arrival, standard deviation repeatability / 2; carried over
//     linearly during a move
//
// Homing ends with a slow forward approach of the switch at m = 0 and sets the counter to 0 there,
// unless the controller counts on. Where the controller says so it decelerates from there, and stands beyond its own zero.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>

#include "src/core/clock.h"
#include "src/core/rig_file.h"

namespace turntable::sim {

/// Speeds of a move, unit/s and unit/s^2.
struct Ramp {
  double initial_speed{}, speed{}, acceleration{};
};

/// A move along a line from rest to rest; starts and ends at the initial speed, as steppers do.
class Trapezoid {
 public:
  Trapezoid() = default;
  /// @param distance >= 0.
  Trapezoid(double distance, Ramp ramp);
  /// From `speed` down to a halt, over a whole number of `grid`.
  static Trapezoid braking(double speed, Ramp ramp, double grid);
  /// The same profile with a little more or less to go at its highest speed.
  Trapezoid over(double distance) const {
    Trapezoid other = *this;
    other.distance_ = distance;
    other.finish();
    return other;
  }

  double distance_at(double t) const;  ///< travelled after `t` s, >= 0
  double speed_at(double t) const;
  double distance() const { return distance_; }
  double duration() const { return duration_; }

 private:
  void finish();

  double distance_ = 0, initial_ = 0, peak_ = 0, acceleration_ = 1;
  double up_s_ = 0, down_s_ = 0, duration_ = 0;
};

class AxisModel {
 public:
  enum class Jam { kNone, kPulses, kTable };

  AxisModel(const AxisConfig& config, const AxisTruth& truth, std::uint64_t seed);

  // What the controller's electronics do. Times must not go backwards.
  /// Begins a move to `target` (counter, unit), to the nearest pulse. The profile stops at a hard
  /// limit.
  void move_to(Time now, double target, Ramp ramp);
  /// Finds the home switch: quickly past it, back, and slowly onto it.
  /// @param overshoot where it comes to a halt after the switch was seen, from there; negative if
  /// the slow approach is a backward one. 0 = on the switch.
  /// @param then where it goes on to, from the switch, before the homing has ended.
  /// @param zeroes false: the counter goes on counting, and is whatever it has counted at the end.
  void home(Time now, Ramp ramp, double overshoot = 0, std::optional<double> then = {},
            bool zeroes = true);
  /// Decelerates and halts; `immediate` halts on the spot.
  /// @param within_s how long that takes from any speed, if it is not the acceleration that counts.
  void stop(Time now, bool immediate = false, std::optional<double> within_s = {});
  /// Lets the present position count as `value`.
  void set_counter(Time now, double value);
  /// Power cycle: halts on the spot, counter 0, nothing referenced.
  void power_cycle(Time now);
  /// A limit switch comes on in the way: halts on the spot; the switch stays on until the axis moves
  /// the other way or is homed. Does nothing to an axis that stands.
  void hit_switch(Time now);
  /// kPulses: nothing moves any more and no move ends. kTable: the controller counts on, the table
  /// stays.
  void jam(Time now, Jam jam);

  double counter_position(Time t) const;
  bool moving(Time t) const;
  /// When the present motion ends; nothing if there is none or it never ends.
  std::optional<Time> ends_at() const;
  bool at_hard_limit(Time t) const;
  bool lower_switch(Time t) const { return switch_ < 0 || motor_at(t) <= hard_lower_; }
  bool upper_switch(Time t) const { return switch_ > 0 || motor_at(t) >= hard_upper_; }
  bool home_switch(Time t) const { return std::abs(motor_at(t)) < 0.5 * per_step_; }
  bool homed(Time t) const;

  /// Where the table really is. @param t not before the last command.
  double true_position(Time t) const;

  const AxisConfig& config() const { return config_; }
  double per_step() const { return per_step_; }
  std::uint64_t moves() const { return moves_; }
  /// How far the counter has been on moves (not on the way home), since the last homing.
  double lowest(Time t) const {
    return on_move_ ? std::min(lowest_, counter_position(t)) : lowest_;
  }
  double highest(Time t) const {
    return on_move_ ? std::max(highest_, counter_position(t)) : highest_;
  }
  /// Ends of the mechanics, true coordinate.
  double hard_lower() const { return hard_lower_; }
  double hard_upper() const { return hard_upper_; }

 private:
  struct Leg {
    Time begin{0};
    double from = 0, to = 0;  ///< motor
    Trapezoid profile;
    Time end() const;
    double at(Time t) const;
  };
  struct Mechanics {
    double motor = 0, play = 0;
  };

  void freeze(Time now);
  void add_leg(Time begin, double from, double to, Ramp ramp);
  const Leg& leg_at(Time t) const;
  double clipped(double motor) const;
  double motor_at(Time t) const;
  Mechanics mechanics_at(Time t) const;
  double error_at(Time t) const;
  double draw() const;
  double worm(double motor) const;

  AxisConfig config_;
  AxisTruth truth_;
  std::uint64_t seed_;
  std::string stream_;
  double per_step_, worm_period_, worm_phase_;
  double hard_lower_, hard_upper_;

  std::array<Leg, 3> legs_;
  int leg_count_ = 0;
  Mechanics rest_;                     ///< at the beginning of the legs
  double error_ = 0, next_error_ = 0;  ///< at their beginning and at their end
  double counter_zero_ = 0;            ///< motor position that counts as 0
  Ramp ramp_;
  bool homing_ = false, homed_ = false;
  bool zeroes_ = true;  ///< the homing that is under way or was the last one
  bool never_ends_ = false;
  std::uint64_t moves_ = 0;
  Jam jam_ = Jam::kNone;
  double blocked_true_ = 0;
  int switch_ = 0;        ///< a limit switch that is on: -1 lower, 1 upper
  bool on_move_ = false;  ///< the last motion was a move, not a homing
  double lowest_ = 0, highest_ = 0;
};

}  // namespace turntable::sim
