#include "src/core/clock.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <functional>
#include <string>
#include <thread>

#include "src/core/errors.h"
#include "src/core/interrupt.h"

namespace turntable {
namespace {

using namespace std::chrono_literals;

struct Pair {
  int ours = -1, theirs = -1;
  Pair() {
    int fds[2];
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, fds) != 0)
      throw LineError("no socket pair");
    ours = fds[0];
    theirs = fds[1];
  }
  ~Pair() {
    ::close(ours);
    if (theirs >= 0) ::close(theirs);
  }
  Pair(const Pair&) = delete;
  Pair& operator=(const Pair&) = delete;

  void send(const std::string& text) const {
    ASSERT_GT(::write(ours, text.data(), text.size()), 0);
  }
  std::string receive() const {
    char buffer[256];
    const ssize_t n = ::read(ours, buffer, sizeof buffer);
    return n > 0 ? std::string(buffer, static_cast<std::size_t>(n)) : std::string();
  }
};

/// A device that repeats every byte after a time of its own.
class Echo final : public Actor {
 public:
  Echo(int fd, Time delay) : fd_(fd), delay_(delay) {}
  int descriptor() const override { return fd_; }
  std::optional<Time> next_due() const override { return due_; }
  void act(Time now) override {
    char buffer[256];
    const ssize_t n = ::read(fd_, buffer, sizeof buffer);
    if (n > 0) {
      pending_.append(buffer, static_cast<std::size_t>(n));
      if (!due_) due_ = now + delay_;
    }
    if (due_ && *due_ <= now) {
      acted_at_ = now;
      if (::write(fd_, pending_.data(), pending_.size()) < 0) ADD_FAILURE() << "write failed";
      pending_.clear();
      due_.reset();
    }
  }
  Time acted_at() const { return acted_at_; }

 private:
  int fd_;
  Time delay_;
  std::string pending_;
  std::optional<Time> due_;
  Time acted_at_{-1};
};

/// Ticks by itself.
class Ticker final : public Actor {
 public:
  explicit Ticker(Time period) : period_(period), due_(period) {}
  int descriptor() const override { return -1; }
  std::optional<Time> next_due() const override { return due_; }
  void act(Time now) override {
    EXPECT_EQ(now, due_) << "time jumped over a tick";
    ++ticks_;
    due_ += period_;
    if (on_tick) on_tick();
  }
  int ticks() const { return ticks_; }
  std::function<void()> on_tick;

 private:
  Time period_, due_;
  int ticks_ = 0;
};

class Interrupts : public ::testing::Test {
 protected:
  void SetUp() override { set_interrupt_level(0); }
  void TearDown() override { set_interrupt_level(0); }
};
using ManualClockTest = Interrupts;
using SystemClockTest = Interrupts;

TEST_F(ManualClockTest, sleeping_moves_time_and_takes_none) {
  ManualClock clock;
  const auto wall = std::chrono::steady_clock::now();
  clock.sleep_for(24h);
  EXPECT_EQ(clock.now(), 24h);
  EXPECT_LT(std::chrono::steady_clock::now() - wall, 1s);
}

TEST_F(ManualClockTest, a_deadline_in_the_past_does_not_turn_time_back) {
  ManualClock clock;
  clock.sleep_for(5s);
  clock.sleep_until(2s);
  EXPECT_EQ(clock.now(), 5s);
  Pair pair;
  EXPECT_FALSE(clock.wait_readable(pair.ours, 1s));
  EXPECT_EQ(clock.now(), 5s);
}

TEST_F(ManualClockTest, an_answer_arrives_at_the_time_the_actor_takes_for_it) {
  ManualClock clock;
  Pair pair;
  Echo echo(pair.theirs, 250ms);
  clock.attach(echo);
  clock.sleep_for(1s);
  pair.send("ping");
  ASSERT_TRUE(clock.wait_readable(pair.ours, 10s));
  EXPECT_EQ(clock.now(), 1250ms);
  EXPECT_EQ(echo.acted_at(), 1250ms);
  EXPECT_EQ(pair.receive(), "ping");
}

TEST_F(ManualClockTest, a_late_answer_is_a_timeout_exactly_at_the_deadline) {
  ManualClock clock;
  Pair pair;
  Echo echo(pair.theirs, 2s);
  clock.attach(echo);
  pair.send("ping");
  EXPECT_FALSE(clock.wait_readable(pair.ours, 500ms));
  EXPECT_EQ(clock.now(), 500ms);
  EXPECT_TRUE(clock.wait_readable(pair.ours, 3s));
  EXPECT_EQ(clock.now(), 2s);
}

TEST_F(ManualClockTest, an_answer_due_at_the_deadline_still_counts) {
  ManualClock clock;
  Pair pair;
  Echo echo(pair.theirs, 500ms);
  clock.attach(echo);
  pair.send("ping");
  EXPECT_TRUE(clock.wait_readable(pair.ours, 500ms));
}

TEST_F(ManualClockTest, actors_are_visited_at_every_time_they_ask_for) {
  ManualClock clock;
  Ticker fast(10ms), slow(25ms);
  clock.attach(fast);
  clock.attach(slow);
  clock.sleep_until(1s);
  EXPECT_EQ(fast.ticks(), 100);
  EXPECT_EQ(slow.ticks(), 40);
}

TEST_F(ManualClockTest, a_detached_actor_is_left_alone) {
  ManualClock clock;
  Ticker ticker(10ms);
  clock.attach(ticker);
  clock.sleep_until(100ms);
  clock.detach(ticker);
  clock.sleep_until(1s);
  EXPECT_EQ(ticker.ticks(), 10);
}

TEST_F(ManualClockTest, a_peer_that_is_gone_ends_the_wait) {
  ManualClock clock;
  Pair pair;
  ::close(pair.theirs);
  pair.theirs = -1;
  EXPECT_TRUE(clock.wait_readable(pair.ours, 10s));
  EXPECT_EQ(clock.now(), 0s);
  EXPECT_EQ(pair.receive(), "");
}

TEST_F(ManualClockTest, the_same_dialogue_takes_the_same_time_twice) {
  const auto dialogue = [] {
    ManualClock clock;
    Pair pair;
    Echo echo(pair.theirs, 37ms);
    Ticker ticker(5ms);
    clock.attach(echo);
    clock.attach(ticker);
    std::vector<Time> times;
    for (int i = 0; i < 20; ++i) {
      pair.send("x");
      EXPECT_TRUE(clock.wait_readable(pair.ours, clock.now() + 1s));
      pair.receive();
      times.push_back(clock.now());
      clock.sleep_for(3ms);
    }
    return times;
  };
  EXPECT_EQ(dialogue(), dialogue());
}

TEST_F(ManualClockTest, an_urgent_interrupt_ends_a_wait_unless_shielded) {
  ManualClock clock;
  Ticker ticker(10ms);
  ticker.on_tick = [&] {
    if (ticker.ticks() == 3) set_interrupt_level(2);
  };
  clock.attach(ticker);
  EXPECT_THROW(clock.sleep_until(1s), Interrupted);
  EXPECT_EQ(clock.now(), 30ms);
  const InterruptShield shield;
  EXPECT_NO_THROW(clock.sleep_until(1s));
}

TEST_F(ManualClockTest, serves_several_threads_and_time_never_goes_back) {
  ManualClock clock;
  Ticker ticker(1ms);
  clock.attach(ticker);
  const auto wait_in_steps = [&] {
    Time last{0};
    for (int i = 0; i < 200; ++i) {
      clock.sleep_for(1ms);
      const Time now = clock.now();
      EXPECT_GE(now, last);
      last = now;
    }
  };
  std::thread other(wait_in_steps);
  wait_in_steps();
  other.join();
  EXPECT_GE(clock.now(), 200ms);
  EXPECT_EQ(ticker.ticks(), clock.now() / 1ms);
}

TEST_F(SystemClockTest, waits_for_bytes_and_for_deadlines) {
  SystemClock clock;
  Pair pair;
  const Time before = clock.now();
  EXPECT_FALSE(clock.wait_readable(pair.ours, before + 30ms));
  EXPECT_GE(clock.now() - before, 30ms);
  ASSERT_EQ(::write(pair.theirs, "x", 1), 1);
  EXPECT_TRUE(clock.wait_readable(pair.ours, clock.now() + 10s));
  const Time before_sleep = clock.now();
  clock.sleep_for(15ms);
  EXPECT_GE(clock.now() - before_sleep, 15ms);
}

TEST_F(SystemClockTest, an_urgent_interrupt_ends_a_wait_early) {
  SystemClock clock;
  Pair pair;
  set_interrupt_level(2);
  EXPECT_THROW(clock.sleep_for(60s), Interrupted);
  EXPECT_THROW(clock.wait_readable(pair.ours, clock.now() + 60s), Interrupted);
  EXPECT_LT(clock.now(), 10s);
}

TEST_F(SystemClockTest, serve_lets_actors_answer_in_real_time_until_an_interrupt) {
  SystemClock clock;
  Pair pair;
  Echo echo(pair.theirs, 5ms);
  const std::vector<Actor*> actors{&echo};
  std::thread server([&] { serve(clock, actors); });
  pair.send("ping");
  EXPECT_TRUE(clock.wait_readable(pair.ours, clock.now() + 10s));
  EXPECT_EQ(pair.receive(), "ping");
  set_interrupt_level(1);
  server.join();
}

TEST(Clock, seconds_and_time_return_to_each_other) {
  EXPECT_DOUBLE_EQ(seconds(1500ms), 1.5);
  EXPECT_EQ(from_seconds(0.25), 250ms);
  EXPECT_DOUBLE_EQ(seconds(from_seconds(123.456)), 123.456);
}

TEST(Clock, utc_has_the_shape_of_iso_8601) {
  const std::string now = utc_now();
  ASSERT_EQ(now.size(), std::string("2026-01-31T12:00:00.000Z").size());
  EXPECT_EQ(now[4], '-');
  EXPECT_EQ(now[10], 'T');
  EXPECT_EQ(now[19], '.');
  EXPECT_EQ(now.back(), 'Z');
  const std::string compact = utc_now_compact();
  ASSERT_EQ(compact.size(), std::string("20260131T120000Z").size());
  EXPECT_EQ(compact[8], 'T');
  EXPECT_EQ(compact.back(), 'Z');
}

}  // namespace
}  // namespace turntable
