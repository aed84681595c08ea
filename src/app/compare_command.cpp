// "turntable report A B": two runs side by side, from what is stored of them.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "src/app/commands.h"
#include "src/app/outputs.h"
#include "src/core/errors.h"
#include "src/evaluation/run_comparison.h"
#include "src/record/folder.h"
#include "src/record/sha256.h"
#include "src/report/compare_report.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

std::string folder_name(const fs::path& run) {
  const fs::path whole = fs::absolute(run).lexically_normal();
  return (whole.has_filename() ? whole.filename() : whole.parent_path().filename()).string();
}

/// A folder in A that tells B, also from other runs whose folder has the same name.
fs::path default_folder(const fs::path& a, const fs::path& b) {
  constexpr std::size_t kDigits = 8;
  const RunState state = read_run_state(RunFolder::open(b));
  const std::string uid = state.sessions.empty() ? "" : state.sessions.front().uid;
  return a / fmt::format("compare_{}{}", folder_name(b),
                         uid.empty() ? "" : "_" + uid.substr(0, kDigits));
}

ComparedRun described(const fs::path& run, const StoredRun& stored) {
  return {folder_name(run), run.string(),
          stored.record.sessions.empty() ? "" : stored.record.sessions.front().began_utc,
          stored.rig.simulated()};
}

/// What of it is compared, beside its errors.
struct Compared {
  RunFolder folder;
  EvaluationRecord how;
  StoredRun run;
};

Compared compared(const fs::path& run) {
  const RunFolder folder = RunFolder::open(run);
  EvaluationRecord how = read_evaluation_record(folder, load_plan(folder.plan()));
  StoredRun stored = stored_run(folder, how.solvers);
  return {folder, std::move(how), std::move(stored)};
}

std::string scenario_names(const Plan& plan) {
  std::vector<std::string> names;
  for (const ScenarioInfo& s : plan.scenarios)
    if (s.kind == ScenarioKind::kAttitude) names.push_back(s.name);
  return fmt::format("{}", fmt::join(names, ", "));
}

/// What is not the same: rig, scenarios, calibration, program.
std::vector<RunFact> differences(const Compared& a, const Compared& b) {
  std::vector<RunFact> facts = plan_differences(a.run.record.plan, b.run.record.plan);
  const auto calibration = [](const Compared& c) {
    return Json{{"source", c.run.calibration.source},
                {"sha256", sha256_hex(read_text(c.folder.calibration())).substr(0, 16)}};
  };
  const auto add = [&](const std::string& what, const Json& first, const Json& other) {
    for (RunFact& fact : json_differences(what, first, other)) facts.push_back(std::move(fact));
  };
  add("calibration", calibration(a), calibration(b));
  add("program that evaluated", a.how.poses_by, b.how.poses_by);
  return facts;
}

}  // namespace

int compare_command(const ReportArguments& a) {
  const fs::path &first = a.runs[0], &other = a.runs[1];
  std::error_code none;
  if (fs::equivalent(first, other, none))
    spdlog::warn("{} and {} are the same run.", first.string(), other.string());
  for (const fs::path& run : a.runs) require_evaluated(RunFolder::open(run));
  const fs::path out = a.out.empty() ? default_folder(first, other) : a.out;
  if (fs::exists(out / "plan.json", none))
    throw ConfigError(
        "--out", "",
        fmt::format(
            "found {}, which is a run's own folder, allowed: another one. The comparison would "
            "stand among what the run has made.",
            out.string()));
  require_writable(out, "the comparison", "--out");
  const std::unique_ptr<PdfPrinter> printer = a.no_pdf ? nullptr : std::make_unique<PdfPrinter>();
  const Compared one = compared(first), two = compared(other);
  const Plan &plan = one.run.record.plan, &other_plan = two.run.record.plan;
  const RunComparison comparison =
      compare_runs(one.run.evaluation, plan, two.run.evaluation, other_plan);
  if (comparison.scenarios.empty())
    throw ConfigError(
        other.string(), "",
        fmt::format(
            "has no attitude scenario in common with {}: found {}; there: {}. Scenarios are "
            "matched by name.",
            first.string(), scenario_names(other_plan), scenario_names(plan)));
  if (comparison.changes.empty())
    throw ConfigError(
        other.string(), "",
        fmt::format("was evaluated with none of the solvers of {}. Evaluate both with "
                    "the same, by --solver.",
                    first.string()));

  const fs::path page =
      write_comparison(out, {described(first, one.run), described(other, two.run)},
                       differences(one, two), comparison, printer.get());
  for (const CommonScenario& s : comparison.scenarios)
    fmt::print("{:<20} {} poses planned in both, {} only in A, {} only in B\n", s.name, s.both,
               s.only_first, s.only_other);
  std::size_t failed = 0;
  for (const RunChange& c : comparison.changes) {
    failed += c.first_failed + c.other_failed;
    if (c.verdict() == ChangeVerdict::kNothing) {
      fmt::print("{:<20} {:<18} not compared: {} poses of A and {} of B were measured\n",
                 c.scenario, c.solver->name, c.first_poses, c.other_poses);
      continue;
    }
    const bool has_interval = std::isfinite(c.change_deg.interval.lower);
    fmt::print("{:<20} {:<18} A {:.4f}  B {:.4f} deg  {:+.4f} [{}]{}\n", c.scenario, c.solver->name,
               c.first_rmse_deg, c.other_rmse_deg, c.change_deg.value,
               has_interval ? fmt::format("{:+.4f}, {:+.4f}", c.change_deg.interval.lower,
                                          c.change_deg.interval.upper)
                            : "too few poses for an interval",
               has_interval ? fmt::format("  B is {}", change_verdict_name(c.verdict())) : "");
  }
  for (const auto& [name, run] : {std::pair("A", &one.run), std::pair("B", &two.run)})
    if (!run->record.complete())
      spdlog::warn("{} ended early: {} of {} planned poses were taken.", name,
                   run->record.poses.size(), run->record.plan.poses.size());
  if (failed > 0)
    spdlog::warn(
        "{} results are missing, of poses that failed or were never taken; the report of each run "
        "says which and why.",
        failed);
  renew_pdf(out / "comparison.md", printer.get());
  fmt::print("comparison: {}\n", page.string());
  return failed > 0 ? kFailedPoses : kDone;
}

}  // namespace turntable
