#include "src/core/target_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "src/core/errors.h"
#include "src/core/rig_file.h"
#include "tests/support/message_of.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

const std::filesystem::path kTargetScenarios =
    std::filesystem::path(TURNTABLE_SOURCE_DIR) / "scenarios";

TEST(TargetFile, EveryShippedOneLoads) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kTargetScenarios / "targets")) {
    if (entry.path().extension() != ".json") continue;
    EXPECT_GE(load_target(entry.path()).points_mm.size(), 4u) << entry.path();
    ++count;
  }
  EXPECT_GE(count, 2);
}

TEST(TargetFile, IsARigFilesTargetToo) {
  const TargetFile of_rig = load_target(kTargetScenarios / "rigs/simulated.json");
  EXPECT_EQ(of_rig.points_mm, load_target(kTargetScenarios / "targets/published.json").points_mm);
  EXPECT_EQ(of_rig.points_mm,
            load_rig_file(kTargetScenarios / "rigs/simulated.json").target.points_mm);
}

TEST(TargetFile, MayLieInAPlaneAndStateItsUncertainty) {
  TemporaryFolder folder;
  spill(folder / "flat.json",
        R"({"format": "turntable-target/1", "uncertainty_mm": 0.05,
            "points_mm": [[1, 2, 3], [60, 0, 3], [0, 60, 3], [-30, -40, 3]]})");
  const TargetFile target = load_target(folder / "flat.json");
  EXPECT_DOUBLE_EQ(target.uncertainty_mm, 0.05);
  EXPECT_EQ(target.title, "flat");
  EXPECT_EQ(target.points_mm[0], Eigen::Vector3d(1, 2, 3));
}

TEST(TargetFile, EverySlipIsNamedWithItsPlace) {
  TemporaryFolder folder;
  const std::string format = R"("format": "turntable-target/1", )";
  for (const auto& [text, says] : std::vector<std::pair<std::string, std::string>>{
           {"{" + format + R"("points_mm": [[0,0,0],[1,0,0],[0,1,0]]})", "at /points_mm"},
           {"{" + format + R"("points_mm": [[0,0,0],[1,0,0],[0,1,0],[0,1]]})", "at /points_mm/3"},
           {"{" + format + R"("points_mm": [[0,0,0],[1,0,0],[0,1,0],[1,0,0]]})",
            "at /points_mm/3: stands where point 1 does"},
           {"{" + format + R"("points": []})", "unknown key \"points\""},
           {"{" + format +
                R"("points_mm": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]], "uncertainty_mm": -1})",
            "at /uncertainty_mm"},
           {R"({"format": "turntable-campaign/1"})", "a campaign file, allowed"},
           {R"({"points_mm": []})", "at /format"},
           {"", "is empty"}}) {
    spill(folder / "target.json", text);
    const std::string message =
        message_of<ConfigError>([&] { load_target(folder / "target.json"); });
    EXPECT_THAT(message, HasSubstr("target.json"));
    EXPECT_THAT(message, HasSubstr(says));
  }
  EXPECT_THAT(message_of<ConfigError>([&] { load_target(folder / "nowhere.json"); }),
              HasSubstr("cannot be read"));
}

}  // namespace
}  // namespace turntable
