#include "drivers/axis_controller.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "src/core/interrupt.h"

namespace turntable {
namespace {

constexpr double kReplyTimeout_s = 1.0;  // of a controller that is opened without the catalogue
// Serial servers are seen to close a connection after 20 s to some minutes without traffic.
constexpr Time kKeptAlive = std::chrono::seconds{5};

}  // namespace

/// A channel's axis, without its unit.
class AxisController::Port {
 public:
  virtual ~Port() = default;
  virtual void trust_reference() = 0;
  virtual bool stands() const = 0;
  virtual void forbid() = 0;
  virtual void begin_stop() = 0;
  virtual void finish_stop() = 0;
};

/// What may be said again, on a line that was perhaps closed since it was last used.
template <class F>
auto AxisController::on_open_line(F&& exchange) {
  try {
    {
      const auto guard = lock();
      notice_reopening();
    }
    return exchange();
  } catch (const LineError& closed) {
    const auto guard = lock();
    connect_again(closed);
    notice_reopening();
  }
  return exchange();
}

/// Turns the motion loop's millimetres or degrees into the driver's pulses.
template <class Q>
class AxisController::ChannelAxis final : public Port, public AxisPort<Q> {
 public:
  ChannelAxis(AxisController& controller, std::size_t index, MotionTiming timing)
      : controller_(&controller),
        index_(index),
        scale_{{channel().config.per_step()}},
        sign_(channel().config.reversed ? -1.0 : 1.0),
        axis_(controller_side(channel().config), *this, *controller.clock_, timing) {}

  Axis<Q>* axis() { return &axis_; }
  void trust_reference() override { axis_.trust_reference(); }
  bool stands() const override { return axis_.stands(); }
  void forbid() override { axis_.forbid(); }
  void begin_stop() override { axis_.begin_stop(); }
  void finish_stop() override { axis_.finish_stop(); }

  std::unique_lock<std::recursive_mutex> lock() override { return controller_->lock(); }
  void require_ready() const override { controller_->require_ready(); }
  bool free() override {
    return controller_->on_open_line([&] { return controller_->free(channel()); });
  }
  Acknowledgement start_move(Q from, Q to) override {
    return controller_->start_move(channel(), scale_.to_steps(sign_ * from),
                                   scale_.to_steps(sign_ * to));
  }
  Acknowledgement start_home() override { return controller_->start_home(channel()); }
  bool count_from_home() override { return controller_->count_from_home(channel()); }
  AxisStatus<Q> status(Time deadline) override {
    AxisStatus<Steps> raw =
        controller_->on_open_line([&] { return controller_->status(channel(), deadline); });
    AxisStatus<Q> status;
    if (raw.position) status.position = sign_ * scale_.from_steps(*raw.position);
    status.motion = raw.motion;
    status.lower_limit = sign_ > 0 ? raw.lower_limit : raw.upper_limit;
    status.upper_limit = sign_ > 0 ? raw.upper_limit : raw.lower_limit;
    status.fault = std::move(raw.fault);
    return status;
  }
  void send_stop(bool immediate) override { controller_->stop_channel(channel(), immediate); }

 private:
  const Channel& channel() const { return controller_->channels_[index_]; }

  AxisController* controller_;
  std::size_t index_;
  StepScale<Q> scale_;
  double sign_;  ///< of the controller's count against the axis
  MotionAxis<Q> axis_;
};

AxisController::AxisController(ControllerSetup& setup)
    : config_(std::move(setup.controller)),
      clock_(setup.clock),
      line_(std::move(setup.line)),
      opened_(line_.times_opened()) {
  if (config_.reply_timeout_s <= 0) config_.reply_timeout_s = kReplyTimeout_s;
  for (AxisConfig& axis : setup.axes) {
    for (const Channel& other : channels_)
      if (other.config.channel == axis.channel)
        throw ConfigError("rig", fmt::format("/axes/{}/channel", axis_name(axis.id)),
                          fmt::format("channel {} is already taken by {}.", axis.channel,
                                      axis_name(other.config.id)));
    channels_.push_back({controller_side(axis), channels_.size()});
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
  std::vector<std::string> names;
  for (const Channel& channel : channels_) {
    const std::string& name = channel.config.channel;
    names.push_back(name.find(' ') == name.npos ? name : fmt::format("\"{}\"", name));
  }
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
  opened_ = line_.times_opened();
  std::vector<std::string> differences;
  details_ = observe(differences);
  differences_ = std::move(differences);
  connected_ = true;
  if (differences_.empty() && positions_are_absolute())
    for (const auto& port : ports_) port->trust_reference();
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
    if (!on_open_line([&] { return may_be_homed(channel); }))
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
  keep_alive();  // a pulse may not be given twice
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

/// A stop is the one command that is worth a new connection while something moves.
void AxisController::stop_channel(const Channel& channel, bool immediate) {
  const SharedLine::Stop stopping(line_);
  try {
    send_stop(channel, immediate);
  } catch (const LineError&) {
    if (!line_.can_reopen()) throw;
    line_.reopen();
    send_stop(channel, immediate);
  }
}

// ---- a line that was closed

/// After the line was opened again, by whomever, the device may be another one or have been switched
/// off meanwhile: nothing is believed before its set-up has been compared anew. Positions are compared
/// by each axis before it starts.
void AxisController::notice_reopening() {
  if (!connected_ || opened_ == line_.times_opened()) return;
  if (const auto differences = connect(); !differences.empty())
    throw DeviceError(fmt::format(
        "controller {} on {}: the line was closed and opened again, and now the controller is set "
        "up "
        "differently from the rig file, so nothing will be moved:\n  {}\nIt may have been switched "
        "off and on meanwhile. Let it be configured from the rig file, and home its axes.",
        config_.name, line_name(), fmt::join(differences, "\n  ")));
}

/// Opens the line again, unless an axis of this controller moves: then the run has to end, and the
/// stop opens the line for itself.
void AxisController::connect_again(const LineError& why) {
  const auto moves = [](const auto& port) { return !port->stands(); };
  if (!line_.can_reopen() || std::ranges::any_of(ports_, moves)) throw;
  try {
    line_.reopen();
  } catch (const Error& again) {
    throw LineError(fmt::format("{} It could not be opened again: {} No axis was moving.",
                                why.what(), again.what()));
  }
}

void AxisController::keep_alive() {
  try {
    const auto guard = lock();
    if (!connected_ || !line_.can_reopen() || channels_.empty()) return;
    if (const auto last = line_.last_byte(); last && clock_->now() - *last < kKeptAlive) return;
    on_open_line([&] { return status(channels_.front(), clock_->now() + reply_timeout()); });
  } catch (const Interrupted&) {
    throw;
  } catch (const Error&) {  // whoever moves next will hear of it
  }
}

void AxisController::forbid_all() {
  for (const auto& port : ports_) port->forbid();
}

/// Every axis is told before any is told again: a drive that does not answer must not keep the
/// others waiting. Whether an axis heard it is for `finish_stop_all` to see.
void AxisController::begin_stop_all() {
  not_told_.assign(ports_.size(), nullptr);
  for (const bool again : {false, true}) {
    once_ = !again;
    for (std::size_t i = 0; i < ports_.size(); ++i) {
      if (again && !not_told_[i]) continue;
      try {
        not_told_[i] = nullptr;
        ports_[i]->begin_stop();
      } catch (const Error&) {
        not_told_[i] = std::current_exception();
      }
    }
  }
}

/// An axis that is seen to stand has stopped, whether it acknowledged that or not. One that was seen to
/// stand before, and was told nothing since, stands although its controller cannot be reached any more.
void AxisController::finish_stop_all() {
  Attempts tried;
  for (std::size_t i = 0; i < ports_.size(); ++i) try {
      ports_[i]->finish_stop();
    } catch (const Error& e) {
      const bool silent =
          dynamic_cast<const LineError*>(&e) != nullptr || dynamic_cast<const TimeoutError*>(&e);
      if (silent && ports_[i]->stands()) continue;
      tried([&] {
        if (i < not_told_.size() && not_told_[i]) std::rethrow_exception(not_told_[i]);
        throw;
      });
    }
  tried.rethrow();
}

void AxisController::require_no_stop(const Channel& channel) const {
  if (gives_way())
    throw GaveWay(
        fmt::format("{}: a motion gave way to a stop. Nothing was sent.", where(channel)));
}

}  // namespace turntable
