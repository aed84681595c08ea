#include "src/report/level_tables.h"

#include <fmt/format.h>

#include <algorithm>

#include "src/record/atomic_file.h"
#include "src/record/csv.h"

namespace turntable {
namespace {

constexpr int kLevelDecimals = 4;  // deg

/// Digits that a rig file would have.
int decimals_of(const RigParameter& parameter) { return parameter.unit == "1" ? 7 : 4; }

const LevelBound& bound_of(const CrossValidation& judged, const LevelRow& row) {
  return *std::ranges::find(judged.bounds, row.scenario, &LevelBound::scenario);
}

WrittenTable write_levels(const RunFolder& folder, const Plan& plan,
                          const CrossValidation& judged) {
  Csv csv({"scenario", "solver", "level", "poses", "failed", "left_out", "rmse_pitch_deg",
           "rmse_roll_deg", "rmse_yaw_deg", "rmse_total_deg", "bound_pitch_deg", "bound_roll_deg",
           "bound_yaw_deg", "bound_total_deg", "bound_with_repeatability_deg"});
  std::string md =
      "| scenario | solver | poses | failed | as published | aligned | self-calibrated | bound | "
      "bound "
      "with repeatability |\n|---|---|--:|--:|--:|--:|--:|--:|--:|\n";
  for (const LevelRow& row : judged.rows) {
    const LevelBound& bound = bound_of(judged, row);
    const ErrorStatistics& s = row.statistics;
    const std::string& scenario = plan.scenarios[row.scenario].name;
    csv.text(scenario).text(row.solver->name).text(truth_level_name(row.level));
    csv.integer(static_cast<std::int64_t>(s.poses)).integer(static_cast<std::int64_t>(s.failed));
    csv.integer(static_cast<std::int64_t>(bound.left_out));
    for (const double value :
         {s.pitch.rmse_deg, s.roll.rmse_deg, s.yaw.rmse_deg, s.rmse_total_deg, bound.pitch_deg,
          bound.roll_deg, bound.yaw_deg, bound.total_deg, bound.total_with_repeatability_deg})
      csv.number(value, kLevelDecimals);
    // The levels of one solver stand side by side, in their order.
    if (row.level == TruthLevel::kPublished)
      md += fmt::format("| {} | {} | {} | {} |", scenario, row.solver->name, s.poses, s.failed);
    md += fmt::format(" {} |", fixed(s.rmse_total_deg, kLevelDecimals));
    if (row.level == TruthLevel::kSelfCalibrated)
      md += fmt::format(" {} | {} |\n", fixed(bound.total_deg, kLevelDecimals),
                        fixed(bound.total_with_repeatability_deg, kLevelDecimals));
    csv.end_row();
  }
  const std::string title = "Three levels of truth: total RMSE on held-out poses, deg";
  csv.write(folder.tables() / "levels.csv");
  write_atomically(folder.tables() / "levels.md", fmt::format("# {}\n\n{}", title, md));
  return {"levels", title, md};
}

WrittenTable write_identified(const RunFolder& folder, const RigModel& model,
                              const SelfCalibration& found) {
  Csv csv({"parameter", "unit", "drawing", "estimate", "uncertainty", "prior_uncertainty",
           "prior_source", "verdict"});
  std::vector<std::string> header{"parameter"};
  for (const RigParameter& p : model.parameters()) header.push_back(p.name);
  Csv correlation(header);
  for (int i = 0; i < model.size(); ++i) {
    const RigParameter& p = model.parameters()[static_cast<std::size_t>(i)];
    const int decimals = decimals_of(p);
    csv.text(p.name).text(p.unit).number(p.drawing, decimals).number(found.values(i), decimals);
    csv.number(found.sd(i), decimals + 1).number(p.prior.sd, decimals + 1).text(p.prior.source);
    csv.text(verdict_name(found.verdicts[static_cast<std::size_t>(i)])).end_row();
    correlation.text(p.name);
    for (int k = 0; k < model.size(); ++k) correlation.number(found.correlation(i, k), 3);
    correlation.end_row();
  }
  const std::string title = "The rig, identified";
  const std::string md = identified_markdown(model, found);
  csv.write(folder.tables() / "identified.csv");
  correlation.write(folder.tables() / "identified_correlation.csv");
  write_atomically(folder.tables() / "identified.md", fmt::format("# {}\n\n{}", title, md));
  return {"identified", title, md};
}

}  // namespace

std::string identified_markdown(const RigModel& model, const SelfCalibration& found) {
  std::string md =
      "| parameter | unit | drawing | estimate | uncertainty | prior | from | verdict |\n"
      "|---|---|--:|--:|--:|--:|---|---|\n";
  for (int i = 0; i < model.size(); ++i) {
    const RigParameter& p = model.parameters()[static_cast<std::size_t>(i)];
    const int decimals = decimals_of(p);
    md += fmt::format("| {} | {} | {} | {} | {} | {} | {} | {} |\n", p.what,
                      p.unit == "1" ? "" : p.unit, fixed(p.drawing, decimals),
                      fixed(found.values(i), decimals), fixed(found.sd(i), decimals),
                      fixed(p.prior.sd, decimals), p.prior.source,
                      verdict_name(found.verdicts[static_cast<std::size_t>(i)]));
  }
  return md;
}

std::vector<WrittenTable> write_level_tables(const RunFolder& folder, const Plan& plan,
                                             const TruthLevels& levels) {
  std::filesystem::create_directories(folder.tables());
  std::vector<WrittenTable> written;
  if (!levels.judged.rows.empty()) written.push_back(write_levels(folder, plan, levels.judged));
  if (levels.model) written.push_back(write_identified(folder, *levels.model, levels.found));
  return written;
}

std::string levels_text(const RunFolder& folder, const Plan& plan, const TruthLevels& levels) {
  const std::vector<WrittenTable> tables = write_level_tables(folder, plan, levels);
  std::string md = "## Three levels of truth\n\n";
  if (!levels.why_not.empty()) md += fmt::format("Not for this run: {}\n\n", levels.why_not);
  for (const WrittenTable& table : tables) {
    if (table.name == "levels") {
      md += fmt::format(
          "An error is the difference of a measurement and the turntable, and the turntable is not "
          "where its drawing says. *As published* believes the drawing. *Aligned* turns the gimbal "
          "and the target as the measured attitudes themselves ask for, solver by solver. "
          "*Self-calibrated* estimates the whole rig from the images: mounting, axes, stage, and "
          "the "
          "places of the LEDs. What falls from one level to the next was the rig's error, not the "
          "solver's.\n\n"
          "All levels are judged on poses that had no part in the estimate: {} folds of {} "
          "arrivals "
          "of the outermost axis. *Bound* is what the noise of the spots alone leaves to any "
          "unbiased solver, this image and the initial one together (Cramer-Rao); beside it with "
          "the "
          "turntable's stated repeatability, which no solver can see through.\n\n{}\n",
          levels.judged.folds, levels.judged.groups, table.markdown);
    } else {
      const SelfCalibration& found = levels.found;
      md += fmt::format(
          "### {}\n\n"
          "From {} poses, with {} errors of arrivals beside these parameters; {} iterations{}. Chi "
          "square per degree of freedom {:.3f}{}. Each estimate starts from its drawing and the "
          "tolerance under \"prior\" (standard uncertainties). *Held*: the run does not determine "
          "it, so that the drawing stands. *Weakly determined*: run and drawing have both their "
          "say. "
          "LEDs that turn together about M0 look like a target turned on its table: tolerances "
          "alone "
          "tell the two apart, so that coordinates are weak one by one and strongly correlated, "
          "and no "
          "relative attitude depends on it. Uncertainties count spots, arrivals and tolerances, "
          "not the "
          "camera: its plane frame is where the pattern lay in its sweep, within the repeatability "
          "of "
          "that arrival, which is in mounting and squareness. {}\n\n{}\n",
          table.title, found.poses, found.arrivals, found.iterations,
          found.converged ? "" : ", **not converged**", found.chi2 / found.dof,
          found.noise_factor != 1.0
              ? fmt::format(": the noise of the spots counts {:.2f} times what is stated",
                            found.noise_factor)
              : "",
          levels.model->stage_made_frame() ? "The camera was calibrated on the stage, so that its "
                                             "rays lean with it: the stage's "
                                             "lean shows as a sheared target."
                                           : "The camera was calibrated elsewhere: the stage's "
                                             "lean shows only where it travels.",
          table.markdown);
    }
  }
  return md;
}

}  // namespace turntable
