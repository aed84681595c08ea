// Bytes as people write them down.
#pragma once

#include <fmt/format.h>

#include <string>
#include <string_view>

namespace turntable {

/// Blanks between digits are left out.
inline std::string bytes_of(std::string_view hex) {
  std::string bytes, digits;
  for (const char c : hex)
    if (c != ' ') digits += c;
  for (std::size_t i = 0; i + 1 < digits.size(); i += 2)
    bytes += static_cast<char>(std::stoi(digits.substr(i, 2), nullptr, 16));
  return bytes;
}

inline std::string hex_of(std::string_view bytes) {
  std::string hex;
  for (const char c : bytes) hex += fmt::format("{:02x}", static_cast<unsigned char>(c));
  return hex;
}

/// The checksum of Modbus RTU, low byte first; bit by bit, unlike the program's.
inline std::string modbus_checksum(std::string_view bytes) {
  unsigned crc = 0xFFFF;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1u) != 0 ? (crc >> 1u) ^ 0xA001u : crc >> 1u;
  }
  return {static_cast<char>(crc & 0xFFu), static_cast<char>(crc >> 8u)};
}

}  // namespace turntable
