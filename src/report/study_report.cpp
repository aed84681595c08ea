#include "src/report/study_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "src/core/errors.h"
#include "src/core/units.h"
#include "src/record/atomic_file.h"
#include "src/record/folder.h"
#include "src/report/html_report.h"

namespace turntable {
namespace {

using StudyPath = std::filesystem::path;

/// Lines told apart without colour: dash and point type of solver `index`.
std::string line_style(std::size_t index) {
  constexpr int kPoints[] = {6, 4, 8, 10, 12, 2, 1, 3, 7, 5};
  return fmt::format("pt {} ps 0.8 dt {} lw 1.5 lc rgb '{}'", kPoints[index % std::size(kPoints)],
                     1 + index % 5, kColours[index % kColours.size()]);
}

std::string case_name(const NoiseRow& row) {
  return row.setting.target + "_" + row.setting.poses.name;
}

/// Rows of one target and pose range stand together; calls `use(first, count)` for each.
template <class Use>
void each_case(const SolverStudy& study, Use&& use) {
  for (std::size_t first = 0, end; first < study.noise.size(); first = end) {
    end = first;
    while (end < study.noise.size() && case_name(study.noise[end]) == case_name(study.noise[first]))
      ++end;
    use(std::span<const NoiseRow>(study.noise).subspan(first, end - first));
  }
}

std::string lens_name(double walk_mm) {
  return walk_mm == 0.0 ? "central" : fmt::format("pupil walks {:g} mm", walk_mm);
}

const char* tail_mark(const Judgement& j) { return j.heavy_tail() ? " \\*" : ""; }

std::string number_or_dash(double value, int decimals) {
  return std::isfinite(value) ? fixed(value, decimals) : "-";
}

std::string solver_list(const SolverStudy& study, const std::string& format) {
  std::string text;
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s)
    text += fmt::format(fmt::runtime(format), fmt::arg("comma", s > 0 ? ", " : ""),
                        fmt::arg("name", study.options.solvers[s]->name), fmt::arg("index", s));
  return text;
}

Draft noise_draft(const StudyPath& folder, const SolverStudy& study,
                  std::span<const NoiseRow> rows) {
  const std::string name = "noise_" + case_name(rows[0]);
  Csv csv({"noise_px", "pupil_walk_mm", "solver_index", "solver", "rmse_over_bound", "lower_95",
           "upper_95"});
  for (const NoiseRow& row : rows)
    for (std::size_t s = 0; s < row.judgements.size(); ++s) {
      const Judgement& j = row.judgements[s];
      csv.number(row.setting.noise_px, 2).number(row.walk_mm, 1);
      csv.integer(static_cast<std::int64_t>(s)).text(study.options.solvers[s]->name);
      csv.number(j.over_bound, 5).number(j.over_bound_95.lower, 5);
      csv.number(j.over_bound_95.upper, 5).end_row();
    }
  csv.write(folder / (name + ".csv"));
  constexpr double kTop = 4.0;  // what is above is no matter of degree
  Draft draft;
  draft.figure.name = name;
  draft.figure.caption = fmt::format(
      "RMSE over the Cramer-Rao bound with 95 % intervals, target {}, poses {}: central lens and "
      "pupils that walk so far from the axis to the image's edge. The axis is linear near 1 and "
      "logarithmic away from it. Arrows at the upper edge: above {:g}, beyond the frame; the "
      "numbers are in the table.",
      rows[0].setting.target, rows[0].setting.poses.name, kTop);
  draft.size = "1000,900";
  double low = 0.98;
  for (const NoiseRow& row : rows)
    for (const Judgement& j : row.judgements) low = std::fmin(low, j.over_bound_95.lower);
  draft.commands = fmt::format(
      "top = {}\nset yrange [{:.3f}:1.1 * top]\nset nonlinear y via asinh((y - 1) / 0.05) inverse "
      "1 "
      "+ 0.05 * sinh(y)\n"
      "set ylabel 'RMSE over bound'\nset ytics (0.5, 0.8, 0.9, 0.95, 0.98, 1, 1.02, 1.05, 1.1, "
      "1.2, "
      "1.5, 2, 3, 4)\nset xtics rotate by -25 ({})\nset xrange [-0.6:{}]\n"
      "set multiplot layout 2,1\n",
      kTop, low - 0.01, solver_list(study, "{comma}'{name}' {index}"),
      static_cast<double>(study.options.solvers.size()) - 0.4);
  constexpr int kMarks[] = {7, 5, 9, 13};  // filled: circle, square, triangle, diamond
  for (const double noise_px : kStudyNoises_px) {
    draft.commands +=
        fmt::format("set title '{:g} px'\nplot 1 with lines lc rgb '#888888' notitle", noise_px);
    for (std::size_t k = 0; k < std::size(kStudyWalks_mm); ++k) {
      const double beside = 0.15 * (static_cast<double>(k) - 1.5);
      draft.commands += fmt::format(
          ", 'DATA' every ::1 using ($1 == {0} && $2 == {1} && $5 <= top ? $3 + {2} : 1/0):5:6:7 "
          "with yerrorbars pt {3} ps 0.9 lc rgb '{4}' title '{5}'"
          ", 'DATA' every ::1 using ($1 == {0} && $2 == {1} && $5 > top ? $3 + {2} : 1/0):(0.7 * "
          "top):(0):(0.35 * top) with vectors head filled lw 1.5 lc rgb '{4}' notitle",
          noise_px, kStudyWalks_mm[k], beside, kMarks[k], kColours[k],
          lens_name(kStudyWalks_mm[k]));
    }
    draft.commands += "\n";
  }
  draft.commands += "unset multiplot\n";
  return draft;
}

Draft basin_draft(const StudyPath& folder, const SolverStudy& study, Factor factor) {
  const std::string name = fmt::format("basin_{}", factor_name(factor));
  Csv csv({"value", "solver_index", "solver", "success_percent", "lower_95_percent",
           "upper_95_percent"});
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s)
    for (const BasinRow& row : study.basin)
      if (row.factor == factor)
        csv.number(row.value, 3)
            .integer(static_cast<std::int64_t>(s))
            .text(study.options.solvers[s]->name)
            .number(100.0 * row.judgements[s].success_rate(), 3)
            .number(100.0 * row.judgements[s].success_95().lower, 3)
            .number(100.0 * row.judgements[s].success_95().upper, 3)
            .end_row();
  csv.write(folder / (name + ".csv"));
  const std::vector<double> values = factor_values(factor, study.options);
  const bool by_decades = factor != Factor::kViewAngle;
  // Zero has no place on an axis of decades: it gets one below the smallest value.
  const bool with_zero = by_decades && values.front() == 0.0;
  const double at_zero = with_zero ? values.at(1) / 4.0 : 0.0;
  const double low = with_zero ? at_zero : values.front();
  const double margin = by_decades ? 1.15 : 3.0;
  Draft draft;
  draft.figure.name = name;
  draft.figure.caption = fmt::format(
      "Success against {} with 95 % intervals, {} poses per point, all else at the centre. Solvers "
      "that never fail lie on each other at the top.{}",
      factor_label(factor), study.basin_poses,
      with_zero
          ? " The leftmost points are those of zero, which the logarithmic axis does not have."
          : "");
  draft.commands = fmt::format(
      "set xlabel '{}'\nset ylabel 'success / %'\nset yrange [-3:103]\nset xrange [{:.4g}:{:.4g}]\n"
      "{}{}zero = {:g}\nplot ",
      factor_label(factor), by_decades ? low / margin : low - margin,
      by_decades ? values.back() * margin : values.back() + margin,
      by_decades ? "set logscale x\n" : "",
      with_zero ? fmt::format("set xtics add ('0' {:g})\n", at_zero) : "", at_zero);
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s)
    draft.commands += fmt::format(
        "{}'DATA' every ::1 using ($2 == {} ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with "
        "yerrorlines {} title '{}'",
        s > 0 ? ", " : "", s, line_style(s), study.options.solvers[s]->name);
  draft.commands += "\n";
  return draft;
}

Draft map_draft(const StudyPath& folder, const SolverStudy& study) {
  std::vector<double> ratios;
  for (const MapRow& row : study.map)
    if (ratios.empty() || ratios.back() != row.depth_ratio) ratios.push_back(row.depth_ratio);
  Csv csv({"solver_index", "solver", "view_angle_deg", "depth_ratio", "depth_index",
           "success_percent"});
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s)
    for (const MapRow& row : study.map)
      csv.integer(static_cast<std::int64_t>(s))
          .text(study.options.solvers[s]->name)
          .number(row.view_deg, 1)
          .number(row.depth_ratio, 3)
          .integer(std::ranges::find(ratios, row.depth_ratio) - ratios.begin())
          .number(100.0 * row.judgements[s].success_rate(), 2)
          .end_row();
  csv.write(folder / "basin_map.csv");
  const std::size_t columns = std::min<std::size_t>(3, study.options.solvers.size());
  const std::size_t rows = (study.options.solvers.size() + columns - 1) / columns;
  std::string tics;
  for (std::size_t i = 0; i < ratios.size(); ++i)
    tics += fmt::format("{}'{:g}' {}", i > 0 ? ", " : "", ratios[i], i);
  Draft draft;
  draft.figure.name = "basin_map";
  draft.figure.caption = fmt::format(
      "Success per solver against view angle and depth over size of the target, {} poses per cell, "
      "all else at the centre.",
      study.map_poses);
  const double width = 320.0 * static_cast<double>(columns) + 140.0;
  draft.size = fmt::format("{:.0f},{}", width, 300 * rows);
  draft.commands = fmt::format(
      "set palette maxcolors 10 defined (0 '#8c2d04', 0.5 '#E69F00', 1 '#fff5e1')\n"
      "set cbrange [0:100]\nset cblabel 'success / %'\nset colorbox user origin {:.3f},0.2 size "
      "0.015,0.6\nset key off\nunset grid\nset xrange [-5:85]\nset yrange [-0.5:{}.5]\nset ytics "
      "({})\nset xtics 0,20\nset xlabel 'view angle / deg'\nset style fill solid noborder\nset "
      "multiplot layout {},{} margins screen {:.3f}, {:.3f}, {:.3f}, {:.3f} spacing screen {:.3f}, "
      "{:.3f}\n",
      1.0 - 100.0 / width, ratios.size() - 1, tics, rows, columns, 80.0 / width,
      1.0 - 120.0 / width, 0.25 / static_cast<double>(rows), 1.0 - 0.15 / static_cast<double>(rows),
      60.0 / width, 0.4 / static_cast<double>(rows));
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s)
    draft.commands += fmt::format(
        "set title '{}'\nset ylabel '{}'\nplot 'DATA' every ::1 using ($1 == {} ? $3 : "
        "1/0):5:(5):(0.5):6 with boxxyerror lc palette\nunset colorbox\n",
        study.options.solvers[s]->name, s % columns == 0 ? "depth over size" : "", s);
  draft.commands += "unset multiplot\n";
  return draft;
}

std::string noise_text(const SolverStudy& study, std::span<const NoiseRow> rows) {
  const StudySetting& setting = rows[0].setting;
  const PoseRange& poses = setting.poses;
  std::string md =
      fmt::format("### Target {}, poses {}\n\nPoints / mm:", setting.target, poses.name);
  for (const Vector3d& p : setting.target_mm)
    md += fmt::format(" ({:g}, {:g}, {:g})", p.x(), p.y(), p.z());
  md += fmt::format(
      ". Camera {:g} mm above M0, f = {:g} px, {:g} px ({:.1f} deg) from the axis to the image's "
      "edge; M0 within {:.0f} mm across and {:.0f} mm along the axis; view angle {:g} to {:g} deg, "
      "about any horizontal axis, after {}.\n\n",
      setting.lens.centre_mm.z() - 0.5 * (setting.lens.planes.a_mm + setting.lens.planes.b_mm),
      setting.lens.focal_px, setting.lens.half_field_px, kDegPerRad * setting.lens.half_field_rad(),
      poses.lateral_mm, poses.along_mm, poses.view_low_deg, poses.view_high_deg,
      poses.quarter_turns ? std::string("quarter turns about the axis, exactly")
      : poses.turn_spread_deg >= 180.0
          ? std::string("any turn about it")
          : fmt::format("turns of {:g} deg, give or take {:g}, about it", poses.turn_deg,
                        poses.turn_spread_deg));
  md += "RMSE over the bound, by noise and lens:\n\n| solver |";
  std::string rule = "|---|";
  for (const NoiseRow& row : rows) {
    md += fmt::format(" {:g} px, {} |", row.setting.noise_px, lens_name(row.walk_mm));
    rule += "--:|";
  }
  md += "\n" + rule + "\n";
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s) {
    md += fmt::format("| {} |", study.options.solvers[s]->name);
    for (const NoiseRow& row : rows)
      md += fmt::format(" {}{} |", number_or_dash(row.judgements[s].over_bound, 3),
                        tail_mark(row.judgements[s]));
    md += "\n";
  }
  if (std::ranges::any_of(rows, [](const NoiseRow& row) {
        return std::ranges::any_of(row.judgements, &Judgement::heavy_tail);
      }))
    md +=
        "\n\\* A hundredth of the poses has more than a third of the sum of squares: this RMSE is "
        "made "
        "by a few poses and would come out otherwise with others. See the median and the 95 % "
        "quantile, and do not trust the interval.\n";
  md += "\nMedian and 95 % quantile of the error / deg:\n\n| solver |";
  for (const NoiseRow& row : rows)
    md += fmt::format(" {:g} px, {} |", row.setting.noise_px, lens_name(row.walk_mm));
  md += "\n" + rule + "\n";
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s) {
    md += fmt::format("| {} |", study.options.solvers[s]->name);
    for (const NoiseRow& row : rows)
      md += fmt::format(" {}, {} |", number_or_dash(row.judgements[s].median_deg, 4),
                        number_or_dash(row.judgements[s].percentile95_deg, 4));
    md += "\n";
  }
  md += fmt::format(
      "\nOver all {} solves of a solver in this table:\n\n| solver | no attitude | flipped | "
      "largest "
      "error / deg | normalised squared error |\n|---|--:|--:|--:|--:|\n",
      rows.size() * study.options.poses);
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s) {
    std::size_t none = 0, flipped = 0;
    double largest = 0.0, low = INFINITY, high = -INFINITY;
    for (const NoiseRow& row : rows) {
      const Judgement& j = row.judgements[s];
      none += j.no_attitude;
      flipped += j.flipped;
      largest = std::fmax(largest, j.largest_deg);
      low = std::fmin(low, j.squared_error);
      high = std::fmax(high, j.squared_error);
    }
    md += fmt::format("| {} | {} | {} | {} | {} |\n", study.options.solvers[s]->name, none, flipped,
                      fixed(largest, 3),
                      std::isfinite(low) ? fixed(low, 3) + " to " + fixed(high, 3) : "-");
  }
  return md + "\n";
}

/// The rms bound over the poses that most solvers have an attitude of, deg; NaN without noise.
double basin_bound(const BasinRow& row) {
  return std::ranges::min(row.judgements, {}, &Judgement::no_attitude).bound_deg;
}

bool noise_alone_fails(const BasinRow& row) { return basin_bound(row) >= kNoiseAlone_deg; }

/// All of it in one table.
std::string summary_text(const SolverStudy& study) {
  bool heavy = false;
  for (const NoiseRow& row : study.noise)
    heavy = heavy || std::ranges::any_of(row.judgements, &Judgement::heavy_tail);
  std::string md = fmt::format(
      "## Summary\n\nLargest RMSE over the bound of any target, pose range and noise; counts over "
      "all "
      "solves of the noise study; weak points of the basin: values of one factor with success "
      "below 99 %, where the bound is "
      "below {:g} deg, so that noise alone does not explain them.{}\n\n"
      "| solver | central lens |",
      kNoiseAlone_deg,
      heavy ? " \\* A hundredth of the poses has more than a third of the sum of squares." : "");
  std::string rule = "|---|--:|";
  std::size_t points = 0;
  for (const BasinRow& row : study.basin) points += !noise_alone_fails(row);
  for (const double walk_mm : kStudyWalks_mm)
    if (walk_mm > 0.0) {
      md += fmt::format(" pupil walks {:g} mm |", walk_mm);
      rule += "--:|";
    }
  md += " no attitude | flipped | weak points of basin |\n" + rule + "--:|--:|--:|\n";
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s) {
    md += fmt::format("| {} |", study.options.solvers[s]->name);
    std::size_t none = 0, flipped = 0, weak = 0;
    for (const double walk_mm : kStudyWalks_mm) {
      double largest = Solution::kNaN;
      const char* mark = "";
      for (const NoiseRow& row : study.noise) {
        if (row.walk_mm != walk_mm) continue;
        if (row.judgements[s].over_bound > largest || std::isnan(largest)) {
          largest = std::fmax(largest, row.judgements[s].over_bound);
          mark = tail_mark(row.judgements[s]);
        }
        none += row.judgements[s].no_attitude;
        flipped += row.judgements[s].flipped;
      }
      md += fmt::format(" {}{} |", number_or_dash(largest, 3), mark);
    }
    for (const BasinRow& row : study.basin)
      weak += !noise_alone_fails(row) && row.judgements[s].success_rate() < 0.99;
    md += fmt::format(" {} | {} | {} of {} |\n", none, flipped, weak, points);
  }
  return md + "\n";
}

std::string basin_text(const SolverStudy& study, Factor factor) {
  std::string md = fmt::format("| {} |", factor_label(factor)), rule = "|---|";
  for (const BasinRow& row : study.basin)
    if (row.factor == factor) {
      md += fmt::format(" {:g} |", row.value);
      rule += "--:|";
    }
  md += "\n" + rule + "\n";
  for (std::size_t s = 0; s < study.options.solvers.size(); ++s) {
    md += fmt::format("| {} |", study.options.solvers[s]->name);
    for (const BasinRow& row : study.basin)
      if (row.factor == factor)
        md += fmt::format(" {} |", fixed(100.0 * row.judgements[s].success_rate(), 1));
    md += "\n";
  }
  md += "| *bound / deg* |";
  for (const BasinRow& row : study.basin)
    if (row.factor == factor) md += fmt::format(" {} |", number_or_dash(basin_bound(row), 2));
  return md + "\n\n";
}

/// Why a well-known row does so badly, where it is shown.
std::string epnp_text(const StudyOptions& options) {
  const bool shown = std::ranges::any_of(options.solvers,
                                         [](const Solver* s) { return s->name == "opencv_epnp"; });
  if (!shown || options.target_mm.size() > 5) return {};
  return fmt::format(
      "*opencv_epnp*: EPnP (Lepetit, Moreno-Noguer and Fua 2009) finds its four control points in "
      "the kernel of a matrix with two rows per point and twelve columns. {} points leave that "
      "kernel at least {} dimensions, where OpenCV's approximations of the weights are poor and a "
      "few Gauss-Newton steps do not mend them: answers are often wrong by degrees, even without "
      "noise. Six points and more leave no such freedom; with so few, take it for a start at "
      "most.\n\n",
      options.target_mm.size(), 12 - 2 * options.target_mm.size());
}

std::string study_text(const SolverStudy& study) {
  const StudyOptions& o = study.options;
  const StudySetting centre = basin_centre(o);
  std::string md = fmt::format(
      "# Solver study\n\n"
      "**Synthetic, at point level.** No hardware and no images took part: a spot is its true "
      "centre plus Gaussian noise on u and v, the target and the camera's rays are known exactly, "
      "and every spot is matched. Seed {}; {} poses per row of the noise study, {} per point of "
      "the "
      "basin, {} per cell of the map. Poses and noise are the same for every solver, lens and "
      "noise, so that differences are surer than the intervals of each.\n\n"
      "- *Bound*: the Cramer-Rao bound of each pose with the true Jacobians of its lens, rms over "
      "the poses. RMSE of the geodesic angle, over the poses with an attitude.\n"
      "- *Intervals* of the noise study are 95 %, by drawing the same poses again. Where errors "
      "are rare and large, "
      "an "
      "interval of few poses misses those that were not drawn: the first 300 poses may look good, "
      "with a narrow interval, and 10,000 lie outside it.\n"
      "- *Flipped*: wrong by more than 10 deg. *Normalised squared error*: with the solver's own "
      "covariance; 3 is expected.\n"
      "- *Lens*: central, or its entrance pupil walks along the axis with the square of the field "
      "angle, by so many mm at the image's edge. Solvers on rays are given the true rays. Solvers "
      "on a pinhole are given what the best central camera with distortion makes of them: exact on "
      "the plane half-way between the calibration planes, its pupil at two thirds of the walk.\n\n",
      o.seed, o.poses, study.basin_poses, study.map_poses);
  md += "| solver | sees | what |\n|---|---|---|\n";
  for (const Solver* s : o.solvers)
    md += fmt::format("| {} | {} | {} |\n", s->name, sight_name(s->sight), s->title);
  md +=
      "\nRows on the raw pixels of a pinhole are left out unless asked for: at point level, "
      "without "
      "distortion, they equal those on undistorted points.\n\n";
  md += summary_text(study) +
        "## Noise\n\nEvery row with its "
        "interval: [tables/noise.csv](tables/noise.csv).\n\n";
  each_case(study, [&](std::span<const NoiseRow> rows) { md += noise_text(study, rows); });
  md += fmt::format(
      "## Basin of convergence\n\nSuccess in percent: an attitude within {:g} deg of the truth, "
      "neither flipped nor missing. The limit is the same for every noise, so that no solver gains "
      "by worse images; where the bound comes near it, noise alone fails everybody. One factor at "
      "a time around the centre: view angle "
      "{:g} deg, {:g} mm away, {:g} px noise, target {} as it is (depth over size {:.3g}), central "
      "lens. Depth is the target's extent along its z, size the largest distance of a point from "
      "M0 "
      "across z; the target is stretched along z. Points are not hidden by one another. With "
      "intervals: [tables/basin.csv](tables/basin.csv), "
      "[tables/basin_map.csv](tables/basin_map.csv).\n\n",
      kFlipped_deg, centre.poses.view_low_deg, o.distance_mm, centre.noise_px, o.target,
      depth_ratio(o.target_mm));
  for (const Factor factor : kFactors)
    if (!factor_values(factor, o).empty()) md += basin_text(study, factor);
  md += epnp_text(o);
  if (study.map.empty())
    md += "The target has no depth along its z: it cannot be stretched, and there is no map.\n\n";
  return md;
}

/// @param name relative to the study's folder, with '/'.
bool is_of_study(const std::string& name) {
  if (name == "study.md" || name == "study.html" || name == "tables" || name == "figures")
    return true;
  const StudyPath file(name);
  if (file.parent_path() == "tables")
    return name == "tables/noise.csv" || name == "tables/basin.csv" ||
           name == "tables/basin_map.csv";
  const std::string stem = file.stem().string(), ending = file.extension().string();
  return file.parent_path() == "figures" &&
         (stem.starts_with("noise_") || stem.starts_with("basin_")) &&
         (ending == ".csv" || ending == ".gp" || ending == ".svg");
}

void remove_earlier_study(const StudyPath& folder) {
  std::error_code error;
  for (const char* text : {"study.md", "study.html"}) std::filesystem::remove(folder / text, error);
  for (const char* part : {"tables", "figures"})
    for (const auto& entry : std::filesystem::directory_iterator(folder / part, error))
      if (is_of_study((StudyPath(part) / entry.path().filename()).generic_string()))
        std::filesystem::remove(entry.path(), error);
}

/// Success of one solver as cells: counts, rate, interval.
void success_cells(Csv& csv, const Solver& solver, const Judgement& j) {
  const Interval interval = j.success_95();
  csv.text(solver.name).integer(static_cast<std::int64_t>(j.poses));
  csv.integer(static_cast<std::int64_t>(j.success()));
  csv.integer(static_cast<std::int64_t>(j.no_attitude));
  csv.integer(static_cast<std::int64_t>(j.flipped));
  csv.number(100.0 * j.success_rate(), 3).number(100.0 * interval.lower, 3);
  csv.number(100.0 * interval.upper, 3).number(j.rmse_deg, 6).number(j.median_deg, 6);
  csv.number(j.over_bound, 4).end_row();
}

}  // namespace

Csv noise_csv(const SolverStudy& study) {
  Csv csv({"target",
           "poses_of",
           "focal_px",
           "pupil_walk_mm",
           "pupil_walk_mm_per_rad2",
           "noise_px",
           "solver",
           "poses",
           "no_attitude",
           "flipped",
           "rmse_deg",
           "bound_deg",
           "rmse_over_bound",
           "rmse_over_bound_lower_95",
           "rmse_over_bound_upper_95",
           "median_error_deg",
           "percentile95_error_deg",
           "largest_error_deg",
           "worst_hundredth_share",
           "normalised_squared_error",
           "normalised_squared_error_lower_95",
           "normalised_squared_error_upper_95"});
  for (const NoiseRow& row : study.noise)
    for (std::size_t s = 0; s < row.judgements.size(); ++s) {
      const Judgement& j = row.judgements[s];
      csv.text(row.setting.target).text(row.setting.poses.name);
      csv.number(row.setting.lens.focal_px, 1).number(row.walk_mm, 1);
      csv.number(row.setting.lens.pupil_walk_mm_per_rad2, 3).number(row.setting.noise_px, 3);
      csv.text(study.options.solvers[s]->name).integer(static_cast<std::int64_t>(j.poses));
      csv.integer(static_cast<std::int64_t>(j.no_attitude));
      csv.integer(static_cast<std::int64_t>(j.flipped));
      csv.number(j.rmse_deg, 6).number(j.bound_deg, 6).number(j.over_bound, 5);
      csv.number(j.over_bound_95.lower, 5).number(j.over_bound_95.upper, 5);
      csv.number(j.median_deg, 6).number(j.percentile95_deg, 6).number(j.largest_deg, 5);
      csv.number(j.worst_share, 4).number(j.squared_error, 4);
      csv.number(j.squared_error_95.lower, 4).number(j.squared_error_95.upper, 4).end_row();
    }
  return csv;
}

Csv basin_csv(const SolverStudy& study) {
  Csv csv({"factor", "unit", "value", "solver", "poses", "success", "no_attitude", "flipped",
           "success_percent", "success_lower_95_percent", "success_upper_95_percent", "rmse_deg",
           "median_error_deg", "rmse_over_bound"});
  for (const BasinRow& row : study.basin)
    for (std::size_t s = 0; s < row.judgements.size(); ++s) {
      csv.text(factor_name(row.factor)).text(factor_unit(row.factor)).number(row.value, 3);
      success_cells(csv, *study.options.solvers[s], row.judgements[s]);
    }
  return csv;
}

Csv basin_map_csv(const SolverStudy& study) {
  Csv csv({"view_angle_deg", "depth_ratio", "solver", "poses", "success", "no_attitude", "flipped",
           "success_percent", "success_lower_95_percent", "success_upper_95_percent", "rmse_deg",
           "median_error_deg", "rmse_over_bound"});
  for (const MapRow& row : study.map)
    for (std::size_t s = 0; s < row.judgements.size(); ++s) {
      csv.number(row.view_deg, 1).number(row.depth_ratio, 3);
      success_cells(csv, *study.options.solvers[s], row.judgements[s]);
    }
  return csv;
}

std::vector<Draft> study_drafts(const std::filesystem::path& folder, const SolverStudy& study) {
  std::vector<Draft> drafts;
  each_case(study, [&](std::span<const NoiseRow> rows) {
    drafts.push_back(noise_draft(folder, study, rows));
  });
  for (const Factor factor : kFactors)
    if (!factor_values(factor, study.options).empty())
      drafts.push_back(basin_draft(folder, study, factor));
  if (!study.map.empty()) drafts.push_back(map_draft(folder, study));
  return drafts;
}

std::filesystem::path foreign_to_study(const StudyPath& folder) {
  namespace fs = std::filesystem;
  std::error_code error;
  const bool study = fs::is_regular_file(folder / "study.md", error);
  for (auto entry = fs::recursive_directory_iterator(folder, error);
       entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    const StudyPath name = entry->path().lexically_relative(folder);
    const bool is_folder = name == "tables" || name == "figures";
    const bool as_it_should = is_folder ? fs::is_directory(entry->symlink_status(error))
                                        : fs::is_regular_file(entry->symlink_status(error));
    if (!study || !as_it_should || !is_of_study(name.generic_string())) return name;
  }
  return {};
}

std::filesystem::path write_study_report(const std::filesystem::path& folder,
                                         const SolverStudy& study) {
  remove_earlier_study(folder);
  make_folder(folder / "figures");
  make_folder(folder / "tables");
  noise_csv(study).write(folder / "tables" / "noise.csv");
  basin_csv(study).write(folder / "tables" / "basin.csv");
  if (!study.map.empty()) basin_map_csv(study).write(folder / "tables" / "basin_map.csv");
  const std::vector<Figure> figures =
      draw(folder / "figures", study_drafts(folder / "figures", study));
  write_atomically(folder / "study.md",
                   study_text(study) + "## Figures\n\n" + figures_markdown(figures));
  return write_html(folder / "study.md", figures);
}

}  // namespace turntable
