// The driver and its simulated bus in real time: RTU over a pty, and Modbus TCP over a socket.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "drivers/motion.h"
#include "drivers/sim/serve.h"
#include "protocols/serial.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "tests/support/simulated_leadshine.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class LeadshineRealTime : public ::testing::Test {
 protected:
  ~LeadshineRealTime() override {
    controller.reset();
    if (!server.joinable()) return;
    set_interrupt_level(1);
    server.join();
    set_interrupt_level(0);
  }

  ControllerConfig config_of(LineConfig::Kind kind) {
    ControllerConfig config;
    config.name = "bus";
    config.model = "leadshine-pr";
    config.reply_timeout_s = 0.5;
    config.line.kind = kind;
    config.line.host = "127.0.0.1";
    simulator = sim::simulate_leadshine({bus_axes(), {}, draws_of_this_test()(), config});
    return config;
  }
  void serve_in_background(std::vector<Actor*> actors) {
    server = std::thread([this, actors] { serve(clock, actors); });
  }
  void open_on_a_pty() {
    const ControllerConfig config = config_of(LineConfig::Kind::kSerial);
    const std::string path = sim::plug_into_pty(*simulator);
    serve_in_background({simulator.get()});
    open(config, open_serial(path, 38400));
  }
  void open(const ControllerConfig& config, const SharedLine& line) {
    line.line().set_log(wire.log());
    controller = open_controller({config, bus_axes(), line, &clock});
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }

  void home_and_move() {
    EXPECT_THAT(controller->connect(), IsEmpty());
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
  }

  SystemClock clock;
  WireRecord wire;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<sim::TcpSocket> socket;
  std::unique_ptr<Controller> controller;
  std::thread server;
};

TEST_F(LeadshineRealTime, HomesAndMovesOverAPty) {
  open_on_a_pty();
  home_and_move();
}

TEST_F(LeadshineRealTime, HomesAndMovesThroughAGateway) {
  ControllerConfig config = config_of(LineConfig::Kind::kModbusTcp);
  socket = std::make_unique<sim::TcpSocket>(*simulator, 0);
  config.line.tcp_port = socket->port();
  serve_in_background({socket.get(), simulator.get()});
  open(config, open_line(config));
  home_and_move();
}

TEST_F(LeadshineRealTime, StopsFromAnotherThreadAtOnce) {
  open_on_a_pty();
  controller->connect();
  yaw().home();
  yaw().start(Degrees{29});
  std::atomic<Time> sent{};
  wire.on_sent = [&](std::string_view bytes, Time time) {
    if (bytes == std::string_view("\x02\x06\x60\x02\x00\x40\x37\xc9", 8) && sent.load() == Time{0})
      sent = time;
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
  // An exchange gives way and its answer is let pass; the rest is the scheduling of a busy machine.
  EXPECT_GT(sent.load(), Time{0});
  EXPECT_LT(sent.load() - asked, milliseconds{20 + 50 + 80});
  EXPECT_THAT(ended, HasSubstr("stopped"));
  const double here = yaw().position().value;
  EXPECT_LT(here, 20.0);
  std::this_thread::sleep_for(milliseconds{100});
  EXPECT_EQ(yaw().position().value, here);
}

}  // namespace
}  // namespace turntable
