#include "protocols/modbus_master.h"

#include <fmt/format.h>
#include <modbus/modbus.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <unordered_map>

namespace turntable {
namespace {

using std::chrono::milliseconds;

constexpr Time kBusSlice = milliseconds{20};
constexpr Time kQuiet = milliseconds{50};  // after trouble: nothing more comes
constexpr Time kUrgentQuiet = milliseconds{5};
constexpr Time kSettleMost = milliseconds{300};
constexpr std::size_t kExceptionBytes = 2;  // function and code
constexpr std::size_t kMostKept = 1024;     // of what arrives before an answer does
constexpr Time kLeastSilence = std::chrono::microseconds{1750};  // at any baud rate
// Slaves answer within 57 to 73 ms where that was measured (ZC300).
constexpr Time kAnswerOnItsWay = milliseconds{100};

// Exceptions that are a gateway's own words, or say that the time is wrong and not the request.
constexpr int kAcknowledged = 0x05, kBusy = 0x06;
constexpr int kGatewayNoPath = 0x0A, kGatewayTargetSilent = 0x0B;

bool is_read(int function) {
  return function == MODBUS_FC_READ_HOLDING_REGISTERS || function == MODBUS_FC_READ_INPUT_REGISTERS;
}

std::uint8_t high(std::uint16_t word) { return static_cast<std::uint8_t>(word >> 8u); }
std::uint8_t low(std::uint16_t word) { return static_cast<std::uint8_t>(word & 0xFFu); }
void append(std::string& bytes, std::uint16_t word) {
  bytes += static_cast<char>(high(word));
  bytes += static_cast<char>(low(word));
}
std::uint8_t byte_at(std::string_view bytes, std::size_t i) {
  return static_cast<std::uint8_t>(bytes[i]);
}
std::uint16_t word_at(std::string_view bytes, std::size_t i) {
  return static_cast<std::uint16_t>(byte_at(bytes, i) << 8u | byte_at(bytes, i + 1));
}

std::string request(int function, std::uint16_t address, std::uint16_t value) {
  std::string pdu(1, static_cast<char>(function));
  append(pdu, address);
  append(pdu, value);
  return pdu;
}

std::string hex(std::string_view bytes) {
  std::string shown;
  for (const char c : bytes.substr(0, 32))
    shown += fmt::format("{}{:02x}", shown.empty() ? "" : " ", static_cast<unsigned char>(c));
  return shown + (bytes.size() > 32 ? " ..." : "");
}

}  // namespace

Time rtu_silence(int baud) { return baud > 19200 ? kLeastSilence : from_seconds(3.5 * 11 / baud); }

/// A libmodbus context whose line is a socket pair inside this process.
class ModbusMaster::Context {
 public:
  explicit Context(Framing framing)
      : modbus_(framing == Framing::kRtu ? modbus_new_rtu("/dev/null", 115200, 'N', 8, 1)
                                         : modbus_new_tcp("127.0.0.1", 502)),
        header_(framing == Framing::kRtu ? 1 : 7) {
    if (modbus_ == nullptr ||
        ::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends_.data()) != 0)
      throw LineError(fmt::format("libmodbus cannot be set up: {}", modbus_strerror(errno)));
    modbus_set_socket(modbus_, ends_[0]);
    modbus_set_response_timeout(modbus_, 0, 1000);  // what it is shown is complete already
    modbus_set_byte_timeout(modbus_, 0, 1000);
  }
  ~Context() {
    modbus_free(modbus_);
    ::close(ends_[0]);
    ::close(ends_[1]);
  }
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  /// The bytes of a request. Polling asks for the same ones over and over.
  const std::string& frame(int slave, const std::string& pdu) {
    std::string raw(1, static_cast<char>(slave));
    raw += pdu;
    modbus_set_slave(modbus_, slave);
    if (frames_.size() > kFramesKept) frames_.clear();
    std::string& kept = frames_[raw];
    if (kept.empty()) kept = made(raw);
    return kept;
  }

  std::string made(const std::string& raw) {
    std::array<char, MODBUS_MAX_ADU_LENGTH> bytes;
    ssize_t n = -1;
    if (modbus_send_raw_request(modbus_, reinterpret_cast<const std::uint8_t*>(raw.data()),
                                static_cast<int>(raw.size())) > 0)
      n = ::recv(ends_[1], bytes.data(), bytes.size(), MSG_DONTWAIT);
    if (n <= 0)
      throw ProtocolError(fmt::format("libmodbus made no frame: {}", modbus_strerror(errno)));
    return {bytes.data(), static_cast<std::size_t>(n)};
  }

  /// The PDU of an answer from the slave that was asked last; empty if libmodbus does not take it.
  std::string pdu(std::string_view frame) {
    std::array<std::uint8_t, MODBUS_MAX_ADU_LENGTH> answer;
    int n = -1;
    if (::send(ends_[1], frame.data(), frame.size(), MSG_NOSIGNAL) ==
        static_cast<ssize_t>(frame.size()))
      n = modbus_receive_confirmation(modbus_, answer.data());
    if (n != static_cast<int>(frame.size())) {  // nothing may be left for the next frame
      std::array<char, MODBUS_MAX_ADU_LENGTH> rest;
      while (::recv(ends_[0], rest.data(), rest.size(), MSG_DONTWAIT) > 0) {
      }
      return {};
    }
    const std::size_t crc = header_ == 1 ? 2 : 0;
    return {reinterpret_cast<const char*>(answer.data()) + header_, frame.size() - header_ - crc};
  }

 private:
  static constexpr std::size_t kFramesKept = 64;
  modbus_t* modbus_;
  std::size_t header_;  ///< bytes before the PDU
  std::unordered_map<std::string, std::string> frames_;
  std::array<int, 2> ends_{-1, -1};
};

ModbusMaster::ModbusMaster(SharedLine line, Clock& clock, Framing framing, Time timeout,
                           std::function<bool()> give_way)
    : line_(std::move(line)),
      clock_(&clock),
      framing_(framing),
      timeout_(timeout),
      give_way_(std::move(give_way)),
      context_(std::make_unique<Context>(framing)) {
  if (framing == Framing::kRtu) line_.want_silence(kLeastSilence);
}

ModbusMaster::~ModbusMaster() = default;

std::vector<std::uint16_t> ModbusMaster::read_holding(int slave, std::uint16_t address, int count) {
  return read(MODBUS_FC_READ_HOLDING_REGISTERS, slave, address, count);
}

std::vector<std::uint16_t> ModbusMaster::read_input(int slave, std::uint16_t address, int count) {
  return read(MODBUS_FC_READ_INPUT_REGISTERS, slave, address, count);
}

std::vector<std::uint16_t> ModbusMaster::read(int function, int slave, std::uint16_t address,
                                              int count) {
  const auto words = static_cast<std::size_t>(count);
  const std::string pdu = exchange(request(function, address, static_cast<std::uint16_t>(count)),
                                   slave, 2 + 2 * words, Repeat::kAllowed);
  std::vector<std::uint16_t> values;
  for (std::size_t i = 0; i < words; ++i) values.push_back(word_at(pdu, 2 + 2 * i));
  return values;
}

void ModbusMaster::write_register(int slave, std::uint16_t address, std::uint16_t value,
                                  Repeat repeat) {
  write(request(MODBUS_FC_WRITE_SINGLE_REGISTER, address, value), slave, repeat);
}

void ModbusMaster::write_registers(int slave, std::uint16_t address,
                                   std::span<const std::uint16_t> values, Repeat repeat) {
  std::string pdu = request(MODBUS_FC_WRITE_MULTIPLE_REGISTERS, address,
                            static_cast<std::uint16_t>(values.size()));
  pdu += static_cast<char>(2 * values.size());
  for (const std::uint16_t value : values) append(pdu, value);
  write(pdu, slave, repeat);
}

/// A write is answered by its own first five bytes.
void ModbusMaster::write(const std::string& pdu, int slave, Repeat repeat) {
  const auto turn = line_.lock();
  const std::string answer = exchange(pdu, slave, 5, repeat);
  if (answer == pdu.substr(0, 5)) return;
  line_.set_unanswered(clock_->now());
  throw ProtocolError(fmt::format("{}: slave {} confirms another write ({}) than the one asked for",
                                  line_.name(), slave, hex(answer)));
}

/// Lets what still comes after trouble come, and throws it away. A stop waits for it only as long as an
/// answer may be on its way: talking into it would lose both.
void ModbusMaster::settle(Time unanswered_since) {
  Line& line = line_.line();
  const auto readable = [&](Time until) {
    return clock_->now() < until && clock_->wait_readable(line.descriptor(), until);
  };
  line.drain(clock_->now());
  if (urgent_) {
    if (framing_ == Framing::kRtu && readable(unanswered_since + kAnswerOnItsWay))
      line.drain(clock_->now());
    if (readable(clock_->now() + kUrgentQuiet)) line.drain(clock_->now());
    return;
  }
  const Time end = clock_->now() + kSettleMost;
  while (!(give_way_ && give_way_()) && readable(std::min(end, clock_->now() + kQuiet)))
    line.drain(clock_->now());
}

/// Puts a frame on the line, after the silence that has to be between frames. What is on the line then
/// is no answer to it. A line that is flooded is never silent: what is urgent goes out all the same.
void ModbusMaster::send(const std::string& frame, Time deadline) {
  if (const auto since = line_.unanswered_since()) settle(*since);
  line_.line().drain(clock_->now());
  line_.await_silence(*clock_);
  line_.line().drain(clock_->now());
  line_.set_unanswered(clock_->now());
  line_.line().write(frame, *clock_, deadline);
}

/// Drops the master's own frame from the front of what has arrived, where the adapter hands it back.
/// The answer to function 6 looks like its question, so there the line's habit has to be known; it is
/// learnt from reads, whose answers never do.
/// @param due whether it may still come. @return true if what is there may be looked at for an answer.
bool ModbusMaster::drop_echo(std::string& received, std::string_view frame, int function,
                             bool& due) {
  if (!due) return true;
  const bool known = line_.echoes().value_or(false);
  if (frame.starts_with(std::string_view(received).substr(0, frame.size()))) {
    if (received.size() < frame.size()) return !known;
    if (is_read(function) || known) {
      line_.set_echoes(true);
      received.erase(0, frame.size());
    }
  }
  due = false;
  return true;
}

std::string ModbusMaster::exchange(const std::string& pdu, int slave, std::size_t answer_bytes,
                                   Repeat repeat) {
  const auto turn = line_.lock();
  std::string frame = context_->frame(slave, pdu);
  if (framing_ == Framing::kTcp) {  // libmodbus leaves it at 0 in a raw request
    ++transaction_;
    frame[0] = static_cast<char>(high(transaction_));
    frame[1] = static_cast<char>(low(transaction_));
  }
  send(frame, clock_->now() + kSettleMost + timeout_);
  Line& line = line_.line();
  const Time sent = clock_->now(), deadline = sent + timeout_;
  const Time patience = sent + (framing_ == Framing::kRtu ? kAnswerOnItsWay : kBusSlice);
  const int function = byte_at(pdu, 0);
  std::string received;
  bool echo_due = framing_ == Framing::kRtu;
  std::array<char, 512> buffer;
  for (;;) {
    // A stop does not talk into an answer that may be coming: both would be lost.
    const Time now = clock_->now();
    if (give_way_ && now >= patience && give_way_())
      throw GaveWay(fmt::format("{}: an exchange gave way to a stop", line_.name()));
    if (now >= deadline) break;
    if (!clock_->wait_readable(line.descriptor(),
                               give_way_ ? std::min(deadline, now + kBusSlice) : deadline))
      continue;
    const std::size_t n = line.read_available(buffer, clock_->now());
    received.append(buffer.data(), n);
    if (!drop_echo(received, frame, function, echo_due)) continue;
    if (const std::string answer = answer_in(received, function, slave, answer_bytes);
        !answer.empty()) {
      line_.set_unanswered(std::nullopt);
      if (byte_at(answer, 0) == function) return answer;
      refused(pdu, slave, byte_at(answer, 1), repeat);
    }
    // The rest serves the message only: an answer that is still incomplete is shorter than this.
    if (received.size() > kMostKept) received.erase(0, received.size() - kMostKept / 2);
  }
  unanswered(received, frame, slave);
}

/// What an exception means, by what was asked.
void ModbusMaster::refused(const std::string& pdu, int slave, int code, Repeat repeat) const {
  const int function = byte_at(pdu, 0);
  const std::string what =
      fmt::format("{}: slave {} answers function {} at {} with exception {:02X}", line_.name(),
                  slave, function, word_at(pdu, 1), code);
  if (code == kGatewayTargetSilent)
    throw TimeoutError(fmt::format(
        "{}: the gateway had no answer from slave {}. Check its power, address and cable.",
        line_.name(), slave));
  if (repeat == Repeat::kAllowed) {
    if (code == kBusy || (code == kAcknowledged && is_read(function)))
      throw BusyError(what + (code == kBusy ? " (busy)." : " (accepted, not done yet)."));
    if (code == kGatewayNoPath && is_read(function))
      throw TimeoutError(fmt::format(
          "{}: the gateway has no way to slave {}. Check its set-up, and the slave's address.",
          line_.name(), slave));
  }
  throw ModbusException(what, code);
}

/// What has arrived is no answer: says why, as far as the bytes tell.
void ModbusMaster::unanswered(const std::string& received, const std::string& frame,
                              int slave) const {
  if (received.empty() && line_.echoes().value_or(false))
    throw TimeoutError(
        fmt::format("{}: no answer from slave {} within {:g} s: nothing but this program's own "
                    "bytes came back, "
                    "which the adapter hands back. Check power, cable and address.",
                    line_.name(), slave, seconds(timeout_)));
  if (received.empty())
    throw TimeoutError(
        fmt::format("{}: no answer from slave {} within {:g} s. Check power, cable, address{}.",
                    line_.name(), slave, seconds(timeout_),
                    framing_ == Framing::kRtu ? " and baud rate" : " and the gateway's set-up"));
  std::string differs;
  const auto add = [&](std::string_view text) {
    differs += fmt::format("{}{}", differs.empty() ? "" : ", and ", text);
  };
  if (framing_ == Framing::kTcp && received.size() >= 8) {
    if (word_at(received, 0) != word_at(frame, 0))
      add(fmt::format("transaction {} instead of {}", word_at(received, 0), word_at(frame, 0)));
    if (word_at(received, 2) != 0)
      add(fmt::format("protocol {} instead of 0", word_at(received, 2)));
    if (byte_at(received, 6) != slave)
      add(fmt::format("unit {} instead of {}", byte_at(received, 6), slave));
  }
  if (!differs.empty())
    throw ProtocolError(fmt::format(
        "{}: slave {} was asked, and the answer came with {}: {}. It is the late answer to an earlier "
        "question, or the gateway does not repeat what it was asked with, so that late answers cannot "
        "be told. Check its set-up, or take another gateway.",
        line_.name(), slave, differs, hex(received)));
  throw ProtocolError(
      fmt::format("{}: slave {} was asked, and what came is no answer to that: {}. Check {}.",
                  line_.name(), slave, hex(received),
                  framing_ == Framing::kRtu ? "baud rate, parity, cable and termination"
                                            : "the gateway's set-up"));
}

/// The PDU of the first frame in `received` that answers; empty if there is none yet. Noise and
/// frames of other slaves may stand before it.
std::string ModbusMaster::answer_in(std::string_view received, int function, int slave,
                                    std::size_t answer_bytes) {
  const std::size_t header = framing_ == Framing::kRtu ? 1 : 7;
  const std::size_t trailer = framing_ == Framing::kRtu ? 2 : 0;
  for (std::size_t at = 0; at + header + kExceptionBytes + trailer <= received.size(); ++at) {
    const std::string_view rest = received.substr(at);
    const int found = byte_at(rest, header);
    if (byte_at(rest, header - 1) != slave || (found & 0x7F) != function) continue;
    const std::size_t bytes = found == function ? answer_bytes : kExceptionBytes;
    if (rest.size() < header + bytes + trailer) continue;
    if (framing_ == Framing::kTcp && (word_at(rest, 0) != transaction_ || word_at(rest, 2) != 0 ||
                                      word_at(rest, 4) != bytes + 1))
      continue;
    if (found == function && is_read(function) && byte_at(rest, header + 1) != answer_bytes - 2)
      continue;
    if (std::string pdu = context_->pdu(rest.substr(0, header + bytes + trailer)); !pdu.empty())
      return pdu;
  }
  return {};
}

}  // namespace turntable
