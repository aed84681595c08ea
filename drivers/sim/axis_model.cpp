#include "drivers/sim/axis_model.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "src/core/random.h"
#include "src/core/stage_spec.h"

namespace turntable::sim {
namespace {

constexpr double kTwoPi = 2.0 * std::numbers::pi;

/// Limit switches stand a little outside the travel that the data sheet promises.
constexpr double kSwitchMargin = 0.01;

struct Travel {
  double lower, upper;
};

Travel mechanical_travel(const AxisConfig& config) {
  const StageSpec* spec = find_stage_spec(config.stage_model);
  const double lower = spec != nullptr ? std::min(spec->travel_lower, config.lower) : config.lower;
  const double upper = spec != nullptr ? std::max(spec->travel_upper, config.upper) : config.upper;
  const double margin = kSwitchMargin * (upper - lower);
  return {lower - margin, upper + margin};
}

}  // namespace

Trapezoid::Trapezoid(double distance, Ramp ramp)
    : distance_(distance),
      initial_(std::min(ramp.initial_speed, ramp.speed)),
      peak_(ramp.speed),
      acceleration_(ramp.acceleration) {
  const double both_ramps = (peak_ * peak_ - initial_ * initial_) / acceleration_;
  if (distance_ < both_ramps) peak_ = std::sqrt(initial_ * initial_ + acceleration_ * distance_);
  up_s_ = down_s_ = (peak_ - initial_) / acceleration_;
  finish();
}

Trapezoid Trapezoid::braking(double speed, Ramp ramp, double grid) {
  Trapezoid t;
  t.initial_ = std::min(ramp.initial_speed, speed);
  t.peak_ = speed;
  t.acceleration_ = ramp.acceleration;
  t.down_s_ = (t.peak_ - t.initial_) / t.acceleration_;
  const double ramp_distance = 0.5 * (t.peak_ + t.initial_) * t.down_s_;
  t.distance_ = std::ceil(ramp_distance / grid - 1e-6) * grid;
  t.finish();
  return t;
}

void Trapezoid::finish() {
  const double ramps = 0.5 * (peak_ + initial_) * (up_s_ + down_s_);
  const double cruise = std::max(0.0, distance_ - ramps);
  duration_ = up_s_ + down_s_ + (cruise > 0 ? cruise / peak_ : 0.0);
}

double Trapezoid::distance_at(double t) const {
  if (t <= 0) return 0;
  if (t >= duration_) return distance_;
  if (t < up_s_) return t * (initial_ + 0.5 * acceleration_ * t);
  const double left = duration_ - t;
  if (left < down_s_)
    return std::max(0.0, distance_ - left * (initial_ + 0.5 * acceleration_ * left));
  return 0.5 * (peak_ + initial_) * up_s_ + peak_ * (t - up_s_);
}

double Trapezoid::speed_at(double t) const {
  if (t < 0 || t >= duration_) return 0;
  if (t < up_s_) return initial_ + acceleration_ * t;
  const double left = duration_ - t;
  return left < down_s_ ? initial_ + acceleration_ * left : peak_;
}

AxisModel::AxisModel(const AxisConfig& config, const AxisTruth& truth, std::uint64_t seed)
    : config_(config),
      truth_(truth),
      seed_(seed),
      stream_(std::string(axis_name(config.id)) + " repeatability"),
      per_step_(config.per_step()),
      worm_period_(config.kind == StageKind::kRotary ? 360.0 / config.drive_ratio : config.lead_mm),
      worm_phase_(
          Random(seed, std::string(axis_name(config.id)) + " worm phase").uniform(0, kTwoPi)) {
  const Travel travel = mechanical_travel(config);
  hard_lower_ = travel.lower;
  hard_upper_ = travel.upper;
  rest_.motor = clipped(truth.home_offset);
  counter_zero_ = rest_.motor;
  error_ = next_error_ = draw();
}

// ---- what the electronics do

void AxisModel::move_to(Time now, double target, Ramp ramp) {
  freeze(now);
  const double pulses = std::round(target / per_step_);
  ramp_ = ramp;
  if (jam_ == Jam::kPulses) {
    never_ends_ = true;
    return;
  }
  const double to = clipped(counter_zero_ + pulses * per_step_);
  if ((to - rest_.motor) * switch_ < 0) switch_ = 0;
  on_move_ = true;
  add_leg(now, rest_.motor, to, ramp);
}

void AxisModel::home(Time now, Ramp ramp, double overshoot, std::optional<double> then,
                     bool zeroes) {
  freeze(now);
  zeroes_ = zeroes;
  homed_ = false;
  on_move_ = false;
  switch_ = 0;
  ramp_ = ramp;
  if (jam_ == Jam::kPulses) {
    never_ends_ = true;
    return;
  }
  homing_ = true;
  const double past = std::max({0.1 * ramp.speed, 20 * per_step_, 2 * std::abs(overshoot)});
  const double beyond = clipped(overshoot < 0 ? past : -past);
  add_leg(now, rest_.motor, beyond, ramp);
  const Ramp slow{overshoot == 0 ? ramp.initial_speed : 0.0, ramp.initial_speed, ramp.acceleration};
  const auto pulses = [&](double v) { return std::round(v / per_step_) * per_step_; };
  const double halt = clipped(pulses(overshoot));
  add_leg(legs_[0].end(), beyond, halt, slow);
  if (then)
    add_leg(legs_[1].end(), halt, clipped(pulses(*then)), {0.0, ramp.speed, ramp.acceleration});
}

void AxisModel::stop(Time now, bool immediate, std::optional<double> within_s) {
  never_ends_ = false;
  if (!moving(now)) return;
  const Leg& leg = leg_at(now);
  const double speed = leg.profile.speed_at(seconds(now - leg.begin));
  const double direction = leg.to < leg.from ? -1.0 : 1.0;
  freeze(now);
  // Pulses are whole: a halt is always on the grid.
  const double on_grid =
      counter_zero_ + (direction > 0
                           ? std::ceil((rest_.motor - counter_zero_) / per_step_ - 1e-6)
                           : std::floor((rest_.motor - counter_zero_) / per_step_ + 1e-6)) *
                          per_step_;
  if (within_s) ramp_ = {0.0, speed, speed / *within_s};
  // Too slow for a ramp: what the profile has left is less than a pulse.
  if (immediate || speed * speed <= 2 * ramp_.acceleration * per_step_) {
    rest_.motor = on_grid;
    return;
  }
  const Trapezoid braking = Trapezoid::braking(speed, ramp_, per_step_);
  const double to = clipped(on_grid + direction * braking.distance());
  legs_[0] = {now, rest_.motor, to, braking.over(std::abs(to - rest_.motor))};
  leg_count_ = 1;
  ++moves_;
  next_error_ = draw();
}

void AxisModel::hit_switch(Time now) {
  if (!moving(now) || never_ends_) return;
  const Leg& leg = leg_at(now);
  const int side = leg.to < leg.from ? -1 : 1;
  stop(now, true);
  switch_ = side;
}

void AxisModel::set_counter(Time now, double value) {
  freeze(now);
  const double by = value - (rest_.motor - counter_zero_);
  lowest_ += by;
  highest_ += by;
  counter_zero_ = rest_.motor - value;
}

void AxisModel::power_cycle(Time now) {
  freeze(now);
  never_ends_ = false;
  homed_ = false;
  counter_zero_ = rest_.motor;
}

void AxisModel::jam(Time now, Jam jam) {
  if (jam == Jam::kTable) blocked_true_ = true_position(now);
  if (jam == Jam::kPulses && moving(now)) {
    freeze(now);
    never_ends_ = true;
  }
  jam_ = jam;
}

/// What has happened up to `now` becomes the past.
void AxisModel::freeze(Time now) {
  const bool was_moving = moving(now);
  const Mechanics here = mechanics_at(now);
  error_ = next_error_ = error_at(now);
  if (homing_ && !was_moving) {
    homed_ = true;
    if (zeroes_) counter_zero_ = 0;
    lowest_ = highest_ = here.motor - counter_zero_;
  } else if (on_move_ && leg_count_ > 0) {
    lowest_ = std::min(lowest_, here.motor - counter_zero_);
    highest_ = std::max(highest_, here.motor - counter_zero_);
  }
  homing_ = false;
  rest_ = here;
  leg_count_ = 0;
}

void AxisModel::add_leg(Time begin, double from, double to, Ramp ramp) {
  const double distance = std::abs(to - from);
  const std::size_t index = static_cast<std::size_t>(leg_count_++);
  legs_[index] = {begin, from, to, Trapezoid(distance, ramp)};
  if (distance > 0 && index == 0) {
    ++moves_;
    next_error_ = draw();
  }
}

// ---- functions of time

const AxisModel::Leg& AxisModel::leg_at(Time t) const {
  std::size_t i = 0;
  while (i + 1 < static_cast<std::size_t>(leg_count_) && t >= legs_[i].end()) ++i;
  return legs_[i];
}

double AxisModel::clipped(double motor) const {
  return std::clamp(motor, hard_lower_, hard_upper_);
}

Time AxisModel::Leg::end() const { return begin + from_seconds(profile.duration()); }

double AxisModel::Leg::at(Time t) const {
  if (t >= end()) return to;
  const double way = profile.distance_at(seconds(t - begin));
  return to < from ? from - way : from + way;
}

std::optional<Time> AxisModel::ends_at() const {
  if (never_ends_ || leg_count_ == 0) return std::nullopt;
  return legs_[static_cast<std::size_t>(leg_count_ - 1)].end();
}

bool AxisModel::moving(Time t) const {
  if (never_ends_) return true;
  const auto end = ends_at();
  return end && t < *end;
}

bool AxisModel::homed(Time t) const { return homing_ ? !moving(t) : homed_; }

double AxisModel::motor_at(Time t) const {
  double motor = rest_.motor;
  for (int i = 0; i < leg_count_; ++i)
    if (const Leg& leg = legs_[static_cast<std::size_t>(i)]; t >= leg.begin) motor = leg.at(t);
  return motor;
}

AxisModel::Mechanics AxisModel::mechanics_at(Time t) const {
  Mechanics m = rest_;
  for (int i = 0; i < leg_count_; ++i) {
    const Leg& leg = legs_[static_cast<std::size_t>(i)];
    if (t < leg.begin) break;
    const double motor = leg.at(t);
    m.play = std::clamp(m.play - (motor - m.motor), 0.0, truth_.backlash);
    m.motor = motor;
  }
  return m;
}

double AxisModel::error_at(Time t) const {
  if (next_error_ == error_) return error_;
  double way = 0, gone = 0;
  for (int i = 0; i < leg_count_; ++i) {
    const Leg& leg = legs_[static_cast<std::size_t>(i)];
    way += std::abs(leg.to - leg.from);
    if (t >= leg.begin) gone += std::abs(leg.at(t) - leg.from);
  }
  return way > 0 ? error_ + (next_error_ - error_) * gone / way : error_;
}

double AxisModel::counter_position(Time t) const {
  const double zero = homing_ && zeroes_ && !moving(t) ? 0.0 : counter_zero_;
  const double value = std::round((motor_at(t) - zero) / per_step_) * per_step_;
  return value == 0.0 ? 0.0 : value;  // never -0
}

bool AxisModel::at_hard_limit(Time t) const {
  const double motor = motor_at(t);
  return motor <= hard_lower_ || motor >= hard_upper_;
}

double AxisModel::true_position(Time t) const {
  if (jam_ == Jam::kTable) return blocked_true_;
  const Mechanics m = mechanics_at(t);
  return m.motor + m.play + worm(m.motor) + error_at(t);
}

double AxisModel::draw() const {
  if (truth_.repeatability == 0.0) return 0.0;
  return 0.5 * truth_.repeatability * Random(seed_, stream_, moves_).normal();
}

double AxisModel::worm(double motor) const {
  if (truth_.worm_amplitude == 0.0) return 0.0;
  return truth_.worm_amplitude *
         (std::sin(kTwoPi * motor / worm_period_ + worm_phase_) - std::sin(worm_phase_));
}

}  // namespace turntable::sim
