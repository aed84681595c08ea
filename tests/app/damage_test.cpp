// What may happen to a run on its disk, through the program: each damage is detected and named, and
// nothing else is lost.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "src/record/run_folder.h"
#include "src/record/sha256.h"
#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

/// One small run with everything, of which every test damages a copy.
class DamagedCopy : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    original_ = new TemporaryFolder;
    const std::string scenarios = TURNTABLE_SOURCE_DIR "/scenarios/quick/";
    spill(*original_ / "campaign.json",
          R"({"format": "turntable-campaign/1", "name": "small", "title": "Small", "steps": [
              {"scenario": ")" +
              scenarios + R"(calibration.json"},
              {"scenario": ")" +
              scenarios + R"(triaxial_xyz.json"}]})");
    const Outcome made = turntable_program("run " + (*original_ / "campaign.json").string() +
                                           " --rig scenarios/rigs/ideal.json --out " +
                                           (*original_ / "run").string());
    ASSERT_EQ(made.code, 0) << made.output;
  }
  static void TearDownTestSuite() { delete original_; }
  DamagedCopy() { fs::copy(*original_ / "run", run, fs::copy_options::recursive); }

  Outcome verify(const std::string& more = "") {
    return turntable_program("verify " + run.string() + more);
  }
  /// Replaces the first `from` behind `after`.
  void edit(const fs::path& file, const std::string& after, const std::string& from,
            const std::string& to) {
    std::string text = slurp(file);
    const auto at = text.find(from, text.find(after));
    ASSERT_NE(at, std::string::npos) << file << " has no " << from;
    spill(file, text.replace(at, from.size(), to));
  }

  static TemporaryFolder* original_;
  TemporaryFolder folder;
  const fs::path run = folder / "run";
};
TemporaryFolder* DamagedCopy::original_ = nullptr;

TEST_F(DamagedCopy, VerifyMakesEverythingThatFollowsAgain) {
  const Outcome sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("the same again"));

  edit(run / "tables/table5.csv", "ours", ".", ",");
  edit(run / "poses.csv", "triaxial", ",measure,", ",return,");
  fs::remove(run / "tables/camera_solver.md");
  spill(run / "tables/mine.csv", "a\n");
  const std::string before = slurp(run / "poses.csv");
  const Outcome damaged = verify();
  EXPECT_EQ(damaged.code, 4);
  EXPECT_THAT(damaged.output,
              AllOf(HasSubstr("table5.csv: line "), HasSubstr("poses.csv: line "),
                    HasSubstr("camera_solver.md: is missing"), HasSubstr("mine.csv: is nothing"),
                    Not(HasSubstr("table1")), Not(HasSubstr("another program"))));
  EXPECT_EQ(slurp(run / "poses.csv"), before) << "verify changes nothing";
  EXPECT_EQ(verify(" --record-only").code, 0);

  fs::remove(run / "tables/mine.csv");
  EXPECT_EQ(turntable_program("evaluate " + run.string()).code, 0);
  EXPECT_EQ(verify().code, 0);
}

TEST_F(DamagedCopy, ReportSaysThatPosesCsvIsNotWhatWasWritten) {
  const std::string report = "report " + run.string() + " --no-pdf";
  const Outcome sound = turntable_program(report);
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, Not(HasSubstr("poses.csv")));
  const std::string poses = slurp(run / "poses.csv");
  spill(run / "poses.csv", poses.substr(0, poses.size() / 2));
  EXPECT_THAT(turntable_program(report).output, HasSubstr("poses.csv: was changed after"));
  fs::remove(run / "poses.csv");
  EXPECT_THAT(turntable_program(report).output, HasSubstr("poses.csv: is missing"));
}

TEST_F(DamagedCopy, ItsStartDocumentSaysWhatTheResultsOweTheirBeingTo) {
  const Json start = Json::parse(read_run_state(RunFolder::open(run)).start_document);
  const Json& p = start.at("provenance");
  for (const char* key :
       {"program", "version", "commit", "modified", "compiler", "host", "command", "folder"})
    EXPECT_TRUE(p.contains(key)) << key;
  EXPECT_EQ(start.at("plan_sha256"), sha256_hex(slurp(run / "plan.json")));
  EXPECT_EQ(p.at("rig").at("sha256"), sha256_hex(slurp("scenarios/rigs/ideal.json")));
  ASSERT_EQ(p.at("sources").size(), 3u);  // the campaign and its two scenarios
  for (const Json& source : p.at("sources"))
    EXPECT_EQ(source.at("sha256"), sha256_hex(slurp(source.at("file").get<std::string>())));
  EXPECT_FALSE(p.contains("calibration_sha256")) << "it follows from the run's own sweep";
  EXPECT_EQ(p.at("axes").size(), 4u);
  for (const auto& [name, axis] : p.at("axes").items())
    for (const char* key : {"lower", "upper", "speed", "acceleration", "backlash", "tolerance"})
      EXPECT_TRUE(axis.at(key).is_number()) << name << key;
  EXPECT_EQ(p.at("camera").at("width_px"), 1024);
  EXPECT_EQ(p.at("camera").at("trigger"), "software");
  EXPECT_TRUE(p.at("seed").is_number());
  EXPECT_GE(p.at("libraries").size(), 5u);
  // Device identities stand beside it, as each device answered.
  EXPECT_FALSE(start.at("devices").empty());
}

TEST_F(DamagedCopy, ACalibrationThatDoesNotFollowFromItsSweepIsNamed) {
  edit(run / "calibration.json", "sigma_mm", "0.", "1.");
  const Outcome damaged = verify();
  EXPECT_EQ(damaged.code, 4);
  EXPECT_THAT(damaged.output,
              AllOf(HasSubstr("calibration.json: line "), Not(HasSubstr("poses.csv"))));
}

TEST_F(DamagedCopy, ADifferenceMayBeTheProgramsAndThatIsSaid) {
  edit(run / "evaluation.json", "tables_by", "\"version\": \"", "\"version\": \"0.0.9-");
  EXPECT_EQ(verify().code, 0) << "the same tables, by whatever program";
  edit(run / "tables/table5.csv", "ours", ".", ",");
  EXPECT_THAT(verify().output, AllOf(HasSubstr("another program"), HasSubstr("version 0.0.9-")));
}

TEST_F(DamagedCopy, WhatWasGivenFromElsewhereIsKnownByItsHash) {
  const fs::path given = folder / "given.json";
  fs::copy(run / "calibration.json", given);
  edit(given, "\"source\"", ": \"", ": \"other ");
  ASSERT_EQ(turntable_program("evaluate " + run.string() + " --solver posit,ml_ray --calibration " +
                              given.string())
                .code,
            0);
  const Outcome sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  edit(run / "calibration.json", "\"source\"", ": \"", ": \"x");
  const Outcome damaged = verify();
  EXPECT_EQ(damaged.code, 4);
  EXPECT_THAT(damaged.output, HasSubstr("is not the one that the run was evaluated with"));
}

TEST_F(DamagedCopy, ARunSetBesideIsMadeAgainTooAsLongAsItIsThere) {
  fs::copy(run, folder / "other", fs::copy_options::recursive);
  ASSERT_EQ(
      turntable_program("report " + run.string() + " --beside " + (folder / "other").string()).code,
      0);
  EXPECT_THAT(slurp(run / "tables/camera_solver.csv"), HasSubstr("\n2,"));
  Outcome sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  fs::remove_all(folder / "other");
  sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("remark: tables/camera_solver"));
}

TEST_F(DamagedCopy, TablesOfAnEarlierStateDoNotPassAndARunWithoutTablesDoes) {
  edit(run / "evaluation.json", "journal_lines", "\": ", "\": 1");
  std::string evaluation = slurp(run / "evaluation.json");
  const auto digits = evaluation.find(": 1", evaluation.find("journal_lines")) + 2;
  evaluation.erase(digits + 2, evaluation.find_first_not_of("0123456789", digits) - digits - 2);
  spill(run / "evaluation.json", evaluation);  // evaluated when it had some ten lines
  Outcome sound = verify();
  EXPECT_EQ(sound.code, 4) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("of an earlier state and were not compared"));
  for (const char* name : {"poses.csv", "evaluation.json", "tables", "calibration.json"})
    fs::remove_all(run / name);
  sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("has not been evaluated yet"));
}

TEST_F(DamagedCopy, WhatCannotBeWrittenIsNamedAndTheOldStays) {
  const std::string poses = slurp(run / "poses.csv");
  for (const char* verb : {"evaluate ", "report "}) {
    const Outcome full = turntable_program(verb + run.string(), "ulimit -f 1;");
    EXPECT_EQ(full.code, 3) << full.output;
    EXPECT_THAT(full.output, AllOf(HasSubstr(run.string()), HasSubstr("Make room")));
    EXPECT_EQ(slurp(run / "poses.csv"), poses);
    EXPECT_EQ(verify().code, 0);
  }
  const Outcome scratch = turntable_program("verify " + run.string(), "TMPDIR=/proc");
  EXPECT_EQ(scratch.code, 3) << scratch.output;
  EXPECT_THAT(scratch.output, HasSubstr("--record-only"));
  const Outcome nowhere = turntable_program("verify " + run.string(), "TMPDIR=/nonexistent");
  EXPECT_EQ(nowhere.code, 3) << "the run is not to blame";
  EXPECT_THAT(nowhere.output, HasSubstr("TMPDIR: found \"/nonexistent\""));
}

TEST_F(DamagedCopy, AJournalCutOffInItsLastLineIsSaidAndVerifiedUpToThere) {
  const std::string journal = slurp(run / "journal.jsonl");
  spill(run / "journal.jsonl", journal.substr(0, journal.size() - 10));
  const Outcome torn = verify();
  EXPECT_EQ(torn.code, 4) << "it was whole when the run was evaluated";
  EXPECT_THAT(torn.output, AllOf(HasSubstr("cut off"), HasSubstr("no stop document"),
                                 HasSubstr("its end is lost")));
  for (const char* name : {"poses.csv", "evaluation.json", "tables", "calibration.json"})
    fs::remove_all(run / name);
  EXPECT_EQ(verify().code, 0) << "what a power cut leaves";
}

TEST_F(DamagedCopy, AJournalThatLostLinesSinceItWasEvaluatedIsDamaged) {
  std::string journal = slurp(run / "journal.jsonl");
  journal.resize(journal.rfind('\n', journal.size() - 2) + 1);
  spill(run / "journal.jsonl", journal);
  const Outcome cut = verify();
  EXPECT_EQ(cut.code, 4) << cut.output;
  EXPECT_THAT(cut.output, HasSubstr("its end is lost"));
}

TEST_F(DamagedCopy, ARunWithoutItsJournalIsNotSound) {
  fs::remove(run / "journal.jsonl");
  const Outcome outcome = verify();
  EXPECT_EQ(outcome.code, 4);
  EXPECT_THAT(outcome.output, HasSubstr("journal.jsonl"));
}

/// A short motion whose camera is known, without images.
std::string short_run(const fs::path& calibration, const fs::path& out) {
  return "run scenarios/uniaxial_z.json --rig scenarios/rigs/ideal.json --images none "
         "--calibration " +
         calibration.string() + " --out " + out.string();
}

TEST_F(DamagedCopy, ARunWhoseDiskWasFullGoesOnToTheSameTables) {
  const fs::path camera = run / "calibration.json";
  ASSERT_EQ(turntable_program(short_run(camera, folder / "whole")).code, 0);
  // Enough for plan and calibration, not for the whole journal.
  const auto blocks = fs::file_size(camera) / 512 + 2;
  ASSERT_GT(fs::file_size(folder / "whole/journal.jsonl"), 512 * blocks);
  const Outcome full = turntable_program(short_run(camera, folder / "full"),
                                         "ulimit -f " + std::to_string(blocks) + ";");
  EXPECT_EQ(full.code, 3) << full.output;
  EXPECT_THAT(full.output, AllOf(HasSubstr("journal.jsonl"), HasSubstr("turntable resume")));
  const std::string begun = slurp(folder / "full/journal.jsonl");
  EXPECT_GT(begun.size(), 0u);
  const Outcome resumed = turntable_program("resume " + (folder / "full").string());
  EXPECT_EQ(resumed.code, 0) << resumed.output;
  EXPECT_TRUE(slurp(folder / "full/journal.jsonl").starts_with(begun));
  EXPECT_EQ(slurp(folder / "full/poses.csv"), slurp(folder / "whole/poses.csv"));
  const Outcome sound = turntable_program("verify " + (folder / "full").string());
  EXPECT_EQ(sound.code, 0) << sound.output;
}

TEST_F(DamagedCopy, ARunGoesOnWithTheCalibrationThatItBeganWith) {
  const fs::path out = folder / "short";
  ASSERT_EQ(turntable_program(short_run(run / "calibration.json", out)).code, 0);
  std::string journal = slurp(out / "journal.jsonl");
  // As if it had been killed before its last poses.
  for (int i = 0; i < 8; ++i) journal.resize(journal.rfind('\n', journal.size() - 2) + 1);
  spill(out / "journal.jsonl", journal);
  // Evaluated with another one in between, it goes on with the first, and says so.
  const std::string given = slurp(out / "calibration.json");
  spill(folder / "other.json", given);
  edit(folder / "other.json", "\"source\"", ": \"", ": \"other ");
  ASSERT_EQ(turntable_program("evaluate " + out.string() + " --calibration " +
                              (folder / "other.json").string())
                .code,
            4)
      << "poses are missing";
  EXPECT_NE(slurp(out / "calibration.json"), given);
  ASSERT_EQ(turntable_program("resume " + out.string()).code, 0);
  EXPECT_EQ(slurp(out / "calibration.json"), given);
  EXPECT_THAT(read_run_state(RunFolder::open(out)).sessions.at(1).start_document,
              HasSubstr(sha256_hex(given)));
  fs::remove(out / "given_calibration.json");

  spill(out / "journal.jsonl", journal);
  edit(out / "calibration.json", "\"source\"", ": \"", ": \"another ");
  const Outcome refused = turntable_program("resume " + out.string());
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.output, HasSubstr("is not the calibration that the run began with"));
  EXPECT_EQ(slurp(out / "journal.jsonl"), journal);
  EXPECT_EQ(turntable_program("resume " + out.string() + " --accept-changes").code, 0);
  const Outcome sound = turntable_program("verify " + out.string());
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("is not the one that the run began with"));
}

TEST_F(DamagedCopy, ARunThatEndedInItsSweepSaysHowToGoOn) {
  const std::string journal = slurp(run / "journal.jsonl");
  std::size_t end = 0;
  for (int i = 0; i < 6; ++i) end = journal.find('\n', end) + 1;
  spill(run / "journal.jsonl", journal.substr(0, end));
  for (const char* file : {"calibration.json", "evaluation.json", "poses.csv"})
    fs::remove(run / file);
  const Outcome early = turntable_program("evaluate " + run.string());
  EXPECT_EQ(early.code, 2);
  EXPECT_THAT(early.output,
              AllOf(HasSubstr("ended early"), HasSubstr("turntable resume " + run.string())));
}

TEST(UnwritableFolder, IsRefusedBeforeAnythingMovesAndStaysAsItWas) {
  const TemporaryFolder folder;
  const std::string run =
      "run scenarios/campaigns/quick.json --rig scenarios/rigs/ideal.json --out ";
  const Outcome no_room = turntable_program(run + "/proc/run");
  EXPECT_EQ(no_room.code, 2) << no_room.output;
  EXPECT_THAT(no_room.output, HasSubstr("/proc"));
  const Outcome full = turntable_program(run + (folder / "run").string(), "ulimit -f 0;");
  EXPECT_EQ(full.code, 3) << full.output;
  EXPECT_THAT(full.output, HasSubstr("plan.json"));
  EXPECT_TRUE(fs::is_empty(folder / "run"));
}

}  // namespace
}  // namespace turntable
