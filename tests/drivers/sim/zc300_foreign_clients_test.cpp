// What clients that nobody here wrote say to a ZC300, byte for byte, to the simulated one: the vendor's own
// library (recorded), and the requests that public programs make, which their authors run on real devices.
// Refused is only what they provoke.
#include <gtest/gtest.h>

#include <array>
#include <span>
#include <string>

#include "drivers/sim/modbus_framer.h"
#include "drivers/sim/zc300.h"
#include "tests/support/axis_configs.h"
#include "tests/support/draws.h"
#include "tests/support/hex.h"

namespace turntable::sim {
namespace {

using std::chrono::milliseconds;

class Zc300ForeignClients : public ::testing::Test {
 protected:
  Zc300ForeignClients() : Zc300ForeignClients(line_pair("line")) {}
  explicit Zc300ForeignClients(std::pair<Line, Line> ends)
      : line(std::move(ends.first)),
        device(simulate_zc300({{linear_axis("X")}, {}, draws_of_this_test()(), {}})) {
    device->plug(std::move(ends.second));
    clock.attach(*device);
  }
  ~Zc300ForeignClients() override { clock.detach(*device); }

  /// What comes back within 0.25 s, as these clients wait; asked a second time after silence.
  std::string ask(const std::string& frame) {
    for (int attempt = 0; attempt < 2; ++attempt) {
      clock.sleep_for(milliseconds{4});
      line.write(bytes_of(frame), clock, clock.now());
      std::array<char, 256> buffer;
      for (int ms = 0; ms < 250; ++ms) {
        clock.sleep_for(milliseconds{1});
        if (const std::size_t n = line.read_available(buffer, clock.now()); n > 0)
          return hex_of({buffer.data(), n});
      }
      ++missed;
    }
    return {};
  }
  static bool refused(const std::string& answer) {
    return answer.size() < 4 || answer[2] == '8' || answer[2] == '9';
  }

  ManualClock clock;
  Line line;
  std::unique_ptr<ControllerSimulator> device;
  int missed = 0;
};

struct Said {
  const char* what;
  const char* frame;
};
struct LibraryCall {
  const char* frame;
  const char* answer;  ///< where it is known to the byte
};

const std::string kDoesItMove = "0104753b00015a0b";

/// The requests of the vendor's library in the order in which it made them: search, set-up, relative and
/// absolute moves, endless ones that it stops, a move of an axis that moves, homing, zero, outputs, beeper.
/// It asks whether an axis moves until it does not: told once here.
const LibraryCall kLibrary[] = {
    {"010475300007abcb", "01040e5a433330302d33410000000000006491"},
    {"010475300007abcb", "01040e5a433330302d33410000000000006491"},
    {"010475300007abcb", "01040e5a433330302d33410000000000006491"},
    {"010475300007abcb", "01040e5a433330302d33410000000000006491"},
    {"010475370002da09", ""},
    {"0104753e00014a0a", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", "01030400000000fa33"},
    {"0103757700012e1c", "01030200017984"},
    {"0103757a0002ffde", "01030400000640f863"},
    {"0103758300022fef", "01030440800000ee1b"},
    {"010475300007abcb", "01040e5a433330302d33410000000000006491"},
    {"01107571000102000149b6", ""},
    {"010375710001ce1d", "01030200017984"},
    {"0110758000010200009d57", ""},
    {"01107577000102000149d0", ""},
    {"0110758300020440800000f560", ""},
    {"0110757a000204000006402c36", ""},
    {"011075890002043f8000006ccb", ""},
    {"0103758900020fed", "0103043f800000f7cf"},
    {"011075980001020003de8e", ""},
    {"0103759800011fe9", "0103020003f845"},
    {"011075aa0002043f8000002ec6", ""},
    {"011075b000020441a00000b657", ""},
    {"011075b600020442480000b60d", ""},
    {"0110759200020440a00000346a", ""},
    {"010375aa0002fe27", "0103043f800000f7cf"},
    {"010375b00002dfe0", "01030441a00000ee2d"},
    {"010375b600023fe1", "010304424800006e5d"},
    {"0103759200027fea", "01030440a00000efd1"},
    {"0103756a0002fe1b", "01030400000000fa33"},
    {"011075a100020440a00000776b", ""},
    {"01107561000306006500310050120d", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", "01030440a00000efd1"},
    {"011075a1000204402000007683", ""},
    {"0110756100030600650031004e9205", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", "01030440200000ee39"},
    {"011075a10002043f0000006e9d", ""},
    {"0110756100030600640031004eafc5", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", "010304bf000000dfe7"},
    {"011075a1000204000000006289", ""},
    {"0110756100030600640031004eafc5", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", "01030400000000fa33"},
    {"011075a100020441200000777f", ""},
    {"011075610003060064003100502fcd", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", "01030441200000efc5"},
    {"011075a10002043f8000006f75", ""},
    {"01107561000306006600310050560d", ""},
    {"0104753e00014a0a", ""},
    {"01107561000204006700311ed2", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", ""},
    {"011075a10002043f8000006f75", ""},
    {"0110756100030600660031004ed605", ""},
    {"011075a100020440400000769d", ""},
    {"01107561000306006500310050120d", ""},
    {"01107561000204006800312ed1", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", ""},
    {"01107561000204006900317f11", ""},
    {"0104753b00015a0b", ""},
    {"0103756a0002fe1b", ""},
    {"0104753e00014a0a", ""},
    {"0110756a000204000000002f6a", ""},
    {"0103756a0002fe1b", "01030400000000fa33"},
    {"0110756a000204412000003a9c", ""},
    {"0103756a0002fe1b", "01030441200000efc5"},
    {"01107570000102000549a4", ""},
    {"0103757000019fdd", "01030200057847"},
    {"0104753a00010bcb", ""},
    {"0110757500010200014832", ""},
    {"0103757500018fdc", "01030200017984"},
    {"011075a1000204000000006289", ""},
    {"0110756100030600650031004e9205", ""},
    {"0104753b00015a0b", ""},
};

TEST_F(Zc300ForeignClients, TheVendorsLibraryFindsNothingStrange) {
  int refusals = 0;
  const Time began = clock.now();
  for (const auto& [frame, known] : kLibrary) {
    std::string answer = ask(frame);
    if (frame == kDoesItMove) {
      for (int polls = 0; answer.substr(6, 4) != "0000"; ++polls) {
        ASSERT_LT(polls, 1000);
        clock.sleep_for(milliseconds{50});
        answer = ask(frame);
        ASSERT_EQ(answer.size(), 14u) << frame;
      }
      continue;
    }
    ASSERT_NE(answer, "") << frame;
    if (refused(answer)) {
      ++refusals;
      EXPECT_EQ(std::string(frame), "01107561000306006500310050120d");  // of an axis that moves
      EXPECT_EQ(answer, "019006cc02");
    }
    if (*known != 0) {
      EXPECT_EQ(answer, known) << frame;
    }
    if (std::string(frame).substr(14, 4) == "0066") clock.sleep_for(milliseconds{100});  // a jog
  }
  EXPECT_EQ(refusals, 1);
  EXPECT_LE(missed, 2);
  EXPECT_LT(turntable::seconds(clock.now() - began), 60.0);
  EXPECT_TRUE(device->axis(AxisId::kStage).homed(clock.now()));
}

// gavinlouuu-kpt/mib-studio-qt, which runs a ZC300-1A.
const Said kMibStudio[] = {
    {"the model", "010475300007abcb"},
    {"serial number and firmware", "0104753700031bc9"},
    {"unit", "0103757700012e1c"},
    {"stage type", "0103758000019fee"},
    {"pulses per revolution", "0103757a0002ffde"},
    {"lead", "0103758300022fef"},
    {"status", "0104753b000a1bcc"},
    {"stage type linear", "0110758000010200009d57"},
    {"lead 4", "0110758300020440800000f560"},
    {"1600 pulses", "0110757a000204000006402c36"},
    {"unit mm", "01107577000102000149d0"},
    {"speed 15", "011075b000020441700000b7ae"},
    {"acceleration 30", "011075b600020441f00000366c"},
    {"here is 0", "0110756a000204000000002f6a"},
    {"distance 5.00001", "011075a100020440a00015b6a4"},
    {"absolute +", "011075610003060064003100502fcd"},
    {"status", "0104753b000a1bcc"},
    {"stop", "01107561000204006800312ed1"},
    {"distance 0.10001", "011075a10002043dccd20bb27d"},
    {"relative -", "0110756100030600650031004e9205"},
};

// Lewbert/transfer-stage-control: the stage under a joystick.
const Said kTransferStage[] = {
    {"does it move", "0104753b00015a0b"},       {"enable X", "010675710001021d"},
    {"enable Y", "010675720001f21d"},           {"enable Z", "010675730001a3dd"},
    {"speed 10", "011075b000020441200000b7bf"}, {"endless +", "01107561000306006600310050560d"},
    {"does it move", "0104753b00015a0b"},       {"stop X", "01107561000204006800312ed1"},
    {"stop all", "0110756100020400680030ef11"}, {"switches", "0104753e00014a0a"},
    {"position", "0104753f00025bcb"},
};

// Lewbert/talos-2d-transfer.
const Said kTalos[] = {
    {"which move", "0104753b0003dbca"},
    {"the model", "010475300007abcb"},
    {"units", "010475450003bbd2"},
    {"enable X", "010675710001021d"},
    {"acceleration", "010375b600023fe1"},
    {"speed 10", "011075b000020441200000b7bf"},
    {"distance 2", "011075a1000204400000007749"},
    {"read back", "010375a100028fe5"},
    {"relative +", "01107561000306006500310050120d"},
};

TEST_F(Zc300ForeignClients, ProgramsOfLaboratoriesAreUnderstood) {
  const auto talks = [&](std::span<const Said> said) {
    for (const auto& [what, frame] : said)
      EXPECT_FALSE(refused(ask(frame))) << what << " " << frame;
    clock.sleep_for(std::chrono::seconds{20});
  };
  talks(kMibStudio);
  talks(kTransferStage);
  talks(kTalos);
}

TEST_F(Zc300ForeignClients, WhatTheyHaveWrongIsRefused) {
  // Acceleration 10^7 pulses/s^2, which is beyond the range; homing in three registers.
  EXPECT_EQ(ask("01067577000023dc"), "01067577000023dc");
  EXPECT_EQ(ask("011075b60002044b189680db80"), "0190058c03");
  EXPECT_EQ(ask("0110756100030600690031004e8204"), "0190030c01");
}

}  // namespace
}  // namespace turntable::sim
