#include "drivers/sim/serve.h"

#include <fmt/format.h>

#include <memory>
#include <ostream>
#include <set>
#include <system_error>

#include "protocols/serial.h"
#include "src/core/errors.h"

namespace turntable::sim {
namespace fs = std::filesystem;

void link_pty(const std::string& pty, const fs::path& link) {
  std::error_code error;
  if (fs::is_symlink(link)) fs::remove(link, error);
  fs::create_symlink(pty, link, error);
  if (error)
    throw LineError(
        fmt::format("{}: cannot be linked to {}: {}", link.string(), pty, error.message()));
}

std::string plug_into_pty(ControllerSimulator& simulator, const fs::path& link) {
  Pty pty = make_pty();
  if (!link.empty()) link_pty(pty.path, link);
  simulator.plug(std::move(pty.master));
  return pty.path;
}

void TcpSocket::act(Time now) {
  // A client that has just left makes room for the one that comes: both are seen in one poll.
  if (plugged_()) device_->act(now);
  while (auto client = listener_.accept())
    if (!plugged_()) plug_(std::move(*client));
}

void serve_controllers(SystemClock& clock, const std::vector<ServedController>& controllers,
                       std::ostream& out, const std::vector<Actor*>& others) {
  std::vector<std::unique_ptr<TcpSocket>> sockets;
  std::vector<Actor*> actors = others;
  // A link to a pty that is gone would mislead the next reader.
  struct Links {
    std::vector<std::pair<fs::path, fs::path>> paths;
    ~Links() {
      std::error_code ignored;
      for (const auto& [path, target] : paths)
        if (fs::read_symlink(path, ignored) == target) fs::remove(path, ignored);
    }
  } links;
  std::vector<std::unique_ptr<Bus>> buses;
  const auto listen = [&](auto& device, std::uint16_t port) {
    sockets.push_back(std::make_unique<TcpSocket>(device, port));
    actors.push_back(sockets.back().get());
    return fmt::format("127.0.0.1:{}", sockets.back()->port());
  };
  std::set<std::string> shared;
  for (const ServedController& served : controllers) {
    actors.push_back(served.simulator);
    if (!served.line.empty() && shared.contains(served.line)) continue;
    std::vector<const ServedController*> group;
    std::vector<ControllerSimulator*> simulators;
    for (const ServedController& other : controllers)
      if (&other == &served || (!served.line.empty() && other.line == served.line)) {
        group.push_back(&other);
        simulators.push_back(other.simulator);
      }
    shared.insert(served.line);
    std::string where;
    if (group.size() == 1 && served.tcp_port) {
      where = listen(*served.simulator, *served.tcp_port);
    } else if (group.size() == 1) {
      where = plug_into_pty(*served.simulator);
    } else {
      buses.push_back(std::make_unique<Bus>(simulators, served.gateway));
      if (served.tcp_port) {
        where = listen(*buses.back(), *served.tcp_port);
      } else {
        Pty pty = make_pty();
        where = pty.path;
        buses.back()->plug(std::move(pty.master));
      }
      actors.push_back(buses.back().get());
    }
    for (const ServedController* one : group) {
      if (!one->tcp_port && !one->link.empty()) {
        link_pty(where, one->link);
        links.paths.emplace_back(one->link, where);
      }
      out << fmt::format("{} {}\n", one->name, where);
    }
  }
  out.flush();
  serve(clock, actors);
}

}  // namespace turntable::sim
