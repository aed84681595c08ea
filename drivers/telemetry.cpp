#include "drivers/telemetry.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <fstream>
#include <map>
#include <memory>

#include "protocols/modbus_master.h"
#include "protocols/serial.h"
#include "protocols/tcp.h"
#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr int kDefaultBaud = 9600;
constexpr Time kConnectWait = std::chrono::seconds{3};
constexpr std::size_t kLongestAnswer = 256;

Line open_instrument(const LineConfig& line) {
  if (line.kind == LineConfig::Kind::kSerial)
    return open_serial(line.serial_port, line.baud != 0 ? line.baud : kDefaultBaud, line.parity,
                       line.stop_bits);
  return open_tcp(line.host, line.tcp_port, kConnectWait);
}

std::string line_key(const LineConfig& line) {
  return line.kind == LineConfig::Kind::kSerial ? line.serial_port
                                                : fmt::format("{}:{}", line.host, line.tcp_port);
}

/// Instruments end their lines with CR, LF or both: either ends an answer, and both end the query.
std::string ask_instrument(Line& line, Clock& clock, const std::string& query, Time timeout) {
  line.drain(clock.now());
  const Time deadline = clock.now() + timeout;
  line.write(query + "\r\n", clock, deadline);
  std::string answer;
  for (char byte = 0; answer.size() < kLongestAnswer;) {
    line.read({&byte, 1}, clock, deadline);
    if (byte != '\r' && byte != '\n')
      answer += byte;
    else if (!answer.empty())
      return answer;
  }
  throw ProtocolError(fmt::format("{}: an answer of more than {} bytes to \"{}\"", line.name(),
                                  kLongestAnswer, query));
}

std::string text_of(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::string text(kLongestAnswer, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (in.gcount() == 0) throw DeviceError(fmt::format("{}: cannot be read", file.string()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  return text;
}

}  // namespace

double first_number(std::string_view text) {
  for (std::size_t at = 0; at < text.size(); ++at) {
    // A sign belongs to the number behind it; std::from_chars knows no plus.
    const std::string_view rest = text.substr(at);
    if (rest.find_first_of("0123456789") == rest.npos) break;
    double value = 0.0;
    const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), value);
    if (error == std::errc() && std::isfinite(value)) return value;
  }
  throw ProtocolError(fmt::format("no number in \"{}\"", text.substr(0, 60)));
}

std::vector<Channel> open_channels(const TelemetryConfig& telemetry, Clock& clock,
                                   const std::function<double(const ChannelConfig&)>& simulated) {
  using Source = ChannelConfig::Source;
  std::map<std::string, std::shared_ptr<Line>> dialogs;
  std::map<std::string, std::shared_ptr<ModbusMaster>> masters;
  std::vector<Channel> channels;
  for (const ChannelConfig& c : telemetry.channels) {
    std::function<double()> reading;
    const Time timeout = from_seconds(c.reply_timeout_s);
    if (c.source == Source::kFile) {
      reading = [c] { return first_number(text_of(c.path)); };
    } else if (c.source == Source::kAsk) {
      auto& line = dialogs[line_key(c.line)];
      if (!line) line = std::make_shared<Line>(open_instrument(c.line));
      reading = [c, line, timeout, &clock] {
        return first_number(ask_instrument(*line, clock, c.ask, timeout));
      };
    } else if (c.source == Source::kRegister) {
      auto& master = masters[line_key(c.line)];
      if (!master)
        master = std::make_shared<ModbusMaster>(open_instrument(c.line), clock,
                                                c.line.kind == LineConfig::Kind::kModbusTcp
                                                    ? ModbusMaster::Framing::kTcp
                                                    : ModbusMaster::Framing::kRtu,
                                                timeout);
      reading = [c, master] {
        const auto address = static_cast<std::uint16_t>(c.register_at);
        const auto words = c.holding ? master->read_holding(c.slave, address, 1)
                                     : master->read_input(c.slave, address, 1);
        return c.is_signed ? static_cast<double>(static_cast<std::int16_t>(words.at(0)))
                           : static_cast<double>(words.at(0));
      };
    } else {
      reading = [c, simulated] { return simulated(c); };
    }
    channels.push_back({c.name, [c, reading] { return c.scale * reading() + c.offset; }});
  }
  return channels;
}

}  // namespace turntable
