#include "src/report/figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "src/record/csv.h"
#include "src/report/trajectory.h"

namespace turntable {
namespace {

void trajectory_figure(const std::filesystem::path& folder, const RunRecord& record,
                       std::size_t scenario, int repeat, std::vector<Draft>& drafts) {
  const ScenarioInfo& info = record.plan.scenarios[scenario];
  Csv csv({"point", "rig_time_s", "stage_mm", "turntable_yaw_deg", "turntable_roll_deg",
           "turntable_pitch_deg"});
  for (const TakenPose& p : record.poses)
    if (p.planned.scenario == scenario && p.planned.repeat == repeat) {
      csv.integer(p.planned.point).number(p.rig_time_s, 3).number(p.stage.position, 5);
      csv.number(p.yaw.position, 5).number(p.roll.position, 5).number(p.pitch.position, 5);
      csv.end_row();
    }
  Draft draft;
  draft.figure.name = "figure13_" + info.name;
  draft.figure.caption =
      fmt::format("Motion of the turntable, {}, first repeat (as figure 13).", info.title);
  if (info.axes.size() > 1) draft.size = "1200,560";
  draft.commands =
      "set multiplot\n" + trajectory_commands(info.axes, "every ::1", {}) + "unset multiplot\n";
  csv.write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

/// Where the errors of all but the worst hundredth of any solver end, deg: a scale that one wrong
/// minimum does not spoil. 0 if nothing was measured.
double common_error_deg(const Evaluation& evaluation, std::size_t scenario) {
  double largest = 0.0;
  for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
    std::vector<double> errors;
    for (const EvaluatedPose& pose : evaluation.poses)
      if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure &&
          pose.results[k].measured)
        errors.push_back(pose.results[k].error.geodesic_deg);
    if (!errors.empty()) largest = std::max(largest, percentile(errors, 0.99));
  }
  return largest;
}

/// Column of an axis in the file of `error_figure`.
int error_column(AxisId axis) { return axis == AxisId::kYaw ? 4 : axis == AxisId::kRoll ? 5 : 6; }

/// Errors of one axis' motion: pitch, roll and yaw one below the other.
void uniaxial_errors(Draft& draft, const PosePoints& points, const Evaluation& evaluation,
                     const ScenarioInfo& info) {
  const AxisId axis = info.axes.front();
  draft.figure.caption = fmt::format(
      "Errors against the {} angle, {}, every repeat (as figure 14).", axis_name(axis), info.title);
  draft.size = "900,760";
  draft.commands =
      "set multiplot layout 3,1\nset key outside right\n"
      "set offsets graph 0.02, graph 0.02, graph 0.06, graph 0.06\n";
  for (const auto& [name, error] :
       {std::pair("pitch", "9"), std::pair("roll", "8"), std::pair("yaw", "7")}) {
    draft.commands +=
        fmt::format("set xlabel '{} / deg'\nset ylabel '{} error / deg'\n", axis_name(axis), name);
    for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
      const Solver& solver = *evaluation.solvers[k];
      points.draw(draft, solver, fmt::format("${}", error_column(axis)), error,
                  "ps 0.6 " + solver_look(solver, k));
    }
    draft.end_plot();
  }
  draft.commands += "unset multiplot\n";
}

/// Errors where several axes turn: a panel per solver, one colour scale for all.
void multiaxial_errors(Draft& draft, const PosePoints& points, const Evaluation& evaluation,
                       const ScenarioInfo& info, double scale_deg) {
  constexpr double kPanelPx = 400.0, kScalePx = 90.0;
  const std::size_t count = evaluation.solvers.size(), columns = std::min<std::size_t>(3, count),
                    rows = (count + columns - 1) / columns;
  const double width = kPanelPx * static_cast<double>(columns) + kScalePx;
  draft.figure.caption = fmt::format(
      "Geodesic error of every pose over the turntable's angles, {}: a panel per solver, the "
      "paper's comparison first, one scale for all; the scale ends where 99 % of every solver's "
      "errors do (as figures 15 and 16).",
      info.title);
  draft.size = fmt::format("{:.0f},{:.0f}", width, kPanelPx * static_cast<double>(rows));
  draft.commands = fmt::format(
      "set multiplot\nset key off\nset xlabel 'pitch / deg'\nset ylabel 'roll / deg'\n"
      "set zlabel 'yaw / deg' rotate\nset cblabel 'error / deg'\nset xyplane 0.05\nset view 65,35\n"
      "set tics font ',9'\nset cbrange [0:{:.6g}]\n"
      "set colorbox user origin {:.4f},0.2 size 0.015,0.6\n"
      "set palette defined (0 '#440154', 0.33 '#31688e', 0.66 '#35b779', 1 '#fde725')\n",
      scale_deg > 0.0 ? scale_deg : 1.0, 1.0 - 0.9 * kScalePx / width);
  for (std::size_t k = 0; k < count; ++k) {
    const Solver& solver = *evaluation.solvers[k];
    const double w = kPanelPx / width, h = 1.0 / static_cast<double>(rows);
    draft.commands +=
        fmt::format("set origin {:.5f},{:.5f}\nset size {:.5f},{:.5f}\nset title '{}'\n",
                    static_cast<double>(k % columns) * w,
                    1.0 - static_cast<double>(k / columns + 1) * h, w, h, solver.name);
    points.draw(draft, solver, "$6", "5:4:10", "pt 7 ps 0.5 lc palette", "splot");
    draft.end_plot().commands += "unset colorbox\n";
  }
  draft.commands += "unset multiplot\n";
}

void error_figure(const std::filesystem::path& folder, const RunRecord& record,
                  const Evaluation& evaluation, std::size_t scenario, std::vector<Draft>& drafts) {
  const ScenarioInfo& info = record.plan.scenarios[scenario];
  PosePoints points({"repeat", "turntable_yaw_deg", "turntable_roll_deg", "turntable_pitch_deg",
                     "error_yaw_deg", "error_roll_deg", "error_pitch_deg", "error_geodesic_deg"});
  for (const EvaluatedPose& pose : evaluation.poses) {
    if (pose.planned.scenario != scenario || pose.planned.role != PoseRole::kMeasure) continue;
    for (const PoseResult& r : pose.results) {
      if (!r.measured) continue;
      Csv& csv = points.row(*r.solver, pose.planned.index).integer(pose.planned.repeat);
      csv.number(pose.read_back_deg.yaw, 5).number(pose.read_back_deg.roll, 5);
      csv.number(pose.read_back_deg.pitch, 5).number(r.error.yaw_deg, 6);
      csv.number(r.error.roll_deg, 6).number(r.error.pitch_deg, 6).number(r.error.geodesic_deg, 6);
      csv.end_row();
    }
  }
  const bool uniaxial = info.axes.size() == 1;
  Draft draft;
  draft.figure.name = (uniaxial ? "figure14_" : "figure15_") + info.name;
  if (uniaxial)
    uniaxial_errors(draft, points, evaluation, info);
  else
    multiaxial_errors(draft, points, evaluation, info, common_error_deg(evaluation, scenario));
  points.csv().write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

}  // namespace

std::vector<Draft> attitude_drafts(const std::filesystem::path& folder, const RunRecord& record,
                                   const Evaluation& evaluation) {
  std::vector<Draft> drafts;
  if (evaluation.solvers.empty()) return drafts;
  for (std::size_t i = 0; i < record.plan.scenarios.size(); ++i) {
    if (record.plan.scenarios[i].kind != ScenarioKind::kAttitude) continue;
    trajectory_figure(folder, record, i, 1, drafts);
    error_figure(folder, record, evaluation, i, drafts);
  }
  return drafts;
}

}  // namespace turntable
