#include "src/report/compare_report.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "src/record/atomic_file.h"
#include "src/record/csv.h"
#include "src/record/folder.h"
#include "src/report/drawing.h"
#include "src/report/html_report.h"
#include "src/report/table.h"

namespace turntable {
namespace {

constexpr std::size_t kFactsToRead = 60;  ///< in the text; all are in the table's files

std::int64_t counted(std::size_t count) { return static_cast<std::int64_t>(count); }

WithInterval in_percent(const WithInterval& share) {
  return {100.0 * share.value, {100.0 * share.interval.lower, 100.0 * share.interval.upper}};
}

std::string_view poses_are(const RunChange& c) {
  return c.verdict() == ChangeVerdict::kNothing ? "missing" : c.paired ? "paired" : "not paired";
}

Table changes_table(const RunComparison& comparison) {
  Table table{"comparison",
              "What changed from A to B in the total RMSE, 95 % interval; below zero B is better",
              {{"scenario", "scenario"},
               {"solver", "solver"},
               {"poses", "poses are"},
               {"a_poses", "poses of A"},
               {"b_poses", "poses of B"},
               {"a_failed", "failed in A"},
               {"b_failed", "failed in B"},
               {"a_rmse_deg", "total RMSE of A / deg"},
               {"b_rmse_deg", "of B / deg"},
               {"change_deg", "change [95 % interval] / deg"},
               {"change_percent", "change [95 %] / %", 1},
               {"verdict", "B is"}},
              {}};
  for (const RunChange& c : comparison.changes)
    table.rows.push_back({c.scenario, std::string(c.solver->name), std::string(poses_are(c)),
                          counted(c.first_poses), counted(c.other_poses), counted(c.first_failed),
                          counted(c.other_failed), c.first_rmse_deg, c.other_rmse_deg, c.change_deg,
                          in_percent(c.change_share),
                          std::string(change_verdict_name(c.verdict()))});
  return table;
}

Table bias_table(const RunComparison& comparison) {
  Table table{"bias",
              "What changed from A to B in the mean errors (bias), 95 % intervals",
              {{"scenario", "scenario"},
               {"solver", "solver"},
               {"bias_change_pitch_deg", "pitch / deg"},
               {"bias_change_roll_deg", "roll / deg"},
               {"bias_change_yaw_deg", "yaw / deg"}},
              {}};
  for (const RunChange& c : comparison.changes) {
    std::vector<Cell> row{c.scenario, std::string(c.solver->name)};
    for (const WithInterval& bias : c.bias_change_deg) row.emplace_back(bias);
    table.rows.push_back(std::move(row));
  }
  return table;
}

Table facts_table(const std::vector<RunFact>& facts) {
  Table table{"differences",
              "What differs between the runs",
              {{"what", "what"}, {"place", "place"}, {"a", "A"}, {"b", "B"}},
              {}};
  for (const RunFact& f : facts) table.rows.push_back({f.what, f.place, f.first, f.other});
  return table;
}

Table scenarios_table(const RunComparison& comparison) {
  Table table{"scenarios",
              "Poses to be judged, matched by repeat and planned angles",
              {{"scenario", "scenario"},
               {"both", "in both"},
               {"only_a", "only in A"},
               {"only_b", "only in B"}},
              {}};
  for (const CommonScenario& s : comparison.scenarios)
    table.rows.push_back({s.name, counted(s.both), counted(s.only_first), counted(s.only_other)});
  return table;
}

/// Change in percent of A's RMSE with its interval, a line per scenario and solver.
Draft change_figure(const std::filesystem::path& folder, const RunComparison& comparison) {
  Csv csv({"line", "label", "solver", "change_percent", "lower_percent", "upper_percent"});
  std::vector<const Solver*> solvers;
  std::size_t line = 0;
  for (const RunChange& c : comparison.changes) {
    if (std::ranges::find(solvers, c.solver) == solvers.end()) solvers.push_back(c.solver);
    ++line;
    if (!std::isfinite(c.change_share.interval.lower)) continue;
    csv.integer(counted(line)).text(fmt::format("{} {}", c.scenario, c.solver->name));
    const WithInterval percent = in_percent(c.change_share);
    csv.text(c.solver->name).number(percent.value, 3);
    csv.number(percent.interval.lower, 3).number(percent.interval.upper, 3).end_row();
  }
  Draft draft;
  draft.figure.name = "comparison_change";
  draft.figure.caption =
      "Change of the total RMSE from A to B, in percent of A's, with 95 % intervals: left of zero "
      "B "
      "is better.";
  draft.size = fmt::format("900,{}", 120 + 18 * line);
  draft.commands = fmt::format(
      "set yrange [{}:0.4] \nset xlabel 'change of the total RMSE / %'\nset key off\n"
      "set ytics font ',10'\nset arrow 1 from 0, graph 0 to 0, graph 1 nohead lc rgb '#444444'\n"
      "set offsets graph 0.05, graph 0.05, 0, 0\n",
      fixed(static_cast<double>(line) + 0.6, 1));
  for (std::size_t k = 0; k < solvers.size(); ++k)
    draft.element(fmt::format("'DATA' every ::1 using (strcol(3) eq '{}' ? $4 : 1/0):1:5:6:"
                              "yticlabels(2) with xerrorbars ps 0.8 lw 1.5 {}",
                              solvers[k]->name, solver_look(*solvers[k], k)),
                  {std::string(solvers[k]->name), {}});
  draft.end_plot();
  csv.write(folder / (draft.figure.name + ".csv"));
  return draft;
}

std::string glance(const RunComparison& comparison) {
  const auto number = [&](ChangeVerdict verdict) {
    return std::ranges::count(comparison.changes, verdict, &RunChange::verdict);
  };
  std::size_t unpaired = 0;
  for (const RunChange& c : comparison.changes)
    unpaired += !c.paired && c.verdict() != ChangeVerdict::kNothing;
  const auto nothing = number(ChangeVerdict::kNothing), too_few = number(ChangeVerdict::kTooFew);
  return fmt::format(
      "**Of {} comparisons (scenario and solver) B is better in {}, worse in {}, the same within 1 "
      "% "
      "in {}; {} are not told apart.**{}{}{} With many comparisons some intervals miss zero by "
      "chance: "
      "about one in twenty.\n\n",
      comparison.changes.size(), number(ChangeVerdict::kBetter), number(ChangeVerdict::kWorse),
      number(ChangeVerdict::kSame), number(ChangeVerdict::kCannotTell),
      nothing == 0
          ? ""
          : fmt::format(" In {} of them a run has measured no pose: nothing is compared.", nothing),
      too_few == 0
          ? ""
          : fmt::format(" In {} of them there are too few poses for an interval.", too_few),
      unpaired == 0
          ? ""
          : fmt::format(
                " In {} of them fewer than half of the poses have a partner in the other run: "
                "they are compared without pairs.",
                unpaired));
}

}  // namespace

std::filesystem::path write_comparison(const std::filesystem::path& folder,
                                       const std::array<ComparedRun, 2>& runs,
                                       const std::vector<RunFact>& facts,
                                       const RunComparison& comparison, PdfPrinter* printer) {
  for (const char* part : {"tables", "figures"}) make_folder(folder / part);
  const WrittenTable changes = write_table(changes_table(comparison), folder / "tables");
  const WrittenTable scenarios = write_table(scenarios_table(comparison), folder / "tables");
  const WrittenTable bias = write_table(bias_table(comparison), folder / "tables");
  const Table all_facts = facts_table(facts);
  write_table(all_facts, folder / "tables");
  const std::vector<Figure> figures =
      draw(folder / "figures", {change_figure(folder / "figures", comparison)});

  const auto& [a, b] = runs;
  std::string md = fmt::format("# {} and {}\n\n", markdown_text(a.name), markdown_text(b.name));
  for (const auto& [letter, run] : {std::pair('A', &a), std::pair('B', &b)})
    md += fmt::format("{} is {}{}, begun {}, in {}. ", letter, markdown_text(run->name),
                      run->simulated ? " (simulated)" : "",
                      run->began_utc.empty() ? "nobody knows when" : run->began_utc,
                      markdown_text(run->folder));
  md += "\n\n";
  md += glance(comparison);
  md += "## What differs\n\n";
  if (facts.empty()) {
    md += "Nothing: rig, scenarios, calibration and program are the same.\n\n";
  } else {
    Table shown = all_facts;
    if (shown.rows.size() > kFactsToRead) shown.rows.resize(kFactsToRead);
    md += table_markdown(shown);
    if (facts.size() > kFactsToRead)
      md += fmt::format("\n{} more are in [the table](tables/differences.csv).\n",
                        facts.size() - kFactsToRead);
    md += "\n";
  }
  md +=
      "## Errors\n\n" + changes.title + ".\n\n" + changes.markdown +
      "\nPoses are those that the RMSEs are over: paired, those that both runs have measured. "
      "Failed ones are counted and in no RMSE. Intervals come from drawing angles again; what all "
      "poses of a run share, as the error of its calibration and of its initial poses, is in no "
      "interval: a change that is told apart is one of these two runs, and not yet one of what was "
      "changed.\n\n";
  md += "### Bias\n\n" + bias.title + ".\n\n" + bias.markdown + "\n";
  md += "## Poses\n\n" + scenarios.title + ".\n\n" + scenarios.markdown + "\n";
  for (const auto& [name, only] :
       {std::pair("A", &comparison.only_first), std::pair("B", &comparison.only_other)})
    if (!only->empty()) md += fmt::format("Only in {}: {}.\n\n", name, fmt::join(*only, ", "));
  md += "## Figures\n\n" + figures_markdown(figures);
  write_atomically(folder / "comparison.md", md);
  if (printer != nullptr) printer->load(page_for_paper(folder / "comparison.md"));
  return write_html(folder / "comparison.md", figures);
}

}  // namespace turntable
