// Axes and a camera without devices, for tests of what drives a rig: they move at a constant speed
// on a manual clock, note what was asked of them, and fail when told to.
#pragma once

#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/core/rig.h"

namespace turntable {

template <class Q>
class FakeAxis final : public Axis<Q> {
 public:
  FakeAxis(std::string name, Clock& clock, double lower, double upper)
      : name_(std::move(name)), clock_(clock), limits_{{lower}, {upper}} {}

  const std::string& name() const override { return name_; }
  AxisLimits<Q> limits() const override { return limits_; }
  void check(Q target) const override {
    if (target < limits_.lower || target > limits_.upper)
      throw LimitError(name_ + " outside limits");
  }
  bool homed() const override { return homed_; }
  void home() override {
    clock_.sleep_for(from_seconds(2.0));
    homed_ = true;
    position_ = Q{0.0};
  }
  void start(Q target) override {
    check(target);
    if (!homed_) throw DeviceError(name_ + " is not homed");
    starts.push_back(target.value);
    target_ = target;
    due_ = clock_.now() + from_seconds(move_seconds(position_, target));
  }
  bool advance() override {
    if (!target_) throw std::logic_error(name_ + " is advanced without a move");
    if (on_advance) on_advance();
    if (clock_.now() < due_) return false;
    position_ = *target_ + Q{miss};
    arrival_ = {position_, *target_, miss != 0.0, miss != 0.0 ? 2 : 0, false};
    target_.reset();
    return true;
  }
  Arrival<Q> arrival() const override { return arrival_; }
  Q position() override { return position_; }
  double move_seconds(Q from, Q to) const override { return abs(to - from).value / 10.0; }
  void stop() override {
    throw_if_stopping_now();  // the way out must be shielded
    ++stops;
    target_.reset();
  }
  bool moving() const { return target_.has_value(); }

  std::vector<double> starts;
  int stops = 0;
  double miss = 0.0;
  std::function<void()> on_advance;

 private:
  std::string name_;
  Clock& clock_;
  AxisLimits<Q> limits_;
  bool homed_ = false;
  Q position_{};
  std::optional<Q> target_;
  Time due_{0};
  Arrival<Q> arrival_{};
};

class FakeCamera final : public Camera {
 public:
  FakeCamera(Clock& clock, Image image) : clock_(clock), image_(std::move(image)) {}
  std::string identity() const override { return "fake camera"; }
  ImageSize image_size() const override { return image_.size(); }
  void check(std::span<const Exposure> exposures) const override {
    if (on_check) on_check(exposures);
  }
  bool exposes() const override { return exposing; }
  void announce(const Exposure& exposure) override { announced.push_back(exposure); }
  Frame trigger() override {
    ++triggers;
    if (on_trigger) on_trigger();
    if (timeouts > 0) {
      --timeouts;
      clock_.sleep_for(from_seconds(0.5));
      throw TimeoutError("no frame within 0.5 s");
    }
    clock_.sleep_for(from_seconds(0.02));
    return {image_, ++id_, clock_.now()};
  }
  void show(Image image) { image_ = std::move(image); }

  Frame try_out() override {
    ++try_outs;
    return {image_, 0, clock_.now()};
  }

  bool exposing = true;
  int triggers = 0;
  int try_outs = 0;
  int timeouts = 0;  ///< so many triggers from now on stay unanswered
  std::function<void()> on_trigger;
  std::function<void(std::span<const Exposure>)> on_check;
  std::vector<Exposure> announced;

 private:
  Clock& clock_;
  Image image_;
  std::uint64_t id_ = 0;
};

/// A whole rig of fakes.
struct FakeRig {
  explicit FakeRig(Image image)
      : stage("stage", clock, -1, 200),
        yaw("yaw", clock, -90, 90),
        roll("roll", clock, -45, 45),
        pitch("pitch", clock, -45, 45),
        camera(clock, std::move(image)) {
    rig.clock = &clock;
    rig.stage = &stage;
    rig.yaw = &yaw;
    rig.roll = &roll;
    rig.pitch = &pitch;
    rig.camera = &camera;
    rig.simulated = true;
    rig.identities = {"fake controller"};
    rig.mount = [this](Payload payload) { mounts.push_back(payload); };
  }
  int stops() const { return stage.stops + yaw.stops + roll.stops + pitch.stops; }
  bool moving() const { return stage.moving() || yaw.moving() || roll.moving() || pitch.moving(); }

  ManualClock clock;
  FakeAxis<Millimetres> stage;
  FakeAxis<Degrees> yaw, roll, pitch;
  FakeCamera camera;
  std::vector<Payload> mounts;
  Rig rig;
};

}  // namespace turntable
