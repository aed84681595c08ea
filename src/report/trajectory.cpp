#include "src/report/trajectory.h"

#include <fmt/format.h>

#include <algorithm>
#include <tuple>

#include "src/record/csv.h"

namespace turntable {
namespace {

/// Viridis without its light end, which white paper swallows.
constexpr const char* kPath = "set palette defined (0 '#440154', 0.5 '#31688e', 1 '#35b779')\n";
constexpr double kRowPx = 330.0, kTitlePx = 50.0;

int column_of(AxisId axis) {
  return axis == AxisId::kStage ? 3 : axis == AxisId::kYaw ? 4 : axis == AxisId::kRoll ? 5 : 6;
}

/// With a little room around the data, so that no line lies on the frame.
std::string placed(const Panel& p) {
  return fmt::format(
      "set autoscale fix\n"
      "set offsets graph 0.03, graph 0.03, graph 0.06, graph 0.06\n"
      "set origin {:.5f},{:.5f}\nset size {:.5f},{:.5f}\n",
      p.x, p.y, p.width, p.height);
}

/// In single quotes, where gnuplot takes everything as it is but these and the end of a line.
std::string quoted(const std::string& text) {
  std::string out = "'";
  for (const char c : text) {
    if (c == '\'') out += c;
    out += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
  }
  return out + "'";
}

/// The axis that moves at every pose lies below the ones that move seldom.
std::string angles(const std::vector<AxisId>& axes, const std::string& every, const Panel& panel) {
  std::vector<AxisId> order(axes.rbegin(), axes.rend());
  for (const AxisId axis : kRotaryAxes)
    if (std::ranges::find(order, axis) == order.end()) order.push_back(axis);
  std::string plots;
  for (const AxisId axis : order) {
    const auto [name, dash, colour] = axis == AxisId::kYaw    ? std::tuple{"yaw (z)", 1, 0}
                                      : axis == AxisId::kRoll ? std::tuple{"roll (y)", 2, 1}
                                                              : std::tuple{"pitch (x)", 4, 2};
    plots += fmt::format("{}'DATA' {} using 1:{} with steps lw {} dt {} lc rgb '{}' title '{}'",
                         plots.empty() ? "" : ", ", every, column_of(axis),
                         plots.empty() && axes.size() > 1 ? 1.2 : 1.8, dash,
                         kColours[static_cast<std::size_t>(colour)], name);
  }
  return placed(panel) +
         "set xlabel 'pose'\nset ylabel 'angle / deg'\nset key outside top center "
         "horizontal\nplot " +
         plots + "\n";
}

std::string stage(const std::string& every, const Panel& panel) {
  return placed(panel) + fmt::format(
                             "set xlabel 'pose'\nset ylabel 'stage / mm'\nset key off\n"
                             "plot 'DATA' {} using 1:3 with steps lw 1.5 lc rgb '{}'\n",
                             every, kColours[3]);
}

/// Poses as points on their path, in the plane of two axes or the space of three; colour = pose.
std::string path(const std::vector<AxisId>& axes, const std::string& every, const Panel& panel) {
  const auto label = [](char which, AxisId axis) {
    return fmt::format("set {}label '{} / deg'\n", which, axis_name(axis));
  };
  const char* look = "with linespoints pt 7 ps 0.4 lw 1 lc palette";
  const std::string head = std::string("unset title\nset key off\nset cblabel 'pose'\n") + kPath;
  if (axes.size() == 2)
    return placed(panel) + head + label('x', axes[1]) + label('y', axes[0]) +
           fmt::format("plot 'DATA' {} using {}:{}:1 {}\n", every, column_of(axes[1]),
                       column_of(axes[0]), look);
  // The scale has a place of its own: where gnuplot puts it, there is no room for its label, which is left out.
  const Panel space{panel.x, panel.y, 0.78 * panel.width, panel.height};
  return placed(space) +
         fmt::format("set colorbox user origin {:.5f},{:.5f} size {:.5f},{:.5f}\n",
                     panel.x + 0.79 * panel.width, panel.y + 0.3 * panel.height,
                     0.035 * panel.width, 0.4 * panel.height) +
         head + label('x', AxisId::kPitch) + label('y', AxisId::kRoll) +
         "set zlabel 'yaw / deg' rotate\nset xyplane 0.05\nset view 60,35\n"
         "set tics font ',9'\n" +
         fmt::format("splot 'DATA' {} using 6:5:4:1 {}\nset tics font ''\n", every, look);
}

}  // namespace

std::string trajectory_commands(const std::vector<AxisId>& axes, const std::string& every,
                                const Panel& panel) {
  if (axes.size() < 2) return angles(axes, every, panel);
  const double left = 0.56 * panel.width;
  return angles(axes, every, {panel.x, panel.y, left, panel.height}) +
         path(axes, every, {panel.x + left, panel.y, panel.width - left, panel.height});
}

std::string plan_picture(const Plan& plan, const std::vector<PhaseTimes>& times) {
  Csv csv({"pose", "time_s", "stage_mm", "yaw_deg", "roll_deg", "pitch_deg"});
  struct Rows {
    std::size_t first = 0, count = 0;
    double time_s = 0.0;
  };
  std::vector<Rows> rows(plan.scenarios.size());
  double time_s = 0.0;
  for (std::size_t i = 0; i < plan.poses.size(); ++i) {
    const PlannedPose& p = plan.poses[i];
    time_s += times[i].total_s();
    csv.integer(static_cast<std::int64_t>(p.index)).number(time_s, 3).number(p.stage_mm, 4);
    csv.number(p.yaw_deg, 4).number(p.roll_deg, 4).number(p.pitch_deg, 4).end_row();
    Rows& r = rows[p.scenario];
    if (r.count == 0) r.first = i;
    if (plan.scenario_of(p).kind == ScenarioKind::kAttitude && p.repeat > 1) continue;
    ++r.count;
    r.time_s += times[i].total_s();
  }

  const double height = kTitlePx + kRowPx * static_cast<double>(rows.size());
  Draft draft;
  draft.figure.name = "trajectory";
  draft.size = fmt::format("1100,{:.0f}", height);
  draft.commands = fmt::format("set multiplot title {} font ',16'\n", quoted(plan.title));
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const ScenarioInfo& s = plan.scenarios[k];
    const Rows& r = rows[k];
    const std::string every = fmt::format("every ::{}::{}", r.first + 1, r.first + r.count);
    const double row = kRowPx / height;
    const Panel panel{0.0, 1.0 - kTitlePx / height - static_cast<double>(k + 1) * row, 1.0, row};
    draft.commands += fmt::format(
        "set title {}\n",
        quoted(fmt::format("{}: {} poses{}, {}", s.name, r.count,
                           s.kind == ScenarioKind::kAttitude && s.repeats > 1
                               ? fmt::format(" of the first of {} repeats", s.repeats)
                               : "",
                           r.time_s < 120.0 ? fmt::format("{:.0f} s", r.time_s)
                                            : fmt::format("{:.0f} min", r.time_s / 60.0))));
    if (s.kind == ScenarioKind::kCalibration)
      draft.commands += stage(every, {0.0, panel.y, 0.4, row}) + "unset title\n" +
                        angles({}, every, {0.4, panel.y, 0.6, row});
    else
      draft.commands += trajectory_commands(s.axes, every, panel);
    draft.commands += "unset title\n";
  }
  draft.commands += "unset multiplot\n";
  return draw_svg(draft, csv.str());
}

}  // namespace turntable
