#include "src/report/evaluation_figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>

#include "src/core/units.h"
#include "src/evaluation/clustered_bootstrap.h"
#include "src/evaluation/scenario_statistics.h"
#include "src/report/figures.h"

namespace turntable {
namespace {

/// Rows of the file that one element of the plot shows.
struct FileRows {
  std::size_t first = 0, last = 0;  ///< the header is row 0
  std::string every() const { return fmt::format("'DATA' every ::{}::{}", first, last); }
};

/// Panels of one size, beside and below each other, and the room about and between them; px.
struct PanelGrid {
  std::size_t columns = 1, rows = 1;
  double width = 225, height = 200;  ///< of a panel
  double left = 105, right = 205, top = 40, bottom = 60;
  double beside = 55, below = 70;

  /// As many rows of three as it takes, or of fewer if three are wider than type on paper allows.
  PanelGrid& of(std::size_t panels) {
    columns = std::min<std::size_t>(3, panels);
    while (columns > 1 && whole_width() > 1200.0) --columns;
    rows = (panels + columns - 1) / columns;
    return *this;
  }
  double whole_width() const {
    const auto n = static_cast<double>(columns);
    return left + n * width + (n - 1) * beside + right;
  }
  double whole_height() const {
    const auto n = static_cast<double>(rows);
    return top + n * height + (n - 1) * below + bottom;
  }
  std::string size() const { return fmt::format("{:.0f},{:.0f}", whole_width(), whole_height()); }
  std::string multiplot() const {
    const double w = whole_width(), h = whole_height();
    return fmt::format(
        "set multiplot layout {},{} margins {:.5f},{:.5f},{:.5f},{:.5f} spacing {:.5f},{:.5f}\n",
        rows, columns, left / w, 1.0 - right / w, bottom / h, 1.0 - top / h, beside / w, below / h);
  }
  bool leftmost(std::size_t panel) const { return panel % columns == 0; }
  /// Where the key begins, behind the panels.
  double key() const { return 1.0 - (right - 10.0) / whole_width(); }
};

/// The numbers of a scenario, solver by solver, of poses that are judged.
template <class Visit>
void visit_measured(const Evaluation& evaluation, std::size_t scenario, std::size_t solver,
                    const Visit& visit) {
  for (const EvaluatedPose& pose : evaluation.poses)
    if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure &&
        pose.results.size() > solver && pose.results[solver].measured)
      visit(pose, pose.results[solver].error);
}

/// Quantile of the standard normal distribution, by bisection: a figure needs a few dozen.
double normal_quantile(double probability) {
  double low = -10.0, high = 10.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (0.5 * std::erfc(-middle / std::numbers::sqrt2) < probability ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

/// "0.01, 0.02, 0.05": of a logarithmic scale, which gnuplot labels by decades, were there none in it.
std::string decade_tics(double low, double high) {
  std::string tics;
  for (double decade = std::pow(10.0, std::floor(std::log10(low))); decade <= high; decade *= 10.0)
    for (const double part : {1.0, 2.0, 5.0})
      if (part * decade >= low && part * decade <= high)
        tics += fmt::format("{}{:.6g}", tics.empty() ? "" : ", ", part * decade);
  return tics;
}

/// "uniaxial_x" as gnuplot shows it between single quotes.
std::string in_quotes(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '\'') out += c;
    out += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
  }
  return out;
}

}  // namespace

std::vector<Draft> angle_drafts(const std::filesystem::path& folder, const Plan& plan,
                                const RigFile& rig, const Calibration& calibration,
                                const Evaluation& evaluation) {
  constexpr double kLeastDeg = 1e-6;  // a logarithm wants more than nothing
  constexpr std::size_t kMedians = 40;
  const auto scenario = widest_scenario(plan);
  if (!scenario) return {};
  const Gimbal gimbal(rig.gimbal);
  const IrtModel& camera = calibration.irt;
  PosePoints points({"angle_deg", "error_geodesic_deg"});
  Csv medians({"solver", "angle_deg", "median_error_deg", "poses"});
  struct Curve {
    std::size_t solver;
    FileRows rows;
  };
  std::vector<Curve> curves;
  std::size_t median_row = 0;
  double low = INFINITY, high = 0.0, least_deg = INFINITY, most_deg = 0.0;
  for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
    std::vector<std::pair<double, double>> at;  // angle, error
    visit_measured(evaluation, *scenario, k, [&](const EvaluatedPose& pose, const PoseError& e) {
      if (pose.points_px.empty()) return;
      GimbalAngles angles;
      for (const AxisId axis : kRotaryAxes) angles[axis] = rad_from_deg(pose.read_back_deg[axis]);
      const Vector2d slope = camera.ray(pose.points_px.front()).slope(camera.planes());
      const Vector3d to_camera = Vector3d(slope.x(), slope.y(), 1.0).normalized();
      const double cosine = to_camera.dot(gimbal.rotation(angles).col(2));
      const double angle_deg = deg_from_rad(std::acos(std::clamp(cosine, -1.0, 1.0)));
      const double error_deg = std::max(kLeastDeg, e.geodesic_deg);
      low = std::min(low, error_deg);
      high = std::max(high, error_deg);
      least_deg = std::min(least_deg, angle_deg);
      most_deg = std::max(most_deg, angle_deg);
      at.emplace_back(angle_deg, error_deg);
      Csv& csv = points.row(*evaluation.solvers[k], pose.planned.index).number(angle_deg, 4);
      csv.number(error_deg, 6).end_row();
    });
    if (at.empty()) continue;
    std::ranges::sort(at);
    const std::size_t window = std::min(at.size(), std::max<std::size_t>(3, at.size() / 15)),
                      steps = std::min(kMedians, at.size() - window + 1);
    for (std::size_t i = 0; i < steps; ++i) {
      const std::size_t first = steps == 1 ? 0 : i * (at.size() - window) / (steps - 1);
      std::vector<double> angles, errors;
      for (std::size_t j = first; j < first + window; ++j) {
        angles.push_back(at[j].first);
        errors.push_back(at[j].second);
      }
      medians.text(evaluation.solvers[k]->name).number(percentile(angles, 0.5), 4);
      medians.number(percentile(errors, 0.5), 6).integer(static_cast<std::int64_t>(window));
      medians.end_row();
    }
    curves.push_back({k, {median_row + 1, median_row + steps}});
    median_row += steps;
  }
  if (curves.empty()) return {};
  Draft draft;
  draft.figure.name = "error_angle";
  draft.figure.caption = fmt::format(
      "Geodesic error against the angle between the target's axis and the line of sight of M0, {}: "
      "a panel per solver on one scale, with its running median as a line; in the last panel all "
      "of the medians.",
      plan.scenarios[*scenario].title);
  PanelGrid grid{.below = 105};
  draft.size = grid.of(curves.size() + 1).size();
  draft.commands = fmt::format(
      "set key off\nset logscale y\nset yrange [{:.4g}:{:.4g}]\nset xrange [{:.4g}:{:.4g}]\n"
      "set xlabel 'angle / deg' offset 0,0.3\nset format y '%g'\nset ytics ({})\n{}",
      0.8 * low, 1.25 * high, least_deg - 0.5, most_deg + 0.5, decade_tics(0.8 * low, 1.25 * high),
      grid.multiplot());
  const auto median = [&](const Curve& curve, std::string_view look) {
    draft.element(fmt::format("'error_angle_median.csv' every ::{}::{} using 2:3 with lines {}",
                              curve.rows.first, curve.rows.last, look),
                  {std::string(evaluation.solvers[curve.solver]->name), {}});
  };
  std::size_t panel = 0;
  for (const Curve& curve : curves) {
    const Solver& solver = *evaluation.solvers[curve.solver];
    draft.commands += fmt::format("set title '{}'\nset ylabel '{}'\n", solver.name,
                                  grid.leftmost(panel++) ? "error / deg" : "");
    points.draw(draft, solver, "3", "4", "ps 0.4 " + solver_look(solver, curve.solver));
    median(curve, "lw 2.5 lc rgb 'black' notitle");
    draft.end_plot();
  }
  draft.commands += fmt::format("set title 'running medians'\nset ylabel '{}'\n",
                                grid.leftmost(panel) ? "error / deg" : "");
  std::vector<KeyEntry> key;
  for (const Curve& curve : curves) {
    const Solver& solver = *evaluation.solvers[curve.solver];
    median(curve, solver_line(solver, curve.solver));
    key.push_back({"lines " + solver_line(solver, curve.solver), std::string(solver.name)});
  }
  draft.end_plot().end_multiplot(grid.key(), key);
  points.write(folder / "error_angle.csv");
  medians.write(folder / "error_angle_median.csv");
  return {std::move(draft)};
}

std::vector<Draft> normality_drafts(const std::filesystem::path& folder, const Plan& plan,
                                    const Evaluation& evaluation) {
  constexpr std::size_t kQuantiles = 41, kFewest = 10;
  constexpr double kShown = 8.0;  // standard deviations
  const auto scenario = widest_scenario(plan);
  if (!scenario) return {};
  Csv csv({"axis", "solver", "normal_quantile", "standardised_error", "mean_deg",
           "standard_deviation_deg"});
  struct Line {
    AxisId axis;
    std::size_t solver;
    FileRows rows;
  };
  std::vector<Line> lines;
  std::size_t row = 0, beyond = 0;
  double reach = 0.0;
  for (const AxisId axis : kToldAxes)
    for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
      std::vector<double> errors;
      visit_measured(evaluation, *scenario, k, [&](const EvaluatedPose&, const PoseError& e) {
        errors.push_back(error_of(e, axis));
      });
      const double middle = mean(errors), spread = standard_deviation(errors);
      if (errors.size() < kFewest || !(spread > 0.0)) continue;
      std::ranges::sort(errors);
      const auto n = static_cast<double>(errors.size());
      // Order statistics at about equal distances of the normal quantile, both ends among them.
      const double end = normal_quantile(1.0 - 0.5 / n);
      std::size_t last = errors.size();
      const std::size_t first_row = row + 1;
      for (std::size_t i = 0; i < kQuantiles; ++i) {
        const double wanted = end * (2.0 * static_cast<double>(i) / (kQuantiles - 1) - 1.0);
        const double share = 0.5 * std::erfc(-wanted / std::numbers::sqrt2);
        const auto place =
            std::min(errors.size() - 1,
                     static_cast<std::size_t>(std::max(0.0, std::round(share * n - 0.5))));
        if (place == last) continue;
        last = place;
        const double z = (errors[place] - middle) / spread;
        csv.text(axis_name(axis)).text(evaluation.solvers[k]->name);
        csv.number(normal_quantile((static_cast<double>(place) + 0.5) / n), 4).number(z, 4);
        csv.number(middle, 6).number(spread, 6).end_row();
        ++row;
        reach = std::max({reach, std::abs(z), end});
        if (std::abs(z) > kShown) ++beyond;
      }
      lines.push_back({axis, k, {first_row, row}});
    }
  if (lines.empty()) return {};
  Draft draft;
  draft.figure.name = "error_normal";
  draft.figure.caption = fmt::format(
      "Are the errors of a normal distribution? Each axis' errors, {}, less their mean and in "
      "units of their standard deviation, against normal quantiles: they are where the marks "
      "follow the diagonal; an S says that tails are short, as of systematic errors.{}",
      plan.scenarios[*scenario].title,
      beyond > 0 ? fmt::format(" {} marks beyond {:g} are outside.", beyond, kShown) : "");
  const std::string normal = "lines lw 1 dt 3 lc rgb 'black' title 'normal'";
  PanelGrid grid{.height = 260};
  draft.size = grid.of(kToldAxes.size()).size();
  draft.commands = fmt::format(
      "set xlabel 'normal quantile'\nset ylabel 'standardised error'\nset xrange [{0}:{1}]\n"
      "set yrange [{0}:{1}]\n{2}set key off\n",
      -std::min(kShown, 1.06 * reach), std::min(kShown, 1.06 * reach), grid.multiplot());
  std::map<std::size_t, KeyEntry> of_solvers;
  for (const AxisId axis : kToldAxes) {
    draft.commands += fmt::format("set title '{}'\n", axis_name(axis));
    draft.element("x with " + normal);
    for (const Line& line : lines)
      if (line.axis == axis) {
        const std::string name(evaluation.solvers[line.solver]->name);
        const std::string look = "linespoints lw 0.7 ps 0.55 " +
                                 solver_look(*evaluation.solvers[line.solver], line.solver);
        draft.element(fmt::format("{} using 3:4 with {}", line.rows.every(), look), {name, {}});
        of_solvers[line.solver] = {look, name};
      }
    draft.end_plot().commands += "set ylabel ''\n";
  }
  std::vector<KeyEntry> key{{normal, {}}};
  for (const auto& [solver, entry] : of_solvers) key.push_back(entry);
  draft.end_multiplot(grid.key(), key);
  csv.write(folder / "error_normal.csv");
  return {std::move(draft)};
}

std::vector<Draft> bound_drafts(const std::filesystem::path& folder, const Plan& plan,
                                const TruthLevels& levels) {
  const CrossValidation& judged = levels.judged;
  if (judged.rows.empty()) return {};
  // Pale to dark, so that levels are told apart in grey too.
  constexpr std::array kShades{"#c9e3f5", "#56B4E9", "#00466e"};
  const auto bar_of = [&](TruthLevel level) {
    return fmt::format("boxes fill solid border lc rgb '#333333' lc rgb '{}' title '{}'",
                       kShades[static_cast<std::size_t>(level)], truth_level_name(level));
  };
  const std::string kBound = "lines lw 2 lc rgb 'black' title 'bound'";
  const std::string kRepeatable = "lines lw 2 dt 2 lc rgb '#D55E00' title 'with repeatability'";
  Csv csv({"scenario", "solver", "level", "place", "rmse_total_deg", "bound_total_deg",
           "bound_with_repeatability_deg"});
  Draft draft;
  draft.figure.name = "error_bound";
  draft.figure.caption =
      "Total RMSE on held-out poses as published, aligned and self-calibrated (bars from pale to "
      "dark), and what the noise of the spots alone leaves to any unbiased solver (line; dashed "
      "with the turntable's repeatability): what is between the last bar and the line is left to "
      "gain.";
  std::map<const Solver*, double> of_solver;
  for (const LevelRow& r : judged.rows)
    if (std::isfinite(r.statistics.rmse_total_deg))
      of_solver[r.solver] = std::max(of_solver[r.solver], r.statistics.rmse_total_deg);
  PanelGrid grid{.width = std::max(225.0, 30.0 * static_cast<double>(of_solver.size())),  // names
                 .height = 160,
                 .bottom = 90,
                 .below = 110};
  draft.size = grid.of(judged.bounds.size()).size();
  std::vector<double> ends;
  for (const auto& [solver, end] : of_solver) ends.push_back(end);
  double largest = common_limit(ends);
  if (!ends.empty() && std::ranges::max(ends) > largest)
    draft.figure.caption += " Bars that end at the frame reach beyond it.";
  for (const LevelBound& b : judged.bounds)
    if (std::isfinite(b.total_with_repeatability_deg))
      largest = std::max(largest, b.total_with_repeatability_deg);
  draft.commands = fmt::format(
      "set boxwidth 0.26\nset yrange [0:{:.4g}]\n"
      "set grid noxtics\nset xtics rotate by -30 scale 0\nset key off\n{}",
      1.06 * largest, grid.multiplot());
  std::size_t row = 0, panel = 0;
  for (const LevelBound& bound : judged.bounds) {
    std::vector<std::string> names;
    std::array<std::vector<std::pair<double, double>>, 3> bars;  // by level: place, RMSE
    for (const LevelRow& r : judged.rows) {
      if (r.scenario != bound.scenario) continue;
      const std::string name(r.solver->name);
      auto at = std::ranges::find(names, name);
      if (at == names.end()) at = names.insert(names.end(), name);
      const auto level = static_cast<std::size_t>(r.level);
      bars[level].emplace_back(
          static_cast<double>(at - names.begin()) + 0.27 * (static_cast<double>(level) - 1.0),
          r.statistics.rmse_total_deg);
    }
    std::string tics;
    for (std::size_t i = 0; i < names.size(); ++i)
      tics += fmt::format("{}'{}' {}", i == 0 ? "" : ", ", names[i], i);
    draft.commands +=
        fmt::format("set title '{}'\nset ylabel '{}'\nset xrange [-0.6:{}.6]\nset xtics ({})\n",
                    in_quotes(plan.scenarios[bound.scenario].name),
                    grid.leftmost(panel) ? "total RMSE / deg" : "", names.size() - 1, tics);
    for (const TruthLevel level : kTruthLevels) {
      const auto& of = bars[static_cast<std::size_t>(level)];
      if (of.empty()) continue;
      const FileRows rows{row + 1, row + of.size()};
      row = rows.last;
      for (const auto& [place, rmse_deg] : of) {
        csv.text(plan.scenarios[bound.scenario].name);
        csv.text(names[static_cast<std::size_t>(std::lround(place))]);
        csv.text(truth_level_name(level)).number(place, 2).number(rmse_deg, 6);
        csv.number(bound.total_deg, 6).number(bound.total_with_repeatability_deg, 6).end_row();
      }
      draft.element(fmt::format("{} using 4:5 with {}", rows.every(), bar_of(level)));
    }
    draft.element(fmt::format("{:.8g} with {}", bound.total_deg, kBound));
    draft.element(fmt::format("{:.8g} with {}", bound.total_with_repeatability_deg, kRepeatable));
    draft.end_plot();
    ++panel;
  }
  std::vector<KeyEntry> key;
  for (const TruthLevel level : kTruthLevels) key.push_back({bar_of(level), {}});
  key.insert(key.end(), {{kBound, {}}, {kRepeatable, {}}});
  draft.end_multiplot(grid.key(), key);
  csv.write(folder / "error_bound.csv");
  return {std::move(draft)};
}

std::vector<Draft> repeatability_drafts(const std::filesystem::path& folder, const Plan& plan,
                                        const Evaluation& evaluation,
                                        const std::vector<ScenarioStatistics>& statistics) {
  const auto returned = [](const ScenarioStatistics& s) {
    return std::ranges::any_of(
        s.axes, [](const AxisDetail& a) { return std::isfinite(a.repeatability_deg); });
  };
  std::map<std::size_t, std::vector<const ScenarioStatistics*>> by_scenario;
  for (const ScenarioStatistics& s : statistics)
    if (returned(s)) by_scenario[s.scenario].push_back(&s);
  if (by_scenario.empty()) return {};
  Csv csv({"scenario", "solver", "axis", "place", "repeatability_deg", "repeats"});
  Draft draft;
  draft.figure.name = "error_repeatability";
  draft.figure.caption =
      "Repeatability of the measured angles: how far repeats at the same angles spread about their "
      "mean, by axis and solver, on one scale. Errors that come back every time are not in it.";
  PanelGrid grid{.height = 230};
  draft.size = grid.of(by_scenario.size()).size();
  std::map<const Solver*, double> of_solver;
  for (const auto& [scenario, of] : by_scenario)
    for (const ScenarioStatistics* s : of)
      for (const AxisDetail& a : s->axes)
        if (std::isfinite(a.repeatability_deg))
          of_solver[s->solver] = std::max(of_solver[s->solver], a.repeatability_deg);
  std::vector<double> ends;
  for (const auto& [solver, end] : of_solver) ends.push_back(end);
  const double largest = common_limit(ends);
  if (std::ranges::max(ends) > largest) draft.figure.caption += kBeyondScale;
  draft.commands = fmt::format(
      "set yrange [0:{:.4g}]\nset xrange [-0.5:2.5]\nset xtics scale 0 ({})\nset key off\n{}",
      largest > 0.0 ? 1.1 * largest : 1.0, "'pitch' 0, 'roll' 1, 'yaw' 2", grid.multiplot());
  std::map<std::size_t, KeyEntry> of_solvers;
  std::size_t row = 0, panel = 0;
  for (const auto& [scenario, of] : by_scenario) {
    draft.commands += fmt::format("set title '{}, {} repeats'\nset ylabel '{}'\n",
                                  in_quotes(plan.scenarios[scenario].name), of.front()->repeats,
                                  grid.leftmost(panel) ? "repeatability / deg" : "");
    for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
      const Solver& solver = *evaluation.solvers[k];
      const auto found = std::ranges::find(of, &solver, &ScenarioStatistics::solver);
      if (found == of.end()) continue;
      const FileRows rows{row + 1, row + kToldAxes.size()};
      row = rows.last;
      const auto solvers = static_cast<double>(evaluation.solvers.size());
      const double aside =
          std::min(0.12, 0.9 / solvers) * (static_cast<double>(k) - 0.5 * (solvers - 1.0));
      for (std::size_t a = 0; a < kToldAxes.size(); ++a) {
        csv.text(plan.scenarios[scenario].name).text(solver.name).text(axis_name(kToldAxes[a]));
        csv.number(static_cast<double>(a) + aside, 3)
            .number((*found)->axes[a].repeatability_deg, 6);
        csv.integer((*found)->repeats).end_row();
      }
      const std::string look = "points ps 1.1 lw 1.5 " + solver_look(solver, k);
      draft.element(fmt::format("{0} using 4:($5 > {1:.6g} ? {1:.6g} : $5) with {2}", rows.every(),
                                largest, look),
                    {std::string(solver.name), {}});
      of_solvers[k] = {look, std::string(solver.name)};
    }
    draft.end_plot();
    ++panel;
  }
  std::vector<KeyEntry> key;
  for (const auto& [k, entry] : of_solvers) key.push_back(entry);
  draft.end_multiplot(grid.key(), key);
  csv.write(folder / "error_repeatability.csv");
  return {std::move(draft)};
}

std::vector<Draft> drift_drafts(const std::filesystem::path& folder, const RunRecord& record,
                                const Evaluation& published, const TruthLevels& levels) {
  constexpr std::size_t kBlocks = 40, kFewestPerBlock = 5;
  const bool residual = !levels.judged.rows.empty();
  const Evaluation evaluation =
      residual ? at_level(published, levels.judged, TruthLevel::kSelfCalibrated) : published;
  // Each session's clock begins anew: then the order alone is told.
  const bool one_clock = record.sessions.size() < 2;
  std::map<std::size_t, double> when;
  for (std::size_t i = 0; i < record.poses.size(); ++i)
    when[record.poses[i].planned.index] =
        one_clock ? record.poses[i].rig_time_s / 3600.0 : static_cast<double>(i);
  Csv csv({"solver", "what", "scenario", "pose", one_clock ? "rig_time_h" : "order_of_taking",
           "error_pitch_deg", "error_roll_deg", "error_yaw_deg", "poses"});
  std::size_t row = 0;
  const auto add = [&](const Solver& solver, std::string_view what, const PlannedPose& of,
                       double time, const Vector3d& error_deg, std::size_t poses) {
    csv.text(solver.name).text(what).text(record.plan.scenarios[of.scenario].name);
    csv.integer(static_cast<std::int64_t>(of.index)).number(time, 5);
    for (const double e : error_deg) csv.number(e, 6);
    csv.integer(static_cast<std::int64_t>(poses)).end_row();
    ++row;
  };
  std::vector<double> largest(evaluation.solvers.size());
  struct Lines {
    std::vector<FileRows> means;  ///< one per scenario and repeat: no line from one to the next
    FileRows returns;
    std::vector<std::size_t> return_poses;
  };
  std::vector<Lines> of_solver(evaluation.solvers.size());
  for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
    const Solver& solver = *evaluation.solvers[k];
    std::map<std::pair<std::size_t, int>, std::vector<const EvaluatedPose*>> stretches;
    Lines& lines = of_solver[k];
    lines.returns.first = row + 1;
    for (const EvaluatedPose& pose : evaluation.poses) {
      if (pose.results.size() <= k || !pose.results[k].measured ||
          !when.contains(pose.planned.index))
        continue;
      const PoseError& e = pose.results[k].error;
      if (pose.planned.role == PoseRole::kMeasure)
        stretches[{pose.planned.scenario, pose.planned.repeat}].push_back(&pose);
      if (pose.planned.role != PoseRole::kReturn) continue;
      lines.return_poses.push_back(pose.planned.index);
      const Vector3d error_deg(e.pitch_deg, e.roll_deg, e.yaw_deg);
      add(solver, "return", pose.planned, when[pose.planned.index], error_deg, 1);
      largest[k] = std::max(largest[k], error_deg.cwiseAbs().maxCoeff());
    }
    lines.returns.last = row;
    for (const auto& [of, poses] : stretches) {
      const std::size_t blocks =
          std::clamp<std::size_t>(poses.size() / kFewestPerBlock, 1, kBlocks);
      const std::size_t first = row + 1;
      for (std::size_t b = 0; b < blocks; ++b) {
        const std::size_t begin = b * poses.size() / blocks, end = (b + 1) * poses.size() / blocks;
        Vector3d sum = Vector3d::Zero();
        double time = 0.0;
        for (std::size_t i = begin; i < end; ++i) {
          const PoseError& e = poses[i]->results[k].error;
          sum += Vector3d(e.pitch_deg, e.roll_deg, e.yaw_deg);
          time += when[poses[i]->planned.index];
        }
        const auto n = static_cast<double>(end - begin);
        add(solver, "mean", poses[begin]->planned, time / n, sum / n, end - begin);
        largest[k] = std::max(largest[k], sum.cwiseAbs().maxCoeff() / n);
      }
      lines.means.push_back({first, row});
    }
  }
  if (row == 0) return {};
  const bool returns = std::ranges::any_of(
      of_solver, [](const Lines& lines) { return !lines.return_poses.empty(); });
  Draft draft;
  draft.figure.name = "error_drift";
  draft.figure.caption = fmt::format(
      "Does anything drift? Errors {} in the order of time{}: lines are means of blocks of poses, "
      "scenario by scenario and repeat by repeat; they wave with the angles of a scenario, and a "
      "drift would carry them away{}.",
      residual ? "at level \"self-calibrated\"" : "as published",
      one_clock ? "" : " (several sessions: by the order of taking)",
      returns ? "; marks are poses at zero angles again, whose error is what has moved since the "
                "beginning of their repeat"
              : " (this run has no poses that return to zero, which would show it alone)");
  const PanelGrid grid{
      .rows = kToldAxes.size(), .width = 750, .height = 170, .top = 15, .below = 20};
  draft.size = grid.size();
  draft.commands = grid.multiplot() +
                   "set key off\nset offsets graph 0.02, graph 0.02, graph 0.05, graph 0.05\n"
                   "set xzeroaxis lc rgb '#888888'\nset format x ''\nset autoscale xfix\n";
  std::erase(largest, 0.0);  // measured nothing
  const double limit = common_limit(largest);
  if (!largest.empty() && std::ranges::max(largest) > limit) {
    draft.commands += fmt::format("set yrange [{:.6g}:{:.6g}]\n", -limit, limit);
    draft.figure.caption += kBeyondScale;
  }
  const auto within = [limit](std::size_t column) {
    return fmt::format("(${0} > {1:.6g} ? {1:.6g} : ${0} < -{1:.6g} ? -{1:.6g} : ${0})", column,
                       limit);
  };
  const auto look_of = [&](std::size_t k) {
    return fmt::format("linespoints ps 0.45 pt {} {}", k + 4,
                       solver_line(*evaluation.solvers[k], k));
  };
  for (std::size_t a = 0; a < kToldAxes.size(); ++a) {
    draft.commands += fmt::format("set ylabel '{} error / deg'\n", axis_name(kToldAxes[a]));
    if (a + 1 == kToldAxes.size())
      draft.commands += fmt::format("set format x '%g'\nset xlabel '{}'\n",
                                    one_clock ? "rig time / h" : "pose in the order of taking");
    for (std::size_t k = 0; k < of_solver.size(); ++k) {
      const Solver& solver = *evaluation.solvers[k];
      const Lines& lines = of_solver[k];
      // With marks: of few poses there is a single block, and no line.
      for (const FileRows& rows : lines.means)
        draft.element(fmt::format("{} using 5:{} with {}", rows.every(), within(a + 6), look_of(k)),
                      {std::string(solver.name), {}});
      if (!lines.return_poses.empty())
        draft.element(fmt::format("{} using 5:{} with points ps 0.9 {}", lines.returns.every(),
                                  within(a + 6), solver_look(solver, k)),
                      {std::string(solver.name), lines.return_poses});
    }
    draft.end_plot();
  }
  std::vector<KeyEntry> key;
  for (std::size_t k = 0; k < of_solver.size(); ++k)
    if (!of_solver[k].means.empty() || !of_solver[k].return_poses.empty())
      key.push_back({look_of(k), std::string(evaluation.solvers[k]->name)});
  draft.end_multiplot(grid.key(), key);
  csv.write(folder / "error_drift.csv");
  return {std::move(draft)};
}

std::vector<Draft> budget_drafts(const std::filesystem::path& folder, const Plan& plan,
                                 const std::vector<ErrorBudget>& budgets) {
  const auto scenario = widest_scenario(plan);
  std::vector<const ErrorBudget*> of;
  for (const ErrorBudget& b : budgets)
    if (scenario == b.scenario && b.poses > 0 && b.drawn.total_deg() > 0.0) of.push_back(&b);
  if (of.empty()) return {};
  const bool found = std::ranges::all_of(
      of, [](const ErrorBudget* b) { return b->found && b->found->total_deg() > 0.0; });
  constexpr double kNumbered = 0.04;  // of the scale: a piece that has its number in it
  constexpr double kOfItsOwn = 0.01;  // of some bar: a cause that has a colour of its own
  constexpr std::array kPanelTitles{"built to the drawings", "as found"};
  constexpr std::string_view kRest = "all others", kObserved = "observed";

  struct Bar {
    const ErrorBudget* budget;
    bool as_found;
    double predicted_deg;
    double share(const BudgetLine& line) const {
      const double deg =
          as_found ? line.found.value_or(Contribution{}).total_deg() : line.drawn.total_deg();
      return deg * deg / (predicted_deg * predicted_deg);
    }
    double observed() const { return std::pow(budget->observed.total_deg() / predicted_deg, 2); }
  };
  std::vector<std::vector<Bar>> panels(found ? 2 : 1);
  for (const ErrorBudget* b : of) {
    panels[0].push_back({b, false, b->drawn.total_deg()});
    if (found) panels[1].push_back({b, true, b->found->total_deg()});
  }
  std::array<bool, kCauses> shown_alone{};
  double highest = 1.0;
  for (const auto& panel : panels)
    for (const Bar& bar : panel) {
      double sum = 0.0;
      for (const BudgetLine& line : bar.budget->lines) {
        sum += bar.share(line);
        if (bar.share(line) >= kOfItsOwn) shown_alone[static_cast<std::size_t>(line.cause)] = true;
      }
      highest = std::max({highest, sum, bar.observed()});
    }

  Csv csv({"panel", "solver", "place", "cause", "from_percent", "to_percent", "contribution_deg",
           "predicted_deg"});
  struct Piece {
    std::size_t panel, place;
    double from, to;  ///< percent
    double contribution_deg;
  };
  std::vector<std::string> causes;  // in the order of the bars, from below
  for (int c = 0; c < kCauses; ++c)
    if (shown_alone[static_cast<std::size_t>(c)])
      causes.emplace_back(cause_name(static_cast<Cause>(c)));
  causes.emplace_back(kRest);
  std::map<std::string, std::vector<Piece>> pieces;
  for (std::size_t p = 0; p < panels.size(); ++p)
    for (std::size_t i = 0; i < panels[p].size(); ++i) {
      const Bar& bar = panels[p][i];
      std::map<std::string, double> share;
      for (const BudgetLine& line : bar.budget->lines)
        share[shown_alone[static_cast<std::size_t>(line.cause)]
                  ? std::string(cause_name(line.cause))
                  : std::string(kRest)] += bar.share(line);
      double from = 0.0;
      for (const std::string& cause : causes) {
        if (!(share[cause] > 0.0)) continue;
        const double to = from + 100.0 * share[cause];
        pieces[cause].push_back({p, i, from, to, bar.predicted_deg * std::sqrt(share[cause])});
        from = to;
      }
    }

  Draft draft;
  draft.figure.name = "error_budget";
  draft.figure.caption = fmt::format(
      "Where the error comes from, {}: shares of the causes in the predicted mean square of every "
      "solver's total error, for a rig built to the drawings{}. Numbers are those of the key; "
      "at the top stands the predicted total, deg; diamond: the observed mean square.",
      plan.scenarios[*scenario].title,
      found ? " and for this one as found (its causes add up pose by pose: to more than 100 % "
              "where they cancel, to less where they join)"
            : "");
  const PanelGrid grid{.columns = panels.size(),
                       .width = 62.0 * static_cast<double>(of.size()),
                       .height = 380,
                       .right = 320,
                       .bottom = 90};
  draft.size = grid.size();
  std::string tics;
  for (std::size_t i = 0; i < of.size(); ++i)
    tics += fmt::format("{}'{}' {}", i == 0 ? "" : ", ", of[i]->solver->name, i);
  draft.commands = fmt::format(
      "set ylabel 'share of the mean square / %'\n"
      "set yrange [0:{:.5g}]\nset xrange [-0.6:{}.6]\nset xtics ({}) rotate by -30 scale 0\n"
      "set grid noxtics\n{}set key left at screen {:.4f},0.9 reverse Left samplen 1\n",
      115.0 * highest, of.size() - 1, tics, grid.multiplot(),
      1.0 - (grid.right - 10.0) / grid.whole_width());
  std::map<std::pair<std::size_t, std::string>, FileRows> rows;
  std::size_t row = 0;
  for (std::size_t p = 0; p < panels.size(); ++p) {
    const auto add = [&](std::size_t place, const std::string& cause, double from, double to,
                         double contribution_deg) {
      const Bar& bar = panels[p][place];
      csv.text(kPanelTitles[p]).text(bar.budget->solver->name);
      csv.integer(static_cast<std::int64_t>(place)).text(cause).number(from, 3).number(to, 3);
      csv.number(contribution_deg, 6).number(bar.predicted_deg, 6).end_row();
      ++row;
      rows.try_emplace({p, cause}, FileRows{row, row}).first->second.last = row;
    };
    for (const std::string& cause : causes)
      for (const Piece& piece : pieces[cause])
        if (piece.panel == p) add(piece.place, cause, piece.from, piece.to, piece.contribution_deg);
    for (std::size_t i = 0; i < panels[p].size(); ++i)
      add(i, std::string(kObserved), 0.0, 100.0 * panels[p][i].observed(),
          panels[p][i].budget->observed.total_deg());
  }
  for (std::size_t p = 0; p < panels.size(); ++p) {
    draft.commands += fmt::format("unset label\nset title '{}'\n", kPanelTitles[p]);
    for (std::size_t i = 0; i < panels[p].size(); ++i) {
      for (std::size_t c = 0; c < causes.size(); ++c)
        for (const Piece& piece : pieces[causes[c]]) {
          if (piece.panel != p || piece.place != i) continue;
          if (piece.to - piece.from > 100.0 * kNumbered * highest)
            draft.commands += fmt::format("set label '{}' at {},{:.6g} center front\n", c + 1, i,
                                          0.5 * (piece.from + piece.to));
        }
      draft.commands +=
          fmt::format("set label '{:.4f}' at {},graph 0.97 center font 'sans,11' front\n",
                      panels[p][i].predicted_deg, i);
    }
    for (std::size_t c = 0; c < causes.size(); ++c) {
      // A colour that comes again is hatched.
      const std::string look =
          fmt::format("fill {} border lc rgb '#333333' lc rgb '{}' title '{}'",
                      c < kColours.size() || causes[c] == kRest ? "solid" : "pattern 2",
                      causes[c] == kRest ? "#bbbbbb" : kColours[c % kColours.size()],
                      fmt::format("{} {}", c + 1, causes[c]));
      const auto at = rows.find({p, causes[c]});
      // What only the other panel has is in the key as well.
      draft.element(at == rows.end()
                        ? "1/0 with boxes " + look
                        : fmt::format("{} using 3:5:($3-0.38):($3+0.38):5:6 with boxxyerror {}",
                                      at->second.every(), look));
    }
    draft.element(
        fmt::format("{} using ($3+0.27):6 with points pt 13 ps 1.6 lc rgb 'black' title 'observed'",
                    rows.at({p, std::string(kObserved)}).every()));
    draft.end_plot().commands += "set key off\nset ylabel ''\n";
  }
  draft.commands += "unset multiplot\n";
  csv.write(folder / "error_budget.csv");
  return {std::move(draft)};
}

}  // namespace turntable
