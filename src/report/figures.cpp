#include "src/report/figures.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <map>
#include <set>

#include "src/core/parallel.h"
#include "src/record/atomic_file.h"
#include "src/record/csv.h"

extern char** environ;

namespace turntable {
namespace {

// Okabe & Ito (2008): told apart by colour-blind readers and in grey.
constexpr std::array<const char*, 6> kColours{"#0072B2", "#D55E00", "#009E73",
                                              "#CC79A7", "#E69F00", "#56B4E9"};

/// Runs gnuplot on a script in its folder. False if there is no gnuplot or it fails.
bool draw(const std::filesystem::path& script) {
  const std::string folder = script.parent_path().string(), name = script.filename().string();
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
  std::string program = "gnuplot", argument = name;
  char* argv[] = {program.data(), argument.data(), nullptr};
  pid_t child = 0;
  const int failed = posix_spawnp(&child, "gnuplot", &actions, nullptr, argv, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed != 0) return false;
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

/// A figure being made: data, and how gnuplot shows them.
struct Draft {
  Figure figure;
  std::string commands;  ///< the plot, with "DATA" for the file
  std::string size = "900,560";
};

std::string script_of(const Draft& draft) {
  std::string commands = draft.commands;
  const std::string data = draft.figure.name + ".csv";
  for (std::size_t at; (at = commands.find("DATA")) != std::string::npos;)
    commands.replace(at, 4, data);
  return fmt::format(
      "set terminal svg size {} dynamic noenhanced background rgb 'white' font 'sans,13'\n"
      "set output '{}.svg'\n"
      "set datafile separator ','\nset key outside right top\nset grid lc rgb '#dddddd'\n{}",
      draft.size, draft.figure.name, commands);
}

void residual_figures(const RunFolder& folder, const Calibration& calibration, double spacing_mm,
                      const std::vector<PlanePoint>& points, std::vector<Draft>& drafts) {
  std::map<double, std::vector<const PlanePoint*>> planes;
  for (const PlanePoint& p : points) planes[std::round(1000.0 * p.z_mm) / 1000.0].push_back(&p);
  for (const auto& [z, on_plane] : planes) {
    Csv csv({"column", "row", "x_mm", "y_mm", "z_mm", "u_px", "v_px", "residual_x_mm",
             "residual_y_mm", "residual_mm", "in_domain"});
    double largest = 0.0;
    for (const PlanePoint* p : on_plane) {
      const Vector2d r = residual_mm(calibration.irt, *p);
      const bool inside = calibration.irt.in_domain(p->pixel_px);
      if (inside) largest = std::max(largest, r.norm());
      csv.integer(p->column)
          .integer(p->row)
          .number(p->on_plane_mm.x(), 3)
          .number(p->on_plane_mm.y(), 3);
      csv.number(z, 5).number(p->pixel_px.x(), 4).number(p->pixel_px.y(), 4);
      csv.number(r.x(), 6).number(r.y(), 6).number(r.norm(), 6).integer(inside);
      csv.end_row();
    }
    Draft draft;
    draft.figure.name = fmt::format("figure10_residuals_{:g}mm", z);
    draft.figure.caption = fmt::format(
        "Residuals of the ray model on the plane at {:.3f} mm (as figure 10): arrows enlarged so "
        "that the longest, "
        "{:.4f} mm, spans one lattice spacing; circles outside the calibrated area are left out.",
        z, largest);
    draft.size = "760,620";
    draft.commands = fmt::format(
        "set size ratio -1\nset xlabel 'x / mm'\nset ylabel 'y / mm'\nset cblabel 'residual / mm'\n"
        "set palette defined (0 '#fff5e1', 0.5 '#E69F00', 1 '#8c2d04')\nset key off\nk = {}\n"
        "plot 'DATA' every ::1 using 3:4:($11 == 1 ? $8*k : 1/0):($9*k):10 with vectors head "
        "filled lw 1.5 lc palette\n",
        largest > 0 ? spacing_mm / largest : 1.0);
    csv.write(folder.figures() / (draft.figure.name + ".csv"));
    drafts.push_back(std::move(draft));
  }
}

void trajectory_figure(const RunFolder& folder, const RunRecord& record, std::size_t scenario,
                       int repeat, std::vector<Draft>& drafts) {
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
  draft.commands = fmt::format(
      "set xlabel 'pose'\nset ylabel 'angle / deg'\n"
      "plot 'DATA' every ::1 using 1:4 with steps lw 1.5 lc rgb '{}' title 'yaw (z)', "
      "'' every ::1 using 1:5 with steps lw 1.5 dt 2 lc rgb '{}' title 'roll (y)', "
      "'' every ::1 using 1:6 with steps lw 1.5 dt 4 lc rgb '{}' title 'pitch (x)'\n",
      kColours[0], kColours[1], kColours[2]);
  csv.write(folder.figures() / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

void error_figure(const RunFolder& folder, const RunRecord& record, const Evaluation& evaluation,
                  std::size_t scenario, std::vector<Draft>& drafts) {
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
  csv.write(folder.figures() / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

}  // namespace

std::vector<Figure> write_figures(const RunFolder& folder, const RunRecord& record,
                                  const Evaluation& evaluation, const Calibration& calibration,
                                  const std::vector<PlanePoint>& points, double spacing_mm) {
  std::filesystem::create_directories(folder.figures());
  std::vector<Draft> drafts;
  residual_figures(folder, calibration, spacing_mm, points, drafts);
  if (!evaluation.solvers.empty())
    for (std::size_t i = 0; i < record.plan.scenarios.size(); ++i) {
      if (record.plan.scenarios[i].kind != ScenarioKind::kAttitude) continue;
      trajectory_figure(folder, record, i, 1, drafts);
      error_figure(folder, record, evaluation, i, drafts);
    }
  std::vector<Figure> figures(drafts.size());
  for (const Draft& d : drafts)
    write_atomically(folder.figures() / (d.figure.name + ".gp"), script_of(d));
  parallel_for(drafts.size(), [&](std::size_t i) {
    figures[i] = drafts[i].figure;
    figures[i].drawn = draw(folder.figures() / (figures[i].name + ".gp"));
  });
  return figures;
}

}  // namespace turntable
