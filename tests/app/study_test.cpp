// "turntable study" as somebody uses it who has no rig yet, and its misuses.
#include <gtest/gtest.h>

#include <vector>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

Outcome run_study(const fs::path& out, const std::string& options) {
  return turntable_program("study --out \"" + out.string() + "\" " + options);
}

TEST(Study, WritesTextTablesAndFiguresOfATarget) {
  TemporaryFolder folder;
  const std::string options =
      "--target scenarios/rigs/simulated.json --poses 80 --solver ml_ray,posit_undistorted";
  const Outcome first = run_study(folder / "a", options);
  ASSERT_EQ(first.code, 0) << first.output;
  EXPECT_NE(first.output.find("study.html"), std::string::npos);
  for (const char* file :
       {"study.md", "study.html", "tables/noise.csv", "tables/basin.csv", "tables/basin_map.csv",
        "figures/noise_simulated_general.svg", "figures/noise_simulated_half_turn.svg",
        "figures/basin_view_angle.svg", "figures/basin_distance.svg",
        "figures/basin_depth_ratio.svg", "figures/basin_noise.svg", "figures/basin_map.svg"})
    EXPECT_GT(slurp(folder / "a" / file).size(), 500u) << file;
  const std::string text = slurp(folder / "a/study.md");
  for (const char* words : {"Synthetic, at point level", "Seed 1; 80 poses", "f = 1945 px",
                            "Camera 550 mm above M0", "| ml_ray |"})
    EXPECT_NE(text.find(words), std::string::npos) << words;
  // Nobody asked for others, and the target was given.
  EXPECT_EQ(text.find("aopit"), std::string::npos);
  EXPECT_EQ(text.find("corner_75"), std::string::npos);

  ASSERT_EQ(run_study(folder / "b", options).code, 0);
  for (const char* file : {"study.md", "tables/noise.csv", "tables/basin.csv"})
    EXPECT_EQ(slurp(folder / "a" / file), slurp(folder / "b" / file)) << file;
  // Over an earlier one, with another seed and camera.
  ASSERT_EQ(run_study(folder / "b", options + " --seed 2 --distance 800 --focal 2500").code, 0);
  EXPECT_NE(slurp(folder / "a/tables/noise.csv"), slurp(folder / "b/tables/noise.csv"));
  EXPECT_NE(slurp(folder / "b/study.md").find("Camera 800 mm above M0, f = 2500 px"),
            std::string::npos);
}

TEST(Study, LeavesNothingOfAnEarlierStudyOfAnotherTarget) {
  TemporaryFolder folder;
  const std::string few = " --poses 40 --solver ml_ray --target scenarios/";
  ASSERT_EQ(run_study(folder / "a", few + "rigs/simulated.json").code, 0);
  ASSERT_TRUE(fs::exists(folder / "a/figures/noise_simulated_general.csv"));
  ASSERT_EQ(run_study(folder / "a", few + "targets/corner_75mm.json").code, 0);
  for (const auto& entry : fs::recursive_directory_iterator(folder / "a"))
    EXPECT_EQ(entry.path().filename().string().find("simulated"), std::string::npos)
        << entry.path();
  EXPECT_TRUE(fs::exists(folder / "a/figures/noise_corner_75mm_general.csv"));
}

TEST(Study, TakesSomebodysCameraAndSaysWhereTheTargetDoesNotFitIt) {
  TemporaryFolder folder;
  spill(folder / "metres.json",
        R"({"format": "turntable-target/1", "title": "in metres by mistake", "points_mm":
           [[0, 0, 0], [0.0586, 0.013, -0.04], [-0.0406, 0.0442, -0.04], [-0.018, -0.0572, -0.04]]})");
  const Outcome tiny = run_study(folder / "a", "--poses 40 --solver ml_ray --target \"" +
                                                   (folder / "metres.json").string() + "\"");
  EXPECT_EQ(tiny.code, 0) << tiny.output;
  EXPECT_NE(tiny.output.find("Are its points in millimetres"), std::string::npos) << tiny.output;
  const std::string target = "--poses 40 --solver ml_ray --target scenarios/rigs/simulated.json ";
  const Outcome wide = run_study(folder / "b", target + "--image-size 1920,1200");
  EXPECT_EQ(wide.output.find("Are its points"), std::string::npos) << wide.output;
  EXPECT_EQ(wide.output.find("image's edge"), std::string::npos) << wide.output;
  EXPECT_NE(slurp(folder / "b/study.md").find("f = 1945 px, 960 px (26.3 deg) from the axis"),
            std::string::npos);
  const Outcome narrow = run_study(folder / "c", target + "--image-size 640,480");
  EXPECT_NE(narrow.output.find("the image's edge is at 320 px"), std::string::npos)
      << narrow.output;
}

TEST(Study, RefusesWhatItCannotStudyAndWritesNothing) {
  TemporaryFolder folder;
  struct Slip {
    std::string options;
    std::vector<std::string> says;
  };
  for (const Slip& slip : std::vector<Slip>{
           {"--solver magic", {"--solver", "magic", "ml_ray"}},
           {"--target nowhere.json", {"nowhere.json"}},
           {"--target scenarios/uniaxial_z.json", {"uniaxial_z.json", "/format", "scenario"}},
           {"--poses 0", {"--poses"}},
           {"--poses many", {"--poses"}},
           {"--seed -1", {"--seed", "0 to 9007199254740991"}},
           {"--image-size 1920", {"--image-size"}},
           {"--image-size 1920,0", {"--image-size"}},
           {"--focal 0", {"--focal"}},
           {"--distance 60", {"--distance", "60 mm", "90.2 mm"}},
           {"surplus", {"surplus"}},
       }) {
    const Outcome outcome = run_study(folder / "out", slip.options);
    EXPECT_EQ(outcome.code, 2) << slip.options << ": " << outcome.output;
    for (const std::string& words : slip.says)
      EXPECT_NE(outcome.output.find(words), std::string::npos)
          << "no \"" << words << "\" in: " << outcome.output;
    EXPECT_FALSE(fs::exists(folder / "out")) << slip.options;
  }
  // Of a study and somebody's own.
  fs::create_directories(folder / "mixed/figures");
  spill(folder / "mixed/study.md", "a study");
  spill(folder / "mixed/figures/noise_old.svg", "a figure");
  for (const char* own : {"letter.txt", "figures/photo.png", "tables"}) {
    spill(folder / "mixed" / own, "mine");
    const Outcome outcome = run_study(folder / "mixed", "--poses 40");
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_NE(outcome.output.find(own), std::string::npos) << outcome.output;
    EXPECT_EQ(slurp(folder / "mixed" / own), "mine");
    EXPECT_EQ(slurp(folder / "mixed/figures/noise_old.svg"), "a figure");
    fs::remove(folder / "mixed" / own);
  }
  fs::create_directory(folder / "full");
  spill(folder / "full/letter.txt", "mine");
  EXPECT_EQ(run_study(folder / "full", "--poses 40").code, 2);
  EXPECT_FALSE(fs::exists(folder / "full/study.md"));
  EXPECT_EQ(run_study(folder / "full/letter.txt", "--poses 40").code, 2);
  EXPECT_EQ(run_study(folder / "full/letter.txt/below", "--poses 40").code, 2);
}

}  // namespace
}  // namespace turntable
