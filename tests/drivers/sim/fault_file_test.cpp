#include "drivers/sim/fault_file.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/support/temporary_folder.h"

namespace turntable::sim {
namespace {

TEST(FaultFile, KnowsEveryFaultByItsNameAndAllItsKeys) {
  const TemporaryFolder folder;
  for (const FaultKind kind : all_faults()) {
    spill(folder / "f.json",
          fmt::format(R"({{"format": "turntable-faults/1", "faults": [{{"controller": "mc2",
                          "fault": "{}", "on": "move", "nth": 3, "times": -1, "after_ms": 250,
                          "text": "E02"}}]}})",
                      fault_name(kind)));
    const auto faults = load_fault_file(folder / "f.json");
    ASSERT_EQ(faults.size(), 1u);
    EXPECT_EQ(faults[0].controller, "mc2");
    EXPECT_EQ(faults[0].fault.kind, kind) << fault_name(kind);
    EXPECT_EQ(faults[0].fault.verb, "move");
    EXPECT_EQ(faults[0].fault.nth, 3);
    EXPECT_EQ(faults[0].fault.times, -1);
    EXPECT_EQ(faults[0].fault.delay_s, 0.25);
    EXPECT_EQ(faults[0].fault.text, "E02");
  }
}

TEST(FaultFile, ThatIsShippedLoads) {
  EXPECT_EQ(
      load_fault_file(std::filesystem::path(TURNTABLE_SOURCE_DIR) / "scenarios/faults/example.json")
          .size(),
      3u);
}

}  // namespace
}  // namespace turntable::sim
