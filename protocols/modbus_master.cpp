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
constexpr int kGatewayTargetSilent = 0x0B;  // a gateway's own words for a slave's silence
constexpr std::size_t kExceptionBytes = 2;  // function and code

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

ModbusMaster::ModbusMaster(Line line, Clock& clock, Framing framing, Time timeout,
                           std::function<bool()> give_way)
    : line_(std::move(line)),
      clock_(&clock),
      framing_(framing),
      timeout_(timeout),
      give_way_(std::move(give_way)),
      context_(std::make_unique<Context>(framing)) {}

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
  const std::string pdu =
      exchange(request(function, address, static_cast<std::uint16_t>(count)), slave, 2 + 2 * words);
  std::vector<std::uint16_t> values;
  for (std::size_t i = 0; i < words; ++i) values.push_back(word_at(pdu, 2 + 2 * i));
  return values;
}

void ModbusMaster::write_register(int slave, std::uint16_t address, std::uint16_t value) {
  write(request(MODBUS_FC_WRITE_SINGLE_REGISTER, address, value), slave);
}

void ModbusMaster::write_registers(int slave, std::uint16_t address,
                                   std::span<const std::uint16_t> values) {
  std::string pdu = request(MODBUS_FC_WRITE_MULTIPLE_REGISTERS, address,
                            static_cast<std::uint16_t>(values.size()));
  pdu += static_cast<char>(2 * values.size());
  for (const std::uint16_t value : values) append(pdu, value);
  write(pdu, slave);
}

/// A write is answered by its own first five bytes.
void ModbusMaster::write(const std::string& pdu, int slave) {
  const std::string answer = exchange(pdu, slave, 5);
  if (answer == pdu.substr(0, 5)) return;
  in_step_ = false;
  throw ProtocolError(fmt::format("{}: slave {} confirms another write ({}) than the one asked for",
                                  line_.name(), slave, hex(answer)));
}

/// Lets what still comes after trouble come, and throws it away.
void ModbusMaster::settle() {
  const Time quiet = urgent_ ? kUrgentQuiet : kQuiet;
  const Time end = clock_->now() + (urgent_ ? kUrgentQuiet : kSettleMost);
  line_.drain(clock_->now());
  while (clock_->now() < end && !(give_way_ && give_way_()) &&
         clock_->wait_readable(line_.descriptor(), std::min(end, clock_->now() + quiet)))
    line_.drain(clock_->now());
}

std::string ModbusMaster::exchange(const std::string& pdu, int slave, std::size_t answer_bytes) {
  if (!in_step_) settle();
  line_.drain(clock_->now());
  std::string frame = context_->frame(slave, pdu);
  if (framing_ == Framing::kTcp) {  // libmodbus leaves it at 0 in a raw request
    ++transaction_;
    frame[0] = static_cast<char>(high(transaction_));
    frame[1] = static_cast<char>(low(transaction_));
  }
  in_step_ = false;
  const Time deadline = clock_->now() + timeout_;
  line_.write(frame, *clock_, deadline);
  const int function = byte_at(pdu, 0);
  std::string received;
  std::array<char, 512> buffer;
  for (bool waited = false;; waited = true) {
    const std::size_t n = waited ? line_.read_available(buffer, clock_->now()) : 0;
    if (n > 0) {
      received.append(buffer.data(), n);
      const std::string answer = answer_in(received, function, slave, answer_bytes);
      if (answer.empty()) continue;
      in_step_ = true;
      if (byte_at(answer, 0) == function) return answer;
      const int code = byte_at(answer, 1);
      if (code == kGatewayTargetSilent)
        throw TimeoutError(fmt::format(
            "{}: the gateway had no answer from slave {}. Check its power, address and cable.",
            line_.name(), slave));
      throw ModbusException(
          fmt::format("{}: slave {} answers function {} at {} with exception {:02X}", line_.name(),
                      slave, function, word_at(pdu, 1), code),
          code);
    }
    const Time slice = give_way_ ? std::min(deadline, clock_->now() + kBusSlice) : deadline;
    if (clock_->wait_readable(line_.descriptor(), slice)) continue;
    if (clock_->now() >= deadline) break;
    if (give_way_()) throw GaveWay(fmt::format("{}: an exchange gave way to a stop", line_.name()));
  }
  if (received.empty())
    throw TimeoutError(fmt::format(
        "{}: no answer from slave {} within {:g} s. Check power, cable, address and baud rate.",
        line_.name(), slave, seconds(timeout_)));
  throw ProtocolError(fmt::format(
      "{}: slave {} was asked, and what came is no answer to that: {}. Check baud rate, parity, "
      "cable and termination.",
      line_.name(), slave, hex(received)));
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
    const bool reads =
        function == MODBUS_FC_READ_HOLDING_REGISTERS || function == MODBUS_FC_READ_INPUT_REGISTERS;
    if (found == function && reads && byte_at(rest, header + 1) != answer_bytes - 2) continue;
    if (std::string pdu = context_->pdu(rest.substr(0, header + bytes + trailer)); !pdu.empty())
      return pdu;
  }
  return {};
}

}  // namespace turntable
