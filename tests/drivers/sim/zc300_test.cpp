// The simulated controller against the bytes of the manual's facts (protocols/README.md). The frames
// with their checks were worked out outside this project.
#include "drivers/sim/zc300.h"

#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <string>

#include "drivers/sim/modbus_framer.h"
#include "src/core/errors.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/hex.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using Words = std::vector<std::uint16_t>;

const std::string kSilence;

class Zc300 : public ::testing::Test {
 protected:
  explicit Zc300(ControllerConfig config = with_output(), double reply_delay_s = 0.0)
      : Zc300(line_pair("line"), config, reply_delay_s) {}
  Zc300(std::pair<Line, Line> ends, const ControllerConfig& config, double reply_delay_s)
      : line(std::move(ends.first)),
        device(simulate_zc300({{linear_axis("X"), rotary_axis(AxisId::kYaw, "Y")},
                               {},
                               draws_of_this_test()(),
                               config,
                               reply_delay_s})) {
    device->plug(std::move(ends.second));
    device->on_output([this](const std::string& name, bool on, Time) {
      outputs.push_back(name + (on ? " on" : " off"));
    });
    clock.attach(*device);
  }
  ~Zc300() override { clock.detach(*device); }

  static ControllerConfig with_output() {
    ControllerConfig config;
    OutputConfig shutter, lamp;
    shutter.name = "shutter";
    shutter.register_at = 30064;
    shutter.bit = 1;
    lamp.name = "lamp";
    lamp.register_at = 5;
    lamp.slave = 9;
    lamp.on_value = 0xFF00;
    config.outputs = {shutter, lamp};
    return config;
  }

  /// Sends bytes as they are, and returns all that comes back at once.
  std::string raw(const std::string& hex) {
    clock.sleep_for(milliseconds{2});  // the silence between frames
    line.write(bytes_of(hex), clock, clock.now());
    clock.sleep_until(clock.now());
    return heard();
  }
  std::string heard() {
    std::array<char, 1024> buffer;
    return hex_of({buffer.data(), line.read_available(buffer, clock.now())});
  }
  std::string after(Time time) {
    clock.sleep_for(time);
    return heard();
  }

  // In the manual's numbers; the framing is pinned by the tests that write bytes.
  static std::string framed(std::string pdu) {
    pdu = "\x01" + pdu;
    const std::uint16_t crc = modbus_crc(pdu);
    return hex_of(pdu) + fmt::format("{:02x}{:02x}", crc & 0xFF, crc >> 8);
  }
  static std::string request(int function, int number, const std::string& rest) {
    return framed(bytes_of(fmt::format("{:02x}{:04x}{}", function, number - 1, rest)));
  }
  /// The words, or the exception as one word 0x8000 + code.
  static Words parsed(const std::string& hex) {
    const std::string answer = bytes_of(hex);
    const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(answer.at(i)); };
    if ((byte(1) & 0x80) != 0) return {static_cast<std::uint16_t>(0x8000 + byte(2))};
    Words words;
    for (std::size_t i = 3; i + 3 < answer.size(); i += 2)
      words.push_back(static_cast<std::uint16_t>(byte(i) << 8 | byte(i + 1)));
    return words;
  }
  Words input(int number, int count) {
    return parsed(raw(request(4, number, fmt::format("{:04x}", count))));
  }
  Words holding(int number, int count = 1) {
    return parsed(raw(request(3, number, fmt::format("{:04x}", count))));
  }
  double real(int number) {
    const Words words = holding(number, 2);
    return std::bit_cast<float>(static_cast<std::uint32_t>(words.at(0)) << 16 | words.at(1));
  }
  /// The code of the refusal; 0 = done, -1 = no answer.
  static int outcome(const std::string& answer) {
    if (answer.empty()) return -1;
    const std::string bytes = bytes_of(answer);
    return (bytes.at(1) & 0x80) != 0 ? bytes.at(2) : 0;
  }
  int write(int number, const Words& words) {
    std::string rest = fmt::format("{:04x}{:02x}", words.size(), 2 * words.size());
    for (const auto word : words) rest += fmt::format("{:04x}", word);
    return outcome(raw(request(16, number, rest)));
  }
  int write_one(int number, int word) {
    return outcome(raw(request(6, number, fmt::format("{:04x}", word))));
  }
  int write_real(int number, double value) {
    const auto bits = std::bit_cast<std::uint32_t>(static_cast<float>(value));
    return write(number,
                 {static_cast<std::uint16_t>(bits >> 16), static_cast<std::uint16_t>(bits)});
  }
  double position(int axis) {  // 0 X, 1 Y
    const Words words = input(30016 + 2 * axis, 2);
    return std::bit_cast<float>(static_cast<std::uint32_t>(words.at(0)) << 16 | words.at(1));
  }
  unsigned bits() { return input(30015, 1).at(0); }
  /// Waits for the end of all motion, and has it miss the request that it may miss.
  void rest() {
    clock.sleep_for(seconds{60});
    raw(request(3, 30069, "0001"));
    ASSERT_NE(raw(request(3, 30069, "0001")), kSilence);
  }
  void go(int axis, double target) {
    ASSERT_EQ(write_real(30114 + 2 * axis, std::abs(target)), 0);
    ASSERT_EQ(write(30050, {0x64, static_cast<std::uint16_t>(0x31 + axis),
                            static_cast<std::uint16_t>(target < 0 ? 'N' : 'P')}),
              0);
    rest();
  }
  double truth(AxisId id) const { return device->axis(id).true_position(clock.now()); }
  double counter(AxisId id) const { return device->axis(id).counter_position(clock.now()); }
  bool moving(AxisId id) const { return device->axis(id).moving(clock.now()); }

  ManualClock clock;
  Line line;
  std::unique_ptr<ControllerSimulator> device;
  std::vector<std::string> outputs;
};

// ---- bytes

TEST_F(Zc300, SaysWhoItIs) {
  EXPECT_EQ(raw("01047530000a6a0e"), "0104145a433330302d3341000000000000000065a1000c02e9");
}

TEST_F(Zc300, TellsItsStatusInOneRead) {
  // Home bits of X and Y, which stand at their switches, and of Z, which is not there.
  EXPECT_EQ(raw("0104753b000a1bcc"), "0104140000000000000124000000000000000000000000e4a4");
}

TEST_F(Zc300, MovesAsTheManualSays) {
  EXPECT_EQ(raw("011075a300020440b008467145"), "011075a30002abe6");
  EXPECT_EQ(raw("010375a300022e25"), "01030440b00a3d2965");  // whole pulses: 5.50125
  EXPECT_EQ(raw("0110756100030600640032004e5fc5"), "011075610003cbda");
  EXPECT_EQ(input(30012, 3), (Words{0, 1, 0}));
  rest();
  EXPECT_EQ(input(30012, 3), (Words{0, 0, 0}));
  EXPECT_NEAR(counter(AxisId::kYaw), -5.50125, 1e-9);
  EXPECT_NEAR(position(1), -5.50125, 1e-6);
}

TEST_F(Zc300, HomesAndStopsAsTheManualSays) {
  go(1, 12);
  EXPECT_EQ(raw("01107561000204006900323f10"), "0110756100020a1a");
  clock.sleep_for(milliseconds{300});
  EXPECT_EQ(raw("01107561000204006700325ed3"), "0110756100020a1a");
  EXPECT_TRUE(moving(AxisId::kYaw));  // it decelerates
  rest();
  EXPECT_EQ(raw("01107561000204006900323f10"), "0110756100020a1a");
  rest();
  EXPECT_TRUE(device->axis(AxisId::kYaw).homed(clock.now()));
  EXPECT_EQ(raw("011075610003060064003200500000").size(), 0u);  // a spoiled check: silence
  clock.sleep_for(seconds{1});
  ASSERT_EQ(write_real(30116, 20), 0);
  ASSERT_EQ(raw("01107561000306006400320050dfcd"), "011075610003cbda");
  clock.sleep_for(milliseconds{300});
  EXPECT_EQ(raw("01107561000204006800326ed0"), "0110756100020a1a");
  EXPECT_FALSE(moving(AxisId::kYaw));  // at once
}

TEST_F(Zc300, CountsOnWhileItHomes) {
  go(1, 12);
  ASSERT_EQ(write_real(30061, 5), 0);
  ASSERT_EQ(write(30050, {0x69, 0x32}), 0);
  rest();
  EXPECT_NEAR(truth(AxisId::kYaw), 0, 1e-9);
  EXPECT_NEAR(position(1), -7, 1e-5);
  ASSERT_EQ(write_real(30061, 0), 0);
  EXPECT_EQ(position(1), 0.0);
  go(1, 3);
  EXPECT_NEAR(truth(AxisId::kYaw), 3, 1e-9);
}

TEST_F(Zc300, RefusesInTheManualsBytes) {
  EXPECT_EQ(raw("0103753b000aae0c"), "018302c0f1");  // an input register by function 3
  EXPECT_EQ(raw("010175610001b618"), "0181018190");  // function 1
  EXPECT_EQ(raw("011075610004080064003200500000641f"), "0190030c01");  // padded
  EXPECT_EQ(raw("0110756100010200994a8c"), "01900acc07");              // opcode 99h
}

TEST_F(Zc300, SavesInItsOwnTime) {
  EXPECT_EQ(raw("01107561000102006d4b0b"), kSilence);
  EXPECT_EQ(after(milliseconds{1050}), kSilence);
  EXPECT_EQ(after(milliseconds{20}), "0110756100014a1b");
}

TEST_F(Zc300, SpeaksModbusTcpBehindAGateway) {
  ControllerConfig config;
  config.line.kind = LineConfig::Kind::kModbusTcp;
  config.address = 3;
  const auto gateway = simulate_zc300({{linear_axis("X")}, {}, 1, config});
  auto [near, far] = line_pair("line");
  gateway->plug(std::move(far));
  clock.attach(*gateway);
  near.write(bytes_of("12340000000603047541"
                      "0001"
                      "1235000000060403753b0001"),
             clock, clock.now());
  clock.sleep_for(milliseconds{100});
  std::array<char, 64> buffer;
  EXPECT_EQ(hex_of({buffer.data(), near.read_available(buffer, clock.now())}),
            "12340000000503040200"
            "00");
  clock.detach(*gateway);
}

TEST_F(Zc300, IsDeafToOtherSlavesAndToSpoiledFrames) {
  EXPECT_EQ(raw("02047530000a6a3d"), kSilence);
  EXPECT_EQ(raw("01047530000a6a0f"), kSilence);
  EXPECT_EQ(raw("01047530000a6a0e").size(), 50u);
}

// ---- registers

TEST_F(Zc300, HasEachRegisterForItsFunctionsOnly) {
  EXPECT_EQ(input(30001, 49).size(), 49u);
  EXPECT_EQ(input(30001, 50), Words{0x8002});
  EXPECT_EQ(input(30049, 2), Words{0x8002});
  EXPECT_EQ(input(30050, 1), Words{0x8002});
  EXPECT_EQ(holding(30049), Words{0x8002});
  EXPECT_EQ(holding(30050, 91).size(), 91u);
  EXPECT_EQ(holding(30050, 92), Words{0x8002});
  EXPECT_EQ(holding(30141), Words{0x8002});
  EXPECT_EQ(holding(30050, 0), Words{0x8003});
  EXPECT_EQ(holding(30050, 126), Words{0x8003});
  EXPECT_EQ(write_one(30012, 1), 2);
  EXPECT_EQ(write(30012, {1}), 2);
  EXPECT_EQ(write_one(30050, 0x6D), 2);  // opcodes come by function 16 only
  EXPECT_EQ(write(30140, {0, 0}), 2);
  for (const int function : {1, 2, 5, 15 + 2, 43})
    EXPECT_EQ(outcome(raw(request(function, 30050, "0001"))), 1) << function;
  EXPECT_EQ(outcome(raw(request(16, 30054,
                                "0002"
                                "02"
                                "0001"))),
            3);  // count and bytes disagree
}

TEST_F(Zc300, IsSetUpLikeItsStages) {
  EXPECT_EQ(holding(30072, 3), (Words{1, 2, 1}));
  EXPECT_EQ(input(30022, 3), (Words{1, 2, 1}));
  EXPECT_EQ(holding(30075, 6), (Words{0, 1600, 0, 1600, 0, 1600}));
  EXPECT_EQ(holding(30081, 3), (Words{0, 1, 0}));
  EXPECT_EQ(real(30084), 4.0);
  EXPECT_EQ(real(30090), 1.0);
  EXPECT_EQ(real(30092), 180.0);
  EXPECT_NEAR(real(30101), 5, 1e-5);
  EXPECT_NEAR(real(30123), 1, 1e-6);
  EXPECT_NEAR(real(30125), 1, 1e-6);
  EXPECT_NEAR(real(30129), 20, 1e-5);
  EXPECT_NEAR(real(30131), 25, 1e-5);
  EXPECT_NEAR(real(30137), 50, 1e-5);
  EXPECT_EQ(holding(30066, 4), (Words{1, 1, 1, 1}));  // enabled; and the slave address
  EXPECT_EQ(holding(30105, 3), (Words{3, 3, 3}));
  EXPECT_EQ(holding(30120, 3), (Words{1, 1, 1}));
  EXPECT_EQ(real(30114), 0.0);
}

TEST_F(Zc300, KeepsWhatItIsSetTo) {
  for (const auto& [number, word] : std::vector<std::pair<int, int>>{{30065, 5},
                                                                     {30067, 0},
                                                                     {30070, 1},
                                                                     {30071, 200},
                                                                     {30073, 0},
                                                                     {30082, 0},
                                                                     {30106, 1},
                                                                     {30109, 0x43},
                                                                     {30112, 0x41},
                                                                     {30121, 0}}) {
    EXPECT_EQ(write_one(number, word), 0) << number;
    EXPECT_EQ(holding(number).at(0), word) << number;
  }
  for (const int number : {30129, 30123, 30114, 30135, 30084, 30090, 30099}) {
    EXPECT_EQ(write_real(number, 12.5), 0) << number;
    EXPECT_NEAR(real(number), 12.5, 1e-5) << number;
  }
  EXPECT_EQ(write_real(30123, 0), 0);  // ramps from standstill
  EXPECT_EQ(write(30075, {0, 3200}), 0);
  EXPECT_EQ(write_one(30076, 800), 0);  // half of a pair
  EXPECT_EQ(holding(30075, 2), (Words{0, 800}));
}

TEST_F(Zc300, TakesNothingInReservedRegisters) {
  for (const int number : {30054, 30055, 30056, 30057, 30058, 30096, 30097, 30098}) {
    EXPECT_EQ(write_one(number, 7), 2) << number;
    EXPECT_EQ(holding(number), Words{0}) << number;
  }
  EXPECT_EQ(write(30057, {1, 1, 0, 0}), 2);  // nor in passing
  EXPECT_EQ(input(30025, 25), Words(25, 0));
}

TEST_F(Zc300, RefusesValuesThatCannotBe) {
  EXPECT_EQ(write_one(30065, 8), 5);
  EXPECT_EQ(write_one(30066, 2), 5);
  EXPECT_EQ(write_one(30069, 0), 5);
  EXPECT_EQ(write_one(30069, 256), 5);
  EXPECT_EQ(write_one(30070, 2), 5);
  EXPECT_EQ(write_one(30071, 256), 5);
  EXPECT_EQ(write_one(30072, 3), 5);
  EXPECT_EQ(write(30075, {0, 0}), 5);
  EXPECT_EQ(write(30075, {10000000 >> 16, 10000000 & 0xFFFF}), 5);
  EXPECT_EQ(write(30075, {9999999 >> 16, 9999999 & 0xFFFF}), 0);
  EXPECT_EQ(write(30075, {0, 1600}), 0);
  EXPECT_EQ(write_one(30081, 2), 5);
  EXPECT_EQ(write_one(30105, 0), 5);
  EXPECT_EQ(write_one(30105, 4), 5);
  EXPECT_EQ(write_one(30108, 0x52), 5);
  EXPECT_EQ(write_one(30111, 0x4A), 5);
  EXPECT_EQ(write_one(30120, 2), 5);
  for (const int number : {30084, 30090, 30099, 30129, 30135})
    for (const double value : {0.0, -1.0, static_cast<double>(NAN), static_cast<double>(INFINITY)})
      EXPECT_EQ(write_real(number, value), 5) << number << " " << value;
  EXPECT_EQ(write_real(30084, 1000), 5);
  EXPECT_EQ(write_real(30090, 10000), 5);
  EXPECT_EQ(write_real(30123, -1), 5);
  EXPECT_EQ(write_real(30123, 20.1), 5);   // above the cruise speed
  EXPECT_EQ(write_real(30129, 0.9), 5);    // below the initial one
  EXPECT_EQ(write_real(30099, 20), 5);     // not below the cruise speed
  EXPECT_EQ(write_real(30135, 25000), 5);  // 10^7 pulses/s^2
  EXPECT_EQ(write_real(30114, -1), 5);     // the sign is a letter of the command
  EXPECT_EQ(write_real(30059, NAN), 5);
  EXPECT_EQ(write_real(30059, 25001), 5);
  EXPECT_EQ(write(30066, {0, 2}), 5);
  EXPECT_EQ(holding(30066), Words{1});  // all or nothing
}

TEST_F(Zc300, KeepsSpeedsAndDistancesInPulses) {
  EXPECT_EQ(write_real(30116, 10), 0);
  EXPECT_EQ(write_real(30086, 4), 0);  // of a rotary stage it makes nothing
  EXPECT_NEAR(real(30116), 10, 1e-5);
  EXPECT_EQ(write_real(30092, 90), 0);  // twice the way per pulse
  EXPECT_NEAR(real(30131), 50, 1e-5);
  EXPECT_NEAR(real(30116), 20, 1e-5);
  EXPECT_EQ(write_one(30073, 0), 0);  // pulses
  EXPECT_EQ(real(30131), 20000);
  EXPECT_EQ(real(30116), 8000);
}

TEST_F(Zc300, CutsDistancesOffToAThousandth) {
  EXPECT_EQ(write_real(30084, 1), 0);  // 0.000625 mm per pulse
  for (const auto& [written, kept] : std::vector<std::pair<double, double>>{
           {0.0019, 0.00125}, {0.00201, 0.001875}, {12.34501, 12.345}, {12.3449, 12.34375}}) {
    EXPECT_EQ(write_real(30114, written), 0);
    EXPECT_NEAR(real(30114), kept, 1e-6) << written;
  }
  EXPECT_EQ(write_one(30072, 0), 0);
  EXPECT_EQ(write_real(30114, 12345), 0);  // but not those in pulses
  EXPECT_EQ(real(30114), 12345);
}

// ---- motion

TEST_F(Zc300, MovesAbsolutelyRelativelyAndEndlessly) {
  go(1, 10);
  EXPECT_NEAR(counter(AxisId::kYaw), 10, 1e-9);
  EXPECT_EQ(write_real(30116, 4), 0);
  EXPECT_EQ(write(30050, {0x65, 0x32, 'N'}), 0);
  rest();
  EXPECT_NEAR(counter(AxisId::kYaw), 6, 1e-9);
  EXPECT_EQ(write(30050, {0x65, 0x32, 'P'}), 0);
  rest();
  EXPECT_NEAR(counter(AxisId::kYaw), 10, 1e-9);
  EXPECT_EQ(write(30050, {0x66, 0x31, 'P'}), 0);
  rest();
  EXPECT_TRUE(device->axis(AxisId::kStage).at_hard_limit(clock.now()));
  EXPECT_EQ(bits() & 3u, 1u);
  EXPECT_EQ(write(30050, {0x66, 0x31, 'P'}), 7);
  EXPECT_EQ(write(30050, {0x66, 0x31, 'N'}), 0);
  rest();
  EXPECT_EQ(bits() & 3u, 2u);
}

TEST_F(Zc300, GoesToZeroWhenNoTargetWasEverWritten) {
  go(1, 10);
  EXPECT_EQ(write(30050, {0x64, 0x31, 'P'}), 0);  // X, to 0, where it stands
  rest();
  EXPECT_EQ(counter(AxisId::kStage), 0.0);
}

TEST_F(Zc300, MovesAndStopsAllAxesAtOnce) {
  EXPECT_EQ(write_real(30114, 100), 0);
  EXPECT_EQ(write_real(30116, 25), 0);
  EXPECT_EQ(write(30050, {0x64, 0x30, 'P'}), 0);
  EXPECT_EQ(input(30012, 3), (Words{1, 1, 0}));
  clock.sleep_for(milliseconds{300});
  EXPECT_EQ(write(30050, {0x67, 0x30}), 5);  // that is for one axis
  EXPECT_EQ(write(30050, {0x68, 0x30}), 0);
  EXPECT_FALSE(moving(AxisId::kStage));
  EXPECT_FALSE(moving(AxisId::kYaw));
}

TEST_F(Zc300, LetsThePresentPlaceCountAsAnything) {
  go(1, 10);
  EXPECT_EQ(write_real(30061, -3.5), 0);
  EXPECT_NEAR(position(1), -3.5, 1e-6);
  EXPECT_NEAR(truth(AxisId::kYaw), 10, 1e-9);
  go(1, 0);
  EXPECT_NEAR(truth(AxisId::kYaw), 13.5, 1e-9);
}

TEST_F(Zc300, HomesByItsMode) {
  go(1, 10);
  ASSERT_EQ(write_real(30061, 4), 0);
  EXPECT_EQ(write_one(30106, 1), 0);  // the user's origin
  EXPECT_EQ(write(30050, {0x69, 0x32}), 0);
  rest();
  EXPECT_NEAR(truth(AxisId::kYaw), 6, 1e-9);
  EXPECT_EQ(write_one(30106, 3), 0);  // the switch
  EXPECT_EQ(write(30050, {0x69, 0x32}), 0);
  rest();
  EXPECT_NEAR(truth(AxisId::kYaw), 0, 1e-9);
  EXPECT_EQ(write_one(30105, 2), 0);  // the negative limit
  EXPECT_EQ(write(30050, {0x69, 0x31}), 0);
  rest();
  EXPECT_TRUE(device->axis(AxisId::kStage).at_hard_limit(clock.now()));
  EXPECT_LT(position(0), -1.0);  // counted on
}

TEST_F(Zc300, RefusesOpcodesOfTheWrongLengthOrValue) {
  for (const std::uint16_t opcode : Words{0x63, 0x6A, 0x6B, 0x6E, 0x99, 0x164})
    EXPECT_EQ(write(30050, {opcode, 0x32, 'P'}), 10) << opcode;
  for (const std::uint16_t opcode : Words{0x64, 0x65, 0x66}) {
    EXPECT_EQ(write(30050, {opcode, 0x32}), 3);
    EXPECT_EQ(write(30050, {opcode, 0x32, 'P', 0}), 3);
    EXPECT_EQ(write(30050, {opcode, 0x34, 'P'}), 5);
    EXPECT_EQ(write(30050, {opcode, 0x32, 'Q'}), 5);
  }
  for (const std::uint16_t opcode : Words{0x67, 0x68, 0x69}) {
    EXPECT_EQ(write(30050, {opcode}), 3);
    EXPECT_EQ(write(30050, {opcode, 0x32, 'P'}), 3);
    EXPECT_EQ(write(30050, {opcode, 0x2F}), 5);
  }
  EXPECT_EQ(write(30050, {0x6D, 0x32}), 3);
  EXPECT_EQ(write(30050, {0x6C, 0x32}), 3);
  EXPECT_FALSE(moving(AxisId::kYaw));
}

TEST_F(Zc300, RefusesWhatIsNotAllowedNow) {
  EXPECT_EQ(write(30050, {0x64, 0x33, 'P'}), 9);  // no stage there
  EXPECT_EQ(write_one(30067, 0), 0);
  EXPECT_EQ(write(30050, {0x64, 0x32, 'P'}), 9);
  EXPECT_EQ(write_one(30067, 1), 0);
  EXPECT_EQ(write_real(30116, 20), 0);
  EXPECT_EQ(write(30050, {0x64, 0x32, 'P'}), 0);
  EXPECT_EQ(write(30050, {0x64, 0x32, 'P'}), 6);
  EXPECT_EQ(write(30050, {0x69, 0x32}), 6);
  EXPECT_EQ(write(30050, {0x6D}), 4);
  EXPECT_EQ(write(30050, {0x6C}), 6);
  EXPECT_EQ(write_real(30131, 5), 6);
  EXPECT_EQ(write_one(30073, 0), 6);
  rest();
  EXPECT_NEAR(counter(AxisId::kYaw), 20, 1e-9);  // none of which disturbed the move
}

TEST_F(Zc300, SaysWhatStoppedIt) {
  device->add_fault({.kind = FaultKind::kEmergencyStop, .verb = "0x64", .delay_s = 0.3});
  go(1, 20);
  EXPECT_LT(counter(AxisId::kYaw), 10);
  EXPECT_EQ(bits() & 1u << 9, 1u << 9);
  EXPECT_EQ(write(30050, {0x64, 0x32, 'P'}), 8);
  device->clear_trouble();
  device->add_fault({.kind = FaultKind::kAlarm, .verb = "move", .delay_s = 0.1});
  go(1, 20);
  EXPECT_EQ(bits() >> 9, 4u);  // Y's driver
  device->clear_trouble();
  device->add_fault({.kind = FaultKind::kLimitHit, .verb = "move", .delay_s = 0.1});
  go(1, -20);
  EXPECT_EQ(bits() >> 3 & 7u, 2u);
  EXPECT_EQ(write(30050, {0x64, 0x32, 'N'}), 7);
  EXPECT_EQ(write(30050, {0x69, 0x32}), 0);  // but home it finds
  rest();
  EXPECT_EQ(bits() >> 3 & 7u, 4u);
}

TEST_F(Zc300, MissesARequestAfterAMotionNowAndThen) {
  int missed = 0;
  ASSERT_EQ(write_real(30114, 0.1), 0);
  for (int i = 0; i < 400; ++i) {
    ASSERT_EQ(write(30050, {0x65, 0x31, static_cast<std::uint16_t>(i % 2 == 0 ? 'P' : 'N')}), 0);
    clock.sleep_for(seconds{1});
    if (raw(request(3, 30069, "0001")) == kSilence) {
      ++missed;
      EXPECT_NE(raw(request(3, 30069, "0001")), kSilence);
    }
  }
  EXPECT_GT(missed, 4);
  EXPECT_LT(missed, 60);
}

TEST(Zc300Timing, AnswersAsLateAsARealOne) {
  ManualClock clock;
  auto [near, far] = line_pair("line");
  const auto device = simulate_zc300({{linear_axis("X")}, {}, draws_of_this_test()(), {}});
  device->plug(std::move(far));
  clock.attach(*device);
  std::array<char, 64> buffer;
  double least = 1, most = 0;
  for (int i = 0; i < 100; ++i) {
    clock.sleep_for(milliseconds{2});
    near.write(bytes_of("01047530000a6a0e"), clock, clock.now());
    const Time asked = clock.now();
    while (near.read_available(buffer, clock.now()) == 0) clock.sleep_for(milliseconds{1});
    const double took = turntable::seconds(clock.now() - asked);
    least = std::min(least, took);
    most = std::max(most, took);
  }
  EXPECT_GE(least, 0.056);
  EXPECT_LT(least, 0.062);
  EXPECT_GT(most, 0.068);
  EXPECT_LE(most, 0.075);
  clock.detach(*device);
}

// ---- memory

TEST_F(Zc300, ForgetsWhatWasNotSaved) {
  go(1, 10);
  EXPECT_EQ(write_one(30065, 3), 0);
  EXPECT_EQ(write_one(30067, 0), 0);
  EXPECT_EQ(write_real(30129, 10), 0);
  EXPECT_EQ(write_real(30114, 7), 0);
  EXPECT_EQ(write(30050, {0x6D}), -1);
  EXPECT_NE(after(seconds{2}), kSilence);
  EXPECT_EQ(write_real(30131, 10), 0);
  EXPECT_EQ(write_real(30116, 3), 0);
  device->add_fault({.kind = FaultKind::kReset, .verb = "get"});
  holding(30069);
  clock.sleep_for(milliseconds{1});
  EXPECT_EQ(holding(30065), Words{0});
  EXPECT_EQ(holding(30067), Words{1});
  EXPECT_NEAR(real(30129), 10, 1e-5);
  EXPECT_NEAR(real(30131), 25, 1e-5);
  EXPECT_NEAR(real(30114), 7, 1e-5);
  EXPECT_NEAR(real(30116), 10, 1e-5);  // as it was saved
  EXPECT_EQ(position(1), 0.0);
  EXPECT_NEAR(truth(AxisId::kYaw), 10, 1e-9);
}

TEST_F(Zc300, ReturnsToTheFactorysSettings) {
  EXPECT_EQ(write(30050, {0x6C}), 0);
  EXPECT_EQ(holding(30075, 2), (Words{0, 1600}));
  EXPECT_EQ(real(30086), 4.0);
  EXPECT_EQ(real(30092), 1.0);
  EXPECT_EQ(write_one(30073, 0), 0);
  EXPECT_EQ(real(30131), 8000);
  EXPECT_EQ(real(30137), 12000);
}

TEST_F(Zc300, AnswersToANewAddressAtOnce) {
  EXPECT_EQ(write_one(30069, 2), 0);
  EXPECT_EQ(raw("01047530000a6a0e"), kSilence);
  EXPECT_EQ(raw("02047530000a6a3d").size(), 50u);
}

TEST_F(Zc300, SwitchesTheOutputsOfTheRigFile) {
  EXPECT_EQ(raw("01067570000213dc"), "01067570000213dc");  // OUT2
  EXPECT_EQ(write(30065, {3}), 0);  // OUT1 too: of which the rig file tells nothing
  EXPECT_EQ(write_one(30065, 1), 0);
  EXPECT_EQ(holding(30065), Words{1});
  EXPECT_EQ(raw("09060005ff00d973"), "09060005ff00d973");  // another slave on the same bus
  EXPECT_EQ(outputs, (std::vector<std::string>{"shutter on", "shutter off", "lamp on"}));
  EXPECT_EQ(write_one(30200, 1), 2);  // there is no such register
}

// ---- what the faults make of it

TEST_F(Zc300, TellsOfItsRequests) {
  device->note_requests();
  raw("0104753b000a1bcc");
  input(30015, 1);
  write_real(30116, 1);
  write(30050, {0x64, 0x32, 'P'});
  write(30050, {0x67, 0x31});
  write(30050, {0x69, 0x31});
  std::string told;
  for (const auto& r : device->requests())
    told += fmt::format("{} {} {}\n", r.verb, r.kind, r.axis ? axis_name(*r.axis) : "-");
  EXPECT_EQ(told,
            "fc04 status -\nfc04 get -\nfc16 set yaw\n0x64 move yaw\n0x67 stop stage\n"
            "0x69 home stage\n");
}

TEST_F(Zc300, RefusesAsAFaultSays) {
  device->add_fault({.kind = FaultKind::kErrorReply, .verb = "move", .text = "08"});
  device->add_fault({.kind = FaultKind::kErrorReply, .verb = "move", .text = "0A"});
  EXPECT_EQ(write(30050, {0x64, 0x32, 'P'}), 10);  // the later fault has the last word
  EXPECT_FALSE(moving(AxisId::kYaw));
}

TEST_F(Zc300, NamesChannelsThatItDoesNotHave) {
  EXPECT_THROW(simulate_zc300({{linear_axis("T")}, {}, 1}), ConfigError);
}

}  // namespace
}  // namespace turntable::sim
