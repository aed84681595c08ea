#include "protocols/shared_line.h"

#include <gtest/gtest.h>

#include <optional>
#include <thread>

#include "src/core/errors.h"

namespace turntable {
namespace {

/// A line that may be opened as often as the far end is willing.
struct Reopened {
  Reopened()
      : shared([this] {
          if (refuses) throw LineError("refused");
          auto [near, other] = line_pair("server");
          far.emplace(std::move(other));
          return std::move(near);
        }) {}
  bool refuses = false;
  std::optional<Line> far;
  SharedLine shared;
};

TEST(SharedLine, IsOneLineForAllItsCopies) {
  auto [near, far] = line_pair("line");
  const SharedLine one(std::move(near)), other = one;
  EXPECT_EQ(&one.line(), &other.line());
  EXPECT_EQ(other.name(), "line");
  EXPECT_FALSE(one.can_reopen());
  EXPECT_THROW(one.reopen(), LineError);
}

TEST(SharedLine, MakesEverybodyButTheStopGiveWay) {
  auto [near, far] = line_pair("line");
  const SharedLine line(std::move(near));
  auto talking = line.lock();
  EXPECT_FALSE(line.gives_way());
  std::thread stop([&] {
    const SharedLine::Stop turn(line);
    EXPECT_FALSE(line.gives_way());
  });
  while (!line.gives_way()) std::this_thread::yield();
  talking.unlock();
  stop.join();
  EXPECT_FALSE(line.gives_way());
}

TEST(SharedLine, IsOpenedAgainAndTellsThatItWas) {
  ManualClock clock;
  Reopened server;
  const SharedLine other = server.shared;
  EXPECT_EQ(other.times_opened(), 1u);
  server.shared.set_unanswered(clock.now());
  server.shared.set_echoes(true);
  server.shared.reopen();
  EXPECT_EQ(other.times_opened(), 2u);
  EXPECT_FALSE(other.unanswered_since());
  EXPECT_FALSE(other.echoes());
  other.line().write("x", clock, clock.now());
  char byte = 0;
  EXPECT_EQ(server.far->read_available({&byte, 1}, clock.now()), 1u);
  EXPECT_EQ(byte, 'x');
}

TEST(SharedLine, MayBeTriedAgainAfterItCouldNotBeOpened) {
  Reopened server;
  server.refuses = true;
  EXPECT_THROW(server.shared.reopen(), LineError);
  EXPECT_THROW(server.shared.line(), LineError);
  EXPECT_FALSE(server.shared.last_byte());
  server.refuses = false;
  server.shared.reopen();
  EXPECT_NO_THROW(server.shared.line());
}

TEST(SharedLine, HeedsWhoeverWantsTheLongestSilence) {
  ManualClock clock;
  auto [near, far] = line_pair("line");
  const SharedLine line(std::move(near));
  line.await_silence(clock);
  EXPECT_EQ(clock.now(), Time{0});
  line.want_silence(std::chrono::milliseconds{4});
  line.want_silence(std::chrono::milliseconds{2});
  line.line().write("x", clock, clock.now());
  line.await_silence(clock);
  EXPECT_EQ(clock.now(), std::chrono::milliseconds{4});
  line.await_silence(clock);
  EXPECT_EQ(clock.now(), std::chrono::milliseconds{4});
}

}  // namespace
}  // namespace turntable
