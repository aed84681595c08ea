#include "drivers/axis_controller.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "src/core/interrupt.h"

namespace turntable {
namespace {

constexpr double kReplyTimeout_s = 1.0;  // of a controller that is opened without the catalogue

}  // namespace

/// A channel's axis, without its unit.
class AxisController::Port {
 public:
  virtual ~Port() = default;
  virtual void trust_reference() = 0;
  virtual void forbid() = 0;
  virtual void begin_stop() = 0;
  virtual void finish_stop() = 0;
};

/// Turns the motion loop's millimetres or degrees into the driver's pulses.
template <class Q>
class AxisController::ChannelAxis final : public Port, public AxisPort<Q> {
 public:
  ChannelAxis(AxisController& controller, std::size_t index, MotionTiming timing)
      : controller_(&controller),
        index_(index),
        scale_{{channel().config.per_step()}},
        axis_(channel().config, *this, *controller.clock_, timing) {}

  Axis<Q>* axis() { return &axis_; }
  void trust_reference() override { axis_.trust_reference(); }
  void forbid() override { axis_.forbid(); }
  void begin_stop() override { axis_.begin_stop(); }
  void finish_stop() override { axis_.finish_stop(); }

  std::unique_lock<std::recursive_mutex> lock() override { return controller_->lock(); }
  void require_ready() const override { controller_->require_ready(); }
  bool free() override { return controller_->free(channel()); }
  Acknowledgement start_move(Q from, Q to) override {
    return controller_->start_move(channel(), scale_.to_steps(from), scale_.to_steps(to));
  }
  Acknowledgement start_home() override { return controller_->start_home(channel()); }
  AxisStatus<Q> status(Time deadline) override {
    AxisStatus<Steps> raw = controller_->status(channel(), deadline);
    AxisStatus<Q> status;
    if (raw.position) status.position = scale_.from_steps(*raw.position);
    status.motion = raw.motion;
    status.lower_limit = raw.lower_limit;
    status.upper_limit = raw.upper_limit;
    status.fault = std::move(raw.fault);
    return status;
  }
  void send_stop(bool immediate) override { controller_->stop_channel(channel(), immediate); }

 private:
  const Channel& channel() const { return controller_->channels_[index_]; }

  AxisController* controller_;
  std::size_t index_;
  StepScale<Q> scale_;
  MotionAxis<Q> axis_;
};

AxisController::AxisController(ControllerSetup& setup)
    : config_(std::move(setup.controller)), clock_(setup.clock) {
  if (config_.reply_timeout_s <= 0) config_.reply_timeout_s = kReplyTimeout_s;
  for (AxisConfig& axis : setup.axes) {
    for (const Channel& other : channels_)
      if (other.config.channel == axis.channel)
        throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(axis.id)),
                          fmt::format("channel {} is already taken by {}.", axis.channel,
                                      axis_name(other.config.id)));
    channels_.push_back({std::move(axis), channels_.size()});
  }
  MotionTiming timing;
  timing.reply_timeout = config_.reply_timeout_s;
  for (const Channel& channel : channels_) {
    if (channel.config.kind == StageKind::kLinear)
      ports_.push_back(std::make_unique<ChannelAxis<Millimetres>>(*this, channel.index, timing));
    else
      ports_.push_back(std::make_unique<ChannelAxis<Degrees>>(*this, channel.index, timing));
  }
}

AxisController::~AxisController() = default;

template <class Q>
Axis<Q>* AxisController::find(AxisId id) {
  for (const Channel& channel : channels_)
    if (channel.config.id == id)
      if (auto* axis = dynamic_cast<ChannelAxis<Q>*>(ports_[channel.index].get()))
        return axis->axis();
  return nullptr;
}

Axis<Millimetres>* AxisController::linear_axis(AxisId id) { return find<Millimetres>(id); }
Axis<Degrees>* AxisController::rotary_axis(AxisId id) { return find<Degrees>(id); }

std::string AxisController::identity() const {
  const auto guard = lock();
  std::vector<std::string_view> names;
  for (const Channel& channel : channels_) names.push_back(channel.config.channel);
  return fmt::format("{} \"{}\" on {}, channels {}{}{}", config_.model, config_.name, line_name(),
                     fmt::join(names, " "), details_.empty() ? "" : ": ", details_);
}

std::string AxisController::where(const Channel& channel) const {
  return fmt::format("axis {} (channel {} of {} on {})", axis_name(channel.config.id),
                     channel.config.channel, config_.name, line_name());
}

std::string AxisController::difference(const Channel& channel, const std::string& what,
                                       const std::string& wanted, const std::string& found) {
  return fmt::format("{}: {}: wanted {}, found {}", axis_name(channel.config.id), what, wanted,
                     found);
}

std::vector<std::string> AxisController::connect() {
  const auto guard = lock();
  connected_ = false;
  std::vector<std::string> differences;
  details_ = observe(differences);
  differences_ = std::move(differences);
  connected_ = true;
  return differences_;
}

void AxisController::configure() {
  const auto guard = lock();
  write_setup();
  if (!connect().empty()) require_ready();
}

void AxisController::require_ready() const {
  const auto guard = lock();
  if (!connected_)
    throw DeviceError(
        fmt::format("controller {} on {}: not connected yet", config_.name, line_name()));
  if (!differences_.empty())
    throw DeviceError(
        fmt::format("controller {} on {} is set up differently from the rig file, so nothing will "
                    "be moved:\n  {}\nCorrect the rig file, or let the controller be configured "
                    "from it.",
                    config_.name, line_name(), fmt::join(differences_, "\n  ")));
}

void AxisController::trust_reference(AxisId id) {
  const auto guard = lock();
  for (const Channel& channel : channels_) {
    if (channel.config.id != id) continue;
    if (!may_be_homed(channel))
      throw DeviceError(fmt::format(
          "{}: the controller says that it has not been homed since it was switched on. Home it.",
          where(channel)));
    ports_[channel.index]->trust_reference();
  }
}

void AxisController::pulse_output(const std::string& name) {
  const auto output = std::ranges::find(config_.outputs, name, &OutputConfig::name);
  if (output == config_.outputs.end())
    throw ConfigError("rig", fmt::format("/controllers/{}/outputs", config_.name),
                      fmt::format("has no output \"{}\".", name));
  const auto switched = [&](bool on) {
    const auto guard = lock();
    switch_output(*output, on);
  };
  try {
    switched(true);
    clock_->sleep_for(from_seconds(output->pulse_s));
  } catch (...) {  // whatever ends it, the output does not stay on
    const InterruptShield shield;
    try {
      switched(false);
    } catch (const Error&) {  // the first error says more
    }
    throw;
  }
  switched(false);
}

char AxisController::letter(const Channel& channel) {
  const char c = channel.config.channel.front();
  return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
}

void AxisController::require_letters(std::string_view letters) const {
  for (const Channel& channel : channels_) {
    const std::string pointer = fmt::format("/axes/{}/channel", axis_name(channel.config.id));
    if (channel.config.channel.size() != 1 || letters.find(letter(channel)) == letters.npos)
      throw ConfigError("rig", pointer,
                        fmt::format("found \"{}\", allowed on {}: {}.", channel.config.channel,
                                    config_.model, fmt::join(letters, ", ")));
    for (const Channel& other : channels_)
      if (other.index < channel.index && letter(other) == letter(channel))
        throw ConfigError("rig", pointer,
                          fmt::format("channel {} is already taken by {}.", channel.config.channel,
                                      axis_name(other.config.id)));
  }
}

void AxisController::require_outputs(bool as_text) const {
  for (const OutputConfig& output : config_.outputs)
    if (output.register_at.has_value() == as_text)
      throw ConfigError(
          "rig", fmt::format("/controllers/{}/outputs/{}", config_.name, output.name),
          fmt::format("{} is switched by {}. State that.", config_.model,
                      as_text ? "lines of text: \"on\" and \"off\" as strings"
                              : "a holding register: \"register\", \"on\" and \"off\" as numbers"));
}

void AxisController::stop_channel(const Channel& channel, bool immediate) {
  struct Waiting {
    std::atomic<int>& count;
    explicit Waiting(std::atomic<int>& c) : count(c) { ++count; }
    ~Waiting() { --count; }
  } const waiting(stops_waiting_);
  const auto guard = lock();
  struct Stopping {
    std::atomic<bool>& flag;
    explicit Stopping(std::atomic<bool>& f) : flag(f) { flag = true; }
    ~Stopping() { flag = false; }
  } const stopping(stopping_);
  send_stop(channel, immediate);
}

void AxisController::forbid_all() {
  for (const auto& port : ports_) port->forbid();
}

/// Every axis is told before any is told again: a drive that does not answer must not keep the
/// others waiting.
void AxisController::begin_stop_all() {
  std::vector<Port*> again;
  once_ = true;
  for (const auto& port : ports_) try {
      port->begin_stop();
    } catch (const Error&) {
      again.push_back(port.get());
    }
  once_ = false;
  Attempts tried;
  for (Port* port : again) tried([&] { port->begin_stop(); });
  tried.rethrow();
}

void AxisController::finish_stop_all() {
  Attempts tried;
  for (const auto& port : ports_) tried([&] { port->finish_stop(); });
  tried.rethrow();
}

void AxisController::require_no_stop(const Channel& channel) const {
  if (gives_way())
    throw GaveWay(
        fmt::format("{}: a motion gave way to a stop. Nothing was sent.", where(channel)));
}

}  // namespace turntable
