// "turntable identify": what a run tells about its rig, and the files that carry it on.
#include <gtest/gtest.h>

#include "src/core/errors.h"
#include "src/core/rig_file.h"
#include "src/core/target_file.h"
#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

const fs::path kRig = fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/rigs/simulated.json";

Outcome identify(const fs::path& run, const std::string& options = "") {
  return turntable_program("identify \"" + run.string() + "\" " + options);
}

TEST(Identify, PrintsTheRigAndWritesFilesThatNameTheRun) {
  TemporaryFolder folder;
  const std::string quick = "run scenarios/campaigns/quick.json --rig ";
  const std::string images = " --out ";
  Outcome outcome = turntable_program(quick + kRig.string() + images + (folder / "first").string());
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  for (const char* file :
       {"levels.csv", "levels.md", "identified.csv", "identified.md", "identified_correlation.csv"})
    EXPECT_GT(slurp(folder / "first/tables" / file).size(), 300u) << file;
  const std::string report = slurp(folder / "first/report.md");
  EXPECT_NE(report.find("## Three levels of truth"), std::string::npos);
  EXPECT_NE(report.find("| as published | aligned | self-calibrated |"), std::string::npos);

  const fs::path rig_out = folder / "identified.json", target_out = folder / "target.json";
  const std::string options =
      "--rig-out " + rig_out.string() + " --target-out " + target_out.string();
  outcome = identify(folder / "first", options);
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("lean of the stage's travel towards x"), std::string::npos);
  EXPECT_NE(outcome.output.find("self-calibrated"), std::string::npos);
  EXPECT_EQ(outcome.output.find("does not explain"), std::string::npos) << outcome.output;

  const RigFile drawn = load_rig_file(kRig), found = load_rig_file(rig_out);
  EXPECT_NE(found.source.find("\"run\": \"first\""), std::string::npos);
  // The simulated rig is where it was: what was drawn and its error add up to the same.
  for (std::size_t i = 0; i < 4; ++i)
    EXPECT_LT((found.target.points_mm[i] + found.simulation->target_errors_mm[i] -
               drawn.target.points_mm[i] - drawn.simulation->target_errors_mm[i])
                  .norm(),
              2e-4);
  EXPECT_GT(found.gimbal.plane_from_gimbal_deg.norm(), 0.0);
  EXPECT_LT((found.gimbal.plane_from_gimbal_deg - drawn.simulation->plane_from_gimbal_deg).norm(),
            0.05);
  EXPECT_LT((found.target.offset_mm - drawn.simulation->target_offset_error_mm).norm(), 0.1);
  EXPECT_EQ(fs::weakly_canonical(found.calibration.sweep),
            fs::weakly_canonical(drawn.calibration.sweep));
  const TargetFile target = load_target(target_out);
  EXPECT_EQ(target.points_mm[2], found.target.points_mm[2]);
  EXPECT_GT(target.uncertainty_mm, 0.0);

  const std::string before = slurp(rig_out);
  outcome = identify(folder / "first", options);
  EXPECT_EQ(outcome.code, 2);
  EXPECT_NE(outcome.output.find("which exists"), std::string::npos) << outcome.output;
  EXPECT_EQ(slurp(rig_out), before);

  outcome = identify(folder / "first", "--rig-out " + (folder / "nowhere/rig.json").string());
  EXPECT_EQ(outcome.code, 2);
  EXPECT_NE(outcome.output.find("in a folder that is there"), std::string::npos) << outcome.output;

  // And it serves as a rig file.
  outcome = turntable_program(quick + rig_out.string() + images + (folder / "second").string());
  EXPECT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_EQ(turntable_program("verify " + (folder / "first").string()).code, 0);
}

TEST(Identify, SaysThatARigModelDoesNotExplainItsRun) {
  TemporaryFolder folder;  // its yaw has a periodic error, which is no parameter
  ASSERT_EQ(
      turntable_program("run scenarios/campaigns/quick.json --rig scenarios/rigs/paper_2019.json "
                        "--out " +
                        (folder / "run").string())
          .code,
      0);
  EXPECT_NE(identify(folder / "run").output.find("does not explain this run"), std::string::npos);
  EXPECT_NE(slurp(folder / "run/report.md").find("**The rig model does not explain this run"),
            std::string::npos);
}

TEST(Identify, RefusesWhatTellsNothing) {
  TemporaryFolder folder;
  EXPECT_EQ(identify(folder / "nothing").code, 2);
  const Outcome help = turntable_program("identify --help");
  EXPECT_EQ(help.code, 0);
  EXPECT_NE(help.output.find("Examples:"), std::string::npos);
}

}  // namespace
}  // namespace turntable
