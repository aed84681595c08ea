#include "src/evaluation/run_comparison.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/support/draws.h"

namespace turntable {
namespace {

/// A run of one sweep; errors as the test says.
struct MadeRun {
  Evaluation evaluation;
  Plan plan;

  explicit MadeRun(const std::string& scenario = "sweep") {
    evaluation.solvers = {find_solver("posit"), find_solver("aopit")};
    add_scenario(scenario);
  }
  void add_scenario(const std::string& name) {
    plan.scenarios.emplace_back().name = name;
    plan.scenarios.back().axes = {AxisId::kYaw};
    EvaluatedPose initial;
    initial.planned.scenario = plan.scenarios.size() - 1;
    initial.planned.role = PoseRole::kReference;
    initial.results.resize(2);
    evaluation.poses.push_back(initial);
  }
  /// Both solvers err by `yaw_error_deg`; NaN: neither measured.
  void visit(double yaw_deg, double yaw_error_deg, int repeat = 1) {
    EvaluatedPose pose;
    pose.planned.index = evaluation.poses.size();
    pose.planned.scenario = plan.scenarios.size() - 1;
    pose.planned.yaw_deg = yaw_deg;
    pose.planned.repeat = repeat;
    for (const Solver* solver : evaluation.solvers) {
      PoseResult result;
      result.solver = solver;
      result.measured = std::isfinite(yaw_error_deg);
      if (result.measured) result.error.yaw_deg = yaw_error_deg;
      pose.results.push_back(result);
    }
    evaluation.poses.push_back(std::move(pose));
  }
};

RunComparison compared(const MadeRun& a, const MadeRun& b) {
  return compare_runs(a.evaluation, a.plan, b.evaluation, b.plan);
}

TEST(RunComparison, MatchesPosesByAnglesAndNotByTheirPlace) {
  MadeRun a, b;
  Random random = draws_of_this_test();
  std::vector<double> errors;
  for (int k = 0; k < 30; ++k) {
    errors.push_back(0.1 + 0.02 * random.normal());
    a.visit(k, errors.back());
  }
  for (int k = 29; k >= 0; --k) b.visit(k, 0.5 * errors[static_cast<std::size_t>(k)]);
  const RunComparison c = compared(a, b);
  ASSERT_EQ(c.scenarios.size(), 1u);
  EXPECT_EQ(c.scenarios[0].both, 30u);
  EXPECT_EQ(c.scenarios[0].only_first + c.scenarios[0].only_other, 0u);
  ASSERT_EQ(c.changes.size(), 2u);
  const RunChange& change = c.changes[0];
  EXPECT_TRUE(change.paired);
  EXPECT_EQ(change.first_poses, 30u);
  EXPECT_NEAR(change.other_rmse_deg, 0.5 * change.first_rmse_deg, 1e-12);
  EXPECT_NEAR(change.change_deg.value, -0.5 * change.first_rmse_deg, 1e-12);
  EXPECT_NEAR(change.bias_change_deg[2].value, -0.05, 0.01);
  EXPECT_EQ(change.bias_change_deg[0].value, 0.0);
  EXPECT_EQ(change.verdict(), ChangeVerdict::kBetter);
  EXPECT_EQ(compared(b, a).changes[0].verdict(), ChangeVerdict::kWorse);
  EXPECT_EQ(compared(a, a).changes[0].verdict(), ChangeVerdict::kSame);
  EXPECT_EQ(compared(a, a).changes[0].change_deg.value, 0.0);
}

TEST(RunComparison, ChanceIsNotTakenForAChange) {
  int told_apart = 0;
  constexpr int kRuns = 60;
  for (std::uint64_t seed = 0; seed < kRuns; ++seed) {
    MadeRun a, b;
    Random random = draws_of_this_test(seed);
    for (int k = 0; k < 50; ++k) {
      a.visit(k, 0.1 * random.normal());
      b.visit(k, 0.1 * random.normal());
    }
    const ChangeVerdict verdict = compared(a, b).changes[0].verdict();
    told_apart += verdict == ChangeVerdict::kBetter || verdict == ChangeVerdict::kWorse;
  }
  EXPECT_LE(told_apart, 9);  // 3 of 60 are expected
}

TEST(RunComparison, WithoutCommonAnglesIsNotPaired) {
  MadeRun a, b;
  Random random = draws_of_this_test();
  for (int k = 0; k < 80; ++k) a.visit(k, 0.1 * random.normal());
  for (int k = 0; k < 60; ++k) b.visit(k + 0.5, 0.3 * random.normal());
  b.visit(0, 0.3);
  const RunComparison c = compared(a, b);
  EXPECT_EQ(c.scenarios[0].both, 1u);
  EXPECT_EQ(c.scenarios[0].only_first, 79u);
  EXPECT_EQ(c.scenarios[0].only_other, 60u);
  const RunChange& change = c.changes[0];
  EXPECT_FALSE(change.paired);
  EXPECT_EQ(change.first_poses, 80u);
  EXPECT_EQ(change.other_poses, 61u);
  EXPECT_EQ(change.verdict(), ChangeVerdict::kWorse);
  EXPECT_LT(change.change_deg.interval.lower, change.change_deg.value);
}

TEST(RunComparison, CountsWhatFailedAndWhatOnlyOneRunHas) {
  MadeRun a, b;
  for (int k = 0; k < 10; ++k) {
    a.visit(k, k < 2 ? std::nan("") : 0.1);
    b.visit(k, k == 5 ? std::nan("") : 0.2);
    a.visit(k, 0.3, 2);  // a repeat that B has not
  }
  a.add_scenario("only here");
  a.visit(1, 0.1);
  b.add_scenario("only there");
  b.visit(1, 0.1);
  b.evaluation.solvers[1] = find_solver("ml_ray");
  const RunComparison c = compared(a, b);
  EXPECT_EQ(c.only_first, (std::vector<std::string>{"solver aopit", "only here"}));
  EXPECT_EQ(c.only_other, (std::vector<std::string>{"solver ml_ray", "only there"}));
  ASSERT_EQ(c.scenarios.size(), 1u);
  EXPECT_EQ(c.scenarios[0].both, 10u);
  EXPECT_EQ(c.scenarios[0].only_first, 10u);
  ASSERT_EQ(c.changes.size(), 1u);
  EXPECT_EQ(c.changes[0].first_failed, 2u);
  EXPECT_EQ(c.changes[0].other_failed, 1u);
  EXPECT_TRUE(c.changes[0].paired);
  EXPECT_EQ(c.changes[0].first_poses, 7u);  // measured by both, with a partner
  EXPECT_EQ(c.changes[0].other_poses, 7u);
  EXPECT_NEAR(c.changes[0].change_deg.value, 0.1, 1e-12);
}

TEST(RunComparison, OfASecondVisitIsWithTheSecondVisit) {
  MadeRun a, b;
  for (int k = 0; k < 5; ++k) a.visit(k, 0.1);
  for (int k = 4; k >= 0; --k) a.visit(k, 0.2);
  b = a;
  const RunComparison c = compared(a, b);
  EXPECT_EQ(c.scenarios[0].both, 10u);
  EXPECT_EQ(c.changes[0].first_poses, 10u);
  EXPECT_EQ(c.changes[0].change_deg.value, 0.0);
}

TEST(RunComparison, NamesWhereFilesDiffer) {
  const Json a = Json::parse(R"({"camera": {"gain": 2, "model": "x"}, "list": [1, 2]})");
  const Json b = Json::parse(R"({"camera": {"gain": 3, "model": "x"}, "list": [1, 2, 5]})");
  const auto facts = json_differences("rig file", a, b);
  ASSERT_EQ(facts.size(), 2u);
  EXPECT_EQ(facts[0].place, "/camera/gain");
  EXPECT_EQ(facts[0].first, "2");
  EXPECT_EQ(facts[0].other, "3");
  EXPECT_EQ(facts[1].place, "/list/2");
  EXPECT_EQ(facts[1].first, "-");
  EXPECT_TRUE(json_differences("rig file", a, a).empty());
}

}  // namespace
}  // namespace turntable
