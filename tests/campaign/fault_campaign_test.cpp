// A thousand short runs per controller, each with its own random faults.
#include "tests/support/fault_campaign.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace turntable {
namespace {

class FaultCampaigns : public ::testing::TestWithParam<ControllerVariant> {};

TEST_P(FaultCampaigns, EndWithCorrectDataOrWithAnErrorAndStoppedAxes) {
  FaultCampaign campaign(GetParam());
  int completed = 0, failed = 0;
  constexpr std::uint64_t kRuns = 1000;
  for (std::uint64_t k = 0; k < kRuns; ++k) {
    const FaultedRun run = campaign.run(k);
    ++(run.completed ? completed : failed);
    EXPECT_THAT(run.broken, ::testing::IsEmpty())
        << "run " << k << " with " << run.faults << "ended: " << run.error;
  }
  std::cout << GetParam().name() << ": " << completed << " completed, " << failed << " failed\n";
  EXPECT_GT(completed, 100);
  EXPECT_GT(failed, 100);
}

INSTANTIATE_TEST_SUITE_P(Catalogue, FaultCampaigns, ::testing::ValuesIn(all_controllers()),
                         [](const ::testing::TestParamInfo<ControllerVariant>& variant) {
                           return variant.param.name();
                         });

}  // namespace
}  // namespace turntable
