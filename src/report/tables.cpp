#include "src/report/tables.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "src/evaluation/scenario_statistics.h"
#include "src/imaging/monomial_table.h"
#include "src/record/atomic_file.h"
#include "src/record/csv.h"
#include "src/record/folder.h"
#include "src/report/budget_tables.h"
#include "src/report/level_tables.h"
#include "src/report/noise_report.h"
#include "src/report/published.h"

namespace turntable {
namespace {

struct Row {
  std::string method;
  std::vector<Cell> cells;
};

/// Published values have three decimals, and no count of poses.
Row published_row(const PublishedRow& p) {
  Row row{p.method, {"published", p.method, {}, std::int64_t{p.repeat}}};
  for (const double v : {p.max_pitch_deg, p.max_roll_deg, p.max_yaw_deg, p.rmse_pitch_deg,
                         p.rmse_roll_deg, p.rmse_yaw_deg, p.rmse_total_deg})
    row.cells.emplace_back(Rounded{v, 3});
  row.cells.resize(row.cells.size() + 2);
  return row;
}

Row our_row(const RepeatStatistics& r, const std::string& scenario, int repeat) {
  const ErrorStatistics& s = r.statistics;
  Row row{std::string(r.solver->name),
          {"ours", std::string(r.solver->name), scenario, std::int64_t{repeat},
           s.pitch.max_signed_deg, s.roll.max_signed_deg, s.yaw.max_signed_deg, s.pitch.rmse_deg,
           s.roll.rmse_deg, s.yaw.rmse_deg, s.rmse_total_deg, static_cast<std::int64_t>(s.poses),
           static_cast<std::int64_t>(s.failed)}};
  return row;
}

/// The form of Tables 3 to 5.
Table errors_table(const std::string& name, const std::string& title, bool of_several,
                   const std::vector<Row>& rows) {
  Table table{name,
              title,
              {{"source", "source"},
               {"method", "method"},
               {"scenario", of_several ? "scenario" : ""},
               {"repeat", "repeat"},
               {"max_pitch_deg", "max pitch / deg"},
               {"max_roll_deg", "max roll / deg"},
               {"max_yaw_deg", "max yaw / deg"},
               {"rmse_pitch_deg", "RMSE pitch / deg"},
               {"rmse_roll_deg", "RMSE roll / deg"},
               {"rmse_yaw_deg", "RMSE yaw / deg"},
               {"rmse_total_deg", "total RMSE / deg"},
               {"poses", "poses"},
               {"failed", "failed"}},
              {}};
  for (const Row& row : rows) table.rows.push_back(row.cells);
  return table;
}

WrittenTable write_table1(const RunFolder& folder, const Calibration& calibration) {
  // v counted upward, as in the published table; see the frames in scenarios/rigs/README.md.
  const PublishedCoefficients& published = published_coefficients();
  const std::vector<MonomialTable> tables{
      {"ours", calibration.irt.order(), calibration.irt.monomials(VDirection::kUp)},
      {"published", published.order, published.monomials}};
  const std::string md = monomials_to_markdown(tables);
  const std::string title = fmt::format(
      "Table 1: coefficients of the two planes (ours: order {}, planes at {:.3f} mm and {:.3f} mm; "
      "published: {:.0f} mm "
      "and {:.0f} mm; raw pixels, v counted upward)",
      calibration.irt.order(), calibration.irt.planes().a_mm, calibration.irt.planes().b_mm,
      published.plane_a_mm, published.plane_b_mm);
  write_atomically(folder.tables() / "table1.csv", monomials_to_csv(tables));
  write_atomically(folder.tables() / "table1.tex", monomials_to_latex(tables));
  write_atomically(folder.tables() / "table1.md", fmt::format("# {}\n\n{}", title, md));
  return {"table1", title, md};
}

/// Tables beside table1 and those of errors. An evaluation may lack some of them.
constexpr std::array<std::string_view, 11> kNotOfErrors{
    "camera_solver", "statistics",   "paired",     "repeatability",
    "iso230",        "levels",       "identified", "identified_correlation",
    "budget",        "budget_found", "noise"};

/// A scenario may be called what it likes; "table3" or "statistics" without being it must not look like
/// it.
std::string own_table_name(const std::string& scenario) {
  const bool taken = scenario.starts_with("table") || scenario.starts_with("scenario_") ||
                     std::ranges::find(kNotOfErrors, scenario) != kNotOfErrors.end();
  return taken ? "scenario_" + scenario : scenario;
}

std::int64_t whole(std::size_t count) { return static_cast<std::int64_t>(count); }

/// What the camera model gains and what the solver gains, one group of rows per rig and camera.
Table camera_solver_table(const std::vector<CameraComparison>& comparisons) {
  Table table{"camera_solver",
              "Camera model and solver: which of the two gains what",
              {{"run", comparisons.size() > 1 ? "Run" : ""},  // 1 = this run
               {"", comparisons.size() > 1 ? "Rig" : ""},
               {"camera", "Camera"},
               {"solver", "Solver"},
               {"poses", "Poses"},
               {"failed", "Failed"},
               {"rmse_total_deg", "Total RMSE / deg [95 %]"},
               {"change_from_posit_deg", "Change against POSIT, same camera / deg [95 %]"},
               {"camera_before", "Camera before"},
               {"change_from_camera_before_deg", "Change against it, same solver / deg [95 %]"}},
              {}};
  std::int64_t run = 0;
  for (const CameraComparison& c : comparisons) {
    ++run;
    for (std::size_t k = 0; k < c.cells.size(); ++k) {
      const CameraSolverCell& cell = c.cells[k];
      Cell before;
      if (k >= c.solvers.size()) before = c.cells[k - c.solvers.size()].camera;
      table.rows.push_back({run, c.rig, cell.camera, std::string(cell.solver->name),
                            whole(cell.poses), whole(cell.failed), cell.rmse_deg,
                            cell.from_first_solver_deg, before, cell.from_camera_before_deg});
    }
  }
  return table;
}

/// (level, row) of every level, one after the other.
template <class Row>
std::vector<std::pair<std::string, Row>> rows_of(const std::vector<LevelStatistics>& levels,
                                                 std::vector<Row> LevelStatistics::*rows) {
  std::vector<std::pair<std::string, Row>> out;
  for (const LevelStatistics& level : levels)
    for (const Row& row : level.*rows) out.emplace_back(truth_level_name(level.level), row);
  return out;
}

/// Bias and spread apart, percentiles, and what is left of the total by chance.
Table statistics_table(const std::vector<LevelStatistics>& levels, const Plan& plan) {
  Table table{"statistics",
              "Errors of each scenario, all repeats together: bias (mean) and spread (standard "
              "deviation) apart, percentiles, 95 % intervals",
              {{"level", "level"},
               {"scenario", "scenario"},
               {"solver", "solver"},
               {"repeats", "repeats"},
               {"poses", "poses"},
               {"failed", "failed"},
               {"rmse_total_deg", "total RMSE [95 % interval] / deg"},
               {"bias_pitch_deg", "bias pitch / deg"},
               {"bias_roll_deg", "bias roll / deg"},
               {"bias_yaw_deg", "bias yaw / deg"},
               {"spread_pitch_deg", "spread pitch / deg"},
               {"spread_roll_deg", "spread roll / deg"},
               {"spread_yaw_deg", "spread yaw / deg"},
               {"percentile95_pitch_deg", "95 % of pitch below / deg"},
               {"percentile95_roll_deg", "95 % of roll below / deg"},
               {"percentile95_yaw_deg", "95 % of yaw below / deg"},
               {"geodesic_median_deg", "geodesic median / deg"},
               {"geodesic_percentile95_deg", "geodesic 95 % / deg"},
               {"geodesic_max_deg", "geodesic max / deg"}},
              {}};
  for (const auto& [level, s] : rows_of(levels, &LevelStatistics::scenarios)) {
    const ErrorStatistics& e = s.pooled;
    table.rows.push_back({level, plan.scenarios[s.scenario].name, std::string(s.solver->name),
                          std::int64_t{s.repeats}, whole(e.poses), whole(e.failed),
                          s.rmse_total_deg, e.pitch.mean_deg, e.roll.mean_deg, e.yaw.mean_deg,
                          e.pitch.standard_deviation_deg, e.roll.standard_deviation_deg,
                          e.yaw.standard_deviation_deg, s.axes[0].percentile95_deg,
                          s.axes[1].percentile95_deg, s.axes[2].percentile95_deg,
                          e.geodesic.median_deg, e.geodesic.percentile95_deg, e.geodesic.max_deg});
  }
  return table;
}

/// What the same angles give again, and whether it matters from where an axis came.
Table repeatability_table(const std::vector<LevelStatistics>& levels, const Plan& plan) {
  Table table{"repeatability",
              "Repeatability over repeats (standard deviation at the same angles, noise of the "
              "initial poses included), and mean error of poses come to from below minus from "
              "above",
              {{"level", "level"},
               {"scenario", "scenario"},
               {"solver", "solver"},
               {"repeats", "repeats"},
               {"repeatability_pitch_deg", "repeatability pitch / deg"},
               {"repeatability_roll_deg", "repeatability roll / deg"},
               {"repeatability_yaw_deg", "repeatability yaw / deg"},
               {"forward_minus_backward_pitch_deg", "forward - backward pitch / deg"},
               {"forward_minus_backward_roll_deg", "forward - backward roll / deg"},
               {"forward_minus_backward_yaw_deg", "forward - backward yaw / deg"}},
              {}};
  for (const auto& [level, s] : rows_of(levels, &LevelStatistics::scenarios)) {
    std::vector<Cell> row{level, plan.scenarios[s.scenario].name, std::string(s.solver->name),
                          std::int64_t{s.repeats}};
    for (const AxisDetail& a : s.axes) row.emplace_back(a.repeatability_deg);
    for (const AxisDetail& a : s.axes) row.emplace_back(a.forward_minus_backward_deg);
    table.rows.push_back(std::move(row));
  }
  return table;
}

Table paired_table(const std::vector<LevelStatistics>& levels, const Plan& plan) {
  Table table{"paired",
              "Is one solver better than another? Change of the total RMSE from the first to the "
              "other over the same poses, 95 % interval",
              {{"level", "level"},
               {"scenario", "scenario"},
               {"first", "first"},
               {"other", "other"},
               {"poses", "poses of both"},
               {"only_first", "only first"},
               {"only_other", "only other"},
               {"change_deg", "change [95 % interval] / deg"},
               {"share_other_nearer", "share of poses where the other is nearer", 2},
               {"verdict", "the other is"}},
              {}};
  for (const auto& [level, c] : rows_of(levels, &LevelStatistics::pairs)) {
    table.rows.push_back({level, plan.scenarios[c.scenario].name, std::string(c.first->name),
                          std::string(c.other->name), whole(c.poses), whole(c.only_first),
                          whole(c.only_other), c.change_deg, c.share_other_nearer,
                          std::string(change_verdict_name(c.verdict()))});
  }
  return table;
}

Table iso230_table(const std::vector<Iso230>& rows, const Plan& plan) {
  Table table{"iso230",
              "Quantities of ISO 230-2 for scenarios that turn one axis: the measured against the "
              "turntable's angle (the standard asks for five approaches from each side)",
              {{"scenario", "scenario"},
               {"solver", "solver"},
               {"axis", "axis"},
               {"positions", "positions"},
               {"approaches", "approaches"},
               {"directions", "directions"},
               {"accuracy_deg", "A / deg"},
               {"systematic_deg", "E / deg"},
               {"mean_range_deg", "M / deg"},
               {"repeatability_deg", "R / deg"},
               {"reversal_deg", "B / deg"}},
              {}};
  for (const Iso230& i : rows)
    table.rows.push_back({plan.scenarios[i.scenario].name, std::string(i.solver->name),
                          std::string(axis_name(i.axis)), whole(i.positions),
                          std::int64_t{i.approaches}, std::int64_t{i.bidirectional ? 2 : 1},
                          i.accuracy_deg, i.systematic_deg, i.mean_range_deg, i.repeatability_deg,
                          i.reversal_deg});
  return table;
}

/// Tables 3 to 5, and one for each scenario that belongs to none of them.
void write_error_tables(const RunFolder& folder, const Plan& plan, const Evaluation& evaluation,
                        std::vector<WrittenTable>& written) {
  std::map<std::string, std::vector<Row>> ours;  // by table name
  std::map<std::string, std::string> titles;
  std::map<std::string, std::map<std::pair<std::size_t, int>, int>>
      numbers;                           // repeats numbered on over scenarios
  std::map<std::string, int> published;  // number of the published table, by table name
  std::map<std::string, std::vector<std::size_t>> scenarios;  // by table name
  std::vector<std::string> order{"table3", "table4", "table5"};
  for (const RepeatStatistics& r : repeat_statistics(evaluation)) {
    const ScenarioInfo& scenario = plan.scenarios[r.scenario];
    const std::string name =
        scenario.table ? fmt::format("table{}", *scenario.table) : own_table_name(scenario.name);
    if (scenario.table) published[name] = *scenario.table;
    titles[name] = scenario.table ? fmt::format("Table {}: {}", *scenario.table,
                                                published_table(*scenario.table).title)
                                  : scenario.title;
    if (auto& of = scenarios[name]; std::ranges::find(of, r.scenario) == of.end())
      of.push_back(r.scenario);
    auto& numbered = numbers[name];
    const int next = static_cast<int>(numbered.size()) + 1;
    const int repeat = numbered.try_emplace({r.scenario, r.repeat}, next).first->second;
    if (ours[name].empty() && !scenario.table) order.push_back(name);
    ours[name].push_back(our_row(r, scenario.name, repeat));
  }
  for (const std::string& name : order) {
    if (!ours.contains(name)) continue;
    std::vector<Row> rows;
    if (published.contains(name))
      for (const PublishedRow& p : published_table(published[name]).rows)
        rows.push_back(published_row(p));
    // By solver, then repeat, as the paper prints them.
    for (const Solver* solver : evaluation.solvers)
      for (const Row& r : ours[name])
        if (r.method == solver->name) rows.push_back(r);
    const std::vector<std::size_t>& of = scenarios[name];
    WrittenTable table =
        write_table(errors_table(name, titles[name], of.size() > 1, rows), folder.tables());
    if (published.contains(name)) {  // its title is the paper's, and tells the paper's motion
      std::string ours_are;
      for (const std::size_t s : of)
        ours_are += fmt::format("{}{}", ours_are.empty() ? "" : "; ",
                                markdown_text(plan.scenarios[s].title));
      table.markdown = fmt::format(
          "Ours: {}.{}\n\n{}", ours_are,
          of.size() > 1 ? " Repeats are numbered on from one to the next." : "", table.markdown);
    }
    written.push_back(std::move(table));
  }
}

/// Files have every level and pair; the report shows one level, which its text names.
std::string without_level(Table table) {
  table.columns.front().title.clear();
  return table_markdown(table);
}

void write_statistics(const RunFolder& folder, const Results& results,
                      std::vector<WrittenTable>& written) {
  const Plan& plan = results.plan();
  const auto write = [&](const Table& table, const std::string& markdown) {
    if (table.rows.empty()) return;
    written.push_back(write_table(table, folder.tables()));
    written.back().markdown = markdown;
  };
  LevelStatistics shown = results.statistics.front();
  write(statistics_table(results.statistics, plan), without_level(statistics_table({shown}, plan)));
  if (!results.evaluation.solvers.empty())
    std::erase_if(shown.pairs, [&](const PairedComparison& c) {
      return c.first != results.evaluation.solvers.front();
    });
  write(paired_table(results.statistics, plan), without_level(paired_table({shown}, plan)));
  const auto tells_nothing = [](const ScenarioStatistics& s) {
    return std::ranges::none_of(s.axes, [](const AxisDetail& a) {
      return std::isfinite(a.repeatability_deg) ||
             std::isfinite(a.forward_minus_backward_deg.value);
    });
  };
  std::erase_if(shown.scenarios, tells_nothing);
  std::vector<LevelStatistics> telling = results.statistics;
  for (LevelStatistics& level : telling) std::erase_if(level.scenarios, tells_nothing);
  write(repeatability_table(telling, plan), without_level(repeatability_table({shown}, plan)));
  const Table iso = iso230_table(iso230(results.evaluation, plan), plan);
  write(iso, table_markdown(iso));
}

}  // namespace

std::vector<WrittenTable> write_tables(const RunFolder& folder, const Results& results) {
  const Plan& plan = results.plan();
  make_folder(folder.tables());
  std::vector<WrittenTable> written{write_table1(folder, results.calibration)};
  write_error_tables(folder, plan, results.evaluation, written);
  const std::vector<CameraComparison>& cameras = results.cameras;
  if (!cameras.empty() && !cameras.front().cells.empty() && cameras.front().cells.front().poses > 0)
    written.push_back(write_table(camera_solver_table(cameras), folder.tables()));
  write_statistics(folder, results, written);
  for (WrittenTable& table : write_level_tables(folder, plan, results.levels))
    written.push_back(std::move(table));
  for (WrittenTable& table : write_budget_tables(folder, plan, results.budgets))
    written.push_back(std::move(table));
  if (results.noise) written.push_back(write_noise_table(folder, *results.noise));
  // An earlier evaluation may have had more: other solvers, or noise.
  for (const std::string_view name : kNotOfErrors)
    if (find_table(written, name == "identified_correlation" ? "identified" : name) == nullptr)
      remove_files(folder.tables(), name, {".csv", ".md", ".tex"});
  return written;
}

}  // namespace turntable
