#include "src/report/trajectory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "src/core/errors.h"
#include "tests/support/message_of.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

const std::filesystem::path kScenarios = std::filesystem::path(TURNTABLE_SOURCE_DIR) / "scenarios";

struct Planned {
  RigFile rig = load_rig_file(kScenarios / "rigs" / "simulated.json");
  Plan plan = plan_campaign(load_campaign(kScenarios / "campaigns" / "quick.json"), rig);
  std::vector<PhaseTimes> times = pose_times(plan, rig);
};

TEST(PlanPicture, HasAPanelForEveryScenarioAndUnitsOnItsAxes) {
  Planned planned;
  planned.plan.title = "Tonight's & 'DATA' <poses>\nset output 'elsewhere.svg'";
  const std::string svg = plan_picture(planned.plan, planned.times);
  const auto shows = [&svg](const std::string& text) {
    return svg.find(text) != std::string::npos;
  };
  for (const char* text : {"<svg", "</svg>", "angle / deg", "stage / mm", "yaw (z)",
                           "Tonight's &amp; ", "set output 'elsewhere.svg'"})
    EXPECT_TRUE(shows(text)) << text;
  for (const ScenarioInfo& s : planned.plan.scenarios) EXPECT_TRUE(shows(s.name + ": ")) << s.name;
  EXPECT_TRUE(svg == plan_picture(planned.plan, planned.times));
}

TEST(PlanPicture, ShowsThePathOnlyWhereSeveralAxesTurn) {
  EXPECT_THAT(trajectory_commands({AxisId::kPitch}, "every ::1", {}),
              AllOf(Not(HasSubstr("splot")), Not(HasSubstr("linespoints"))));
  // Outermost first: the inner axis runs to the right.
  EXPECT_THAT(
      trajectory_commands({AxisId::kPitch, AxisId::kYaw}, "every ::1", {}),
      AllOf(Not(HasSubstr("splot")), HasSubstr("using 4:6"), HasSubstr("set xlabel 'yaw / deg'")));
  EXPECT_THAT(trajectory_commands({AxisId::kPitch, AxisId::kRoll, AxisId::kYaw}, "every ::1", {}),
              HasSubstr("splot 'DATA' every ::1 using 6:5:4"));
}

TEST(PlanPicture, SaysWhatIsMissingWithoutGnuplot) {
  const Planned planned;
  const std::string path = std::getenv("PATH");
  ::setenv("PATH", "/nowhere", 1);
  const std::string message =
      message_of<ConfigError>([&] { plan_picture(planned.plan, planned.times); });
  ::setenv("PATH", path.c_str(), 1);
  EXPECT_THAT(message, AllOf(HasSubstr("gnuplot"), HasSubstr("Install it")));
}

}  // namespace
}  // namespace turntable
