// How good are the solvers for this target? A study (src/evaluation/solver_study.h) as text, tables and
// figures.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "src/evaluation/solver_study.h"
#include "src/record/csv.h"
#include "src/report/drawing.h"

namespace turntable {

/// One row per target, pose range, lens, noise and solver.
Csv noise_csv(const SolverStudy& study);
/// One row per factor, value and solver.
Csv basin_csv(const SolverStudy& study);
/// One row per view angle, depth ratio and solver.
Csv basin_map_csv(const SolverStudy& study);

/// Writes <folder>/*.csv for:
///   noise_<target>_<poses>   RMSE over the bound, per solver, lens and noise
///   basin_<factor>           success against one factor
///   basin_map                success against view angle and depth ratio, per solver
/// @throws RecordError.
std::vector<Draft> study_drafts(const std::filesystem::path& folder, const SolverStudy& study);

/// What lies in a folder beside the files of a study (study.md, and what is named like its tables and
/// figures), or empty if there is nothing else. A folder that holds things but no study.md is no
/// study's: the first of them is returned.
std::filesystem::path foreign_to_study(const std::filesystem::path& folder);

/// study.md and .html, tables/noise.csv, tables/basin.csv, tables/basin_map.csv, figures/. An earlier study's
/// files go first, so that no figure of another target stays. @return study.html. @throws RecordError.
std::filesystem::path write_study_report(const std::filesystem::path& folder,
                                         const SolverStudy& study);

}  // namespace turntable
