#include "src/record/run_folder.h"

#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

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
  taken.images = {
      {"images/a.png", std::string(64, 'a'), 7, 12.625, {{{1.5, 2.25, 0.01, 200, 21, false}}}},
      {"", "", 8, 12.75, std::nullopt}};
  return taken;
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
