#include "drivers/sim/serve.h"

#include <fmt/format.h>

#include <memory>
#include <ostream>
#include <system_error>

#include "protocols/serial.h"
#include "src/core/errors.h"

namespace turntable::sim {
namespace fs = std::filesystem;

std::string plug_into_pty(ControllerSimulator& simulator, const fs::path& link) {
  Pty pty = make_pty();
  if (!link.empty()) {
    std::error_code error;
    if (fs::is_symlink(link)) fs::remove(link, error);
    fs::create_symlink(pty.path, link, error);
    if (error)
      throw LineError(
          fmt::format("{}: cannot be linked to {}: {}", link.string(), pty.path, error.message()));
  }
  simulator.plug(std::move(pty.master));
  return pty.path;
}

TcpSocket::TcpSocket(ControllerSimulator& simulator, std::uint16_t port, const std::string& address)
    : simulator_(&simulator), listener_(port, address) {}

void TcpSocket::act(Time now) {
  // A client that has just left makes room for the one that comes: both are seen in one poll.
  if (simulator_->plugged()) simulator_->act(now);
  while (auto client = listener_.accept())
    if (!simulator_->plugged()) simulator_->plug(std::move(*client));
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
  for (const ServedController& served : controllers) {
    if (served.tcp_port) {
      sockets.push_back(std::make_unique<TcpSocket>(*served.simulator, *served.tcp_port));
      actors.push_back(sockets.back().get());
      out << fmt::format("{} 127.0.0.1:{}\n", served.name, sockets.back()->port());
    } else {
      const std::string path = plug_into_pty(*served.simulator, served.link);
      if (!served.link.empty()) links.paths.emplace_back(served.link, path);
      out << fmt::format("{} {}\n", served.name, path);
    }
    actors.push_back(served.simulator);
  }
  out.flush();
  serve(clock, actors);
}

}  // namespace turntable::sim
