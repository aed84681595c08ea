#include "src/report/noise_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "src/evaluation/scenario_statistics.h"
#include "src/record/csv.h"
#include "src/record/folder.h"

namespace turntable {
namespace {

constexpr const char* kDetailFigure = "figure17_noise";
constexpr const char* kCloudFigure = "figure18_noise";
constexpr std::size_t kCloudPoses = 250;  ///< more hide each other
constexpr std::size_t kLevelsBeside = 5;  ///< as many as a page is wide for

/// Distance of the ticks of a scale from -`scale` to `scale`: one digit, one or two on either side.
std::string tick(double scale) {
  const double unit = std::pow(10.0, std::floor(std::log10(scale)));
  return fmt::format("{:.6g}", std::floor(scale / unit) * unit);
}

Rounded grey(double sigma) { return {sigma, sigma == std::floor(sigma) ? 0 : 3}; }

void detail_figure(const std::filesystem::path& folder, const NoiseCampaign& campaign,
                   std::vector<Draft>& drafts) {
  if (!campaign.detail) return;
  const NoiseDetail& detail = *campaign.detail;
  const std::filesystem::path file = folder / (std::string(kDetailFigure) + ".csv");
  if (!detail.cutouts.empty()) {
    Csv csv({"sigma_grey", "u_px", "v_px", "grey"});
    for (std::size_t level = 0; level < detail.cutouts.size(); ++level)
      for (int v = 0; v < detail.side; ++v)
        for (int u = 0; u < detail.side; ++u) {
          csv.text(fmt::format("{}", campaign.levels[level].sigma_grey));
          csv.integer(detail.left + u).integer(detail.top + v);
          csv.integer(detail.cutouts[level].pixels[static_cast<std::size_t>(v * detail.side + u)]);
          csv.end_row();
        }
    csv.write(file);
  } else if (!std::filesystem::exists(file)) {
    return;
  }
  Draft draft;
  draft.figure.name = kDetailFigure;
  draft.figure.caption = fmt::format(
      "Brightest LED of pose {} with noise of every standard deviation, and the centre found in "
      "it, "
      "if one was (as figure 17). Grey levels 0 to 255.",
      detail.pose);
  const std::size_t count = campaign.levels.size(), columns = std::min(kLevelsBeside, count),
                    rows = (count + columns - 1) / columns;
  draft.size = fmt::format("{},{}", 230 * columns, 280 * rows);
  draft.commands = fmt::format(
      "set multiplot layout {},{}\nset key off\nset palette gray\nset cbrange [0:255]\n"
      "unset colorbox\nset size ratio -1\nset xlabel 'u / px'\nset ylabel 'v / px'\n"
      "set xrange [{}:{}]\nset yrange [{}:{}]\nset xtics 20\nset ytics 20\nunset grid\n",
      rows, columns, detail.left - 0.5, detail.left + detail.side - 0.5,
      detail.top + detail.side - 0.5,
      detail.top - 0.5);  // v down
  const int pixels = detail.side * detail.side;
  for (std::size_t level = 0; level < count; ++level) {
    const int from = 1 + static_cast<int>(level) * pixels;  // behind the header
    draft.commands += fmt::format("set title 'sigma {:g}'\n", campaign.levels[level].sigma_grey);
    if (const auto& centre = detail.centres_px[level])
      draft.commands +=
          fmt::format("set label 1 '' at {},{} front point pt 1 ps 2 lw 1.5 lc rgb '{}'\n",
                      fixed(centre->x(), 4), fixed(centre->y(), 4), kColours[1]);
    else
      draft.commands += "unset label 1\n";
    draft.commands +=
        fmt::format("plot 'DATA' every ::{}::{} using 2:3:4 with image\n", from, from + pixels - 1);
  }
  draft.commands += "unset multiplot\n";
  drafts.push_back(std::move(draft));
}

void cloud_figure(const std::filesystem::path& folder, const NoiseCampaign& campaign,
                  std::vector<Draft>& drafts) {
  const std::vector<const Solver*>& solvers = campaign.levels.front().evaluation.solvers;
  std::size_t measure = 0;
  for (const EvaluatedPose& pose : campaign.levels.front().evaluation.poses)
    measure += pose.planned.role == PoseRole::kMeasure;
  const std::size_t every = std::max<std::size_t>(1, (measure + kCloudPoses - 1) / kCloudPoses);

  PosePoints points({"sigma_grey", "error_yaw_deg", "error_roll_deg", "error_pitch_deg"});
  // The scale ends where all but the worst hundredth of any solver's errors do, at any sigma.
  double scale = 0.0;
  for (std::size_t level = 0; level < campaign.levels.size(); ++level) {
    const Evaluation& evaluation = campaign.levels[level].evaluation;
    for (std::size_t k = 0; k < solvers.size(); ++k) {
      std::vector<double> largest;
      std::size_t number = 0;
      for (const EvaluatedPose& pose : evaluation.poses) {
        if (pose.planned.role != PoseRole::kMeasure) continue;
        const PoseResult& r = pose.results[k];
        const bool shown = number++ % every == 0;
        if (!r.measured) continue;
        largest.push_back(std::max(
            {std::abs(r.error.yaw_deg), std::abs(r.error.roll_deg), std::abs(r.error.pitch_deg)}));
        if (!shown) continue;
        Csv& csv = points.row(*r.solver, pose.planned.index, level);
        csv.text(fmt::format("{}", campaign.levels[level].sigma_grey));
        csv.number(r.error.yaw_deg, 6).number(r.error.roll_deg, 6).number(r.error.pitch_deg, 6);
        csv.end_row();
      }
      if (!largest.empty()) scale = std::max(scale, percentile(largest, 0.99));
    }
  }
  if (!(scale > 0.0)) scale = 1.0;
  Draft draft;
  draft.figure.name = kCloudFigure;
  draft.figure.caption = fmt::format(
      "Errors of {} poses of {} with noise of every standard deviation, a column per sigma, one "
      "scale "
      "for all; errors beyond it are drawn at its edge (as figure 18).",
      every == 1 ? "the" : fmt::format("every {}th of the {}", every, measure),
      campaign.options.scenario);
  const std::size_t count = campaign.levels.size(), columns = std::min(kLevelsBeside, count),
                    rows = 2 * ((count + columns - 1) / columns);
  constexpr double kCloudPx = 200.0, kCloudHeightPx = 210.0, kLabelPx = 30.0, kKeyPx = 190.0;
  const double width = kLabelPx + kCloudPx * static_cast<double>(columns) + kKeyPx,
               height = 1.0 / static_cast<double>(rows);  // of a row
  draft.size = fmt::format("{:.0f},{:.0f}", width, kCloudHeightPx / height);
  draft.commands = fmt::format(
      "set multiplot\nset key off\nset size {0:.5f},{5:.5f}\nset lmargin 8\nset rmargin 1\n"
      "set tmargin 2\nset bmargin 4\nset tics font ',11'\nset xrange [{1}:{2}]\n"
      "set yrange [{1}:{2}]\nset xtics {3}\nset ytics {3}\n"
      "edge(x) = x > {4} ? {4} : x < -{4} ? -{4} : x\n",
      kCloudPx / width, fixed(-1.05 * scale, 6), fixed(1.05 * scale, 6), tick(scale),
      fixed(scale, 6), height);
  for (const auto& [row, name, column] :
       {std::tuple(0u, "pitch", "$6"), std::tuple(1u, "roll", "$5")})
    for (std::size_t level = 0; level < count; ++level) {
      draft.commands += fmt::format(
          "set origin {:.5f},{:.5f}\nset title 'sigma {:g}'\nset xlabel 'yaw error / deg'\n"
          "set ylabel '{}'\n",
          (kLabelPx + static_cast<double>(level % columns) * kCloudPx) / width,
          1.0 - static_cast<double>(2 * (level / columns) + row + 1) * height,
          campaign.levels[level].sigma_grey,
          level % columns == 0 ? fmt::format("{} error / deg", name) : "");
      for (std::size_t k = 0; k < solvers.size(); ++k)
        points.draw(draft, *solvers[k], "(edge($4))", fmt::format("(edge({}))", column),
                    "ps 0.4 " + solver_look(*solvers[k], k), "plot", level);
      draft.end_plot();
    }
  draft.end_multiplot(1.0 - kKeyPx / width, key_of_points(solvers));
  points.write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

}  // namespace

WrittenTable write_noise_table(const RunFolder& folder, const NoiseCampaign& campaign) {
  Table table{"noise",
              fmt::format("Gaussian noise added to the images of {}: standard deviation in grey "
                          "levels, seed {}",
                          campaign.options.scenario, campaign.options.seed),
              {{"sigma_grey", "sigma / grey", 0},
               {"solver", "solver"},
               {"poses", "poses"},
               {"failed", "failed"},
               {"rmse_pitch_deg", "RMSE pitch / deg"},
               {"rmse_roll_deg", "RMSE roll / deg"},
               {"rmse_yaw_deg", "RMSE yaw / deg"},
               {"rmse_total_deg", "total RMSE [95 % interval] / deg"},
               {"geodesic_max_deg", "geodesic max / deg"},
               {"median_spot_sigma_px", "spots' stated sigma (median) / px"},
               {"spot_shift_px", "moved by the noise (rms) / px"}},
              {}};
  for (const NoiseLevel& level : campaign.levels)
    for (const ScenarioStatistics& s : scenario_statistics(level.evaluation)) {
      const ErrorStatistics& e = s.pooled;
      table.rows.push_back({grey(level.sigma_grey), std::string(s.solver->name),
                            static_cast<std::int64_t>(e.poses), static_cast<std::int64_t>(e.failed),
                            e.pitch.rmse_deg, e.roll.rmse_deg, e.yaw.rmse_deg, s.rmse_total_deg,
                            e.geodesic.max_deg, level.median_spot_sigma_px, level.spot_shift_px});
    }
  make_folder(folder.tables());
  return write_table(table, folder.tables());
}

std::vector<Draft> noise_drafts(const std::filesystem::path& folder,
                                const NoiseCampaign& campaign) {
  std::vector<Draft> drafts;
  detail_figure(folder, campaign, drafts);
  if (!campaign.levels.front().evaluation.solvers.empty()) cloud_figure(folder, campaign, drafts);
  return drafts;
}

std::string noise_text(const std::vector<WrittenTable>& written, const RunRecord& record,
                       const NoiseCampaign& campaign) {
  const WrittenTable& table = *find_table(written, "noise");
  const bool regions = !record.start_document.empty() &&
                       Json::parse(record.start_document).value("archive", "") == "regions";
  std::size_t exposures = 0;
  for (const TakenPose& pose : record.poses)
    if (record.plan.scenario_of(pose.planned).name == campaign.options.scenario)
      exposures += pose.images.size();
  return fmt::format(
      "## Noise in the images\n\n"
      "Zero-mean Gaussian noise was added to the archived images of {}, each of its {} exposures "
      "by "
      "itself, the initial poses' too; rounded and clipped to 8 bit, and everything done again: "
      "the "
      "threshold from the image's own range, spots, attitudes. The camera calibration stayed as it "
      "is. Sigma 0 is the images as they were taken, with the noise that they had. The paper calls "
      "these numbers a variance in pixels; the call that it quotes takes a standard deviation in "
      "grey "
      "levels, and so was it done here. Poses without an attitude are counted as failed and are in "
      "no "
      "RMSE: a row with failures flatters. What spots state comes from the pixels around "
      "them: where noise is clipped at black it states too little; what the noise really did to "
      "them "
      "stands beside it. The initial pose's noise is in all poses alike and in no "
      "interval.{}\n\n### {}\n\n{}\n",
      campaign.options.scenario, exposures,
      regions ? " The images had been archived as regions: away from the spots they were evenly as "
                "dark as their darkest pixel before the noise was added."
              : "",
      table.title, table.markdown);
}

}  // namespace turntable
