#include "src/evaluation/error_budget.h"

#include <gtest/gtest.h>

#include <cmath>

#include "src/evaluation/cross_validation.h"
#include "tests/support/point_run.h"
#include "tests/support/synthetic_campaign.h"

namespace turntable {
namespace {

void hide_repeatability(RigFile& rig) {
  for (const AxisId axis : kRotaryAxes) rig.simulation->axes[axis].repeatability = 0.005;
}

/// Draws of standard deviation `sd`.
Vector3d hidden(Random& random, double sd) {
  return sd * Vector3d(random.normal(), random.normal(), random.normal());
}

void hide_target(RigFile& rig, Random& random) {
  for (std::size_t i = 1; i < rig.simulation->target_errors_mm.size(); ++i)
    rig.simulation->target_errors_mm[i] = hidden(random, 0.1);
}

std::vector<ErrorBudget> budgets_of(const PointRun& run) {
  const TruthLevels levels = truth_levels(run.record, run.rig, run.calibration, run.evaluation);
  EXPECT_TRUE(levels.model.has_value()) << levels.why_not;
  return error_budgets(run.record, run.rig, run.calibration, run.evaluation, levels);
}

std::string lines_of(const ErrorBudget& budget) {
  std::string text;
  for (const BudgetLine& line : budget.lines)
    text += fmt::format("{}: drawn {:.4f}, found {:.4f} deg\n", cause_name(line.cause),
                        line.drawn.total_deg(), line.found->total_deg());
  return text;
}

TEST(ErrorBudget, PredictsTheTotalOfTenRigs) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    RigFile rig = toleranced_rig();
    Random random(seed, "hidden errors");
    hide_target(rig, random);
    hide_repeatability(rig);
    rig.simulation->stage_squareness_deg = hidden(random, 0.25).head<2>();
    rig.simulation->plane_from_gimbal_deg = hidden(random, 0.4);
    rig.simulation->table_from_target_deg = hidden(random, 0.4);
    for (std::size_t i = 0; i < 3; ++i) rig.simulation->axis_errors_deg[i] = hidden(random, 0.05);
    const PointRun run(rig, seed, {find_solver("aopit"), find_solver("ml_ray")});
    for (const ErrorBudget& b : budgets_of(run)) {
      ASSERT_TRUE(b.found);
      EXPECT_NEAR(b.found->total_deg() / b.observed.total_deg(), 1.0, 0.15)
          << "seed " << seed << ", " << b.solver->name << ", observed " << b.observed.total_deg();
      EXPECT_NEAR(b.drawn.total_deg() / b.monte_carlo_deg.value, 1.0, 0.15)
          << "linear against drawn rigs, " << b.solver->name << ", seed " << seed << ", scenario "
          << b.scenario << "\n"
          << lines_of(b);
    }
  }
}

/// A rig with one thing wrong, and the line that has to say so.
struct SingleCause {
  Cause cause;
  void (*hide)(RigFile&, Random&);
};

class ErrorBudgetLine : public ::testing::TestWithParam<SingleCause> {};

TEST_P(ErrorBudgetLine, NamesTheCause) {
  RigFile rig = toleranced_rig();
  Random random(7, "hidden errors");
  GetParam().hide(rig, random);
  const bool noise_only =
      GetParam().cause == Cause::kSpots || GetParam().cause == Cause::kRepeatability;
  PointRunOptions options;
  options.sigma_px = GetParam().cause == Cause::kSpots ? 0.2 : 0.02;
  options.both_ways = GetParam().cause == Cause::kBacklash;
  const PointRun run(rig, 7, {find_solver("ml_ray")}, options);
  const ErrorBudget b = budgets_of(run).front();
  double largest = 0.0;
  Cause named{};
  for (const BudgetLine& line : b.lines)
    if (line.found->total_deg() > largest) {
      largest = line.found->total_deg();
      named = line.cause;
    }
  const std::string lines = lines_of(b);
  EXPECT_EQ(cause_name(named), cause_name(GetParam().cause)) << lines;
  // Self-calibration does not know backlash, and takes some of it for mounting, stage and target.
  const double within = noise_only ? 0.2 : GetParam().cause == Cause::kBacklash ? 0.3 : 0.25;
  EXPECT_NEAR(largest / b.observed.total_deg(), 1.0, within) << lines;
}

INSTANTIATE_TEST_SUITE_P(
    Each, ErrorBudgetLine,
    ::testing::Values(SingleCause{Cause::kSpots, [](RigFile&, Random&) {}},
                      SingleCause{Cause::kTarget, hide_target},
                      SingleCause{Cause::kAlignment,
                                  [](RigFile& rig, Random&) {
                                    rig.simulation->plane_from_gimbal_deg = {0.4, -0.3, 0.2};
                                  }},
                      SingleCause{Cause::kAxes,
                                  [](RigFile& rig, Random&) {
                                    rig.simulation->axis_errors_deg[2] = {0.0, 0.1, 0.1};
                                  }},
                      SingleCause{Cause::kStage,
                                  [](RigFile& rig, Random&) {
                                    rig.simulation->stage_squareness_deg = {0.2, -0.25};
                                  }},
                      SingleCause{Cause::kBacklash,
                                  [](RigFile& rig, Random&) {
                                    for (const AxisId axis : kRotaryAxes) {
                                      rig.simulation->axes[axis].backlash = 0.1;
                                      rig.axes.at(axis).backlash =
                                          0.0;  // approached from both sides
                                    }
                                  }},
                      SingleCause{Cause::kRepeatability, [](RigFile& rig, Random&) {
                                    for (const AxisId axis : kRotaryAxes) {
                                      rig.simulation->axes[axis].repeatability = 0.05;
                                      rig.axes.at(axis).repeatability = 0.05;
                                    }
                                  }}));

}  // namespace
}  // namespace turntable
