#include "src/report/figures.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <regex>

#include "src/record/atomic_file.h"
#include "src/record/image_archive.h"
#include "src/record/sha256.h"
#include "src/report/evaluation_figures.h"
#include "src/report/html_report.h"
#include "tests/support/point_run.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

/// Three axes, forward and backward, seen by two solvers.
const PointRun& motion() {
  static const PointRun run = [] {
    PointRunOptions options;
    options.steps = 3;
    options.stages_mm = {130.0};
    options.both_ways = true;
    return PointRun(shipped_rig("simulated"), 1, {find_solver("aopit"), find_solver("aopit_ray")},
                    options);
  }();
  return run;
}

const TruthLevels& levels() {
  static const TruthLevels found =
      truth_levels(motion().record, motion().rig, motion().calibration, motion().evaluation);
  return found;
}

/// The poses of a run that turn yaw alone.
std::pair<RunRecord, Evaluation> uniaxial() {
  std::pair<RunRecord, Evaluation> out{motion().record, motion().evaluation};
  out.first.plan.scenarios.front().axes = {AxisId::kYaw};
  std::erase_if(out.second.poses, [](const EvaluatedPose& pose) {
    return pose.planned.roll_deg != 0.0 || pose.planned.pitch_deg != 0.0;
  });
  return out;
}

std::vector<std::string> names_of(const std::vector<Draft>& drafts) {
  std::vector<std::string> names;
  for (const Draft& draft : drafts) names.push_back(draft.figure.name);
  return names;
}

/// Data, caption, a picture with marks and every text, and points that the page finds again.
void expect_drawn(const fs::path& folder, const std::vector<Draft>& drafts) {
  const std::vector<Figure> figures = draw(folder, drafts);
  for (std::size_t i = 0; i < figures.size(); ++i) {
    const Figure& figure = figures[i];
    SCOPED_TRACE(figure.name);
    EXPECT_FALSE(figure.caption.empty());
    EXPECT_GT(std::ranges::count(slurp(folder / (figure.name + ".csv")), '\n'), 1);
    ASSERT_TRUE(figure.drawn);
    const std::string svg = slurp(folder / (figure.name + ".svg"));
    EXPECT_GT(svg.size(), 10'000u);  // an empty frame has about 8000
    EXPECT_LT(svg.size(), 700'000u);
    // gnuplot leaves out without a word what does not fit.
    static const std::regex kText("(?:label|title) '([^']+)'");
    const std::string& commands = drafts[i].commands;
    for (std::sregex_iterator text(commands.begin(), commands.end(), kText), end; text != end;
         ++text)
      EXPECT_THAT(svg, HasSubstr(">" + text->str(1) + "<"));
    const std::string inlined = inline_svg(svg, figure, "f-");
    EXPECT_THAT(inlined, Not(HasSubstr("unlinked")));
    for (const Element& element : figure.elements)
      EXPECT_THAT(inlined,
                  HasSubstr(element.solver.empty() ? std::string("class=\"plot\"")
                                                   : "data-solver=\"" + element.solver + "\""));
  }
}

TEST(AttitudeFigures, AreDrawnInTheOrderOfThePaper) {
  const TemporaryFolder folder;
  const auto drafts = attitude_drafts(folder.path(), motion().record, motion().evaluation);
  EXPECT_THAT(names_of(drafts),
              ElementsAre("figure13_raster_130", "figure15_raster_130", "figure16_raster_130"));
  expect_drawn(folder.path(), drafts);
  // 2 solvers x 3 planes x 3 x 3 cells, each the mean of 3 angles and 2 repeats.
  const std::string maps = slurp(folder / "figure16_raster_130.csv");
  EXPECT_EQ(std::ranges::count(maps, '\n'), 1 + 2 * 3 * 9);
  EXPECT_THAT(maps, HasSubstr("aopit,pitch-roll,-20.0000,-20.0000,"));
  EXPECT_THAT(maps, Not(HasSubstr(",5\n")));
}

TEST(AttitudeFigures, LeaveOutASolverThatFailedEverywhere) {
  const TemporaryFolder folder;
  Evaluation evaluation = motion().evaluation;
  for (EvaluatedPose& pose : evaluation.poses) pose.results.front().measured = false;
  const auto drafts = attitude_drafts(folder.path(), motion().record, evaluation);
  EXPECT_EQ(drafts.size(), 3u);
  expect_drawn(folder.path(), drafts);
}

TEST(AttitudeFigures, KeepTheirScaleWhereOneSolverMissesByFar) {
  EXPECT_EQ(common_limit({}), 0.0);
  EXPECT_EQ(common_limit({1.0, 2.0, 3.0}), 3.0);
  EXPECT_EQ(common_limit({1.0, 2.0, 300.0}), 6.0);
}

TEST(AttitudeFigures, OfOneAxisShowItsErrorsAgainstTheAngle) {
  const TemporaryFolder folder;
  const auto [record, evaluation] = uniaxial();
  const auto drafts = attitude_drafts(folder.path(), record, evaluation);
  EXPECT_THAT(names_of(drafts), ElementsAre("figure13_raster_130", "figure14_raster_130"));
  expect_drawn(folder.path(), drafts);
}

TEST(SpotsFigure, ShowsTheOutermostPosesThatHaveAnImage) {
  const TemporaryFolder folder;
  RunRecord record = motion().record;
  const RunFolder run = RunFolder::create(folder / "run", record.plan);
  fs::create_directories(run.figures());
  EXPECT_FALSE(spots_draft(run, record, motion().evaluation).has_value());  // archived: none

  const std::string png = encode_png(Image({1024, 1024}, 30));
  fs::create_directories(run.images());
  write_atomically(run.images() / "grey.png", png);
  for (TakenPose& pose : record.poses) {
    pose.images.front().file = "images/grey.png";
    pose.images.front().sha256 = sha256_hex(png);
  }
  const auto draft = spots_draft(run, record, motion().evaluation);
  ASSERT_TRUE(draft.has_value());
  expect_drawn(run.figures(), {*draft});
  // The first pose, three axes at both ends, and the one that is turned farthest, with four LEDs each.
  EXPECT_EQ(std::ranges::count(slurp(run.figures() / "figure12_raster_130.csv"), '\n'), 1 + 8 * 4);
  const std::string svg = slurp(run.figures() / "figure12_raster_130.svg");
  for (const char* text : {"M0", "M3", "data:image/png;base64", "first pose"})
    EXPECT_THAT(svg, HasSubstr(text));

  write_atomically(run.images() / "grey.png", png.substr(0, 100));  // cut off
  EXPECT_FALSE(spots_draft(run, record, motion().evaluation).has_value());
}

TEST(EvaluationFigures, AreDrawnOfEverythingThatARunHas) {
  const TemporaryFolder folder;
  const PointRun& run = motion();
  const Plan& plan = run.record.plan;
  const auto check = [&](const std::vector<Draft>& drafts, const std::string& name) {
    EXPECT_THAT(names_of(drafts), ElementsAre(name));
    expect_drawn(folder.path(), drafts);
  };
  check(angle_drafts(folder.path(), plan, run.rig, run.calibration, run.evaluation), "error_angle");
  check(normality_drafts(folder.path(), plan, run.evaluation), "error_normal");
  check(repeatability_drafts(folder.path(), plan, run.evaluation,
                             scenario_statistics(run.evaluation)),
        "error_repeatability");
  ASSERT_FALSE(levels().judged.rows.empty()) << levels().why_not;
  check(bound_drafts(folder.path(), plan, levels()), "error_bound");
  EXPECT_EQ(std::ranges::count(slurp(folder / "error_bound.csv"), '\n'), 1 + 2 * 3);
  const auto drift = drift_drafts(folder.path(), run.record, run.evaluation, levels());
  check(drift, "error_drift");
  EXPECT_THAT(drift.front().figure.caption, HasSubstr("no poses that return to zero"));
}

TEST(EvaluationFigures, ShowPosesThatReturnToZeroAsDrift) {
  const TemporaryFolder folder;
  RunRecord record = motion().record;
  Evaluation evaluation = motion().evaluation;
  for (EvaluatedPose& pose : evaluation.poses)
    if (pose.planned.yaw_deg == 0.0 && pose.planned.roll_deg == 0.0 &&
        pose.planned.pitch_deg == 0.0 && pose.planned.role == PoseRole::kMeasure)
      pose.planned.role = PoseRole::kReturn;
  record.sessions.resize(2);  // each with a clock of its own
  const auto drafts = drift_drafts(folder.path(), record, evaluation, {});
  expect_drawn(folder.path(), drafts);
  EXPECT_THAT(drafts.front().figure.caption, HasSubstr("marks are poses at zero angles again"));
  const std::string csv = slurp(folder / "error_drift.csv");
  EXPECT_THAT(csv, HasSubstr("order_of_taking"));
  EXPECT_THAT(csv, HasSubstr("aopit,return,"));
}

TEST(EvaluationFigures, StackTheBudgetUpToTheWhole) {
  const TemporaryFolder folder;
  const PointRun& run = motion();
  const auto budgets =
      error_budgets(run.record, run.rig, run.calibration, run.evaluation, levels());
  const auto drafts = budget_drafts(folder.path(), run.record.plan, budgets);
  EXPECT_THAT(names_of(drafts), ElementsAre("error_budget"));
  expect_drawn(folder.path(), drafts);
  const std::string csv = slurp(folder / "error_budget.csv");
  EXPECT_THAT(csv, HasSubstr(",100.000,"));  // where the last piece ends
  EXPECT_THAT(csv, HasSubstr("as found,aopit,0,observed,0.000,"));
}

TEST(EvaluationFigures, AreLeftOutWhereThereIsNothingToShow) {
  const TemporaryFolder folder;
  const PointRun& run = motion();
  Plan plan = run.record.plan;
  Evaluation once = run.evaluation;
  std::erase_if(once.poses, [](const EvaluatedPose& pose) { return pose.planned.repeat > 1; });
  EXPECT_TRUE(repeatability_drafts(folder.path(), plan, once, scenario_statistics(once)).empty());
  EXPECT_TRUE(bound_drafts(folder.path(), plan, {}).empty());
  EXPECT_TRUE(budget_drafts(folder.path(), plan, {}).empty());

  Evaluation failed = run.evaluation;
  for (EvaluatedPose& pose : failed.poses)
    for (PoseResult& result : pose.results) result.measured = false;
  EXPECT_TRUE(angle_drafts(folder.path(), plan, run.rig, run.calibration, failed).empty());
  EXPECT_TRUE(normality_drafts(folder.path(), plan, failed).empty());
  EXPECT_TRUE(drift_drafts(folder.path(), run.record, failed, {}).empty());
  EXPECT_TRUE(fs::is_empty(folder.path()));
  EXPECT_THAT(names_of(attitude_drafts(folder.path(), run.record, failed)),
              ElementsAre("figure13_raster_130"));

  for (ScenarioInfo& scenario : plan.scenarios) scenario.kind = ScenarioKind::kCalibration;
  EXPECT_FALSE(widest_scenario(plan).has_value());
  EXPECT_TRUE(normality_drafts(folder.path(), plan, run.evaluation).empty());
}

}  // namespace
}  // namespace turntable
