#include "src/report/level_tables.h"

#include <fmt/format.h>

#include <algorithm>

#include "src/record/atomic_file.h"
#include "src/record/csv.h"
#include "src/record/folder.h"

namespace turntable {
namespace {

/// Digits that a rig file would have.
int decimals_of(const RigParameter& parameter) { return parameter.unit == "1" ? 7 : 4; }

const LevelBound& bound_of(const CrossValidation& judged, const LevelRow& row) {
  return *std::ranges::find(judged.bounds, row.scenario, &LevelBound::scenario);
}

/// A row for each level.
Table levels_long(const Plan& plan, const CrossValidation& judged) {
  Table table{"levels",
              "",
              {{"scenario", ""},
               {"solver", ""},
               {"level", ""},
               {"poses", ""},
               {"failed", ""},
               {"left_out", ""},
               {"rmse_pitch_deg", ""},
               {"rmse_roll_deg", ""},
               {"rmse_yaw_deg", ""},
               {"rmse_total_deg", ""},
               {"bound_pitch_deg", ""},
               {"bound_roll_deg", ""},
               {"bound_yaw_deg", ""},
               {"bound_total_deg", ""},
               {"bound_with_repeatability_deg", ""}},
              {}};
  for (const LevelRow& row : judged.rows) {
    const LevelBound& bound = bound_of(judged, row);
    const ErrorStatistics& s = row.statistics;
    table.rows.push_back(
        {plan.scenarios[row.scenario].name, std::string(row.solver->name),
         std::string(truth_level_name(row.level)), static_cast<std::int64_t>(s.poses),
         static_cast<std::int64_t>(s.failed), static_cast<std::int64_t>(bound.left_out),
         s.pitch.rmse_deg, s.roll.rmse_deg, s.yaw.rmse_deg, s.rmse_total_deg, bound.pitch_deg,
         bound.roll_deg, bound.yaw_deg, bound.total_deg, bound.total_with_repeatability_deg});
  }
  return table;
}

/// The levels of one solver side by side, in their order: totals.
Table levels_shown(const Plan& plan, const CrossValidation& judged) {
  Table table{"levels",
              "Three levels of truth: total RMSE on held-out poses, deg",
              {{"scenario", "scenario"},
               {"solver", "solver"},
               {"poses", "poses"},
               {"failed", "failed"},
               {"published_deg", "as published"},
               {"aligned_deg", "aligned"},
               {"self_calibrated_deg", "self-calibrated"},
               {"bound_deg", "bound"},
               {"bound_with_repeatability_deg", "bound with repeatability"}},
              {}};
  for (const LevelRow& row : judged.rows) {
    const ErrorStatistics& s = row.statistics;
    if (row.level == TruthLevel::kPublished)
      table.rows.push_back({plan.scenarios[row.scenario].name, std::string(row.solver->name),
                            static_cast<std::int64_t>(s.poses),
                            static_cast<std::int64_t>(s.failed)});
    table.rows.back().emplace_back(s.rmse_total_deg);
    if (row.level != TruthLevel::kSelfCalibrated) continue;
    const LevelBound& bound = bound_of(judged, row);
    table.rows.back().emplace_back(bound.total_deg);
    table.rows.back().emplace_back(bound.total_with_repeatability_deg);
  }
  return table;
}

Table identified_table(const RigModel& model, const SelfCalibration& found) {
  Table table{"identified",
              "The rig, identified",
              {{"parameter", ""},
               {"", "parameter"},
               {"unit", "unit"},
               {"drawing", "drawing"},
               {"estimate", "estimate"},
               {"uncertainty", "uncertainty"},
               {"prior_uncertainty", "prior"},
               {"prior_source", "from"},
               {"verdict", "verdict"}},
              {}};
  for (int i = 0; i < model.size(); ++i) {
    const RigParameter& p = model.parameters()[static_cast<std::size_t>(i)];
    const auto number = [&](double value) { return Rounded{value, decimals_of(p)}; };
    table.rows.push_back({p.name, p.what, p.unit, number(p.drawing), number(found.values(i)),
                          number(found.sd(i)), number(p.prior.sd), p.prior.source,
                          std::string(verdict_name(found.verdicts[static_cast<std::size_t>(i)]))});
  }
  return table;
}

void write_correlation(const RunFolder& folder, const RigModel& model,
                       const SelfCalibration& found) {
  std::vector<std::string> header{"parameter"};
  for (const RigParameter& p : model.parameters()) header.push_back(p.name);
  Csv csv(header);
  for (int i = 0; i < model.size(); ++i) {
    csv.text(model.parameters()[static_cast<std::size_t>(i)].name);
    for (int k = 0; k < model.size(); ++k) csv.number(found.correlation(i, k), 3);
    csv.end_row();
  }
  csv.write(folder.tables() / "identified_correlation.csv");
}

/// What chi square made of the noise of the spots.
std::string noise_text(const SelfCalibration& found) {
  if (found.noise_factor == 1.0) return {};
  if (!found.noise_stated)
    return fmt::format(
        " with spots of {:g} px, which they do not state; {:.2f} times that is taken",
        kAssumedSpotSigmaPx, found.noise_factor);
  return fmt::format(
      " with the noise that the spots state; {:.2f} times that is taken, at which it is one (the "
      "errors of arrivals, whose tolerances stay, are estimated anew each time and take less then)",
      found.noise_factor);
}

}  // namespace

std::string identified_markdown(const RigModel& model, const SelfCalibration& found) {
  return table_markdown(identified_table(model, found));
}

std::vector<WrittenTable> write_level_tables(const RunFolder& folder, const Plan& plan,
                                             const TruthLevels& levels) {
  make_folder(folder.tables());
  std::vector<WrittenTable> written;
  if (!levels.judged.rows.empty())
    written.push_back(write_table(levels_long(plan, levels.judged),
                                  levels_shown(plan, levels.judged), folder.tables()));
  if (levels.model) {
    written.push_back(write_table(identified_table(*levels.model, levels.found), folder.tables()));
    write_correlation(folder, *levels.model, levels.found);
  }
  return written;
}

std::string levels_text(const std::vector<WrittenTable>& written, const TruthLevels& levels) {
  std::string md = "## Three levels of truth\n\n";
  if (!levels.why_not.empty()) md += fmt::format("Not for this run: {}\n\n", levels.why_not);
  for (const WrittenTable& table : written) {
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
    } else if (table.name == "identified") {
      const SelfCalibration& found = levels.found;
      md += fmt::format(
          "### {}\n\n"
          "From {} poses, with {} errors of arrivals beside these parameters; {} iterations{}. Chi "
          "square per degree of freedom {:.3f}{}.{} Each estimate starts from its drawing and the "
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
          found.converged ? "" : ", **not converged**", found.chi2 / found.dof, noise_text(found),
          found.has_misfit() ? fmt::format(" **{}**", misfit_text(found)) : "",
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

std::string misfit_text(const SelfCalibration& found) {
  if (!found.has_misfit()) return {};
  return fmt::format(
      "The rig model does not explain this run: its residuals are {:.1f} times the stated noise of "
      "the spots. Something that no parameter describes is larger, as a periodic error of an axis "
      "or a stage that bends; compare the self-calibrated errors of the scenarios, and trust "
      "parameters and uncertainties with care.",
      found.noise_factor);
}

}  // namespace turntable
