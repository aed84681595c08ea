#include "protocols/line.h"

#include <gtest/gtest.h>

#include <string>

#include "src/core/errors.h"
#include "tests/protocols/read_text.h"
#include "tests/support/wire_record.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

TEST(Line, CarriesBytesBothWays) {
  ManualClock clock;
  auto [a, b] = line_pair("pair");
  a.write("to b", clock, Time{0});
  b.write("to a", clock, Time{0});
  EXPECT_EQ(read_text(b, clock, Time{0}), "to b");
  EXPECT_EQ(read_text(a, clock, Time{0}), "to a");
}

TEST(Line, WaitsForBytesUntilTheDeadlineOfTheClock) {
  ManualClock clock;
  auto [a, b] = line_pair("pair");
  EXPECT_THROW(read_text(a, clock, milliseconds{250}), TimeoutError);
  EXPECT_EQ(clock.now(), milliseconds{250});
}

TEST(Line, SaysThatThePeerIsGoneRatherThanThatItIsSilent) {
  ManualClock clock;
  auto pair = line_pair("pair");
  { const Line closed = std::move(pair.second); }
  EXPECT_THROW(read_text(pair.first, clock, milliseconds{250}), LineError);
  EXPECT_THROW(pair.first.write("x", clock, milliseconds{250}), LineError);
  EXPECT_EQ(clock.now(), Time{0});
}

TEST(Line, TimesOutWritingToAPeerThatDoesNotRead) {
  ManualClock clock;
  auto [a, b] = line_pair("pair");
  EXPECT_THROW(a.write(std::string(10'000'000, 'x'), clock, milliseconds{50}), TimeoutError);
  EXPECT_EQ(clock.now(), milliseconds{50});
}

TEST(Line, DrainsWhatHasArrived) {
  ManualClock clock;
  auto [a, b] = line_pair("pair");
  b.write(std::string(2000, 'x'), clock, Time{0});
  EXPECT_EQ(a.drain(clock.now()), 2000u);
  EXPECT_EQ(a.drain(clock.now()), 0u);
}

TEST(Line, ShowsEveryByteToTheWireLog) {
  ManualClock clock;
  auto [a, b] = line_pair("pair");
  WireRecord record;
  a.set_log(record.log());
  a.write("asked", clock, Time{0});
  b.write("answered", clock, Time{0});
  read_text(a, clock, Time{0});
  EXPECT_EQ(record.sent(), "asked");
  EXPECT_EQ(record.received(), "answered");
}

TEST(Line, LeavesClosingToItsOwnerIfItHasOne) {
  ManualClock clock;
  auto pair = line_pair("pair");
  const int fd = pair.first.descriptor();
  bool released = false;
  const std::shared_ptr<void> owner(nullptr, [&](void*) { released = true; });
  {
    Line line(fd, "owned", owner);
    line.write("x", clock, Time{0});
  }
  EXPECT_FALSE(released);                 // `owner` is still held here
  pair.first.write("y", clock, Time{0});  // and the descriptor is open
  EXPECT_EQ(read_text(pair.second, clock, Time{0}), "xy");
}

}  // namespace
}  // namespace turntable
