#include "src/campaign/telemetry.h"

#include <gmock/gmock.h>

#include <cmath>

#include "src/core/errors.h"
#include "tests/support/fake_rig.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

class TelemetryWatchTest : public ::testing::Test {
 protected:
  TelemetryWatchTest() {
    ChannelConfig room;
    room.name = "room";
    room.unit = "degC";
    room.hold = {18.0, 24.0, 19.0, 23.0, 60.0, 600.0};
    ChannelConfig supply;
    supply.name = "supply";
    supply.unit = "V";
    config.channels = {room, supply};
    config.every_s = 10.0;
    fake.rig.channels = {{"room", [this] { return value(); }}, {"supply", [] { return 24.1; }}};
  }
  double value() const {
    if (std::isnan(room_degc)) throw TimeoutError("no answer within 0.5 s");
    return room_degc;
  }

  FakeRig fake{Image({8, 8}, 0)};
  TelemetryConfig config;
  double room_degc = 21.0;
};

TEST_F(TelemetryWatchTest, ReadsWhenTheLastReadingIsOldEnough) {
  TelemetryWatch watch(fake.rig, config);
  ASSERT_TRUE(watch.read_if_due());
  fake.clock.sleep_for(std::chrono::seconds{9});
  EXPECT_FALSE(watch.read_if_due());
  fake.clock.sleep_for(std::chrono::seconds{1});
  const auto reading = watch.read_if_due();
  ASSERT_TRUE(reading);
  EXPECT_EQ(reading->rig_time_s, 10.0);
  EXPECT_EQ(reading->values[0], 21.0);
  EXPECT_EQ(reading->values[1], 24.1);
}

TEST_F(TelemetryWatchTest, LeavesByTheWideBandAndComesBackByTheNarrowOne) {
  TelemetryWatch watch(fake.rig, config);
  for (const double inside : {18.0, 18.5, 24.0}) {
    room_degc = inside;
    watch.read();
    EXPECT_EQ(watch.outside(), "") << inside;
  }
  room_degc = 24.1;
  watch.read();
  EXPECT_THAT(watch.outside(), HasSubstr("room 24.1 degC, allowed: 18 to 24 degC"));
  EXPECT_EQ(watch.for_s(), 60.0);
  EXPECT_EQ(watch.give_up_s(), 600.0);
  room_degc = 23.5;
  watch.read();
  EXPECT_EQ(watch.outside(), "");
  EXPECT_THAT(watch.not_yet_back(), HasSubstr("allowed: 19 to 23 degC"));
  room_degc = 22.9;
  watch.read();
  EXPECT_EQ(watch.not_yet_back(), "");
}

TEST_F(TelemetryWatchTest, ACountingChannelThatCannotBeReadIsOutside) {
  TelemetryWatch watch(fake.rig, config);
  room_degc = std::nan("");
  const TelemetryReading reading = watch.read();
  EXPECT_FALSE(reading.values[0]);
  EXPECT_EQ(reading.values[1], 24.1);
  EXPECT_THAT(reading.trouble, HasSubstr("room: no answer"));
  EXPECT_THAT(watch.outside(), HasSubstr("cannot be read"));
}

TEST_F(TelemetryWatchTest, AChannelWithoutABandHoldsNothing) {
  fake.rig.channels[1].read = []() -> double { throw LineError("unplugged"); };
  TelemetryWatch watch(fake.rig, config);
  EXPECT_FALSE(watch.read().values[1]);
  EXPECT_EQ(watch.outside(), "");
}

}  // namespace
}  // namespace turntable
