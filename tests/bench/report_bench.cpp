// "turntable report" of the tri-axial motion (1053 poses, all solvers) from its stored points, as a user runs it: a
// process of its own, from its start to its end, with the PDF and without. Taking the run is not measured. It
// fails if no report comes, never on time.
#include <benchmark/benchmark.h>
#include <fmt/format.h>
#include <sys/wait.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <string>

#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

bool succeeds(const std::string& arguments) {
  const int status =
      std::system(fmt::format("\"{}\" {} > /dev/null 2>&1", TURNTABLE_PROGRAM, arguments).c_str());
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

/// Taken once, for both rows.
const std::filesystem::path& stored_run() {
  static const TemporaryFolder folder;
  static const std::filesystem::path run = [] {
    ::setenv("XDG_STATE_HOME", (folder / "state").c_str(), 1);  // what it learns is nobody's
    ::unsetenv("TURNTABLE_NO_PDF");
    const std::string scenarios = TURNTABLE_SOURCE_DIR "/scenarios/";
    const std::filesystem::path taken = folder / "run";
    return succeeds(fmt::format("run \"{0}triaxial_xyz.json\" --rig \"{0}rigs/simulated.json\" "
                                "--solver all --no-pdf --out \"{1}\"",
                                scenarios, taken.string()))
               ? taken
               : std::filesystem::path();
  }();
  return run;
}

/// Ten reports, since what a machine gives varies.
void report(benchmark::State& state, bool pdf) {
  using std::chrono::steady_clock;
  const std::filesystem::path& run = stored_run();
  if (run.empty()) {
    state.SkipWithError("the run could not be taken");
    return;
  }
  double fastest = std::numeric_limits<double>::infinity(), slowest = 0.0;
  for (auto _ : state) {
    const auto begin = steady_clock::now();
    const bool done =
        succeeds(fmt::format("report \"{}\"{}", run.string(), pdf ? "" : " --no-pdf"));
    const double took_s = std::chrono::duration<double>(steady_clock::now() - begin).count();
    fastest = std::min(fastest, took_s);
    slowest = std::max(slowest, took_s);
    if (!done || std::filesystem::exists(run / "report.pdf") != pdf) {
      state.SkipWithError(pdf ? "no report, or no PDF of it" : "no report");
      return;
    }
  }
  state.counters["fastest_s"] = fastest;
  state.counters["slowest_s"] = slowest;
}

void shown(benchmark::internal::Benchmark* bench) {
  bench->UseRealTime()->Unit(benchmark::kSecond)->Iterations(10);
}

BENCHMARK_CAPTURE(report, html, false)->Apply(shown);
BENCHMARK_CAPTURE(report, html_and_pdf, true)->Apply(shown);

}  // namespace
}  // namespace turntable
