// Figures beyond the paper: what the errors depend on, what they look like, what could be had, and
// where they come from. Each function writes <folder>/<name>.csv, and leaves a figure out where the run
// has nothing for it. Solvers, marks and colours are in the order of the table.
#pragma once

#include <filesystem>
#include <vector>

#include "src/evaluation/cross_validation.h"
#include "src/evaluation/error_budget.h"
#include "src/evaluation/evaluate.h"
#include "src/imaging/calibration.h"
#include "src/record/run_folder.h"
#include "src/report/drawing.h"

namespace turntable {

/// error_angle: geodesic error against the angle between the target's z axis, where the turntable says
/// it is, and the line from M0 to the camera; of `widest_scenario`. error_angle_median.csv is the
/// running median.
std::vector<Draft> angle_drafts(const std::filesystem::path& folder, const Plan& plan,
                                const RigFile& rig, const Calibration& calibration,
                                const Evaluation& evaluation);

/// error_normal: axis errors, each less its mean and divided by its standard deviation, against the
/// quantiles of the normal distribution at (i - 0.5) / n; of `widest_scenario`.
std::vector<Draft> normality_drafts(const std::filesystem::path& folder, const Plan& plan,
                                    const Evaluation& evaluation);

/// error_bound: total RMSE of every level of truth, solver and scenario beside the Cramer-Rao bound.
std::vector<Draft> bound_drafts(const std::filesystem::path& folder, const Plan& plan,
                                const TruthLevels& levels);

/// error_repeatability: repeatability of every axis, solver and scenario that came back to some angles.
/// @param statistics of `evaluation`
std::vector<Draft> repeatability_drafts(const std::filesystem::path& folder, const Plan& plan,
                                        const Evaluation& evaluation,
                                        const std::vector<ScenarioStatistics>& statistics);

/// error_drift: errors of the "return" poses, which are at zero angles again, and block means of all
/// the others, in the order of time. @param levels gives the residual errors, self-calibrated and
/// held-out, if it was judged; else those are as published.
std::vector<Draft> drift_drafts(const std::filesystem::path& folder, const RunRecord& record,
                                const Evaluation& evaluation, const TruthLevels& levels);

/// error_budget: shares of the causes in the mean square error of every solver, as tolerances let
/// expect and as found, and the observed one; of `widest_scenario`.
std::vector<Draft> budget_drafts(const std::filesystem::path& folder, const Plan& plan,
                                 const std::vector<ErrorBudget>& budgets);

}  // namespace turntable
