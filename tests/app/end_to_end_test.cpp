// The quick campaign through the program: reference values, the same bytes twice, evaluation from
// what is archived.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <sstream>
#include <vector>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::Not;

const fs::path kSource = TURNTABLE_SOURCE_DIR;
constexpr const char* kTables[] = {"table1.csv", "table3.csv",           "table4.csv",
                                   "table5.csv", "quick_uniaxial_x.csv", "camera_solver.csv"};

Outcome run(const fs::path& out, const std::string& rig = "simulated", const std::string& more = "",
            const std::string& campaign = "campaigns/quick") {
  return turntable_program("run scenarios/" + campaign + ".json --rig scenarios/rigs/" + rig +
                           ".json --out " + out.string() + " " + more);
}

std::vector<std::vector<std::string>> read_csv(const fs::path& file) {
  std::istringstream in(slurp(file));
  std::vector<std::vector<std::string>> rows;
  for (std::string line; std::getline(in, line);) {
    std::vector<std::string> cells(1);
    for (const char c : line) {
      if (c == ',')
        cells.emplace_back();
      else
        cells.back() += c;
    }
    rows.push_back(cells);
  }
  return rows;
}

/// Column of a table by its name.
std::size_t column(const std::vector<std::vector<std::string>>& rows, const std::string& name) {
  for (std::size_t i = 0; i < rows.at(0).size(); ++i)
    if (rows[0][i] == name) return i;
  ADD_FAILURE() << "no column " << name;
  return 0;
}

TEST(QuickCampaign, AgreesWithTheReferenceTables) {
  TemporaryFolder folder;
  const Outcome outcome = run(folder / "run");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("simulated"), std::string::npos);
  // Of irt, the change against brown.
  EXPECT_THAT(slurp(folder / "run/tables/camera_solver.md"),
              ContainsRegex("\\| irt \\| aopit_ray \\|[^\n]*\\| brown \\|"));
  EXPECT_THAT(slurp(folder / "run/tables/camera_solver.tex"), HasSubstr("\\begin{tabular}"));
  EXPECT_NE(slurp(folder / "run/report.md").find("brown x posit = `posit_undistorted`"),
            std::string::npos);
  // The same seed gives the same images; another processor's floating point may move the last
  // digits of a centre.
  constexpr double kToleranceDeg = 2e-4;
  std::size_t compared = 0;
  for (const char* table : {"table3.csv", "table4.csv", "table5.csv", "quick_uniaxial_x.csv"}) {
    const auto ours = read_csv(folder / "run/tables" / table);
    const auto reference = read_csv(kSource / "results/reference/quick/tables" / table);
    ASSERT_EQ(ours.size(), reference.size()) << table;
    ASSERT_EQ(ours[0], reference[0]) << table;
    for (std::size_t i = 1; i < ours.size(); ++i)
      for (std::size_t j = 0; j < ours[i].size(); ++j) {
        const std::string& name = ours[0][j];
        if (name.ends_with("_deg") && !reference[i][j].empty() && !ours[i][j].empty()) {
          EXPECT_NEAR(std::stod(ours[i][j]), std::stod(reference[i][j]), kToleranceDeg)
              << table << " " << i << " " << name;
          ++compared;
        } else {
          EXPECT_EQ(ours[i][j], reference[i][j]) << table << " " << i << " " << name;
        }
      }
  }
  EXPECT_GT(compared, 150u);
}

TEST(QuickCampaign, GivesTheSameBytesInAnotherFolderAndFromEvaluateAndReport) {
  TemporaryFolder folder;
  ASSERT_EQ(run(folder / "a").code, 0);
  fs::create_directories(folder / "elsewhere/deep");
  ASSERT_EQ(run(folder / "elsewhere/deep/b").code, 0);
  const std::string poses = slurp(folder / "a/poses.csv");
  ASSERT_GT(poses.size(), 10000u);
  EXPECT_EQ(poses, slurp(folder / "elsewhere/deep/b/poses.csv"));
  EXPECT_EQ(slurp(folder / "a/calibration.json"),
            slurp(folder / "elsewhere/deep/b/calibration.json"));
  std::map<std::string, std::string> tables;
  for (const char* table : kTables) {
    tables[table] = slurp(folder / "a/tables" / table);
    EXPECT_FALSE(tables[table].empty()) << table;
    EXPECT_EQ(tables[table], slurp(folder / "elsewhere/deep/b/tables" / table)) << table;
  }
  for (const std::string verb : {"evaluate", "report"}) {
    fs::remove_all(folder / "a/tables");
    fs::remove(folder / "a/report.md");
    ASSERT_EQ(turntable_program(verb + " " + (folder / "a").string()).code, 0);
    for (const char* table : kTables)
      EXPECT_EQ(tables[table], slurp(folder / "a/tables" / table)) << verb << table;
    EXPECT_EQ(poses, slurp(folder / "a/poses.csv"));
    EXPECT_TRUE(fs::exists(folder / "a/report.md"));
  }
}

TEST(QuickCampaign, GivesTheSameTablesWhateverIsArchived) {
  TemporaryFolder folder;
  ASSERT_EQ(run(folder / "regions").code, 0);
  ASSERT_EQ(run(folder / "full", "simulated", "--images full").code, 0);
  EXPECT_EQ(slurp(folder / "regions/poses.csv"), slurp(folder / "full/poses.csv"));
  // Without images: the camera from the first run, the spots from the journal.
  const Outcome none =
      run(folder / "none", "simulated",
          "--images none --calibration " + (folder / "regions/calibration.json").string());
  ASSERT_EQ(none.code, 0) << none.output;
  EXPECT_EQ(slurp(folder / "regions/poses.csv"), slurp(folder / "none/poses.csv"));
  EXPECT_TRUE(!fs::exists(folder / "none/images") || fs::is_empty(folder / "none/images"));
  EXPECT_EQ(turntable_program("report " + (folder / "none").string()).code, 0);
}

/// simulated.json with a camera that replays the images of a run, by these keys.
fs::path replaying_rig(const TemporaryFolder& folder, const std::string& keys) {
  std::string rig = slurp(kSource / "scenarios/rigs/simulated.json");
  const std::string model = "\"model\": \"simulated\"";
  rig.replace(rig.find(model), model.size(), R"("model": "folder", "replay": true, )" + keys);
  const std::string sweep = "\"../calibration_sweep.json\"";
  rig.replace(rig.find(sweep), sweep.size(),
              "\"" + (kSource / "scenarios/calibration_sweep.json").string() + "\"");
  spill(folder / "replay.json", rig);
  return folder / "replay.json";
}

Outcome replay(const TemporaryFolder& folder, const fs::path& rig, const std::string& out) {
  return turntable_program("run scenarios/campaigns/quick.json --assume-mounted --rig " +
                           rig.string() + " --out " + (folder / out).string());
}

TEST(QuickCampaign, GivesTheSameTablesFromImagesTakenEarlier) {
  TemporaryFolder folder;
  ASSERT_EQ(run(folder / "taken", "simulated", "--images full").code, 0);
  // The archive's names begin with the number of the pose, so their order is the plan's.
  const Outcome by_name = replay(
      folder, replaying_rig(folder, R"("folder": "taken/images", "files": "*-*-?.png")"), "again");
  ASSERT_EQ(by_name.code, 0) << by_name.output;
  EXPECT_EQ(slurp(folder / "taken/poses.csv"), slurp(folder / "again/poses.csv"));
  for (const char* table : kTables)
    EXPECT_EQ(slurp(folder / "taken/tables" / table), slurp(folder / "again/tables" / table))
        << table;

  // A lab's own names: every pose finds its file by a layout, and one that is missing is found
  // before anything moves.
  std::vector<fs::path> images;
  for (const auto& entry : fs::directory_iterator(folder / "taken/images"))
    images.push_back(entry.path());
  for (const fs::path& image : images) {
    const std::string name = image.filename().string();  // index-id-image.png
    fs::rename(image, folder / "taken/images" /
                          ("pose_" + std::to_string(std::stoi(name)) + "_" + name.substr(24)));
  }
  const fs::path rig =
      replaying_rig(folder, R"("folder": "taken/images", "layout": "pose_{index}_{image}.png")");
  ASSERT_EQ(replay(folder, rig, "laid_out").code, 0);
  EXPECT_EQ(slurp(folder / "taken/poses.csv"), slurp(folder / "laid_out/poses.csv"));
  fs::remove(folder / "taken/images/pose_7_1.png");
  const Outcome missing = replay(folder, rig, "missing");
  EXPECT_EQ(missing.code, 2) << missing.output;
  EXPECT_NE(missing.output.find("pose_7_1.png of pose 7"), std::string::npos) << missing.output;
}

TEST(QuickCampaign, WithAnotherSeedGivesOtherNumbers) {
  TemporaryFolder folder;
  std::string rig = slurp(kSource / "scenarios/rigs/simulated.json");
  rig.replace(rig.find("20190511"), 8, "20190512");
  rig.replace(rig.find("\"../calibration_sweep.json\""), 27,
              "\"" + (kSource / "scenarios/calibration_sweep.json").string() + "\"");
  spill(folder / "rig.json", rig);
  ASSERT_EQ(run(folder / "a").code, 0);
  ASSERT_EQ(turntable_program("run scenarios/campaigns/quick.json --rig " +
                              (folder / "rig.json").string() + " --out " + (folder / "b").string())
                .code,
            0);
  EXPECT_NE(slurp(folder / "a/poses.csv"), slurp(folder / "b/poses.csv"));
}

TEST(PaperCampaign, OnIdealMechanicsStaysBelowAHundredthOfADegreeInEveryScenario) {
  TemporaryFolder folder;
  const Outcome outcome = run(folder / "ideal", "ideal", "", "campaigns/paper_2019");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  std::size_t rows = 0;
  for (const char* table : {"table3.csv", "table4.csv", "table5.csv", "uniaxial_x.csv"}) {
    const auto csv = read_csv(folder / "ideal/tables" / table);
    for (std::size_t i = 1; i < csv.size(); ++i) {
      if (csv[i][column(csv, "source")] != "ours") continue;
      EXPECT_EQ(csv[i][column(csv, "failed")], "0");
      if (!csv[i][column(csv, "method")].starts_with("aopit")) continue;
      EXPECT_LT(std::stod(csv[i][column(csv, "rmse_total_deg")]), 0.01) << table << " row " << i;
      ++rows;
    }
  }
  EXPECT_EQ(rows, 2u * (3 + 3 + 2 + 3));  // two solvers, every repeat of every scenario
}

TEST(SingleScenario, CalibratesFirstAndReportsTheChosenSolversOnly) {
  TemporaryFolder folder;
  const Outcome outcome =
      run(folder / "run", "simulated", "--solver aopit_ray,posit", "quick/triaxial_xyz");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("calibrated first"), std::string::npos);
  const auto csv = read_csv(folder / "run/tables/table5.csv");
  std::map<std::string, int> methods;
  for (std::size_t i = 1; i < csv.size(); ++i)
    if (csv[i][0] == "ours") ++methods[csv[i][1]];
  EXPECT_EQ(methods, (std::map<std::string, int>{{"aopit_ray", 1}, {"posit", 1}}));
  const std::string table = slurp(folder / "run/tables/table5.csv");
  ASSERT_EQ(turntable_program("report " + (folder / "run").string()).code, 0);
  EXPECT_EQ(slurp(folder / "run/tables/table5.csv"), table);  // the same solvers

  // One solver has none to be compared with, and nothing stays of two.
  EXPECT_TRUE(fs::exists(folder / "run/tables/paired.csv"));
  const fs::path figures = folder / "run/figures";
  for (const char* file : {"figure18_noise.csv", "figure18_noise.gp", "mine.gp"})
    spill(figures / file, "of an earlier one");
  ASSERT_EQ(turntable_program("evaluate --solver ml_ray " + (folder / "run").string()).code, 0);
  for (const char* file : {"paired.csv", "paired.md", "paired.tex"})
    EXPECT_FALSE(fs::exists(folder / "run/tables" / file)) << file;
  EXPECT_FALSE(fs::exists(figures / "figure18_noise.csv"));
  EXPECT_FALSE(fs::exists(figures / "figure18_noise.gp"));
  for (const char* file : {"mine.gp", "error_angle.csv", "error_angle_median.csv"})
    EXPECT_TRUE(fs::exists(figures / file)) << file;
  const Outcome verified = turntable_program("verify " + (folder / "run").string());
  EXPECT_EQ(verified.code, 0) << verified.output;
}

TEST(SingleScenario, KeepsTheCalibrationThatItWasGivenAndATitleAsItStands) {
  TemporaryFolder folder;
  ASSERT_EQ(run(folder / "first", "simulated", "--solver ml_ray", "quick/uniaxial_x").code, 0);
  const fs::path given = folder / "first/calibration.json";
  std::string scenario = slurp(kSource / "scenarios/quick/uniaxial_x.json");
  const std::size_t title = scenario.find("\"title\": \"") + 10;
  scenario.replace(title, scenario.find('"', title) - title, "Pitch in [-30, 30) | *deg*");
  spill(folder / "scenario.json", scenario);
  const std::string at = (folder / "run").string();
  const Outcome taken =
      turntable_program("run " + (folder / "scenario.json").string() +
                        " --rig scenarios/rigs/simulated.json --solver ml_ray --calibration " +
                        given.string() + " --out " + at);
  ASSERT_EQ(taken.code, 0) << taken.output;
  const std::string page = slurp(folder / "run/report.html"),
                    report = slurp(folder / "run/report.md");
  EXPECT_THAT(page, HasSubstr("<h1"));
  EXPECT_THAT(page, HasSubstr("Pitch in [-30, 30) | *deg*"));
  EXPECT_THAT(page, Not(HasSubstr("![")));
  EXPECT_THAT(report, HasSubstr("--solver ml_ray --calibration "));
  EXPECT_THAT(report, HasSubstr("| calibration | the one that the run began with"));

  std::string other = slurp(given);
  other.insert(other.find(": \"", other.find("\"source\"")) + 3, "other ");
  spill(folder / "other.json", other);
  ASSERT_EQ(
      turntable_program("evaluate " + at + " --calibration " + (folder / "other.json").string())
          .code,
      0);
  EXPECT_THAT(slurp(folder / "run/report.md"),
              HasSubstr("**The calibration of the camera is another one"));
  EXPECT_EQ(slurp(folder / "run/given_calibration.json"), slurp(given));
  EXPECT_EQ(turntable_program("verify " + at).code, 0);
  ASSERT_EQ(turntable_program("evaluate " + at).code, 0);
  EXPECT_EQ(slurp(folder / "run/calibration.json"), slurp(given))
      << "a plain evaluation goes back to it";
  EXPECT_THAT(slurp(folder / "run/report.md"), Not(HasSubstr("another one than")));
}

TEST(CameraThatLosesSight, FailsPosesWithoutDroppingThem) {
  // A rig whose LEDs are too weak to be told from the ground: every pose is a failure, and the
  // tables say so.
  TemporaryFolder folder;
  ASSERT_EQ(run(folder / "good").code, 0);
  std::string rig = slurp(kSource / "scenarios/rigs/simulated.json");
  rig.replace(rig.find("\"led_peak_grey\": 200"), 20, "\"led_peak_grey\": 14 ");
  spill(folder / "rig.json", rig);
  const Outcome outcome = turntable_program("run scenarios/quick/triaxial_xyz.json --rig " +
                                            (folder / "rig.json").string() + " --calibration " +
                                            (folder / "good/calibration.json").string() +
                                            " --out " + (folder / "blind").string());
  EXPECT_EQ(outcome.code, 4) << outcome.output;
  const auto csv = read_csv(folder / "blind/tables/table5.csv");
  int rows = 0;
  for (std::size_t i = 1; i < csv.size(); ++i) {
    if (csv[i][0] != "ours") continue;
    ++rows;
    EXPECT_EQ(csv[i][column(csv, "poses")], "8");
    EXPECT_EQ(csv[i][column(csv, "failed")], "8");
    EXPECT_EQ(csv[i][column(csv, "rmse_total_deg")], "");
  }
  EXPECT_EQ(rows, 5);  // one per solver that is shown by default
}

}  // namespace
}  // namespace turntable
