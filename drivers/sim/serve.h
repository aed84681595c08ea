// Simulators for people: in real time, on ptys and TCP ports.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

#include "drivers/sim/bus.h"
#include "drivers/sim/controller_simulator.h"
#include "protocols/tcp.h"

namespace turntable::sim {

/// Links a pty to a name that stays. @param link replaced if it is a symbolic link already.
/// @throws LineError.
void link_pty(const std::string& pty, const std::filesystem::path& link);

/// Puts `simulator` at the far end of a new pty. @param link if not empty, a symbolic link to it.
/// @return the path to open as a serial port. @throws LineError.
std::string plug_into_pty(ControllerSimulator& simulator, const std::filesystem::path& link = {});

/// Listens, and plugs one client at a time into a simulator or a bus; a second one is turned away. Both
/// must outlive `serve`.
class TcpSocket final : public Actor {
 public:
  /// @param device a `ControllerSimulator` or a `Bus`. @param port 0 = any free one. @throws LineError.
  template <class Device>
  TcpSocket(Device& device, std::uint16_t port, const std::string& address = "127.0.0.1")
      : device_(&device),
        plugged_([&device] { return device.plugged(); }),
        plug_([&device](Line client) { device.plug(std::move(client)); }),
        listener_(port, address) {}
  std::uint16_t port() const { return listener_.port(); }
  int descriptor() const override { return listener_.descriptor(); }
  std::optional<Time> next_due() const override { return std::nullopt; }
  void act(Time now) override;

 private:
  Actor* device_;
  std::function<bool()> plugged_;
  std::function<void(Line)> plug_;
  TcpListener listener_;
};

/// One simulated controller and where it is to be found.
struct ServedController {
  std::string name;
  ControllerSimulator* simulator = nullptr;
  std::string line;  ///< those that name the same one share it; empty = one of its own
  std::optional<std::uint16_t> tcp_port;  ///< nothing = on a pty
  bool gateway = false;                   ///< Modbus TCP
  std::filesystem::path link;             ///< of the pty
};

/// Serves until an interrupt, after printing one line per controller: "NAME /dev/pts/N" or "NAME
/// host:port".
/// @param others further actors to run beside them. @throws LineError.
void serve_controllers(SystemClock& clock, const std::vector<ServedController>& controllers,
                       std::ostream& out, const std::vector<Actor*>& others = {});

}  // namespace turntable::sim
