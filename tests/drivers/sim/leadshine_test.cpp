// The simulated drives against the bytes of the manuals' facts (protocols/README.md); frames and
// checksums worked out by hand.
#include "drivers/sim/leadshine.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <string>

#include "src/core/errors.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/hex.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::ElementsAre;

/// Stage, yaw, roll and pitch at the addresses 1 to 4. Yaw: 0.00125 deg per pulse.
std::vector<AxisConfig> bus_axes() {
  return {linear_axis("1"), rotary_axis(AxisId::kYaw, "2"), rotary_axis(AxisId::kRoll, "3"),
          rotary_axis(AxisId::kPitch, "4")};
}

ControllerConfig bus(LineConfig::Kind kind) {
  ControllerConfig config;
  config.line.kind = kind;
  OutputConfig output;
  output.name = "camera";
  output.register_at = 0x0157;
  output.slave = 2;
  output.on_value = 0x80;
  config.outputs = {output};
  return config;
}

class Leadshine : public ::testing::Test {
 protected:
  explicit Leadshine(LineConfig::Kind kind = LineConfig::Kind::kSimulated,
                     LeadshineGuesses guesses = {})
      : Leadshine(line_pair("bus line"), kind, guesses) {}
  Leadshine(std::pair<Line, Line> ends, LineConfig::Kind kind, LeadshineGuesses guesses)
      : line(std::move(ends.first)),
        device(simulate_leadshine({bus_axes(), {}, draws_of_this_test()(), bus(kind)}, guesses)) {
    device->plug(std::move(ends.second));
    device->note_requests();
    clock.attach(*device);
  }
  ~Leadshine() override { clock.detach(*device); }

  /// Sends a frame as it is, and returns all that comes back at once.
  std::string raw(std::string_view hex) {
    clock.sleep_for(milliseconds{2});  // the silence between frames
    line.write(bytes_of(hex), clock, clock.now());
    clock.sleep_until(clock.now());
    return heard();
  }
  std::string heard() {
    std::array<char, 1024> buffer;
    return hex_of({buffer.data(), line.read_available(buffer, clock.now())});
  }
  /// The same without the checksum, which is added and checked.
  std::string ask(std::string_view hex) {
    const std::string frame = bytes_of(hex);
    const std::string reply = raw(hex_of(frame + modbus_checksum(frame)));
    if (reply.empty()) return {};
    const std::string bytes = bytes_of(reply), body = bytes.substr(0, bytes.size() - 2);
    EXPECT_EQ(bytes.substr(bytes.size() - 2), modbus_checksum(body)) << reply;
    return hex_of(body);
  }
  std::string read(int slave, int address, int words = 1) {
    const std::string reply = ask(fmt::format("{:02x}03{:04x}{:04x}", slave, address, words));
    return reply.substr(std::min<std::size_t>(reply.size(), 6));
  }
  void set(int slave, int address, int value) {
    const std::string request = fmt::format("{:02x}06{:04x}{:04x}", slave, address, value);
    EXPECT_EQ(ask(request), request);
  }
  /// Path `path`, with 750 rpm and 667 ms per 1000 rpm.
  void write_path(int slave, int path, int mode, int position, int rpm = 750, int special = 0) {
    const int at = 0x6200 + 8 * path;
    EXPECT_EQ(ask(fmt::format("{:02x}10{:04x}000810{:04x}{:08x}{:04x}029b029b0000{:04x}", slave, at,
                              mode, static_cast<unsigned>(position), rpm & 0xFFFF, special)),
              fmt::format("{:02x}10{:04x}0008", slave, at));
  }
  double yaw() { return device->axis(AxisId::kYaw).counter_position(clock.now()); }
  bool moving() { return device->axis(AxisId::kYaw).moving(clock.now()); }

  ManualClock clock;
  Line line;
  std::unique_ptr<ControllerSimulator> device;
};

// ---- frames

TEST_F(Leadshine, AnswersWithTheBytesOfTheManual) {
  EXPECT_EQ(raw("010300010001d5ca"), "0103020640ba14");     // 1600 pulses per revolution
  EXPECT_EQ(raw("01031003000170ca"), "01030200023985");     // enabled
  EXPECT_EQ(raw("03066002002036 30"), "0306600200203630");  // home
  EXPECT_EQ(raw("0203602a0002fbf0"), "02030400000000c933");
}

TEST_F(Leadshine, RefusesInModbusWords) {
  EXPECT_EQ(raw("010400010001600a"), "01840182c0");  // function
  EXPECT_EQ(raw("01030500000184c6"), "018302c0f1");  // register
  EXPECT_EQ(raw("010600010064d9e1"), "0186030261");  // value
  EXPECT_EQ(ask("01 01 0000 0001"), "018101");
  EXPECT_EQ(ask("01 03 0001 0000"), "018303");
  EXPECT_EQ(ask("01 03 0009 0002"), "018302");  // runs into a gap
  EXPECT_EQ(ask("01 10 6006 0002 04 0000 0001"), "011060060002");
  EXPECT_EQ(ask("01 10 6006 0002 02 0000"), "019003");  // count and bytes disagree
  EXPECT_EQ(ask("01 06 1003 0001"), "018602");          // read only
  EXPECT_EQ(ask("01 06 6002 0030"), "018603");
  EXPECT_EQ(ask("01 06 1801 1234"), "018603");
}

TEST_F(Leadshine, AWriteOfSeveralRegistersIsDoneWholeOrNotAtAll) {
  EXPECT_EQ(ask("02 10 6002 0002 04 0010 0001"), "029002");
  EXPECT_EQ(ask("02 10 000E 0002 04 0000 0007"), "029003");
  EXPECT_EQ(read(2, 0x000F), "0001");
}

TEST_F(Leadshine, ASpoiltFrameAndOneForAnotherSlaveAreNotAnswered) {
  EXPECT_EQ(raw("010300010001d5cb"), "");
  EXPECT_EQ(raw("050310030001714e"), "");
  EXPECT_EQ(raw("010300010001d5ca"), "0103020640ba14");
}

TEST_F(Leadshine, ABroadcastIsCarriedOutByAllAndAnsweredByNone) {
  EXPECT_EQ(raw("0006600200203603"), "");
  clock.sleep_for(milliseconds{50});
  for (const AxisId id : kAllAxes) EXPECT_TRUE(device->axis(id).moving(clock.now()));
  EXPECT_EQ(ask("00 03 1003 0001"), "");
}

TEST_F(Leadshine, TellsItsRequestsAsAPersonWould) {
  read(2, 0x1003);
  read(2, 0x602A, 2);
  read(3, 0x0001);
  set(2, 0x6017, 100);
  set(2, 0x6002, 0x10);
  set(2, 0x6002, 0x20);
  set(2, 0x6002, 0x40);
  write_path(4, 0, 1, 100);
  write_path(4, 0, 1, 100, 750, 0x10);
  std::vector<std::string> told;
  for (const auto& request : device->requests())
    told.push_back(fmt::format("{} {} {}", axis_name(*request.axis), request.kind, request.verb));
  EXPECT_THAT(told,
              ElementsAre("yaw status fc03", "yaw status fc03", "roll get fc03",
                          "yaw set 0x6017=0x64", "yaw move 0x6002=0x10", "yaw home 0x6002=0x20",
                          "yaw stop 0x6002=0x40", "pitch set fc16", "pitch move fc16"));
}

// ---- motion

TEST_F(Leadshine, RunsAPathAndShowsItInTheStatusWord) {
  write_path(2, 0, 0x0001, 800);
  EXPECT_EQ(read(2, 0x6200, 8), "00010000032002ee029b029b00000000");
  EXPECT_EQ(read(2, 0x1003), "0002");
  set(2, 0x6002, 0x10);
  EXPECT_EQ(read(2, 0x1003), "0006");
  clock.sleep_for(seconds{2});
  EXPECT_EQ(read(2, 0x1003), "0032");
  EXPECT_EQ(raw("0203602a0002fbf0"), "02030400000320c81b");
  EXPECT_NEAR(yaw(), 1.0, 1e-9);
  EXPECT_NEAR(device->axis(AxisId::kYaw).true_position(clock.now()), 1.0, 1e-9);
  write_path(2, 0, 0x0001, -800);
  set(2, 0x6002, 0x10);
  clock.sleep_for(seconds{2});
  EXPECT_EQ(raw("0203602a0002fbf0"), "020304fffffce0899f");
  EXPECT_EQ(read(2, 0x602C, 2), "fffffce0");
}

TEST_F(Leadshine, RampsFromAndToStandstill) {
  write_path(2, 0, 0x0001, 16000);  // 20 deg: up 0.5 s, 12.5 deg at 25 deg/s... down 0.5 s
  set(2, 0x6002, 0x10);
  clock.sleep_for(milliseconds{250});
  EXPECT_NEAR(yaw(), 0.5 * 50 * 0.25 * 0.25, 0.01);
  clock.sleep_for(milliseconds{350});
  EXPECT_NEAR(std::stoi(read(2, 0x1044, 2), nullptr, 16), 750, 4);
  EXPECT_NEAR(std::stoi(read(2, 0x1046, 2), nullptr, 16), 750, 4);
  clock.sleep_for(milliseconds{690});
  EXPECT_TRUE(moving());
  clock.sleep_for(milliseconds{20});
  EXPECT_FALSE(moving());
  EXPECT_EQ(read(2, 0x1046, 2), "00000000");
}

TEST_F(Leadshine, KnowsSixteenPathsAbsoluteRelativeAndByVelocity) {
  write_path(2, 15, 0x0041, 800);
  for (const double place : {1.0, 2.0}) {
    set(2, 0x6002, 0x1F);
    clock.sleep_for(seconds{2});
    EXPECT_NEAR(yaw(), place, 1e-9);
  }
  write_path(2, 3, 0x0002, 0, -300);
  set(2, 0x6002, 0x13);
  clock.sleep_for(seconds{1});
  EXPECT_LT(std::stoi(read(2, 0x1047), nullptr, 16) - 0x10000, -290);
  set(2, 0x6002, 0x40);
  clock.sleep_for(seconds{1});
  EXPECT_FALSE(moving());
  EXPECT_LT(yaw(), -5);
  write_path(2, 3, 0x0002, 0, 300);
  set(2, 0x6002, 0x13);
  clock.sleep_for(seconds{60});
  EXPECT_NEAR(yaw(), 30, 1e-9);  // as far as the soft limit
}

TEST_F(Leadshine, OneFrameSetsAndFiresPathZero) {
  EXPECT_EQ(raw("0110620000081000010000032002ee029b029b00000010d7c1"), "011062000008de77");
  EXPECT_EQ(read(1, 0x1003), "0006");
  clock.sleep_for(seconds{2});
  EXPECT_EQ(read(1, 0x602A, 2), "00000320");
}

TEST_F(Leadshine, SeveralSlavesMoveAtOnce) {
  for (const int slave : {1, 2, 3, 4}) write_path(slave, 0, 0x0001, 800 * slave, 750, 0x10);
  for (const int slave : {1, 2, 3, 4}) EXPECT_EQ(read(slave, 0x1003), "0006");
  clock.sleep_for(seconds{3});
  for (const int slave : {1, 2, 3, 4})
    EXPECT_EQ(read(slave, 0x602A, 2), fmt::format("{:08x}", 800 * slave));
}

TEST_F(Leadshine, ASoftLimitKeepsAPathFromBeginning) {
  write_path(2, 0, 0x0001, 24001);
  set(2, 0x6002, 0x10);
  EXPECT_EQ(read(2, 0x1003), "0002");
  write_path(2, 0, 0x0041, -24001);
  set(2, 0x6002, 0x10);
  EXPECT_EQ(read(2, 0x1003), "0002");
  set(2, 0x6000, 0);
  set(2, 0x6002, 0x10);
  EXPECT_EQ(read(2, 0x1003), "0006");
}

TEST_F(Leadshine, DeceleratesPastTheOriginAndGoesBackToTheStopPosition) {
  set(2, 0x6002, 0x20);
  bool overshot = false;
  while (read(2, 0x1003) == "0006") {  // home done not before it is back
    clock.sleep_for(milliseconds{1});
    overshot |= device->axis(AxisId::kYaw).true_position(clock.now()) > 0.0095;
  }
  EXPECT_EQ(read(2, 0x1003), "0072");
  EXPECT_EQ(read(2, 0x602A, 2), "00000000");
  EXPECT_TRUE(overshot);
}

TEST_F(Leadshine, WithoutTheWayBackItStandsBeyondTheOriginItCountsFrom) {
  set(2, 0x600A, 0x0004);
  set(2, 0x6002, 0x20);
  clock.sleep_for(seconds{20});
  EXPECT_EQ(read(2, 0x1003), "0072");
  // From 30 rpm (1 deg/s) with 667 ms per 1000 rpm (49.975 deg/s^2): 0.010005 deg, 9 pulses.
  EXPECT_EQ(read(2, 0x602A, 2), "00000009");
  EXPECT_NEAR(device->axis(AxisId::kYaw).true_position(clock.now()), 0.01125, 1e-9);
  set(2, 0x600A, 0x0005);  // found from the other side
  set(2, 0x6002, 0x20);
  clock.sleep_for(seconds{20});
  EXPECT_EQ(read(2, 0x602A, 2), "fffffff7");
}

TEST_F(Leadshine, HomesByItselfWhenItIsSwitchedOnIfThatWasSaved) {
  for (const bool saved : {false, true}) {
    set(2, 0x6000, 0x0006);
    if (saved) set(2, 0x1801, 0x2211);
    device->add_fault({.kind = FaultKind::kReset, .verb = "get"});
    read(2, 0x0001);
    clock.sleep_for(milliseconds{1});
    EXPECT_EQ(moving(), saved);
    clock.sleep_for(seconds{20});
    EXPECT_EQ(read(2, 0x1003), saved ? "0072" : "0002");
  }
}

TEST_F(Leadshine, HomesAndCountsFromThere) {
  write_path(2, 0, 0x0001, 8000, 750, 0x10);
  clock.sleep_for(seconds{3});
  set(2, 0x6002, 0x20);
  EXPECT_EQ(read(2, 0x1003), "0006");
  clock.sleep_for(seconds{20});
  EXPECT_EQ(read(2, 0x1003), "0072");
  EXPECT_EQ(read(2, 0x602A, 2), "00000000");
  write_path(2, 0, 0x0001, 800, 750, 0x10);
  EXPECT_EQ(read(2, 0x1003), "0046");
  clock.sleep_for(seconds{2});
  EXPECT_EQ(read(2, 0x1003), "0072");
}

TEST_F(Leadshine, MovesAwayFromHomeIfItsModeSaysSo) {
  set(2, 0x600A, 0x0006);
  set(2, 0x600C, 80);   // position at the origin
  set(2, 0x600E, 880);  // and where to go then
  set(2, 0x6002, 0x20);
  clock.sleep_for(seconds{20});
  EXPECT_EQ(read(2, 0x602A, 2), "00000370");
  EXPECT_NEAR(device->axis(AxisId::kYaw).true_position(clock.now()), 1.0, 1e-9);
}

TEST_F(Leadshine, SetsZeroWhereItStands) {
  write_path(2, 0, 0x0001, 800, 750, 0x10);
  clock.sleep_for(seconds{2});
  set(2, 0x6002, 0x21);
  EXPECT_EQ(read(2, 0x602A, 2), "00000000");
}

TEST_F(Leadshine, StopsWithARampOrOnTheSpot) {
  for (const int ramp : {667, 0}) {
    write_path(2, 0, 0x0001, ramp == 0 ? -16000 : 16000, 750, 0x10);
    clock.sleep_for(milliseconds{600});
    set(2, 0x6017, ramp);
    set(2, 0x6002, 0x40);
    EXPECT_EQ(moving(), ramp != 0);
    clock.sleep_for(seconds{1});
    EXPECT_EQ(read(2, 0x1003), "0002");  // enabled, and nothing done
  }
}

TEST_F(Leadshine, AStopTakesItsMillisecondsFromWhateverSpeed) {
  for (const int rpm : {750, 75}) {
    write_path(2, 0, 0x0001, rpm == 750 ? 24000 : 0, rpm, 0x10);
    clock.sleep_for(seconds{1});
    set(2, 0x6017, 200);
    set(2, 0x6002, 0x40);
    clock.sleep_for(milliseconds{190});
    EXPECT_TRUE(moving());
    clock.sleep_for(milliseconds{20});
    EXPECT_FALSE(moving());
  }
}

TEST_F(Leadshine, KnowsWhatOtherPeoplesClientsAskFor) {
  for (const int address : {0x0005, 0x0009, 0x00A1, 0x0177, 0x0179, 0x017B, 0x0187, 0x0197, 0x01C1,
                            0x01D1, 0x01D3, 0x01E1, 0x01FF, 0x0201, 0x1010, 0x1012, 0x1014, 0x6013,
                            0x6015, 0x601A, 0x601D, 0x602E})
    EXPECT_EQ(read(2, address).size(), 4u) << address;
  EXPECT_EQ(read(2, 0x1003, 19).size(), 4u * 19);  // status and feedback as one block
  EXPECT_EQ(ask("02 06 00A1 0201"), "028603");     // 512 at most
  set(2, 0x601A, 0x0002);
}

TEST_F(Leadshine, SaysWhatItIsDoingWhereItIsTold) {
  write_path(2, 3, 0x0001, 8000);
  set(2, 0x6002, 0x13);
  EXPECT_EQ(read(2, 0x6002), "0103");
  clock.sleep_for(seconds{3});
  EXPECT_EQ(read(2, 0x6002), "0003");
  EXPECT_EQ(read(2, 0x1012, 2), "00001f40");
  EXPECT_EQ(read(2, 0x1014, 2), "00050000");  // five turns, 65536 counts each
}

TEST_F(Leadshine, ALimitSwitchIsAnInputAndAWarning) {
  set(2, 0x0147, 0x25);
  set(2, 0x0149, 0xA6);
  set(2, 0x1801, 0x2211);
  device->add_fault({.kind = FaultKind::kReset, .verb = "get"});
  read(2, 0x0001);  // what an input means counts after a power cycle
  clock.sleep_for(milliseconds{1});
  device->add_fault({.kind = FaultKind::kLimitHit, .verb = "move", .delay_s = 0.3});
  write_path(2, 5, 0x0001, 8000);
  set(2, 0x6002, 0x15);
  EXPECT_EQ(read(2, 0x601D), "0000");
  clock.sleep_for(milliseconds{400});
  EXPECT_EQ(read(2, 0x601D), "0205");
  EXPECT_EQ(read(2, 0x0179), "0002");
  set(2, 0x6002, 0x20);
  EXPECT_EQ(read(2, 0x601D), "0000");
  device->add_fault({.kind = FaultKind::kLimitHit, .verb = "home", .delay_s = 0.1});
  set(2, 0x6002, 0x20);
  clock.sleep_for(seconds{1});
  EXPECT_EQ(read(2, 0x601D), "0100");
}

TEST_F(Leadshine, JogsAsLongAsItIsTold) {
  for (int i = 0; i < 20; ++i) {
    set(2, 0x1801, 0x4001);
    clock.sleep_for(milliseconds{40});
    EXPECT_TRUE(moving());
  }
  clock.sleep_for(seconds{1});
  EXPECT_FALSE(moving());
  const double there = yaw();
  EXPECT_GT(there, 1.0);
  set(2, 0x1801, 0x4002);
  clock.sleep_for(seconds{1});
  EXPECT_LT(yaw(), there);
  EXPECT_FALSE(moving());
}

TEST_F(Leadshine, CountsWithThePulsesAndTheDirectionItIsToldButTheGearStaysTheSame) {
  set(2, 0x0001, 3200);
  write_path(2, 0, 0x0001, 1600, 750, 0x10);
  clock.sleep_for(seconds{2});
  EXPECT_NEAR(yaw(), 1.0, 1e-9);
  EXPECT_EQ(read(2, 0x602A, 2), "00000640");
  set(2, 0x0007, 1);
  write_path(2, 0, 0x0041, 1600, 750, 0x10);
  clock.sleep_for(seconds{2});
  EXPECT_NEAR(yaw(), 0.0, 1e-9);
}

// ---- enable, alarms, memory

TEST_F(Leadshine, DoesNotMoveWhileItIsNotEnabled) {
  set(2, 0x000F, 0);
  EXPECT_EQ(read(2, 0x1003), "0000");
  write_path(2, 0, 0x0001, 800, 750, 0x10);
  set(2, 0x6002, 0x20);
  EXPECT_FALSE(moving());
  set(2, 0x000F, 1);
  set(2, 0x6002, 0x10);
  EXPECT_TRUE(moving());
  set(2, 0x000F, 0);
  EXPECT_FALSE(moving());
}

TEST_F(Leadshine, AnAlarmHaltsItUntilItIsCleared) {
  device->add_fault({.kind = FaultKind::kAlarm, .verb = "move", .delay_s = 0.3});
  write_path(2, 0, 0x0001, 8000, 750, 0x10);
  clock.sleep_for(milliseconds{400});
  EXPECT_EQ(read(2, 0x1003), "0001");
  EXPECT_EQ(read(2, 0x2203), "0001");
  EXPECT_EQ(read(3, 0x1003), "0002");
  set(2, 0x6002, 0x10);
  EXPECT_FALSE(moving());
  set(2, 0x1801, 0x1122);
  EXPECT_EQ(read(2, 0x2203), "0001");
  set(2, 0x1801, 0x1111);
  EXPECT_EQ(read(2, 0x1003), "0002");
  set(2, 0x6002, 0x10);
  EXPECT_TRUE(moving());
}

TEST_F(Leadshine, TheEmergencyStopIsAnAlarmOfEveryDriveThatClearsOnlyAfterItsRelease) {
  device->add_fault({.kind = FaultKind::kEmergencyStop, .verb = "move", .delay_s = 0.3});
  write_path(2, 0, 0x0001, 8000, 750, 0x10);
  clock.sleep_for(milliseconds{400});
  for (const int slave : {1, 2, 3, 4}) EXPECT_EQ(read(slave, 0x1003), "0001");
  set(2, 0x1801, 0x1111);
  EXPECT_EQ(read(2, 0x2203), "1000");
  device->clear_trouble();
  EXPECT_EQ(read(2, 0x1003), "0002");
}

TEST_F(Leadshine, ALimitSwitchHaltsItWithoutAWord) {
  device->add_fault({.kind = FaultKind::kLimitHit, .verb = "move", .delay_s = 0.3});
  write_path(2, 0, 0x0001, 8000, 750, 0x10);
  clock.sleep_for(milliseconds{400});
  EXPECT_EQ(read(2, 0x1003), "0002");
  EXPECT_EQ(read(2, 0x2203), "0000");
}

class LeadshineWithLimitAlarm : public Leadshine {
 protected:
  LeadshineWithLimitAlarm() : Leadshine(LineConfig::Kind::kSimulated, {.limit_alarm = 0x0033}) {}
};

TEST_F(LeadshineWithLimitAlarm, ALimitSwitchMayRaiseAnAlarm) {
  device->add_fault({.kind = FaultKind::kLimitHit, .verb = "move", .delay_s = 0.3});
  write_path(2, 0, 0x0001, 8000, 750, 0x10);
  clock.sleep_for(milliseconds{400});
  EXPECT_EQ(read(2, 0x1003), "0001");
  EXPECT_EQ(read(2, 0x2203), "0033");
  set(2, 0x1801, 0x1111);
  EXPECT_EQ(read(2, 0x1003), "0002");
  set(2, 0x6002, 0x20);
  clock.sleep_for(seconds{20});
  EXPECT_EQ(read(2, 0x1003), "0072");
}

TEST_F(Leadshine, RemembersOverAPowerCycleOnlyWhatWasSaved) {
  set(2, 0x6017, 50);
  set(2, 0x01BF, 7);
  EXPECT_EQ(read(2, 0x1901), "1111");
  set(2, 0x1801, 0x2211);
  EXPECT_EQ(read(2, 0x1901), "5555");
  EXPECT_EQ(read(2, 0x1901), "1111");
  set(2, 0x6016, 10);
  EXPECT_EQ(read(2, 0x01BF), "0007");  // but it goes on answering to 2
  device->add_fault({.kind = FaultKind::kReset, .verb = "get"});
  read(2, 0x0001);
  clock.sleep_for(milliseconds{1});
  EXPECT_EQ(read(2, 0x1003), "");
  EXPECT_EQ(read(7, 0x6016, 2), "00320032");
}

TEST_F(Leadshine, GoesBackToFactorySettings) {
  set(2, 0x1801, 0x2233);
  EXPECT_EQ(read(2, 0x0001), "2710");
  EXPECT_EQ(read(2, 0x6000), "0000");
  EXPECT_EQ(read(2, 0x6006, 4), "0000000000000000");
}

TEST_F(Leadshine, SwitchesAnOutput) {
  std::string seen;
  device->on_output(
      [&](const std::string& name, bool on, Time) { seen += name + (on ? " on " : " off "); });
  set(2, 0x0157, 0x80);
  set(3, 0x0157, 0x80);  // another drive's
  set(2, 0x0157, 0);
  EXPECT_EQ(seen, "camera on camera off ");
}

// ---- gateway, faults, noise

class LeadshineGateway : public Leadshine {
 protected:
  LeadshineGateway() : Leadshine(LineConfig::Kind::kModbusTcp) {}
};

TEST_F(LeadshineGateway, TheSameWithTransactionsInsteadOfChecksums) {
  EXPECT_EQ(raw("1234 0000 0006 01 03 0001 0001"),
            "123400000005"
            "0103020640");
  EXPECT_EQ(raw("0001 0000 0017 01 10 6200 0008 10 0001 00000320 02EE 029B 029B 0000 0000"),
            "000100000006"
            "011062000008");
  EXPECT_EQ(raw("0002 0000 0006 01 06 6002 0010"),
            "000200000006"
            "010660020010");
  EXPECT_EQ(raw("0003 0000 0006 01 03 1003 0001"),
            "000300000005"
            "0103020006");
}

TEST_F(LeadshineGateway, AnswersForAnAbsentSlave) {
  EXPECT_EQ(raw("0009 0000 0006 11 03 1003 0001"),
            "000900000003"
            "11830b");
}

TEST_F(Leadshine, ErrorRepliesCarryTheExceptionOfTheFault) {
  device->add_fault({.kind = FaultKind::kErrorReply, .verb = "fc03", .text = "04"});
  device->add_fault({.kind = FaultKind::kErrorReply, .verb = "0x6002=0x10", .text = "nonsense"});
  EXPECT_EQ(ask("01 03 1003 0001"), "018304");
  EXPECT_EQ(ask("01 06 6002 0010"), "018604");
}

TEST_F(Leadshine, PutsAForeignFrameBeforeItsAnswer) {
  device->add_fault({.kind = FaultKind::kGarbage, .text = bytes_of("110302123474f0")});
  EXPECT_EQ(raw("010300010001d5ca"),
            "110302123474f0"
            "0103020640ba14");
}

TEST_F(Leadshine, ForgetsWhereItIsAfterAReset) {
  set(2, 0x6002, 0x20);
  clock.sleep_for(seconds{20});
  device->add_fault({.kind = FaultKind::kReset, .verb = "move", .delay_s = 0.5});
  write_path(2, 0, 0x0001, 8000, 750, 0x10);
  clock.sleep_for(seconds{1});
  EXPECT_EQ(read(2, 0x1003), "0002");
  EXPECT_EQ(read(2, 0x602A, 2), "00000000");
  EXPECT_GT(device->axis(AxisId::kYaw).true_position(clock.now()), 1.0);
}

TEST_F(Leadshine, SurvivesNoise) {
  Random draws = draws_of_this_test(1);
  for (int i = 0; i < 500; ++i) {
    std::string noise;
    for (int n = 0; n < 40; ++n) noise += static_cast<char>(draws() & 0xff);
    raw(hex_of(noise));
  }
  clock.sleep_for(seconds{1});
  heard();
  EXPECT_EQ(raw("010300010001d5ca"), "0103020640ba14");
}

TEST(LeadshineChannels, AreSlaveAddresses) {
  for (const char* channel : {"X", "0", "32", ""})
    EXPECT_THROW(simulate_leadshine({{rotary_axis(AxisId::kYaw, channel)}, {}, 1}), ConfigError)
        << channel;
}

}  // namespace
}  // namespace turntable::sim
