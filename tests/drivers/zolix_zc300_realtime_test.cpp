// The same driver and simulator in real time: RTU over a pty, and Modbus TCP.
#include <gtest/gtest.h>

#include <thread>

#include "drivers/motion.h"
#include "drivers/sim/serve.h"
#include "protocols/serial.h"
#include "src/core/interrupt.h"
#include "tests/support/simulated_zc300.h"

namespace turntable {
namespace {

class Zc300RealTime : public ::testing::TestWithParam<LineConfig::Kind> {
 protected:
  Zc300RealTime() : config(zc300_config(GetParam())) {
    config.reply_timeout_s = 0.2;
    simulator = sim::simulate_controller("zolix-zc300",
                                         {zc300_axes(), {}, draws_of_this_test()(), config, 0.002});
    simulator->note_requests();
  }
  ~Zc300RealTime() override {
    controller.reset();
    end_serving();
  }
  void end_serving() {
    if (!server.joinable()) return;
    set_interrupt_level(1);
    server.join();
    set_interrupt_level(0);
  }
  SharedLine served() {
    std::vector<Actor*> actors{simulator.get()};
    if (GetParam() == LineConfig::Kind::kSerial) {
      const std::string path = sim::plug_into_pty(*simulator);
      server = std::thread([this, actors] { serve(clock, actors); });
      return open_serial(path, 115200);
    }
    socket = std::make_unique<sim::TcpSocket>(*simulator, 0);
    config.line.host = "127.0.0.1";
    config.line.tcp_port = socket->port();
    actors.insert(actors.begin(), socket.get());
    server = std::thread([this, actors] { serve(clock, actors); });
    return open_line(config);
  }

  SystemClock clock;
  ControllerConfig config;
  std::unique_ptr<sim::ControllerSimulator> simulator;
  std::unique_ptr<sim::TcpSocket> socket;  // outlives the server thread, whatever a test throws
  std::unique_ptr<Controller> controller;
  std::thread server;
};

TEST_P(Zc300RealTime, HomesAndMovesTwoAxes) {
  controller = open_controller({config, zc300_axes(), served(), &clock});
  EXPECT_TRUE(controller->connect().empty());
  Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
  Axis<Degrees>& roll = *controller->rotary_axis(AxisId::kRoll);
  yaw.home();
  roll.home();
  yaw.start(Degrees{3});
  roll.start(Degrees{-5});
  wait_all(yaw, roll);
  EXPECT_NEAR(yaw.arrival().position.value, 3.0, 1e-6);
  EXPECT_NEAR(roll.arrival().position.value, -5.0, 1e-6);
  yaw.start(Degrees{20});
  clock.sleep_for(std::chrono::milliseconds{300});
  controller->stop_all();
  EXPECT_LT(yaw.position().value, 15.0);
  end_serving();
  const auto moves =
      std::ranges::count(simulator->requests(), "move", &sim::ControllerSimulator::Request::kind);
  EXPECT_EQ(moves, 5);  // two legs each, and the one that was stopped
}

INSTANTIATE_TEST_SUITE_P(Lines, Zc300RealTime,
                         ::testing::Values(LineConfig::Kind::kSerial,
                                           LineConfig::Kind::kModbusTcp));

}  // namespace
}  // namespace turntable
