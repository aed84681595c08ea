// The driver against the bytes of the manual's facts (protocols/README.md), and on its simulator.
#include "drivers/zolix_zc300.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "drivers/motion.h"
#include "src/core/errors.h"
#include "tests/support/simulated_zc300.h"

namespace turntable {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

class ZolixZc300 : public ::testing::Test, protected SimulatedZc300 {};

TEST_F(ZolixZc300, AgreesWithItsSimulatorAboutTheSetUp) {
  EXPECT_THAT(controller->connect(), ElementsAre());
  EXPECT_THAT(controller->identity(),
              HasSubstr("channels X Y Z: ZC300-3A serial 26017 firmware 1.2"));
  EXPECT_EQ(count("set"), 0u);
}

TEST_F(ZolixZc300, ArrivesToThePulse) {
  ready();
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 100; ++i) {
    const double target = draws.uniform(-29.5, 30);
    const Arrival<Degrees> arrival = move(yaw(), target);
    EXPECT_FALSE(arrival.missed);
    EXPECT_EQ(arrival.requested.value, target);
    EXPECT_NEAR(arrival.position.value, target, 0.00125 / 2 + 1e-9);
    EXPECT_NEAR(counter(AxisId::kYaw), arrival.position.value, 1e-9);
    EXPECT_NEAR(truth(AxisId::kYaw), arrival.position.value, 1e-9);
  }
}

}  // namespace
}  // namespace turntable
