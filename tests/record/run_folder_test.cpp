#include "src/record/run_folder.h"

#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "src/record/atomic_file.h"
#include "src/core/errors.h"
#include "src/record/image_archive.h"
#include "src/record/run_journal.h"
#include "tests/record/small_plan.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

TakenPose taken_at(const Plan& plan, std::size_t index) {
  TakenPose taken;
  taken.planned = plan.poses[index];
  for (const AxisId id : kAllAxes)
    taken.axis(id) = {plan.poses[index].target(id) + 0.001, false, 0, true};
  taken.roll.missed = true;
  taken.roll.retries = 2;
  taken.rig_time_s = 12.5;
  taken.phases = {1.5, 0.75, 0.375, 0.1875};
  taken.images = {
      {"images/a.png", std::string(64, 'a'), 7, 12.625, {{{1.5, 2.25, 0.01, 200, 21, false}}}},
      {"", "", 8, 12.75, std::nullopt}};
  return taken;
}

TEST(RunFolder, OneThatWasKilledBeforeItsPlanIsAsGoodAsEmptyAndNoOther) {
  const TemporaryFolder temporary;
  for (const char* part : {"images", "tables", "figures"})
    std::filesystem::create_directories(temporary / "run" / part);
  write_atomically(temporary / "run/plan.json.tmp1234", "{");
  (void)RunFolder::create(temporary / "run", small_plan());
  EXPECT_FALSE(std::filesystem::exists(temporary / "run/plan.json.tmp1234"));
  EXPECT_THROW(RunFolder::require_new(temporary / "run"), ConfigError) << "it has a plan now";

  for (const char* file : {"other/images/mine.png", "other/mine.txt", "other/notes.tmp1"}) {
    const std::filesystem::path mine = temporary / file;
    std::filesystem::remove_all(temporary / "other");
    std::filesystem::create_directories(mine.parent_path());
    write_atomically(mine, "mine");
    EXPECT_THROW((void)RunFolder::create(temporary / "other", small_plan()), ConfigError) << file;
    EXPECT_TRUE(std::filesystem::exists(mine));
  }
}

TEST(RunFolder, JoinsPlanAndJournal) {
  const TemporaryFolder temporary;
  const Plan plan = small_plan();
  const RunFolder folder = RunFolder::create(temporary / "run", plan);
  {
    RunJournal journal(folder, {{"provenance", {{"version", "0.1.0"}}}});
    journal.baseline({1, 2, 3, 4});
    journal.pose(taken_at(plan, 1), "motion");
    journal.pose(taken_at(plan, 0), "motion");
    journal.stop("abort", "a person asked");
  }
  const RunRecord record = read_run(RunFolder::open(temporary / "run"));
  ASSERT_EQ(record.poses.size(), 2u);
  EXPECT_FALSE(record.complete());
  EXPECT_EQ(record.exit_status, "abort");
  EXPECT_EQ(record.reason, "a person asked");
  EXPECT_EQ(Json::parse(record.start_document).at("provenance").at("version"), "0.1.0");
  EXPECT_EQ(record.poses[0].planned.index, 0u);
  const TakenPose& pose = record.poses[1];
  EXPECT_EQ(pose.planned.id, plan.poses[1].id);
  EXPECT_EQ(pose.yaw.position, plan.poses[1].yaw_deg + 0.001);
  EXPECT_EQ(pose.stage.position, 120.001);
  EXPECT_TRUE(pose.roll.missed);
  EXPECT_TRUE(pose.missed());
  EXPECT_EQ(pose.roll.retries, 2);
  EXPECT_TRUE(pose.pitch.overshot);
  EXPECT_EQ(pose.rig_time_s, 12.5);
  ASSERT_EQ(pose.images.size(), 2u);
  EXPECT_EQ(pose.images[0].frame_id, 7u);
  EXPECT_EQ(pose.images[0].exposed_s, 12.625);
  ASSERT_TRUE(pose.images[0].spots);
  EXPECT_EQ(pose.images[0].spots->at(0).v_px, 2.25);
  EXPECT_FALSE(pose.images[1].spots);
  EXPECT_THROW(load_image(folder, pose.images[1]), ConfigError);
}

TelemetryConfig two_channels() {
  TelemetryConfig config;
  config.channels.resize(2);
  config.channels[0].name = "room";
  config.channels[0].unit = "degC";
  config.channels[1].name = "air";
  config.channels[1].unit = "hPa";
  return config;
}

TEST(RunFolder, KnowsWhereItsTimeWentAndWhatMadeItWait) {
  const TemporaryFolder temporary;
  const Plan plan = small_plan();
  const RunFolder folder = RunFolder::create(temporary / "run", plan);
  {
    RunJournal journal(folder, Json::object());
    journal.interruption("pause", "asked for");
    journal.pose(taken_at(plan, 0), "motion");
    journal.telemetry({30.0, {25.0, 1013.5}, ""}, two_channels());
    journal.interruption("suspend", "room 25 degC");
    journal.telemetry({40.0, {std::nullopt, 1013.0}, "room: no answer"}, two_channels());
    journal.telemetry({50.0, {22.0, 1012.0}, ""}, two_channels());
    journal.interruption("resume", "back");
    journal.time({{"motion_s", 7.0}, {"rig_s", 60.0}});
    journal.stop("abort", "a person asked");
  }
  {  // killed: says nothing about its time
    RunJournal journal(folder, Json::object(), read_run_state(folder));
    TakenPose again = taken_at(plan, 0);
    again.phases = {3.0, 0.5, 0.25, 0.125};
    journal.pose(again, "motion", true);
    journal.pose(taken_at(plan, 1), "motion");
    again.planned = plan.poses[1];
    journal.pose(again, "motion");
  }
  const RunRecord record = read_run(folder);
  ASSERT_EQ(record.sessions.size(), 2u);
  const RunSession& first = record.sessions[0];
  EXPECT_TRUE(first.whole_time);
  EXPECT_EQ(first.time, (std::map<std::string, double>{{"motion_s", 7.0}, {"rig_s", 60.0}}));
  ASSERT_EQ(first.interruptions.size(), 3u);
  EXPECT_EQ(first.interruptions[0].what, "pause");
  EXPECT_FALSE(first.interruptions[0].rig_time_s) << "nothing before it said any";
  EXPECT_EQ(first.interruptions[1].reason, "room 25 degC");
  EXPECT_EQ(first.interruptions[1].rig_time_s, 30.0);
  EXPECT_EQ(first.interruptions[2].rig_time_s, 50.0);
  EXPECT_EQ(first.interruptions[2].utc.size(), 24u);
  const RunSession& second = record.sessions[1];
  EXPECT_FALSE(second.whole_time);
  EXPECT_EQ(second.time, (std::map<std::string, double>{{"motion_s", 6.0 + 1.5},
                                                        {"settle_s", 1.0 + 0.75},
                                                        {"trigger_s", 0.5 + 0.375},
                                                        {"transfer_s", 0.25 + 0.1875}}))
      << "of all its poses, also one that no longer counts";
  EXPECT_TRUE(second.interruptions.empty());

  ASSERT_EQ(record.telemetry.size(), 2u);
  const SessionTelemetry& telemetry = record.telemetry[0];
  ASSERT_EQ(telemetry.channels.size(), 2u);
  EXPECT_EQ(telemetry.channels[0].name, "air");
  EXPECT_EQ(telemetry.channels[1].unit, "degC");
  ASSERT_EQ(telemetry.readings.size(), 3u);
  EXPECT_EQ(telemetry.readings[1].rig_time_s, 40.0);
  EXPECT_EQ(telemetry.readings[1].values[0], 1013.0);
  EXPECT_FALSE(telemetry.readings[1].values[1]);
  EXPECT_EQ(telemetry.readings[1].trouble, "room: no answer");
  EXPECT_TRUE(record.telemetry[1].readings.empty());
}

TEST(RunFolder, JournalHasTheShapeOfTheEventModel) {
  const TemporaryFolder temporary;
  const Plan plan = small_plan();
  const RunFolder folder = RunFolder::create(temporary / "run", plan);
  {
    RunJournal journal(folder, Json::object());
    journal.pose(taken_at(plan, 0), "motion");
    journal.pose(taken_at(plan, 1), "motion");
    journal.stop("success", "");
  }
  std::vector<std::string> order;
  Json start, descriptor, last, stop;
  read_journal(folder.journal(), [&](const JournalEntry& entry) {
    order.push_back(entry.name);
    (entry.name == "start"   ? start
     : entry.name == "stop"  ? stop
     : entry.name == "event" ? last
                             : descriptor) = entry.doc;
  });
  EXPECT_THAT(order, ::testing::ElementsAre("start", "descriptor", "event", "event", "stop"));
  EXPECT_TRUE(start.at("time").is_number());
  EXPECT_EQ(descriptor.at("run_start"), start.at("uid"));
  EXPECT_EQ(last.at("descriptor"), descriptor.at("uid"));
  EXPECT_EQ(last.at("seq_num"), 2);
  EXPECT_EQ(stop.at("run_start"), start.at("uid"));
  EXPECT_EQ(stop.at("num_events").at("primary"), 2);
  ASSERT_EQ(last.at("data").size(), descriptor.at("data_keys").size());
  for (const auto& [key, value] : last.at("data").items()) {
    ASSERT_TRUE(descriptor.at("data_keys").contains(key)) << key;
    EXPECT_TRUE(last.at("timestamps").contains(key)) << key;
    const auto& type = descriptor.at("data_keys").at(key);
    EXPECT_TRUE(type.contains("source") && type.contains("shape")) << key;
    const std::string dtype = type.at("dtype");
    EXPECT_TRUE(dtype == "string"    ? value.is_string()
                : dtype == "integer" ? value.is_number_integer()
                : dtype == "boolean" ? value.is_boolean()
                : dtype == "array"   ? value.is_array()
                                     : value.is_number())
        << key;
  }
}

TEST(RunFolder, OfAPoseTakenTwiceTheLaterOneCounts) {
  const TemporaryFolder temporary;
  const Plan plan = small_plan();
  const RunFolder folder = RunFolder::create(temporary / "run", plan);
  RunJournal journal(folder, Json::object());
  TakenPose taken = taken_at(plan, 1);
  journal.pose(taken, "motion");
  taken.yaw.position = 77;
  journal.pose(taken, "motion");
  const RunRecord record = read_run(folder);
  ASSERT_EQ(record.poses.size(), 1u);
  EXPECT_EQ(record.poses[0].yaw.position, 77);
  EXPECT_EQ(record.exit_status, "");
}

TEST(RunFolder, IsNeverMadeOverAnotherOne) {
  const TemporaryFolder temporary;
  RunFolder::create(temporary / "run", small_plan());
  EXPECT_THROW(RunFolder::create(temporary / "run", small_plan()), ConfigError);
  spill(temporary / "file", "x");
  EXPECT_THROW(RunFolder::create(temporary / "file", small_plan()), ConfigError);
  EXPECT_THROW(RunFolder::create("/proc/turntable/run", small_plan()), RecordError);
  std::filesystem::create_directory(temporary / "empty");
  EXPECT_NO_THROW(RunFolder::create(temporary / "empty", small_plan()));
}

TEST(RunFolder, IsRefusedWithoutAPlan) {
  const TemporaryFolder temporary;
  EXPECT_THROW(RunFolder::open(temporary.path()), ConfigError);
  EXPECT_THROW(RunFolder::open(temporary / "nowhere"), ConfigError);
}

TEST(RunFolder, RefusesAJournalOfAnotherPlan) {
  const TemporaryFolder temporary;
  const Plan plan = small_plan();
  const RunFolder folder = RunFolder::create(temporary / "run", plan);
  RunJournal journal(folder, Json::object());
  TakenPose taken = taken_at(plan, 1);
  taken.planned.id = "0123456789abcdef";
  journal.pose(taken, "motion");
  try {
    read_run(folder);
    FAIL() << "no error";
  } catch (const ConfigError& e) {
    EXPECT_THAT(e.what(), HasSubstr("0123456789abcdef"));
  }
}

}  // namespace
}  // namespace turntable
