// The driver against the bytes of the manual's facts (protocols/README.md), and on its simulator. The
// frames with their checks were worked out outside this project.
#include "drivers/zolix_zc300.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>

#include "drivers/motion.h"
#include "drivers/sim/modbus_framer.h"
#include "src/core/errors.h"
#include "tests/support/hex.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_zc300.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

// ---- bytes

/// Registers that say what the test puts into them; a write changes them, unless it is stuck.
class Registers final : public Actor {
 public:
  explicit Registers(Line line) : line_(std::move(line)) {}
  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override { return std::nullopt; }
  void act(Time now) override {
    std::array<char, 256> buffer;
    const std::size_t n = line_.read_available(buffer, now);
    if (n == 0) return;
    heard.push_back(hex_of({buffer.data(), n}));
    framer_.feed({buffer.data(), n}, now, Time::max());
    while (const auto request = framer_.next()) line_.write_available(answer(*request), now);
  }
  void put(int number, double value) {
    const auto raw = std::bit_cast<std::uint32_t>(static_cast<float>(value));
    words[number] = static_cast<std::uint16_t>(raw >> 16);
    words[number + 1] = static_cast<std::uint16_t>(raw);
  }

  std::map<int, std::uint16_t> words;  ///< by the manual's number
  std::map<int, int> refusals;         ///< register -> exception
  std::set<int> stuck;                 ///< take no writes
  std::vector<std::string> heard;

 private:
  std::string answer(const sim::ModbusRequest& request) {
    const int first = request.address + 1;
    if (const auto refusal = refusals.find(first); refusal != refusals.end())
      return framer_.exception(request, refusal->second);
    if (request.function <= 4) {
      std::vector<std::uint16_t> found;
      for (int i = 0; i < request.count; ++i) found.push_back(words[first + i]);
      return framer_.words(request, found);
    }
    for (std::size_t i = 0; i < request.values.size(); ++i)
      if (const int number = first + static_cast<int>(i); !stuck.contains(number))
        words[number] = request.values[i];
    return framer_.confirmation(request);
  }

  Line line_;
  sim::ModbusFramer framer_{false};
};

class Zc300Bytes : public ::testing::Test {
 protected:
  Zc300Bytes() : Zc300Bytes(line_pair("line")) {}
  explicit Zc300Bytes(std::pair<Line, Line> ends) : peer(std::move(ends.second)) {
    clock.attach(peer);
    ControllerConfig config = zc300_config();
    OutputConfig output;
    output.name = "shutter";
    output.register_at = 30064;
    output.bit = 0;
    config.outputs = {output};
    controller =
        open_zolix_zc300({config, {rotary_axis(AxisId::kYaw, "Y")}, std::move(ends.first), &clock});
    for (const auto& [number, word] : std::map<int, int>{{30001, 0x5A43},
                                                         {30002, 0x3330},
                                                         {30003, 0x302D},
                                                         {30004, 0x3341},
                                                         {30009, 26017},
                                                         {30010, 12},
                                                         {30073, 2},
                                                         {30078, 1600},
                                                         {30082, 1},
                                                         {30106, 3},
                                                         {30121, 1},
                                                         {30067, 1}})
      peer.words[number] = static_cast<std::uint16_t>(word);
    peer.put(30086, 360);
    peer.put(30092, 180);
    peer.put(30125, 1);
    peer.put(30131, 25);
    peer.put(30137, 50);
    peer.put(30101, 5);
  }
  ~Zc300Bytes() override { clock.detach(peer); }

  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  void ready() {
    controller->connect();
    yaw().home();
    peer.heard.clear();
  }
  /// Starts and stops. @return what was said between the status read and the stop.
  std::vector<std::string> started(double to) {
    peer.heard.clear();
    yaw().start(Degrees{to});
    std::vector<std::string> said(peer.heard.begin() + 1, peer.heard.end());
    yaw().stop();
    return said;
  }

  ManualClock clock;
  Registers peer;
  std::unique_ptr<Controller> controller;
};

const std::string kReadStatus = "0104753b000a1bcc";
const std::string kReadTargets = "010375a1001b4e2f";  // 30114..30140
const std::string kReadFirst = "01037571001e8fd5", kReadSecond = "01037592002a7ff4";
const std::string kMoveUp = "01107561000306006400320050dfcd";
const std::string kMoveDown = "0110756100030600640032004e5fc5";
const std::string kGoHome = "01107561000204006900323f10";
const std::string kStop = "01107561000204006700325ed3";

TEST_F(Zc300Bytes, ConnectingAsksAndChangesNothing) {
  EXPECT_THAT(controller->connect(), ElementsAre());
  EXPECT_THAT(controller->identity(), HasSubstr("ZC300-3A serial 26017 firmware 1.2"));
  EXPECT_THAT(peer.heard, ElementsAre("01047530000a6a0e", kReadFirst, kReadSecond));
}

TEST_F(Zc300Bytes, ConfiguringWritesWhatDiffersAndReadsItBack) {
  for (int number = 30066; number <= 30140; ++number) peer.words[number] = 0;
  controller->configure();
  EXPECT_THAT(peer.heard, ElementsAre(kReadFirst, kReadSecond,
                                      "010675780002921e",            // deg
                                      "0110757c00020400000640ac1c",  // 1600
                                      "010675810001022e",            // rotary
                                      "0110758500020443b4000034c0",  // the lead: 360
                                      "0110758b00020443340000b4a4",  // the ratio: 180
                                      kReadFirst, kReadSecond,
                                      "011075b200020441c80000b652",  // the cruise speed first: 25
                                      "011075ac0002043f800000aeec",  // 1
                                      "0110759400020440a00000b440",  // 5
                                      "011075b8000204424800003781",  // 50
                                      "01067599000303e8",            // home switch
                                      "010675a80001d3e6",            // decelerates
                                      "010675720001f21d",            // enabled
                                      "01047530000a6a0e", kReadFirst, kReadSecond));
  peer.heard.clear();
  controller->configure();
  for (const std::string& frame : peer.heard)  // nothing differs any more
    EXPECT_TRUE(frame.starts_with("0103") || frame.starts_with("0104")) << frame;
}

TEST_F(Zc300Bytes, HomesMovesAndStopsInTheManualsWords) {
  controller->connect();
  peer.heard.clear();
  yaw().home();
  EXPECT_THAT(peer.heard, ElementsAre(kReadStatus, kReadTargets,
                                      "011075b80002044247f5c30083",  // 49.99: the mark
                                      kReadTargets, kGoHome, kReadStatus, kReadTargets, kReadStatus,
                                      kReadStatus, kReadTargets,
                                      "0110756c00020400000000af40",  // counts as 0
                                      "0103756c00021e1a", kReadStatus));
  EXPECT_THAT(started(12.345), ElementsAre("011075a3000204413d8529c5ee", kReadTargets, kMoveUp));
  // The sign is a letter, the number a magnitude to 0.001 and a little more.
  EXPECT_THAT(started(-5.00125),
              ElementsAre("011075a300020440b008467145", kReadTargets, kMoveDown));
  EXPECT_THAT(started(0), ElementsAre("011075a30002043f0000a8eefa", kReadTargets, kMoveDown));
  peer.heard.clear();
  yaw().stop();
  EXPECT_EQ(peer.heard.at(0), kStop);
}

TEST_F(Zc300Bytes, SwitchesAnOutputAndLeavesTheOthers) {
  peer.words[30065] = 4;
  controller->pulse_output("shutter");
  EXPECT_THAT(peer.heard, ElementsAre("0103757000019fdd", "010675700005521e", "0103757000019fdd",
                                      "01067570000493de"));
  EXPECT_EQ(peer.words[30065], 4);
}

TEST_F(Zc300Bytes, NamesWhatDiffersAndMovesNothing) {
  peer.put(30131, 20);
  peer.put(30086, 4);
  peer.words[30073] = 0;
  peer.words[30067] = 0;
  EXPECT_THAT(controller->connect(),
              ElementsAre("yaw: register 30073 (unit): wanted 2, found 0",
                          "yaw: register 30086 (lead): wanted 360, found 4",
                          "yaw: register 30131 (cruise speed): wanted 25, found 20",
                          "yaw: register 30067 (enable): wanted 1, found 0"));
  peer.heard.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().home(); }),
              HasSubstr("register 30131 (cruise speed): wanted 25, found 20"));
  EXPECT_THAT(peer.heard, ElementsAre());
  controller->stop_all();  // but stopping is always allowed
}

TEST_F(Zc300Bytes, NamesEachSettingThatDiffers) {
  for (const auto& [number, name] : std::map<int, std::string>{{30073, "unit"},
                                                               {30077, "pulses per revolution"},
                                                               {30082, "stage type"},
                                                               {30086, "lead"},
                                                               {30092, "drive ratio"},
                                                               {30125, "initial speed"},
                                                               {30131, "cruise speed"},
                                                               {30137, "acceleration"},
                                                               {30101, "home speed"},
                                                               {30106, "home mode"},
                                                               {30121, "stop mode"},
                                                               {30067, "enable"}}) {
    const auto before = std::exchange(peer.words[number], std::uint16_t{0x4400});
    const auto differences = controller->connect();
    ASSERT_EQ(differences.size(), 1u) << name;
    EXPECT_THAT(differences[0],
                HasSubstr("yaw: register " + std::to_string(number) + " (" + name + "): wanted"));
    peer.words[number] = before;
  }
}

TEST_F(Zc300Bytes, FindsOutThatASettingWasNotKept) {
  peer.words[30138] = 1;
  peer.stuck = {30137, 30138};
  peer.put(30137, 49);
  EXPECT_THAT(message_of<DeviceError>([&] { controller->configure(); }),
              HasSubstr("register 30137 (acceleration): wanted 50, found 49"));
}

TEST_F(Zc300Bytes, SaysWhoAnsweredInsteadOfAZc300) {
  peer.words[30001] = 0x4D43;
  EXPECT_THAT(message_of<DeviceError>([&] { controller->connect(); }),
              HasSubstr("is not a ZC300: it calls itself \"MC300-3A\""));
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().home(); }), HasSubstr("not connected"));
}

TEST_F(Zc300Bytes, MovesNothingWhenTheTargetDoesNotReadBack) {
  ready();
  peer.stuck = {30116, 30117};
  peer.put(30116, 95);
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{10}); }),
              AllOf(HasSubstr("axis yaw"), HasSubstr("register 30116 (target)"),
                    HasSubstr("wanted 9.50001, found 95"), HasSubstr("Nothing was moved")));
  for (const std::string& frame : peer.heard) EXPECT_NE(frame, kMoveUp);
  EXPECT_FALSE(yaw().homed());
}

TEST_F(Zc300Bytes, NamesEveryRefusal) {
  const std::map<int, std::string> names{{0x01, "does not know the function"},
                                         {0x02, "no such register"},
                                         {0x03, "wrong number of registers"},
                                         {0x04, "could not save"},
                                         {0x05, "value is not allowed"},
                                         {0x06, "axis is already moving"},
                                         {0x07, "limit switch is on"},
                                         {0x08, "emergency stop is pressed"},
                                         {0x09, "axis is not enabled"},
                                         {0x0A, "unknown opcode"},
                                         {0x3C, "do not define"}};
  for (const auto& [code, name] : names) {
    peer.refusals.clear();
    ready();
    peer.refusals = {{30050, code}};
    const std::string message = message_of<DeviceError>([&] { yaw().start(Degrees{10}); });
    EXPECT_THAT(message, AllOf(HasSubstr("axis yaw (channel Y of zc300 on line)"),
                               HasSubstr(fmt::format("opcode 64h was refused with {:02X}", code)),
                               HasSubstr(name)));
    EXPECT_EQ(std::ranges::count(peer.heard, kMoveUp), 1);
    EXPECT_FALSE(yaw().homed());
    peer.refusals.clear();
    yaw().stop();
  }
}

TEST_F(Zc300Bytes, AsksAgainForAStatusThatCannotBe) {
  ready();
  peer.words[30013] = 7;
  EXPECT_THROW(yaw().position(), ProtocolError);
  EXPECT_EQ(peer.heard.size(), 4u);  // three, and one for each channel
  peer.words[30013] = 0;
  peer.put(30018, NAN);
  EXPECT_THROW(yaw().position(), ProtocolError);
  peer.put(30018, 1e30);
  EXPECT_THROW(yaw().position(), ProtocolError);
  peer.put(30018, -12.5);
  EXPECT_EQ(yaw().position().value, -12.5);
}

TEST_F(Zc300Bytes, LooksAtTheBitsOfItsOwnAxis) {
  ready();
  const auto fails = [&](unsigned bits, double to) {
    peer.words[30015] = static_cast<std::uint16_t>(bits);
    const std::string message = message_of<DeviceError>([&] { yaw().start(Degrees{to}); });
    peer.words[30015] = 0;
    yaw().home();
    return message;
  };
  EXPECT_THAT(fails(1u << 3, 10), HasSubstr("upper limit switch is on"));
  EXPECT_THAT(fails(1u << 4, -10), HasSubstr("lower limit switch is on"));
  EXPECT_THAT(fails(1u << 9, 10), HasSubstr("the emergency stop is pressed; release it"));
  EXPECT_THAT(fails(1u << 11, 10), HasSubstr("the driver of the axis reports an alarm"));
  // Of the others, and home switches of all: nothing to do with it.
  peer.words[30015] = 0x1 | 0x2 | 0x4 | 0x20 | 0x40 | 0x80 | 0x100 | 1u << 10 | 1u << 12;
  yaw().start(Degrees{10});
  yaw().stop();
}

TEST(Zc300Setup, RefusesWhatTheControllerWouldBeforeAnyByteLeaves) {
  ManualClock clock;
  const auto refused = [&](auto change) {
    AxisConfig axis = rotary_axis(AxisId::kYaw, "Y");
    change(axis);
    return message_of<ConfigError>([&] {
      open_controller({zc300_config(), {axis}, line_pair("line").first, &clock});
    });
  };
  EXPECT_THAT(refused([](AxisConfig& a) { a.steps_per_rev = 1e7; }),
              AllOf(HasSubstr("/axes/yaw"), HasSubstr("pulses per revolution 10000000")));
  EXPECT_THAT(refused([](AxisConfig& a) { a.steps_per_rev = 1600.5; }), HasSubstr("whole numbers"));
  EXPECT_THAT(refused([](AxisConfig& a) { a.drive_ratio = 10000; }), HasSubstr("drive ratio"));
  EXPECT_THAT(refused([](AxisConfig& a) { a.speed = 12500; }), HasSubstr("below 10^7 pulses"));
  EXPECT_THAT(refused([](AxisConfig& a) { a.initial_speed = 26; }), HasSubstr("initial speed"));
  EXPECT_THAT(refused([](AxisConfig& a) { a.home_speed = 25; }), HasSubstr("below the speed, 25"));
  EXPECT_THAT(refused([](AxisConfig& a) { a.acceleration = 12500; }), HasSubstr("acceleration"));
  OutputConfig output;
  output.name = "camera";
  output.register_at = 30200;
  ControllerConfig config = zc300_config();
  config.outputs = {output};
  EXPECT_THAT(message_of<ConfigError>([&] {
                open_controller({config, {linear_axis("X")}, line_pair("line").first, &clock});
              }),
              AllOf(HasSubstr("/controllers/zc300/outputs/camera"), HasSubstr("register 30064")));
}

TEST(Zc300Setup, NamesWhatARigFileHasWrong) {
  ManualClock clock;
  const auto open = [&](std::vector<AxisConfig> axes, std::vector<OutputConfig> outputs = {}) {
    ControllerConfig config = zc300_config();
    config.outputs = std::move(outputs);
    return open_controller({config, std::move(axes), line_pair("line").first, &clock});
  };
  EXPECT_THAT(message_of<ConfigError>([&] { open({rotary_axis(AxisId::kYaw, "T")}); }),
              HasSubstr("found \"T\", allowed on zolix-zc300: X, Y, Z."));
  EXPECT_THROW(open({rotary_axis(AxisId::kYaw, "XY")}), ConfigError);
  EXPECT_THROW(open({rotary_axis(AxisId::kYaw, "X"), rotary_axis(AxisId::kRoll, "x")}),
               ConfigError);
  OutputConfig text;
  text.name = "shutter";
  text.on_text = "Open";
  EXPECT_THAT(message_of<ConfigError>([&] { open({linear_axis("X")}, {text}); }),
              HasSubstr("holding register"));
}

// ---- on the simulator

class ZolixZc300 : public ::testing::Test, protected SimulatedZc300 {};

TEST_F(ZolixZc300, AgreesWithItsSimulatorAboutTheSetUp) {
  EXPECT_THAT(controller->connect(), ElementsAre());
  EXPECT_THAT(controller->identity(),
              HasSubstr("channels X Y Z: ZC300-3A serial 26017 firmware 1.2"));
  EXPECT_EQ(count("set"), 0u);
}

TEST_F(ZolixZc300, ConfiguresWhatDiffersAndSavesNothing) {
  std::vector<AxisConfig> real = zc300_axes();
  real[0].lead_mm = 5;
  real[1].kind = StageKind::kLinear;
  real[1].lead_mm = 4;
  real[2].speed = 10;
  SimulatedZc300 rig({.real = real});
  EXPECT_EQ(rig.controller->connect().size(), 6u);
  rig.controller->configure();
  EXPECT_THAT(rig.controller->connect(), ElementsAre());
  EXPECT_EQ(rig.count("0x6D"), 0u);
}

TEST_F(ZolixZc300, DoesNotMoveBeforeItIsConnectedAndHomed) {
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{1}); }),
              HasSubstr("not connected"));
  controller->connect();
  wire.clear();
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().start(Degrees{1}); }), HasSubstr("not homed"));
  EXPECT_EQ(wire.sent(), "");
}

TEST_F(ZolixZc300, ArrivesToThePulse) {
  ready();
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 100; ++i) {
    const double target = draws.uniform(-29.5, 30);
    const Arrival<Degrees> arrival = move(yaw(), target);
    EXPECT_FALSE(arrival.missed);
    EXPECT_EQ(arrival.retries, 0);
    EXPECT_EQ(arrival.requested.value, target);
    EXPECT_NEAR(arrival.position.value, target, 0.00125 / 2 + 1e-9);
    EXPECT_NEAR(counter(AxisId::kYaw), arrival.position.value, 1e-9);
    EXPECT_NEAR(truth(AxisId::kYaw), arrival.position.value, 1e-9);
  }
}

TEST_F(ZolixZc300, StaysWithinAPulseWhereThePulsesAreFinerThanTheTargets) {
  std::vector<AxisConfig> other = zc300_axes();
  other[0].lead_mm = 1;
  other[0].speed = 5;
  other[0].home_speed = 2;
  other[0].tolerance = 0.000625;
  SimulatedZc300 rig({.axes = other});
  rig.controller->connect();
  rig.stage().home();
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 50; ++i) {
    const double target = draws.uniform(0, 200);
    const auto arrival = rig.move(rig.stage(), target);
    EXPECT_FALSE(arrival.missed) << target;
    EXPECT_EQ(arrival.retries, 0) << target;
    EXPECT_NEAR(rig.truth(AxisId::kStage), target, 1.5 * 0.000625 + 1e-9) << target;
  }
}

TEST_F(ZolixZc300, SetsTheRatioOfARotaryAxis) {
  std::vector<AxisConfig> other = zc300_axes();
  other[1].drive_ratio = 90;
  other[1].steps_per_rev = 3200;
  SimulatedZc300 rig({.axes = other});
  EXPECT_THAT(rig.controller->connect(), ElementsAre());
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), -12.5).position.value, -12.5, 1e-9);
  EXPECT_NEAR(rig.truth(AxisId::kYaw), -12.5, 1e-9);
}

TEST_F(ZolixZc300, GoesThroughAGateway) {
  ControllerConfig gateway = zc300_config(LineConfig::Kind::kModbusTcp);
  gateway.address = 7;
  SimulatedZc300 rig({.config = gateway});
  rig.ready();
  EXPECT_NEAR(rig.move(rig.yaw(), 10).position.value, 10, 1e-9);
}

TEST_F(ZolixZc300, FindsItsHomeFromWhereverItWasSwitchedOn) {
  for (const double offset : {-40.0, -0.2, 0.0, 17.3}) {
    SimulatedZc300 rig({.truth = {{AxisId::kYaw, {.home_offset = offset}}}});
    rig.controller->connect();
    rig.yaw().home();
    EXPECT_TRUE(rig.yaw().homed());
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 0.0, 1e-9) << offset;
    EXPECT_NEAR(rig.move(rig.yaw(), 5).position.value, 5.0, 1e-9);
    EXPECT_NEAR(rig.truth(AxisId::kYaw), 5.0, 1e-9) << offset;
  }
}

TEST_F(ZolixZc300, RefusesBeyondItsLimitsBeforeAnyByteLeaves) {
  ready();
  for (const double target : {30.001, -29.6, 1e9, std::nan("")})
    EXPECT_THROW(yaw().start(Degrees{target}), LimitError);
  EXPECT_EQ(wire.sent(), "");
  EXPECT_TRUE(yaw().homed());
}

TEST_F(ZolixZc300, SendsEachMotionCommandOnce) {
  ready();
  move(yaw(), 10);
  EXPECT_EQ(count("move"), 2u);  // to 9.5, and to 10
  EXPECT_EQ(count("home"), 1u);
}

TEST_F(ZolixZc300, StopsAndKnowsThatItHasStopped) {
  ready();
  yaw().start(Degrees{25});
  clock.sleep_for(milliseconds{400});
  yaw().stop();
  EXPECT_FALSE(simulator->axis(AxisId::kYaw).moving(clock.now()));
  EXPECT_TRUE(yaw().homed());
  EXPECT_NEAR(move(yaw(), 5).position.value, 5, 1e-9);
}

TEST_F(ZolixZc300, MovesTwoAxesThatEndAtDifferentTimesWithoutLosingACommand) {
  ControllerConfig quick = zc300_config();
  quick.reply_timeout_s = 0.2;
  SimulatedZc300 rig({.config = quick, .reply_delay_s = 0.005});
  rig.ready();
  rig.roll().home();
  Random draws = draws_of_this_test(1);
  const std::size_t before = rig.count("move");
  std::size_t legs = 0;
  for (int i = 0; i < 200; ++i) {
    const double a = draws.uniform(-29.5, 30), b = draws.uniform(-29.5, 30);
    rig.yaw().start(Degrees{a});
    rig.clock.sleep_for(from_seconds(draws.uniform(0, 0.5)));
    rig.roll().start(Degrees{b});
    wait_all(rig.yaw(), rig.roll());
    for (const auto& arrival : {rig.yaw().arrival(), rig.roll().arrival()})
      legs += arrival.overshot ? 2 : 1;
    EXPECT_NEAR(rig.truth(AxisId::kYaw), a, 0.00125 / 2 + 1e-9);
    EXPECT_NEAR(rig.truth(AxisId::kRoll), b, 0.00125 / 2 + 1e-9);
  }
  EXPECT_EQ(rig.count("move") - before, legs);
}

TEST_F(ZolixZc300, SendsItsFirstMotionSoonThoughEachAnswerTakes60Ms) {
  SimulatedZc300 rig({.reply_delay_s = std::nullopt});
  const Time before = rig.clock.now();
  rig.controller->connect();
  rig.yaw().home();
  const auto first = [&](const std::string& kind) {
    return std::ranges::find(rig.simulator->requests(), kind,
                             &sim::ControllerSimulator::Request::kind)
        ->at;
  };
  const double home_after = seconds(first("home") - before);
  RecordProperty("first_home_opcode_s", std::to_string(home_after));
  EXPECT_LT(home_after, 0.65);
  const Time asked = rig.clock.now();
  rig.yaw().start(Degrees{10});
  EXPECT_LT(seconds(first("move") - asked), 0.3);
  while (!rig.yaw().advance()) {
  }
  EXPECT_NEAR(rig.truth(AxisId::kYaw), 10, 1e-9);
}

TEST_F(ZolixZc300, ReadsTheStatusOfAllAxesAtOnce) {
  SimulatedZc300 rig({.reply_delay_s = std::nullopt});
  rig.ready();
  rig.roll().home();
  rig.stage().home();
  rig.yaw().start(Degrees{20});
  rig.roll().start(Degrees{20});
  rig.stage().start(Millimetres{20});
  const std::size_t before = rig.count("status");
  const Time began = rig.clock.now();
  while (seconds(rig.clock.now() - began) < 0.6) {
    rig.yaw().advance();
    rig.roll().advance();
    rig.stage().advance();
  }
  EXPECT_LT(rig.count("status") - before, 10u);  // one for each 100 ms, and not three
  wait_all(rig.yaw(), rig.roll(), rig.stage());
  EXPECT_NEAR(rig.truth(AxisId::kYaw), 20, 1e-9);
  EXPECT_NEAR(rig.truth(AxisId::kRoll), 20, 1e-9);
  EXPECT_NEAR(rig.truth(AxisId::kStage), 20, 1e-9);
}

TEST_F(ZolixZc300, HoldsACommandBackAroundTheEndOfAnotherMotion) {
  for (int ms = -100; ms <= 100; ms += 4) {
    SimulatedZc300 rig({.reply_delay_s = 0.005});
    rig.ready();
    rig.roll().home();
    rig.roll().start(Degrees{20});
    const auto end = rig.simulator->axis(AxisId::kRoll).ends_at();
    ASSERT_TRUE(end);
    rig.clock.sleep_until(*end + milliseconds{ms - 25});  // what goes before takes about 25 ms
    rig.yaw().start(Degrees{10});
    EXPECT_TRUE(rig.simulator->axis(AxisId::kYaw).moving(rig.clock.now())) << ms;
    wait_all(rig.yaw(), rig.roll());
    EXPECT_EQ(rig.count("move"), 4u) << ms;
  }
}

TEST_F(ZolixZc300, WaitsForTheHomingOfAnotherAxis) {
  ControllerConfig quick = zc300_config();
  quick.reply_timeout_s = 0.1;
  SimulatedZc300 rig({.truth = {{AxisId::kRoll, {.home_offset = 20}}}, .config = quick});
  rig.ready();
  // Nobody waits for this homing any more, but it goes on.
  rig.fault({.kind = sim::FaultKind::kSilence, .verb = "status", .nth = 5, .times = 6});
  EXPECT_THROW(rig.roll().home(), TimeoutError);
  const auto end = rig.simulator->axis(AxisId::kRoll).ends_at();
  ASSERT_TRUE(end);
  rig.yaw().start(Degrees{-20});
  while (rig.count("move") == 0) rig.yaw().advance();
  EXPECT_GE(rig.clock.now(), *end);
  while (!rig.yaw().advance()) {
  }
  EXPECT_NEAR(rig.truth(AxisId::kYaw), -20, 1e-9);
}

}  // namespace
}  // namespace turntable
