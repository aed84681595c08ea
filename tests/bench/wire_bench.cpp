// What the drivers and the simulated wire cost in real time, for every controller of the catalogue.
// Prints times; fails only if a move ends elsewhere than it should, or a faulted run breaks a rule.
#include <benchmark/benchmark.h>

#include <array>
#include <cmath>
#include <thread>

#include "drivers/motion.h"
#include "drivers/sim/serve.h"
#include "protocols/serial.h"
#include "src/core/interrupt.h"
#include "tests/support/fault_campaign.h"

namespace turntable {
namespace {

/// One question and its answer through driver and simulator, all of it in this process.
void SimulatedExchange(benchmark::State& state, const ControllerVariant& variant) {
  SimulatedController rig(variant);
  rig.controller->connect();
  const std::size_t before = rig.simulator->requests().size();
  for (auto _ : state) benchmark::DoNotOptimize(rig.yaw().position());
  state.counters["exchanges_per_read"] =
      static_cast<double>(rig.simulator->requests().size() - before) /
      static_cast<double>(state.iterations());
}

/// An actor that sends back what it hears: the line's own time.
class Echo final : public Actor {
 public:
  explicit Echo(Line line) : line_(std::move(line)) {}
  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override { return std::nullopt; }
  void act(Time now) override {
    std::array<char, 256> buffer;
    const std::size_t n = line_.read_available(buffer, now);
    line_.write_available({buffer.data(), n}, now);
  }

 private:
  Line line_;
};

/// Serves on a thread of its own while it lives.
class Served {
 public:
  Served(SystemClock& clock, Actor& actor)
      : actors_{&actor}, thread_([this, &clock] { serve(clock, actors_); }) {}
  ~Served() {
    set_interrupt_level(1);
    thread_.join();
    set_interrupt_level(0);
  }

 private:
  std::vector<Actor*> actors_;
  std::thread thread_;
};

/// Sixteen bytes there and back over a pty, without any driver.
void PtyEcho(benchmark::State& state) {
  SystemClock clock;
  Pty pty = make_pty();
  Echo echo(std::move(pty.master));
  const Served served(clock, echo);
  Line line = open_serial(pty.path, 19200);
  std::array<char, 64> buffer;
  for (auto _ : state) {
    const Time deadline = clock.now() + std::chrono::seconds{5};
    line.write("0123456789abcdef", clock, deadline);
    for (std::size_t n = 0; n < 16;) n += line.read(buffer, clock, deadline);
  }
}
BENCHMARK(PtyEcho)->UseRealTime()->Unit(benchmark::kMicrosecond);

/// The same as SimulatedExchange over a pty, with the simulator on a thread of its own: what is
/// beyond PtyEcho, per exchange, is the driver's and the simulator's.
void PtyExchange(benchmark::State& state, const ControllerVariant& variant) {
  SystemClock clock;
  ControllerConfig config;
  config.name = "mc1";
  config.model = variant.model;
  config.answers_while_moving = variant.answers_while_moving;
  config.description = variant.description();
  const std::vector<AxisConfig> axes = axes_of(variant.model);
  const auto simulator = sim::simulate_controller(variant.model, {axes, {}, 1, config});
  const std::string path = sim::plug_into_pty(*simulator);
  const Served served(clock, *simulator);
  const auto controller = open_controller({config, axes, open_serial(path, 19200), &clock});
  controller->connect();
  Axis<Degrees>& yaw = *controller->rotary_axis(AxisId::kYaw);
  for (auto _ : state) benchmark::DoNotOptimize(yaw.position());
}

/// A pose of a campaign: three axes, 5 deg or 5 mm further each, overshoot and settling included.
void SimulatedPose(benchmark::State& state, const ControllerVariant& variant) {
  SimulatedController rig(variant, Transport::kSocketPair, {}, {}, 1, false);
  rig.ready();
  int k = 0;
  const Time before = rig.clock.now();
  for (auto _ : state) {
    const double to = 5.0 * (++k % 11) - 25.0;
    rig.yaw().start(Degrees{to});
    rig.roll().start(Degrees{-to});
    rig.stage().start(Millimetres{30 + to});
    wait_all(rig.yaw(), rig.roll(), rig.stage());
    if (std::abs(rig.yaw().arrival().position.value - to) > 0.001)
      state.SkipWithError("did not arrive");
  }
  state.counters["virtual_s_per_pose"] = seconds(rig.clock.now() - before) / std::max(k, 1);
}

/// Short runs with random faults (tests/support/fault_campaign.h), their journals included.
void FaultedRuns(benchmark::State& state, const ControllerVariant& variant) {
  FaultCampaign campaign(variant);
  std::uint64_t k = 100'000;
  for (auto _ : state)
    if (!campaign.run(k++).broken.empty()) state.SkipWithError("a run broke a rule");
  state.counters["runs_per_s"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

const bool registered = [] {
  for (const ControllerVariant& variant : all_controllers()) {
    const auto add = [&](const char* name, auto* function) {
      return benchmark::RegisterBenchmark((std::string(name) + "/" + variant.name()).c_str(),
                                          function, variant);
    };
    add("SimulatedExchange", SimulatedExchange)->Unit(benchmark::kMicrosecond);
    if (!variant.gateway)
      add("PtyExchange", PtyExchange)->UseRealTime()->Unit(benchmark::kMicrosecond);
    add("SimulatedPose", SimulatedPose)->Unit(benchmark::kMicrosecond);
    add("FaultedRuns", FaultedRuns)->UseRealTime()->Unit(benchmark::kMillisecond);
  }
  return true;
}();

}  // namespace
}  // namespace turntable

BENCHMARK_MAIN();
