// A simulated controller: device models behind a wire format, at the far end of a line. What goes
// wrong on a wire or with a stage goes wrong in the same way for all of them, and is here; a
// simulator says how its requests look and what they mean.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "drivers/sim/axis_model.h"
#include "drivers/sim/faults.h"
#include "protocols/line.h"
#include "src/core/clock.h"
#include "src/core/rig_file.h"

namespace turntable::sim {

/// What a simulator is made from.
struct SimulatorSetup {
  std::vector<AxisConfig> axes;       ///< those on this controller, as it is set up at power-up
  std::map<AxisId, AxisTruth> truth;  ///< missing = ideal
  std::uint64_t seed = 0;
  ControllerConfig controller{};  ///< address, outputs, and what its manual leaves open
  /// Between a request and its answer; missing = as the device takes.
  std::optional<double> reply_delay_s{};
};

/// Keeps its state while clients come and go, as a controller does while its cable is plugged and
/// unplugged.
class ControllerSimulator : public Actor {
 public:
  /// A request as a person would tell of it.
  struct Request {
    std::string verb;  ///< the device's word
    std::string kind;  ///< "move", "home", "stop", "status", "set", "get"; "reset": a power cycle
    std::optional<AxisId> axis{};  ///< that it names
    Time at{0};                    ///< when it came
    double counter = 0;            ///< of the axis that it names, then
  };

  /// Takes the far end of a line; drops the one it had.
  void plug(Line line);
  void unplug();
  bool plugged() const { return line_.has_value() || bus_; }
  /// Makes it one of several on a bus, which hands it what the master sends (`hear`) and takes what it
  /// answers.
  void join_bus(std::function<void(std::string_view answer, Time)> answers) {
    bus_ = std::move(answers);
  }
  /// @param silence how long the bus had been silent before.
  void hear(std::string_view bytes, Time now, Time silence);
  /// True while an answer is being made: whoever talks then talks into it.
  bool answering() const { return answers_due_ > 0; }
  /// The answers that are being made are lost.
  void interrupt_answers() { ++interruptions_; }
  const Line* line() const { return line_ ? &*line_ : nullptr; }

  void add_fault(Fault fault) { faults_.push_back({std::move(fault), 0}); }
  /// @throws std::out_of_range if the axis is not on this controller.
  const AxisModel& axis(AxisId id) const;
  /// A person releases the emergency stop and resets the alarms.
  void clear_trouble();
  /// A mechanic frees axes that are stuck.
  void mend();
  /// Told when a digital output of the rig file is switched.
  void on_output(std::function<void(const std::string& name, bool on, Time)> listener) {
    output_listener_ = std::move(listener);
  }
  /// From now on every request is noted, whatever becomes of it.
  void note_requests() { note_requests_ = true; }
  const std::vector<Request>& requests() const { return requests_; }

  int descriptor() const final { return line_ ? line_->descriptor() : -1; }
  std::optional<Time> next_due() const final;
  void act(Time now) final;

 protected:
  explicit ControllerSimulator(const SimulatorSetup& setup);

  // ---- What a simulator supplies.

  /// Bytes have arrived; find the requests in them and `serve` each.
  virtual void receive(std::string_view bytes, Time now) = 0;
  /// Does what is due by itself: completion lines and the like.
  virtual void happen(Time) {}
  /// When that will be, beside the events of `later`.
  virtual std::optional<Time> next_own() const { return std::nullopt; }
  /// Everything volatile is gone. The axes have been reset already.
  virtual void power_up(Time now) = 0;
  /// What a refusal looks like. @param text as in the fault.
  virtual std::string refusal(const std::string& text) = 0;
  /// What the device takes for the answer to the present request, unless the set-up says otherwise.
  virtual Time own_reply_delay() { return Time{0}; }
  /// The line of the rig that was pulled took half a request with it.
  virtual void forget_input() = 0;

  // ---- What it may use.

  std::vector<std::unique_ptr<AxisModel>>& axes() { return axes_; }
  const std::vector<std::unique_ptr<AxisModel>>& axes() const { return axes_; }
  const ControllerConfig& config() const { return config_; }
  Time now() const { return now_; }
  /// How long the line had been silent before the bytes that are being received.
  Time silence() const { return silence_; }
  bool emergency_stop() const { return emergency_stop_; }
  bool alarm(AxisId id) const { return alarms_.contains(id); }
  /// Clears the alarm of one axis, where the controller has a command for that.
  void clear_alarm(AxisId id) { alarms_.erase(id); }
  void switch_output(const std::string& name, bool on) {
    if (output_listener_) output_listener_(name, on, now_);
  }

  /// Carries a request out and answers it, with the faults that strike it. @param carry_out does
  /// what it asks for; @return the bytes of the answer, empty = none now.
  /// @param error makes the answer of a kErrorReply fault.
  void serve(Request request, Time now, const std::function<std::string()>& carry_out,
             const std::function<std::string(const std::string&)>& error);
  void serve(Request request, Time now, const std::function<std::string()>& carry_out) {
    serve(std::move(request), now, carry_out, [this](const std::string& t) { return refusal(t); });
  }
  /// Said by `carry_out`: the answer follows when the axis has done what it was asked for, by
  /// `send_deferred`. What would have spoilt the answer spoils that.
  void defer_answer(AxisId id) { deferred_to_ = id; }
  void send_deferred(AxisId id, std::string bytes);
  /// True once for every kLostCompletion that struck a request naming this axis.
  bool loses_completion(AxisId id) { return lost_completions_.erase(id) > 0; }
  /// Bytes that answer nothing, now.
  void send(std::string_view bytes);
  void later(Time due, std::function<void(Time)> action);

 private:
  struct Armed {
    Fault fault;
    int seen = 0;
  };
  struct Event {
    Time due;
    std::function<void(Time)> happen;
  };

  AxisModel* model(std::optional<AxisId> id);
  void reset(Time now);
  Time reply_delay() { return reply_delay_s_ ? from_seconds(*reply_delay_s_) : own_reply_delay(); }
  void answer(std::string bytes, Time now);
  void answer_at(Time due, std::string bytes);
  void write(std::string_view bytes);
  void flood(Time now);
  void answer(std::string bytes, const std::optional<Fault>& fault, Time now);

  ControllerConfig config_;
  std::optional<double> reply_delay_s_;
  Time last_answer_{0};  ///< when it is due
  std::vector<std::unique_ptr<AxisModel>> axes_;
  std::optional<Line> line_;
  std::vector<Armed> faults_;
  std::vector<Event> events_;  // earliest first
  std::set<AxisId> alarms_, lost_completions_;
  std::optional<AxisId> deferred_to_;        ///< by the request that is being carried out
  std::map<AxisId, Fault> deferred_faults_;  ///< of answers that are still to come
  bool emergency_stop_ = false;
  bool flooded_ = false;
  std::function<void(const std::string&, bool, Time)> output_listener_;
  bool note_requests_ = false;
  std::vector<Request> requests_;
  std::function<void(std::string_view, Time)> bus_;
  int answers_due_ = 0;
  unsigned interruptions_ = 0;
  Time now_{0};
  Time silence_{Time::max()};
  std::optional<Time> last_byte_;  ///< heard or said
  std::minstd_rand noise_;
};

}  // namespace turntable::sim
