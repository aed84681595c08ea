// "turntable study": how good the solvers are for a target and a camera, before anybody builds a rig.
#include <fmt/format.h>

#include <algorithm>

#include "src/app/commands.h"
#include "src/app/progress.h"
#include "src/core/errors.h"
#include "src/core/target_file.h"
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

/// Checked before the work: a folder that is new, empty, or holds an earlier study.
void check_study_folder(const std::filesystem::path& out) {
  std::error_code error;
  std::filesystem::path there = std::filesystem::absolute(out, error);
  while (!std::filesystem::exists(std::filesystem::status(there, error)) &&
         there.has_relative_path())
    there = there.parent_path();
  if (!std::filesystem::is_directory(there, error))
    throw ConfigError(there.string(), "", "is a file. Choose a folder for the study (--out).");
  if (!std::filesystem::is_directory(out, error)) return;
  if (!std::filesystem::is_empty(out, error) &&
      !std::filesystem::is_regular_file(out / "study.md", error))
    throw ConfigError(out.string(), "",
                      "holds other things than a study. Choose a new folder (--out).");
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
