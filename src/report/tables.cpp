#include "src/report/tables.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "src/imaging/monomial_table.h"
#include "src/record/atomic_file.h"
#include "src/record/csv.h"
#include "src/report/published.h"

namespace turntable {
namespace {

struct Row {
  std::string source, method;
  int repeat;
  double max_pitch, max_roll, max_yaw, rmse_pitch, rmse_roll, rmse_yaw, rmse_total;
  std::optional<std::size_t> poses, failed;  ///< not published
};

Row published_row(const PublishedRow& p) {
  return {"published",
          p.method,
          p.repeat,
          p.max_pitch_deg,
          p.max_roll_deg,
          p.max_yaw_deg,
          p.rmse_pitch_deg,
          p.rmse_roll_deg,
          p.rmse_yaw_deg,
          p.rmse_total_deg,
          {},
          {}};
}

Row our_row(const RepeatStatistics& r, int repeat) {
  const ErrorStatistics& s = r.statistics;
  return {"ours",
          std::string(r.solver->name),
          repeat,
          s.pitch.max_signed_deg,
          s.roll.max_signed_deg,
          s.yaw.max_signed_deg,
          s.pitch.rmse_deg,
          s.roll.rmse_deg,
          s.yaw.rmse_deg,
          s.rmse_total_deg,
          s.poses,
          s.failed};
}

/// Published values have three decimals; ours may be smaller than their last digit.
constexpr int kDecimals = 4;

std::string cell(double value, const std::string& source) {
  if (!std::isfinite(value)) return "-";
  return fixed(value, source == "published" ? 3 : kDecimals);
}

WrittenTable write(const RunFolder& folder, const std::string& name, const std::string& title,
                   const std::vector<Row>& rows) {
  Csv csv({"source", "method", "repeat", "max_pitch_deg", "max_roll_deg", "max_yaw_deg",
           "rmse_pitch_deg", "rmse_roll_deg", "rmse_yaw_deg", "rmse_total_deg", "poses", "failed"});
  std::string md =
      "| source | method | repeat | max pitch / deg | max roll / deg | max yaw / deg | RMSE pitch "
      "/ deg | RMSE roll / "
      "deg | RMSE yaw / deg | total RMSE / deg | poses | failed |\n"
      "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n";
  for (const Row& r : rows) {
    const int decimals = r.source == "published" ? 3 : 6;
    csv.text(r.source).text(r.method).integer(r.repeat);
    md += fmt::format("| {} | {} | {} |", r.source, r.method, r.repeat);
    for (const double v : {r.max_pitch, r.max_roll, r.max_yaw, r.rmse_pitch, r.rmse_roll,
                           r.rmse_yaw, r.rmse_total}) {
      csv.number(v, decimals);
      md += fmt::format(" {} |", cell(v, r.source));
    }
    for (const auto& count : {r.poses, r.failed}) {
      if (count)
        csv.integer(static_cast<std::int64_t>(*count));
      else
        csv.empty();
      md += count ? fmt::format(" {} |", *count) : " |";
    }
    csv.end_row();
    md += "\n";
  }
  csv.write(folder.tables() / (name + ".csv"));
  write_atomically(folder.tables() / (name + ".md"), fmt::format("# {}\n\n{}", title, md));
  return {name, title, md};
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

/// What the camera model gains and what the solver gains, one group of rows per rig.
WrittenTable write_camera_solver_table(const RunFolder& folder,
                                       const std::vector<CameraComparison>& comparisons) {
  Csv csv({"run", "camera", "solver", "poses", "failed", "rmse_total_deg", "rmse_lower_deg",
           "rmse_upper_deg", "change_from_posit_deg", "change_from_posit_lower_deg",
           "change_from_posit_upper_deg", "change_from_camera_before_deg",
           "change_from_camera_before_lower_deg", "change_from_camera_before_upper_deg"});
  using Column = WithInterval CameraSolverCell::*;
  constexpr std::array<std::pair<Column, const char*>, 3> kParts{{
      {&CameraSolverCell::rmse_deg, "Total RMSE / deg [95 % interval]"},
      {&CameraSolverCell::from_first_solver_deg,
       "What the solver gains: change against POSIT with the same camera / deg"},
      {&CameraSolverCell::from_camera_before_deg,
       "What the camera gains: change against another camera with the same solver / deg"},
  }};
  std::string md;
  std::int64_t number = 0;  // 1 = this run
  for (const CameraComparison& c : comparisons) {
    ++number;
    if (comparisons.size() > 1) md += fmt::format("**{}**\n\n", c.rig);
    for (const auto& [column, title] : kParts) {
      const bool of_cameras = column == &CameraSolverCell::from_camera_before_deg;
      if (of_cameras && c.cameras.size() < 2) continue;
      md += fmt::format("{}:\n\n| camera |", title);
      std::string line = "|---|";
      for (const Solver* solver : c.solvers) {
        md += fmt::format(" {} |", solver->name);
        line += "--:|";
      }
      md += "\n" + line;
      for (std::size_t k = 0; k < c.cells.size(); ++k) {
        const CameraSolverCell& cell = c.cells[k];
        if (of_cameras && k < c.solvers.size()) continue;  // against nothing
        if (k % c.solvers.size() == 0)
          md += of_cameras ? fmt::format("\n| {} against {} |", cell.camera,
                                         c.cells[k - c.solvers.size()].camera)
                           : fmt::format("\n| {} |", cell.camera);
        const WithInterval& v = cell.*column;
        const bool is_change = column != &CameraSolverCell::rmse_deg;
        md += !std::isfinite(v.value) ? std::string(" - |")
              : is_change
                  ? fmt::format(" {:+.4f} [{:+.4f}, {:+.4f}] |", v.value, v.interval.lower,
                                v.interval.upper)
                  : fmt::format(" {:.4f} [{:.4f}, {:.4f}]{} |", v.value, v.interval.lower,
                                v.interval.upper,
                                cell.failed == 0
                                    ? ""
                                    : fmt::format(", {} of {} failed", cell.failed, cell.poses));
      }
      md += "\n\n";
    }
    for (const CameraSolverCell& cell : c.cells) {
      csv.integer(number).text(cell.camera).text(cell.solver->name);
      csv.integer(static_cast<std::int64_t>(cell.poses));
      csv.integer(static_cast<std::int64_t>(cell.failed));
      for (const auto& part : kParts) {
        const WithInterval& v = cell.*part.first;
        for (const double value : {v.value, v.interval.lower, v.interval.upper})
          csv.number(value, 6);
      }
      csv.end_row();
    }
  }
  const std::string title = "Camera model and solver: which of the two gains what";
  csv.write(folder.tables() / "camera_solver.csv");
  write_atomically(folder.tables() / "camera_solver.md", fmt::format("# {}\n\n{}", title, md));
  return {"camera_solver", title, md};
}

}  // namespace

std::vector<WrittenTable> write_tables(const RunFolder& folder, const Plan& plan,
                                       const Evaluation& evaluation, const Calibration& calibration,
                                       const std::vector<CameraComparison>& cameras) {
  std::filesystem::create_directories(folder.tables());
  std::vector<WrittenTable> written{write_table1(folder, calibration)};

  std::map<std::string, std::vector<Row>> ours;  // by table name
  std::map<std::string, std::string> titles;
  std::map<std::string, std::map<std::pair<std::size_t, int>, int>>
      numbers;                           // repeats numbered on over scenarios
  std::map<std::string, int> published;  // number of the published table, by table name
  std::vector<std::string> order{"table3", "table4", "table5"};
  for (const RepeatStatistics& r : repeat_statistics(evaluation)) {
    const ScenarioInfo& scenario = plan.scenarios[r.scenario];
    // A scenario may be called what it likes; "table3" without belonging to it must not look like
    // it.
    const std::string name = scenario.table ? fmt::format("table{}", *scenario.table)
                             : scenario.name.starts_with("table") ? "scenario_" + scenario.name
                                                                  : scenario.name;
    if (scenario.table) published[name] = *scenario.table;
    titles[name] = scenario.table ? fmt::format("Table {}: {}", *scenario.table,
                                                published_table(*scenario.table).title)
                                  : scenario.title;
    auto& numbered = numbers[name];
    const int next = static_cast<int>(numbered.size()) + 1;
    const int repeat = numbered.try_emplace({r.scenario, r.repeat}, next).first->second;
    if (ours[name].empty() && !scenario.table) order.push_back(name);
    ours[name].push_back(our_row(r, repeat));
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
    written.push_back(write(folder, name, titles[name], rows));
  }
  if (!cameras.empty() && !cameras.front().cells.empty() && cameras.front().cells.front().poses > 0)
    written.push_back(write_camera_solver_table(folder, cameras));
  return written;
}

}  // namespace turntable
