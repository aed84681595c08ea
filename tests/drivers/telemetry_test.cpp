#include "drivers/telemetry.h"

#include <gmock/gmock.h>

#include <atomic>
#include <thread>

#include "protocols/tcp.h"
#include "src/core/errors.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

double never(const ChannelConfig&) { return 0.0; }

/// Answers what it is asked on a TCP port, until the test ends.
class Instrument {
 public:
  explicit Instrument(std::function<std::string(const std::string&)> answer)
      : listener_(0), thread_([this, answer = std::move(answer)] { serve(answer); }) {}
  ~Instrument() {
    ending_ = true;
    thread_.join();
  }
  LineConfig line() const {
    LineConfig line;
    line.kind = LineConfig::Kind::kTcp;
    line.host = "127.0.0.1";
    line.tcp_port = listener_.port();
    return line;
  }
  int clients() const { return clients_; }

 private:
  void serve(const std::function<std::string(const std::string&)>& answer) {
    std::vector<Line> lines;
    while (!ending_) {
      if (auto line = listener_.accept()) {
        lines.push_back(std::move(*line));
        ++clients_;
      }
      for (Line& line : lines) {
        char buffer[256];
        try {
          if (const std::size_t n = line.read_available(buffer, clock_.now()); n > 0)
            line.write(answer({buffer, n}), clock_, clock_.now() + std::chrono::seconds{1});
        } catch (const LineError&) {
        }
      }
      std::this_thread::sleep_for(std::chrono::milliseconds{1});
    }
  }
  SystemClock clock_;
  TcpListener listener_;
  std::atomic<bool> ending_{false};
  std::atomic<int> clients_{0};
  std::thread thread_;
};

TEST(Telemetry, FindsTheFirstNumberOfAnAnswer) {
  EXPECT_EQ(first_number("21.5"), 21.5);
  EXPECT_EQ(first_number("+021.37 C\r"), 21.37);
  EXPECT_EQ(first_number("T=-3.5e1;RH=40"), -35.0);
  EXPECT_EQ(first_number("45678\n"), 45678.0);
  EXPECT_EQ(first_number("23.5C"), 23.5);
  EXPECT_EQ(first_number("-.5"), -0.5);
  EXPECT_EQ(first_number("T:21.5"), 21.5);
  EXPECT_EQ(first_number("+021.37E+0,+023.11E+0"), 21.37);
  for (const char* text : {"", "ERR", "nan", "--", "+", ".", "1e999"})
    EXPECT_THROW(first_number(text), ProtocolError) << text;
}

TEST(Telemetry, PassesOverNumbersThatMeasureNothing) {
  EXPECT_EQ(first_number("PT100 21.3"), 21.3);
  EXPECT_EQ(first_number("ch1: 22.5"), 22.5);
  EXPECT_EQ(first_number("2026-12-01 23.4"), 23.4);
  EXPECT_EQ(first_number("01/12/2026 12:30:05 21.0"), 21.0);
  EXPECT_EQ(first_number("2026-12-01T12:30:05Z;20.5"), 20.5);
  EXPECT_EQ(first_number("192.168.0.7 19.5"), 19.5);
  EXPECT_EQ(first_number("0x1F 18"), 18.0);
  EXPECT_THROW(first_number("12:30"), ProtocolError);
}

TEST(Telemetry, CutsNoNumberShortAtAComma) {
  for (const char* text : {"23,87", "1.234,5", "1,234.5", "T=23,87", "-3,5", "1'234.5"})
    EXPECT_THROW(first_number(text), ProtocolError) << text;
  EXPECT_EQ(first_number("23,87", Decimal::kComma), 23.87);
  EXPECT_EQ(first_number("-3,5 C", Decimal::kComma), -3.5);
  EXPECT_EQ(first_number("23.87", Decimal::kComma), 23.87);  // some write both
  EXPECT_EQ(first_number("23.87,40.1", Decimal::kPoint), 23.87);
  for (const char* text : {"1.234,5", "1,234,567", "1,234.5"})
    EXPECT_THROW(first_number(text, Decimal::kComma), ProtocolError) << text;
}

TEST(Telemetry, ReadsANumberFromAFileWithItsScale) {
  const TemporaryFolder folder;
  spill(folder / "temp1_input", "21375\n");
  SystemClock clock;
  ChannelConfig channel;
  channel.name = "room";
  channel.path = folder / "temp1_input";
  channel.scale = 0.001;
  channel.offset = 0.5;
  const auto channels = open_channels({10.0, {channel}}, clock, never);
  ASSERT_EQ(channels.size(), 1u);
  EXPECT_EQ(channels[0].name, "room");
  EXPECT_DOUBLE_EQ(channels[0].read(), 21.875);
  spill(folder / "temp1_input", "");
  EXPECT_THROW(channels[0].read(), DeviceError);
  std::filesystem::remove(folder / "temp1_input");
  EXPECT_THROW(channels[0].read(), DeviceError);
}

TEST(Telemetry, AsksAnInstrumentInTextAndSharesItsLine) {
  Instrument instrument([](const std::string& query) -> std::string {
    if (query == "KRDG? A\r\n") return "+293.65\r\n";
    if (query == "KRDG? B\r\n") return "\n+294.10\n";
    return {};
  });
  SystemClock clock;
  ChannelConfig a, b, silent;
  a.source = b.source = silent.source = ChannelConfig::Source::kAsk;
  a.line = b.line = silent.line = instrument.line();
  a.ask = "KRDG? A";
  a.offset = -273.15;
  b.ask = "KRDG? B";
  silent.ask = "KRDG? C";
  silent.reply_timeout_s = 0.05;
  const auto channels = open_channels({10.0, {a, b, silent}}, clock, never);
  EXPECT_NEAR(channels[0].read(), 20.5, 1e-9);
  EXPECT_EQ(channels[1].read(), 294.1);
  EXPECT_THROW(channels[2].read(), TimeoutError);
  EXPECT_NEAR(channels[0].read(), 20.5, 1e-9);
  EXPECT_EQ(instrument.clients(), 1);
}

TEST(Telemetry, DoesNotTakeALateAnswerForTheNextOne) {
  Instrument instrument([](const std::string& query) -> std::string {
    if (query == "SLOW\r\n") {
      std::this_thread::sleep_for(std::chrono::milliseconds{150});
      return "1\r\n";
    }
    return "2\r\n";
  });
  SystemClock clock;
  ChannelConfig slow, quick;
  slow.source = quick.source = ChannelConfig::Source::kAsk;
  slow.line = quick.line = instrument.line();
  slow.ask = "SLOW";
  slow.reply_timeout_s = 0.1;
  quick.ask = "QUICK";
  const auto channels = open_channels({10.0, {slow, quick}}, clock, never);
  EXPECT_THROW(channels[0].read(), TimeoutError);
  EXPECT_EQ(channels[1].read(), 2.0);
}

TEST(Telemetry, OpensALineAgainThatWasLost) {
  SystemClock clock;
  ChannelConfig channel;
  channel.source = ChannelConfig::Source::kAsk;
  channel.line.kind = LineConfig::Kind::kTcp;
  channel.line.host = "127.0.0.1";
  channel.ask = "T?";
  channel.reply_timeout_s = 10.0;
  TcpListener listener(0);
  channel.line.tcp_port = listener.port();
  const auto channels = open_channels({10.0, {channel}}, clock, never);
  const auto accept = [&listener] {
    for (;;) {
      if (auto line = listener.accept()) return std::move(*line);
      std::this_thread::sleep_for(std::chrono::milliseconds{1});
    }
  };
  { const Line lost = accept(); }
  EXPECT_THROW(channels[0].read(), LineError);
  std::atomic<bool> read{false};
  std::thread answering([&] {
    Line line = accept();
    char buffer[16];
    line.read(buffer, clock, clock.now() + std::chrono::seconds{20});
    line.write("21.5\n", clock, clock.now() + std::chrono::seconds{20});
    while (!read) std::this_thread::sleep_for(std::chrono::milliseconds{1});
  });
  EXPECT_EQ(channels[0].read(), 21.5);
  read = true;
  answering.join();
}

TEST(Telemetry, ReadsAModbusRegister) {
  // Function 4, register 7 of slave 3 holds 0xff38, which is -200 with a sign.
  Instrument instrument([](const std::string& query) -> std::string {
    if (query.size() == 12 && query.substr(6) == std::string("\x03\x04\x00\x07\x00\x01", 6))
      return query.substr(0, 4) + std::string("\x00\x05\x03\x04\x02\xff\x38", 7);
    return {};
  });
  SystemClock clock;
  ChannelConfig channel;
  channel.source = ChannelConfig::Source::kRegister;
  channel.line = instrument.line();
  channel.line.kind = LineConfig::Kind::kModbusTcp;
  channel.register_at = 7;
  channel.slave = 3;
  channel.scale = 0.1;
  channel.is_signed = true;
  EXPECT_NEAR(open_channels({10.0, {channel}}, clock, never)[0].read(), -20.0, 1e-9);
  channel.is_signed = false;
  EXPECT_NEAR(open_channels({10.0, {channel}}, clock, never)[0].read(), 6533.6, 1e-9);
}

TEST(Telemetry, SaysThatNobodyIsThere) {
  SystemClock clock;
  ChannelConfig channel;
  channel.source = ChannelConfig::Source::kAsk;
  channel.ask = "?";
  {
    Instrument gone([](const std::string&) { return std::string(); });
    channel.line = gone.line();
  }
  EXPECT_THROW(open_channels({10.0, {channel}}, clock, never), LineError);
}

}  // namespace
}  // namespace turntable
