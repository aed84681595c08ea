// What has come over a line.
#pragma once

#include <array>
#include <string>

#include "protocols/line.h"

namespace turntable {

/// Waits for the first bytes. @throws TimeoutError, LineError.
inline std::string read_text(Line& line, Clock& clock, Time deadline) {
  std::array<char, 64> buffer;
  return {buffer.data(), line.read(buffer, clock, deadline)};
}
/// For a second.
inline std::string read_text(Line& line, Clock& clock) {
  return read_text(line, clock, clock.now() + std::chrono::milliseconds{1000});
}

}  // namespace turntable
