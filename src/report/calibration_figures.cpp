#include <fmt/format.h>

#include <cmath>

#include "src/record/atomic_file.h"
#include "src/record/csv.h"
#include "src/record/image_archive.h"
#include "src/report/calibration_report.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

/// What a figure needs to be written.
struct Context {
  const fs::path& folder;
  const Calibration& calibration;
  std::vector<Draft>& drafts;

  void add(Draft draft, const Csv& csv) const {
    csv.write(folder / (draft.figure.name + ".csv"));
    drafts.push_back(std::move(draft));
  }
  /// "set xrange" and "set yrange" of a picture in pixels, v down.
  std::string image_frame() const {
    const ImageSize size = calibration.irt.image_size();
    return fmt::format(
        "set size ratio -1\nset xrange [-0.5:{}]\nset yrange [{}:-0.5]\nset xlabel 'u / px'\n"
        "set ylabel 'v / px'\n",
        size.width - 0.5, size.height - 0.5);
  }
  /// The calibrated area's outline as a gnuplot data block.
  std::string domain_block() const {
    std::string block = "$domain << EOD\n";
    const auto& hull = calibration.irt.domain_hull_px();
    for (std::size_t i = 0; i <= hull.size() && !hull.empty(); ++i)
      block += fmt::format("{:.2f},{:.2f}\n", hull[i % hull.size()].x(), hull[i % hull.size()].y());
    return block + "EOD\n";
  }
};

/// Plane heights in file names and captions: 130, not 130.00002.
double tidy_mm(double z) { return std::round(1000.0 * z) / 1000.0; }

/// Least distance of two points of a plane, to scale arrows by.
double arrow_span_mm(const CalibrationSet& set, const std::vector<PlanePoint>& points) {
  if (set.spacing_mm > 0.0) return set.spacing_mm;
  double nearest = INFINITY;
  for (std::size_t i = 0; i < points.size(); ++i)
    for (std::size_t j = 0; j < i; ++j)
      nearest = std::min(nearest, (points[i].on_plane_mm - points[j].on_plane_mm).norm());
  return std::isfinite(nearest) ? nearest : 1.0;
}

void pattern_figure(const Context& to, const PatternExample& example) {
  if (example.points.empty()) return;
  Csv csv({"column", "row", "x_mm", "y_mm", "u_px", "v_px", "sigma_px"});
  const PatternPoint* middle = &example.points.front();
  const Vector2d centre(0.5 * example.image.width, 0.5 * example.image.height);
  double step = 0.0;
  for (const PatternPoint& p : example.points) {
    csv.integer(p.column).integer(p.row).number(p.on_pattern_mm.x(), 4);
    csv.number(p.on_pattern_mm.y(), 4).number(p.centre_px.x(), 4).number(p.centre_px.y(), 4);
    csv.number(p.sigma_px, 5).end_row();
    if ((p.centre_px - centre).norm() < (middle->centre_px - centre).norm()) middle = &p;
  }
  double nearest = INFINITY;
  for (const PatternPoint& p : example.points)
    if (&p != middle) nearest = std::min(nearest, (p.centre_px - middle->centre_px).norm());
  step = std::isfinite(nearest) ? nearest : 20.0;
  const Region whole{0, 0, example.image.width - 1, example.image.height - 1};
  constexpr int kWholePx = 400;  // of the drawn image: the page carries it
  const auto around = [step](double centre_px, int end) {
    return std::pair(std::max(0, static_cast<int>(std::floor(centre_px - 1.7 * step))),
                     std::min(end, static_cast<int>(std::ceil(centre_px + 1.7 * step))));
  };
  const auto [left, right] = around(middle->centre_px.x(), whole.right);
  const auto [top, bottom] = around(middle->centre_px.y(), whole.bottom);
  const Region detail{left, top, right, bottom};
  const auto drawn = [&](const char* name, const Region& part, int every, bool large) {
    return fmt::format(
        "set xrange [{}:{}]\nset yrange [{}:{}]\nplot {}, "
        "'DATA' every ::1 using 5:6 with points pt 1 ps {} lw {} lc rgb '#D55E00'{}\n",
        part.left - 0.5, part.right + 0.5, part.bottom + 0.5, part.top - 0.5,
        image_part(to.folder, name, example.image, part, every), large ? 1.6 : 0.5,
        large ? 2.0 : 0.9,
        large ? ", '' every ::1 using 5:6:(sprintf('%d,%d', $1, $2)) with labels offset 0,1.1 font "
                "'sans,14' textcolor rgb '#0072B2'"
              : "");
  };
  Draft draft;
  draft.figure.name = "figure8_pattern";
  draft.figure.caption = fmt::format(
      "A processed image of the pattern ({}) with the centre that was found of every point, and a "
      "detail with their names, column and row from the pattern's origin (as figure 8).",
      example.file);
  draft.size = "1000,520";
  draft.commands =
      "set key off\nset size ratio -1\nunset grid\nset xlabel 'u / px'\nset ylabel 'v / px'\n"
      "set multiplot layout 1,2\n" +
      drawn("figure8_pattern_whole", whole,
            std::max(1, (example.image.width + kWholePx - 1) / kWholePx), false) +
      drawn("figure8_pattern_detail", detail, 1, true) + "unset multiplot\n";
  to.add(std::move(draft), csv);
}

void positions_figure(const Context& to, const CalibrationSet& set) {
  Csv csv({"z_mm", "x_mm", "y_mm", "recalculated_x_mm", "recalculated_y_mm", "in_domain"});
  std::string plots;
  Vector2d low(INFINITY, INFINITY), high(-INFINITY, -INFINITY);
  for (const SeenPlane& plane : set.planes) {
    for (const PlanePoint& p : plane.points) {
      low = low.cwiseMin(p.on_plane_mm);
      high = high.cwiseMax(p.on_plane_mm);
      const Vector2d at = p.on_plane_mm + residual_mm(to.calibration.irt, p);
      csv.number(tidy_mm(plane.z_mm), 3).number(p.on_plane_mm.x(), 4).number(p.on_plane_mm.y(), 4);
      csv.number(at.x(), 5).number(at.y(), 5);
      csv.integer(to.calibration.irt.in_domain(p.pixel_px)).end_row();
    }
    plots += fmt::format(
        "set title '{:g} mm ({})'\nplot 'DATA' every ::1 using ($1 == {:.3f} ? $2 : 1/0):3 with "
        "points pt 6 ps 0.9 lc rgb '{}' title 'standard', '' every ::1 using ($1 == {:.3f} && $6 "
        "== "
        "1 ? $4 : 1/0):5 with points pt 2 ps 0.6 lw 1.6 lc rgb '{}' title 'recalculated'\n"
        "set key off\n",
        tidy_mm(plane.z_mm), plane.fit ? "fitted" : "kept out", tidy_mm(plane.z_mm), kColours[0],
        tidy_mm(plane.z_mm), kColours[1]);
  }
  const std::size_t columns = std::min<std::size_t>(3, set.planes.size());
  const std::size_t rows = (set.planes.size() + columns - 1) / columns;
  Draft draft;
  draft.figure.name = "figure9_positions";
  draft.figure.caption =
      "Positions of the pattern's points on each plane, on one scale: standard (circles), and "
      "recalculated by the ray model from their pixels (crosses), those in the calibrated area (as "
      "figure 9).";
  draft.size = fmt::format("{},{}", 330 * columns, 50 + 330 * rows);
  const Vector2d room = 0.06 * (high - low);
  draft.commands = fmt::format(
      "set size ratio -1\nset tics font ',11'\nset xlabel 'x / mm'\nset ylabel 'y / mm'\n"
      "set xrange [{}:{}]\nset yrange [{}:{}]\nset key at screen 0.5,0.995 center top horizontal "
      "maxrows 1\nset bmargin 4\nset tmargin 3\nset multiplot layout {},{} title ' '\n{}unset "
      "multiplot\n",
      low.x() - room.x(), high.x() + room.x(), low.y() - room.y(), high.y() + room.y(), rows,
      columns, plots);
  to.add(std::move(draft), csv);
}

void residual_figures(const Context& to, const CalibrationSet& set, const SeenPlane& plane) {
  const IrtModel& model = to.calibration.irt;
  const double z = tidy_mm(plane.z_mm);
  Csv csv({"column", "row", "x_mm", "y_mm", "z_mm", "u_px", "v_px", "residual_x_mm",
           "residual_y_mm", "residual_mm", "in_domain"});
  double largest = 0.0;
  int inside = 0;
  Vector2d low(INFINITY, INFINITY), high(-INFINITY, -INFINITY);
  std::string block = "$inside << EOD\n";  // what is interpolated: gnuplot's grid knows no gaps
  for (const PlanePoint& p : plane.points) {
    const Vector2d r = residual_mm(model, p);
    const bool in = model.in_domain(p.pixel_px);
    if (in) {
      largest = std::max(largest, r.norm());
      low = low.cwiseMin(p.on_plane_mm);
      high = high.cwiseMax(p.on_plane_mm);
      block +=
          fmt::format("{:.4f},{:.4f},{:.6f}\n", p.on_plane_mm.x(), p.on_plane_mm.y(), r.norm());
      ++inside;
    }
    csv.integer(p.column).integer(p.row).number(p.on_plane_mm.x(), 4).number(p.on_plane_mm.y(), 4);
    csv.number(z, 5).number(p.pixel_px.x(), 4).number(p.pixel_px.y(), 4);
    csv.number(r.x(), 6).number(r.y(), 6).number(r.norm(), 6).integer(in).end_row();
  }
  const std::string which =
      fmt::format("on the plane at {:g} mm ({})", z, plane.fit ? "fitted" : "kept out of the fit");
  const std::string common =
      "set xlabel 'x / mm'\nset ylabel 'y / mm'\nset cblabel 'residual / mm'\nset key off\n" +
      std::string(kHeat);
  // A surface needs points on both sides of it.
  if (inside >= 9 && (high - low).minCoeff() > 0.0) {
    Draft map;
    map.figure.name = fmt::format("figure10_residuals_{:g}mm", z);
    map.figure.caption = fmt::format(
        "Residuals of the ray model {}, interpolated between the points in the calibrated area: "
        "contour map and in three dimensions, on a scale of their own (as figure 10).",
        which);
    map.size = "1000,430";
    map.commands =
        block + "EOD\n" + common +
        fmt::format(
            "set xrange [{}:{}]\nset yrange [{}:{}]\nset cbrange [0:*]\nset zrange [0:*]\n"
            "set dgrid3d 30,30 splines\nset pm3d\nunset cblabel\nset multiplot\n"
            "set margins at screen 0.08, at screen 0.4, at screen 0.16, at screen 0.95\n"
            "set view map\nset size ratio -1\nset contour surface\nset cntrparam levels auto 6\n"
            "splot $inside using 1:2:3 with pm3d nocontour, '' using 1:2:3 with lines lc rgb "
            "'#444444' lw 0.8 nosurface\n"
            "unset contour\nset margins -1, -1, -1, -1\nset origin 0.53,0.03\n"
            "set size noratio 0.47,1\nset view 58,35,1.1\nset xyplane 0\n"
            "set zlabel 'residual / mm' rotate offset -2\nunset colorbox\nsplot $inside using "
            "1:2:3 with pm3d\nunset "
            "multiplot\n",
            low.x(), high.x(), low.y(), high.y());
    to.add(std::move(map), csv);
  }
  Draft arrows;
  arrows.figure.name = fmt::format("calibration_vectors_{:g}mm", z);
  arrows.figure.caption = fmt::format(
      "Residual vectors {}, enlarged so that the longest, {:.4f} mm, spans the distance of two "
      "neighbours; points outside the calibrated area are left out.",
      which, largest);
  arrows.size = "760,620";
  arrows.commands =
      common + fmt::format(
                   "set size ratio -1\nk = {}\nplot 'DATA' every ::1 using 3:4:($11 == 1 ? $8*k : "
                   "1/0):($9*k):10 with vectors head filled lw 1.5 lc palette\n",
                   largest > 0 ? arrow_span_mm(set, plane.points) / largest : 1.0);
  to.add(std::move(arrows), csv);
}

void coverage_figure(const Context& to, const CalibrationSet& set) {
  Csv csv({"kind", "u_px", "v_px"});
  const auto rows = [&](std::string_view kind, const auto& points, auto pixel) {
    for (const auto& p : points)
      csv.text(kind).number(pixel(p).x(), 2).number(pixel(p).y(), 2).end_row();
  };
  const auto of_plane = [](const PlanePoint& p) { return p.pixel_px; };
  for (const PatternView& view : set.views)
    if (!view.at_zero) rows("view", view.pixels_px, [](const Vector2d& p) { return p; });
  rows("fit", set.points(true), of_plane);
  rows("check", set.points(false), of_plane);
  Draft draft;
  draft.figure.name = "calibration_coverage";
  draft.figure.caption =
      "Where in the image the calibration's points lie, and the calibrated area (line): outside it "
      "a "
      "ray is an extrapolation, and is flagged.";
  draft.size = "860,640";
  draft.commands = to.domain_block() + to.image_frame() + "plot ";
  for (const auto& [kind, title, colour, mark] :
       {std::tuple("view", "tilted views", kColours[5], 1),
        {"fit", "fitted", kColours[0], 6},
        {"check", "kept out", kColours[1], 2}})
    draft.commands += fmt::format(
        "'DATA' every ::1 using (strcol(1) eq '{}' ? $2 : 1/0):3 with points pt {} ps 0.6 lc rgb "
        "'{}' title '{}', ",
        kind, mark, colour, title);
  draft.commands += "$domain using 1:2 with lines lw 2 lc rgb '#000000' title 'calibrated area'\n";
  to.add(std::move(draft), csv);
}

void orders_figure(const Context& to) {
  Csv csv = orders_csv(to.calibration.orders);
  Draft draft;
  draft.figure.name = "calibration_orders";
  draft.figure.caption = fmt::format(
      "Residuals of the ray model against its polynomial order; order {} was used (line). On the "
      "same "
      "points the fit only gets closer; points left out one at a time, and {} kept out, show where "
      "a "
      "model begins to follow the noise.",
      to.calibration.irt.order(), to.calibration.planes.empty() ? "views" : "planes");
  draft.commands = fmt::format(
      "set logscale y\nset xlabel 'polynomial order'\nset ylabel 'residual / mm rms'\nset xrange "
      "[0.5:9.5]\nset xtics 1\nset arrow from {0},graph 0 to {0},graph 1 nohead dt 2 lc rgb "
      "'#888888'\n"
      "plot 'DATA' every ::1 using 1:5 with linespoints pt 6 lw 1.5 lc rgb '{1}' title 'fitted', "
      "'' every ::1 using 1:6 with linespoints pt 4 lw 1.5 dt 2 lc rgb '{2}' title 'left out one "
      "at "
      "a time', "
      "'' every ::1 using 1:7 with linespoints pt 8 lw 1.5 dt 4 lc rgb '{3}' title 'kept out'\n",
      to.calibration.irt.order(), kColours[0], kColours[1], kColours[2]);
  to.add(std::move(draft), csv);
}

void map_figure(const Context& to, const std::vector<MapPoint>& map, int steps,
                const std::string& name, const std::string& column, const std::string& label,
                const std::string& caption, double scale) {
  Csv csv({"u_px", "v_px", column, "in_domain"});
  for (const MapPoint& p : map)
    csv.number(p.pixel_px.x(), 2)
        .number(p.pixel_px.y(), 2)
        .number(scale * p.value, 6)
        .integer(p.in_domain)
        .end_row();
  Draft draft;
  draft.figure.name = name;
  draft.figure.caption = caption;
  draft.size = "860,660";
  double largest = 0.0;
  for (const MapPoint& p : map)
    if (p.in_domain) largest = std::max(largest, scale * p.value);
  const ImageSize size = to.calibration.irt.image_size();
  draft.commands =
      to.domain_block() + to.image_frame() + kHeat +
      fmt::format(
          "set cblabel '{}'\nset cbrange [0:{:.6g}]\nset key off\nset style fill solid "
          "noborder\n"
          "plot 'DATA' every ::1 using 1:2:({:.4f}):({:.4f}):3 with boxxyerror lc "
          "palette, $domain using 1:2 with lines lw 2 lc rgb '#000000'\n",
          label, largest > 0.0 ? 1.3 * largest : 1.0, 0.5 * (size.width - 1) / (steps - 1),
          0.5 * (size.height - 1) / (steps - 1));
  to.add(std::move(draft), csv);
}

}  // namespace

Csv orders_csv(const std::vector<OrderRow>& orders) {
  Csv csv({"order", "terms", "points", "outliers", "fitted_rms_mm", "left_out_rms_mm",
           "held_out_rms_mm", "held_out_max_mm", "held_out_points", "outside_rms_mm",
           "outside_points", "condition", "max_leverage", "chi2_per_dof", "refused"});
  for (const OrderRow& o : orders) {
    csv.integer(o.order).integer(o.terms).integer(o.points).integer(o.outliers);
    csv.number(o.rms_mm, 6).number(o.loo_rms_mm, 6).number(o.held_out_rms_mm, 6);
    csv.number(o.held_out_max_mm, 6).integer(o.held_out_points).number(o.outside_rms_mm, 6);
    csv.integer(o.outside_points).number(o.condition, 2).number(o.max_leverage, 4);
    csv.number(o.chi2_per_dof, 4).text(o.refused).end_row();
  }
  return csv;
}

std::vector<Draft> calibration_drafts(const std::filesystem::path& folder,
                                      const Calibration& calibration,
                                      const std::optional<CalibrationSet>& set) {
  constexpr int kSteps = 48;
  std::vector<Draft> drafts;
  const Context to{folder, calibration, drafts};
  if (set) {
    if (set->example) pattern_figure(to, *set->example);
    if (!set->planes.empty()) positions_figure(to, *set);
    for (const SeenPlane& plane : set->planes) residual_figures(to, *set, plane);
    coverage_figure(to, *set);
  }
  if (!calibration.orders.empty()) orders_figure(to);
  const IrtModel& model = calibration.irt;
  if (model.covariance().size() > 0) {
    // At the plane that judges, if there is one: there no point was fitted.
    double z = model.planes().a_mm;
    for (const PlaneResidual& plane : calibration.planes)
      if (!plane.fitted) z = plane.z_mm;
    map_figure(
        to, sigma_map(model, z, kSteps), kSteps, "calibration_uncertainty", "sigma_um",
        "standard uncertainty / um",
        fmt::format("Standard uncertainty of a ray's x, and of its y, at a height of {:g} mm; "
                    "the line is the calibrated area, outside it the scale soon ends.",
                    tidy_mm(z)),
        1000.0);
  }
  constexpr double kMeetMm = 1e-6;  // rays of an ideal camera do, and there is nothing to draw
  if (model.bundle_centre().second > kMeetMm)
    map_figure(
        to, bundle_map(model, kSteps), kSteps, "calibration_bundle", "distance_mm", "distance / mm",
        "Distance of each ray from the point that all pass nearest to: 0 everywhere for a camera "
        "whose rays meet in one point.",
        1.0);
  return drafts;
}

}  // namespace turntable
