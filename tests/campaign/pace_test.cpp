#include "src/campaign/pace.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <numeric>

#include "src/campaign/planning.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

class PaceTest : public ::testing::Test {
 protected:
  PaceTest() {
    rig = load_rig_file(std::filesystem::path(TURNTABLE_SOURCE_DIR) /
                        "scenarios/rigs/simulated.json");
    Campaign campaign;
    campaign.name = campaign.title = "pace";
    campaign.scenarios = {parse_scenario(
        R"({"format": "turntable-scenario/1", "name": "m", "title": "M", "kind": "attitude",
            "stage_mm": 120, "images_per_pose": 2,
            "ranges": [{"axis": "pitch", "start_deg": -20, "stop_deg": 20, "step_deg": 2},
                       {"axis": "yaw", "start_deg": -30, "stop_deg": 30, "step_deg": 5}]})",
        "m.json")};
    plan = plan_campaign(campaign, rig);
    times = pose_times(plan, rig);
    todo.resize(plan.poses.size());
    std::iota(todo.begin(), todo.end(), std::size_t{0});
  }
  /// What a pose takes on a rig with these overheads, its images apart.
  double motion_of(std::size_t pose, const std::array<double, 4>& leg_s) const {
    return times[pose].motion_s + times[pose].settle_s +
           leg_s[static_cast<std::size_t>(times[pose].slowest)] * times[pose].legs;
  }

  RigFile rig;
  Plan plan;
  std::vector<PhaseTimes> times;
  std::vector<std::size_t> todo;
};

TEST_F(PaceTest, LearnsWhatEachAxisAddsToItsMoves) {
  const std::array<double, 4> leg_s{0.3, 0.08, 0.02, 0.15};
  const double image_s = 0.12;
  Pace pace(plan, rig, todo, {});
  double left = 0.0;
  for (const std::size_t pose : todo) left += motion_of(pose, leg_s) + 2 * image_s;
  for (const std::size_t pose : todo) {
    pace.taken(motion_of(pose, leg_s) + 2 * image_s, 2 * image_s);
    left -= motion_of(pose, leg_s) + 2 * image_s;
    if (pose == 20) {
      EXPECT_NEAR(pace.left_s() / left, 1.0, 0.05);
    }
  }
  EXPECT_NEAR(pace.left_s(), 0.0, 1e-6);
  const Overheads learned = pace.learned();
  EXPECT_NEAR(*learned.leg_s[1], 0.08, 1e-9);
  EXPECT_FALSE(learned.leg_s[2]) << "roll never moved";
  EXPECT_NEAR(learned.image_s, image_s, 0.02);
  EXPECT_EQ(learned.poses, plan.poses.size());
}

TEST_F(PaceTest, StartsFromWhatEarlierRunsHaveTaught) {
  Overheads known;
  known.leg_s = {0.3, 0.08, 0.02, 0.15};
  known.image_s = 0.12;
  known.poses = 500;
  double left = 0.0;
  for (const std::size_t pose : todo)
    left += motion_of(pose, {0.3, 0.08, 0.02, 0.15}) + 2 * known.image_s;
  EXPECT_NEAR(Pace(plan, rig, todo, known).left_s(), left, 1e-6 * left);
}

TEST_F(PaceTest, RemembersOverheadsPerRigAndForgetsNonsense) {
  const TemporaryFolder folder;
  const char* before = std::getenv("XDG_STATE_HOME");
  const std::string saved = before == nullptr ? "" : before;
  ::setenv("XDG_STATE_HOME", folder.path().c_str(), 1);
  EXPECT_FALSE(known_overheads("lab"));
  Overheads learned;
  learned.leg_s[1] = 0.08;
  learned.image_s = 0.12;
  learned.poses = 50;
  remember_overheads("lab", learned);
  const auto known = known_overheads("lab");
  ASSERT_TRUE(known);
  EXPECT_EQ(known->leg_s, learned.leg_s);
  EXPECT_EQ(known->image_s, 0.12);
  EXPECT_EQ(known->poses, 50u);
  EXPECT_FALSE(known_overheads("another"));
  for (const char* text :
       {"", "{}", "[1]", R"({"leg_s": {"yaw": 1e9}, "image_s": 0.1, "poses": 5})",
        R"({"leg_s": {}, "image_s": -1, "poses": 5})"}) {
    spill(folder / "turntable/lab-overheads.json", text);
    EXPECT_FALSE(known_overheads("lab")) << text;
  }
  if (before != nullptr)
    ::setenv("XDG_STATE_HOME", saved.c_str(), 1);
  else
    ::unsetenv("XDG_STATE_HOME");
}

TEST_F(PaceTest, KeepsWhatARehearsalTeachesApart) {
  const std::string simulated = pace_key(rig, 1.0);
  EXPECT_EQ(simulated, rig.name);
  LineConfig& line = rig.controllers.front().line;
  line.kind = LineConfig::Kind::kSerial;
  line.serial_port = "/dev/ttyUSB7";
  const std::string real = pace_key(rig, 1.0);
  EXPECT_NE(real, simulated);
  EXPECT_NE(pace_key(rig, 10.0), real);
  line.baud = 9600;
  EXPECT_NE(pace_key(rig, 1.0), real);
  line.baud = 0;
  line.serial_port = "/dev/ttyUSB8";  // an adapter that was plugged in anew
  EXPECT_EQ(pace_key(rig, 1.0), real);
  line.kind = LineConfig::Kind::kTcp;
  EXPECT_NE(pace_key(rig, 1.0), real);
}

}  // namespace
}  // namespace turntable
