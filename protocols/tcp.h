// TCP: serial servers and gateways on the one side, simulators that listen on the other.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "protocols/line.h"

namespace turntable {

/// Connects, without delaying small packets. Resolving the name may take longer than `timeout`.
/// @throws LineError (refused, unknown host), TimeoutError.
Line open_tcp(const std::string& host, std::uint16_t port, Time timeout);

/// A listening socket.
class TcpListener {
 public:
  /// @param port 0 takes any free one. @throws LineError if the port is taken.
  explicit TcpListener(std::uint16_t port, const std::string& address = "127.0.0.1");
  std::uint16_t port() const { return port_; }
  int descriptor() const { return socket_.descriptor(); }
  /// The next client, if one is waiting.
  std::optional<Line> accept();

 private:
  Line socket_;
  std::uint16_t port_;
};

}  // namespace turntable
