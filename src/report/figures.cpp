#include "src/report/figures.h"

#include <fmt/format.h>

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

void error_figure(const std::filesystem::path& folder, const RunRecord& record,
                  const Evaluation& evaluation, std::size_t scenario, std::vector<Draft>& drafts) {
  const ScenarioInfo& info = record.plan.scenarios[scenario];
  Csv csv({"solver", "repeat", "turntable_yaw_deg", "turntable_roll_deg", "turntable_pitch_deg",
           "error_yaw_deg", "error_roll_deg", "error_pitch_deg", "error_geodesic_deg"});
  for (const EvaluatedPose& pose : evaluation.poses) {
    if (pose.planned.scenario != scenario || pose.planned.role != PoseRole::kMeasure) continue;
    for (const PoseResult& r : pose.results) {
      if (!r.measured) continue;
      csv.text(r.solver->name).integer(pose.planned.repeat).number(pose.read_back_deg.yaw, 5);
      csv.number(pose.read_back_deg.roll, 5)
          .number(pose.read_back_deg.pitch, 5)
          .number(r.error.yaw_deg, 6);
      csv.number(r.error.roll_deg, 6).number(r.error.pitch_deg, 6).number(r.error.geodesic_deg, 6);
      csv.end_row();
    }
  }
  const auto column = [](AxisId axis) {
    return axis == AxisId::kYaw ? 3 : axis == AxisId::kRoll ? 4 : 5;
  };
  const bool uniaxial = info.axes.size() == 1;
  Draft draft;
  if (uniaxial) {
    draft.figure.name = "figure14_" + info.name;
    draft.figure.caption =
        fmt::format("Errors against the {} angle, {}, every repeat (as figure 14).",
                    axis_name(info.axes.front()), info.title);
    draft.size = "900,760";
    draft.commands = "set multiplot layout 3,1\nset key outside right\n";
    for (const auto& [name, error] :
         {std::pair("pitch", 8), std::pair("roll", 7), std::pair("yaw", 6)}) {
      draft.commands += fmt::format("set xlabel '{} / deg'\nset ylabel '{} error / deg'\nplot ",
                                    axis_name(info.axes.front()), name);
      for (std::size_t k = 0; k < evaluation.solvers.size(); ++k)
        draft.commands += fmt::format(
            "{}'DATA' every ::1 using (strcol(1) eq '{}' ? ${} : 1/0):{} with points pt {} ps 0.6 "
            "lc rgb '{}' title "
            "'{}'",
            k ? ", " : "", evaluation.solvers[k]->name, column(info.axes.front()), error, k + 4,
            kColours[k % kColours.size()], evaluation.solvers[k]->name);
      draft.commands += "\n";
    }
    draft.commands += "unset multiplot\n";
  } else {
    draft.figure.name = "figure15_" + info.name;
    draft.figure.caption = fmt::format(
        "Geodesic error of every pose over the turntable's angles, {}; left the paper's "
        "comparison, right the last "
        "solver of the table (as figures 15 and 16).",
        info.title);
    draft.size = "1200,560";
    draft.commands =
        "set multiplot layout 1,2\nset key off\nset xlabel 'pitch / deg'\nset ylabel 'roll / "
        "deg'\nset zlabel 'yaw / "
        "deg' rotate\nset cblabel 'error / deg'\nset xyplane 0.05\nset view 65,35\nset ticslevel "
        "0\nset palette "
        "defined (0 '#440154', 0.33 '#31688e', 0.66 '#35b779', 1 '#fde725')\n";
    for (const Solver* solver : {evaluation.solvers.front(), evaluation.solvers.back()})
      draft.commands += fmt::format(
          "set title '{}'\nsplot 'DATA' every ::1 using (strcol(1) eq '{}' ? $5 : 1/0):4:3:9 with "
          "points pt 7 ps 0.5 "
          "lc palette\n",
          solver->name, solver->name);
    draft.commands += "unset multiplot\n";
  }
  csv.write(folder / (draft.figure.name + ".csv"));
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
