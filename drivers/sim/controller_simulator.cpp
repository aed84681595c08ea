#include "drivers/sim/controller_simulator.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <stdexcept>

#include "src/core/errors.h"

namespace turntable::sim {
namespace {

using namespace std::string_view_literals;

constexpr std::string_view kNoise = "\x7f\x01#@!\r";

constexpr std::array kFaultNames{
    std::pair{FaultKind::kSilence, "silence"sv},
    std::pair{FaultKind::kLostReply, "lost_reply"sv},
    std::pair{FaultKind::kGarbage, "garbage"sv},
    std::pair{FaultKind::kCorruptReply, "corrupt_reply"sv},
    std::pair{FaultKind::kTruncatedReply, "truncated_reply"sv},
    std::pair{FaultKind::kSplitReply, "split_reply"sv},
    std::pair{FaultKind::kLateReply, "late_reply"sv},
    std::pair{FaultKind::kDuplicatedLine, "duplicated_reply"sv},
    std::pair{FaultKind::kLostCompletion, "lost_completion"sv},
    std::pair{FaultKind::kErrorReply, "error_reply"sv},
    std::pair{FaultKind::kReset, "reset"sv},
    std::pair{FaultKind::kStuckAxis, "stuck_axis"sv},
    std::pair{FaultKind::kBlockedTable, "blocked_table"sv},
    std::pair{FaultKind::kUnplugged, "unplugged"sv},
    std::pair{FaultKind::kLimitHit, "limit_hit"sv},
    std::pair{FaultKind::kAlarm, "alarm"sv},
    std::pair{FaultKind::kEmergencyStop, "emergency_stop"sv},
    std::pair{FaultKind::kFlood, "flood"sv},
};

bool same_word(std::string_view a, std::string_view b) {
  return std::ranges::equal(a, b, [](char x, char y) {
    return std::tolower(static_cast<unsigned char>(x)) ==
           std::tolower(static_cast<unsigned char>(y));
  });
}

}  // namespace

std::string_view fault_name(FaultKind kind) {
  return std::ranges::find(kFaultNames, kind, [](const auto& row) { return row.first; })->second;
}

std::optional<FaultKind> fault_from_name(std::string_view name) {
  for (const auto& [kind, word] : kFaultNames)
    if (word == name) return kind;
  return std::nullopt;
}

std::span<const FaultKind> all_faults() {
  static constexpr auto kKinds = [] {
    std::array<FaultKind, kFaultNames.size()> kinds{};
    for (std::size_t i = 0; i < kinds.size(); ++i) kinds[i] = kFaultNames[i].first;
    return kinds;
  }();
  return kKinds;
}

ControllerSimulator::ControllerSimulator(const SimulatorSetup& setup)
    : config_(setup.controller), reply_delay_s_(setup.reply_delay_s) {
  for (const AxisConfig& axis : setup.axes) {
    const auto truth = setup.truth.find(axis.id);
    axes_.push_back(std::make_unique<AxisModel>(
        axis, truth == setup.truth.end() ? AxisTruth{} : truth->second, setup.seed));
  }
}

const AxisModel& ControllerSimulator::axis(AxisId id) const {
  for (const auto& axis : axes_)
    if (axis->config().id == id) return *axis;
  throw std::out_of_range(fmt::format("no axis {} on this controller", axis_name(id)));
}

AxisModel* ControllerSimulator::model(std::optional<AxisId> id) {
  for (const auto& axis : axes_)
    if (axis->config().id == id) return axis.get();
  return nullptr;
}

void ControllerSimulator::plug(Line line) {
  unplug();
  line_.emplace(std::move(line));
}

void ControllerSimulator::unplug() {
  if (!line_) return;
  line_.reset();
  forget_input();
}

void ControllerSimulator::clear_trouble() {
  emergency_stop_ = false;
  alarms_.clear();
}

void ControllerSimulator::mend() {
  for (const auto& axis : axes_) axis->jam(now_, AxisModel::Jam::kNone);
}

// ---- time

std::optional<Time> ControllerSimulator::next_due() const {
  std::optional<Time> next = next_own();
  if (!events_.empty() && (!next || events_.front().due < *next)) next = events_.front().due;
  return next;
}

void ControllerSimulator::act(Time now) {
  now_ = now;
  while (!events_.empty() && events_.front().due <= now) {
    const Event event = std::move(events_.front());
    events_.erase(events_.begin());
    event.happen(now);
  }
  happen(now);
  std::array<char, 512> buffer;
  while (line_) {
    std::size_t n = 0;
    try {
      n = line_->read_available(buffer, now);
    } catch (const LineError&) {
      unplug();
      return;
    }
    if (n == 0) return;
    silence_ = last_byte_ ? now - *last_byte_ : Time::max();
    last_byte_ = now;
    receive({buffer.data(), n}, now);
  }
}

void ControllerSimulator::later(Time due, std::function<void(Time)> action) {
  const auto place = std::ranges::upper_bound(events_, due, {}, &Event::due);
  events_.insert(place, {due, std::move(action)});
}

// ---- bytes

void ControllerSimulator::hear(std::string_view bytes, Time now, Time silence) {
  now_ = now;
  silence_ = silence;
  receive(bytes, now);
}

void ControllerSimulator::send(std::string_view bytes) {
  if (bytes.empty()) return;
  last_byte_ = now_;
  if (bus_) return bus_(bytes, now_);
  write(bytes);
}

void ControllerSimulator::write(std::string_view bytes) {
  if (!line_) return;
  try {
    line_->write_available(bytes, now_);  // a wire without flow control loses what nobody reads
  } catch (const LineError&) {
    unplug();
  }
}

/// Comes from an adapter or a cable and not from the controller, which hears its master all the while.
void ControllerSimulator::flood(Time now) {
  constexpr std::size_t kBytes = 64;  // in a millisecond
  std::string noise;
  for (std::size_t i = 0; i < kBytes; ++i) noise += static_cast<char>(noise_());
  write(noise);
  flooded_ = line_.has_value();
  if (flooded_) later(now + std::chrono::milliseconds{1}, [this](Time t) { flood(t); });
}

void ControllerSimulator::answer(std::string bytes, Time now) {
  const Time delay = reply_delay();
  if (delay == Time{0}) return send(bytes);
  last_answer_ = std::max(last_answer_, now + delay);  // one after the other
  answer_at(last_answer_, std::move(bytes));
}

void ControllerSimulator::answer_at(Time due, std::string bytes) {
  if (bytes.empty()) return;
  ++answers_due_;
  later(due, [this, text = std::move(bytes), interruptions = interruptions_](Time) {
    --answers_due_;
    if (interruptions == interruptions_) send(text);
  });
}

// ---- faults

void ControllerSimulator::reset(Time now) {
  for (const auto& axis : axes_) axis->power_cycle(now);
  lost_completions_.clear();
  deferred_faults_.clear();
  alarms_.clear();
  forget_input();
  power_up(now);
}

void ControllerSimulator::serve(Request request, Time now,
                                const std::function<std::string()>& carry_out,
                                const std::function<std::string(const std::string&)>& error) {
  AxisModel* named = model(request.axis);
  request.at = now;
  if (named != nullptr) request.counter = named->counter_position(now);
  if (note_requests_) requests_.push_back(request);

  // Which faults strike this request?
  std::optional<Fault> reply_fault;
  std::optional<std::string> forced;
  for (Armed& armed : faults_) {
    const Fault& fault = armed.fault;
    if (!fault.verb.empty() && !same_word(fault.verb, request.verb) &&
        !same_word(fault.verb, request.kind))
      continue;
    ++armed.seen;
    if (armed.seen < fault.nth || (fault.times >= 0 && armed.seen >= fault.nth + fault.times))
      continue;
    const Time due = now + from_seconds(fault.delay_s);
    const auto to_axis = [&](auto action) {
      if (named != nullptr) later(due, [named, action](Time t) { action(*named, t); });
    };
    switch (fault.kind) {
      case FaultKind::kSilence:
        return;
      case FaultKind::kErrorReply:
        forced = error(fault.text);
        break;
      case FaultKind::kLostCompletion:
        if (named != nullptr) lost_completions_.insert(*request.axis);
        break;
      case FaultKind::kReset:
        later(due, [this](Time t) {
          if (note_requests_) requests_.push_back({.verb = "", .kind = "reset", .at = t});
          reset(t);
        });
        break;
      case FaultKind::kStuckAxis:
        to_axis([](AxisModel& axis, Time t) { axis.jam(t, AxisModel::Jam::kPulses); });
        break;
      case FaultKind::kBlockedTable:
        to_axis([](AxisModel& axis, Time t) { axis.jam(t, AxisModel::Jam::kTable); });
        break;
      case FaultKind::kLimitHit:
        to_axis([](AxisModel& axis, Time t) { axis.hit_switch(t); });
        break;
      case FaultKind::kAlarm:
        to_axis([this](AxisModel& axis, Time t) {
          axis.stop(t, true);
          alarms_.insert(axis.config().id);
        });
        break;
      case FaultKind::kEmergencyStop:
        later(due, [this](Time t) {
          emergency_stop_ = true;
          for (const auto& axis : axes_) axis->stop(t, true);
        });
        break;
      case FaultKind::kUnplugged:
        later(due, [this](Time) { unplug(); });
        break;
      case FaultKind::kFlood:
        later(due, [this](Time t) {
          if (!flooded_) flood(t);  // a line can be no fuller
        });
        break;
      default:
        reply_fault = fault;
    }
  }

  deferred_to_.reset();
  std::string reply = forced ? *forced : carry_out();
  if (!deferred_to_) return answer(std::move(reply), reply_fault, now);
  deferred_faults_.erase(*deferred_to_);
  if (reply_fault) deferred_faults_.emplace(*deferred_to_, *reply_fault);
}

void ControllerSimulator::send_deferred(AxisId id, std::string bytes) {
  std::optional<Fault> fault;
  if (const auto node = deferred_faults_.extract(id)) fault = node.mapped();
  answer(std::move(bytes), fault, now_);
}

void ControllerSimulator::answer(std::string reply, const std::optional<Fault>& fault, Time now) {
  if (!fault || reply.empty()) return answer(std::move(reply), now);
  const Time due = now + reply_delay() + from_seconds(fault->delay_s);
  const std::string half = reply.substr(0, reply.size() / 2), rest = reply.substr(reply.size() / 2);
  switch (fault->kind) {
    case FaultKind::kGarbage:
      answer(fault->text.empty() ? std::string(kNoise) : fault->text, now);
      return answer(reply, now);
    case FaultKind::kCorruptReply:
      reply[reply.size() / 2] = static_cast<char>(reply[reply.size() / 2] ^ 0x15);
      return answer(reply, now);
    case FaultKind::kTruncatedReply:
      return answer(half, now);
    case FaultKind::kSplitReply:
      answer(half, now);
      return answer_at(due, rest);
    case FaultKind::kLateReply:
      return answer_at(due, reply);
    case FaultKind::kDuplicatedLine:
      answer(reply, now);
      return answer(reply, now);
    default:
      return;  // kLostReply
  }
}

}  // namespace turntable::sim
