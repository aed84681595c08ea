#include "src/report/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

#include "src/evaluation/clustered_bootstrap.h"
#include "src/record/atomic_file.h"
#include "src/record/csv.h"
#include "src/record/folder.h"
#include "src/record/run_journal.h"
#include "src/report/budget_tables.h"
#include "src/report/calibration_report.h"
#include "src/report/evaluation_figures.h"
#include "src/report/figures.h"
#include "src/report/html_report.h"
#include "src/report/level_tables.h"
#include "src/report/noise_report.h"
#include "src/report/pose_data.h"
#include "src/report/provenance_report.h"
#include "src/report/published.h"
#include "src/report/tables.h"
#include "src/report/time_report.h"

namespace turntable {
namespace {

std::string vector_text(const Vector3d& v) {
  return fmt::format("({:g}, {:g}, {:g})", v.x(), v.y(), v.z());
}

/// Everything that is wrong with the simulated rig on purpose, line by line.
std::string simulation_budget(const RigFile& rig) {
  const SimulationConfig& s = *rig.simulation;
  std::string md = "| what | amount |\n|---|---|\n";
  const auto row = [&](const std::string& what, const std::string& amount) {
    md += fmt::format("| {} | {} |\n", what, amount);
  };
  row("lens",
      fmt::format("focal length {:g} px, principal point ({:g}, {:g}) px, radial {:g} {:g} {:g}, "
                  "decentring "
                  "{:g} {:g}, sensor tilt ({:g}, {:g}) deg, pupil walk {:g} mm/rad^2",
                  s.lens.focal_px, s.lens.principal_point_px.x(), s.lens.principal_point_px.y(),
                  s.lens.radial[0], s.lens.radial[1], s.lens.radial[2], s.lens.decentring[0],
                  s.lens.decentring[1], s.lens.sensor_tilt_deg.x(), s.lens.sensor_tilt_deg.y(),
                  s.lens.pupil_walk_mm_per_rad2));
  row("camera pose", fmt::format("at {} mm, turned by {} deg", vector_text(s.camera_position_mm),
                                 vector_text(s.camera_rotation_deg)));
  row("image",
      fmt::format(
          "blur {:g} px, read noise {:g} grey, {}, 8 bit", s.image.blur_px, s.image.read_noise_grey,
          s.image.electrons_per_grey > 0
              ? fmt::format("shot noise of {:g} electrons per grey", s.image.electrons_per_grey)
              : "no shot noise"));
  for (const AxisId id : kAllAxes) {
    const AxisTruth& a = s.axes.at(id);
    const auto unit = axis_unit(id);
    row(fmt::format("{} axis", axis_name(id)),
        fmt::format("repeatability {:g} {} (2 sigma), lost motion {:g} {}, periodic error {:g} {}",
                    a.repeatability, unit, a.backlash, unit, a.worm_amplitude, unit));
  }
  row("stage squareness",
      fmt::format("({:g}, {:g}) deg", s.stage_squareness_deg.x(), s.stage_squareness_deg.y()));
  row("stage travel", fmt::format("{:g} of what is stated", s.stage_scale));
  for (std::size_t i = 0; i < kRotaryAxes.size(); ++i)
    row(fmt::format("direction of the {} axis", axis_name(kRotaryAxes[i])),
        fmt::format("turned by {} deg", vector_text(s.axis_errors_deg[i])));
  row("gimbal against plane frame", vector_text(s.plane_from_gimbal_deg) + " deg");
  row("target on its table",
      fmt::format("turned by {} deg, shifted by {} mm", vector_text(s.table_from_target_deg),
                  vector_text(s.target_offset_error_mm)));
  for (std::size_t i = 0; i < s.target_errors_mm.size(); ++i)
    if (s.target_errors_mm[i].norm() > 0)
      row(fmt::format("LED M{}", i),
          vector_text(s.target_errors_mm[i]) + " mm off its drawn place");
  return md;
}

/// Which solver has the smallest total RMSE: over the poses that all of them have measured, since a solver that fails
/// where it is difficult would look better than one that does not.
std::string smallest_text(const Evaluation& evaluation) {
  std::vector<double> squares(evaluation.solvers.size());
  std::size_t poses = 0, common = 0;
  for (const EvaluatedPose& pose : evaluation.poses) {
    if (pose.planned.role != PoseRole::kMeasure) continue;
    ++poses;
    if (!std::ranges::all_of(pose.results, &PoseResult::measured)) continue;
    ++common;
    for (std::size_t k = 0; k < squares.size(); ++k)
      squares[k] += squared_error(pose.results[k].error);
  }
  if (common == 0)
    return "No pose was measured by every solver: their totals are over different poses.";
  const auto rmse_deg = [&](std::size_t k) {
    return std::sqrt(squares[k] / static_cast<double>(common));
  };
  const auto best = static_cast<std::size_t>(std::ranges::min_element(squares) - squares.begin());
  std::string md = fmt::format(
      "**Smallest total RMSE over {}: `{}`, {:.4f} deg",
      common == poses
          ? fmt::format("all {} poses", poses)
          : fmt::format("the {} of {} poses that every solver has measured", common, poses),
      evaluation.solvers[best]->name, rmse_deg(best));
  if (const Solver* first = evaluation.solvers.front(); best != 0)
    md += fmt::format("; `{}`, {}, has {:.4f} deg", first->name,
                      first->name == "posit" ? "the paper's comparison" : "the first of the table",
                      rmse_deg(0));
  md += ".**";
  if (common < poses)
    md += " The rows below are over what each solver has measured, and are not of the same poses.";
  return md;
}

/// Per solver the total RMSE of every scenario, all repeats together: what a reader wants to know
/// first.
std::string summary_text(const Results& results) {
  const RunRecord& record = results.record;
  const Evaluation& evaluation = results.evaluation;
  struct Total {
    double squares = 0.0;
    std::size_t poses = 0, failed = 0;
    double rmse_deg() const {
      return poses == failed ? NAN : std::sqrt(squares / static_cast<double>(poses - failed));
    }
    void add(const ErrorStatistics& s) {
      if (s.poses > s.failed)
        squares += s.rmse_total_deg * s.rmse_total_deg * static_cast<double>(s.poses - s.failed);
      poses += s.poses;
      failed += s.failed;
    }
  };
  std::map<const Solver*, std::map<std::size_t, Total>> totals;
  std::map<const Solver*, Total> all;
  std::vector<std::size_t> scenarios;
  for (const RepeatStatistics& r : repeat_statistics(evaluation)) {
    totals[r.solver][r.scenario].add(r.statistics);
    all[r.solver].add(r.statistics);
    if (std::ranges::find(scenarios, r.scenario) == scenarios.end())
      scenarios.push_back(r.scenario);
  }
  std::string md = fmt::format(
      "{} of {} planned poses were taken{}.", record.poses.size(), record.plan.poses.size(),
      record.complete() ? ""
      : record.exit_status.empty()
          ? std::string("; the run ended early: killed, or its journal was cut off")
          : fmt::format("; the run ended early ({}: {})", record.exit_status,
                        markdown_text(record.reason)));
  for (const PlaneResidual& p : results.calibration.planes)
    if (!p.fitted)
      md += fmt::format(
          " Camera: {:.4f} mm rms on the plane at {:.0f} mm that was kept out of the fit.",
          p.rms_mm, p.z_mm);
  if (const std::string other = other_calibration_text(results); !other.empty())
    md += fmt::format("\n\n**The calibration of the camera is {}.**", other);
  if (all.empty()) return md + "\n\n";

  md += "\n\n" + smallest_text(evaluation);
  md += "\n\n| total RMSE / deg | all | poses | failed |";
  std::string line = "|---|--:|--:|--:|";
  for (const std::size_t s : scenarios) {
    md += fmt::format(" {} |", markdown_text(record.plan.scenarios[s].name));
    line += "--:|";
  }
  md += "\n" + line + "\n";
  const auto cell = [](const Total& t) {
    return std::isfinite(t.rmse_deg()) ? fmt::format(" {:.4f} |", t.rmse_deg()) : " - |";
  };
  for (const Solver* solver : evaluation.solvers) {
    const Total& t = all[solver];
    md += fmt::format("| `{}` |{} {} | {} |", solver->name, cell(t), t.poses, t.failed);
    for (const std::size_t s : scenarios) md += cell(totals[solver][s]);
    md += "\n";
  }
  return md + "\n";
}

std::string failures_text(const Evaluation& evaluation, const Plan& plan) {
  const auto kind = [](PoseRole role) {
    return role == PoseRole::kReference ? ", initial pose"
           : role == PoseRole::kReturn  ? ", return to zero"
                                        : "";
  };
  std::map<std::string, std::size_t> counts;
  std::size_t rows = 0, outside = 0, missed = 0;
  for (const EvaluatedPose& pose : evaluation.poses) {
    if (pose.taken && !pose.points_px.empty() && !pose.in_domain) ++outside;
    if (pose.missed) ++missed;
    for (const PoseResult& r : pose.results) {
      ++rows;
      if (!r.measured)
        ++counts[fmt::format("{}: {}{} ({})", markdown_text(plan.scenario_of(pose.planned).name),
                             r.status, kind(pose.planned.role), r.solver->name)];
    }
  }
  std::string md;
  if (counts.empty()) md += fmt::format("No failed pose among {} results.\n", rows);
  for (const auto& [what, count] : counts) md += fmt::format("- {} x {}\n", count, what);
  if (!counts.empty())
    md += "\nThe tables of errors count neither initial poses nor returns to zero.\n";
  md += fmt::format(
      "\n{} of {} poses had a spot outside the calibrated area (flagged `in_domain` = 0). {} poses "
      "had an axis outside "
      "its tolerance (flagged `missed`).\n",
      outside, evaluation.poses.size(), missed);
  return md;
}

/// Shift of the spots from one exposure to another: of the target as a whole, and what is left of the
/// single spots. Nothing if they do not pair up.
struct SpotShift {
  Vector2d mean_px;
  double rest_px;  ///< rms
};
std::optional<SpotShift> spot_shift(const TakenPose& from, const TakenPose& to) {
  if (from.images.empty() || to.images.empty() || !from.images[0].spots || !to.images[0].spots)
    return {};
  const auto& before = *from.images[0].spots;
  const auto& after = *to.images[0].spots;
  if (before.empty() || before.size() != after.size()) return {};
  std::vector<Vector2d> shifts;
  for (const TakenSpot& spot : before) {
    const auto distance = [&](const TakenSpot& other) {
      return std::hypot(other.u_px - spot.u_px, other.v_px - spot.v_px);
    };
    const TakenSpot& nearest = *std::ranges::min_element(after, {}, distance);
    shifts.emplace_back(nearest.u_px - spot.u_px, nearest.v_px - spot.v_px);
  }
  SpotShift out{Vector2d::Zero(), 0.0};
  const auto n = static_cast<double>(shifts.size());
  for (const Vector2d& shift : shifts) out.mean_px += shift / n;
  for (const Vector2d& shift : shifts) out.rest_px += (shift - out.mean_px).squaredNorm() / n;
  out.rest_px = std::sqrt(out.rest_px);
  return out;
}

/// Of a run that went on after a break, or that something made wait.
std::string sessions_text(const RunRecord& record) {
  const std::string interruptions = interruptions_text(record);
  if (record.sessions.size() < 2)
    return interruptions.empty() ? "" : "## Sessions\n\n" + interruptions;
  std::string md =
      "## Sessions\n\nThe run was taken in several sessions.\n\n"
      "| session | began | ended | how | poses | taken again beside |\n|--:|---|---|---|--:|--:|\n";
  for (std::size_t s = 0; s < record.sessions.size(); ++s) {
    const RunSession& session = record.sessions[s];
    const auto events = [&](const std::string& stream) {
      const auto found = session.events.find(stream);
      return found == session.events.end() ? 0 : found->second;
    };
    md +=
        fmt::format("| {} | {} | {} | {}{}{} | {} | {} |\n", s + 1, session.began_utc,
                    session.last_utc, session.exit_status.empty() ? "killed" : session.exit_status,
                    session.reason.empty() ? "" : ": ", markdown_text(session.reason),
                    events("primary"), events(std::string(kOverlapStream)));
  }
  md += "\n" + interruptions;
  if (record.overlaps.empty()) return md;
  md +=
      "Poses before a break that were taken again after it, against the ones that count: what "
      "the "
      "break has changed.\n\n"
      "| pose | stage / mm | yaw / deg | roll / deg | pitch / deg | spots, mean u / px | mean v / "
      "px | "
      "rest / px rms |\n|--:|--:|--:|--:|--:|--:|--:|--:|\n";
  for (const TakenPose& again : record.overlaps) {
    const auto counted = std::ranges::find_if(record.poses, [&](const TakenPose& pose) {
      return pose.planned.index == again.planned.index;
    });
    if (counted == record.poses.end()) continue;
    md += fmt::format("| {} |", again.planned.index);
    for (const AxisId id : kAllAxes)
      md += fmt::format(" {:+.4f} |", again.axis(id).position - counted->axis(id).position);
    if (const auto shift = spot_shift(*counted, again))
      md += fmt::format(" {:+.4f} | {:+.4f} | {:.4f} |\n", shift->mean_px.x(), shift->mean_px.y(),
                        shift->rest_px);
    else
      md += " - | - | - |\n";
  }
  return md + "\n";
}

/// Tables in the published form; then what goes beyond it.
std::string statistics_text(const std::vector<WrittenTable>& tables) {
  constexpr std::array<std::pair<std::string_view, std::string_view>, 4> kBeyond{{
      {"statistics",
       "Intervals come from drawing angles again, each with all of its repeats. The error of a "
       "repeat's initial pose is in all of its poses alike, and no interval knows of it. From "
       "fewer "
       "than some ten angles they are too narrow."},
      {"repeatability",
       "Where axes are approached from one side, forward and backward should be the same; an "
       "interval "
       "that does not hold zero says that they are not, once in twenty by chance. It is by least "
       "squares with Student's t, each repeat with a term of its own. Where rows alternate, an "
       "error that bends "
       "with another axis can look like it: the file has the level \"self-calibrated\", where it "
       "does not."},
      {"paired",
       "Both solvers saw the same image points. \"Not told apart\" means that the interval holds "
       "zero: this run cannot tell which is better. With many pairs some intervals miss zero by "
       "chance: about one in twenty."},
      {"iso230",
       "A accuracy, E systematic deviation, M range of the mean deviation of both directions, R "
       "repeatability, B reversal, by their definitions in the standard; the camera measures, so "
       "its own errors are in all of them."},
  }};
  constexpr std::array<std::string_view, 7> kOwnSection{
      "table1", "camera_solver", "levels", "identified", "budget", "budget_found", "noise"};
  std::string published, beyond;
  for (const WrittenTable& t : tables) {
    const auto known =
        std::ranges::find(kBeyond, t.name, &std::pair<std::string_view, std::string_view>::first);
    if (known != kBeyond.end())
      beyond +=
          fmt::format("### {}\n\n{}\n\n{}\n", markdown_text(t.title), known->second, t.markdown);
    else if (std::ranges::find(kOwnSection, t.name) == kOwnSection.end())
      published += fmt::format("### {}\n\n{}\n", markdown_text(t.title), t.markdown);
  }
  return published +
         "## Beyond the published tables\n\nLevel \"as published\"; the files of the same names in "
         "`tables/` have the other levels of truth and every pair too.\n\n" +
         beyond;
}

/// An earlier evaluation may have had more: other solvers, or noise. Those of the camera stay: a report
/// cannot make them again once the pattern's images are gone.
void remove_earlier_figures(const RunFolder& folder, const Plan& plan,
                            const std::vector<Figure>& figures) {
  std::vector<std::string> names{"error_angle",    "error_normal",  "error_bound",
                                 "error_budget",   "error_drift",   "error_repeatability",
                                 "figure17_noise", "figure18_noise"};
  for (const ScenarioInfo& scenario : plan.scenarios)
    for (const char* number : {"figure14_", "figure15_", "figure16_"})
      names.push_back(number + scenario.name);
  for (const std::string& name : names)
    if (std::ranges::find(figures, name, &Figure::name) == figures.end())
      remove_files(folder.figures(), name, {".csv", ".gp", ".svg"});
  if (std::ranges::find(figures, "error_angle", &Figure::name) == figures.end())
    remove_files(folder.figures(), "error_angle_median", {".csv"});
}

/// What a row of the table of cameras and solvers counts, and where else its measurements appear.
std::string counted_poses(const std::vector<CameraComparison>& comparisons) {
  std::string md = "A row counts";
  for (std::size_t i = 0; i < comparisons.size(); ++i)
    md += fmt::format("{} {} poses",
                      i == 0                       ? ""
                      : i + 1 < comparisons.size() ? ","
                                                   : " and",
                      comparisons[i].cells.empty() ? 0 : comparisons[i].cells.front().poses);
  md += fmt::format(
      "{}, all scenarios and repeats together without the initial poses; those that failed are "
      "counted, and in no RMSE. ",
      comparisons.size() > 1 ? ", run by run" : "");
  for (std::size_t i = 1; i < comparisons.size(); ++i)
    md += fmt::format("Run {} is {}. ", i + 1, markdown_text(comparisons[i].run));
  const std::vector<std::string>& cameras = comparisons.front().cameras;
  const auto same = [&](const std::string& camera, const char* solver, const char* row) {
    return fmt::format("{} x {} = `{}`, ", camera, solver, row);
  };
  md += "The tables above have some of these rows too, there repeat by repeat: ";
  for (const std::string& camera : cameras)
    if (camera == "pinhole")
      md += same(camera, "posit", "posit");
    else if (camera != "irt")
      md +=
          same(camera, "posit", "posit_undistorted") + same(camera, "opencv_sqpnp", "opencv_sqpnp");
  return md +
         "irt x aopit = `aopit`, irt x aopit_ray = `aopit_ray`, irt x ml_ray = `ml_ray` (those "
         "that "
         "were asked for).";
}

}  // namespace

std::filesystem::path write_report(const RunFolder& folder, const Results& results,
                                   PdfPrinter* printer) {
  const auto& [record, rig, calibration, calibration_json, set, evaluation, cameras, levels,
               statistics, budgets, noisy_spots, noise] = results;
  const std::vector<WrittenTable> tables = write_tables(folder, results);
  make_folder(folder.figures());
  // The paper's in the order of its numbers, then what goes beyond.
  std::vector<Draft> drafts, beyond;
  const auto take = [&](std::vector<Draft> made) {
    for (Draft& draft : made)
      (draft.figure.name.starts_with("figure") ? drafts : beyond).push_back(std::move(draft));
  };
  take(calibration_drafts(folder.figures(), calibration, set));
  std::optional<Draft> spots = spots_draft(folder, record, evaluation);
  const bool no_spots = !spots && widest_scenario(record.plan);
  if (spots) drafts.push_back(std::move(*spots));
  take(attitude_drafts(folder.figures(), record, evaluation));
  if (noise) take(noise_drafts(folder.figures(), *noise));
  take(angle_drafts(folder.figures(), record.plan, rig, calibration, evaluation));
  take(normality_drafts(folder.figures(), record.plan, evaluation));
  take(bound_drafts(folder.figures(), record.plan, levels));
  take(budget_drafts(folder.figures(), record.plan, budgets));
  take(repeatability_drafts(folder.figures(), record.plan, evaluation,
                            statistics.front().scenarios));
  take(drift_drafts(folder.figures(), record, evaluation, levels));
  take(time_drafts(folder.figures(), record, rig));
  const std::size_t of_paper = drafts.size();
  std::ranges::move(beyond, std::back_inserter(drafts));
  const std::vector<Figure> figures = draw(folder.figures(), drafts);
  remove_earlier_figures(folder, record.plan, figures);

  std::string md = fmt::format(
      "# {}\n\n", markdown_text(record.plan.title.empty() ? record.plan.name : record.plan.title));
  if (rig.simulated())
    md += fmt::format(
        "**Simulated.** Rig \"{}\", seed {}. No hardware took part; the section \"Simulated error "
        "budget\" lists what is wrong with this rig on purpose.\n\n",
        markdown_text(rig.title), rig.simulation->seed);
  else
    md += fmt::format("Rig \"{}\".\n\n", markdown_text(rig.title));
  md += "## At a glance\n\n" + summary_text(results);

  md +=
      "## Errors against the turntable\n\n"
      "Level \"as published\": the gimbal's axes are taken as parallel to the plane frame, and "
      "every attitude is "
      "relative to the initial pose (all angles zero) of its repeat. The initial pose itself is "
      "not counted. The "
      "noise of that one measurement is in every row of its repeat. The turntable's angles are the "
      "controllers' "
      "pulse counters (open loop): their agreement with a target says nothing about the "
      "mechanics.\n\n";
  const auto has = [&](std::string_view name) {
    return std::ranges::find(evaluation.solvers, name, &Solver::name) != evaluation.solvers.end();
  };
  if (has("posit") && has("posit_undistorted"))
    md +=
        "`posit` works on raw pixels of a pinhole without distortion, as the paper's comparison "
        "does; "
        "`posit_undistorted` has the full pinhole calibration. The difference between the two is "
        "the "
        "camera model's, "
        "not the solver's.\n\n";
  md += "Published rows come from another rig: they are a yardstick, not a competitor.\n\n";
  md += statistics_text(tables);

  if (const WrittenTable* t = find_table(tables, "camera_solver"))
    md += fmt::format(
        "## {}\n\n"
        "Every camera model with every solver, on the same image points. {} A change is taken over "
        "the poses that both rows have measured; below zero it is a gain; an interval that holds "
        "zero says that this run cannot tell.\n\n"
        "Intervals come from drawing poses again, with one calibration, one target and the same "
        "initial poses: the errors of those, which all poses share, are not in them. Small "
        "differences between cameras, sure as their intervals look, are this calibration's; "
        "another "
        "one may turn them round.\n\n{}\n",
        t->title, counted_poses(cameras), t->markdown);

  md += levels_text(tables, levels);
  md += budget_text(tables, record.plan, budgets);
  if (noise) md += noise_text(tables, record, *noise);
  md += "## Failed poses\n\n" + failures_text(evaluation, record.plan);
  md += "\n" + images_text(record) + "## Camera\n\n" + calibration_text(calibration);
  if (const WrittenTable* t = find_table(tables, "table1"))
    md +=
        fmt::format("\n<details><summary>{}</summary>\n\n{}\n</details>\n", t->title, t->markdown);

  const auto behind = figures.begin() + static_cast<std::ptrdiff_t>(of_paper);
  md += "\n## Figures\n\n### As in the paper\n\n" + figures_markdown({figures.begin(), behind});
  if (!set && is_of_own_sweep(calibration, record))
    md +=
        "Figures 8 to 10, and where the points of the calibration lie, are left out: images of the "
        "pattern are not "
        "there.\n\n";
  if (no_spots)
    md +=
        "The spots in their images (as figure 12) are left out: no image of the motion that they "
        "would show is there.\n\n";
  md += "### Beyond the paper\n\n" + figures_markdown({behind, figures.end()});
  if (rig.simulation && rig.simulated())
    md += "## Simulated error budget\n\n" + simulation_budget(rig) + "\n";
  md +=
      time_text(record) + telemetry_text(record) + sessions_text(record) + provenance_text(results);
  write_atomically(folder.report(), md);
  if (printer != nullptr) printer->load(page_for_paper(folder.report()));
  const Json poses = pose_data(folder, record, evaluation);
  return write_html(folder.report(), figures, &poses);
}

}  // namespace turntable
