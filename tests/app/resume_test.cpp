// A run from several terminals: paused, let go on, stopped, resumed; and what may not be resumed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "src/record/run_folder.h"
#include "tests/app/background_program.h"
#include "tests/app/program.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

const std::filesystem::path kProject = TURNTABLE_SOURCE_DIR;

std::string run_of(const char* campaign) {
  return "run " + (kProject / campaign).string() + " --rig " +
         (kProject / "scenarios/rigs/ideal.json").string() + " --images regions --out ";
}

/// Lines of the journal once it has at least `least`, or after 20 s.
std::size_t lines(const std::filesystem::path& run, std::size_t least = 0) {
  std::size_t count = 0;
  for (int i = 0; i < 400; ++i) {
    const std::string text = slurp(run / "journal.jsonl");
    count = static_cast<std::size_t>(std::ranges::count(text, '\n'));
    if (count >= least) break;
    std::this_thread::sleep_for(std::chrono::milliseconds{50});
  }
  return count;
}

/// As if the run had been killed: 40 lines are left.
void cut_journal(const std::filesystem::path& run) {
  const std::string journal = slurp(run / "journal.jsonl");
  std::size_t end = 0;
  for (int i = 0; i < 40; ++i) end = journal.find('\n', end) + 1;
  spill(run / "journal.jsonl", journal.substr(0, end));
}

TEST(Resume, ARunIsPausedLetGoOnStoppedAndResumedFromAnotherTerminal) {
  const TemporaryFolder folder;
  const std::string run = (folder / "run").string();
  BackgroundProgram campaign(run_of("scenarios/campaigns/lens.json") + run, folder / "log");
  ASSERT_GE(lines(run, 30), 30u);
  const Outcome paused = turntable_program("pause " + run);
  EXPECT_EQ(paused.code, 0) << paused.output;
  EXPECT_THAT(paused.output, HasSubstr("lets it go on"));
  while (slurp(folder / "run/journal.jsonl").find("\"interruption\":\"pause\"") ==
         std::string::npos)
    std::this_thread::sleep_for(std::chrono::milliseconds{20});
  const std::size_t standing = lines(run);
  EXPECT_EQ(turntable_program(run_of("scenarios/campaigns/lens.json") + run).code, 3)
      << "somebody takes it";
  EXPECT_EQ(lines(run), standing);
  EXPECT_EQ(turntable_program("resume " + run).code, 0);
  EXPECT_GE(lines(run, standing + 20), standing + 20);
  const Outcome stopped = turntable_program("stop " + run);
  EXPECT_EQ(stopped.code, 0) << stopped.output;
  EXPECT_EQ(campaign.ended(), 130);
  EXPECT_THAT(campaign.output(), HasSubstr("turntable resume"));
  EXPECT_EQ(read_run(RunFolder::open(run)).exit_status, "abort");
  EXPECT_EQ(turntable_program("verify " + run).code, 0);
  EXPECT_EQ(turntable_program("stop " + run).code, 2) << "nobody takes it any more";
}

TEST(Resume, TheFirstCtrlCPausesTheSecondEndsAndWhatWasTakenIsKept) {
  const TemporaryFolder folder;
  const std::string run = (folder / "run").string();
  BackgroundProgram campaign(run_of("scenarios/campaigns/lens.json") + run, folder / "log");
  ASSERT_GE(lines(run, 30), 30u);
  campaign.signal(SIGINT);
  ASSERT_TRUE(campaign.prints("paused after"));
  EXPECT_THAT(campaign.output(), HasSubstr("turntable resume " + run));
  EXPECT_EQ(turntable_program("resume " + run).code, 0);
  const std::size_t standing = lines(run);
  EXPECT_GE(lines(run, standing + 20), standing + 20);
  campaign.signal(SIGINT);  // a first one again
  std::this_thread::sleep_for(std::chrono::milliseconds{300});
  campaign.signal(SIGINT);
  EXPECT_EQ(campaign.ended(), 130);
  const RunRecord record = read_run(RunFolder::open(run));
  EXPECT_EQ(record.exit_status, "abort");
  EXPECT_FALSE(record.complete());
  EXPECT_EQ(turntable_program("verify " + run).code, 0);
}

TEST(Resume, DevicesAreAskedWithoutMovingAnything) {
  const TemporaryFolder folder;
  const std::string quick = (kProject / "scenarios/campaigns/quick.json").string() + " --rig " +
                            (kProject / "scenarios/rigs/ideal.json").string();
  const Outcome asked = turntable_program("run " + quick + " --dry-run --ask-devices --wire-log " +
                                          (folder / "wire").string());
  EXPECT_EQ(asked.code, 0) << asked.output;
  EXPECT_THAT(asked.output, HasSubstr("a test exposure came after"));
  EXPECT_THAT(asked.output, HasSubstr("Nothing has moved"));
  const std::string wire = slurp(folder / "wire");
  EXPECT_THAT(wire, HasSubstr("> SetSpeed? X"));
  for (const char* motion : {"> Go", "> Stop"})
    EXPECT_THAT(wire, ::testing::Not(HasSubstr(motion)));
  const Outcome plan = turntable_program("plan " + quick + " --ask-devices");
  EXPECT_EQ(plan.code, 0) << plan.output;
  EXPECT_THAT(plan.output, HasSubstr("a test exposure came after"));
}

TEST(Resume, RelativeNamesCountFromWhereTheRunWasStarted) {
  const TemporaryFolder folder;
  std::filesystem::copy(kProject / "scenarios", folder / "scenarios",
                        std::filesystem::copy_options::recursive);
  auto rig = nlohmann::json::parse(slurp(folder / "scenarios/rigs/ideal.json"));
  rig["telemetry"] = {{"channels", {{"hall", {{"unit", "degC"}, {"file", "hall.txt"}}}}}};
  spill(folder / "scenarios/rigs/ideal.json", rig.dump());
  spill(folder / "scenarios/rigs/hall.txt", "21.5\n");
  const Outcome whole = turntable_program(
      "run scenarios/campaigns/quick.json --rig scenarios/rigs/ideal.json --solver posit --out run",
      "cd " + (folder / ".").string() + " &&");
  ASSERT_EQ(whole.code, 0) << whole.output;
  cut_journal(folder / "run");
  std::filesystem::remove(folder / "run/evaluation.json");
  std::filesystem::remove(folder / "run/poses.csv");
  const std::string resume = "resume " + (folder / "run").string();
  const std::string scenario = slurp(folder / "scenarios/quick/uniaxial_x.json");
  spill(folder / "scenarios/quick/uniaxial_x.json", scenario + " ");
  EXPECT_THAT(turntable_program(resume, "cd / &&").output,
              HasSubstr("uniaxial_x.json: has changed"));
  spill(folder / "scenarios/quick/uniaxial_x.json", scenario);
  const Outcome resumed = turntable_program(resume, "cd / &&");
  ASSERT_EQ(resumed.code, 0) << resumed.output;
  EXPECT_THAT(slurp(folder / "run/evaluation.json"), HasSubstr("\"solvers\": [\n  \"posit\"\n ]"))
      << "as it was begun";
  const RunRecord record = read_run(RunFolder::open(folder / "run"));
  ASSERT_EQ(record.telemetry.size(), 2u);
  ASSERT_FALSE(record.telemetry[1].readings.empty());
  for (const TelemetryReading& reading : record.telemetry[1].readings)
    EXPECT_EQ(reading.values[0], 21.5) << reading.trouble;
}

TEST(Resume, WhatHasChangedSinceTheStartIsNamedAndRefusedUnlessAccepted) {
  const TemporaryFolder folder;
  std::filesystem::create_directories(folder / "a/b");
  std::filesystem::copy(kProject / "tests/data/kill", folder / "a/b/c",
                        std::filesystem::copy_options::recursive);
  std::filesystem::create_directories(folder / "scenarios");
  for (const char* name : {"quick", "rigs", "calibration_sweep.json"})
    std::filesystem::copy(kProject / "scenarios" / name, folder / "scenarios" / name,
                          std::filesystem::copy_options::recursive);
  const std::string run = (folder / "run").string();
  const Outcome whole =
      turntable_program("run " + (folder / "a/b/c/campaign.json").string() + " --rig " +
                        (folder / "scenarios/rigs/ideal.json").string() + " --out " + run);
  ASSERT_EQ(whole.code, 0) << whole.output;
  cut_journal(folder / "run");
  const std::string scenario = slurp(folder / "a/b/c/motion.json");
  spill(folder / "a/b/c/motion.json", scenario + " ");
  const Outcome refused = turntable_program("resume " + run);
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.output, HasSubstr("motion.json: has changed"));
  EXPECT_EQ(lines(run), 40u) << "nothing was written";
  const Outcome accepted = turntable_program("resume " + run + " --accept-changes");
  EXPECT_EQ(accepted.code, 0) << accepted.output;
  const RunRecord record = read_run(RunFolder::open(run));
  EXPECT_TRUE(record.complete());
  EXPECT_THAT(record.sessions.back().start_document, HasSubstr("accepted_changes"));

  // A lost image is found, said, and taken again.
  std::filesystem::remove(folder / "run" / record.poses[50].images[0].file);
  EXPECT_EQ(turntable_program("verify " + run).code, 4);
  spill(folder / "a/b/c/motion.json", scenario);
  const Outcome again = turntable_program("resume " + run);
  EXPECT_EQ(again.code, 0) << again.output;
  EXPECT_THAT(again.output, HasSubstr("1 whose images are lost"));
  EXPECT_EQ(turntable_program("verify " + run).code, 0);
  EXPECT_THAT(turntable_program("resume " + run).output, HasSubstr("Nothing is left to take"));
}

}  // namespace
}  // namespace turntable
