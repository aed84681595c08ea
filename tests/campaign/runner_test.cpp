#include "src/campaign/runner.h"

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "src/campaign/planning.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/journal.h"
#include "src/record/run_journal.h"
#include "src/record/verify.h"
#include "src/vision/spots.h"
#include "tests/support/draws.h"
#include "tests/support/fake_rig.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_images.h"

namespace turntable {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr ImageSize kSize{320, 240};
constexpr std::size_t kNoPattern = 2;  ///< the planes, whose images show LEDs too

Image four_spots() {
  return blobs(kSize,
               {{60.3, 50.7, 1.5, 190},
                {250.1, 61.4, 1.6, 180},
                {71.8, 190.2, 1.4, 200},
                {240.5, 180.9, 1.5, 150}},
               12, 1.5, draws_of_this_test());
}

constexpr const char* kCalibration =
    R"({"format": "turntable-scenario/1", "name": "c", "title": "C", "kind": "calibration",
        "images_per_plane": 2,
        "planes": [{"stage_mm": 130, "use": "fit"}, {"stage_mm": 180, "use": "fit"}]})";
constexpr const char* kMotion =
    R"({"format": "turntable-scenario/1", "name": "m", "title": "M", "kind": "attitude",
        "stage_mm": 120, "dwell_ms": 100,
        "ranges": [{"axis": "pitch", "values_deg": [-10, 10]},
                   {"axis": "yaw", "values_deg": [1, 2, 3]}]})";

class RunnerTest : public ::testing::Test {
 protected:
  RunnerTest() : fake(four_spots()) {
    rig_file = load_rig_file(std::filesystem::path(TURNTABLE_SOURCE_DIR) /
                             "scenarios/rigs/simulated.json");
    rig_file.camera.image_size = kSize;
    rig_file.telemetry = {};
    rig_file.inspection.retakes = 0;  // these images show no rig
    campaign.name = campaign.title = "test";
    campaign.scenarios = {parse_scenario(kCalibration, "c.json"),
                          parse_scenario(kMotion, "m.json")};
    plan = plan_campaign(campaign, rig_file);
    set_interrupt_level(0);
  }
  ~RunnerTest() override { set_interrupt_level(0); }

  AcquireSummary run(AcquireOptions options = {}) {
    folder = RunFolder::create(temporary / "run", plan);
    return acquire(fake.rig, rig_file, plan, *folder, {{"version", "test"}}, options);
  }
  /// Runs, expects E, and that the journal says why and every axis was stopped.
  template <class E>
  RunRecord run_expecting(const std::string& status, const std::string& reason,
                          AcquireOptions options = {}) {
    EXPECT_THROW(run(options), E);
    EXPECT_GE(fake.stops(), 4);
    EXPECT_FALSE(fake.moving());
    set_interrupt_level(0);
    RunRecord record = read_run(*folder);
    EXPECT_EQ(record.exit_status, status);
    EXPECT_THAT(record.reason, HasSubstr(reason));
    return record;
  }

  TemporaryFolder temporary;
  FakeRig fake;
  RigFile rig_file;
  Campaign campaign;
  Plan plan;
  std::optional<RunFolder> folder;
};

TEST_F(RunnerTest, KeepsTheLinesAliveWhileAPoseDwells) {
  std::string slow = kMotion;
  slow.replace(slow.find("\"dwell_ms\": 100"), 15, "\"dwell_ms\": 30000");
  campaign.scenarios = {parse_scenario(slow, "m.json")};
  plan = plan_campaign(campaign, rig_file);
  std::vector<Time> kept;
  fake.rig.keep_alive = [&] { kept.push_back(fake.clock.now()); };
  EXPECT_EQ(run().poses, 7u);  // with the reference pose
  EXPECT_GE(kept.size(), 6u * 29u);  // a server that closes after 2 s would never see the line idle
}

TEST_F(RunnerTest, TakesEveryPoseInThePlansOrder) {
  const AcquireSummary summary = run();
  EXPECT_EQ(summary.poses, 9u);
  EXPECT_EQ(summary.failed, kNoPattern);
  EXPECT_EQ(summary.trigger_retries, 0u);
  EXPECT_NEAR(summary.homing_s, 8.0, 1e-6);
  EXPECT_GT(summary.motion_s, 1.0);
  EXPECT_GE(summary.settle_s, 0.7);
  EXPECT_NEAR(summary.trigger_s, 11 * 0.02, 1e-6);
  EXPECT_GT(summary.archive_s, 0.0);

  const RunRecord record = read_run(*folder);
  EXPECT_TRUE(record.complete());
  EXPECT_EQ(record.exit_status, "success");
  const Json start = Json::parse(record.start_document);
  EXPECT_EQ(start.at("provenance").at("version"), "test");
  EXPECT_EQ(start.at("num_poses"), 9);
  std::uint64_t frame = 0;
  for (const TakenPose& pose : record.poses) {
    EXPECT_EQ(pose.images.size(), static_cast<std::size_t>(pose.planned.images));
    for (const AxisId id : kAllAxes) EXPECT_EQ(pose.axis(id).position, pose.planned.target(id));
    for (const TakenImage& image : pose.images) {
      EXPECT_EQ(image.frame_id, ++frame);
      EXPECT_EQ(load_image(*folder, image).size(), kSize);
      EXPECT_EQ(image.spots.has_value(), pose.planned.payload == Payload::kLedTarget);
    }
  }
  EXPECT_EQ(fake.stops(), 0);
}

TEST_F(RunnerTest, HomesOnceAndReturnsToZeroForEveryChangeOfThePayload) {
  run();
  EXPECT_THAT(fake.mounts, ElementsAre(Payload::kCirclePattern, Payload::kLedTarget));
  EXPECT_THAT(fake.stage.starts, ElementsAre(0, 130, 180, 0, 120));
}

TEST_F(RunnerTest, MovesOnlyAxesWhoseTargetChanges) {
  run();
  EXPECT_THAT(fake.pitch.starts, ElementsAre(0, -10, 10));
  EXPECT_THAT(fake.yaw.starts, ElementsAre(0, 1, 2, 3, 1, 2, 3));
  EXPECT_THAT(fake.roll.starts, ElementsAre(0));
}

TEST_F(RunnerTest, MovesAllAxesOfAPoseAtOnce) {
  bool together = false;
  fake.yaw.on_advance = [&] { together = together || (fake.yaw.moving() && fake.pitch.moving()); };
  run();
  EXPECT_TRUE(together);
}

TEST_F(RunnerTest, WritesBaselineReadingsAtStartAndEnd) {
  run();
  std::vector<std::string> descriptors;
  std::vector<double> stage;
  read_journal(folder->journal(), [&](const JournalEntry& entry) {
    if (entry.name == "descriptor") descriptors.push_back(entry.doc.at("name"));
    if (entry.name != "event") return;
    const Json& data = entry.doc.at("data");
    if (data.contains("stage_mm") && !data.contains("pose_id")) stage.push_back(data["stage_mm"]);
  });
  EXPECT_THAT(descriptors, ElementsAre("baseline", "primary", "time"));
  EXPECT_THAT(stage, ElementsAre(0, 120));
}

TEST_F(RunnerTest, FindsTheSameSpotsInArchivedRegionsAsInTheWholeImage) {
  run();
  const SpotSearch whole = find_spots(four_spots());
  ASSERT_EQ(whole.spots.size(), 4u);
  const RunRecord record = read_run(*folder);
  const TakenImage& image = record.poses.back().images.front();
  EXPECT_LT(std::filesystem::file_size(folder->root() / image.file), 12000u);
  const SpotSearch masked = find_spots(load_image(*folder, image));
  EXPECT_EQ(masked.threshold, whole.threshold);
  ASSERT_EQ(masked.spots.size(), 4u);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(masked.spots[i].centre_px, whole.spots[i].centre_px);  // to the last bit
    EXPECT_EQ(masked.spots[i].sigma_px, whole.spots[i].sigma_px);
    EXPECT_EQ(masked.spots[i].area_px, whole.spots[i].area_px);
    EXPECT_EQ(image.spots->at(i).u_px, whole.spots[i].centre_px.x());
    EXPECT_EQ(image.spots->at(i).v_px, whole.spots[i].centre_px.y());
  }
}

TEST_F(RunnerTest, ArchivesPatternsWholeAlsoInRegionsMode) {
  run();
  const RunRecord record = read_run(*folder);
  EXPECT_EQ(load_image(*folder, record.poses[0].images[0]).pixels, four_spots().pixels);
  EXPECT_NE(load_image(*folder, record.poses[3].images[0]).pixels, four_spots().pixels);
}

TEST_F(RunnerTest, ArchivesFullOrNothingIfAskedTo) {
  run({.archive = ArchiveMode::kFull});
  EXPECT_EQ(load_image(*folder, read_run(*folder).poses.back().images[0]).pixels,
            four_spots().pixels);
  std::filesystem::remove_all(temporary / "run");
  run({.archive = ArchiveMode::kNone});
  EXPECT_TRUE(std::filesystem::is_empty(folder->images()));
  EXPECT_EQ(read_run(*folder).poses.back().images[0].spots->size(), 4u);
}

TEST_F(RunnerTest, KeepsImagesWithoutTheTargetWholeAndCountsThemAsFailed) {
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 11) fake.camera.show(Image(kSize, 30));
  };
  const AcquireSummary summary = run();
  EXPECT_EQ(summary.failed, kNoPattern + 1);
  const RunRecord record = read_run(*folder);
  EXPECT_TRUE(record.poses.back().images[0].spots->empty());
  EXPECT_EQ(load_image(*folder, record.poses.back().images[0]).pixels, Image(kSize, 30).pixels);
}

TEST_F(RunnerTest, RecordsAMissedTargetAndTriesAgainAtTheNextPose) {
  fake.pitch.miss = 0.02;
  const AcquireSummary summary = run();
  EXPECT_EQ(summary.failed, 9u);
  const RunRecord record = read_run(*folder);
  EXPECT_TRUE(record.poses[4].pitch.missed);
  EXPECT_EQ(record.poses[4].pitch.position, -10 + 0.02);
  EXPECT_FALSE(record.poses[4].yaw.missed);
  EXPECT_THAT(fake.pitch.starts, ElementsAre(0, 0, 0, 0, 0, -10, -10, -10, 10, 10, 10));
}

TEST_F(RunnerTest, RepeatsATriggerThatStayedUnanswered) {
  fake.camera.timeouts = 2;
  EXPECT_EQ(run().trigger_retries, 2u);
}

TEST_F(RunnerTest, EndsAfterABoundedNumberOfTriggersAndKeepsWhatItHas) {
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 7) fake.camera.timeouts = 100;
  };
  const RunRecord record = run_expecting<TimeoutError>("fail", "after 3 triggers");
  EXPECT_EQ(record.poses.size(), 4u);
  EXPECT_EQ(fake.camera.triggers, 9);
}

TEST_F(RunnerTest, RefusesAnImageOfAnotherSizeThanTheRigFileSays) {
  fake.camera.on_trigger = [&] { fake.camera.show(Image({100, 100}, 9)); };
  run_expecting<DeviceError>("fail", "allowed: 320 x 240 px");
}

TEST_F(RunnerTest, RefusesACameraOfAnotherSizeBeforeAnythingMoves) {
  fake.camera.show(Image({100, 100}, 9));
  EXPECT_THROW(run(), DeviceError);
  EXPECT_FALSE(fake.stage.homed());
}

TEST_F(RunnerTest, TellsTheCameraWhatEachExposureIsOf) {
  fake.camera.exposing = false;
  std::size_t checked = 0;
  fake.camera.on_check = [&](std::span<const Exposure> all) { checked = all.size(); };
  fake.camera.timeouts = 1;
  run();
  EXPECT_EQ(checked, 11u);
  ASSERT_EQ(fake.camera.announced.size(), 12u);  // the repeated trigger too
  std::string said;
  for (const Exposure& e : fake.camera.announced)
    said += fmt::format("{}/{}/{}/{}/{}:{},{},{},{} ", e.scenario, e.repeat, e.point, e.index,
                        e.image, e.stage_mm, e.yaw_deg, e.roll_deg, e.pitch_deg);
  EXPECT_THAT(said, HasSubstr("c/1/0/0/1:130,0,0,0 c/1/0/0/1:130,0,0,0 c/1/0/0/2:130,0,0,0 "
                              "c/1/1/1/1:180,0,0,0 c/1/1/1/2:180,0,0,0 m/1/0/2/1:120,0,0,0 "
                              "m/1/1/3/1:120,1,0,-10 "));
}

TEST_F(RunnerTest, RefusesAPlanThatTheCameraCannotAnswerBeforeAnythingMoves) {
  fake.camera.exposing = false;
  fake.camera.on_check = [](std::span<const Exposure>) {
    throw ConfigError("images", "", "3 are missing");
  };
  EXPECT_THROW(run(), ConfigError);
  EXPECT_FALSE(fake.stage.homed());
  EXPECT_EQ(fake.camera.triggers, 0);
}

TEST_F(RunnerTest, FirstInterruptEndsBetweenPoses) {
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 6) set_interrupt_level(1);
  };
  const RunRecord record = run_expecting<Interrupted>("abort", "after the last finished pose");
  EXPECT_EQ(record.poses.size(), 4u);  // the pose under way was finished
}

TEST_F(RunnerTest, SecondInterruptStopsTheAxesInTheMiddleOfAMoveAndKeepsWhatIsDone) {
  int advances = 0;
  fake.yaw.on_advance = [&] {
    if (fake.camera.triggers == 6 && ++advances == 3) set_interrupt_level(2);
  };
  const RunRecord record = run_expecting<Interrupted>("abort", "being stopped");
  EXPECT_EQ(record.poses.size(), 4u);
  EXPECT_EQ(fake.camera.triggers, 6);
}

TEST_F(RunnerTest, InterruptsWhileHomingStopTheAxesToo) {
  set_interrupt_level(1);
  EXPECT_EQ(run_expecting<Interrupted>("abort", "interrupted").poses.size(), 0u);
  std::filesystem::remove_all(temporary / "run");
  set_interrupt_level(2);
  EXPECT_EQ(run_expecting<Interrupted>("abort", "interrupted").poses.size(), 0u);
  EXPECT_TRUE(fake.stage.starts.empty());
}

TEST_F(RunnerTest, AFailingAxisStopsAllAxesAndTheJournalSaysWhy) {
  int advances = 0;
  fake.pitch.on_advance = [&] {
    if (++advances == 20) throw DeviceError("pitch: limit switch");
  };
  run_expecting<DeviceError>("fail", "pitch: limit switch");
}

TEST_F(RunnerTest, AFailingWorkerStopsTheRun) {
  // Images do not fit any more while the journal still does.
  fake.camera.show(blobs({320, 240}, {{60, 50, 2, 200}}, 120, 60, draws_of_this_test(1)));
  FileSizeLimit limit(30000);
  const RunRecord record = run_expecting<RecordError>("fail", "Make room");
  EXPECT_EQ(record.poses.size(), 0u);
  EXPECT_TRUE(std::filesystem::is_empty(folder->images()));
}

TEST_F(RunnerTest, AVanishedImageFolderStopsTheRun) {
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 5)
      std::filesystem::rename(folder->images(), temporary / "elsewhere");
  };
  const RunRecord record = run_expecting<RecordError>("fail", "No such file");
  // Nothing stands in the journal behind the pose that could not be archived.
  ASSERT_LT(record.poses.size(), 3u);
  for (std::size_t i = 0; i < record.poses.size(); ++i) EXPECT_EQ(record.poses[i].planned.index, i);
}

TEST_F(RunnerTest, RefusesTargetsTheAxesDoNotAllowBeforeAnythingMoves) {
  plan.poses.back().pitch_deg = 60;
  EXPECT_THROW(run(), LimitError);
  EXPECT_TRUE(fake.stage.starts.empty());
  EXPECT_FALSE(fake.stage.homed());
}

TEST_F(RunnerTest, ReportsProgressUpToTheEnd) {
  folder = RunFolder::create(temporary / "run", plan);
  std::vector<Progress> seen;
  acquire(fake.rig, rig_file, plan, *folder, Json::object(), {},
          [&](const Progress& p) { seen.push_back(p); });
  ASSERT_FALSE(seen.empty());
  EXPECT_EQ(seen.front().phase, "homing");
  EXPECT_GT(seen.front().eta_s, 0.0);
  EXPECT_EQ(seen.back().phase, "finishing");
  EXPECT_EQ(seen.back().done, 9u);
  EXPECT_NEAR(seen.back().eta_s, 0.0, 1e-3);
  for (std::size_t i = 1; i < seen.size(); ++i) EXPECT_GE(seen[i].done, seen[i - 1].done);
}

TEST_F(RunnerTest, GivesTheSamePosesTwice) {
  const auto taken = [this](const char* name) {
    FakeRig fresh(four_spots());
    const RunFolder own = RunFolder::create(temporary / name, plan);
    acquire(fresh.rig, rig_file, plan, own, Json::object());
    std::string all;
    for (const TakenPose& p : read_run(own).poses)
      all += fmt::format("{} {} {} {} {}\n", p.planned.id, p.rig_time_s, p.yaw.position,
                         p.images[0].sha256, p.images[0].exposed_s);
    return all;
  };
  EXPECT_EQ(taken("once"), taken("twice"));
}

// A run that goes on.

TEST_F(RunnerTest, GoesOnWhereItWasInterruptedAndTakesAFewPosesAgainBeside) {
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 8) set_interrupt_level(1);
  };
  const RunRecord before = run_expecting<Interrupted>("abort", "after the last finished pose");
  ASSERT_EQ(before.poses.size(), 6u);
  fake.camera.on_trigger = nullptr;
  AcquireOptions options;
  options.before = &before;
  options.overlap = 2;
  const AcquireSummary summary =
      acquire(fake.rig, rig_file, plan, *folder, {{"version", "test"}}, options);
  EXPECT_EQ(summary.poses, 3u);  // overlap apart

  const RunRecord after = read_run(*folder);
  EXPECT_TRUE(after.complete());
  EXPECT_EQ(after.exit_status, "success");
  ASSERT_EQ(after.sessions.size(), 2u);
  EXPECT_EQ(after.sessions[0].exit_status, "abort");
  EXPECT_EQ(Json::parse(after.sessions[1].start_document).at("resumes"), after.sessions[0].uid);
  ASSERT_EQ(after.overlaps.size(), 2u);
  EXPECT_EQ(after.overlaps[0].planned.index, 4u);
  EXPECT_EQ(after.overlaps[1].planned.index, 5u);
  // What was there is as it was, files included.
  for (std::size_t i = 0; i < before.poses.size(); ++i) {
    EXPECT_EQ(after.poses[i].images[0].file, before.poses[i].images[0].file);
    EXPECT_EQ(after.poses[i].images[0].frame_id, before.poses[i].images[0].frame_id);
    EXPECT_EQ(load_image(*folder, after.poses[i].images[0]).size(), kSize);
  }
  EXPECT_NE(after.overlaps[0].images[0].file, after.poses[4].images[0].file);
}

TEST_F(RunnerTest, TakesNoOverlapOfAnotherPayload) {
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 4) set_interrupt_level(1);  // after the two planes
  };
  const RunRecord before = run_expecting<Interrupted>("abort", "interrupted");
  ASSERT_EQ(before.poses.size(), 2u);
  AcquireOptions options;
  options.before = &before;
  EXPECT_TRUE(schedule_of(plan, options).overlap.empty());
  EXPECT_EQ(schedule_of(plan, options).missing.size(), 7u);
}

TEST_F(RunnerTest, TakesPosesAgainThatAreNotAmongThoseTaken) {
  run();
  RunRecord before = read_run(*folder);
  const std::string lost = before.poses[3].images[0].file;
  before.line_of_pose[3] = 0;
  AcquireOptions options;
  options.before = &before;
  options.overlap = 0;
  EXPECT_EQ(acquire(fake.rig, rig_file, plan, *folder, {}, options).poses, 1u);
  const RunRecord after = read_run(*folder);
  EXPECT_TRUE(after.complete());
  EXPECT_NE(after.poses[3].images[0].file, lost);
  EXPECT_TRUE(std::filesystem::exists(folder->root() / lost)) << "history is never written over";
}

TEST_F(RunnerTest, ASessionThatWasKilledGetsTheStopDocumentItCouldNotWrite) {
  run();
  std::string lines = slurp(folder->journal());
  lines.resize(lines.rfind("{\"name\":\"stop\""));
  lines += "{\"name\":\"sto";  // torn
  spill(folder->journal(), lines);
  RunRecord before = read_run(*folder);
  EXPECT_TRUE(before.torn);
  EXPECT_EQ(before.exit_status, "");
  before.line_of_pose.back() = 0;
  AcquireOptions options;
  options.before = &before;
  acquire(fake.rig, rig_file, plan, *folder, {}, options);
  const RunRecord after = read_run(*folder);
  EXPECT_FALSE(after.torn);
  ASSERT_EQ(after.sessions.size(), 2u);
  EXPECT_EQ(after.sessions[0].exit_status, "fail");
  EXPECT_THAT(after.sessions[0].reason, HasSubstr("killed"));
  EXPECT_TRUE(verify_run(*folder).sound());
}

TEST_F(RunnerTest, AJournalCutOffAtAnyByteLosesNothingThatWasAcknowledged) {
  run();
  const std::string whole = slurp(folder->journal());
  std::size_t step = 0;
  for (std::size_t length = 0; length <= whole.size(); length += 97 + step++ % 7) {
    spill(folder->journal(), whole.substr(0, length));
    const std::string kept = whole.substr(0, length);
    // Acknowledged: whole lines.
    std::size_t poses = 0, from = 0;
    for (std::size_t end; (end = kept.find('\n', from)) != kept.npos; from = end + 1)
      poses += kept.substr(from, end - from).find("\"pose_id\":") != kept.npos &&
               kept.substr(from, end - from).starts_with("{\"name\":\"event\"");
    const RunRecord before = read_run(*folder);
    ASSERT_EQ(before.poses.size(), poses) << length;
    {
      RunJournal journal(*folder, {{"version", "test"}}, before);
      journal.stop("success", "");
    }
    const RunRecord after = read_run(*folder);
    EXPECT_EQ(after.poses.size(), poses) << length;
    EXPECT_FALSE(after.torn) << length;
    EXPECT_EQ(after.exit_status, "success") << length;
  }
}

TEST_F(RunnerTest, PausesBetweenPosesUntilItIsToldToGoOnAndTheJournalSaysSo) {
  std::thread other;
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers != 5) return;
    request_pause(true);
    other = std::thread([] {
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
      request_pause(false);
    });
  };
  EXPECT_EQ(run().poses, 9u);
  other.join();
  std::vector<std::string> interruptions;
  read_journal(folder->journal(), [&](const JournalEntry& entry) {
    if (entry.name == "event" && entry.doc.at("data").contains("interruption"))
      interruptions.push_back(entry.doc.at("data").at("interruption"));
  });
  EXPECT_THAT(interruptions, ElementsAre("pause", "resume"));
  EXPECT_TRUE(verify_run(*folder).sound());
}

TEST_F(RunnerTest, AnInterruptEndsAPauseToo) {
  fake.camera.on_trigger = [&] {
    if (fake.camera.triggers == 5) request_pause(true);
  };
  std::thread other([] {
    while (!pause_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    set_interrupt_level(1);
  });
  EXPECT_EQ(run_expecting<Interrupted>("abort", "interrupted").poses.size(), 3u);
  other.join();
  request_pause(false);
}

TEST_F(RunnerTest, WhatWasAlteredOrIsMissingIsNamedAndNothingElse) {
  run();
  EXPECT_TRUE(verify_run(*folder).sound());
  const RunRecord record = read_run(*folder);
  const auto image = [&](std::size_t pose) {
    return folder->root() / record.poses[pose].images[0].file;
  };
  std::filesystem::remove(image(2));
  std::string bytes = slurp(image(5));
  bytes[bytes.size() / 2] ^= 1;
  spill(image(5), bytes);
  spill(folder->images() / "left-over.png", "x");
  const RunFindings findings = verify_run(*folder);
  ASSERT_EQ(findings.damage.size(), 2u);
  EXPECT_THAT(findings.damage[0], HasSubstr(image(2).filename().string()));
  EXPECT_THAT(findings.damage[1], HasSubstr("was altered"));
  EXPECT_THAT(findings.lost_poses, ElementsAre(2, 5));
  ASSERT_EQ(findings.remarks.size(), 1u);
  EXPECT_THAT(findings.remarks[0], HasSubstr("no line of the journal"));
}

}  // namespace
}  // namespace turntable
