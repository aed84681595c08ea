#include "protocols/shared_line.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>

#include "src/core/errors.h"

namespace turntable {

struct SharedLine::State {
  std::function<Line()> open;
  std::optional<Line> line;  ///< nothing after `open` has failed
  std::string name;
  std::recursive_mutex mutex;
  std::atomic<int> stops_waiting{0};
  std::atomic<bool> stopping{false};
  Time silence{0};
  std::atomic<unsigned> times_opened{1};
  std::optional<Time> unanswered_since;
  std::optional<bool> echoes;
};

SharedLine::SharedLine(Line line) : state_(std::make_shared<State>()) {
  state_->name = line.name();
  state_->line.emplace(std::move(line));
}

SharedLine::SharedLine(std::function<Line()> open) : SharedLine(open()) {
  state_->open = std::move(open);
}

const std::string& SharedLine::name() const { return state_->name; }

Line& SharedLine::line() const {
  if (!state_->line)
    throw LineError(fmt::format("{}: closed, and could not be opened again.", state_->name));
  return *state_->line;
}

std::unique_lock<std::recursive_mutex> SharedLine::lock() const {
  return std::unique_lock(state_->mutex);
}

SharedLine::Stop::Stop(const SharedLine& line) : line_(line) {
  ++line_.state_->stops_waiting;
  lock_ = line_.lock();
  line_.state_->stopping = true;
}

SharedLine::Stop::~Stop() {
  line_.state_->stopping = false;
  --line_.state_->stops_waiting;
}

bool SharedLine::gives_way() const { return state_->stops_waiting > 0 && !state_->stopping; }

void SharedLine::want_silence(Time least) const {
  const auto turn = lock();
  state_->silence = std::max(state_->silence, least);
}

std::optional<Time> SharedLine::last_byte() const {
  return state_->line ? state_->line->last_byte() : std::nullopt;
}

/// Of a line that has just been opened nobody knows who spoke last.
void SharedLine::await_silence(Clock& clock) const {
  if (state_->silence > Time{0})
    clock.sleep_until(last_byte().value_or(clock.now()) + state_->silence);
}

bool SharedLine::can_reopen() const { return static_cast<bool>(state_->open); }

void SharedLine::reopen() const {
  if (!can_reopen()) throw LineError(fmt::format("{}: cannot be opened again.", state_->name));
  state_->line.reset();  // a serial server takes one client at a time
  state_->line.emplace(state_->open());
  ++state_->times_opened;
  state_->unanswered_since.reset();
  state_->echoes.reset();
}

unsigned SharedLine::times_opened() const { return state_->times_opened; }
std::optional<Time> SharedLine::unanswered_since() const { return state_->unanswered_since; }
void SharedLine::set_unanswered(std::optional<Time> since) const {
  state_->unanswered_since = since;
}
std::optional<bool> SharedLine::echoes() const { return state_->echoes; }
void SharedLine::set_echoes(bool echoes) const { state_->echoes = echoes; }

}  // namespace turntable
