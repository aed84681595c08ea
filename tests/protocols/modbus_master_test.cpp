// The master's frames against bytes worked out by hand, and what it makes of a noisy bus.
#include "protocols/modbus_master.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <deque>

namespace turntable {
namespace {

using ::testing::ElementsAre;

/// Answers each request with the next of the prepared answers.
class Peer final : public Actor {
 public:
  explicit Peer(Line line) : line_(std::move(line)) {}
  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override {
    return late_.empty() ? std::nullopt : std::optional(due_);
  }
  void act(Time now) override {
    std::array<char, 512> buffer;
    if (const std::size_t n = line_.read_available(buffer, now); n > 0) {
      heard.emplace_back(buffer.data(), n);
      times.push_back(now);
      if (!answers.empty()) {
        line_.write_available(answers.front(), now);
        answers.pop_front();
      }
      if (!then.empty()) {
        late_ = std::exchange(then, {});
        due_ = now + after;
      }
    }
    if (!late_.empty() && now >= due_) line_.write_available(std::exchange(late_, {}), now);
  }
  std::deque<std::string> answers;
  std::string then;  ///< comes `after` the next answer
  Time after = std::chrono::milliseconds{30};
  std::vector<std::string> heard;
  std::vector<Time> times;  ///< of what was heard

 private:
  Line line_;
  std::string late_;
  Time due_{0};
};

std::string bytes(std::string_view hex) {
  std::string out;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    out += static_cast<char>(std::stoi(std::string(hex.substr(i, 2)), nullptr, 16));
  return out;
}

class Modbus : public ::testing::Test {
 protected:
  explicit Modbus(ModbusMaster::Framing framing = ModbusMaster::Framing::kRtu)
      : Modbus(framing, line_pair("bus")) {}
  Modbus(ModbusMaster::Framing framing, std::pair<Line, Line> ends)
      : peer(std::move(ends.second)),
        master(std::move(ends.first), clock, framing, std::chrono::seconds{1},
               [this] { return give_way; }) {
    clock.attach(peer);
  }
  ~Modbus() override { clock.detach(peer); }
  std::vector<std::uint16_t> read() { return master.read_input(1, 0x753F, 2); }

  ManualClock clock;
  Peer peer;
  bool give_way = false;
  ModbusMaster master;
};

// The bytes below were worked out by hand from the Modbus standard, outside this project.
const std::string kAnswer = bytes("0104044145851FDD35");

TEST_F(Modbus, ReadsAsTheStandardSays) {
  peer.answers = {kAnswer};
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
  EXPECT_THAT(peer.heard, ElementsAre(bytes("0104753F00025BCB")));
}

TEST_F(Modbus, WritesAsTheStandardSays) {
  peer.answers = {bytes("0106756C005593E4"), bytes("011075610003CBDA")};
  master.write_register(1, 0x756C, 0x55);
  master.write_registers(1, 0x7561, std::array<std::uint16_t, 3>{0x64, 0x31, 0x50});
  EXPECT_THAT(peer.heard, ElementsAre(bytes("0106756C005593E4"), bytes("01107561000306006400310050"
                                                                       "2FCD")));
}

TEST_F(Modbus, RefusesTheConfirmationOfAnotherWrite) {
  peer.answers = {bytes("011075610003CBDA")};
  EXPECT_THROW(master.write_registers(1, 0x7562, std::array<std::uint16_t, 3>{0x64, 0x31, 0x50}),
               ProtocolError);
}

TEST_F(Modbus, TurnsAnExceptionIntoItsCode) {
  peer.answers = {bytes("018302C0F1")};
  try {
    master.read_holding(1, 0x7562, 1);
    FAIL() << "accepted";
  } catch (const ModbusException& e) {
    EXPECT_EQ(e.code(), 2);
  }
}

TEST_F(Modbus, FindsTheAnswerBehindNoiseAndFramesOfOthers) {
  peer.answers = {bytes("FF01040400") + bytes("0204044145851FEE35") + bytes("02030000019C44") +
                  kAnswer};
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
}

TEST_F(Modbus, PutsASplitAnswerTogether) {
  peer.answers = {kAnswer.substr(0, 4)};
  peer.then = kAnswer.substr(4);
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
  EXPECT_GE(seconds(clock.now()), 0.03);
}

TEST_F(Modbus, TellsSilenceFromNoise) {
  EXPECT_THROW(read(), TimeoutError);
  EXPECT_NEAR(seconds(clock.now()), 1.0, 0.002);  // and the silence before a frame
  std::string spoilt = kAnswer;
  spoilt[4] ^= 1;
  peer.answers = {spoilt};
  EXPECT_THROW(read(), ProtocolError);
  peer.answers = {kAnswer.substr(0, 5)};
  EXPECT_THROW(read(), ProtocolError);
  peer.answers = {bytes("0204044145851FEE35")};  // only another slave spoke
  EXPECT_THROW(read(), ProtocolError);
  EXPECT_EQ(peer.heard.size(), 4u);  // and nothing was sent twice
}

TEST_F(Modbus, DoesNotTakeALateAnswerForTheNext) {
  peer.then = bytes("01040400000000FB84");
  peer.after = std::chrono::milliseconds{1030};
  EXPECT_THROW(read(), TimeoutError);
  peer.answers = {kAnswer};
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
}

TEST_F(Modbus, GivesWayToAStopOnceNoAnswerIsOnItsWayAnyMore) {
  give_way = true;
  EXPECT_THROW(read(), GaveWay);
  EXPECT_NEAR(seconds(clock.now()), 0.1, 0.0201);  // slaves answer within 73 ms
}

TEST_F(Modbus, LeavesTheSilenceOfThreeAndAHalfCharactersBetweenFrames) {
  peer.answers = {kAnswer, kAnswer, kAnswer};
  for (int i = 0; i < 3; ++i) read();
  ASSERT_EQ(peer.times.size(), 3u);
  for (std::size_t i = 1; i < 3; ++i) {
    EXPECT_GE(seconds(peer.times[i] - peer.times[i - 1]), 0.00175);
    EXPECT_LE(seconds(peer.times[i] - peer.times[i - 1]), 0.002);
  }
  EXPECT_NEAR(seconds(rtu_silence(9600)), 3.5 * 11 / 9600, 1e-9);
  EXPECT_NEAR(seconds(rtu_silence(19200)), 3.5 * 11 / 19200, 1e-9);
  EXPECT_NEAR(seconds(rtu_silence(115200)), 0.00175, 1e-9);
}

const std::string kReadRequest = bytes("0104753F00025BCB");
const std::string kWriteRequest = bytes("0106756C005593E4");  // and its answer

TEST_F(Modbus, DropsItsOwnFrameWhereTheAdapterHandsItBack) {
  peer.answers = {kReadRequest + kAnswer, kWriteRequest + kWriteRequest};
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
  master.write_register(1, 0x756C, 0x55);
  peer.answers = {kReadRequest.substr(0, 3)};  // handed back byte by byte
  peer.then = kReadRequest.substr(3) + kAnswer;
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
}

TEST_F(Modbus, DoesNotTakeAnEchoForTheConfirmationOfAWrite) {
  peer.answers = {kReadRequest + kAnswer, kWriteRequest};  // whoever was to write is silent
  read();
  try {
    master.write_register(1, 0x756C, 0x55);
    FAIL() << "confirmed by its own bytes";
  } catch (const TimeoutError& e) {
    EXPECT_THAT(e.what(), ::testing::HasSubstr("own bytes came back"));
  }
  peer.answers = {kReadRequest};
  try {
    read();
    FAIL() << "answered by its own bytes";
  } catch (const TimeoutError& e) {
    EXPECT_THAT(e.what(), ::testing::HasSubstr("own bytes came back"));
  }
}

TEST_F(Modbus, SaysThatWhatMayBeAskedAgainWasMetByABusyPeer) {
  using Repeat = ModbusMaster::Repeat;
  for (const char* busy : {"0184058303", "018406C302"}) {
    peer.answers = {bytes(busy)};
    EXPECT_THROW(read(), BusyError) << busy;
  }
  const std::array<std::uint16_t, 2> words{1, 2};
  peer.answers = {bytes("018606C262"), bytes("019006CC02")};
  EXPECT_THROW(master.write_register(1, 0x756C, 0x55, Repeat::kAllowed), BusyError);
  EXPECT_THROW(master.write_registers(1, 0x756C, words, Repeat::kAllowed), BusyError);
  // The opcode of a motion may not be said again, and 06 may be the device's own word.
  peer.answers = {bytes("018606C262"), bytes("019006CC02")};
  EXPECT_THROW(master.write_register(1, 0x756C, 0x55), ModbusException);
  EXPECT_THROW(master.write_registers(1, 0x756C, words), ModbusException);
  peer.answers = {bytes("01840AC307")};
  EXPECT_THROW(read(), TimeoutError);  // a gateway without a way there
}

/// Sends noise without pause.
class FloodingPeer final : public Actor {
 public:
  explicit FloodingPeer(Line line) : line_(std::move(line)) {}
  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override { return due_; }
  void act(Time now) override {
    std::array<char, 512> buffer;
    heard += line_.read_available(buffer, now);
    if (now < due_) return;
    line_.write_available(std::string(200, '\x01'), now);
    due_ = now + std::chrono::microseconds{200};
  }
  std::size_t heard = 0;

 private:
  Line line_;
  Time due_{0};
};

TEST(ModbusFlood, EveryWaitEndsAtItsDeadlineAndTheRequestIsSent) {
  ManualClock clock;
  auto [near, far] = line_pair("bus");
  FloodingPeer peer(std::move(far));
  clock.attach(peer);
  ModbusMaster master(std::move(near), clock, ModbusMaster::Framing::kRtu, std::chrono::seconds{1});
  EXPECT_THROW(master.read_input(1, 0x753F, 2), ProtocolError);
  EXPECT_NEAR(seconds(clock.now()), 1.0, 0.1);
  EXPECT_EQ(peer.heard, 8u);
  const Time before = clock.now();
  const ModbusMaster::Urgent urgent(master);
  EXPECT_THROW(master.write_register(1, 0x756C, 0x55), ProtocolError);
  EXPECT_EQ(peer.heard, 16u);
  EXPECT_NEAR(seconds(clock.now() - before), 1.0, 0.1);
  clock.detach(peer);
}

class ModbusGateway : public Modbus {
 protected:
  ModbusGateway() : Modbus(ModbusMaster::Framing::kTcp) {}
};

TEST_F(ModbusGateway, NumbersItsTransactions) {
  peer.answers = {bytes("000100000007"
                        "0104044145851F"),
                  bytes("000200000007"
                        "010404"
                        "00000001")};
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
  EXPECT_THAT(read(), ElementsAre(0, 1));
  EXPECT_THAT(peer.heard, ElementsAre(bytes("000100000006"
                                            "0104753F0002"),
                                      bytes("000200000006"
                                            "0104753F0002")));
}

TEST_F(ModbusGateway, PassesOverTheAnswerToAnEarlierTransaction) {
  EXPECT_THROW(read(), TimeoutError);
  peer.answers = {bytes("000100000007"
                        "010404"
                        "00000001") +
                  bytes("000200000007"
                        "0104044145851F")};
  EXPECT_THAT(read(), ElementsAre(0x4145, 0x851F));
}

TEST_F(ModbusGateway, TakesItsWordThatASlaveIsSilent) {
  peer.answers = {
      bytes("000100000003"
            "01840B")};
  EXPECT_THROW(read(), TimeoutError);
}

TEST_F(ModbusGateway, NamesWhatAGatewayDoesNotRepeat) {
  const auto message = [&](std::string_view answer) {
    peer.answers = {bytes(answer)};
    try {
      read();
    } catch (const ProtocolError& e) {
      return std::string(e.what());
    }
    return std::string("taken");
  };
  EXPECT_THAT(message("0000000000070104044145851F"),
              ::testing::HasSubstr("transaction 0 instead of 1"));
  EXPECT_THAT(message("0002000000070004044145851F"), ::testing::HasSubstr("unit 0 instead of 1"));
  EXPECT_THAT(message("0003000500070104044145851F"),
              ::testing::HasSubstr("protocol 5 instead of 0"));
  const std::string other = message("000400000003010401");
  EXPECT_THAT(other, ::testing::Not(::testing::HasSubstr("baud")));
}

}  // namespace
}  // namespace turntable
