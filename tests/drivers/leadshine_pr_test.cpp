// The driver against the bytes of the manuals' facts (protocols/README.md), frames and checksums
// worked out by hand, and on its simulator.
#include "drivers/leadshine_pr.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "drivers/motion.h"
#include "protocols/modbus_master.h"
#include "src/core/errors.h"
#include "tests/support/hex.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_leadshine.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

OutputConfig camera_output(int register_at, int slave, std::uint16_t on) {
  OutputConfig output;
  output.name = "camera";
  output.register_at = register_at;
  output.slave = slave;
  output.on_value = on;
  return output;
}

// ---- bytes

/// A drive of paper: confirms a write to one register, and says what it is given for the rest.
class Paper final : public Actor {
 public:
  explicit Paper(Line line) : line_(std::move(line)) {}
  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override { return std::nullopt; }
  void act(Time now) override {
    std::array<char, 256> buffer;
    const std::string frame(buffer.data(), line_.read_available(buffer, now));
    if (frame.empty()) return;
    heard.push_back(hex_of(frame));
    if (on_heard) on_heard(heard.back());
    if (const auto reply = replies.find(heard.back()); reply != replies.end())
      line_.write_available(bytes_of(reply->second), now);
    else if (frame[1] == 6)
      line_.write_available(frame, now);
  }
  std::map<std::string, std::string> replies;
  std::vector<std::string> heard;
  std::function<void(const std::string&)> on_heard;  ///< before it is answered

 private:
  Line line_;
};

constexpr const char* kReadPulses = "030300010001d428";
constexpr const char* kReadEnable = "0303000f0001b5eb";
constexpr const char* kReadConfig = "0303600000019be8";
constexpr const char* kReadLimitsAndHoming = "03036006000d7bec";
constexpr const char* kReadStopRamps = "0303601600023a2d";
constexpr const char* kReadAlarm = "0303220300017f90";
constexpr const char* kReadInputs = "03030144000e8405";
constexpr const char* kReadStatus = "0303100300017128";
constexpr const char* kReadPosition = "0303602a0002fa21";
constexpr const char* kReadPath = "0303620000085a56";
constexpr const char* kPathKept = "031062000008df95";
constexpr const char* kHome = "0306600200203630";
constexpr const char* kRun = "0306600200103624";
constexpr const char* kStop = "0306600200403618";

class LeadshineBytes : public ::testing::Test {
 protected:
  LeadshineBytes() : LeadshineBytes(line_pair("bus line")) {}
  explicit LeadshineBytes(std::pair<Line, Line> ends) : drive(std::move(ends.second)) {
    clock.attach(drive);
    ControllerConfig config;
    config.name = "bus";
    config.model = "leadshine-pr";
    config.outputs = {camera_output(0x0157, 3, 0x80)};
    controller = open_leadshine_pr(
        {config, {rotary_axis(AxisId::kYaw, "3")}, std::move(ends.first), &clock});
    drive.replies = {
        {kReadPulses, "0303020640c3d4"},
        {kReadEnable, "03030200010044"},
        {kReadConfig, "03030200024045"},
        {kReadLimitsAndHoming, "03031a00005dc0ffffa240000600000000000000000096001e029b029b1ad5"},
        {kReadStopRamps, "030304003201f4782b"},
        {kReadAlarm, "0303020000c184"},
        // Input 2 is the upper limit switch, 3 the lower one, 4 the home switch.
        {kReadInputs, "03031c000000880000002500000026000000a70000000000000000000000007b7e"},
        {kReadStatus, "030302007241a1"},
        {kReadPosition, "03030400000000d9f3"},
        // Path 0: absolute, 9476 pulses, 750 rpm, 667 ms per 1000 rpm up and down.
        {"0310620000081000010000250402ee029b029b000000007833", kPathKept},
        {kReadPath, "03031000010000250402ee029b029b000000002f22"},
    };
  }
  ~LeadshineBytes() override { clock.detach(drive); }

  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }

  ManualClock clock;
  Paper drive;
  std::unique_ptr<Controller> controller;
};

TEST_F(LeadshineBytes, ConnectingReadsAndChangesNothing) {
  EXPECT_THAT(controller->connect(), IsEmpty());
  EXPECT_THAT(drive.heard, ElementsAre(kReadPulses, kReadEnable, kReadConfig, kReadLimitsAndHoming,
                                       kReadStopRamps, kReadAlarm, kReadInputs));
  EXPECT_THAT(controller->identity(), HasSubstr("slaves 3"));
  EXPECT_THAT(controller->identity(), Not(HasSubstr("home switch")));
}

TEST_F(LeadshineBytes, SaysWhereNoInputIsTheHomeSwitch) {
  drive.replies[kReadInputs] = "03031c0000008800000000000000000000000000000000000000000000000078c4";
  controller->connect();
  EXPECT_THAT(controller->identity(), HasSubstr("slave 3 has no input that is set up as the home"));
  drive.replies[kReadInputs] = "0383026131";  // a relative without these registers
  controller->connect();
  EXPECT_THAT(controller->identity(), Not(HasSubstr("home switch")));
}

TEST_F(LeadshineBytes, ConfiguringWritesTheSetUpAndKeepsBitsThatAreNotItsBusiness) {
  drive.replies[kReadConfig] = "03030200078046";  // bit 0 is on, and 2: it would home by itself
  drive.replies["0303600a0001bbea"] = "03030200050187";  // the other direction, and staying there
  drive.replies["0310600600020400005dc0e8ff"] = "031060060002be2b";
  drive.replies["03106008000204ffffa2402907"] = "031060080002dfe8";
  drive.replies["0310600b0002040000000011a6"] = "0310600b00022fe8";
  drive.replies["0310600d00020400000000918c"] = "0310600d0002cfe9";
  drive.on_heard = [&](const std::string& frame) {
    if (frame == "030660000003d629") drive.replies[kReadConfig] = "03030200038185";
  };
  controller->configure();
  drive.heard.resize(18);
  EXPECT_THAT(drive.heard,
              ElementsAre("030600010640dbb8", "0306000f000179eb", kReadConfig, "030660000007d7ea",
                          kReadConfig, "030660000003d629", "0310600600020400005dc0e8ff",
                          "03106008000204ffffa2402907", "0303600a0001bbea", "0306600a0007f7e8",
                          "0310600b0002040000000011a6", "0310600d00020400000000918c",
                          "0306600f00962645", "03066010001e17e5", "03066011029b86e6",
                          "03066012029b76e6", "030660160032f639", "0306601701f4263b"));
}

TEST_F(LeadshineBytes, AMoveIsWrittenReadBackAndTriggered) {
  controller->connect();
  drive.heard.clear();
  yaw().home();
  drive.heard.resize(8);
  EXPECT_THAT(drive.heard, ElementsAre(kReadStatus, kReadPosition, kReadPulses, kReadEnable,
                                       kReadConfig, kReadLimitsAndHoming, kReadStopRamps, kHome));
  drive.heard.clear();
  yaw().start(Degrees{12.345});  // by way of 11.845
  EXPECT_THAT(drive.heard,
              ElementsAre(kReadStatus, kReadPosition,
                          "0310620000081000010000250402ee029b029b000000007833", kReadPath, kRun));
  drive.heard.clear();
  yaw().stop();
  EXPECT_EQ(drive.heard.at(0), kStop);
}

TEST_F(LeadshineBytes, AnAxisThatGoesOnIsStoppedWithoutDecelerationWhichIsPutBack) {
  bool goes_on = true, here = false;
  drive.on_heard = [&](const std::string& frame) {
    if (frame == "030660170000262c") goes_on = false;
    if (goes_on && frame == kReadPosition) here = !here;
    drive.replies[kReadPosition] = here ? "03030400000000d9f3" : "0303040000000a59f4";
  };
  yaw().stop();
  std::erase_if(drive.heard, [](const std::string& frame) { return frame.starts_with("0303"); });
  EXPECT_THAT(drive.heard, ElementsAre(kStop, "030660170000262c", kStop, "0306601701f4263b"));
}

TEST_F(LeadshineBytes, NegativePositionsAreTwosComplementHighWordFirst) {
  drive.replies["031062000008100001ffffeecf02ee029b029b00000000ec8f"] = kPathKept;
  drive.replies[kReadPath] = "0303100001ffffeecf02ee029b029b00000000bb9e";
  controller->connect();
  yaw().home();
  drive.heard.clear();
  yaw().start(Degrees{-5.00125});  // by way of -5.50125, -4401 pulses
  EXPECT_EQ(drive.heard.back(), kRun);
}

TEST_F(LeadshineBytes, ABlockThatIsNotKeptBlocksTheMotion) {
  drive.replies[kReadPath] = "03031000010000250402ee029b029c000000009ae2";
  controller->connect();
  yaw().home();
  drive.heard.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{12.345}); }),
              AllOf(HasSubstr("axis yaw (channel 3 of bus on bus line)"),
                    HasSubstr("0x6205 (path 0): wanted 0x029B, found 0x029C"),
                    HasSubstr("nothing was moved")));
  EXPECT_EQ(drive.heard.back(), kReadPath);
  EXPECT_FALSE(yaw().homed());
}

TEST_F(LeadshineBytes, NamesRefusalsInWords) {
  drive.replies[kReadStopRamps] = "0383026131";
  EXPECT_THAT(message_of<DeviceError>([&] { controller->connect(); }),
              AllOf(HasSubstr("reading register 0x6016"), HasSubstr("exception 02"),
                    HasSubstr("it has no such register"), HasSubstr("two register maps")));
  drive.replies[kReadStopRamps] = "030304003201f4782b";
  controller->connect();
  yaw().home();
  drive.replies[kRun] = "038603a3a1";
  drive.heard.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{12.345}); }),
              AllOf(HasSubstr("writing 0x0010 to register 0x6002"), HasSubstr("exception 03"),
                    HasSubstr("does not allow this value")));
  EXPECT_EQ(std::ranges::count(drive.heard, kRun), 1);
  EXPECT_FALSE(yaw().homed());
}

TEST_F(LeadshineBytes, SwitchesAnOutputByItsRegister) {
  controller->pulse_output("camera");
  EXPECT_THAT(drive.heard, ElementsAre("03060157008039a4", "0306015700003804"));
}

// ---- what the rig file may say

ControllerConfig bus() {
  ControllerConfig config;
  config.name = "bus";
  config.model = "leadshine-pr";
  return config;
}

std::string refusal_of(AxisConfig axis) {
  ManualClock clock;
  return message_of<ConfigError>([&] {
    open_leadshine_pr({bus(), {std::move(axis)}, line_pair("bus line").first, &clock});
  });
}

TEST(LeadshineConfig, AChannelIsASlaveAddress) {
  for (const char* channel : {"X", "0", "32", "-1", "01", "1 ", "", "1.5"})
    EXPECT_THAT(refusal_of(rotary_axis(AxisId::kYaw, channel)),
                AllOf(HasSubstr("/axes/yaw/channel"), HasSubstr("\"1\" to \"31\"")))
        << channel;
}

TEST(LeadshineConfig, ValuesThatTheDriveCannotHoldAreNamed) {
  AxisConfig axis = rotary_axis(AxisId::kYaw, "1");
  axis.steps_per_rev = 100;
  EXPECT_THAT(refusal_of(axis), AllOf(HasSubstr("/axes/yaw/steps_per_rev"),
                                      HasSubstr("found 100, allowed"), HasSubstr("200 to 51200")));
  axis.steps_per_rev = 1600.5;
  EXPECT_THAT(refusal_of(axis), HasSubstr("steps_per_rev"));
  axis = rotary_axis(AxisId::kYaw, "1");
  axis.speed = 0.05;  // 1.5 rpm
  EXPECT_THAT(refusal_of(axis), AllOf(HasSubstr("/axes/yaw/speed"), HasSubstr("1.5 rpm"),
                                      HasSubstr("possible is 0.0666667 deg/s")));
  axis.speed = 0.001;
  EXPECT_THAT(refusal_of(axis), HasSubstr("possible is 0.0333333 deg/s"));
  axis = rotary_axis(AxisId::kYaw, "1");
  axis.acceleration = 1e6;  // 0.033 ms per 1000 rpm
  EXPECT_THAT(refusal_of(axis),
              AllOf(HasSubstr("/axes/yaw/acceleration"), HasSubstr("ms per 1000 rpm"),
                    HasSubstr("possible is 33333.3 deg/s^2")));
  axis = rotary_axis(AxisId::kYaw, "1");
  axis.home_speed = 0.04;
  EXPECT_THAT(refusal_of(axis), HasSubstr("/axes/yaw/home_speed"));
  axis = rotary_axis(AxisId::kYaw, "1");
  axis.upper = 1e7;
  EXPECT_THAT(refusal_of(axis), HasSubstr("more pulses than the drive can count"));
}

TEST(LeadshineConfig, OutputsAreRegisters) {
  ManualClock clock;
  ControllerConfig config = bus();
  config.outputs = {camera_output(0x0157, 1, 1)};
  config.outputs[0].register_at.reset();
  EXPECT_THAT(message_of<ConfigError>([&] {
                open_leadshine_pr({config, bus_axes(), line_pair("bus line").first, &clock});
              }),
              HasSubstr("holding register"));
}

// ---- on the simulator

class LeadshinePr : public ::testing::Test, protected SimulatedLeadshine {};

TEST_F(LeadshinePr, AgreesWithItsSimulatorAboutTheSetUp) {
  EXPECT_THAT(controller->connect(), IsEmpty());
  EXPECT_THAT(controller->identity(), HasSubstr("slaves 1 2 3 4"));
}

TEST_F(LeadshinePr, ArrivesToThePulse) {
  ready();
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 100; ++i) {
    const double target = draws.uniform(-29.5, 30);
    const Arrival<Degrees> arrival = move(yaw(), target);
    EXPECT_FALSE(arrival.missed);
    EXPECT_NEAR(arrival.position.value, target, 0.00125 / 2 + 1e-9);
    EXPECT_NEAR(counter(AxisId::kYaw), arrival.position.value, 1e-9);
    EXPECT_NEAR(truth(AxisId::kYaw), arrival.position.value, 1e-9);
  }
}

TEST_F(LeadshinePr, ReachesItsVeryLimits) {
  ready();
  move(yaw(), 30);
  EXPECT_NEAR(truth(AxisId::kYaw), 30, 1e-9);
  move(yaw(), -29.5);
  EXPECT_NEAR(truth(AxisId::kYaw), -29.5, 1e-9);
  EXPECT_THROW(yaw().start(Degrees{30.01}), LimitError);
}

TEST_F(LeadshinePr, FourSlavesMoveAtTheSameTime) {
  ready();
  stage().home();
  roll().home();
  pitch().home();
  stage().start(Millimetres{100});
  yaw().start(Degrees{20});
  roll().start(Degrees{-20});
  pitch().start(Degrees{10});
  clock.sleep_for(from_seconds(0.3));
  for (const AxisId id : kAllAxes) EXPECT_TRUE(moving(id)) << axis_name(id);
  wait_all(stage(), yaw(), roll(), pitch());
  EXPECT_NEAR(truth(AxisId::kStage), 100, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 20, 1e-9);
  EXPECT_NEAR(truth(AxisId::kRoll), -20, 1e-9);
  EXPECT_NEAR(truth(AxisId::kPitch), 10, 1e-9);
}

TEST_F(LeadshinePr, StopsAllFour) {
  ready();
  stage().home();
  stage().start(Millimetres{100});
  yaw().start(Degrees{20});
  clock.sleep_for(from_seconds(0.3));
  controller->stop_all();
  EXPECT_FALSE(moving(AxisId::kStage));
  EXPECT_FALSE(moving(AxisId::kYaw));
  EXPECT_EQ(said("stop"), 4);
  EXPECT_TRUE(yaw().homed());  // a stop is no trouble
  EXPECT_NEAR(move(yaw(), 3).position.value, 3, 1e-9);
}

TEST_F(LeadshinePr, NamesEveryDifferenceByItsRegister) {
  std::vector<AxisConfig> real = bus_axes();
  real[1].steps_per_rev = 3200;
  real[1].upper = 25;
  real[1].acceleration = 100;
  real[3].home_speed = 10;
  SimulatedLeadshine rig({.real = real});
  EXPECT_THAT(
      rig.controller->connect(),
      ElementsAre("yaw: register 0x0001 (pulses per revolution): wanted 1600, found 3200",
                  "yaw: register 0x6006 (upper soft limit, pulses): wanted 24000, found 40000",
                  "yaw: register 0x6008 (lower soft limit, pulses): wanted -24000, found -48000",
                  "yaw: register 0x6011 (homing acceleration, ms): wanted 667, found 333",
                  "yaw: register 0x6012 (homing deceleration, ms): wanted 667, found 333",
                  "yaw: register 0x6017 (deceleration of a stop, ms): wanted 500, found 250",
                  "pitch: register 0x600F (fast homing speed, rpm): wanted 150, found 300"));
  rig.mark();
  EXPECT_THAT(message_of<DeviceError>([&] { rig.yaw().home(); }),
              HasSubstr("0x6006 (upper soft limit, pulses): wanted 24000, found 40000"));
  EXPECT_EQ(rig.said("home"), 0);
  rig.controller->configure();
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), 7).position.value, 7, 1e-9);
  EXPECT_NEAR(rig.truth(AxisId::kYaw), 7, 1e-9);
}

TEST_F(LeadshinePr, ASetUpThatAPowerCycleTookAwayBlocksHoming) {
  std::vector<AxisConfig> real = bus_axes();
  real[1].upper = 25;
  SimulatedLeadshine rig({.real = real});
  rig.controller->configure();
  rig.yaw().home();
  rig.fault({.kind = sim::FaultKind::kReset, .verb = "status"});
  rig.yaw().position();
  EXPECT_THAT(message_of<DeviceError>([&] { rig.move(rig.yaw(), 5); }),
              HasSubstr("switched off and on again"));
  rig.mark();
  EXPECT_THAT(message_of<DeviceError>([&] { rig.yaw().home(); }),
              AllOf(HasSubstr("not set up any more"), HasSubstr("0x6006")));
  EXPECT_EQ(rig.said("home"), 0);
  rig.controller->configure();
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), 27).position.value, 27, 1e-9);
}

/// What a person may have set a drive up to, by the bytes of her own tool.
void set(SimulatedLeadshine& rig,
         std::initializer_list<std::pair<std::uint16_t, std::uint16_t>> registers) {
  auto [near, far] = line_pair("another master");
  rig.simulator->plug(std::move(far));
  ModbusMaster master(std::move(near), rig.clock, ModbusMaster::Framing::kRtu,
                      std::chrono::seconds{1});
  for (const auto& [address, value] : registers) master.write_register(2, address, value);
  rig.reconnect();
}

TEST_F(LeadshinePr, AMotorThatStaysBeyondItsSwitchIsADifferenceAndIsSetUpToComeBack) {
  set(*this, {{0x600A, 0x0004}, {0x600E, 80}});
  EXPECT_THAT(controller->connect(),
              ElementsAre("yaw: register 0x600A (homes on the origin switch, and goes to the stop "
                          "position then): wanted 0x0006, found 0x0004",
                          "yaw: register 0x600D (position to go to after homing, pulses): wanted "
                          "0, found 80"));
  mark();
  EXPECT_THROW(yaw().home(), DeviceError);
  EXPECT_EQ(said("home"), 0);
  controller->configure();
  yaw().home();
  EXPECT_NEAR(counter(AxisId::kYaw), 0, 1e-9);
  EXPECT_NEAR(truth(AxisId::kYaw), 0, 1e-9);
  EXPECT_NEAR(move(yaw(), 7).position.value, 7, 1e-9);
}

TEST_F(LeadshinePr, ADriveThatHomesByItselfIsADifferenceInPlainWordsAndIsSetUpNotTo) {
  set(*this, {{0x6000, 0x0006}, {0x600A, 0x0007}});
  EXPECT_THAT(controller->connect(),
              ElementsAre("yaw: register 0x6000 (homes by itself when it is switched on, so that "
                          "the table moves without being asked): wanted off, found on"));
  controller->configure();
  EXPECT_THAT(controller->connect(), IsEmpty());
  yaw().home();  // in the direction that was set
  EXPECT_NEAR(truth(AxisId::kYaw), 0, 1e-9);
}

TEST_F(LeadshinePr, PulsesAnOutputOfADrive) {
  SimulatedLeadshine rig({.outputs = {camera_output(0x0159, 2, 1)}});
  std::vector<std::pair<bool, Time>> seen;
  rig.simulator->on_output([&](const std::string& name, bool on, Time t) {
    EXPECT_EQ(name, "camera");
    seen.emplace_back(on, t);
  });
  rig.controller->pulse_output("camera");
  ASSERT_EQ(seen.size(), 2u);
  EXPECT_TRUE(seen[0].first);
  EXPECT_FALSE(seen[1].first);
  EXPECT_NEAR(seconds(seen[1].second - seen[0].second), 0.01, 1e-6);
}

TEST_F(LeadshinePr, WorksThroughAGateway) {
  SimulatedLeadshine rig({.gateway = true});
  EXPECT_THAT(rig.controller->connect(), IsEmpty());
  // Transaction 1, protocol 0, six bytes, slave 1: function 3, register 0x0001, one of them.
  EXPECT_EQ(hex_of(rig.wire.sent().substr(0, 12)),
            "000100000006"
            "010300010001");
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), -12).position.value, -12, 1e-9);
  EXPECT_NEAR(rig.truth(AxisId::kYaw), -12, 1e-9);
}

TEST_F(LeadshinePr, AnAbsentSlaveIsNamedOnTheBusAndBehindAGateway) {
  for (const bool gateway : {false, true}) {
    std::vector<AxisConfig> absent = bus_axes();
    absent[2].channel = "9";
    SimulatedLeadshine rig({.gateway = gateway, .axes = absent, .real = bus_axes()});
    EXPECT_THAT(message_of<TimeoutError>([&] { rig.controller->connect(); }),
                AllOf(HasSubstr("slave 9"), HasSubstr(gateway ? "gateway" : "no answer")));
  }
}

}  // namespace
}  // namespace turntable
