// Several controllers on one RS-485 line: their exchanges never meet, and a stop from anywhere is heard.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "drivers/catalog.h"
#include "drivers/sim/bus.h"
#include "drivers/sim/catalog.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/message_of.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

constexpr double kReply_s = 0.06;  // as a ZC300 takes
constexpr double kReplyTimeout_s = 0.3;

/// Presses Ctrl-C twice at a moment of virtual time.
class Presser final : public Actor {
 public:
  int descriptor() const override { return -1; }
  std::optional<Time> next_due() const override { return due; }
  void act(Time now) override {
    if (!due || now < *due) return;
    due.reset();
    set_interrupt_level(2);
  }
  std::optional<Time> due;
};

/// Two ZC300 at the addresses 11 and 12, and four Leadshine drives at 1 to 4, on one line.
struct SharedBus {
  SharedBus() {
    std::vector<sim::ControllerSimulator*> all;
    for (const int address : {11, 12}) {
      ControllerConfig config = on_the_line("zolix-zc300");
      config.address = address;
      add(config, {linear_axis("X"), rotary_axis(AxisId::kYaw, "Y")});
    }
    add(on_the_line("leadshine-pr"),
        {linear_axis("1"), rotary_axis(AxisId::kYaw, "2"), rotary_axis(AxisId::kRoll, "3"),
         rotary_axis(AxisId::kPitch, "4")});
    for (const auto& simulator : simulators) {
      simulator->note_requests();
      all.push_back(simulator.get());
    }
    bus = std::make_unique<sim::Bus>(all);
    auto [near, far] = line_pair("bus");
    bus->plug(std::move(far));
    clock.attach(*bus);
    clock.attach(presser);
    const SharedLine line(std::move(near));
    for (std::size_t i = 0; i < configs.size(); ++i) {
      clock.attach(*simulators[i]);
      controllers.push_back(open_controller({configs[i], axes[i], line, &clock}));
    }
  }
  ~SharedBus() { set_interrupt_level(0); }

  static ControllerConfig on_the_line(const std::string& model) {
    ControllerConfig config;
    config.name = config.model = model;
    config.line.baud = 115200;
    config.reply_timeout_s = kReplyTimeout_s;
    return config;
  }
  void add(const ControllerConfig& config, std::vector<AxisConfig> on_it) {
    simulators.push_back(sim::simulate_controller(config.model, {on_it, {}, 1, config, kReply_s}));
    configs.push_back(config);
    axes.push_back(std::move(on_it));
  }
  template <class F>
  void with_all(F&& f) {
    for (std::size_t i = 0; i < controllers.size(); ++i)
      for (const AxisConfig& axis : axes[i]) {
        if (axis.kind == StageKind::kLinear)
          f(*controllers[i]->linear_axis(axis.id));
        else
          f(*controllers[i]->rotary_axis(axis.id));
      }
  }
  bool anything_moves() const {
    for (std::size_t i = 0; i < simulators.size(); ++i)
      for (const AxisConfig& axis : axes[i])
        if (simulators[i]->axis(axis.id).moving(clock.now())) return true;
    return false;
  }
  /// When the last axis was told to stop for the first time since `asked`.
  Time last_told(Time asked) const {
    Time last{0};
    for (std::size_t i = 0; i < simulators.size(); ++i)
      for (const AxisConfig& axis : axes[i]) {
        const auto& requests = simulators[i]->requests();
        const auto told = std::ranges::find_if(requests, [&](const auto& request) {
          return request.kind == "stop" && request.axis == axis.id && request.at >= asked;
        });
        last = std::max(last, told == requests.end() ? Time::max() : told->at);
      }
    return last;
  }
  void stop_all() {
    const InterruptShield shield;
    for (const auto& controller : controllers) controller->forbid_all();
    for (const auto& controller : controllers) controller->begin_stop_all();
    for (const auto& controller : controllers) controller->finish_stop_all();
  }

  ManualClock clock;
  Presser presser;
  std::vector<ControllerConfig> configs;
  std::vector<std::vector<AxisConfig>> axes;
  std::vector<std::unique_ptr<sim::ControllerSimulator>> simulators;
  std::unique_ptr<sim::Bus> bus;
  std::vector<std::unique_ptr<Controller>> controllers;
};

TEST(SharedBus, IsStoppedAtAHundredRandomMomentsWithoutACollision) {
  SharedBus rig;
  Random draws = draws_of_this_test();
  for (const auto& controller : rig.controllers)
    EXPECT_THAT(controller->connect(), ::testing::IsEmpty());
  rig.with_all([](auto& axis) { axis.home(); });
  std::size_t polled = 0;
  rig.with_all([&](auto&) { ++polled; });
  int moving = 0;
  for (int k = 0; k < 100; ++k) {
    rig.presser.due = rig.clock.now() + from_seconds(draws.uniform(0.0, 3.0));
    try {
      rig.with_all([&](auto& axis) {
        if (!axis.homed()) axis.home();
        const auto limits = axis.limits();
        const double to = draws.uniform(limits.lower.value + 2, limits.upper.value - 2);
        axis.start({to});
      });
      for (;;) rig.with_all([](auto& axis) { axis.advance(); });
    } catch (const Interrupted&) {
    }
    moving += rig.anything_moves();
    const Time asked = rig.clock.now();
    ASSERT_NO_THROW(rig.stop_all()) << k;
    ASSERT_FALSE(rig.anything_moves()) << k;
    set_interrupt_level(0);
    // Every axis has been told within the time in which the line can be used once for each of them; a
    // ZC300 may miss a request when its motions end.
    EXPECT_LT(seconds(rig.last_told(asked) - asked),
              (static_cast<double>(polled) + 1) * (kReply_s + 0.005) + 2 * kReplyTimeout_s)
        << k;
  }
  EXPECT_GT(moving, 60);
  EXPECT_EQ(rig.bus->collisions(), 0);
  EXPECT_EQ(rig.bus->too_soon(), 0);
}

RigFile two_on(const std::string& first, const std::string& second) {
  RigFile rig;
  for (const std::string& model : {first, second}) {
    ControllerConfig config = SharedBus::on_the_line(model);
    config.name = rig.controllers.empty() ? "mc1" : "mc2";
    config.address = model == "zolix-zc300" ? 1 + static_cast<int>(rig.controllers.size()) : 1;
    config.line.kind = LineConfig::Kind::kSerial;
    config.line.serial_port = "/dev/ttyUSB7";
    rig.controllers.push_back(config);
  }
  return rig;
}

TEST(SharedBus, IsForControllersThatAnswerByAddressOnly) {
  EXPECT_NO_THROW(check_controllers(two_on("zolix-zc300", "zolix-zc300")));
  EXPECT_THAT(
      message_of<ConfigError>([] { check_controllers(two_on("zolix-zc300", "zolix-mc600")); }),
      HasSubstr("/controllers/mc2/line: is the line of controller mc1 too"));
  RigFile rig = two_on("zolix-zc300", "zolix-zc300");
  rig.controllers[1].address = 1;
  EXPECT_THAT(message_of<ConfigError>([&] { check_controllers(rig); }),
              HasSubstr("/controllers/mc2/address: slave 1 on this line is controller mc1's"));
  rig = two_on("zolix-zc300", "zolix-zc300");
  rig.controllers[1].line.baud = 9600;
  EXPECT_THAT(message_of<ConfigError>([&] { check_controllers(rig); }),
              HasSubstr("another baud rate"));
  rig = two_on("zolix-zc300", "leadshine-pr");
  AxisConfig axis = rotary_axis(AxisId::kYaw, "1");
  axis.controller = "mc2";
  rig.axes[AxisId::kYaw] = axis;
  EXPECT_THAT(message_of<ConfigError>([&] { check_controllers(rig); }), HasSubstr("slave 1"));
  rig.axes[AxisId::kYaw].channel = "2";
  EXPECT_NO_THROW(check_controllers(rig));
}

}  // namespace
}  // namespace turntable
