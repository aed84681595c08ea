// "turntable study": how good the solvers are for a target and a camera, before anybody builds a rig.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "src/app/commands.h"
#include "src/app/progress.h"
#include "src/core/errors.h"
#include "src/core/target_file.h"
#include "src/record/folder.h"
#include "src/report/study_report.h"

namespace turntable {
namespace {

std::vector<const Solver*> studied_solvers(const std::vector<std::string>& names) {
  std::vector<const Solver*> solvers;
  for (const std::string& name : names) {
    if (name == "all") return study_solvers();
    const Solver* solver = find_solver(name);
    if (solver == nullptr) {
      std::string known;
      for (const Solver& s : kSolvers) known += (known.empty() ? "" : ", ") + std::string(s.name);
      throw ConfigError("--solver", "",
                        fmt::format("found \"{}\", allowed: all, {}.", name, known));
    }
    if (std::ranges::find(solvers, solver) == solvers.end()) solvers.push_back(solver);
  }
  return solvers;
}

/// Points of a target, mm. @throws ConfigError.
std::vector<Vector3d> studied_target(const std::filesystem::path& file) {
  const std::vector<Vector3d> points_mm = load_target(file).points_mm;
  if (const std::string reason = TargetModel::refusal(points_mm); !reason.empty())
    throw ConfigError(file.string(), "", reason + ".");
  return points_mm;
}

/// Checked before the work: a folder that is new, empty, or holds nothing but an earlier study.
void check_study_folder(const std::filesystem::path& out) {
  require_writable(out, "the study", "--out");
  std::error_code error;
  if (!std::filesystem::is_directory(out, error)) return;
  if (const std::filesystem::path other = foreign_to_study(out); !other.empty())
    throw ConfigError(
        out.string(), "",
        fmt::format("holds other things than a study, such as {}. Choose a new folder "
                    "(--out).",
                    other.string()));
}

/// Not errors: somebody may want to know. M0 strays as far as `noise_settings` lets it.
void warn_of_geometry(const StudyOptions& options) {
  const StudySetting general = noise_settings(options).front();
  double span_mm = 0.0, radius_mm = 0.0;
  for (const Vector3d& p : options.target_mm) {
    radius_mm = std::max(radius_mm, (p - options.target_mm[0]).norm());
    for (const Vector3d& q : options.target_mm) span_mm = std::max(span_mm, (p - q).norm());
  }
  const double px_per_mm = options.focal_px / options.distance_mm;
  constexpr double kSmallestSpan_px = 20.0;
  if (span_mm * px_per_mm < kSmallestSpan_px)
    spdlog::warn(
        "The target spans {:.3g} mm, which is {:.2g} px at {:g} mm. Are its points in millimetres "
        "(points_mm)?",
        span_mm, span_mm * px_per_mm, options.distance_mm);
  const double farthest_px = (radius_mm + general.poses.lateral_mm) * px_per_mm;
  if (farthest_px > options.half_field_px)
    spdlog::warn(
        "Points are up to {:.0f} px from the axis, the image's edge is at {:.0f} px: poses are not "
        "cut off at the edge. Give a larger --distance or --image-size, or a smaller --focal.",
        farthest_px, options.half_field_px);
}

}  // namespace

int study_command(const StudyArguments& a) {
  StudyOptions options;
  if (!a.target.empty()) {
    options.target = a.target.stem().string();
    options.target_mm = studied_target(a.target);
    options.reference_targets = false;
  }
  options.solvers = studied_solvers(a.solvers);
  options.poses = a.poses;
  options.seed = a.seed;
  options.focal_px = a.focal_px;
  options.half_field_px = 0.5 * a.image_size_px.at(0);
  options.distance_mm = a.distance_mm;
  const double radius = TargetModel(options.target_mm).radius_mm();
  if (!(a.distance_mm > 1.25 * radius))
    throw ConfigError(
        "--distance", "",
        fmt::format("found {:g} mm, allowed: more than {:.1f} mm, so that no point of "
                    "the target reaches the camera.",
                    a.distance_mm, 1.25 * radius));
  const std::filesystem::path out =
      a.out.empty() ? std::filesystem::path("results") / "studies" / options.target : a.out;
  check_study_folder(out);
  warn_of_geometry(options);
  SolverStudy result;
  {
    ProgressLine line("studying");
    result = study(options,
                   [&](std::size_t done, std::size_t total) { line.update(done, total, "poses"); });
  }
  fmt::print("report: {}\n", write_study_report(out, result).string());
  return kDone;
}

}  // namespace turntable
