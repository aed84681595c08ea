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
        line, clock_, tcp ? ModbusMaster::Framing::kTcp : ModbusMaster::Framing::kRtu, timeout_);
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
    const int said = errno;
    std::error_code unreadable;
    const int error = std::filesystem::exists(file, unreadable) ? said : ENOENT;
    throw DeviceError(
        fmt::format("{}: cannot be read ({}). Correct the file's name in the rig file",
                    file.string(), error != 0 ? std::strerror(error) : "it is empty"));
  }
  text.resize(static_cast<std::size_t>(in.gcount()));
  return text;
}

}  // namespace

namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// Whether a word that begins like a number is a date, a time, an address, a version or hexadecimal.
bool is_no_quantity(std::string_view word) {
  if (word.size() > 2 && word[0] == '0' && (word[1] == 'x' || word[1] == 'X')) return true;
  int points = 0;
  for (std::size_t i = 1; i + 1 < word.size(); ++i) {
    const bool between = is_digit(word[i - 1]) && is_digit(word[i + 1]);
    if (between && (word[i] == ':' || word[i] == '/' || word[i] == '-')) return true;
    if (word[i] == ',') points = 0;  // another field
    points += between && word[i] == '.';
    if (points > 1) return true;
  }
  return false;
}

/// A word with a decimal point, whichever way it was written. @param shown for messages.
std::string with_point(std::string word, Decimal decimal, std::string_view shown) {
  const auto between_digits = [&](std::string_view marks) {
    for (std::size_t i = 1; i + 1 < word.size(); ++i)
      if (marks.find(word[i]) != marks.npos && is_digit(word[i - 1]) && is_digit(word[i + 1]))
        return i;
    return std::string::npos;
  };
  if (between_digits("'_") != word.npos)
    throw ProtocolError(fmt::format(
        "\"{}\" has a mark between digits that may part thousands. Let plain numbers be written",
        shown));
  const std::size_t comma = between_digits(",");
  if (comma == word.npos) return word;
  if (decimal == Decimal::kUnstated)
    throw ProtocolError(
        fmt::format("\"{}\" has a comma between digits: a decimal comma, or the next field? State "
                    "\"decimal\": \"comma\" or \"point\" for this channel in the rig file",
                    shown));
  if (decimal == Decimal::kPoint) return word.substr(0, comma);  // the next field
  if (word.find_first_of(".,") != comma || word.find_first_of(".,", comma + 1) != word.npos)
    throw ProtocolError(fmt::format(
        "\"{}\" has a point or a second comma beside its decimal comma: one of them may "
        "part thousands. Let plain numbers be written",
        shown));
  word[comma] = '.';
  return word;
}

}  // namespace

double first_number(std::string_view text, Decimal decimal) {
  const std::string shown(text.substr(0, 60));
  constexpr std::string_view kBetween = " \t\r\n;=\"()[]{}<>|";
  for (std::size_t at = text.find_first_not_of(kBetween); at != text.npos;) {
    const std::size_t end = std::min(text.find_first_of(kBetween, at), text.size());
    std::string word(text.substr(at, end - at));
    at = text.find_first_not_of(kBetween, end);
    // "T:21.5" names its number; "12:30" is a time.
    if (const std::size_t colon = word.rfind(':'); colon != word.npos && !is_digit(word.front()))
      word.erase(0, colon + 1);
    const std::size_t digits = word.find_first_not_of("+-.,");
    if (digits == word.npos || digits > 2 || !is_digit(word[digits])) continue;  // a name: "PT100"
    if (is_no_quantity(word)) continue;
    word = with_point(std::move(word), decimal, shown);
    const char* begin = word.data() + (word[0] == '+' ? 1 : 0);
    double value = 0.0;
    const auto [stop, error] = std::from_chars(begin, word.data() + word.size(), value);
    if (error == std::errc::result_out_of_range || (error == std::errc() && !std::isfinite(value)))
      throw ProtocolError(fmt::format("\"{}\" holds a number that is out of range", shown));
    if (error == std::errc()) return value;  // a unit may stand right behind it
  }
  throw ProtocolError(fmt::format("no number in \"{}\"", shown));
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
      reading = [c] { return first_number(text_of(c.path), c.decimal); };
    } else if (c.source == Source::kAsk) {
      auto& instrument = instruments[line_key(c.line)];
      if (!instrument) instrument = std::make_shared<TextInstrument>(c.line, clock);
      reading = [c, instrument, timeout] {
        return first_number(instrument->ask(c.ask, timeout), c.decimal);
      };
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
