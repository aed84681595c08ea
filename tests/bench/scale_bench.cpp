// Plans of ten thousand to a hundred thousand poses: planned, run on a manual clock without images,
// interrupted half way, resumed, verified. Time per pose and peak memory should not depend on their
// number, apart from the plan itself. Each row is a process of its own, so that its memory is its
// own; half the poses are taken in "run", half in "resume". Wrong results fail, time and memory
// never do.
#include <benchmark/benchmark.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <exception>
#include <nlohmann/json.hpp>

#include "src/campaign/planning.h"
#include "src/campaign/runner.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/run_folder.h"
#include "src/record/verify.h"
#include "tests/support/fake_rig.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_images.h"

namespace turntable {
namespace {

constexpr ImageSize kSmall{96, 72};  // what is measured is not the images

Image four_spots() {
  return blobs(kSmall,
               {{20.3, 15.7, 1.5, 190},
                {70.1, 17.4, 1.6, 180},
                {22.8, 55.2, 1.4, 200},
                {71.5, 54.9, 1.5, 150}},
               12, 0.0, Random(1, "scale"));
}

RigFile large_rig() {
  return load_rig_file(std::filesystem::path(TURNTABLE_SOURCE_DIR) / "scenarios/rigs/ideal.json");
}

/// One pose more than `poses`, the initial one. @param poses a multiple of 1000.
Campaign large_campaign(std::int64_t poses) {
  Campaign campaign;
  campaign.name = campaign.title = "scale";
  Json yaw = Json::array();
  for (std::int64_t i = 0; i < poses / 1000; ++i)
    yaw.push_back(-10.0 + 0.2 * static_cast<double>(i));
  const Json scenario{
      {"format", "turntable-scenario/1"},
      {"name", "scale"},
      {"title", "Scale"},
      {"kind", "attitude"},
      {"stage_mm", 120},
      {"order", "snake"},
      {"ranges",
       {{{"axis", "yaw"}, {"values_deg", yaw}},
        {{"axis", "roll"}, {"start_deg", -4.5}, {"stop_deg", 4.5}, {"step_deg", 1}},
        {{"axis", "pitch"}, {"start_deg", -4.95}, {"stop_deg", 4.95}, {"step_deg", 0.1}}}}};
  campaign.scenarios = {parse_scenario(scenario.dump(), "scale.json")};
  return campaign;
}

void require(bool holds, const std::string& what) {
  if (!holds) throw Error("wrong: " + what);
}

/// What is still to be taken of the run's plan. @param stop_at ends after so many poses; 0 = never.
std::size_t take(const Plan& plan, const RunFolder& folder, const RunState* before, int stop_at) {
  FakeRig fake(four_spots());
  RigFile rig = large_rig();
  rig.camera.image_size = kSmall;
  rig.inspection.retakes = 0;  // one trigger a pose: it is counted to stop half way
  fake.camera.on_trigger = [&] {
    fake.camera.announced.clear();  // the test's own notes would grow
    for (auto* starts : {&fake.yaw.starts, &fake.roll.starts, &fake.pitch.starts}) starts->clear();
    if (fake.camera.triggers == stop_at) set_interrupt_level(1);
  };
  AcquireOptions options;
  options.archive = ArchiveMode::kNone;
  options.before = before;
  try {
    return acquire(fake.rig, rig, plan, folder, {{"version", "bench"}}, options).poses;
  } catch (const Interrupted&) {
    return static_cast<std::size_t>(stop_at);
  }
}

struct Measured {
  double time_s = 0.0, cpu_s = 0.0, peak_mb = 0.0;
  char wrong[400] = {};
};

/// In a child process.
template <class Step>
Measured measured(const Step& step) {
  int ends[2];
  if (::pipe(ends) != 0) return {0, 0, 0, "no pipe"};
  const pid_t child = ::fork();
  if (child == 0) {
    Measured m;
    const auto began = std::chrono::steady_clock::now();
    try {
      step();
    } catch (const std::exception& e) {
      std::strncpy(m.wrong, e.what(), sizeof m.wrong - 1);
    }
    m.time_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    for (const timeval& t : {usage.ru_utime, usage.ru_stime})
      m.cpu_s += static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
    m.peak_mb = static_cast<double>(usage.ru_maxrss) / 1024.0;
    const bool told = ::write(ends[1], &m, sizeof m) == sizeof m;
    ::_exit(told ? 0 : 1);
  }
  Measured m;
  ::close(ends[1]);
  if (::read(ends[0], &m, sizeof m) != sizeof m) std::strcpy(m.wrong, "the process died");
  ::close(ends[0]);
  ::waitpid(child, nullptr, 0);
  return m;
}

template <class Step>
void row(benchmark::State& state, const Step& step) {
  for ([[maybe_unused]] const auto _ : state) {
    const Measured m = measured(step);
    if (m.wrong[0] != '\0') return state.SkipWithError(m.wrong);
    state.SetIterationTime(m.time_s);
    const double thousands = static_cast<double>(state.range(0)) / 1000.0;
    state.counters["s/1000"] = m.time_s / thousands;
    state.counters["cpu_s/1000"] = m.cpu_s / thousands;  // whatever else the machine does
    state.counters["peak_MB"] = m.peak_mb;
  }
}

/// One folder for the rows of one size, which follow each other.
std::filesystem::path folder_of(const benchmark::State& state) {
  static const TemporaryFolder folder;
  return folder / std::to_string(state.range(0));
}

void plan_it(benchmark::State& state) {
  std::filesystem::remove_all(folder_of(state));
  row(state, [&] {
    const RigFile rig = large_rig();
    const Plan plan = plan_campaign(large_campaign(state.range(0)), rig);
    check_plan(plan, rig, {ArchiveMode::kNone, folder_of(state)});
    require(plan.poses.size() == static_cast<std::size_t>(state.range(0)) + 1, "poses of the plan");
    RunFolder::create(folder_of(state), plan);
  });
}

void load_plan_again(benchmark::State& state) {
  row(state, [&] {
    const Plan plan = load_plan(RunFolder::open(folder_of(state)).plan());
    require(plan.poses.size() == static_cast<std::size_t>(state.range(0)) + 1, "poses of the plan");
  });
}

void run_half(benchmark::State& state) {
  const auto half = static_cast<int>(state.range(0) / 2);
  row(state, [&] {
    const RunFolder folder = RunFolder::open(folder_of(state));
    take(load_plan(folder.plan()), folder, nullptr, half);
  });
}

void resume_rest(benchmark::State& state) {
  row(state, [&] {
    const RunFolder folder = RunFolder::open(folder_of(state));
    const RunState before = read_run_state(folder);
    const auto half = static_cast<std::size_t>(state.range(0) / 2);
    require(before.poses_taken() == half, "poses before the break");
    const std::size_t taken = take(before.plan, folder, &before, 0);
    require(taken == before.plan.poses.size() - half, "poses after the break");
  });
}

void verify_all(benchmark::State& state) {
  row(state, [&] {
    const RunFindings findings = verify_run(RunFolder::open(folder_of(state)));
    require(findings.sound(), findings.sound() ? "" : findings.damage.front());
    require(findings.lines > static_cast<std::size_t>(state.range(0)), "lines of the journal");
  });
}

const bool registered = [] {
  for (const std::int64_t poses : {10'000, 30'000, 100'000}) {
    const auto add = [poses](const char* name, void (*function)(benchmark::State&)) {
      benchmark::RegisterBenchmark(name, function)
          ->Arg(poses)
          ->Iterations(1)
          ->UseManualTime()
          ->Unit(benchmark::kSecond);
    };
    add("plan and check", plan_it);
    add("load the plan", load_plan_again);
    add("run the first half", run_half);
    add("resume the rest", resume_rest);
    add("verify", verify_all);
  }
  return true;
}();

}  // namespace
}  // namespace turntable
