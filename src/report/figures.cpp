#include "src/report/figures.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "src/core/errors.h"
#include "src/evaluation/statistics.h"
#include "src/record/csv.h"
#include "src/report/trajectory.h"

namespace turntable {
namespace {

void trajectory_figure(const std::filesystem::path& folder, const RunRecord& record,
                       std::size_t scenario, int repeat, std::vector<Draft>& drafts) {
  const ScenarioInfo& info = record.plan.scenarios[scenario];
  Csv csv({"point", "rig_time_s", "stage_mm", "turntable_yaw_deg", "turntable_roll_deg",
           "turntable_pitch_deg"});
  bool any = false;
  for (const TakenPose& p : record.poses)
    if (p.planned.scenario == scenario && p.planned.repeat == repeat) {
      any = true;
      csv.integer(p.planned.point).number(p.rig_time_s, 3).number(p.stage.position, 5);
      csv.number(p.yaw.position, 5).number(p.roll.position, 5).number(p.pitch.position, 5);
      csv.end_row();
    }
  if (!any) return;
  Draft draft;
  draft.figure.name = "figure13_" + info.name;
  draft.figure.caption = fmt::format(
      "Motion of the turntable, {}, first repeat: its angles as read back, pose by pose{} (as "
      "figure 13).",
      info.title, info.axes.size() > 1 ? ", and the path through them" : "");
  draft.size = info.axes.size() > 1 ? "1000,480" : "1000,380";
  draft.commands =
      "set multiplot\n" + trajectory_commands(info.axes, "every ::1", {}) + "unset multiplot\n";
  csv.write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

/// Where the errors of all but the worst hundredth of the solvers end, deg: a scale that one wrong
/// minimum does not spoil, nor one wrong solver. 0 if nothing was measured.
double common_error_deg(const Evaluation& evaluation, std::size_t scenario) {
  std::vector<double> ends;
  for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
    std::vector<double> errors;
    for (const EvaluatedPose& pose : evaluation.poses)
      if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure &&
          pose.results[k].measured)
        errors.push_back(pose.results[k].error.geodesic_deg);
    if (!errors.empty()) ends.push_back(percentile(errors, 0.99));
  }
  return common_limit(ends);
}

/// Column of an axis in the file of `error_figure`.
int error_column(AxisId axis) { return axis == AxisId::kYaw ? 4 : axis == AxisId::kRoll ? 5 : 6; }

/// Where an axis was sent to in a scenario.
std::set<double> targets_of(const Evaluation& evaluation, std::size_t scenario, AxisId axis) {
  std::set<double> targets;
  for (const EvaluatedPose& pose : evaluation.poses)
    if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure)
      targets.insert(pose.planned.target(axis));
  return targets;
}

/// Least distance of two targets of an axis; 1 if there is only one.
double target_step(const Evaluation& evaluation, std::size_t scenario, AxisId axis) {
  const std::set<double> targets = targets_of(evaluation, scenario, axis);
  double step = INFINITY;
  for (auto it = targets.begin(); it != targets.end() && std::next(it) != targets.end(); ++it)
    step = std::min(step, *std::next(it) - *it);
  return std::isfinite(step) ? step : 1.0;
}

/// How far marks of one target are set apart, so that `count` of them stay near it.
double mark_distance(const Evaluation& evaluation, std::size_t scenario, AxisId axis,
                     std::size_t count) {
  const std::set<double> targets = targets_of(evaluation, scenario, axis);
  const double span = targets.empty() ? 0.0 : *targets.rbegin() - *targets.begin();
  const double most = 0.7 * target_step(evaluation, scenario, axis) / static_cast<double>(count);
  return span > 0.0 ? std::min(most, 0.015 * span) : most;
}

/// Errors of one axis' motion: pitch, roll and yaw one below the other.
void uniaxial_errors(Draft& draft, const PosePoints& points, const Evaluation& evaluation,
                     std::size_t scenario, const ScenarioInfo& info) {
  const AxisId axis = info.axes.front();
  const std::size_t count = evaluation.solvers.size();
  draft.figure.caption = fmt::format(
      "Errors in pitch, roll and yaw against the {} angle, {}, every repeat, on one scale. The "
      "solvers' marks are set side by side at each angle (as figure 14).",
      axis_name(axis), info.title);
  draft.size = "1000,600";
  double low = INFINITY, high = -INFINITY;
  std::vector<double> largest;
  for (std::size_t k = 0; k < count; ++k) {
    double of_solver = -1.0;
    for (const EvaluatedPose& pose : evaluation.poses)
      if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure &&
          pose.results[k].measured) {
        const PoseError& error = pose.results[k].error;
        for (const double e : {error.pitch_deg, error.roll_deg, error.yaw_deg}) {
          low = std::min(low, e);
          high = std::max(high, e);
          of_solver = std::max(of_solver, std::abs(e));
        }
      }
    if (of_solver >= 0.0) largest.push_back(of_solver);
  }
  const double limit = common_limit(largest);
  if (std::max(-low, high) > limit) draft.figure.caption += kBeyondScale;
  low = std::max(low, -limit);
  high = std::min(high, limit);
  draft.commands =
      "set multiplot layout 3,1 margins 0.11,0.82,0.105,0.98 spacing 0,0.025\n"
      "set key off\nset autoscale xfix\nset offsets graph 0.03, graph 0.03, 0, 0\n"
      "set xzeroaxis lc rgb '#888888'\n";
  if (high > low) {
    const double room = 0.06 * (high - low);
    draft.commands += fmt::format("set yrange [{:.6g}:{:.6g}]\n", low - room, high + room);
  }
  const double apart = mark_distance(evaluation, scenario, axis, count);
  for (const auto& [name, error] :
       {std::pair("pitch", "$9"), std::pair("roll", "$8"), std::pair("yaw", "$7")}) {
    const bool last = std::string_view(name) == "yaw";
    draft.commands += fmt::format(
        "set ylabel '{} error / deg'\n{}", name,
        last ? fmt::format("set format x '%g'\nset xlabel '{} / deg'\n", axis_name(axis))
             : "set format x ''\n");
    for (std::size_t k = 0; k < count; ++k) {
      const Solver& solver = *evaluation.solvers[k];
      const double aside = (static_cast<double>(k) - 0.5 * static_cast<double>(count - 1)) * apart;
      points.draw(draft, solver, fmt::format("(${}+({:.4g}))", error_column(axis), aside),
                  fmt::format("({0} < {1:.6g} ? {1:.6g} : {0} > {2:.6g} ? {2:.6g} : {0})", error,
                              low, high),
                  "ps 0.55 " + solver_look(solver, k));
    }
    draft.end_plot();
  }
  draft.end_multiplot(0.83, key_of_points(evaluation.solvers));
}

/// Panels beside and below each other with one colour scale at the right; px.
struct PanelsWithScale {
  std::size_t columns, rows;
  double width, height;  ///< of a panel
  static constexpr double kScaleWidth = 120.0;

  double whole_width() const { return width * static_cast<double>(columns) + kScaleWidth; }
  std::string size() const {
    return fmt::format("{:.0f},{:.0f}", whole_width(), height * static_cast<double>(rows));
  }
  std::string multiplot(double scale_deg, const char* label) const {
    return fmt::format(
        "set multiplot\nset key off\n{}set cblabel '{}'\nset cbrange [0:{:.6g}]\n"
        "set colorbox user origin {:.4f},0.2 size {:.4f},0.6\n",
        kHeat, label, scale_deg > 0.0 ? scale_deg : 1.0, 1.0 - 0.85 * kScaleWidth / whole_width(),
        20.0 / whole_width());
  }
  /// Commands before the plot of the panel `k` of them.
  std::string place(std::size_t k) const {
    const double w = width / whole_width(), h = 1.0 / static_cast<double>(rows);
    return fmt::format("set origin {:.5f},{:.5f}\nset size {:.5f},{:.5f}\n",
                       static_cast<double>(k % columns) * w,
                       1.0 - static_cast<double>(k / columns + 1) * h, w, h);
  }
};

/// "[-20.6:20.6]": where an axis stood in all poses of a scenario, with some room. A solver that lacks the
/// outer ones has the same frame.
std::string frame_of(const Evaluation& evaluation, std::size_t scenario, AxisId axis) {
  double low = INFINITY, high = -INFINITY;
  for (const EvaluatedPose& pose : evaluation.poses)
    if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure) {
      low = std::min(low, pose.read_back_deg[axis]);
      high = std::max(high, pose.read_back_deg[axis]);
    }
  const double room = std::max(0.5, 0.015 * (high - low));
  return fmt::format("[{:.6g}:{:.6g}]", low - room, high + room);
}

/// "-20, 0, 20": the ends of where an axis was sent to, and what is nearest to their middle. In three
/// dimensions gnuplot does not look whether its numbers overlap.
std::string ends_and_middle(const std::set<double>& targets) {
  const double middle = 0.5 * (*targets.begin() + *targets.rbegin());
  const double nearest =
      *std::ranges::min_element(targets, {}, [&](double t) { return std::abs(t - middle); });
  std::string tics;
  for (const double at : std::set{*targets.begin(), nearest, *targets.rbegin()})
    tics += fmt::format("{}{:g}", tics.empty() ? "" : ", ", at);
  return tics;
}

/// Errors where several axes turn: a panel per solver, one colour scale for all.
void multiaxial_errors(Draft& draft, const PosePoints& points, const Evaluation& evaluation,
                       std::size_t scenario, const ScenarioInfo& info) {
  std::vector<const Solver*> solvers;
  for (const Solver* solver : evaluation.solvers)
    if (!points.none_of(*solver)) solvers.push_back(solver);
  const std::size_t count = solvers.size(), columns = std::min<std::size_t>(3, count),
                    rows = (count + columns - 1) / columns;
  const bool flat = info.axes.size() == 2;
  draft.figure.caption = fmt::format(
      "Geodesic error of every pose over the turntable's angles, {}: a panel per solver, the "
      "paper's comparison first, one scale for all; the scale ends where 99 % of the solvers' "
      "errors do{} (as figure 15).",
      info.title, flat && info.repeats > 1 ? "; repeats are set side by side" : "");
  const PanelsWithScale panels{columns, rows, 310.0, 260.0};
  draft.size = panels.size();
  draft.commands = panels.multiplot(common_error_deg(evaluation, scenario), "error / deg");
  if (flat)
    draft.commands += fmt::format(
        "set xlabel '{} / deg'\nset ylabel '{} / deg'\n"
        "set autoscale fix\nset offsets graph 0.07, graph 0.07, graph 0.07, graph 0.07\n",
        axis_name(info.axes[1]), axis_name(info.axes[0]));
  else
    draft.commands += fmt::format(
        "set xlabel 'pitch / deg' offset 3,0.5\nset ylabel 'roll / deg' offset -5.5,0.5\n"
        "set zlabel 'yaw / deg' rotate offset 0.5\nset title offset 0,0.5\nset xtics ({})\n"
        "set ytics ({})\nset xrange {}\nset yrange {}\nset zrange {}\nset xyplane 0.05\n"
        "set view 65,35,1.2\nset lmargin 8\nset rmargin 0\n",
        ends_and_middle(targets_of(evaluation, scenario, AxisId::kPitch)),
        ends_and_middle(targets_of(evaluation, scenario, AxisId::kRoll)),
        frame_of(evaluation, scenario, AxisId::kPitch),
        frame_of(evaluation, scenario, AxisId::kRoll),
        frame_of(evaluation, scenario, AxisId::kYaw));
  for (std::size_t k = 0; k < count; ++k) {
    const Solver& solver = *solvers[k];
    draft.commands += panels.place(k);
    draft.commands += fmt::format("set title '{}'\n", solver.name);
    if (flat)
      points.draw(draft, solver,
                  fmt::format("(${}+({:.4g})*($3-{}))", error_column(info.axes[1]),
                              mark_distance(evaluation, scenario, info.axes[1],
                                            static_cast<std::size_t>(info.repeats)),
                              0.5 * (info.repeats + 1)),
                  fmt::format("{}:10", error_column(info.axes[0])), "pt 7 ps 0.6 lc palette");
    else
      points.draw(draft, solver, "6", "5:4:10", "pt 7 ps 0.5 lc palette", "splot");
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
  if (std::ranges::all_of(evaluation.solvers,
                          [&](const Solver* solver) { return points.none_of(*solver); }))
    return;
  const bool uniaxial = info.axes.size() == 1;
  Draft draft;
  draft.figure.name = (uniaxial ? "figure14_" : "figure15_") + info.name;
  if (uniaxial)
    uniaxial_errors(draft, points, evaluation, scenario, info);
  else
    multiaxial_errors(draft, points, evaluation, scenario, info);
  points.write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

/// Of the table: the paper's comparison, the first solver on rays, and the default one or else the last.
std::vector<std::size_t> compared_solvers(const Evaluation& evaluation) {
  const auto best = std::ranges::find(evaluation.solvers, &default_solver());
  std::set<std::size_t> chosen{0,
                               std::min(static_cast<std::size_t>(best - evaluation.solvers.begin()),
                                        evaluation.solvers.size() - 1)};
  const auto rays = std::ranges::find(evaluation.solvers, Sight::kRays, &Solver::sight);
  if (rays != evaluation.solvers.end())
    chosen.insert(static_cast<std::size_t>(rays - evaluation.solvers.begin()));
  return {chosen.begin(), chosen.end()};
}

/// Mean error over the plane of two axes, the third averaged out; a row of panels per compared solver.
void separation_figure(const std::filesystem::path& folder, const RunRecord& record,
                       const Evaluation& evaluation, std::size_t scenario,
                       std::vector<Draft>& drafts) {
  constexpr double kMapPx = 330.0;
  constexpr std::array kPlanes{std::pair(AxisId::kPitch, AxisId::kRoll),
                               std::pair(AxisId::kPitch, AxisId::kYaw),
                               std::pair(AxisId::kRoll, AxisId::kYaw)};
  const ScenarioInfo& info = record.plan.scenarios[scenario];
  struct Map {
    std::size_t solver;
    std::pair<AxisId, AxisId> plane;
    std::size_t first, last;  ///< rows of the file
  };
  std::vector<Map> maps;
  Csv csv({"solver", "plane", "x_deg", "y_deg", "mean_error_deg", "poses"});
  std::size_t rows = 0;
  std::map<std::size_t, double> largest;
  for (const std::size_t k : compared_solvers(evaluation))
    for (const auto& plane : kPlanes) {
      struct Sum {
        double deg = 0.0;
        int poses = 0;
      };
      std::map<std::pair<double, double>, Sum> cells;
      for (const EvaluatedPose& pose : evaluation.poses)
        if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure &&
            pose.results[k].measured) {
          Sum& sum = cells[{pose.planned.target(plane.first), pose.planned.target(plane.second)}];
          sum.deg += pose.results[k].error.geodesic_deg;
          ++sum.poses;
        }
      if (cells.empty()) continue;
      maps.push_back({k, plane, rows + 1, rows + cells.size()});
      rows += cells.size();
      for (const auto& [at, sum] : cells) {
        const double mean_deg = sum.deg / sum.poses;
        largest[k] = std::max(largest[k], mean_deg);
        csv.text(evaluation.solvers[k]->name);
        csv.text(fmt::format("{}-{}", axis_name(plane.first), axis_name(plane.second)));
        csv.number(at.first, 4).number(at.second, 4).number(mean_deg, 6).integer(sum.poses);
        csv.end_row();
      }
    }
  if (maps.empty()) return;
  std::vector<std::string_view> names;
  for (const auto& [k, end] : largest) names.push_back(evaluation.solvers[k]->name);
  const std::string which =
      names.size() == evaluation.solvers.size()
          ? "per solver"
          : fmt::format("each for {}, as many as a page has room for", fmt::join(names, ", "));
  Draft draft;
  draft.figure.name = "figure16_" + info.name;
  draft.figure.caption = fmt::format(
      "Where in the range the error arises, {}: mean geodesic error over the planes pitch-roll, "
      "pitch-yaw and roll-yaw, the third angle averaged out; a row {}, one scale for all "
      "(as figure 16).",
      info.title, which);
  std::vector<double> ends;
  for (const auto& [k, end] : largest) ends.push_back(end);
  const PanelsWithScale panels{kPlanes.size(), maps.size() / kPlanes.size(), kMapPx, kMapPx};
  draft.size = panels.size();
  draft.commands = panels.multiplot(common_limit(ends), "mean error / deg") +
                   "set style fill solid noborder\nunset grid\nset autoscale fix\n";
  for (std::size_t i = 0; i < maps.size(); ++i) {
    const Map& map = maps[i];
    draft.commands += panels.place(i);
    draft.commands += fmt::format(
        "set title '{}'\nset xlabel '{} / deg'\nset ylabel '{} / deg'\n"
        "plot 'DATA' every ::{}::{} using 3:4:({:.5g}):({:.5g}):5 with boxxyerror lc palette\n"
        "unset colorbox\n",
        evaluation.solvers[map.solver]->name, axis_name(map.plane.first),
        axis_name(map.plane.second), map.first, map.last,
        0.5 * target_step(evaluation, scenario, map.plane.first),
        0.5 * target_step(evaluation, scenario, map.plane.second));
  }
  draft.commands += "unset multiplot\n";
  csv.write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

/// Poses whose images show the range: the first one, each axis at both of its ends with the others as
/// near to zero as there are, and the one that is turned farthest.
std::vector<const EvaluatedPose*> outermost_poses(const std::vector<const EvaluatedPose*>& poses,
                                                  const std::vector<AxisId>& axes) {
  const auto turned = [](const EvaluatedPose& pose) {
    double sum = 0.0;
    for (const AxisId axis : kRotaryAxes) sum += std::abs(pose.planned.target(axis));
    return sum;
  };
  std::vector<const EvaluatedPose*> chosen{poses.front()};
  const auto add = [&](const EvaluatedPose* pose) {
    if (std::ranges::find(chosen, pose) == chosen.end()) chosen.push_back(pose);
  };
  for (const AxisId axis : axes)
    for (const double sign : {-1.0, 1.0})
      add(*std::ranges::min_element(poses, {}, [&](const EvaluatedPose* pose) {
        const double at = pose->planned.target(axis);
        return std::pair(-sign * at, turned(*pose) - std::abs(at));
      }));
  if (axes.size() > 1)
    add(*std::ranges::max_element(poses, {},
                                  [&](const EvaluatedPose* pose) { return turned(*pose); }));
  return chosen;
}

}  // namespace

std::optional<std::size_t> widest_scenario(const Plan& plan) {
  std::optional<std::size_t> widest;
  const auto rank = [](const ScenarioInfo& s) { return std::pair(s.table == 5, s.axes.size()); };
  for (std::size_t i = 0; i < plan.scenarios.size(); ++i)
    if (plan.scenarios[i].kind == ScenarioKind::kAttitude &&
        (!widest || rank(plan.scenarios[i]) > rank(plan.scenarios[*widest])))
      widest = i;
  return widest;
}

double common_limit(const std::vector<double>& of_solvers) {
  if (of_solvers.empty()) return 0.0;
  return std::min(std::ranges::max(of_solvers), 3.0 * percentile(of_solvers, 0.5));
}

std::optional<Draft> spots_draft(const RunFolder& folder, const RunRecord& record,
                                 const Evaluation& evaluation) {
  constexpr int kMarginPx = 50, kPanelImagePx = 300;
  const auto scenario = widest_scenario(record.plan);
  if (!scenario) return {};
  const ScenarioInfo& info = record.plan.scenarios[*scenario];
  std::map<std::size_t, const TakenImage*> images;
  for (const TakenPose& pose : record.poses)
    if (!pose.images.empty() && !pose.images.front().file.empty() &&
        std::filesystem::exists(folder.root() / pose.images.front().file))
      images[pose.planned.index] = &pose.images.front();
  std::vector<const EvaluatedPose*> seen;
  for (const EvaluatedPose& pose : evaluation.poses)
    if (pose.planned.scenario == *scenario && !pose.points_px.empty() &&
        images.contains(pose.planned.index))
      seen.push_back(&pose);
  if (seen.empty()) return {};

  struct View {
    const EvaluatedPose* pose;
    Image image;
    Vector2d low, high;  ///< of its spots, px
  };
  std::vector<View> views;
  double side = 0.0;
  for (const EvaluatedPose* pose : outermost_poses(seen, info.axes)) {
    View view{pose, {}, pose->points_px.front(), pose->points_px.front()};
    try {
      view.image = load_image(folder, *images[pose->planned.index]);
    } catch (const ConfigError&) {  // altered or cut off: `verify` says so
      continue;
    }
    for (const Vector2d& p : pose->points_px) {
      view.low = view.low.cwiseMin(p);
      view.high = view.high.cwiseMax(p);
    }
    side = std::max(side, (view.high - view.low).maxCoeff() + 2.0 * kMarginPx);
    views.push_back(std::move(view));
  }
  if (views.empty()) return {};

  const std::size_t columns = std::min<std::size_t>(4, views.size()),
                    rows = (views.size() + columns - 1) / columns;
  const int every = std::max(1, static_cast<int>(std::ceil(side / kPanelImagePx)));
  Draft draft;
  draft.figure.name = "figure12_" + info.name;
  draft.figure.caption = fmt::format(
      "The LEDs' part of archived images, {}: crosses where a spot's centre was found, with the "
      "serial number of the LED that it was matched with; above each the turntable's yaw, roll and "
      "pitch (as figure 12).",
      info.title);
  draft.size = fmt::format("{},{}", 250 * columns, 270 * rows);
  draft.commands = fmt::format(
      "set key off\nunset grid\nset size ratio -1\nset tics font ',10' out nomirror\n"
      "set xlabel 'u / px' offset 0,0.5\nset ylabel 'v / px' offset 1\n"
      "set xtics 100\nset ytics 100\nset lmargin 7\nset rmargin 1\nset bmargin 3.2\nset tmargin "
      "2.6\n"
      "set multiplot layout {},{}\n",
      rows, columns);
  Csv csv({"pose", "turntable_yaw_deg", "turntable_roll_deg", "turntable_pitch_deg", "led", "u_px",
           "v_px"});
  std::size_t row = 0;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const auto& [pose, image, low, high] = views[i];
    for (std::size_t m = 0; m < pose->points_px.size(); ++m) {
      csv.integer(static_cast<std::int64_t>(pose->planned.index));
      csv.number(pose->read_back_deg.yaw, 4).number(pose->read_back_deg.roll, 4);
      csv.number(pose->read_back_deg.pitch, 4).integer(static_cast<std::int64_t>(m));
      csv.number(pose->points_px[m].x(), 3).number(pose->points_px[m].y(), 3).end_row();
    }
    const Vector2d middle = 0.5 * (low + high);
    const int half = static_cast<int>(0.5 * side), left = static_cast<int>(middle.x()) - half,
              top = static_cast<int>(middle.y()) - half;
    const Region part{std::max(0, left), std::max(0, top),
                      std::min(image.width - 1, left + 2 * half),
                      std::min(image.height - 1, top + 2 * half)};
    draft.commands += fmt::format(
        "set title '{:+g}, {:+g}, {:+g} deg{}'\nset xrange [{}:{}]\nset yrange [{}:{}]\n"
        "plot {}, 'DATA' every ::{}::{} using 6:7 with points pt 1 ps 1.6 lw 0.8 lc rgb '#E69F00', "
        "'' every ::{}::{} using 6:7:(sprintf('M%d', $5)) with labels center offset 0,0.95 font "
        "'sans,13' textcolor rgb '#56B4E9'\n",
        pose->planned.yaw_deg, pose->planned.roll_deg, pose->planned.pitch_deg,
        pose->planned.role == PoseRole::kReference ? " (first pose)" : "", left - 0.5,
        left + 2 * half + 0.5, top + 2 * half + 0.5, top - 0.5,
        image_part(folder.figures(), fmt::format("{}_{}", draft.figure.name, i), image, part,
                   every),
        row + 1, row + pose->points_px.size(), row + 1, row + pose->points_px.size());
    row += pose->points_px.size();
  }
  draft.commands += "unset multiplot\n";
  csv.write(folder.figures() / (draft.figure.name + ".csv"));
  return draft;
}

std::vector<Draft> attitude_drafts(const std::filesystem::path& folder, const RunRecord& record,
                                   const Evaluation& evaluation) {
  std::vector<Draft> drafts;
  if (evaluation.solvers.empty()) return drafts;
  const std::vector<ScenarioInfo>& scenarios = record.plan.scenarios;
  // In the order of the paper's numbers.
  const auto each = [&](std::size_t least_axes, std::size_t most_axes, const auto& figure) {
    for (std::size_t i = 0; i < scenarios.size(); ++i)
      if (scenarios[i].kind == ScenarioKind::kAttitude && scenarios[i].axes.size() >= least_axes &&
          scenarios[i].axes.size() <= most_axes)
        figure(i);
  };
  constexpr std::size_t kAny = kAllAxes.size();
  const auto errors = [&](std::size_t i) { error_figure(folder, record, evaluation, i, drafts); };
  each(0, kAny, [&](std::size_t i) { trajectory_figure(folder, record, i, 1, drafts); });
  each(1, 1, errors);
  each(0, 0, errors);
  each(2, kAny, errors);
  each(3, kAny, [&](std::size_t i) { separation_figure(folder, record, evaluation, i, drafts); });
  return drafts;
}

}  // namespace turntable
