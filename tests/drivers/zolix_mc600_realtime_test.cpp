// The same driver and simulator in real time, over a pty and over TCP, as people use them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>
#include <thread>

#include "drivers/motion.h"
#include "drivers/sim/serve.h"
#include "protocols/serial.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "tests/support/simulated_mc600.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

class RealTime : public ::testing::Test {
 protected:
  RealTime()
      : simulator(
            sim::simulate_controller("zolix-mc600", {four_axes(), {}, draws_of_this_test()()})) {}
  ~RealTime() override {
    controller.reset();
    end_serving();
  }

  void serve_in_background(std::vector<Actor*> actors) {
    server = std::thread([this, actors] { serve(clock, actors); });
  }
  /// @return where to connect to.
  ControllerConfig serve_over_tcp() {
    socket = std::make_unique<sim::TcpSocket>(*simulator, 0);
    serve_in_background({socket.get(), simulator.get()});
    ControllerConfig where;
    where.model = "zolix-mc600";
    where.line.kind = LineConfig::Kind::kTcp;
    where.line.host = "127.0.0.1";
    where.line.tcp_port = socket->port();
    return where;
  }
  void end_serving() {
    if (!server.joinable()) return;
    set_interrupt_level(1);
    server.join();
    set_interrupt_level(0);
  }
  void open(const SharedLine& line) {
    ControllerConfig config;
    config.name = "mc600";
    config.model = "zolix-mc600";
    config.reply_timeout_s = 0.5;
    line.line().set_log(wire.log());
    controller = open_controller({config, four_axes(), line, &clock});
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }

  /// Homes and moves two axes at the same time.
  void home_and_move() {
    EXPECT_TRUE(controller->connect().empty());
    Axis<Degrees>& roll = *controller->rotary_axis(AxisId::kRoll);
    yaw().home();
    roll.home();
    const Time before = clock.now();
    yaw().start(Degrees{5});
    roll.start(Degrees{-5});
    wait_all(yaw(), roll);
    EXPECT_LT(seconds(clock.now() - before),
              1.8 * yaw().move_seconds(Degrees{0}, Degrees{5}) + 0.5);
    EXPECT_NEAR(yaw().arrival().position.value, 5.0, 1e-9);
    EXPECT_NEAR(roll.arrival().position.value, -5.0, 1e-9);
    EXPECT_EQ(wire.commands("GoPosition").size(), 4u);
  }

  SystemClock clock;
  WireRecord wire;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<sim::TcpSocket> socket;  // outlives the server thread, whatever a test throws
  std::unique_ptr<Controller> controller;
  std::thread server;
};

TEST_F(RealTime, HomesAndMovesOverAPty) {
  const std::string path = sim::plug_into_pty(*simulator);
  serve_in_background({simulator.get()});
  open(open_serial(path, 19200));
  home_and_move();
}

TEST_F(RealTime, HomesAndMovesOverTcp) {
  const ControllerConfig where = serve_over_tcp();
  open(open_line(where));
  home_and_move();
  controller.reset();
  // The next client finds the controller as it was left.
  open(open_line(where));
  controller->connect();
  EXPECT_NEAR(yaw().position().value, 5.0, 1e-9);
  EXPECT_FALSE(yaw().homed());
  end_serving();
}

TEST_F(RealTime, ServesOneTcpClientAtATime) {
  const ControllerConfig where = serve_over_tcp();
  open(open_line(where));
  controller->connect();
  const SharedLine second = open_line(where);
  std::array<char, 8> buffer;
  EXPECT_THROW(second.line().read(buffer, clock, clock.now() + milliseconds{2000}), LineError);
  EXPECT_EQ(yaw().position().value, 0.0);  // the first is not disturbed
  end_serving();
}

TEST_F(RealTime, StopsFromAnotherThreadAtOnce) {
  const std::string path = sim::plug_into_pty(*simulator);
  serve_in_background({simulator.get()});
  open(open_serial(path, 19200));
  controller->connect();
  yaw().home();
  yaw().start(Degrees{29});
  std::atomic<Time> sent{};
  wire.on_sent = [&](std::string_view bytes, Time time) {
    if (bytes.find("Stop") != bytes.npos && sent.load() == Time{0}) sent = time;
  };
  std::string ended;
  std::thread mover([&] {
    try {
      while (!yaw().advance()) {
      }
    } catch (const DeviceError& error) {
      ended = error.what();
    }
  });
  std::this_thread::sleep_for(milliseconds{300});
  const Time asked = clock.now();
  yaw().stop();
  mover.join();
  // One poll interval and the scheduling of a busy machine; exact under the manual clock.
  EXPECT_LT(sent.load() - asked, milliseconds{40 + 60});
  EXPECT_THAT(ended, HasSubstr("stopped"));
  const double here = yaw().position().value;
  EXPECT_LT(here, 20.0);
  std::this_thread::sleep_for(milliseconds{100});
  EXPECT_EQ(yaw().position().value, here);
}

TEST_F(RealTime, SaysThatTheCableWasPulled) {
  simulator->add_fault({.kind = sim::FaultKind::kUnplugged, .verb = "GoPosition", .delay_s = 0.1});
  const std::string path = sim::plug_into_pty(*simulator);
  serve_in_background({simulator.get()});
  open(open_serial(path, 19200));
  controller->connect();
  yaw().home();
  yaw().start(Degrees{20});
  EXPECT_THROW(
      {
        for (;;) yaw().advance();
      },
      LineError);
  EXPECT_THROW(controller->stop_all(), LineError);
}

TEST_F(RealTime, ServesByNameUntilAnInterrupt) {
  const TemporaryFolder folder;
  const std::filesystem::path link = folder.path() / "mc600";
  std::ostringstream out;
  server = std::thread([&] {
    sim::serve_controllers(clock, {{"mc600", simulator.get(), "", std::nullopt, false, link}}, out);
  });
  while (!std::filesystem::exists(link)) std::this_thread::sleep_for(milliseconds{1});
  open(open_serial(link.string(), 19200));
  EXPECT_TRUE(controller->connect().empty());
  controller.reset();
  end_serving();
  EXPECT_THAT(out.str(), HasSubstr("mc600 /dev/pts/"));
  EXPECT_FALSE(std::filesystem::exists(std::filesystem::symlink_status(link)));
}

}  // namespace
}  // namespace turntable
