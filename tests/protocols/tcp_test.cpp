#include "protocols/tcp.h"

#include <gtest/gtest.h>

#include <string>

#include "src/core/errors.h"
#include "tests/protocols/read_text.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

TEST(Tcp, CarriesBytesBetweenAClientAndAListener) {
  SystemClock clock;
  TcpListener listener(0);
  Line client = open_tcp("127.0.0.1", listener.port(), milliseconds{1000});
  ASSERT_TRUE(clock.wait_readable(listener.descriptor(), clock.now() + milliseconds{1000}));
  auto served = listener.accept();
  ASSERT_TRUE(served);
  client.write("to server", clock, clock.now() + milliseconds{1000});
  EXPECT_EQ(read_text(*served, clock), "to server");
  served->write("to client", clock, clock.now() + milliseconds{1000});
  EXPECT_EQ(read_text(client, clock), "to client");
  served.reset();
  EXPECT_THROW(read_text(client, clock), LineError);
}

TEST(Tcp, HasNobodyToAcceptWhenNobodyConnects) {
  TcpListener listener(0);
  EXPECT_FALSE(listener.accept());
}

TEST(Tcp, SaysThatAConnectionWasRefused) {
  std::uint16_t free_port = 0;
  {
    const TcpListener listener(0);
    free_port = listener.port();
  }
  EXPECT_THROW(open_tcp("127.0.0.1", free_port, milliseconds{1000}), LineError);
}

TEST(Tcp, SaysThatAHostIsUnknown) {
  EXPECT_THROW(open_tcp("no such host", 4001, milliseconds{1000}), LineError);
}

TEST(Tcp, SaysThatAPortIsTaken) {
  const TcpListener listener(0);
  EXPECT_THROW(TcpListener(listener.port()), LineError);
}

}  // namespace
}  // namespace turntable
