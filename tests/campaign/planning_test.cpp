#include "src/campaign/planning.h"

#include <gmock/gmock.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "drivers/controller_description.h"
#include "src/core/errors.h"
#include "src/core/motion_time.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

const std::filesystem::path kScenarios = std::filesystem::path(TURNTABLE_SOURCE_DIR) / "scenarios";

RigFile rig() { return load_rig_file(kScenarios / "rigs" / "simulated.json"); }

Campaign single(const std::string& ranges, const std::string& rest = "") {
  Campaign campaign;
  campaign.name = campaign.title = "s";
  campaign.scenarios.push_back(parse_scenario(
      R"({"format": "turntable-scenario/1", "name": "s", "title": "S", "kind": "attitude",
          "stage_mm": 120)" +
          rest + R"(, "ranges": )" + ranges + "}",
      "s.json"));
  return campaign;
}

constexpr const char* kTwoAxes =
    R"([{"axis": "pitch", "values_deg": [-10, 0, 10]}, {"axis": "yaw", "values_deg": [1, 2]}])";

std::vector<std::pair<double, double>> pitch_and_yaw(const Plan& plan) {
  std::vector<std::pair<double, double>> out;
  for (const auto& pose : plan.poses) out.emplace_back(pose.pitch_deg, pose.yaw_deg);
  return out;
}

std::pair<std::string, std::string> refusal(const Plan& plan, const RigFile& rig_file,
                                            const CheckOptions& options = {}) {
  try {
    check_plan(plan, rig_file, options);
    return {"accepted", ""};
  } catch (const ConfigError& e) {
    return {e.file() + " " + e.pointer(), e.what()};
  }
}

TEST(Plan, BeginsEachRepeatWithAReferencePose) {
  const Plan plan = plan_campaign(
      single(kTwoAxes, R"(, "repeats": 2, "images_per_pose": 3, "dwell_ms": 250)"), rig());
  ASSERT_EQ(plan.poses.size(), 14u);
  for (const std::size_t i : {0u, 7u}) {
    EXPECT_EQ(plan.poses[i].role, PoseRole::kReference);
    EXPECT_EQ(plan.poses[i].point, 0);
    EXPECT_EQ(plan.poses[i].yaw_deg, 0.0);
    EXPECT_EQ(plan.poses[i].pitch_deg, 0.0);
    EXPECT_EQ(plan.poses[i].stage_mm, 120.0);
  }
  EXPECT_EQ(plan.poses[13].repeat, 2);
  EXPECT_EQ(plan.poses[13].point, 6);
  EXPECT_EQ(plan.poses[13].images, 3);
  EXPECT_EQ(plan.poses[13].dwell_s, 0.25);
}

TEST(Plan, FreezesTheDescriptionOfAController) {
  const TemporaryFolder folder;
  const std::filesystem::path file = folder / "mine.json";
  std::filesystem::copy_file(
      std::filesystem::path(TURNTABLE_SOURCE_DIR) / "drivers/described/zaber_ascii.json", file);
  RigFile rig = load_rig_file(kScenarios / "rigs" / "described_zaber.json");
  ControllerConfig& controller = rig.controllers.front();
  controller.description = file.string();
  const FrozenText frozen = plan_campaign(single(kTwoAxes), rig).sources.back();
  EXPECT_EQ(frozen.file, file.string());
  EXPECT_EQ(frozen.text, slurp(file));
  // A run that goes on has it from its plan, whatever has become of the file.
  std::filesystem::remove(file);
  EXPECT_THROW(plan_campaign(single(kTwoAxes), rig), ConfigError);
  EXPECT_THROW(load_description(controller), ConfigError);
  controller.description_text = frozen.text;
  EXPECT_THAT(load_description(controller).title, HasSubstr("Zaber ASCII protocol"));
}

TEST(Plan, AsWrittenStartsInnerRangesAgain) {
  EXPECT_THAT(
      pitch_and_yaw(plan_campaign(single(kTwoAxes), rig())),
      ::testing::ElementsAre(std::pair(0, 0), std::pair(-10, 1), std::pair(-10, 2), std::pair(0, 1),
                             std::pair(0, 2), std::pair(10, 1), std::pair(10, 2)));
}

TEST(Plan, SnakeMovesOneAxisByOneStepFromPoseToPose) {
  EXPECT_THAT(
      pitch_and_yaw(plan_campaign(single(kTwoAxes, R"(, "order": "snake")"), rig())),
      ::testing::ElementsAre(std::pair(0, 0), std::pair(-10, 1), std::pair(-10, 2), std::pair(0, 2),
                             std::pair(0, 1), std::pair(10, 1), std::pair(10, 2)));
  const Plan plan = plan_campaign(load_campaign(kScenarios / "triaxial_xyz.json"), rig());
  std::set<std::array<double, 3>> visited;
  for (std::size_t i = 1; i < plan.poses.size(); ++i) {
    const PlannedPose &a = plan.poses[i - 1], &b = plan.poses[i];
    EXPECT_TRUE(visited.insert({b.yaw_deg, b.roll_deg, b.pitch_deg}).second);
    if (i == 1) continue;
    EXPECT_DOUBLE_EQ(std::abs(a.yaw_deg - b.yaw_deg) + std::abs(a.roll_deg - b.roll_deg) +
                         std::abs(a.pitch_deg - b.pitch_deg),
                     5.0);
  }
  EXPECT_EQ(visited.size(), 9u * 9u * 13u);
}

Campaign ordered(const std::string& more) {
  Campaign campaign;
  campaign.scenarios = {parse_scenario(
      R"({"format": "turntable-scenario/1", "name": "m", "title": "M", "kind": "attitude",
          "stage_mm": 120, "repeats": 2,
          "ranges": [{"axis": "pitch", "values_deg": [-20, 0, 20]},
                     {"axis": "yaw", "values_deg": [-30, -10, 10, 30]}])" +
          more + "}",
      "m.json")};
  return campaign;
}

std::multiset<std::pair<double, double>> places(const Plan& plan, int repeat) {
  std::multiset<std::pair<double, double>> out;
  for (const PlannedPose& p : plan.poses)
    if (p.repeat == repeat && p.role == PoseRole::kMeasure) out.emplace(p.pitch_deg, p.yaw_deg);
  return out;
}

TEST(Plan, EveryOrderVisitsTheSamePlacesOnceAndNearestMovesLeast) {
  const Plan written = plan_campaign(ordered(""), rig());
  std::map<PoseOrder, double> motion_s;
  for (const OrderTime& time : order_times(ordered(""), rig()))
    motion_s[time.order] = time.motion_s;
  for (const char* order : {"snake", "nearest", "random"}) {
    const Plan plan = plan_campaign(ordered(std::string(", \"order\": \"") + order + "\""), rig());
    ASSERT_EQ(plan.poses.size(), written.poses.size()) << order;
    for (const int repeat : {1, 2})
      EXPECT_EQ(places(plan, repeat), places(written, repeat)) << order;
    std::set<std::string> ids;
    for (const PlannedPose& p : plan.poses) EXPECT_TRUE(ids.insert(p.id).second);
  }
  EXPECT_LT(motion_s.at(PoseOrder::kSnake), motion_s.at(PoseOrder::kAsWritten));
  EXPECT_LE(motion_s.at(PoseOrder::kNearest), motion_s.at(PoseOrder::kSnake));
  EXPECT_GT(motion_s.at(PoseOrder::kRandom), motion_s.at(PoseOrder::kNearest));
}

TEST(Plan, ShufflesBySeedAndRepeatAndTheSameWayEveryTime) {
  const auto yaws = [&](const std::string& more, int repeat) {
    std::vector<std::pair<double, double>> out;
    for (const PlannedPose& p :
         plan_campaign(ordered(", \"order\": \"random\"" + more), rig()).poses)
      if (p.repeat == repeat) out.emplace_back(p.pitch_deg, p.yaw_deg);
    return out;
  };
  EXPECT_EQ(yaws("", 1), yaws("", 1));
  EXPECT_NE(yaws("", 1), yaws("", 2));
  EXPECT_NE(yaws("", 1), yaws(", \"order_seed\": 2", 1));
}

TEST(Plan, ReturnsToZeroAfterEverySoManyPosesButNotAtTheEnd) {
  const Plan plan = plan_campaign(ordered(", \"return_every\": 4"), rig());
  std::string roles;
  for (const PlannedPose& p : plan.poses)
    roles += p.role == PoseRole::kReference ? 'R' : p.role == PoseRole::kReturn ? 'r' : '.';
  EXPECT_EQ(roles, "R....r....r....R....r....r....");
  for (const PlannedPose& p : plan.poses)
    EXPECT_TRUE(p.role != PoseRole::kReturn || p.yaw_deg == 0.0);
  EXPECT_EQ(ordered(", \"return_every\": 4").scenarios[0].pose_count() * 2, plan.poses.size());
  const Plan again = parse_plan(plan_text(plan), "plan.json");
  EXPECT_EQ(again.poses[5].role, PoseRole::kReturn);
}

TEST(Plan, OfThePublishedCampaignHasItsPosesRepeatsAndTables) {
  const Plan plan =
      plan_campaign(load_campaign(kScenarios / "campaigns" / "paper_2019.json"), rig());
  std::vector<std::size_t> counts(plan.scenarios.size());
  std::set<std::string> ids;
  for (const auto& pose : plan.poses) {
    ++counts[pose.scenario];
    EXPECT_TRUE(ids.insert(pose.id).second);
  }
  EXPECT_THAT(counts, ::testing::ElementsAre(16u, 3u * 22u, 3u * 32u, 3u * 170u, 1054u, 1054u));
  EXPECT_EQ(plan.scenarios[0].kind, ScenarioKind::kCalibration);
  EXPECT_EQ(plan.scenarios[1].table, std::nullopt);
  EXPECT_EQ(plan.scenarios[2].table, 3);
  EXPECT_EQ(plan.scenarios[3].table, 4);
  EXPECT_EQ(plan.scenarios[5].table, 5);
  EXPECT_EQ(plan.poses[0].role, PoseRole::kPlaneCheck);
  EXPECT_EQ(plan.poses[1].role, PoseRole::kPlaneFit);
  EXPECT_EQ(plan.poses[1].images, 4);
  EXPECT_EQ(plan.poses[3].role, PoseRole::kPinholeView);
  EXPECT_EQ(plan.poses[3].point, 0);
  EXPECT_EQ(plan.sources.size(), 7u);
}

TEST(Plan, SurvivesItsFile) {
  const Plan plan = plan_campaign(load_campaign(kScenarios / "campaigns" / "quick.json"), rig());
  EXPECT_EQ(plan_text(parse_plan(plan_text(plan), "plan.json")), plan_text(plan));
}

TEST(Plan, IsTheSameEveryTime) {
  const auto make = [] {
    return plan_text(plan_campaign(load_campaign(kScenarios / "campaigns" / "quick.json"), rig()));
  };
  EXPECT_EQ(make(), make());
}

TEST(Scenarios, EveryFileLoadsAndFitsTheSimulatedRigs) {
  int files = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(kScenarios)) {
    if (entry.path().extension() != ".json" || entry.path().parent_path().filename() == "schema")
      continue;
    if (const auto format = format_of(entry.path()); format != "scenario" && format != "campaign")
      continue;
    ++files;
    SCOPED_TRACE(entry.path().string());
    const Campaign campaign = load_campaign(entry.path());
    for (const char* name : {"simulated.json", "ideal.json"}) {
      const RigFile rig_file = load_rig_file(kScenarios / "rigs" / name);
      const PlanReport report = check_plan(plan_campaign(campaign, rig_file), rig_file);
      EXPECT_GT(report.field_margin_px, 30.0);
    }
  }
  EXPECT_GE(files, 14);
}

TEST(Scenarios, QuickStaysQuick) {
  const Plan plan = plan_campaign(load_campaign(kScenarios / "campaigns" / "quick.json"), rig());
  EXPECT_LT(plan.poses.size(), 60u);
  std::set<int> tables;
  for (const auto& s : plan.scenarios) tables.insert(s.table.value_or(1));
  EXPECT_EQ(tables, (std::set{1, 3, 4, 5}));
}

TEST(CheckPlan, RefusesATargetOutsideASoftLimitWithThePointerOfItsRange) {
  const Plan plan = plan_campaign(single(R"([{"axis": "yaw", "values_deg": [0, 5]},
                 {"axis": "pitch", "values_deg": [0, 46, 50]}])"),
                                  rig());
  const auto [where, what] = refusal(plan, rig());
  EXPECT_EQ(where, "s.json /ranges/1");
  EXPECT_THAT(what, AllOf(HasSubstr("2 violations"), HasSubstr("pitch target 46 deg"),
                          HasSubstr("pitch target 50 deg"), HasSubstr("allowed: -45 to 45 deg"),
                          HasSubstr("nothing has moved")));
}

TEST(CheckPlan, RefusesATargetWhoseOvershootLeavesTheSoftLimits) {
  const Plan plan = plan_campaign(single(R"([{"axis": "pitch", "values_deg": [-44.8]}])"), rig());
  RigFile rig_file = rig();
  rig_file.axes[AxisId::kPitch].backlash = 0.5;
  EXPECT_THAT(
      refusal(plan, rig_file).second,
      AllOf(HasSubstr("-44.8 deg is approached from -45.3 deg"), HasSubstr("1 violation:")));
  rig_file.axes[AxisId::kPitch].backlash = -0.5;
  EXPECT_EQ(refusal(plan, rig_file).first, "accepted");
}

TEST(CheckPlan, RefusesAStagePositionOutsideItsLimits) {
  Campaign campaign = single(kTwoAxes);
  campaign.scenarios[0].stage_mm = 201;
  EXPECT_EQ(refusal(plan_campaign(campaign, rig()), rig()).first, "s.json /stage_mm");
}

TEST(CheckPlan, RefusesARigThatCannotReachZero) {
  RigFile rig_file = rig();
  rig_file.axes[AxisId::kStage].lower = 10;
  const auto [where, what] = refusal(plan_campaign(single(kTwoAxes), rig_file), rig_file);
  EXPECT_EQ(where, rig_file.file + " /axes/stage/limits_mm");
}

TEST(CheckPlan, RefusesPosesThatLeaveTheFieldOfView) {
  RigFile rig_file = rig();
  rig_file.camera.nominal_focal_px = 5500;
  const Plan plan = plan_campaign(single(kTwoAxes), rig_file);
  const auto [where, what] = refusal(plan, rig_file);
  EXPECT_EQ(where, "s.json /stage_mm");  // already the reference pose
  EXPECT_THAT(what, AllOf(HasSubstr("7 violations"), HasSubstr("LED"), HasSubstr("px")));
  const Plan calibration =
      plan_campaign(load_campaign(kScenarios / "calibration_sweep.json"), rig_file);
  EXPECT_THAT(refusal(calibration, rig_file).second, HasSubstr("direction circle"));
}

TEST(CheckPlan, PredictsImagePointsFromTheNominalCamera) {
  // One LED 60 mm along x, 580 mm below the camera: 1945 * 60 / 580 px right of the centre.
  RigFile rig_file = rig();
  rig_file.target.points_mm = {Vector3d(60, 0, 0)};
  rig_file.target.led_radius_mm = 0;
  const Plan plan = plan_campaign(single(R"([{"axis": "yaw", "values_deg": [0]}])"), rig_file);
  EXPECT_NEAR(check_plan(plan, rig_file).field_margin_px, 1023 - 511.5 - 1945.0 * 60 / 580, 1e-9);
}

TEST(PredictedPoints, LieWhereTheNominalCameraSeesEachLed) {
  RigFile rig_file = rig();
  rig_file.target.points_mm = {Vector3d(60, 0, 0), Vector3d(0, 40, 0)};
  rig_file.target.led_radius_mm = 2;
  PlannedPose pose;
  pose.stage_mm = 120;
  auto points = predicted_points(pose, rig_file);
  ASSERT_EQ(points.size(), 2u);
  EXPECT_NEAR(points[0].u_px, 511.5 + 1945.0 * 60 / 580, 1e-9);
  EXPECT_NEAR(points[0].v_px, 511.5, 1e-9);
  EXPECT_NEAR(points[1].v_px, 511.5 - 1945.0 * 40 / 580, 1e-9);
  EXPECT_NEAR(points[1].radius_px, 1945.0 * 2 / 580, 1e-9);
  pose.yaw_deg = 90;  // counter-clockwise seen from the camera
  points = predicted_points(pose, rig_file);
  EXPECT_NEAR(points[0].v_px, 511.5 - 1945.0 * 60 / 580, 1e-9);
  pose.stage_mm = 700;  // at the camera's height
  EXPECT_FALSE(predicted_points(pose, rig_file)[0].visible());
}

TEST(PredictedPoints, AreTheOutlineOfAPatternThatIsFoundWholeOnly) {
  RigFile rig_file = rig();
  PatternConfig& p = rig_file.pattern;
  PlannedPose pose;
  pose.payload = Payload::kCirclePattern;
  ASSERT_EQ(predicted_points(pose, rig_file).size(), p.direction_circles.size());
  p.direction_circles.clear();
  // 3 x 4 circles of spacing 10: lattice columns 0, 2, 4 and, in odd rows, 1, 3, 5.
  p.kind = PatternKind::kAsymmetricCircles;
  p.columns = 3;
  p.rows = 4;
  p.origin_column = p.origin_row = 0;
  p.spacing_mm = 10;
  double left = 1e9, right = -1e9, top = 1e9;
  for (const ImagePoint& point : predicted_points(pose, rig_file)) {
    left = std::min(left, point.u_px);
    right = std::max(right, point.u_px);
    top = std::min(top, point.v_px);
  }
  EXPECT_NEAR(left, 511.5, 1e-9);
  EXPECT_NEAR(right, 511.5 + 1945.0 * 50 / 700, 1e-9);
  EXPECT_NEAR(top, 511.5 - 1945.0 * 30 / 700, 1e-9);
}

TEST(CheckPlan, ListsTenViolationsAndTheNumberOfAll) {
  RigFile rig_file = rig();
  rig_file.axes[AxisId::kPitch].lower = -1;
  rig_file.axes[AxisId::kPitch].upper = 1;
  const Plan plan = plan_campaign(
      single(R"([{"axis": "pitch", "start_deg": -30, "stop_deg": 30, "step_deg": 3}])"), rig_file);
  const auto [where, what] = refusal(plan, rig_file);
  EXPECT_THAT(what,
              AllOf(HasSubstr("20 violations, the first 10"), HasSubstr("pitch target -30 deg")));
  EXPECT_EQ(std::ranges::count(what, '\n'), 10);
}

TEST(CheckPlan, RefusesMoreThanTheDiskHolds) {
  const RigFile rig_file = rig();
  Campaign campaign =
      single(R"([{"axis": "pitch", "start_deg": -30, "stop_deg": 30, "step_deg": 0.001}])");
  campaign.scenarios[0].images_per_pose = 1000;  // 60 million images
  const Plan plan = plan_campaign(campaign, rig_file);
  const CheckOptions options{ArchiveMode::kFull,
                             std::filesystem::temp_directory_path() / "not" / "yet" / "there"};
  EXPECT_THAT(refusal(plan, rig_file, options).second, HasSubstr("Make room"));
}

TEST(CheckPlan, ReportsSweptRangesMarginsTimeAndDisk) {
  const RigFile rig_file = rig();
  const Plan plan = plan_campaign(
      single(R"([{"axis": "pitch", "start_deg": -30, "stop_deg": 30, "step_deg": 3}])"), rig_file);
  const PlanReport report =
      check_plan(plan, rig_file, {ArchiveMode::kRegions, std::filesystem::temp_directory_path()});
  const AxisSweep& pitch = report.axes[3];
  const double backlash = rig_file.axis(AxisId::kPitch).backlash;
  EXPECT_EQ(pitch.target_lower, -30);
  EXPECT_EQ(pitch.target_upper, 30);
  EXPECT_DOUBLE_EQ(pitch.swept_lower, -30 - backlash);
  EXPECT_DOUBLE_EQ(pitch.margin(), 45 - 30 - backlash);
  EXPECT_GT(report.time.motion_s, 0.0);
  EXPECT_GT(report.disk_bytes, 22u * 4096u);
  EXPECT_GT(report.free_bytes, 0u);
  EXPECT_EQ(report.images, 22u);
  double total = 0;
  for (const auto& time : pose_times(plan, rig_file)) total += time.total_s();
  EXPECT_NEAR(total, report.time.total_s(), 1e-9);
  EXPECT_THAT(plan_summary(plan, report),
              AllOf(HasSubstr("22 poses"), HasSubstr("pitch"), HasSubstr("disk")));
}

/// Rows of a CSV file by the names of their columns.
std::vector<std::map<std::string, std::string>> rows_of(const std::string& csv) {
  std::istringstream lines(csv);
  const auto cells = [](const std::string& line) {
    std::vector<std::string> out;
    std::istringstream in(line + ",");
    for (std::string cell; std::getline(in, cell, ',');) out.push_back(cell);
    return out;
  };
  std::string line;
  std::getline(lines, line);
  const auto names = cells(line);
  std::vector<std::map<std::string, std::string>> rows;
  while (std::getline(lines, line)) {
    const auto values = cells(line);
    EXPECT_EQ(values.size(), names.size()) << line;
    auto& row = rows.emplace_back();
    for (std::size_t i = 0; i < std::min(values.size(), names.size()); ++i)
      row[names[i]] = values[i];
  }
  return rows;
}

TEST(PlanCsv, HasOneRowPerPoseWithTargetsTimesAndWhereItIsSeen) {
  const TemporaryFolder folder;
  const RigFile rig_file = rig();
  const Plan plan = plan_campaign(single(kTwoAxes), rig_file);
  write_plan_csv(plan, rig_file, folder / "plan.csv");
  const std::string text = slurp(folder / "plan.csv");
  EXPECT_THAT(text,
              HasSubstr("\n1," + plan.poses[1].id +
                        ",s,measure,led_target,1,1,120.0000,1.0000,0.0000,-10.0000,0.000,1,"));
  const auto rows = rows_of(text);
  ASSERT_EQ(rows.size(), plan.poses.size());
  const auto times = pose_times(plan, rig_file);
  double time_s = 0.0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const auto number = [&](const char* name) { return std::stod(rows[i].at(name)); };
    time_s += times[i].total_s();
    EXPECT_NEAR(number("motion_s"), times[i].motion_s, 6e-4);
    EXPECT_NEAR(number("settle_s"), times[i].settle_s, 6e-4);
    EXPECT_NEAR(number("trigger_s"), times[i].trigger_s, 6e-4);
    EXPECT_NEAR(number("time_s"), time_s, 6e-4);
    const auto points = predicted_points(plan.poses[i], rig_file);
    for (const ImagePoint& p : points) {
      EXPECT_LE(number("u_min_px"), p.u_px - p.radius_px + 0.006);
      EXPECT_GE(number("u_max_px"), p.u_px + p.radius_px - 0.006);
      EXPECT_LE(number("v_min_px"), p.v_px - p.radius_px + 0.006);
      EXPECT_GE(number("v_max_px"), p.v_px + p.radius_px - 0.006);
    }
    // And no wider: some disc touches each side.
    const auto touches = [&](const char* name, auto edge) {
      return std::ranges::any_of(
          points, [&](const ImagePoint& p) { return std::abs(edge(p) - number(name)) < 0.006; });
    };
    EXPECT_TRUE(touches("u_min_px", [](const ImagePoint& p) { return p.u_px - p.radius_px; }));
    EXPECT_TRUE(touches("u_max_px", [](const ImagePoint& p) { return p.u_px + p.radius_px; }));
    EXPECT_TRUE(touches("v_min_px", [](const ImagePoint& p) { return p.v_px - p.radius_px; }));
    EXPECT_TRUE(touches("v_max_px", [](const ImagePoint& p) { return p.v_px + p.radius_px; }));
  }
}

// ---- cables

RigFile with_cable(double lower, double upper) {
  RigFile rig_file = rig();
  rig_file.axes[AxisId::kYaw].cable_lower = lower;
  rig_file.axes[AxisId::kYaw].cable_upper = upper;
  return rig_file;
}

TEST(Cable, RefusesATargetAndAnOvershootThatWindItAndNamesBothPlaces) {
  const Plan plan = plan_campaign(single(R"([{"axis": "pitch", "values_deg": [0]},
                                             {"axis": "yaw", "values_deg": [-40, 60]}])"),
                                  rig());
  EXPECT_EQ(refusal(plan, with_cable(-50, 60)).first, "accepted");
  const auto [where, what] = refusal(plan, with_cable(-50, 59));
  EXPECT_EQ(where, "s.json /ranges/1");
  EXPECT_THAT(what, AllOf(HasSubstr("1 violation:"), HasSubstr("yaw target 60 deg"),
                          HasSubstr("allowed: -50 to 59 deg"), HasSubstr("cable range"),
                          HasSubstr("simulated.json at /axes/yaw/cable_deg")));
  // The overshoot of 0.5 deg below -40 winds it.
  EXPECT_THAT(refusal(plan, with_cable(-40.4, 60)).second,
              AllOf(HasSubstr("-40 deg is approached from -40.5 deg"), HasSubstr("cable range")));
}

TEST(Cable, ThatIsLooserThanTheSoftLimitsLeavesThemTheWord) {
  const Plan plan = plan_campaign(single(R"([{"axis": "yaw", "values_deg": [0, 100]}])"), rig());
  EXPECT_THAT(refusal(plan, with_cable(-300, 300)).second,
              AllOf(HasSubstr("allowed: -90 to 90 deg"), HasSubstr("soft limits"),
                    HasSubstr("/axes/yaw/limits_deg"), ::testing::Not(HasSubstr("cable range"))));
}

TEST(Cable, HasToLeaveRoomForTheApproachOfZero) {
  const auto [where, what] = refusal(plan_campaign(single(kTwoAxes), rig()), with_cable(-0.2, 60));
  EXPECT_THAT(where, AllOf(HasSubstr("simulated.json"), HasSubstr("/axes/yaw/cable_deg")));
  EXPECT_THAT(what, AllOf(HasSubstr("approached from -0.5 deg"), HasSubstr("1 violation:")));
}

TEST(CheckPlan, SaysOfAnAbsurdStagePositionWhatItWouldMean) {
  Campaign campaign = single(kTwoAxes);
  campaign.scenarios[0].stage_mm = 1e300;
  const auto [where, what] = refusal(plan_campaign(campaign, rig()), rig());
  EXPECT_EQ(where, "s.json /stage_mm");
  EXPECT_THAT(what, HasSubstr("LED 0 would stand 1e+300 mm above the camera"));
}

TEST(Cable, CountsInTheMarginAndIsShown) {
  const RigFile rig_file = with_cable(-50, 60);
  const Plan plan =
      plan_campaign(single(R"([{"axis": "yaw", "values_deg": [-40, 45]}])"), rig_file);
  const PlanReport report = check_plan(plan, rig_file);
  EXPECT_DOUBLE_EQ(report.axes[1].margin(), 50 - 40.5);
  EXPECT_THAT(plan_summary(plan, report), AllOf(HasSubstr("cable free"), HasSubstr("60.000")));
  EXPECT_TRUE(report.remarks.empty());
  EXPECT_THAT(plan_summary(plan, check_plan(plan, rig())), ::testing::Not(HasSubstr("cable free")));
}

TEST(Cable, OfATableThatTurnsOnAndOnIsRemarkedBecauseHomingSeesNoTurns) {
  RigFile rig_file = with_cable(-400, 400);
  AxisConfig& yaw = rig_file.axes[AxisId::kYaw];
  yaw.lower = -500;
  yaw.upper = 500;
  const Plan plan =
      plan_campaign(single(R"([{"axis": "yaw", "values_deg": [-360, 0, 390]}])"), rig_file);
  const PlanReport report = check_plan(plan, rig_file);
  ASSERT_EQ(report.remarks.size(), 1u);
  EXPECT_THAT(report.remarks[0],
              AllOf(HasSubstr("yaw"), HasSubstr("-400 to 400 deg"), HasSubstr("before homing")));
  EXPECT_THAT(plan_summary(plan, report), HasSubstr("remark: yaw"));
  yaw.cable_lower = -179;
  yaw.cable_upper = 179;
  EXPECT_TRUE(check_plan(plan_campaign(single(kTwoAxes), rig_file), rig_file).remarks.empty());
}

// ---- calibration sweeps

Campaign sweep(int repeats) {
  Campaign campaign;
  campaign.name = campaign.title = "c";
  campaign.scenarios.push_back(parse_scenario(
      R"({"format": "turntable-scenario/1", "name": "c", "title": "C", "kind": "calibration",
          "planes": [{"stage_mm": 0, "use": "check"}, {"stage_mm": 130, "use": "fit"},
                     {"stage_mm": 180, "use": "fit"}],
          "images_per_plane": 2, "return_to_first_plane": true,
          "pinhole_views": [{"stage_mm": 80, "roll_deg": 20}, {"stage_mm": 80, "pitch_deg": 20}],
          "repeats": )" +
          std::to_string(repeats) + "}",
      "c.json"));
  return campaign;
}

TEST(CalibrationSweep, TakesItsPlanesRepeatByRepeatAndViewsAndReturnOnce) {
  const Plan plan = plan_campaign(sweep(3), rig());
  std::string places;
  for (const PlannedPose& p : plan.poses)
    places += std::to_string(p.repeat) +
              (p.role == PoseRole::kPlaneCheck ? "c"
               : p.role == PoseRole::kPlaneFit ? "f"
                                               : "v") +
              std::to_string(p.point) + " ";
  EXPECT_EQ(places, "1c0 1f1 1f2 2c0 2f1 2f2 3c0 3f1 3f2 1v0 1v1 3c0 ");
  EXPECT_EQ(plan.scenarios[0].repeats, 3);
  for (const PlannedPose& p : plan.poses)
    EXPECT_EQ(p.images, p.role == PoseRole::kPinholeView ? 1 : 2);
  std::set<std::string> ids;
  for (const PlannedPose& p : plan.poses) EXPECT_TRUE(ids.insert(p.id).second);
  EXPECT_EQ(plan_text(parse_plan(plan_text(plan), "plan.json")), plan_text(plan));
}

TEST(CalibrationSweep, TakenOnceIsPlannedAsEver) {
  const Plan once = plan_campaign(sweep(1), rig());
  ASSERT_EQ(once.poses.size(), 6u);
  for (const PlannedPose& p : once.poses) EXPECT_EQ(p.repeat, 1);
  EXPECT_EQ(once.poses.back().id, pose_id(once.poses[0], "c", 1));
}

TEST(CalibrationSweep, NamesThePlaneThatIsRefusedInWhicheverRepeat) {
  Campaign campaign = sweep(3);
  campaign.scenarios[0].planes[1].stage_mm = 250;
  const RigFile rig_file = rig();
  const Plan plan = plan_campaign(campaign, rig_file);
  const auto [where, what] = refusal(plan, rig_file);
  EXPECT_EQ(where, "c.json /planes/1/stage_mm");
  EXPECT_THAT(what, HasSubstr("1 violation:"));  // and not one for each repeat
  for (const PlannedPose& p : plan.poses)
    EXPECT_EQ(pointer_of(plan, p, AxisId::kStage),
              p.role == PoseRole::kPinholeView
                  ? "/pinhole_views/" + std::to_string(p.point) + "/stage_mm"
                  : "/planes/" + std::to_string(p.point) + "/stage_mm");
}

AxisConfig plain_axis() {
  AxisConfig axis;
  axis.speed = 20;
  axis.acceleration = 50;
  return axis;
}

TEST(MotionTime, FollowsTheTrapezoid) {
  AxisConfig axis = plain_axis();
  EXPECT_DOUBLE_EQ(trapezoid_seconds(axis, 28),
                   2 * 0.4 + 20.0 / 20);  // ramps of 4 each, 20 at full speed
  EXPECT_DOUBLE_EQ(trapezoid_seconds(axis, -28), trapezoid_seconds(axis, 28));
  EXPECT_DOUBLE_EQ(trapezoid_seconds(axis, 8), 0.8);
  EXPECT_DOUBLE_EQ(trapezoid_seconds(axis, 2), 2 * 10.0 / 50);  // peak sqrt(50 * 2)
  EXPECT_EQ(trapezoid_seconds(axis, 0), 0.0);
  axis.initial_speed = 20;
  EXPECT_DOUBLE_EQ(trapezoid_seconds(axis, 30), 1.5);
}

TEST(MotionTime, OvershootsOnLongMovesAndOnMovesAgainstTheApproach) {
  AxisConfig axis = plain_axis();
  EXPECT_FALSE(takes_overshoot(axis, 0, 10));
  axis.backlash = 0.5;
  EXPECT_TRUE(takes_overshoot(axis, 0, 10));
  EXPECT_TRUE(takes_overshoot(axis, 0, -0.1));
  EXPECT_FALSE(takes_overshoot(axis, 0, 0.4));
  EXPECT_FALSE(takes_overshoot(axis, 1, 1));
  axis.backlash = -0.5;
  EXPECT_TRUE(takes_overshoot(axis, 0, 0.1));
  EXPECT_FALSE(takes_overshoot(axis, 0, -0.4));
  EXPECT_DOUBLE_EQ(move_seconds(axis, 0, -10),
                   trapezoid_seconds(axis, 9.5) + trapezoid_seconds(axis, 0.5));
  EXPECT_DOUBLE_EQ(move_seconds(axis, 0, 10),
                   trapezoid_seconds(axis, 10.5) + trapezoid_seconds(axis, 0.5));
}

}  // namespace
}  // namespace turntable
