#include "src/campaign/inspection.h"

#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "src/campaign/planning.h"
#include "src/campaign/runner.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "tests/support/fake_rig.h"
#include "tests/support/simulated_view.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

class InspectionTest : public ::testing::Test {
 protected:
  InspectionTest() : rig(shipped_rig("simulated")), view(rig) {}

  PlannedPose pose_at(double stage, double yaw, double roll, double pitch,
                      Payload payload = Payload::kLedTarget) {
    PlannedPose pose;
    pose.stage_mm = stage;
    pose.yaw_deg = yaw;
    pose.roll_deg = roll;
    pose.pitch_deg = pitch;
    pose.payload = payload;
    view.stand(stage, yaw, roll, pitch);
    return pose;
  }

  RigFile rig;
  SimulatedView view;
};

/// Mean over squares of `size` pixels: out of focus, with a standard deviation of size / sqrt(12).
Image defocused(const Image& image, int size) {
  Image out = image;
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) {
      int sum = 0;
      for (int j = 0; j < size; ++j)
        for (int i = 0; i < size; ++i)
          sum += ImageView(image).row(
              std::clamp(v + j - size / 2, 0,
                         image.height - 1))[std::clamp(u + i - size / 2, 0, image.width - 1)];
      out.row(v)[u] = static_cast<std::uint8_t>(sum / (size * size));
    }
  return out;
}

void cover(Image& image, const Vector2d& at) {
  for (int v = static_cast<int>(at.y()) - 12; v <= static_cast<int>(at.y()) + 12; ++v)
    for (int u = static_cast<int>(at.x()) - 12; u <= static_cast<int>(at.x()) + 12; ++u)
      image.row(v)[u] = 12;
}

TEST_F(InspectionTest, HasNothingToSayAboutGoodImages) {
  for (const auto& [stage, yaw, roll, pitch] : {std::array{0.0, 0.0, 0.0, 0.0},
                                                {150.0, 45.0, 0.0, -30.0},
                                                {120.0, -80.0, 25.0, 20.0},
                                                {180.0, 10.0, -20.0, 30.0}}) {
    const PlannedPose pose = pose_at(stage, yaw, roll, pitch);
    const Inspection seen = inspect(view.look(pose.payload), pose, rig);
    EXPECT_EQ(seen.complaint, "");
    EXPECT_TRUE(seen.target_seen);
    EXPECT_TRUE(seen.worth_regions);
    EXPECT_EQ(seen.spots->size(), 4u);
  }
  for (const double stage : {0.0, 130.0, 180.0}) {
    const PlannedPose pose = pose_at(stage, 0, 0, 0, Payload::kCirclePattern);
    const Inspection seen = inspect(view.look(pose.payload), pose, rig);
    EXPECT_EQ(seen.complaint, "");
    EXPECT_TRUE(seen.target_seen);
    EXPECT_FALSE(seen.spots);
  }
}

TEST_F(InspectionTest, MissesAnLedThatIsCovered) {
  const PlannedPose pose = pose_at(150, 10, 0, 0);
  Image image = view.look(pose.payload);
  cover(image, view.led_pixels()[2]);
  const Inspection seen = inspect(image, pose, rig);
  EXPECT_FALSE(seen.target_seen);
  EXPECT_THAT(seen.complaint, HasSubstr("3 spots, allowed: 4"));
}

TEST_F(InspectionTest, SeesThatAnLedIsClipped) {
  rig.simulation->image.led_peak_grey = 400;
  SimulatedView bright(rig);
  const PlannedPose pose = pose_at(150, 10, 0, 0);
  bright.stand(150, 10, 0, 0);
  EXPECT_THAT(inspect(bright.look(pose.payload), pose, rig).complaint, HasSubstr("clipped"));
}

TEST_F(InspectionTest, SeesThatTheCameraIsOutOfFocus) {
  const PlannedPose pose = pose_at(150, 10, 0, 0);
  const Image image = view.look(pose.payload);
  EXPECT_EQ(inspect(defocused(image, 5), pose, rig).complaint, "");
  EXPECT_THAT(inspect(defocused(image, 13), pose, rig).complaint, HasSubstr("blurred"));
  const PlannedPose plane = pose_at(150, 0, 0, 0, Payload::kCirclePattern);
  const Image pattern = view.look(plane.payload);
  EXPECT_EQ(inspect(defocused(pattern, 5), plane, rig).complaint, "");
  EXPECT_THAT(inspect(defocused(pattern, 13), plane, rig).complaint, HasSubstr("blurred"));
}

TEST_F(InspectionTest, SeesThatTheTargetStandsElsewhere) {
  const PlannedPose pose = pose_at(150, 10, 0, 0);
  view.stand(150, 55, 0, 0);
  EXPECT_THAT(inspect(view.look(pose.payload), pose, rig).complaint,
              HasSubstr("not where the nominal camera would see them"));
}

TEST_F(InspectionTest, SeesThatThePatternIsNotThereOrThatItStillIs) {
  const PlannedPose plane = pose_at(150, 0, 0, 0, Payload::kCirclePattern);
  const Inspection none = inspect(view.look(Payload::kLedTarget), plane, rig);
  EXPECT_THAT(none.complaint, HasSubstr("pattern"));
  EXPECT_FALSE(none.target_seen) << "so that a blurred pattern is not given up for it";
  const PlannedPose pose = pose_at(150, 0, 0, 0);
  EXPECT_NE(inspect(view.look(Payload::kCirclePattern), pose, rig).complaint, "");
  EXPECT_THAT(inspect(Image({1024, 1024}, 0), pose, rig).complaint, HasSubstr("0 spots"));
}

/// Two poses at zero angles, so that one image fits both.
class RetakeTest : public InspectionTest {
 protected:
  RetakeTest() : good(pose_image()), fake(good), bad(Image(good.size(), 12)) {
    rig.telemetry = {};
    Campaign campaign;
    campaign.name = campaign.title = "retakes";
    campaign.scenarios = {parse_scenario(
        R"({"format": "turntable-scenario/1", "name": "m", "title": "M", "kind": "attitude",
            "stage_mm": 150, "ranges": [{"axis": "yaw", "values_deg": [0]}]})",
        "m.json")};
    plan = plan_campaign(campaign, rig);
    folder = RunFolder::create(temporary / "run", plan);
  }
  Image pose_image() {
    view.stand(150, 0, 0, 0);
    return view.look(Payload::kLedTarget);
  }
  AcquireSummary run() { return acquire(fake.rig, rig, plan, *folder, {{"version", "test"}}); }

  Image good;
  FakeRig fake;
  Image bad;
  TemporaryFolder temporary;
  Plan plan;
  std::optional<RunFolder> folder;
};

TEST_F(RetakeTest, TakesABadImageAgainInPlace) {
  fake.camera.on_trigger = [&] { fake.camera.show(fake.camera.triggers == 2 ? bad : good); };
  const AcquireSummary summary = run();
  EXPECT_EQ(fake.camera.triggers, 3);
  EXPECT_EQ(summary.retakes, 1u);
  EXPECT_EQ(summary.failed, 0u);
  EXPECT_EQ(summary.doubtful, 0u);
  EXPECT_EQ(fake.yaw.starts.size(), 1u) << "in place";
  const RunRecord record = read_run(*folder);
  EXPECT_EQ(record.poses[1].images[0].retakes, 1);
  EXPECT_EQ(record.poses[1].images[0].complaint, "");
  EXPECT_EQ(record.poses[1].images[0].spots->size(), 4u);
  EXPECT_EQ(record.poses[1].images[0].frame_id, 3u);
}

TEST_F(RetakeTest, KeepsTheLastOneWithItsComplaintAfterSoManyRetakes) {
  fake.camera.show(bad);
  rig.inspection.retakes = 3;
  const AcquireSummary summary = run();
  EXPECT_EQ(fake.camera.triggers, 8);
  EXPECT_EQ(summary.failed, 2u);
  const RunRecord record = read_run(*folder);
  EXPECT_EQ(record.poses[0].images[0].retakes, 3);
  EXPECT_THAT(record.poses[0].images[0].complaint, HasSubstr("0 spots"));
}

TEST_F(RetakeTest, KeepsADoubtfulImageRatherThanOneWithoutATarget) {
  const Image soft = defocused(good, 13);
  fake.camera.on_trigger = [&] { fake.camera.show(fake.camera.triggers == 1 ? soft : bad); };
  rig.inspection.retakes = 1;
  const AcquireSummary summary = run();
  EXPECT_EQ(summary.doubtful, 1u);
  EXPECT_EQ(summary.failed, 1u);
  EXPECT_THAT(read_run(*folder).poses[0].images[0].complaint, HasSubstr("blurred"));
}

TEST_F(RetakeTest, TriesTheCameraOutBeforeAnythingMoves) {
  const DeviceCheck check = check_devices(fake.rig, rig, plan);
  EXPECT_EQ(fake.camera.try_outs, 1);
  EXPECT_EQ(fake.camera.triggers, 0);
  EXPECT_TRUE(check.frame_s);
  EXPECT_GT(check.brightest, 150);
  EXPECT_FALSE(fake.yaw.homed());
  fake.camera.show(Image({100, 100}, 9));
  EXPECT_THROW(check_devices(fake.rig, rig, plan), DeviceError);
}

TEST_F(RetakeTest, WaitsWhileAChannelIsOutsideItsBand) {
  ChannelConfig room;
  room.name = "room";
  room.unit = "degC";
  room.hold = {18.0, 24.0, 19.0, 23.0, 60.0, 0.0};
  rig.telemetry.channels = {room};
  rig.telemetry.every_s = 10.0;
  // Warm from 5 s to 500 s of the rig's time, just below the limit until 600 s.
  fake.rig.channels = {{"room", [this] {
                          const double t = seconds(fake.clock.now());
                          return t < 5 ? 21.0 : t < 500 ? 25.0 : t < 600 ? 23.5 : 21.0;
                        }}};
  const AcquireSummary summary = run();
  EXPECT_GE(summary.held_s, 600.0 + 60.0 - 30.0);
  EXPECT_LE(summary.held_s, 600.0 + 60.0 + 30.0);
  std::vector<std::string> waits;
  int readings = 0;
  read_journal(folder->journal(), [&](const JournalEntry& entry) {
    if (entry.name != "event") return;
    const Json& data = entry.doc.at("data");
    if (data.contains("interruption")) waits.push_back(data.at("interruption"));
    readings += data.contains("room");
  });
  EXPECT_THAT(waits, ::testing::ElementsAre("suspend", "resume"));
  EXPECT_GE(readings, 60);
}

TEST_F(RetakeTest, ReadsItsChannelsAgainAfterAPauseBeforeAPoseIsTaken) {
  ChannelConfig room;
  room.name = "room";
  room.unit = "degC";
  room.hold = {18.0, 24.0, 18.0, 24.0, 0.0, 0.0};
  rig.telemetry.channels = {room};
  rig.telemetry.every_s = 10.0;
  double degc = 21.0;
  fake.rig.channels = {{"room", [&] { return degc; }}};
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 1) request_pause(true);
    EXPECT_LT(degc, 24.0) << "no pose is taken outside the band";
  };
  int pauses = 0;
  acquire(fake.rig, rig, plan, *folder, {{"version", "test"}}, {}, [&](const Progress& p) {
    if (p.phase == "suspended") degc = 21.0;
    if (p.phase != "paused" || ++pauses != 3) return;
    fake.clock.sleep_for(std::chrono::hours{1});
    degc = 30.0;
    request_pause(false);
  });
  EXPECT_EQ(pauses, 3);
  EXPECT_EQ(degc, 21.0) << "it was suspended";
}

TEST_F(RetakeTest, GivesUpWaitingIfItIsToldTo) {
  ChannelConfig room;
  room.name = "room";
  room.unit = "degC";
  room.hold = {18.0, 24.0, 18.0, 24.0, 0.0, 300.0};
  rig.telemetry.channels = {room};
  fake.rig.channels = {{"room", [] { return 30.0; }}};
  EXPECT_THROW(run(), DeviceError);
  EXPECT_THAT(read_run(*folder).reason, HasSubstr("not back after"));
  EXPECT_GE(fake.stops(), 4);
}

}  // namespace
}  // namespace turntable
