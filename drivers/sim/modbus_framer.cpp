#include "drivers/sim/modbus_framer.h"

#include <boost/crc.hpp>

namespace turntable::sim {
namespace {

constexpr Time kPause = std::chrono::milliseconds{100};

std::uint8_t byte_at(std::string_view bytes, std::size_t i) {
  return static_cast<std::uint8_t>(bytes[i]);
}
std::uint16_t word_at(std::string_view bytes, std::size_t i) {
  return static_cast<std::uint16_t>(byte_at(bytes, i) << 8u | byte_at(bytes, i + 1));
}
void append(std::string& bytes, std::uint16_t word) {
  bytes += static_cast<char>(word >> 8u);
  bytes += static_cast<char>(word & 0xFFu);
}

}  // namespace

std::uint16_t modbus_crc(std::string_view bytes) {
  boost::crc_optimal<16, 0x8005, 0xFFFF, 0, true, true> crc;
  crc.process_bytes(bytes.data(), bytes.size());
  return static_cast<std::uint16_t>(crc.checksum());
}

void ModbusFramer::feed(std::string_view bytes, Time now, Time silence) {
  if (now - last_ > kPause) pending_.clear();
  last_ = now;
  if (!tcp_ && pending_.empty() && silence < kRtuSilence) return;
  pending_ += bytes;
}

std::optional<ModbusRequest> ModbusFramer::next() {
  const std::size_t header = tcp_ ? 7 : 1, trailer = tcp_ ? 0 : 2;
  if (pending_.size() < header + 5) return std::nullopt;
  ModbusRequest request;
  request.slave = byte_at(pending_, header - 1);
  request.function = byte_at(pending_, header);
  request.address = word_at(pending_, header + 1);
  request.count = word_at(pending_, header + 3);
  std::size_t pdu = 5;
  if (request.function == 16) {
    if (pending_.size() < header + 6) return std::nullopt;
    pdu = 6u + byte_at(pending_, header + 5);
  }
  if (tcp_) {
    request.transaction = word_at(pending_, 0);
    if (word_at(pending_, 2) != 0 || word_at(pending_, 4) > 254) {
      pending_.clear();
      return std::nullopt;
    }
    pdu = word_at(pending_, 4) - 1u;
  }
  const std::size_t size = header + pdu + trailer;
  if (pending_.size() < size) return std::nullopt;
  const std::string frame = pending_.substr(0, size);
  if (!tcp_ && modbus_crc(std::string_view(frame).substr(0, size - 2)) !=
                   (byte_at(frame, size - 2) | byte_at(frame, size - 1) << 8u)) {
    pending_.clear();
    return std::nullopt;
  }
  pending_.erase(0, size);
  if (request.function == 6) request.values = {request.count};
  if (request.function == 16)
    for (std::size_t at = header + 6; at + 1 < header + pdu; at += 2)
      request.values.push_back(word_at(frame, at));
  return request;
}

std::string ModbusFramer::frame(const ModbusRequest& request, std::string_view pdu) const {
  std::string bytes;
  if (tcp_) {
    append(bytes, request.transaction);
    append(bytes, 0);
    append(bytes, static_cast<std::uint16_t>(pdu.size() + 1));
  }
  bytes += static_cast<char>(request.slave);
  bytes += pdu;
  if (tcp_) return bytes;
  const std::uint16_t crc = modbus_crc(bytes);
  bytes += static_cast<char>(crc & 0xFFu);
  bytes += static_cast<char>(crc >> 8u);
  return bytes;
}

std::string ModbusFramer::words(const ModbusRequest& request,
                                std::span<const std::uint16_t> values) const {
  std::string pdu(1, static_cast<char>(request.function));
  pdu += static_cast<char>(2 * values.size());
  for (const std::uint16_t value : values) append(pdu, value);
  return frame(request, pdu);
}

std::string ModbusFramer::confirmation(const ModbusRequest& request) const {
  std::string pdu(1, static_cast<char>(request.function));
  append(pdu, request.address);
  append(pdu, request.count);
  return frame(request, pdu);
}

std::string ModbusFramer::exception(const ModbusRequest& request, int code) const {
  std::string pdu(1, static_cast<char>(request.function | 0x80));
  pdu += static_cast<char>(code);
  return frame(request, pdu);
}

}  // namespace turntable::sim
