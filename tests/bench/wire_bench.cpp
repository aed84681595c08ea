// What the driver and the simulated wire cost in real time. Prints times; fails only if a move ends
// elsewhere than it should.
#include <benchmark/benchmark.h>

#include <cmath>
#include <thread>

#include "drivers/catalog.h"
#include "drivers/motion.h"
#include "drivers/sim/catalog.h"
#include "drivers/sim/serve.h"
#include "protocols/serial.h"
#include "src/core/interrupt.h"
#include "tests/support/axis_configs.h"

namespace turntable {
namespace {

ControllerConfig mc600() {
  ControllerConfig config;
  config.name = "mc600";
  config.model = "zolix-mc600";
  return config;
}

/// Three rotary axes on one controller, joined by a socketpair under a manual clock.
struct Rig {
  Rig() {
    auto [near, far] = line_pair("line");
    simulator->plug(std::move(far));
    clock.attach(*simulator);
    controller = open_controller({mc600(), four_axes(), std::move(near), &clock});
    controller->connect();
    for (auto* axis : {&yaw(), &roll(), &pitch()}) axis->home();
  }
  ~Rig() { clock.detach(*simulator); }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Axis<Degrees>& roll() { return *controller->rotary_axis(AxisId::kRoll); }
  Axis<Degrees>& pitch() { return *controller->rotary_axis(AxisId::kPitch); }

  ManualClock clock;
  std::unique_ptr<sim::ControllerSimulator> simulator =
      sim::simulate_controller("zolix-mc600", {four_axes(), {}, 1});
  std::unique_ptr<Controller> controller;
};

/// One question and its answer, all of it in this process.
void SimulatedExchange(benchmark::State& state) {
  Rig rig;
  for (auto _ : state) benchmark::DoNotOptimize(rig.yaw().position());
}
BENCHMARK(SimulatedExchange);

/// The same over a pty, with the simulator on a thread of its own.
void PtyExchange(benchmark::State& state) {
  SystemClock clock;
  const auto simulator = sim::simulate_controller("zolix-mc600", {four_axes(), {}, 1});
  const std::string path = sim::plug_into_pty(*simulator);
  const std::vector<Actor*> actors{simulator.get()};
  std::thread server([&] { serve(clock, actors); });
  {
    const auto controller =
        open_controller({mc600(), four_axes(), open_serial(path, 19200), &clock});
    controller->connect();
    Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
    for (auto _ : state) benchmark::DoNotOptimize(yaw.position());
  }
  set_interrupt_level(1);
  server.join();
  set_interrupt_level(0);
}
BENCHMARK(PtyExchange)->UseRealTime()->Unit(benchmark::kMicrosecond);

/// A pose of a campaign: three axes, 5 deg further each, overshoot and settling included.
void SimulatedPose(benchmark::State& state) {
  Rig rig;
  int k = 0;
  const Time before = rig.clock.now();
  for (auto _ : state) {
    const double to = 5.0 * (++k % 11) - 25.0;
    rig.yaw().start(Degrees{to});
    rig.roll().start(Degrees{-to});
    rig.pitch().start(Degrees{0.5 * to});
    wait_all(rig.yaw(), rig.roll(), rig.pitch());
    if (std::abs(rig.yaw().arrival().position.value - to) > 0.001)
      state.SkipWithError("did not arrive");
  }
  state.counters["virtual_s_per_pose"] = seconds(rig.clock.now() - before) / std::max(k, 1);
}
BENCHMARK(SimulatedPose)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace turntable

BENCHMARK_MAIN();
