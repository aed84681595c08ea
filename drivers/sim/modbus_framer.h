// Modbus, the slaves' side of a bus: finds requests in a stream of bytes and frames the answers. A
// framer of our own: libmodbus' server waits by itself, and is deaf for a while after a frame to
// another slave, so several slaves could not share a bus; and what checks the master should not be
// made of the same library.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "src/core/clock.h"

namespace turntable::sim {

struct ModbusRequest {
  int slave = 0;
  int function = 0;
  std::uint16_t address = 0;
  std::uint16_t count = 0;            ///< functions 3, 4 and 16: registers; function 6: the value
  std::vector<std::uint16_t> values;  ///< functions 6 and 16
  std::uint16_t transaction = 0;      ///< Modbus TCP
};

/// The least silence before an RTU frame, at any baud rate above 19200 ("MODBUS over serial line" V1.02).
inline constexpr Time kRtuSilence = std::chrono::microseconds{1750};

class ModbusFramer {
 public:
  explicit ModbusFramer(bool tcp) : tcp_(tcp) {}

  /// A pause inside a frame of more than 0.1 s makes what came before it noise.
  /// @param silence how long the line had been silent before. An RTU frame that begins too soon is taken
  /// for the rest of the frame before, and lost.
  void feed(std::string_view bytes, Time now, Time silence);
  /// The next whole request. After a bad CRC all that has come is thrown away, as slaves do.
  std::optional<ModbusRequest> next();
  void forget() { pending_.clear(); }

  std::string words(const ModbusRequest& request, std::span<const std::uint16_t> values) const;
  std::string confirmation(const ModbusRequest& request) const;  ///< of a write
  std::string exception(const ModbusRequest& request, int code) const;

 private:
  std::string frame(const ModbusRequest& request, std::string_view pdu) const;

  bool tcp_;
  std::string pending_;
  Time last_{0};
};

/// Modbus RTU's check: polynomial 0xA001, start 0xFFFF, low byte first on the wire.
std::uint16_t modbus_crc(std::string_view bytes);

}  // namespace turntable::sim
