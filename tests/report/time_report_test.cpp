#include "src/report/time_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

TakenPose taken(std::size_t index, std::size_t scenario, PosePhases phases) {
  TakenPose pose;
  pose.planned.index = index;
  pose.planned.scenario = scenario;
  pose.phases = phases;
  pose.images.emplace_back();
  return pose;
}

/// A session that was killed and one that ended: eight poses of two scenarios and one taken again.
RunRecord two_sessions() {
  RunRecord record;
  ScenarioInfo sweep, motion;
  sweep.name = "sweep";
  motion.name = "motion";
  record.plan.scenarios = {sweep, motion};
  for (std::size_t i = 0; i < 8; ++i) record.poses.push_back(taken(i, i / 4, {5, 1, 0.25, 0.5}));
  record.overlaps.push_back(taken(1, 0, {5, 1, 0.25, 0.5}));
  record.sessions.resize(2);
  record.sessions[0].time = {
      {"motion_s", 10}, {"settle_s", 2}, {"trigger_s", 0.5}, {"transfer_s", 1}};
  record.sessions[1].whole_time = true;
  record.sessions[1].time = {{"homing_s", 4},   {"mount_s", 20},  {"motion_s", 35},
                             {"settle_s", 7},   {"trigger_s", 2}, {"transfer_s", 4},
                             {"held_s", 20},    {"rig_s", 100},   {"inspect_s", 1.25},
                             {"archive_s", 33}, {"waited_s", 6},  {"wall_s", 101}};
  record.telemetry.resize(2);
  return record;
}

TelemetryReading reading(double rig_time_s, std::optional<double> room, std::optional<double> air) {
  return {rig_time_s, {air, room}, room && air ? "" : "room: no | answer"};
}

/// Both sessions read their channels; the second one was suspended once by the room, and cut off while
/// it was suspended again.
void add_telemetry(RunRecord& record) {
  for (SessionTelemetry& session : record.telemetry)
    session.channels = {{"air", "hPa"}, {"room", "degC"}};
  record.telemetry[0].readings = {reading(0, 20, 1013), reading(10, 21, 1012)};
  auto& readings = record.telemetry[1].readings;
  for (int i = 0; i < 10; ++i) {
    const bool warm = (i >= 3 && i < 6) || i > 7;
    readings.push_back(reading(10.0 * i, i == 7 ? std::nullopt : std::optional(warm ? 25.0 : 22.0),
                               1010.0 + 0.125 * i));
  }
  record.sessions[1].interruptions = {{"pause", "asked | for", "2026-11-25T01:00:00.000Z", {}},
                                      {"resume", "asked for", "2026-11-25T01:01:00.000Z", {}},
                                      {"suspend", "room 25", "2026-11-25T02:00:00.000Z", 30.0},
                                      {"resume", "back", "2026-11-25T02:01:00.000Z", 60.0},
                                      {"suspend", "room 25", "2026-11-25T03:00:00.000Z", 80.0}};
}

RigFile rig_that_waits() {
  RigFile rig;
  ChannelConfig room;
  room.name = "room";
  room.unit = "degC";
  room.hold = {18, 24, 18, 23, 0, 0};
  rig.telemetry.channels = {room};
  return rig;
}

TEST(TimeReport, SumsUpEveryPhaseAndWhatNoPhaseNames) {
  RunRecord record = two_sessions();
  const std::string text = time_text(record);
  EXPECT_THAT(text, HasSubstr("Of 113.5 s on the rig's clock 39.6 % were motion and 60.4 % were "
                              "not, most of that: changing the payload 17.6 %, paused or suspended "
                              "17.6 %."));
  EXPECT_THAT(text, HasSubstr("| session 1 / s | % | session 2 / s | % | all / s | % |"));
  EXPECT_THAT(text, HasSubstr("| homing | - | - | 4.0 | 4.0 | 4.0 | 3.5 |\n"));
  EXPECT_THAT(text, HasSubstr("| motion | 10.0 | 74.1 | 35.0 | 35.0 | 45.0 | 39.6 |\n"));
  EXPECT_THAT(text, HasSubstr("| other | - | - | 8.0 | 8.0 | 8.0 | 7.0 |\n"));
  EXPECT_THAT(text, HasSubstr("| in all | 13.5 | | 100.0 | | 113.5 | |\n"));
  EXPECT_THAT(text, HasSubstr("| archiving, beside the motion | - | 33.0 | 33.0 |\n"));
  EXPECT_THAT(text, HasSubstr("| waited for the archive | - | 6.0 | 6.0 |\n"));
  EXPECT_THAT(text, HasSubstr("Of session 1 only the phases of its poses are known"));

  record.sessions.erase(record.sessions.begin());
  const std::string one = time_text(record);
  EXPECT_THAT(one, HasSubstr("Of 100.0 s on the rig's clock 35.0 % were motion"));
  EXPECT_THAT(one, HasSubstr("| settling | 7.0 | 7.0 |\n"));
  EXPECT_THAT(one, Not(HasSubstr("only the phases of its poses")));
  record.sessions.clear();
  EXPECT_EQ(time_text(record), "");
}

TEST(TimeReport, DrawsEveryScenarioAndWhatBelongsToNoPose) {
  const TemporaryFolder folder;
  const auto drafts = time_drafts(folder.path(), two_sessions(), {});
  ASSERT_EQ(drafts.size(), 1u) << "no telemetry";
  EXPECT_EQ(slurp(folder / "dead_time.csv"),
            "what,poses,homing_s,mount_s,motion_s,settle_s,trigger_s,transfer_s,held_s,other_s\n"
            "sweep,4,0.000,0.000,20.000,4.000,1.000,2.000,0.000,0.000\n"
            "motion,4,0.000,0.000,20.000,4.000,1.000,2.000,0.000,0.000\n"
            "overlap,1,0.000,0.000,5.000,1.000,0.250,0.500,0.000,0.000\n"
            "between poses,0,4.000,20.000,0.000,0.000,0.250,0.500,20.000,8.000\n");
  EXPECT_TRUE(draw(folder.path(), drafts)[0].drawn);
  const std::string svg = slurp(folder / "dead_time.svg");
  for (const char* words : {"4 x 6.8 s", "52.8 s", "settling", "between poses"})
    EXPECT_TRUE(svg.find(words) != std::string::npos) << words;
  EXPECT_TRUE(time_drafts(folder.path(), {}, {}).empty()) << "nothing was taken";
}

TEST(ImagesReport, SaysInOneLineThatAllWereGood) {
  EXPECT_EQ(images_text(two_sessions()),
            "## Images checked\n\nAll 8 images were good at once.\n\n");
  EXPECT_EQ(images_text({}), "");
}

TEST(ImagesReport, CountsWhatWasTakenAgainAndPutsLikeComplaintsTogether) {
  RunRecord record = two_sessions();
  record.poses[0].images[0].retakes = 2;
  EXPECT_THAT(images_text(record),
              AllOf(HasSubstr("1 of 8 images were taken again in place, 2 "
                              "exposures in all. Every pose is kept with good"),
                    Not(HasSubstr("|"))));
  const auto complain = [&record](std::size_t pose, const char* text) {
    record.poses[pose].images[0].complaint = text;
    record.poses[pose].images[0].retakes = 2;
  };
  complain(2, "blurred by 4.2 px, allowed: 3 px");
  complain(4, "2 spots, allowed: 4 LEDs or more");
  for (const std::size_t pose : {5u, 7u}) complain(pose, "blurred by 3.9 px, allowed: 3 px");
  record.poses[7].images.push_back(record.poses[7].images[0]);
  const std::string text = images_text(record);
  EXPECT_THAT(text,
              HasSubstr("6 of 9 images were taken again in place, 12 exposures in all. 4 of 8 "
                        "poses are kept with a complaint"));
  EXPECT_THAT(text, HasSubstr("|--:|---|---|---|\n"
                              "| 3 | 5, 7 | motion | blurred by 3.9 px, allowed: 3 px |\n"
                              "| 1 | 2 | sweep | blurred by 4.2 px, allowed: 3 px |\n"
                              "| 1 | 4 | motion | 2 spots, allowed: 4 LEDs or more |\n\n"));
}

TEST(ImagesReport, ShowsTenKindsOfComplaintsAtMost) {
  RunRecord record = two_sessions();
  for (char kind = 'a'; kind <= 'm'; ++kind) {
    TakenImage image;
    image.complaint = std::string(3, kind);
    record.poses[6].images.push_back(image);
  }
  const std::string text = images_text(record);
  EXPECT_THAT(text, AllOf(HasSubstr("| jjj |\n"), Not(HasSubstr("kkk"))));
  EXPECT_THAT(text, HasSubstr("3 more kinds of complaints are in the journal."));
}

TEST(TelemetryReport, HasAChannelsMeanAndExtremesAndHowOftenItWasUnreadable) {
  RunRecord record = two_sessions();
  EXPECT_EQ(telemetry_text(record), "");
  add_telemetry(record);
  const std::string text = telemetry_text(record);
  EXPECT_THAT(text, HasSubstr("| air | hPa | 1010.89 | 1010 | 1013 | 12 | 0 |\n"));
  EXPECT_THAT(text, HasSubstr("| room | degC | 23.0909 | 20 | 25 | 12 | 1 |\n"));
  EXPECT_THAT(text, HasSubstr("room: no \\| answer"));
}

TEST(TelemetryReport, DrawsSessionsApartWithTheirSuspensions) {
  const TemporaryFolder folder;
  RunRecord record = two_sessions();
  add_telemetry(record);
  const auto drafts = time_drafts(folder.path(), record, rig_that_waits());
  ASSERT_EQ(drafts.size(), 2u);
  const std::string csv = slurp(folder / "telemetry.csv");
  // The first session said nothing about its length: its last reading stands for it.
  EXPECT_THAT(csv, HasSubstr("session,rig_time_s,elapsed_s,suspended,air_hPa,room_degC\n"
                             "1,0.000,0.000,0,1013.000000,20.000000\n"
                             "1,10.000,10.000,0,1012.000000,21.000000\n"
                             "2,0.000,10.000,0,1010.000000,22.000000\n"));
  EXPECT_THAT(csv, HasSubstr("\n2,30.000,40.000,1,1010.375000,25.000000\n"));
  EXPECT_THAT(csv, HasSubstr("\n2,70.000,80.000,0,1010.875000,\n"));
  EXPECT_THAT(csv, HasSubstr("\n2,90.000,100.000,1,"));
  EXPECT_THAT(drafts[1].commands, HasSubstr("from 40,graph 0 to 70,graph 1"));
  EXPECT_THAT(drafts[1].commands, HasSubstr("from 90,graph 0 to 110,graph 1")) << "up to its end";
  EXPECT_THAT(drafts[1].commands,
              HasSubstr("plot 18 with lines lw 1.2 dt 2 lc rgb '#D55E00', 24 with lines"));
  EXPECT_TRUE(draw(folder.path(), {drafts[1]})[0].drawn);
  EXPECT_THAT(slurp(folder / "telemetry.svg"), HasSubstr("room / degC"));
}

TEST(InterruptionsReport, NamesEveryOneWithItsTimeAndReason) {
  RunRecord record = two_sessions();
  EXPECT_EQ(interruptions_text(record), "");
  add_telemetry(record);
  const std::string text = interruptions_text(record);
  EXPECT_THAT(text, HasSubstr("| 2 | 2026-11-25T01:00:00.000Z | - | pause | asked \\| for |\n"));
  EXPECT_THAT(text, HasSubstr("| 2 | 2026-11-25T02:01:00.000Z | 60.0 | resume | back |\n"));
  record.sessions[0].interruptions.resize(50);
  EXPECT_THAT(interruptions_text(record), HasSubstr("15 more are in the journal."));
}

}  // namespace
}  // namespace turntable
