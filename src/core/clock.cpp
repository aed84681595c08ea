#include "src/core/clock.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <poll.h>
#include <time.h>

#include <algorithm>
#include <thread>

#include "src/core/interrupt.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

// A wait is cut into slices so that an urgent stop is seen soon whichever thread got the signal.
constexpr milliseconds kSlice{20};

/// Linux' monotonic clock stands still while the computer sleeps; its boot-time clock does not.
Time time_asleep() {
  const auto read = [](clockid_t clock) {
    timespec t{};
    ::clock_gettime(clock, &t);
    return std::chrono::seconds{t.tv_sec} + std::chrono::nanoseconds{t.tv_nsec};
  };
  // They are read one after the other, and this program may have to wait between the two.
  for (int attempt = 1;; ++attempt) {
    const Time before = read(CLOCK_MONOTONIC), asleep = read(CLOCK_BOOTTIME) - before;
    if (read(CLOCK_MONOTONIC) - before < milliseconds{1} || attempt == 100) return asleep;
  }
}

bool readable(int fd, milliseconds wait) {
  pollfd p{fd, POLLIN, 0};
  return fd >= 0 && ::poll(&p, 1, static_cast<int>(wait.count())) > 0;
}

}  // namespace

SystemClock::SystemClock(double speed)
    : start_(std::chrono::steady_clock::now()), asleep_at_start_(time_asleep()), speed_(speed) {}

Time SystemClock::asleep() const {
  constexpr Time kLeast = milliseconds{100};  // no sleep is that short
  const Time wall = time_asleep() - asleep_at_start_;
  return wall < kLeast ? Time{0} : from_seconds(speed_ * seconds(wall));
}

Time SystemClock::now() const {
  const Time wall = std::chrono::steady_clock::now() - start_;
  return speed_ == 1.0 ? wall : from_seconds(speed_ * seconds(wall));
}

milliseconds SystemClock::slice_of(Time wait) const {
  const Time wall = speed_ == 1.0 ? wait : from_seconds(seconds(wait) / speed_);
  return std::clamp(std::chrono::ceil<milliseconds>(wall), milliseconds{0}, kSlice);
}

bool SystemClock::wait_readable(int fd, Time deadline) {
  for (;;) {
    const Time left = deadline - now();
    if (readable(fd, slice_of(left))) return true;
    if (left <= Time{0}) return false;
    throw_if_stopping_now();
  }
}

void SystemClock::sleep_until(Time deadline) {
  while (now() < deadline) {
    std::this_thread::sleep_for(slice_of(deadline - now()));
    throw_if_stopping_now();
  }
}

Time ManualClock::now() const { return now_.load(); }

void ManualClock::settle() {
  std::vector<pollfd> watched;
  std::optional<std::chrono::steady_clock::time_point> waiting_since;
  for (bool busy = true; busy;) {
    busy = false;
    watched.clear();
    for (const Actor* actor : actors_) watched.push_back({actor->descriptor(), POLLIN, 0});
    ::poll(watched.data(), watched.size(), 0);
    for (std::size_t i = 0; i < actors_.size(); ++i) {
      const auto due = actors_[i]->next_due();
      if ((watched[i].revents & POLLIN) == 0 && !(due && *due <= now())) continue;
      actors_[i]->act(now_);
      busy = true;
    }
    if (busy || !in_flight_ || !in_flight_()) continue;
    const auto wall = std::chrono::steady_clock::now();
    if (!waiting_since) waiting_since = wall;
    busy = wall - *waiting_since < std::chrono::seconds{1};
    std::this_thread::sleep_for(std::chrono::microseconds{20});
  }
}

bool ManualClock::wait_readable(int fd, Time deadline) {
  const std::lock_guard lock(mutex_);
  for (;;) {
    settle();
    if (readable(fd, milliseconds{0})) return true;
    const Time now = now_;
    if (now >= deadline) return false;
    throw_if_stopping_now();
    Time next = deadline;
    for (const Actor* actor : actors_)
      if (const auto due = actor->next_due()) next = std::min(next, std::max(*due, now));
    now_ = next;
  }
}

void ManualClock::sleep_until(Time deadline) { wait_readable(-1, deadline); }

void ManualClock::set_in_flight(std::function<bool()> in_flight) {
  const std::lock_guard lock(mutex_);
  in_flight_ = std::move(in_flight);
}

void ManualClock::attach(Actor& actor) {
  const std::lock_guard lock(mutex_);
  actors_.push_back(&actor);
}

void ManualClock::detach(Actor& actor) {
  const std::lock_guard lock(mutex_);
  std::erase(actors_, &actor);
}

void serve(SystemClock& clock, const std::vector<Actor*>& actors) {
  while (interrupt_level() == 0) {
    std::vector<pollfd> watched;
    Time next = Time::max();
    for (const Actor* actor : actors) {
      watched.push_back({actor->descriptor(), POLLIN, 0});
      if (const auto due = actor->next_due()) next = std::min(next, *due);
    }
    const milliseconds wait = clock.slice_of(next - clock.now());
    ::poll(watched.data(), watched.size(), static_cast<int>(wait.count()));
    const std::vector<Actor*> present = actors;  // acting may add to the list
    for (std::size_t i = 0; i < present.size(); ++i) {
      const auto due = present[i]->next_due();
      if (watched[i].revents != 0 || (due && *due <= clock.now())) present[i]->act(clock.now());
    }
  }
}

std::string utc_now() {
  const auto now = std::chrono::system_clock::now();
  const auto ms = std::chrono::duration_cast<milliseconds>(now.time_since_epoch()).count() % 1000;
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z",
                     fmt::gmtime(std::chrono::system_clock::to_time_t(now)), ms);
}

std::string utc_now_compact() {
  return fmt::format(
      "{:%Y%m%dT%H%M%SZ}",
      fmt::gmtime(std::chrono::system_clock::to_time_t(std::chrono::system_clock::now())));
}

}  // namespace turntable
