#include "src/record/plan.h"

#include <gmock/gmock.h>

#include <nlohmann/json.hpp>
#include <set>

#include "src/core/errors.h"
#include "tests/record/small_plan.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

std::string refusal(const Json& json) {
  try {
    parse_plan(json.dump(), "plan.json");
    return "none";
  } catch (const ConfigError& e) {
    return e.what();
  }
}

TEST(Plan, ReadsBackAsItWasWritten) {
  const Plan plan = small_plan();
  const std::string text = plan_text(plan);
  const Plan back = parse_plan(text, "plan.json");
  EXPECT_EQ(plan_text(back), text);
  ASSERT_EQ(back.poses.size(), plan.poses.size());
  EXPECT_EQ(back.poses[3].id, plan.poses[3].id);
  EXPECT_EQ(back.poses[3].index, 3u);
  EXPECT_EQ(back.poses[1].yaw_deg, 0.1 + 0.2);
  EXPECT_EQ(back.scenarios[1].table, 3);
  EXPECT_EQ(back.scenarios[1].axes, std::vector{AxisId::kYaw});
  EXPECT_EQ(back.scenarios[0].polynomial_order, 4);
  EXPECT_EQ(back.rig.text, plan.rig.text);
}

TEST(Plan, HasOneLinePerPose) {
  const std::string text = plan_text(small_plan());
  EXPECT_GE(std::ranges::count(text, '\n'), 4);
  EXPECT_THAT(text, HasSubstr("\n  {\"dwell_s\""));
}

TEST(Plan, IdsAreUniqueAlsoForTheSamePlaceVisitedTwice) {
  Plan plan = small_plan();
  plan.poses.push_back(plan.poses[1]);
  plan.poses.push_back(plan.poses[1]);
  number_poses(plan);
  std::set<std::string> ids;
  for (const auto& pose : plan.poses) EXPECT_TRUE(ids.insert(pose.id).second) << pose.id;
}

TEST(Plan, IdsDependOnScenarioTargetsAndRepeatOnly) {
  const Plan plan = small_plan();
  const PlannedPose& pose = plan.poses[1];
  const std::string id = pose_id(pose, "motion", 0);
  EXPECT_EQ(id, pose.id);
  EXPECT_EQ(id.size(), 16u);
  PlannedPose other = pose;
  other.index = 99;
  other.dwell_s = 5.0;
  EXPECT_EQ(pose_id(other, "motion", 0), id);
  other.repeat = 2;
  EXPECT_NE(pose_id(other, "motion", 0), id);
  other = pose;
  other.roll_deg = 1e-6;
  EXPECT_NE(pose_id(other, "motion", 0), id);
  EXPECT_NE(pose_id(pose, "other", 0), id);
  EXPECT_NE(pose_id(pose, "motion", 1), id);
}

TEST(Plan, IdsStayTheSameFromVersionToVersion) {  // runs are resumed and compared by them
  EXPECT_EQ(small_plan().poses[0].id, "39b10b7cd5f60118");
}

TEST(Plan, RefusesEditsAndNamesThePlace) {
  const Json good = Json::parse(plan_text(small_plan()));
  Json bad = good;
  bad["poses"][1]["yaw_deg"] = 4.0;
  EXPECT_THAT(refusal(bad), HasSubstr("/poses/1/id"));
  bad = good;
  bad["rig"]["text"] = "{}";
  EXPECT_THAT(refusal(bad), HasSubstr("/rig/text"));
  bad = good;
  bad["sources"][0]["text"] = "[]";
  EXPECT_THAT(refusal(bad), HasSubstr("/sources/0/text"));
  bad = good;
  bad["poses"][2]["scenario"] = 7;
  EXPECT_THAT(refusal(bad), HasSubstr("/poses/2/scenario"));
  bad = good;
  bad["poses"][2]["role"] = "dance";
  EXPECT_THAT(refusal(bad), HasSubstr("/poses/2/role"));
  bad = good;
  bad["poses"][2].erase("stage_mm");
  EXPECT_THAT(refusal(bad), HasSubstr("stage_mm"));
  bad = good;
  bad["extra"] = 1;
  EXPECT_THAT(refusal(bad), HasSubstr("extra"));
  EXPECT_EQ(refusal(good), "none");
}

}  // namespace
}  // namespace turntable
