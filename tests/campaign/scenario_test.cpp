#include "src/campaign/scenario.h"

#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

Json attitude() {
  return Json::parse(
      R"({"format": "turntable-scenario/1", "name": "s", "title": "S", "kind": "attitude",
          "stage_mm": 120,
          "ranges": [{"axis": "pitch", "start_deg": -30, "stop_deg": 30, "step_deg": 3}]})");
}

Json calibration() {
  return Json::parse(
      R"({"format": "turntable-scenario/1", "name": "c", "title": "C", "kind": "calibration",
          "planes": [{"stage_mm": 0, "use": "check"}, {"stage_mm": 130, "use": "fit"},
                     {"stage_mm": 180, "use": "fit"}]})");
}

Json changed(Json json, const char* pointer, const Json& value) {
  json[Json::json_pointer(pointer)] = value;
  return json;
}

Json without(Json json, const char* pointer, const char* key) {
  json[Json::json_pointer(pointer)].erase(key);
  return json;
}

struct Refusal {
  std::string pointer, message;
};
void PrintTo(const Refusal& r, std::ostream* out) { *out << r.pointer << " | " << r.message; }

Refusal refusal(const std::string& text) {
  try {
    parse_scenario(text, "s.json");
    return {"accepted", ""};
  } catch (const ConfigError& e) {
    EXPECT_EQ(e.file(), "s.json");
    return {e.pointer(), e.what()};
  }
}
Refusal refusal(const Json& json) { return refusal(json.dump()); }

auto Refuses(const std::string& pointer, const std::string& words) {
  return AllOf(::testing::Field(&Refusal::pointer, pointer),
               ::testing::Field(&Refusal::message, HasSubstr(words)));
}

TEST(Scenario, ExpandsARangeWithBothEnds) {
  const Scenario s = parse_scenario(attitude().dump(), "s.json");
  ASSERT_EQ(s.ranges.size(), 1u);
  EXPECT_EQ(s.ranges[0].axis, AxisId::kPitch);
  EXPECT_EQ(s.ranges[0].values_deg.size(), 21u);
  EXPECT_EQ(s.ranges[0].values_deg.front(), -30.0);
  EXPECT_EQ(s.ranges[0].values_deg[10], 0.0);
  EXPECT_EQ(s.ranges[0].values_deg.back(), 30.0);
  EXPECT_EQ(s.pose_count(), 22u);
  EXPECT_EQ(s.repeats, 1);
  EXPECT_EQ(s.order, PoseOrder::kAsWritten);
}

TEST(Scenario, ExpandsDownwardsAndToDecimalsAsWritten) {
  Json json =
      changed(attitude(), "/ranges/0",
              {{"axis", "yaw"}, {"start_deg", 0.3}, {"stop_deg", -0.3}, {"step_deg", -0.1}});
  EXPECT_THAT(parse_scenario(json.dump(), "s").ranges[0].values_deg,
              ElementsAre(0.3, 0.2, 0.1, 0.0, -0.1, -0.2, -0.3));
}

TEST(Scenario, TakesListedAnglesInTheirOrder) {
  Json json = changed(attitude(), "/ranges/0", {{"axis", "roll"}, {"values_deg", {5, -5, 0}}});
  EXPECT_THAT(parse_scenario(json.dump(), "s").ranges[0].values_deg, ElementsAre(5, -5, 0));
}

TEST(Scenario, ReadsACalibration) {
  const Scenario s = parse_scenario(calibration().dump(), "c.json");
  EXPECT_EQ(s.kind, ScenarioKind::kCalibration);
  EXPECT_EQ(s.payload, Payload::kCirclePattern);
  ASSERT_EQ(s.planes.size(), 3u);
  EXPECT_FALSE(s.planes[0].fit);
  EXPECT_EQ(s.polynomial_order, 5);
  EXPECT_EQ(s.pose_count(), 3u);
}

TEST(Scenario, LeavesTheOrderToTheResidualsOnlyIfAskedTo) {
  EXPECT_EQ(parse_scenario(changed(calibration(), "/polynomial_order", "auto").dump(), "c")
                .polynomial_order,
            kOrderByResiduals);
  EXPECT_THAT(refusal(changed(calibration(), "/polynomial_order", 0)),
              Refuses("/polynomial_order", "found 0"));
}

TEST(Scenario, ReturnsToTheFirstPlaneIfAskedTo) {
  const Scenario s =
      parse_scenario(changed(calibration(), "/return_to_first_plane", true).dump(), "c");
  EXPECT_TRUE(s.return_to_first_plane);
  EXPECT_EQ(s.pose_count(), 4u);
}

TEST(Scenario, RepeatsTheSweepOfPlanesButNotItsViewsNorItsReturn) {
  Json json = changed(calibration(), "/return_to_first_plane", true);
  json["pinhole_views"] = {{{"stage_mm", 80}, {"roll_deg", 10}}};
  EXPECT_EQ(parse_scenario(json.dump(), "c").total_poses(), 3u + 1u + 1u);
  json["repeats"] = 4;
  const Scenario s = parse_scenario(json.dump(), "c");
  EXPECT_EQ(s.repeats, 4);
  EXPECT_EQ(s.total_poses(), 4u * 3u + 1u + 1u);
  Json attitude_twice = changed(attitude(), "/repeats", 2);
  EXPECT_EQ(parse_scenario(attitude_twice.dump(), "s").total_poses(), 2u * 22u);
}

TEST(ScenarioRefuses, AnOrderThatIsNoneASeedWithoutShufflingAndNearestOfTooMany) {
  EXPECT_THAT(refusal(changed(attitude(), "/order", "fastest")), Refuses("/order", "nearest"));
  EXPECT_THAT(refusal(changed(attitude(), "/order_seed", 3)), Refuses("/order_seed", "random"));
  Json many = changed(attitude(), "/order", "nearest");
  many["ranges"] = {{{"axis", "yaw"}, {"start_deg", 0}, {"stop_deg", 45}, {"step_deg", 0.2}},
                    {{"axis", "pitch"}, {"start_deg", 0}, {"stop_deg", 30}, {"step_deg", 0.5}}};
  EXPECT_THAT(refusal(many), Refuses("/order", "snake"));
}

TEST(ScenarioRefuses, AStepOfZero) {
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/step_deg", 0)),
              Refuses("/ranges/0/step_deg", "found 0"));
}

TEST(ScenarioRefuses, AStepOfTheWrongSign) {
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/step_deg", -3)),
              Refuses("/ranges/0/step_deg", "Change its sign"));
}

TEST(ScenarioRefuses, AnEmptyRange) {
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/stop_deg", -30)),
              Refuses("/ranges/0", "empty"));
  EXPECT_THAT(refusal(changed(attitude(), "/ranges", Json::array())),
              Refuses("/ranges", "minItems"));
  EXPECT_THAT(
      refusal(changed(attitude(), "/ranges/0", {{"axis", "yaw"}, {"values_deg", Json::array()}})),
      Refuses("/ranges/0/values_deg", "minItems"));
}

TEST(ScenarioRefuses, AStepThatDoesNotDivideTheRangeAndSaysWhatWould) {
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/step_deg", 7)),
              Refuses("/ranges/0", "26 or 33 deg"));
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/step_deg", 700)),
              Refuses("/ranges/0", "does not divide"));
}

TEST(ScenarioRefuses, AnAxisGivenTwice) {
  Json json = attitude();
  json["ranges"].push_back(json["ranges"][0]);
  EXPECT_THAT(refusal(json), Refuses("/ranges/1/axis", "already has a range"));
}

TEST(ScenarioRefuses, HalfARangeAndBothFormsAtOnce) {
  EXPECT_THAT(refusal(without(attitude(), "/ranges/0", "stop_deg")),
              Refuses("/ranges/0", "stop_deg"));
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/values_deg", {1, 2})),
              Refuses("/ranges/0/start_deg", "beside"));
}

TEST(ScenarioRefuses, AbsurdNumbersOfPosesBeforeMakingThem) {
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/step_deg", 1e-5)),
              Refuses("/ranges/0", "poses"));
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/step_deg", 1e-300)),
              Refuses("/ranges/0", "poses"));
  Json grid = changed(attitude(), "/ranges/0/step_deg", 0.1);
  for (const char* axis : {"yaw", "roll"}) {
    grid["ranges"].push_back(grid["ranges"][0]);
    grid["ranges"].back()["axis"] = axis;
  }
  EXPECT_THAT(refusal(grid), Refuses("/ranges", "found 2.171e+08 poses, allowed: at most 1000000"));
  Json often = changed(attitude(), "/ranges/0/step_deg", 0.01);
  often["repeats"] = 1000;
  EXPECT_THAT(refusal(often), Refuses("/", "fewer repeats"));
}

TEST(ScenarioRefuses, NumbersThatAreNone) {
  std::string text = attitude().dump();
  text.replace(text.find("120"), 3, "NaN");
  EXPECT_THAT(refusal(text), Refuses("", "line 1"));
  text = attitude().dump();
  text.replace(text.find("120"), 3, "1e999");
  EXPECT_THAT(refusal(text).message, HasSubstr("s.json"));
}

TEST(ScenarioRefuses, UnknownKeysWrongTypesAndMissingKeys) {
  EXPECT_THAT(refusal(changed(attitude(), "/stagemm", 120)), Refuses("/", "stagemm"));
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/stepdeg", 1)),
              Refuses("/ranges/0", "stepdeg"));
  EXPECT_THAT(refusal(changed(attitude(), "/stage_mm", "120")), Refuses("/stage_mm", "number"));
  EXPECT_THAT(refusal(changed(attitude(), "/repeats", 0)), Refuses("/repeats", "minimum"));
  EXPECT_THAT(refusal(changed(attitude(), "/repeats", 1.5)), Refuses("/repeats", "integer"));
  EXPECT_THAT(refusal(changed(attitude(), "/name", "Has Spaces")),
              Refuses("/name", "small letters"));
  EXPECT_THAT(refusal(changed(attitude(), "/ranges/0/axis", "stage")),
              Refuses("/ranges/0/axis", "roll"));
  EXPECT_THAT(refusal(changed(attitude(), "/table", 2)), Refuses("/table", "[3,4,5]"));
  EXPECT_THAT(refusal(changed(attitude(), "/dwell_ms", -1)), Refuses("/dwell_ms", "minimum"));
  EXPECT_THAT(refusal(without(attitude(), "", "name")), Refuses("/", "name"));
  EXPECT_THAT(refusal(without(attitude(), "", "stage_mm")), Refuses("/", "stage_mm"));
  EXPECT_THAT(refusal(without(calibration(), "", "planes")), Refuses("/", "planes"));
  EXPECT_THAT(refusal(changed(attitude(), "/format", "turntable-scenario/2")),
              Refuses("/format", "turntable-scenario/1"));
}

TEST(ScenarioRefuses, KeysOfTheOtherKind) {
  EXPECT_THAT(refusal(changed(attitude(), "/polynomial_order", 5)),
              Refuses("/polynomial_order", "calibration"));
  EXPECT_THAT(refusal(changed(calibration(), "/order", "snake")), Refuses("/order", "attitude"));
}

TEST(ScenarioRefuses, PlanesThatCannotCarryARay) {
  EXPECT_THAT(refusal(changed(calibration(), "/planes/1/use", "check")),
              Refuses("/planes", "at least 2"));
  EXPECT_THAT(refusal(changed(calibration(), "/planes/2/stage_mm", 130)),
              Refuses("/planes/2/stage_mm", "/planes/1"));
}

class CampaignTest : public ::testing::Test {
 protected:
  CampaignTest() {
    spill(folder / "s.json", attitude().dump());
    spill(folder / "c.json", calibration().dump());
  }
  Refusal refused(const Json& steps) const {
    spill(folder / "campaign.json",
          Json{{"format", "turntable-campaign/1"}, {"name", "x"}, {"title", "X"}, {"steps", steps}}
              .dump());
    try {
      load_campaign(folder / "campaign.json");
      return {"accepted", ""};
    } catch (const ConfigError& e) {
      return {e.pointer(), e.what()};
    }
  }
  TemporaryFolder folder;
};

TEST_F(CampaignTest, TakesRepeatsFromItsSteps) {
  EXPECT_EQ(
      refused({{{"scenario", "c.json"}, {"repeats", 2}}, {{"scenario", "s.json"}, {"repeats", 3}}})
          .pointer,
      "accepted");
  const Campaign campaign = load_campaign(folder / "campaign.json");
  ASSERT_EQ(campaign.scenarios.size(), 2u);
  EXPECT_EQ(campaign.scenarios[0].repeats, 2);
  EXPECT_EQ(campaign.scenarios[1].repeats, 3);
}

TEST_F(CampaignTest, ASingleScenarioIsACampaignOfOneStep) {
  const Campaign campaign = load_campaign(folder / "s.json");
  EXPECT_EQ(campaign.name, "s");
  EXPECT_EQ(campaign.scenarios.size(), 1u);
  EXPECT_TRUE(campaign.text.empty());
}

TEST_F(CampaignTest, RefusesMissingFilesOtherFilesAndNamesUsedTwice) {
  EXPECT_THAT(refused({{{"scenario", "c.json"}}, {{"scenario", "nowhere.json"}}}),
              Refuses("/steps/1/scenario", "no file"));
  EXPECT_THAT(refused({{{"scenario", "campaign.json"}}}),
              Refuses("/steps/0/scenario", "a campaign file"));
  EXPECT_THAT(refused({{{"scenario", "s.json"}}, {{"scenario", "s.json"}}}),
              Refuses("/steps/1/scenario", "repeats"));
  EXPECT_THAT(refused(Json::array()), Refuses("/steps", "minItems"));
  EXPECT_THROW(load_campaign(folder / "nowhere.json"), ConfigError);
  EXPECT_THROW(load_campaign(folder.path()), ConfigError);
}

TEST_F(CampaignTest, RefusesABadScenarioUnderItsOwnName) {
  spill(folder / "s.json", changed(attitude(), "/ranges/0/step_deg", 0).dump());
  const Refusal r = refused({{{"scenario", "s.json"}}});
  EXPECT_EQ(r.pointer, "/ranges/0/step_deg");
  EXPECT_THAT(r.message, HasSubstr((folder / "s.json").string()));
}

}  // namespace
}  // namespace turntable
