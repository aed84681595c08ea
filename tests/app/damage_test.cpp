// What may happen to a run on its disk, through the program: each damage is detected and named, and
// nothing else is lost.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

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
    const Outcome made = turntable_program(
        "run scenarios/campaigns/quick.json --rig scenarios/rigs/ideal.json --out " +
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
  edit(run / "poses.csv", "uniaxial", ",measure,", ",return,");
  fs::remove(run / "tables/table3.md");
  spill(run / "tables/mine.csv", "a\n");
  const std::string before = slurp(run / "poses.csv");
  const Outcome damaged = verify();
  EXPECT_EQ(damaged.code, 4);
  EXPECT_THAT(damaged.output,
              AllOf(HasSubstr("table5.csv: line "), HasSubstr("poses.csv: line "),
                    HasSubstr("table3.md: is missing"), HasSubstr("mine.csv: is nothing"),
                    Not(HasSubstr("table4")), Not(HasSubstr("another program"))));
  EXPECT_EQ(slurp(run / "poses.csv"), before) << "verify changes nothing";
  EXPECT_EQ(verify(" --record-only").code, 0);

  fs::remove(run / "tables/mine.csv");
  EXPECT_EQ(turntable_program("evaluate " + run.string()).code, 0);
  EXPECT_EQ(verify().code, 0);
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
  ASSERT_EQ(turntable_program("report " + run.string() + " " + (folder / "other").string()).code,
            0);
  EXPECT_THAT(slurp(run / "tables/camera_solver.csv"), HasSubstr("\n2,"));
  Outcome sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  fs::remove_all(folder / "other");
  sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("remark: tables/camera_solver"));
}

TEST_F(DamagedCopy, ARunThatWasNotEvaluatedOrHasGoneOnSinceIsNotDamaged) {
  std::string journal = slurp(run / "journal.jsonl");
  journal.resize(journal.rfind('\n', journal.size() - 2) + 1);
  spill(run / "journal.jsonl", journal);
  Outcome sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("evaluated when its journal had"));
  for (const char* name : {"poses.csv", "evaluation.json", "tables", "calibration.json"})
    fs::remove_all(run / name);
  sound = verify();
  EXPECT_EQ(sound.code, 0) << sound.output;
  EXPECT_THAT(sound.output, HasSubstr("has not been evaluated yet"));
}

}  // namespace
}  // namespace turntable
