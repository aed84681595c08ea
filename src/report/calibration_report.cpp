#include "src/report/calibration_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "src/core/errors.h"
#include "src/imaging/monomial_table.h"
#include "src/imaging/opencv_yaml.h"
#include "src/record/atomic_file.h"
#include "src/record/folder.h"
#include "src/report/html_report.h"
#include "src/report/published.h"
#include "src/report/table.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

/// A cell; "-" for a value that is not known.
std::string cell(double value, int decimals) {
  return std::isfinite(value) ? fixed(value, decimals) : "-";
}

std::string planes_text(const Calibration& c) {
  if (c.planes.empty()) return {};
  // The published residuals are of the published planes: they say nothing of a lab's own.
  const bool sweep = !c.stage.empty();
  std::string md = fmt::format(
      "| plane / mm | used for | points | rms / mm | max / mm |{}\n"
      "|--:|---|--:|--:|--:|{}\n",
      sweep ? " published max / mm |" : "", sweep ? "--:|" : "");
  for (const PlaneResidual& p : c.planes) {
    const auto it = published_plane_residuals_mm().find(static_cast<int>(std::lround(p.z_mm)));
    const std::string published =
        it == published_plane_residuals_mm().end() ? "" : fixed(it->second, 3);
    md += fmt::format("| {:.3f} | {} | {} | {} | {} |{}\n", p.z_mm, p.fitted ? "fit" : "check",
                      p.points, cell(p.rms_mm, 4), cell(p.max_mm, 4),
                      sweep ? fmt::format(" {} |", published) : "");
  }
  md += "\n";
  for (const PlaneResidual& p : c.planes)
    if (p.fitted && p.coverage < kStripCoverage)
      md += fmt::format(
          "**The plane at {:.3f} mm shows only a strip**: its points cover {:.0f} % of the area "
          "that "
          "all planes show, and nothing outside that strip is calibrated.\n\n",
          p.z_mm, 100.0 * p.coverage);
  return md;
}

std::string fit_text(const Calibration& c) {
  std::string md;
  if (std::isfinite(c.loo_rms_mm))
    md += fmt::format(
        "Left out one at a time, a point misses its ray by {:.4f} mm rms; the fit's condition "
        "number "
        "is {:.3g}, its largest leverage {:.2f}.\n",
        c.loo_rms_mm, c.condition, c.max_leverage);
  if (std::isfinite(c.chi2_per_dof))
    md += fmt::format(
        "Observed over stated variance of the points (chi-square per degree of freedom): {:.2f}. "
        "{}\n",
        c.chi2_per_dof,
        c.chi2_per_dof < 0.8    ? "The points are better than their stated uncertainty."
        : c.chi2_per_dof <= 1.2 ? "The points scatter as their images say they should."
                                : "Something beyond the noise of the images is in the points; the "
                                  "stated uncertainty of "
                                  "the rays is widened by the root of it.");
  if (!md.empty()) md += "\n";
  return md;
}

std::string orders_text(const Calibration& c) {
  if (c.orders.empty()) return {};
  const bool views = c.planes.empty();
  std::string md =
      views
          ? "Which order? On the same points the fit only gets closer with every order; views kept "
            "out (every third), whose poses alone are fitted afterwards, judge.\n\n"
            "| order | terms | points | outliers | fitted / mm rms | kept out / mm rms | |\n"
            "|--:|--:|--:|--:|--:|--:|---|\n"
          : "Which order? On the same points the fit only gets closer with every order (each "
            "leaves "
            "out outliers of its own); points left out one at a time and planes kept out judge.\n\n"
            "| order | terms | points | outliers | fitted / mm rms | left out / mm rms | kept out "
            "/ mm "
            "rms | kept out / mm max | largest leverage | chi^2 / dof | |\n"
            "|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|---|\n";
  for (const OrderRow& o : c.orders) {
    const std::string note = !o.refused.empty()         ? "refused: " + o.refused
                             : o.order == c.irt.order() ? "used"
                                                        : "";
    md += fmt::format("| {} | {} | {} | {} | {} |", o.order, o.terms, o.points, o.outliers,
                      cell(o.rms_mm, 4));
    if (!views) md += fmt::format(" {} |", cell(o.loo_rms_mm, 4));
    md += fmt::format(" {} |", cell(o.held_out_rms_mm, 4));
    if (!views)
      md += fmt::format(" {} | {} | {} |", cell(o.held_out_max_mm, 4), cell(o.max_leverage, 2),
                        cell(o.chi2_per_dof, 2));
    md += fmt::format(" {} |\n", note);
  }
  if (!views) {
    try {
      const int best = choose_order(c.orders);
      md += fmt::format("\nThe residuals choose order {}{}.\n", best,
                        best == c.irt.order() ? ", which was used" : "; another one was asked for");
    } catch (const Error&) {
      // No order is carried; the rows say why.
    }
  }
  return md + "\n";
}

std::string models_text(const Calibration& c) {
  if (c.models.empty()) return {};
  std::string md =
      "Camera models, fitted to the same points and judged on points that none of them has "
      "seen:\n\n"
      "| model | parameters | fitted / mm rms | kept out / mm rms | kept out / mm max | kept out / "
      "px "
      "rms | kept out / px max |\n|---|--:|--:|--:|--:|--:|--:|\n";
  std::string why;
  for (const ModelRow& m : c.models) {
    md += fmt::format("| {} | {} | {} | {} | {} | {} | {} |\n", m.name, m.parameters,
                      cell(m.fit_rms_mm, 4), cell(m.held_out_rms_mm, 4), cell(m.held_out_max_mm, 4),
                      cell(m.held_out_rms_px, 3), cell(m.held_out_max_px, 3));
    if (!m.why_not.empty()) why += fmt::format("{}: {}\n\n", m.name, m.why_not);
  }
  return md + "\n" + why;
}

std::string central_text(const Calibration& c) {
  std::string md;
  for (const CentralModel& m : c.central)
    md += fmt::format(
        "- {}: f = ({:.2f}, {:.2f}) px, centre ({:.2f}, {:.2f}) px; {:.4f} px rms {}\n",
        central_name(m.kind), m.fx, m.fy, m.cx, m.cy, m.rms_px,
        m.views > 0 ? fmt::format("over {} views", m.views) : "off the camera that was taken over");
  return md.empty() ? md : "Central models:\n\n" + md + "\n";
}

std::string stage_text(const Calibration& c) {
  if (c.stage.empty()) return {};
  std::string md =
      "| stage asked / mm | read back / mm | visits | repeats / px rms | repeats / mm rms | drift "
      "read back / mm | drift seen / px | drift seen / mm |\n"
      "|--:|--:|--:|--:|--:|--:|--:|--:|\n";
  for (const PlaneVisits& s : c.stage)
    md += s.visits > 1
              ? fmt::format("| {:.3f} | {:.5f} | {} | {} | {} | {:.5f} | ({}, {}) | {} |\n", s.z_mm,
                            s.stage_mm, s.visits, cell(s.repeat_rms_px, 4),
                            cell(s.repeat_rms_mm, 5), s.drift_mm, cell(s.drift_px.x(), 4),
                            cell(s.drift_px.y(), 4), cell(s.drift_plane_mm, 5))
              : fmt::format("| {:.3f} | {:.5f} | 1 | - | - | - | - | - |\n", s.z_mm, s.stage_mm);
  md +=
      "\nDrift: last visit minus first. The mean shift of the pattern's points shows what moved "
      "between camera and pattern, whatever the stage says.\n\n";
  if (std::ranges::any_of(c.stage,
                          [](const PlaneVisits& s) { return std::isfinite(s.repeat_rms_px); }))
    md +=
        "Repeats: standard deviation of a point's image over the repeats of the sweep, each plane "
        "approached anew, u and v together; the noise of the images is in it. A return to the "
        "first plane counts as drift only.\n\n";
  return md;
}

}  // namespace

std::string calibration_text(const Calibration& c) {
  std::string md = fmt::format(
      "Source: {}{}. Ray model of order {} over planes at {:.3f} and {:.3f} mm, {} x {} px",
      markdown_text(c.source), c.simulated ? " (simulated)" : "", c.irt.order(),
      c.irt.planes().a_mm, c.irt.planes().b_mm, c.irt.image_size().width,
      c.irt.image_size().height);
  if (c.points > 0)
    md += fmt::format(", {} points, {} outliers left out.", c.points, c.outliers.size());
  else if (c.sigma_mm > 0.0)
    md += fmt::format("; it reproduces the camera that was taken over to {:.2g} mm per coordinate.",
                      c.sigma_mm);
  else
    md += "; it came as numbers, without points.";
  if (c.planes.empty() && !c.central.empty())
    md +=
        " Frame: the camera's own, turned over: origin in the lens, x right, y up, z towards the "
        "camera, so that what is seen lies at negative heights; the two planes span what was seen.";
  if (!c.planes.empty())
    md +=
        " Residuals are distances in the plane, x and y together; of planes kept out, those of "
        "points "
        "in the calibrated area.";
  md += "\n\n" + planes_text(c) + fit_text(c);
  const auto [centre, spread] = c.irt.bundle_centre();
  const auto [low, high] = c.irt.jacobian_range();
  md += fmt::format(
      "The rays pass nearest to ({}, {}, {}) mm, {:.3g} mm rms apart: that is how central the lens "
      "is. "
      "Right-handed: det d(x,y)/d(u,v) = {:.4f}..{:.4f} mm^2/px^2.\n\n",
      fixed(centre.x(), 2), fixed(centre.y(), 2), fixed(centre.z(), 2),
      spread < 1e-9 ? 0.0 : spread, low, high);
  md += orders_text(c) + models_text(c) + central_text(c) + stage_text(c);
  for (const PlanePoint& p : c.outliers)
    md += c.planes.empty() ? fmt::format("Outlier: point {} of view {} at ({:.1f}, {:.1f}) px.\n",
                                         p.column + 1, p.row + 1, p.pixel_px.x(), p.pixel_px.y())
                           : fmt::format("Outlier: point ({}, {}) on the plane at {:.3f} mm.\n",
                                         p.column, p.row, p.z_mm);
  return md;
}

std::filesystem::path write_calibration_report(const fs::path& folder, const Calibration& c,
                                               const std::optional<CalibrationSet>& set) {
  make_folder(folder / "figures");
  make_folder(folder / "tables");
  // Those of an earlier calibration in the same folder that this one may not have.
  for (const char* table : {"orders", "models"}) remove_files(folder / "tables", table, {".csv"});
  for (const CentralKind kind : kCentralKinds)
    remove_files(folder / "opencv", central_name(kind), {".yml"});
  write_atomically(folder / "calibration.json", calibration_to_json(c));
  // v counted upward, as in the published table.
  const MonomialTable ours{"ours", c.irt.order(), c.irt.monomials(VDirection::kUp)};
  const std::string heading = fmt::format(
      "Table 1: coefficients of the two planes at {:.3f} mm and {:.3f} mm; raw pixels, v counted "
      "upward: "
      "v' = {} - v",
      c.irt.planes().a_mm, c.irt.planes().b_mm, c.irt.image_size().height - 1);
  write_atomically(folder / "tables" / "table1.csv", monomials_to_csv({&ours, 1}));
  write_atomically(folder / "tables" / "table1.md",
                   fmt::format("# {}\n\n{}", heading, monomials_to_markdown({&ours, 1})));
  write_atomically(folder / "tables" / "table1.tex",
                   fmt::format("% {}\n{}", heading, monomials_to_latex({&ours, 1})));
  if (!c.orders.empty()) orders_csv(c.orders).write(folder / "tables" / "orders.csv");
  if (!c.models.empty()) {
    Csv csv({"model", "parameters", "fitted_rms_mm", "fitted_max_mm", "held_out_rms_mm",
             "held_out_max_mm", "held_out_rms_px", "held_out_max_px", "why_not"});
    for (const ModelRow& m : c.models) {
      csv.text(m.name).integer(m.parameters).number(m.fit_rms_mm, 6).number(m.fit_max_mm, 6);
      csv.number(m.held_out_rms_mm, 6).number(m.held_out_max_mm, 6).number(m.held_out_rms_px, 5);
      csv.number(m.held_out_max_px, 5).text(m.why_not).end_row();
    }
    csv.write(folder / "tables" / "models.csv");
  }
  if (!c.central.empty()) make_folder(folder / "opencv");
  for (const CentralModel& m : c.central)
    write_atomically(folder / "opencv" / fmt::format("{}.yml", central_name(m.kind)),
                     to_opencv_yaml(m));

  std::string md = "# Camera calibration\n\n";
  if (c.simulated) md += "**Simulated.** No hardware took part.\n\n";
  md += calibration_text(c);
  if (set) {
    for (const std::string& remark : set->remarks) md += remark + "\n\n";
  }
  const std::vector<Draft> drafts = calibration_drafts(folder / "figures", c, set);
  std::vector<Figure> figures;
  if (drafts.empty()) {  // an ideal camera that came as numbers
    fs::remove(folder / "figures");
  } else {
    figures = draw(folder / "figures", drafts);
    md += "## Figures\n\n" + figures_markdown(figures);
  }
  if (!c.images.empty()) {
    md += "## Images\n\n| file | SHA-256 |\n|---|---|\n";
    for (const UsedImage& image : c.images)
      md += fmt::format("| {} | `{}` |\n", image.file, image.sha256);
  }
  write_atomically(folder / "calibration.md", md);
  return write_html(folder / "calibration.md", figures);
}

}  // namespace turntable
