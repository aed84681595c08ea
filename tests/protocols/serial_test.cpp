#include "protocols/serial.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <filesystem>
#include <string>

#include "src/core/errors.h"
#include "tests/protocols/read_text.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

TEST(Serial, PassesEveryByteThroughAPtyUnchanged) {
  SystemClock clock;
  Pty pty = make_pty();
  Line port = open_serial(pty.path, 19200);
  std::string all;
  for (int i = 0; i < 256; ++i) all += static_cast<char>(i);
  port.write(all, clock, clock.now() + milliseconds{1000});
  std::string got;
  while (got.size() < all.size()) got += read_text(pty.master, clock);
  EXPECT_EQ(got, all);
  pty.master.write("a\r\x03z", clock, clock.now() + milliseconds{1000});
  EXPECT_EQ(read_text(port, clock), "a\r\x03z");
}

TEST(Serial, NamesTheProgramThatHasThePort) {
  Pty pty = make_pty();
  const auto message = [&] {
    try {
      open_serial(pty.path, 19200);
    } catch (const LineError& e) {
      return std::string(e.what());
    }
    return std::string("opened");
  };
  {
    const Line port = open_serial(pty.path, 19200);
    EXPECT_THAT(message(), HasSubstr("in use by this program itself"));
  }
  int told[2];
  ASSERT_EQ(::pipe(told), 0);
  const pid_t other = ::fork();
  if (other == 0) {  // a terminal, as far as the port can tell
    const int fd = ::open(pty.path.c_str(), O_RDWR | O_NOCTTY);
    ::flock(fd, LOCK_EX);
    ::close(told[1]);
    ::pause();
    ::_exit(0);
  }
  ::close(told[1]);
  char byte = 0;
  EXPECT_EQ(::read(told[0], &byte, 1), 0);  // closed once the lock is held
  EXPECT_THAT(message(), HasSubstr("in use by process " + std::to_string(other)));
  ::kill(other, SIGKILL);
  ::waitpid(other, nullptr, 0);
  ::close(told[0]);
  EXPECT_EQ(message(), "opened");
}

TEST(Serial, FollowsASymbolicLink) {
  const TemporaryFolder folder;
  SystemClock clock;
  Pty pty = make_pty();
  const std::filesystem::path link = folder.path() / "controller";
  std::filesystem::create_symlink(pty.path, link);
  Line port = open_serial(link.string(), 19200);
  port.write("x", clock, clock.now() + milliseconds{1000});
  EXPECT_EQ(read_text(pty.master, clock), "x");
}

TEST(Serial, LetsClientsComeAndGoOnAPty) {
  SystemClock clock;
  Pty pty = make_pty();
  for (int i = 0; i < 3; ++i) {
    Line port = open_serial(pty.path, 19200);
    port.write("hello", clock, clock.now() + milliseconds{1000});
    EXPECT_EQ(read_text(pty.master, clock), "hello");
  }
  std::array<char, 8> buffer;
  EXPECT_EQ(pty.master.read_available(buffer, clock.now()), 0u);  // not "gone"
}

TEST(Serial, SaysThatThePortIsGoneWhenItsFarEndCloses) {
  SystemClock clock;
  std::optional<Pty> pty(make_pty());
  Line port = open_serial(pty->path, 19200);
  pty.reset();
  EXPECT_THROW(read_text(port, clock), LineError);
}

TEST(Serial, NamesAPortThatIsNotThere) {
  try {
    open_serial("/dev/ttyNOSUCH", 19200);
    FAIL();
  } catch (const LineError& error) {
    EXPECT_NE(std::string(error.what()).find("/dev/ttyNOSUCH"), std::string::npos);
  }
}

TEST(Serial, RefusesAFileThatIsNoPort) { EXPECT_THROW(open_serial("/dev/null", 19200), LineError); }

}  // namespace
}  // namespace turntable
