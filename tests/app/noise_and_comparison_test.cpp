// "turntable evaluate RUN --noise" and "turntable report A B" on the quick campaign.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

/// The only comparison that lies in a run.
fs::path comparison_in(const fs::path& run) {
  fs::path found;
  for (const auto& entry : fs::directory_iterator(run))
    if (entry.path().filename().string().starts_with("compare_")) {
      EXPECT_TRUE(found.empty()) << "another one: " << entry.path();
      found = entry.path();
    }
  return found;
}

/// Runs the quick campaign once for all tests of this file; each has a copy.
class QuickRun : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    shared_ = new TemporaryFolder;
    first_ = turntable_program(
        "run scenarios/campaigns/quick.json --rig scenarios/rigs/simulated.json --out " +
        (*shared_ / "run").string());
  }
  static void TearDownTestSuite() { delete shared_; }
  void SetUp() override {
    ASSERT_EQ(first_.code, 0) << first_.output;
    fs::copy(*shared_ / "run", run, fs::copy_options::recursive);
  }
  Outcome verb(const std::string& arguments, const std::string& before = "") const {
    return turntable_program(arguments, before);
  }

  TemporaryFolder folder;
  const fs::path run = folder / "run";

 private:
  inline static TemporaryFolder* shared_ = nullptr;
  inline static Outcome first_;
};

std::string lines_with(const std::string& text, const std::string& with) {
  std::istringstream in(text);
  std::string out;
  for (std::string line; std::getline(in, line);)
    if (line.find(with) != std::string::npos) out += line + "\n";
  return out;
}

TEST_F(QuickRun, WithNoiseIsEvaluatedTheSameWayByEveryVerbAndOnOneCore) {
  const std::string poses = slurp(run / "poses.csv");
  const Outcome outcome = verb("evaluate " + run.string() + " --noise 30,10 --noise-seed 5");
  EXPECT_LE(outcome.code, 4) << outcome.output;
  EXPECT_NE(outcome.code, 2) << outcome.output;
  EXPECT_EQ(slurp(run / "poses.csv"), poses);
  // Sigma 0 is poses.csv again.
  std::string zero;
  std::istringstream noise(lines_with(slurp(run / "noise_poses.csv"), "quick_triaxial_xyz"));
  for (std::string line; std::getline(noise, line);)
    if (line.starts_with("0,")) zero += line.substr(2) + "\n";
  EXPECT_EQ(zero, lines_with(poses, "quick_triaxial_xyz"));
  EXPECT_GT(zero.size(), 1000u);

  const std::vector<fs::path> files{"noise_spots.csv", "noise_poses.csv",  "tables/noise.csv",
                                    "tables/noise.md", "tables/noise.tex", "evaluation.json"};
  std::vector<std::string> made;
  for (const fs::path& file : files) {
    made.push_back(slurp(run / file));
    EXPECT_GT(made.back().size(), 300u) << file;
  }
  EXPECT_THAT(made.back(), HasSubstr("\"sigmas_grey\""));
  EXPECT_THAT(slurp(run / "report.md"), HasSubstr("## Noise in the images"));
  const std::string pixels = slurp(run / "figures/figure17_noise.csv");
  EXPECT_GT(pixels.size(), 10000u);
  EXPECT_GT(slurp(run / "figures/figure18_noise.csv").size(), 1000u);
  if (fs::exists(run / "figures/figure14_quick_uniaxial_x.svg")) {
    EXPECT_TRUE(fs::exists(run / "figures/figure17_noise.svg"));
    EXPECT_TRUE(fs::exists(run / "figures/figure18_noise.svg"));
    EXPECT_THAT(slurp(run / "report.html"), Not(HasSubstr("unlinked\"")));
  }

  const Outcome verified = verb("verify " + run.string());
  EXPECT_EQ(verified.code, 0) << verified.output;
  const auto the_same = [&](const std::string& after) {
    for (std::size_t i = 0; i < files.size(); ++i)
      EXPECT_EQ(slurp(run / files[i]), made[i]) << after << " " << files[i];
    EXPECT_EQ(slurp(run / "figures/figure17_noise.csv"), pixels) << after;
  };
  EXPECT_EQ(
      verb("evaluate " + run.string() + " --noise 10,30,10 --noise-seed 5", "taskset -c 0").code,
      outcome.code);
  the_same("one core");
  // From the stored points: no image is read.
  fs::rename(run / "images", folder / "images");
  EXPECT_EQ(verb("report " + run.string() + " --no-pdf").code, 0);
  the_same("report");
  EXPECT_THAT(slurp(run / "report.md"), HasSubstr("## Noise in the images"));
  fs::rename(folder / "images", run / "images");

  std::string altered = made[1];
  altered[altered.size() / 2] ^= 1;
  spill(run / "noise_poses.csv", altered);
  EXPECT_EQ(verb("verify " + run.string()).code, 4);
  fs::remove(run / "noise_spots.csv");
  const Outcome missing = verb("report " + run.string() + " --no-pdf");
  EXPECT_EQ(missing.code, 2);
  EXPECT_THAT(missing.output, HasSubstr("noise_spots.csv"));

  // An evaluation without it leaves nothing of it.
  EXPECT_EQ(verb("evaluate " + run.string()).code, 0);
  for (const fs::path& file : files)
    EXPECT_EQ(fs::exists(run / file), file == "evaluation.json") << file;
  EXPECT_FALSE(fs::exists(run / "figures/figure17_noise.csv"));
  EXPECT_THAT(slurp(run / "report.md"), Not(HasSubstr("## Noise in the images")));
  const Outcome clean = verb("verify " + run.string());
  EXPECT_EQ(clean.code, 0) << clean.output;
}

TEST_F(QuickRun, NoiseThatMeansNothingIsRefusedBeforeTheWork) {
  const std::string report = slurp(run / "report.md");
  const auto refused = [&](const std::string& options, const std::string& says) {
    const Outcome outcome = verb("evaluate " + run.string() + " " + options);
    EXPECT_EQ(outcome.code, 2) << options << ": " << outcome.output;
    EXPECT_THAT(outcome.output, HasSubstr(says)) << options;
  };
  refused("--noise -3", "--noise");
  refused("--noise=-3", "--noise");
  refused("--noise 0", "--noise");
  refused("--noise 5,abc", "--noise");
  refused("--noise 5,300", "--noise");
  refused("--noise nan", "found nan, allowed: a number from 0.01 to 255");
  refused("--noise 5,nan", "found nan");
  refused("--noise", "--noise");
  refused("--scenario quick_triaxial_xyz", "--noise");
  refused("--noise 5 --noise-seed -1", "--noise-seed");
  refused("--noise 5 --scenario quick_triaxial", "quick_biaxial_xz");
  EXPECT_EQ(slurp(run / "report.md"), report);
  EXPECT_FALSE(fs::exists(run / "noise_spots.csv"));
}

TEST_F(QuickRun, WithoutImagesHasNoNoise) {
  const fs::path none = folder / "none";
  ASSERT_EQ(verb("run scenarios/campaigns/quick.json --rig scenarios/rigs/simulated.json --images "
                 "none --calibration " +
                 (run / "calibration.json").string() + " --out " + none.string())
                .code,
            0);
  const Outcome outcome = verb("evaluate " + none.string() + " --noise 5");
  EXPECT_EQ(outcome.code, 2);
  EXPECT_THAT(outcome.output, HasSubstr("--images regions"));
}

TEST_F(QuickRun, IsSetBesideAnotherOneWithWhatDiffers) {
  std::string rig = slurp(fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/rigs/simulated.json");
  const auto replace = [&](const std::string& from, const std::string& to) {
    ASSERT_NE(rig.find(from), std::string::npos) << from;
    rig.replace(rig.find(from), from.size(), to);
  };
  replace(
      "\"../calibration_sweep.json\"",
      "\"" + (fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/calibration_sweep.json").string() + "\"");
  const auto seed = rig.find("\"seed\":");
  ASSERT_NE(seed, std::string::npos);
  rig.replace(seed, rig.find_first_of(",\n}", seed) - seed, "\"seed\": 77");
  spill(folder / "rig.json", rig);
  const fs::path other = folder / "other";
  const Outcome taken = verb("run scenarios/campaigns/quick.json --rig " +
                             (folder / "rig.json").string() + " --out " + other.string());
  ASSERT_EQ(taken.code, 0) << taken.output;
  const std::string poses = slurp(run / "poses.csv"), report = slurp(run / "report.md");

  const Outcome outcome = verb("report " + run.string() + " " + other.string() + " --no-pdf");
  EXPECT_EQ(outcome.code, 0) << outcome.output;
  const fs::path compared = comparison_in(run);
  EXPECT_THAT(compared.filename().string(), ::testing::StartsWith("compare_other_"));
  EXPECT_THAT(outcome.output, HasSubstr(compared.filename().string() + "/comparison.html"));
  const std::string table = slurp(compared / "tables/comparison.csv");
  EXPECT_THAT(table, HasSubstr("quick_triaxial_xyz,ml_ray,paired,8,8,0,0,"));
  EXPECT_THAT(table, HasSubstr("change_lower_deg"));
  EXPECT_THAT(slurp(compared / "tables/bias.csv"), HasSubstr("bias_change_yaw_upper_deg"));
  const std::string facts = slurp(compared / "tables/differences.csv");
  EXPECT_THAT(facts, HasSubstr("/simulation/seed"));
  EXPECT_THAT(facts, HasSubstr("calibration,/sha256"));
  EXPECT_THAT(facts, Not(HasSubstr("scenario file")));
  const std::string text = slurp(compared / "comparison.md");
  EXPECT_LT(text.find("## What differs"), text.find("## Errors"));
  EXPECT_GT(slurp(compared / "comparison.html").size(), 10000u);
  EXPECT_GT(slurp(compared / "figures/comparison_change.csv").size(), 500u);
  // The runs are as they were.
  EXPECT_EQ(slurp(run / "poses.csv"), poses);
  EXPECT_EQ(slurp(run / "report.md"), report);
  EXPECT_TRUE(comparison_in(other).empty());
  EXPECT_THAT(text,
              AllOf(HasSubstr("A is run (simulated), begun 20"),
                    HasSubstr("B is other (simulated), begun 20"), HasSubstr(other.string())));
  const Outcome inside =
      verb("report " + run.string() + " " + other.string() + " --no-pdf --out " + other.string());
  EXPECT_EQ(inside.code, 2);
  EXPECT_THAT(inside.output, HasSubstr("which is a run's own folder"));
  EXPECT_EQ(verb("verify " + run.string()).code, 0);

  // With itself nothing differs; a PDF of an earlier comparison goes, for it would tell of another.
  fs::create_directories(folder / "itself");
  spill(folder / "itself/comparison.pdf", "of before");
  const Outcome itself = verb("report " + run.string() + " " + run.string() + " --no-pdf --out " +
                              (folder / "itself").string());
  EXPECT_EQ(itself.code, 0) << itself.output;
  EXPECT_FALSE(fs::exists(folder / "itself/comparison.pdf"));
  EXPECT_THAT(slurp(folder / "itself/comparison.md"), HasSubstr("Nothing: rig, scenarios"));
  EXPECT_THAT(itself.output, Not(HasSubstr("B is better")));
  EXPECT_THAT(itself.output, HasSubstr("B is the same within 1 %"));
  EXPECT_THAT(itself.output, HasSubstr("are the same run"));
}

TEST_F(QuickRun, IsComparedWithOneThatWasCutOffAsFarAsThatGoes) {
  const fs::path cut = folder / "cut";
  fs::copy(run, cut, fs::copy_options::recursive);
  const std::string journal = slurp(run / "journal.jsonl");
  spill(cut / "journal.jsonl", journal.substr(0, journal.size() / 2));
  const Outcome outcome = verb("report " + cut.string() + " " + run.string() + " --no-pdf");
  EXPECT_EQ(outcome.code, 4) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("not compared: 0 poses of A"));
  EXPECT_THAT(outcome.output, HasSubstr("A ended early: "));
  EXPECT_THAT(outcome.output, HasSubstr("journal.jsonl"));  // its last line is no whole one
  EXPECT_THAT(outcome.output, Not(HasSubstr("nan")));
  const fs::path compared = comparison_in(cut);
  EXPECT_THAT(slurp(compared / "comparison.md"),
              AllOf(HasSubstr("a run has measured no pose"), Not(HasSubstr("nan"))));
  EXPECT_THAT(slurp(compared / "tables/comparison.csv"), HasSubstr("missing,0,"));
  EXPECT_THAT(slurp(compared / "tables/comparison.tex"), Not(HasSubstr("nan")));
  const Outcome report = verb("report " + cut.string() + " --no-pdf");
  EXPECT_EQ(report.code, 4) << report.output;
  EXPECT_THAT(report.output, AllOf(HasSubstr("total RMSE - deg"), Not(HasSubstr("nan"))));
  EXPECT_THAT(slurp(cut / "report.md"), HasSubstr("the run ended early: killed"));
}

TEST_F(QuickRun, IdentifiedElsewhereNamesTheFilesOfItsRigAndWhichAreNotThere) {
  const fs::path elsewhere = folder / "elsewhere.json";
  const Outcome found =
      verb("identify " + run.string() + " --rig-out " + elsewhere.string(), "cd /;");
  EXPECT_EQ(found.code, 0) << found.output;
  EXPECT_THAT(found.output, Not(HasSubstr("which is not there")));
  const std::string sweep = "scenarios/calibration_sweep.json";
  EXPECT_THAT(slurp(elsewhere), HasSubstr(sweep));

  fs::create_directories(folder / "lab");
  fs::copy(fs::path(TURNTABLE_SOURCE_DIR) / "scenarios", folder / "lab/scenarios",
           fs::copy_options::recursive);
  const fs::path taken = folder / "taken";
  ASSERT_EQ(verb("run scenarios/campaigns/quick.json --rig scenarios/rigs/simulated.json --out " +
                     taken.string(),
                 "cd " + (folder / "lab").string() + ";")
                .code,
            0);
  fs::remove(folder / "lab" / sweep);
  const Outcome lost =
      verb("identify " + taken.string() + " --rig-out " + (folder / "lost.json").string(), "cd /;");
  EXPECT_EQ(lost.code, 0) << lost.output;
  EXPECT_THAT(lost.output,
              HasSubstr((fs::canonical(folder / "lab") / sweep).string() + ", which is not there"));
}

TEST_F(QuickRun, IsNotComparedWithWhatItCannotBe) {
  const auto refused = [&](const std::string& arguments, const std::string& says) {
    const Outcome outcome = verb("report " + arguments + " --no-pdf");
    EXPECT_EQ(outcome.code, 2) << arguments << ": " << outcome.output;
    EXPECT_THAT(outcome.output, HasSubstr(says)) << arguments;
  };
  const std::string name = run.string();
  refused(name + " " + (folder / "nowhere").string(), "nowhere");
  refused(name + " " + name + " " + name, "runs");
  refused(name + " " + name + " --beside " + name, "--beside");
  refused(name + " --out " + (folder / "out").string(), "--out");
  const fs::path single = folder / "single";
  ASSERT_EQ(verb("run scenarios/uniaxial_z.json --rig scenarios/rigs/simulated.json --images none "
                 "--calibration " +
                 (run / "calibration.json").string() + " --out " + single.string())
                .code,
            0);
  refused(name + " " + single.string(), "no attitude scenario in common");
  fs::remove(single / "calibration.json");
  refused(name + " " + single.string(), "turntable evaluate");
  refused(single.string(), "turntable evaluate");
  EXPECT_FALSE(fs::exists(single / "report.pdf"));
  spill(folder / "file", "");
  for (const char* out : {"file", "file/", "file/below"})
    refused(name + " " + name + " --out " + (folder / out).string(), "is a file");
}

}  // namespace
}  // namespace turntable
