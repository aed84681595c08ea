#include "drivers/telemetry.h"

#include <fmt/format.h>

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <map>
#include <memory>
#include <optional>

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

/// An instrument that answers in text. A line that was lost is opened again for the next question: it
/// may have been switched off for a while.
class TextInstrument {
 public:
  TextInstrument(const LineConfig& config, Clock& clock)
      : config_(config), clock_(clock), line_(open_instrument(config)) {}

  /// Instruments end their lines with CR, LF or both: either ends an answer, and both end the query.
  std::string ask(const std::string& query, Time timeout) {
    if (!line_) {
      line_ = open_instrument(config_);
      in_step_ = true;  // nothing can be on its way on a new line
    }
    try {
      if (!in_step_) settle(timeout);
      in_step_ = false;
      line_->drain(clock_.now());
      const Time deadline = clock_.now() + timeout;
      line_->write(query + "\r\n", clock_, deadline);
      std::string answer = answer_until(deadline);
      in_step_ = true;
      return answer;
    } catch (const LineError&) {
      line_.reset();
      throw;
    }
  }

 private:
  std::string answer_until(Time deadline) {
    std::string answer;
    for (char byte = 0; answer.size() < kLongestAnswer;) {
      line_->read({&byte, 1}, clock_, deadline);
      if (byte != '\r' && byte != '\n')
        answer += byte;
      else if (!answer.empty())
        return answer;
    }
    throw ProtocolError(
        fmt::format("{}: an answer of more than {} bytes", line_->name(), kLongestAnswer));
  }
  /// After a failure an answer may still be on its way, and must not be taken for the next one's.
  void settle(Time quiet) {
    const Time at_most = clock_.now() + 4 * quiet;
    while (clock_.now() < at_most &&
           clock_.wait_readable(line_->descriptor(), clock_.now() + quiet))
      line_->drain(clock_.now());
  }

  LineConfig config_;
  Clock& clock_;
  std::optional<Line> line_;
  bool in_step_ = true;
};

/// The same for Modbus, whose master settles by itself.
class Registers {
 public:
  Registers(const LineConfig& config, Clock& clock, Time timeout)
      : config_(config), clock_(clock), timeout_(timeout) {
    open();
  }
  std::uint16_t read(const ChannelConfig& channel) {
    if (!master_) open();
    const auto address = static_cast<std::uint16_t>(channel.register_at);
    try {
      return channel.holding ? master_->read_holding(channel.slave, address, 1).at(0)
                             : master_->read_input(channel.slave, address, 1).at(0);
    } catch (const LineError&) {
      master_.reset();
      throw;
    }
  }

 private:
  void open() {
    const bool tcp = config_.kind == LineConfig::Kind::kModbusTcp;
    const SharedLine line(open_instrument(config_));
    if (!tcp) line.want_silence(rtu_silence(config_.baud != 0 ? config_.baud : kDefaultBaud));
    master_ = std::make_unique<ModbusMaster>(
        line, clock_,
        tcp ? ModbusMaster::Framing::kTcp : ModbusMaster::Framing::kRtu, timeout_);
  }
  LineConfig config_;
  Clock& clock_;
  Time timeout_;
  std::unique_ptr<ModbusMaster> master_;
};

std::string text_of(const std::filesystem::path& file) {
  errno = 0;
  std::ifstream in(file);
  std::string text(kLongestAnswer, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (in.gcount() == 0) {
    const int error = std::filesystem::exists(file) ? errno : ENOENT;
    throw DeviceError(
        fmt::format("{}: cannot be read ({}). Correct the file's name in the rig file",
                    file.string(), error != 0 ? std::strerror(error) : "it is empty"));
  }
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
  std::map<std::string, std::shared_ptr<TextInstrument>> instruments;
  std::map<std::string, std::shared_ptr<Registers>> slaves;
  std::vector<Channel> channels;
  for (const ChannelConfig& c : telemetry.channels) {
    std::function<double()> reading;
    const Time timeout = from_seconds(c.reply_timeout_s);
    if (c.source == Source::kFile) {
      reading = [c] { return first_number(text_of(c.path)); };
    } else if (c.source == Source::kAsk) {
      auto& instrument = instruments[line_key(c.line)];
      if (!instrument) instrument = std::make_shared<TextInstrument>(c.line, clock);
      reading = [c, instrument, timeout] { return first_number(instrument->ask(c.ask, timeout)); };
    } else if (c.source == Source::kRegister) {
      auto& registers = slaves[line_key(c.line)];
      if (!registers) registers = std::make_shared<Registers>(c.line, clock, timeout);
      reading = [c, registers] {
        const std::uint16_t word = registers->read(c);
        return c.is_signed ? static_cast<double>(static_cast<std::int16_t>(word))
                           : static_cast<double>(word);
      };
    } else {
      reading = [c, simulated] { return simulated(c); };
    }
    channels.push_back({c.name, [c, reading] { return c.scale * reading() + c.offset; }});
  }
  return channels;
}

}  // namespace turntable
