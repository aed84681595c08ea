// What programs of other people say to these controllers, byte for byte, and what they need to hear:
// transcripts of the wire, typed from their sources as facts. Each is replayed against the simulator,
// which nobody of them has ever seen. What the simulator does differently is in the transcript too,
// and says so.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <regex>
#include <string>
#include <vector>

#include "drivers/sim/catalog.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/hex.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;

/// One thing that a client says, and what it takes for a good answer.
struct Exchange {
  std::string send;   ///< text without its CR, or a frame in hex without its checksum
  std::string want;   ///< regular expression of all that is heard; CR as '|'
  int wait_ms = 100;  ///< for how long it listens
};

struct Transcript {
  const char* name;
  const char* source;
  std::vector<Exchange> exchanges;
};
void PrintTo(const Transcript& transcript, std::ostream* out) { *out << transcript.name; }
const auto kNamed = [](const auto& transcript) { return std::string(transcript.param.name); };

/// A simulated controller and the near end of its line.
struct Client {
  Client(const std::string& model, std::vector<AxisConfig> axes)
      : Client(model, axes, line_pair("line")) {}
  Client(const std::string& model, const std::vector<AxisConfig>& axes, std::pair<Line, Line> ends)
      : line(std::move(ends.first)) {
    SimulatorSetup setup{axes, {}, draws_of_this_test()()};
    setup.controller.model = model;
    device = simulate_controller(model, setup);
    device->plug(std::move(ends.second));
    clock.attach(*device);
  }
  ~Client() { clock.detach(*device); }

  std::string exchange(const std::string& bytes, int wait_ms) {
    line.write(bytes, clock, clock.now());
    clock.sleep_for(milliseconds{wait_ms});
    std::array<char, 4096> buffer;
    return {buffer.data(), line.read_available(buffer, clock.now())};
  }

  ManualClock clock;
  Line line;
  std::unique_ptr<ControllerSimulator> device;
};

// ---- text

class TextClient : public ::testing::TestWithParam<Transcript> {
 protected:
  void replay(const std::string& model, const std::vector<AxisConfig>& axes) {
    Client client(model, axes);
    for (const Exchange& e : GetParam().exchanges) {
      std::string heard = client.exchange(e.send + "\r", e.wait_ms);
      for (char& c : heard) c = c == '\r' ? '|' : c;
      EXPECT_TRUE(std::regex_match(heard, std::regex(e.want)))
          << GetParam().source << ": \"" << e.send << "\" heard \"" << heard << "\", wants "
          << e.want;
    }
  }
};

constexpr const char* kOk = "OK\\|";
constexpr const char* kReady = "READY\\|";

class Sc300Client : public TextClient {};

INSTANTIATE_TEST_SUITE_P(
    , Sc300Client,
    ::testing::Values(
        Transcript{"pySC300",
                   "geyuuu/pySC300: splits at the comma and reads a whole number",
                   {{"VE", "SC300_V1\\.0\\|"},
                    {"TY", "SC300[-0-9A-Z]*\\|"},
                    {"ID", "ID[0-9]+\\|"},
                    {"VX,8000", kOk},
                    {"AX,30000", kOk},
                    {"FX,0", kOk},
                    {"FX,800", kOk},
                    {"XV", "..,8000\\|"},
                    {"XF", "..,800\\|"},
                    {"XA", "..,30000\\|"},
                    {"HX", "\\?X,0\\|", 20000},
                    {"+X,800", "\\?X,800\\|", 2000},
                    {"-X,1200", "\\?X,-400\\|", 2000},
                    {"?X", "\\?X,-400\\|"},
                    {"+X,40000", "", 1000},
                    {"SPX", "OK\\|\\?X,[0-9]+\\|", 1000}}},
        Transcript{"RF_Lab",
                   "DF4IAH/RF-Lab: a turntable of 288000 ticks; looks for SC300 in the version",
                   {{"", kOk, 25},
                    {"VE", ".*SC300.*\\|", 25},
                    {"VX,20000", kOk, 25},
                    {"AX,30000", kOk, 25},
                    {"FX,2500", kOk, 25},
                    {"", kOk, 25},
                    {"?X", "\\?X,0\\|", 25},
                    {"+X,8000", "", 25},  // it sleeps until the table should be there
                    {"", "(\\?X,8000\\|)?OK\\|(\\?X,8000\\|)?", 2000},
                    {"?X", "\\?X,8000\\|", 25},
                    {"-X,8000", "\\?X,0\\|", 2000}}},
        Transcript{"smartlink",
                   "smartlink's SC300: the second character is the axis, the number begins at the "
                   "fourth",
                   {{"VE", "SC300.*\\|"},
                    {"HY", "\\?Y,0\\|", 20000},
                    {"+Y,500", "\\?Y,500\\|", 5000},
                    {"-Y,750", "\\?Y,-250\\|", 5000},
                    {"HZ", "\\?Z,0\\|", 20000}}}),
    kNamed);

TEST_P(Sc300Client, IsUnderstoodByTheSimulator) {
  replay("zolix-sc300",
         {linear_axis("Z"), rotary_axis(AxisId::kYaw, "X"), rotary_axis(AxisId::kRoll, "Y")});
}

class Mc600Client : public TextClient {};

INSTANTIATE_TEST_SUITE_P(
    , Mc600Client,
    ::testing::Values(
        Transcript{"KYKY",
                   "KYKY CommMC600.cpp: cuts at the last commas, compares the verb in upper case",
                   {{"Hello", kOk},
                    {"", ""},
                    {"SetUnit X,s", kOk},
                    {"SetUnit T,s", kOk},
                    {"SetStageStyle X,T", kOk},
                    {"SetStageStyle T,R", kOk},
                    {"SetStageStepsRev X,1600", kOk},
                    {"SetStagePitch X,0.5", kOk},
                    {"SetStagePitch T,30", kOk},
                    {"SetStageDriveRat X,180", kOk},
                    {"SetStageDriveRat T,6.2143", kOk},
                    {"SetDriveRat T,180.0", kOk},
                    {"SetStageDistance X,256000", kOk},
                    {"SetOrigin X,P", kOk},
                    {"Setsechhomemode X,2", kOk},
                    {"SetUserLimitAble X,E", kOk},
                    {"SetUserLimitAble T,D", kOk},
                    {"SetUserPositiveLimit X,124800", kOk},
                    {"SetUserNegativeLimit X,-131200", kOk},
                    {"SetSpeed X,960", kOk},
                    {"SetInitSpeed X,800", kOk},
                    {"SetAccSpeed X,12000", kOk},
                    {"SetHomeSpeed X,800", kOk},
                    {"SetSpeed X,960.0", kOk},
                    {"SetStageWorkState X,O", kOk},
                    {"SetStageWorkState? X", "SETSTAGEWORKSTATE\\? X,O,OK\\|"},
                    {"SetStagePitch? X", "SETSTAGEPITCH\\? X,0\\.50*,OK\\|"},
                    {"SetStageStepsRev? X", "SETSTAGESTEPSREV\\? X,1600[.0]*,OK\\|"},
                    {"SetStageDriveRat? X", "SETSTAGEDRIVERAT\\? X,180[.0]*,OK\\|"},
                    {"SetDriveRat? X", "SETDRIVERAT\\? X,180[.0]*,OK\\|"},
                    {"SetStageDistance? X", "SETSTAGEDISTANCE\\? X,256000[.0]*,OK\\|"},
                    {"SetSpeed? X", "SETSPEED\\? X,960[.0]*,OK\\|"},
                    {"SetHomeSpeed? X", "SETHOMESPEED\\? X,800[.0]*,OK\\|"},
                    {"SetUserNegativeLimit? X", "SETUSERNEGATIVELIMIT\\? X,-131200[.0]*,OK\\|"},
                    {"SetSechHomeMode? X", "SETSECHHOMEMODE\\? X,2[.0]*,OK\\|"},
                    {"SetUserOrigin? X", "SETUSERORIGIN\\? X,0[.0]*,OK\\|"},
                    {"SetOffset? X", "SETOFFSET\\? X,0[.0]*,OK\\|"},
                    {"GonAxisHome Y,N,N,N", "READY\\|X 0[.0]*,OK\\|", 60000},
                    {"GoPosition X,O,R,P,400", "READY\\|X 400[.0]*,OK\\|", 2000},
                    {"GoPosition X,O,A,N,100", "READY\\|X -100[.0]*,OK\\|", 2000},
                    {"GoPosition X,O,R,P,50.0", "READY\\|X -50[.0]*,OK\\|", 2000},
                    {"Position? X", "POSITION\\? X,-50[.0]*,OK\\|"},
                    {"GoPosition X,O,A,P,90000", kReady, 500},
                    {"Stop X", "OK\\|X [0-9.]+,OK\\|", 1000},
                    {"GoOrigion X", "READY\\|X 0[.0]*,OK\\|", 5000},
                    {"GoInterpolationline2 X,100.0,Y,20.0", "READY\\|.*X 100[.0]*,OK\\|.*", 5000}}},
        Transcript{"fiber_fp",
                   "aooppp/fiber-fp-ultrasound-imaging: waits for OK or E0 anywhere in what comes",
                   {{"Hello", kOk},
                    {"SetStageStyle X,T", kOk},
                    {"SetStagePitch X,2.0", kOk},
                    {"SetStageStepsRev X,1600", kOk},
                    {"SetUnit X,m", kOk},
                    {"SetSpeed X,5.0", kOk},
                    {"SetInitSpeed X,2.0", kOk},
                    {"SetAccSpeed X,10.0", kOk},
                    {"SetHomeSpeed X,2.0", kOk},
                    {"SetUnit? X", "SETUNIT\\? X,m,OK\\|"},
                    {"GoHome X", kReady, 20},
                    {"Position? X", "POSITION\\? X,-?[0-9.]+,OK\\|", 20},
                    {"", "X 0[.0]*,OK\\|", 60000},
                    {"Position? X", "POSITION\\? X,0[.0]*,OK\\|"},
                    {"GoPosition X,O,R,P,5.0", "READY\\|X 5[.0]*,OK\\|", 5000},
                    {"GoOrigion X", "READY\\|X 0[.0]*,OK\\|", 5000},
                    {"GoPosition X,O,R,N,5.0", "E02\\|"},  // beyond the soft limit of this rig
                    {"GoPosition X,O,R,N,0.5", "READY\\|X -0\\.50*,OK\\|", 5000},
                    // Differs: this client makes "P,-5.0" of a negative place, KYKY "N,5". What a
                    // device makes of both is not known; the simulator refuses the first.
                    {"GoPosition X,O,A,P,-5.0", "E01\\|"},
                    {"STOP X", kOk},
                    {"SetUserOrigin X,0", kOk},
                    {"Position? X", "POSITION\\? X,0[.0]*,OK\\|"}}},
        Transcript{"xray",
                   "a rotary stage of 180:1 on the MC600 family: reads to the CR, wants OK at the "
                   "end of the second line",
                   {{"hello", kOk},
                    {"SetSpeed T,10", kOk},
                    {"SetInitSpeed T,10", kOk},
                    {"SetStageDriveRat T,180", kOk},
                    {"SetSpeed? T", "SETSPEED\\? T,10[.0]*,OK\\|"},
                    {"SetInitSpeed? T", "SETINITSPEED\\? T,10[.0]*,OK\\|"},
                    {"GoPosition T,O,R,P,18", "READY\\|.*OK\\|", 5000},
                    {"goposition t,o,a,p,12.000000", "READY\\|.*OK\\|", 5000}}}),
    kNamed);

TEST_P(Mc600Client, IsUnderstoodByTheSimulator) {
  replay("zolix-mc600", {linear_axis("X"), linear_axis("Y"), rotary_axis(AxisId::kPitch, "T")});
}

// ---- Modbus RTU

class LeadshineClient : public ::testing::TestWithParam<Transcript> {};

/// Writes of one register, confirmed by themselves.
Exchange write(int address, int value, int wait_ms = 30) {
  const std::string frame = fmt::format("01 06 {:04x} {:04x}", address, value);
  return {frame, hex_of(bytes_of(frame)), wait_ms};
}
/// The same by function 16.
Exchange write_one(int address, int value, int wait_ms = 30) {
  return {fmt::format("01 10 {:04x} 0001 02 {:04x}", address, value),
          fmt::format("0110{:04x}0001", address), wait_ms};
}
Exchange read(int address, const std::string& want, int words = 1) {
  return {fmt::format("01 03 {:04x} {:04x}", address, words),
          fmt::format("0103{:02x}{}", 2 * words, want), 30};
}

INSTANTIATE_TEST_SUITE_P(
    , LeadshineClient,
    ::testing::Values(
        Transcript{
            "DM556RS",
            "a ClearCore program for DM556RS drives: 0x0006 is moving, 0x0032 is there",
            {write(0x0001, 1600), write(0x0191, 5), write(0x6200, 0x0041), write(0x6203, 200),
             write(0x6204, 100), write(0x6205, 100), write(0x000F, 1), write(0x6201, 0),
             write(0x6202, 3200), write(0x6002, 0x10), read(0x1003, "0006"), write(0x000F, 1, 2000),
             read(0x1003, "0032"), read(0x2203, "0000"), write(0x6002, 0x40), write(0x000F, 0)}},
        Transcript{
            "EM2RS_556",
            "jaredlandau/EM2RS-556: reads back each register it has written",
            {write(0x01E1, 120), read(0x01E1, "0078"), write(0x1801, 0x4001), read(0x1801, "0000"),
             write(0x1801, 0x4001), write(0x1801, 0x4002), write(0x01E1, 60), read(0x01E1, "003c"),
             write(0x6002, 0x40), read(0x6002, "....")}},
        Transcript{"em2rs_rs",
                   "FrenchPOC/em2rs-rs: bits 4, 5, 6 of the status are command, path, homing",
                   {write(0x0001, 1600),
                    write(0x0007, 0),
                    write(0x0191, 42),
                    write(0x0009, 1499),
                    write(0x0197, 15),
                    write(0x0149, 0xA7),
                    write(0x600A, 0x0004 | 0x0002),
                    write(0x601A, 0x0002),
                    write(0x600B, 0),
                    write(0x600C, 0),
                    write(0x600D, 0),
                    write(0x600E, 0),
                    write(0x600F, 150),
                    write(0x6010, 30),
                    write(0x6011, 200),
                    write(0x6012, 200),
                    read(0x6000, "...."),
                    write(0x6000, 0x0002),
                    write(0x6002, 0x20, 20000),
                    read(0x1003, "0072"),
                    write(0x6208, 0x0001),
                    write(0x6209, 0),
                    write(0x620A, 1600),
                    write(0x620B, 300),
                    write(0x620C, 100),
                    write(0x620D, 100),
                    write(0x620E, 0),
                    write(0x6002, 0x11),
                    read(0x1003, "00.6"),
                    write(0x0191, 42, 3000),
                    read(0x1003, "0072"),
                    read(0x0179, "...."),
                    write(0x6002, 0x21),
                    write(0x1801, 0x2211),
                    read(0x1901, "5555")}},
        Transcript{
            "iCL_RS",
            "puphup/baanrig-trivision-system, iCL-RS: function 16 for everything, status and "
            "feedback as one block of 19",
            {write_one(0x0145, 0x0000),
             write_one(0x00A1, 500),
             write_one(0x1801, 0x2211),
             read(0x0145, "0000"),
             read(0x00A1, "01f4"),
             write_one(0x0149, 0x00A7),
             write_one(0x600A, 0x0005),
             write_one(0x600F, 10),
             write_one(0x6010, 2),
             write_one(0x6011, 200),
             write_one(0x6012, 200),
             write_one(0x1801, 0x2211),
             write_one(0x000F, 1),
             write_one(0x6002, 0x20, 60000),
             read(0x1003, "00[57]2"),
             Exchange{"01 10 6200 0006 0c 0001 0000 0640 00c8 0064 0064", "011062000006", 30},
             write_one(0x6207, 0x0010),
             read(0x1003, "00.6.{72}", 19),
             read(0x1014, "........", 2),
             read(0x1046, "........", 2),
             write_one(0x000F, 1, 5000),
             read(0x1003, "0072"),
             Exchange{"01 10 6200 0006 0c 0041 ffff f9c0 00c8 0064 0064", "011062000006", 30},
             write_one(0x6207, 0x0010),
             write_one(0x6002, 0x0040),
             read(0x2203, "0000"),
             write_one(0x1801, 0x1111),
             write_one(0x6002, 0x0021),
             write_one(0x000F, 0)}},
        Transcript{
            "EM2RS_limits",
            "a Rust driver of EM2RS drives: bit i of the low byte of 0x0179 is input i + 1",
            {write(0x6203, 100), read(0x6203, "0064"), write(0x6204, 50), read(0x6204, "0032"),
             write(0x6205, 50), read(0x6205, "0032"), write(0x6200, 0x0041), write(0x6201, 0),
             write(0x6202, 800), write(0x6002, 0x10), read(0x1003, "0006"), read(0x0179, "00.."),
             write(0x6002, 0x40)}},
        Transcript{
            "manuals",
            "the CS2RS and iEM-RS manuals' examples, without their spoilt checksums",
            {{"01 02 0001 0001", "018201"},
             read(0x0001, "...."),
             read(0x0144, ".{56}", 14),  // several parameters begin at a high word
             {"01 10 6200 0008 10 0001 0000 2710 00c8 2710 2710 0000 0010", "011062000008", 30}}}),
    kNamed);

TEST_P(LeadshineClient, IsUnderstoodByTheSimulator) {
  Client client("leadshine-pr", {rotary_axis(AxisId::kYaw, "1"), rotary_axis(AxisId::kRoll, "2")});
  for (const Exchange& e : GetParam().exchanges) {
    const std::string frame = bytes_of(e.send);
    const std::string heard = client.exchange(frame + modbus_checksum(frame), e.wait_ms);
    ASSERT_GE(heard.size(), 4u) << GetParam().source << ": " << e.send;
    const std::string body = heard.substr(0, heard.size() - 2);
    EXPECT_EQ(heard.substr(heard.size() - 2), modbus_checksum(body));
    EXPECT_TRUE(std::regex_match(hex_of(body), std::regex(e.want)))
        << GetParam().source << ": " << e.send << " heard " << hex_of(body) << ", wants " << e.want;
  }
}

TEST(LeadshineManual, ItsFramesAreThoseOfTheSimulatorToTheLastByte) {
  Client client("leadshine-pr", {rotary_axis(AxisId::kYaw, "7")});
  EXPECT_EQ(
      hex_of(client.exchange(
          bytes_of("07 10 62 00 00 08 10 00 01 00 00 27 10 00 00 27 10 27 10 00 00 00 10 8D 50"),
          30)),
      "071062000008de11");
}

}  // namespace
}  // namespace turntable::sim
