// Bad input: a clear message that names the place, exit code 2, nothing moved, nothing written.
#include <gtest/gtest.h>

#include <vector>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

std::string edited(const fs::path& file, const std::string& from, const std::string& to) {
  std::string text = slurp(file);
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << file << " has no " << from;
  if (at != std::string::npos) text.replace(at, from.size(), to);
  return text;
}

struct Edit {
  std::string file, from, to;
  std::vector<std::string> says;
};

TEST(BadScenario, IsRefusedWithThePlaceAndNothingHappens) {
  const std::vector<Edit> edits{
      {"uniaxial_z.json", "\"order\"", "\"ordr\"", {"unknown key \"ordr\""}},
      {"uniaxial_z.json", "\"stage_mm\": 120", "\"stage_mm\": \"120\"", {"/stage_mm", "\"120\""}},
      {"uniaxial_z.json", "\"stop_deg\": 45", "\"stop_deg\": 450", {"/ranges/0"}},
      {"uniaxial_z.json",
       "\"start_deg\": -45",
       "\"start_deg\": -90",
       {"/ranges/0", "yaw"}},  // the overshoot is outside
      {"uniaxial_z.json", "\"step_deg\": 3", "\"step_deg\": 0", {"/ranges/0/step_deg"}},
      {"uniaxial_z.json", "\"step_deg\": 3", "\"step_deg\": -3", {"/ranges/0"}},
      {"uniaxial_z.json", "\"step_deg\": 3", "\"step_deg\": NaN", {"not valid JSON at line"}},
      {"uniaxial_z.json",
       "\"start_deg\": -45, \"stop_deg\": 45, \"step_deg\": 3",
       "\"values_deg\": []",
       {"/ranges/0/values_deg"}},
      {"uniaxial_z.json", "\"axis\": \"yaw\"", "\"axis\": \"jaw\"", {"/ranges/0/axis", "\"jaw\""}},
      {"uniaxial_z.json", "\"stage_mm\": 120", "\"stage_mm\": 1200", {"stage"}},
      {"uniaxial_z.json", "turntable-scenario/1", "turntable-rig/1", {"/format"}},
      {"uniaxial_z.json", "\"title\": \"", "\"title\": \"two\\nlines", {"/title"}},
  };
  for (const Edit& edit : edits) {
    TemporaryFolder folder;
    spill(folder / "scenario.json", edited(kScenarios / edit.file, edit.from, edit.to));
    const Outcome outcome =
        turntable_program("run " + (folder / "scenario.json").string() +
                          " --rig scenarios/rigs/simulated.json --out " +
                          (folder / "out").string() + " --wire-log " + (folder / "wire").string());
    EXPECT_EQ(outcome.code, 2) << edit.to << ": " << outcome.output;
    EXPECT_NE(outcome.output.find("scenario.json"), std::string::npos) << outcome.output;
    for (const std::string& words : edit.says)
      EXPECT_NE(outcome.output.find(words), std::string::npos)
          << "no \"" << words << "\" in: " << outcome.output;
    EXPECT_FALSE(fs::exists(folder / "out")) << edit.to;
    EXPECT_FALSE(fs::exists(folder / "wire")) << edit.to;
  }
}

TEST(BadRig, IsRefusedWithThePlaceAndNothingHappens) {
  const std::vector<Edit> edits{
      {"simulated.json",
       "[-40.6, 44.2, -40], [-18.0, -57.2, -40]",
       "[-40.6, 44.2, -40]",
       {"/target/points_mm", "minItems 4"}},
      {"simulated.json",
       "[58.6, 13.0, -40], [-40.6, 44.2, -40], [-18.0, -57.2, -40]",
       "[58.6, 13.0, 0], [-40.6, 44.2, 0], [-18.0, -57.2, 0]",
       {"/target/points_mm", "one plane"}},
      {"simulated.json",
       "\"nominal_focal_px\": 1945",
       "\"nominal_focal_px\": 19450",
       {"inside an image"}},
      {"simulated.json", "zolix-mc600", "zolix-mc6000", {"zolix-mc600"}},
      {"simulated.json", "\"model\": \"simulated\"", "\"model\": \"film\"", {"/camera/model"}},
  };
  for (const Edit& edit : edits) {
    TemporaryFolder folder;
    std::string text = edited(kScenarios / "rigs" / edit.file, edit.from, edit.to);
    text.replace(text.find("../calibration_sweep.json"), 25,
                 (kScenarios / "calibration_sweep.json").string());
    spill(folder / "rig.json", text);
    const Outcome outcome =
        turntable_program("run scenarios/uniaxial_z.json --rig " + (folder / "rig.json").string() +
                          " --out " + (folder / "out").string());
    EXPECT_EQ(outcome.code, 2) << edit.to << ": " << outcome.output;
    for (const std::string& words : edit.says)
      EXPECT_NE(outcome.output.find(words), std::string::npos)
          << "no \"" << words << "\" in: " << outcome.output;
    EXPECT_FALSE(fs::exists(folder / "out")) << edit.to;
  }
}

TEST(BadArguments, AreRefused) {
  for (const std::string arguments :
       {"",
        "dance",
        "run",
        "run nowhere.json --rig scenarios/rigs/simulated.json",
        "run scenarios/uniaxial_z.json",
        "run scenarios/uniaxial_z.json --rig nowhere.json",
        "run scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json --solver magic",
        "run scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json --images some",
        "run scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json --calibration "
        "nowhere.json",
        "run scenarios/rigs/simulated.json --rig scenarios/rigs/simulated.json",
        "run scenarios/uniaxial_z.json --rig scenarios/uniaxial_z.json",
        "evaluate /nowhere",
        "evaluate .",
        "report /nowhere",
        "calibrate /nowhere",
        "calibrate scenarios/calibration_sweep.json",
        "calibrate scenarios/calibrations/paper_table1.json --order 12",
        "simulate nowhere.json",
        "plan scenarios/uniaxial_z.json",
        "calibrate scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json",
        "run scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json --calibration "
        "scenarios/calibrations/paper_table1.json --solver posit"}) {
    const Outcome outcome = turntable_program(arguments);
    EXPECT_EQ(outcome.code, 2) << "turntable " << arguments << ": " << outcome.output;
    EXPECT_FALSE(outcome.output.empty());
  }
}

TEST(BadArguments, APictureThatCannotBeDrawnIsNotWritten) {
  TemporaryFolder folder;
  const std::string plan =
      "plan scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json --picture ";
  const Outcome named = turntable_program(plan + (folder / "way.png").string());
  EXPECT_EQ(named.code, 2) << named.output;
  EXPECT_NE(named.output.find("way.png, allowed: a name that ends in .svg"), std::string::npos)
      << named.output;
  spill(folder / "way.svg", "an older one");
  const Outcome drawn = turntable_program(plan + (folder / "way.svg").string(), "PATH=/nowhere");
  EXPECT_EQ(drawn.code, 2) << drawn.output;
  EXPECT_NE(drawn.output.find("gnuplot"), std::string::npos) << drawn.output;
  EXPECT_EQ(slurp(folder / "way.svg"), "an older one");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator()), 1);
}

TEST(BadArguments, AnExistingRunFolderIsNeverWrittenOver) {
  TemporaryFolder folder;
  fs::create_directories(folder / "out");
  spill(folder / "out/precious.txt", "data");
  const Outcome outcome = turntable_program(
      "run scenarios/campaigns/quick.json --rig scenarios/rigs/ideal.json --out " +
      (folder / "out").string());
  EXPECT_EQ(outcome.code, 2) << outcome.output;
  EXPECT_EQ(std::distance(fs::directory_iterator(folder / "out"), fs::directory_iterator()), 1);
}

TEST(BadCalibration, OfAnotherImageSizeIsRefusedBeforeAnythingMoves) {
  TemporaryFolder folder;
  spill(folder / "camera.json",
        edited(kScenarios / "calibrations/paper_table1.json", "1024, 1024", "1280, 1024"));
  const Outcome outcome = turntable_program(
      "run scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json --calibration " +
      (folder / "camera.json").string() + " --out " + (folder / "out").string());
  EXPECT_EQ(outcome.code, 2);
  EXPECT_NE(outcome.output.find("camera.json at /image_size_px"), std::string::npos)
      << outcome.output;
  EXPECT_NE(outcome.output.find("1280 x 1024"), std::string::npos) << outcome.output;
  EXPECT_FALSE(fs::exists(folder / "out"));
}

TEST(BadCalibration, PublishedTable1CountedDownwardIsRefusedByTheProgram) {
  TemporaryFolder folder;
  EXPECT_EQ(turntable_program("calibrate scenarios/calibrations/paper_table1.json").code, 0);
  spill(folder / "down.json",
        edited(kScenarios / "calibrations/paper_table1.json", "\"up\"", "\"down\""));
  const Outcome outcome = turntable_program("calibrate " + (folder / "down.json").string());
  EXPECT_EQ(outcome.code, 2);
  EXPECT_NE(outcome.output.find("left-handed"), std::string::npos) << outcome.output;
}

TEST(DamagedRun, IsNamedAndRefused) {
  TemporaryFolder folder;
  const std::string run = (folder / "run").string();
  ASSERT_EQ(turntable_program(
                "run scenarios/campaigns/quick.json --rig scenarios/rigs/ideal.json --out " + run)
                .code,
            0);
  fs::path image;
  for (const auto& entry : fs::directory_iterator(folder / "run/images"))
    if (image.empty() || entry.path() > image) image = entry.path();
  const std::string whole = slurp(image);
  const std::string poses = slurp(folder / "run/poses.csv");

  spill(image, whole.substr(0, whole.size() / 2));  // truncated
  Outcome outcome = turntable_program("evaluate " + run);
  EXPECT_EQ(outcome.code, 2);
  EXPECT_NE(outcome.output.find(image.filename().string()), std::string::npos) << outcome.output;
  spill(image, "");  // empty
  EXPECT_EQ(turntable_program("evaluate " + run).code, 2);
  fs::remove(image);
  EXPECT_EQ(turntable_program("evaluate " + run).code, 2);
  EXPECT_EQ(slurp(folder / "run/poses.csv"), poses);
  spill(image, whole);
  EXPECT_EQ(turntable_program("evaluate " + run).code, 0);

  const std::string plan = slurp(folder / "run/plan.json");
  spill(folder / "run/plan.json",
        edited(folder / "run/plan.json", "\"stage_mm\":120", "\"stage_mm\":121"));
  EXPECT_EQ(turntable_program("evaluate " + run).code, 2);
  spill(folder / "run/plan.json", plan);
}

}  // namespace
}  // namespace turntable
