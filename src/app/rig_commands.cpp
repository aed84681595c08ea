// The rig by hand: who is there, where everything stands, home, move, stop; and devices that are
// simulated for others.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <map>

#include "drivers/catalog.h"
#include "protocols/serial.h"
#include "protocols/tcp.h"
#include "src/app/commands.h"
#include "src/app/open_rig.h"
#include "src/app/progress.h"
#include "src/app/rig_lock.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::seconds kStopTimeout{20};

AxisId axis_argument(const std::string& name) {
  for (const AxisId id : kAllAxes)
    if (axis_name(id) == name) return id;
  throw ConfigError("axis", "",
                    fmt::format("found \"{}\", allowed: stage, yaw, roll, pitch.", name));
}

double number_argument(const std::string& axis, const std::string& text) {
  double value = 0;
  const char* begin = text.data() + (text.starts_with('+') && !text.starts_with("+-") ? 1 : 0);
  const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    throw ConfigError(axis, "",
                      fmt::format("found \"{}\", allowed: a number in {}, for example 12.5 or -3.",
                                  text, axis_unit(axis_argument(axis))));
  return value;
}

/// "10.0.0.7:4001"
std::pair<std::string, std::uint16_t> host_argument(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  int port = 0;
  if (colon != std::string::npos && colon > 0) {
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data() + colon + 1, end, port);
    if (error == std::errc() && stop == end && port >= 1 && port <= 65535)
      return {text.substr(0, colon), static_cast<std::uint16_t>(port)};
  }
  throw ConfigError("--tcp", "",
                    fmt::format("found \"{}\", allowed: host:port, port 1 to 65535.", text));
}

/// A relative move that would be rounded to nothing. Said before anything is opened.
void require_a_move(const AxisConfig& axis, double by) {
  if (by == 0.0 || std::abs(by) >= 0.5 * axis.least_move()) return;
  throw ConfigError(
      std::string(axis_name(axis.id)), "",
      fmt::format(
          "found {:g} {} --relative, allowed: at least half of {:g} {}, the least step of this "
          "axis ({}). Nothing would move, however often it is said. Ask for a whole number of "
          "steps.",
          by, axis.unit(), axis.least_move(), axis.unit(),
          axis.sent_step > axis.per_step() ? "what its controller can be sent to"
                                           : "a pulse of its motor"));
}

/// Whatever ends `work`, the axes are stopped before the rig is let go.
template <class Work>
void moving(const Rig& rig, Work&& work) {
  try {
    throw_if_stopping_now();
    work();
  } catch (const std::exception& cause) {
    const InterruptShield shield;
    try {
      rig.stop_all();
    } catch (const Error& e) {
      throw NotStopped(fmt::format(
          "{}; stopping the axes failed: {}. They may still be moving: USE THE EMERGENCY STOP.",
          cause.what(), e.what()));
    }
    throw;
  }
}

void home(const Rig& rig, const std::vector<AxisId>& ids) {
  ProgressLine line("homing");
  for (std::size_t i = 0; i < ids.size(); ++i) {
    line.update(i, ids.size(), axis_name(ids[i]));
    throw_if_stopping_now();
    with_axis(rig, ids[i], [](auto& axis) { axis.home(); });
  }
}

void print_position(const Rig& rig, AxisId id) {
  with_axis(rig, id, [&](auto& axis) {
    const auto position = axis.position();
    fmt::print("{:<6} {:12.5f} {}\n", axis_name(id), position.value, position.unit());
  });
}

}  // namespace

int devices_command(const DevicesArguments& a) {
  stop_at_first_interrupt();
  std::vector<std::pair<std::string, std::uint16_t>> servers;
  for (const std::string& host : a.hosts) servers.push_back(host_argument(host));
  std::vector<SerialPort> ports = list_serial_ports();
  for (const std::string& path : a.ports) ports.push_back({path, "as asked", "", ""});
  if (ports.empty()) fmt::print("no serial ports\n");
  SystemClock clock;
  const auto asked = [&](const std::string& line, const std::string& what, auto&& open) {
    std::string who;
    if (const auto holder = line_holder(line))
      who = "in use by " + holder->who;
    else if (!a.listed_only)
      try {
        const RigLock lock(line, "devices");
        who = identify(clock, open);
      } catch (const DeviceError& e) {
        who = e.what();
      }
    fmt::print("{:<20} {}{}{}\n", line, what, who.empty() ? "" : ": ", who);
    std::fflush(stdout);
  };
  for (const SerialPort& port : ports)
    asked(port.path,
          port.description + (port.usb_id.empty() ? "" : " (" + port.usb_id + ")") +
              (port.by_id.empty() ? "" : ", always " + port.by_id),
          [&](const ControllerModel& model) { return open_serial(port.path, model.default_baud); });
  for (const auto& [host, port] : servers)
    asked(fmt::format("{}:{}", host, port), "TCP",
          [&, host = host, port = port](const ControllerModel&) {
            return open_tcp(host, port, std::chrono::seconds{2});
          });
  bool cameras = false;
  for (const CameraModel& model : camera_models()) {
    if (model.find == nullptr) continue;
    for (const std::string& camera : model.find()) {
      fmt::print("{} camera: {}\n", model.model, camera);
      cameras = true;
    }
  }
  if (!cameras) fmt::print("no cameras\n");
  return kDone;
}

/// What a person has to look at before the rig is believed.
void print_unconfirmed(const RigFile& file) {
  std::vector<std::string> told;
  for (const ControllerConfig& controller : file.controllers) {
    const auto unconfirmed = unconfirmed_of(controller);
    const std::string what =
        controller.description.empty()
            ? controller.model
            : fmt::format("{} {}", controller.model, controller.description);
    if (unconfirmed.empty() || std::ranges::find(told, what) != told.end()) continue;
    told.push_back(what);
    fmt::print(
        "What this program assumes of a {} and no manual, other program or recording confirms; "
        "check it in the first steps on a new rig (scenarios/rigs/README.md):\n",
        what);
    for (const std::string& sentence : unconfirmed) fmt::print("  - {}\n", sentence);
  }
}

int status_command(const HandArguments& a) {
  stop_at_first_interrupt();
  const RigFile file = load_rig(a.rig);
  const std::vector<LineHolder> holders = line_holders(file);
  for (const LineHolder& holder : holders)
    fmt::print("{} is in use by {}\n", holder.line, holder.who);
  if (!holders.empty()) return kDone;  // it would be in the way
  const RigLock lock(file, "status");
  std::vector<std::string> differences;
  const Rig rig = open_axes(file, {false, false, a.wire_log, a.speed}, &differences);
  for (const std::string& identity : rig.identities) fmt::print("{}\n", identity);
  for (const std::string& difference : differences)
    fmt::print("differs from {}: {}\n", file.file, difference);
  for (const AxisId id : kAllAxes)
    with_axis(rig, id, [&](auto& axis) {
      const auto position = axis.position();
      const std::string condition = axis.condition();
      fmt::print("{:<6} {:12.5f} {}  limits [{:g}, {:g}]{}{}\n", axis_name(id), position.value,
                 position.unit(), axis.limits().lower.value, axis.limits().upper.value,
                 condition.empty() ? "" : "  ", condition);
    });
  fmt::print("Positions are pulse counters; they mean something after homing only.\n");
  print_unconfirmed(file);
  return differences.empty() ? kDone : kDeviceTrouble;
}

int home_command(const HomeArguments& a) {
  stop_at_first_interrupt();
  std::vector<AxisId> ids;
  for (const std::string& name : a.axes) ids.push_back(axis_argument(name));
  if (ids.empty()) ids.assign(kAllAxes.begin(), kAllAxes.end());
  const RigFile file = load_rig(a.rig);
  const RigLock lock(file, "home");
  const Rig rig = open_axes(file, {a.configure, false, a.wire_log, a.speed});
  moving(rig, [&] { home(rig, ids); });
  for (const AxisId id : ids) print_position(rig, id);
  return kDone;
}

int move_command(const MoveArguments& a) {
  stop_at_first_interrupt();
  if (!a.home && !a.homed)
    throw ConfigError(
        "move", "",
        "found neither --home nor --homed. Positions are pulse counters, and this program cannot "
        "know whether they still count from the home switch: give --home to home the axes first, "
        "or --homed if they were homed since the controllers were switched on and nothing went "
        "wrong since.");
  if (a.targets.size() % 2 != 0)
    throw ConfigError("move", "",
                      fmt::format("found {} words, allowed: pairs of an axis and a value, for "
                                  "example \"yaw 10 pitch -5\".",
                                  a.targets.size()));
  std::vector<std::pair<AxisId, double>> targets;
  for (std::size_t i = 0; i < a.targets.size(); i += 2) {
    const AxisId id = axis_argument(a.targets[i]);
    if (std::ranges::find(targets, id, &std::pair<AxisId, double>::first) != targets.end())
      throw ConfigError(a.targets[i], "", "is given twice. State each axis once.");
    targets.emplace_back(id, number_argument(a.targets[i], a.targets[i + 1]));
  }
  const RigFile file = load_rig(a.rig);
  if (a.relative)
    for (const auto& [id, value] : targets) require_a_move(file.axis(id), value);
  const RigLock lock(file, "move");
  const Rig rig = open_axes(file, {false, false, a.wire_log, a.speed});
  if (!a.relative || a.home)  // before anything moves; after homing an axis stands at 0
    for (const auto& [id, value] : targets)
      with_axis(rig, id, [value = value](auto& axis) { axis.check({value}); });
  moving(rig, [&] {
    if (a.home) {
      std::vector<AxisId> ids;
      for (const auto& [id, value] : targets) ids.push_back(id);
      home(rig, ids);
    } else {
      std::vector<AxisId> ids;
      for (const auto& [id, value] : targets) ids.push_back(id);
      rig.trust_references(ids);
    }
    if (a.relative)
      for (auto& [id, value] : targets)
        with_axis(rig, id, [&value = value](auto& axis) {
          value += axis.position().value;
          axis.check({value});
        });
    for (const auto& [id, value] : targets)
      with_axis(rig, id, [value = value](auto& axis) { axis.start({value}); });
    ProgressLine line("moving");
    std::vector<bool> arrived(targets.size(), false);
    while (std::ranges::find(arrived, false) != arrived.end()) {
      for (std::size_t i = 0; i < targets.size(); ++i)
        if (!arrived[i])
          arrived[i] = with_axis(rig, targets[i].first, [](auto& axis) { return axis.advance(); });
      throw_if_stopping_now();
      line.update(static_cast<std::size_t>(std::ranges::count(arrived, true)), arrived.size(),
                  "axes");
    }
  });
  bool missed = false;
  for (const auto& [id, value] : targets)
    with_axis(rig, id, [&, id = id](auto& axis) {
      const auto arrival = axis.arrival();
      const AxisConfig& config = file.axis(id);
      const double off =
          std::abs(config.on_grid(arrival.requested.value) - arrival.requested.value);
      fmt::print("{:<6} {:12.5f} {}, asked for {:g}{}{}\n", axis_name(id), arrival.position.value,
                 arrival.position.unit(), arrival.requested.value,
                 off > 0.02 * config.per_step()
                     ? fmt::format(" (the nearest of places {:g} {} apart)", config.least_move(),
                                   config.unit())
                     : "",
                 arrival.missed ? fmt::format(": missed after {} retries", arrival.retries) : "");
      missed = missed || arrival.missed;
    });
  return missed ? kFailedPoses : kDone;
}

int stop_command(const HandArguments& a) {
  stop_at_first_interrupt();
  RigFile file = load_rig(a.rig);
  for (const ControllerConfig& controller : file.controllers)
    if (controller.line.kind == LineConfig::Kind::kSimulated)
      throw ConfigError(file.file, "/controllers/" + controller.name + "/line",
                        "is simulated inside each program: there is nothing that another program "
                        "could stop. End that program.");
  // Controller by controller: that one cannot be reached must not keep the others from stopping.
  std::string trouble;
  const auto tried = [&](const std::string& what, auto&& action) {
    try {
      action();
    } catch (const Error& e) {
      trouble += fmt::format("{}{}: {}", trouble.empty() ? "" : "\n", what, e.what());
    }
  };
  std::vector<StopOrder> orders;  // all are given before one is waited for
  for (const ControllerConfig& controller : file.controllers) orders.emplace_back(controller.line);
  for (std::size_t i = 0; i < orders.size(); ++i)
    tried(file.controllers[i].name, [&] {
      if (const auto holder = orders[i].wait(kStopTimeout))
        fmt::print("{}: {} was told to stop and has let go\n", holder->line, holder->who);
    });
  const std::vector<ControllerConfig> all = file.controllers;
  const std::map<AxisId, AxisConfig> axes = file.axes;
  for (const ControllerConfig& controller : all)
    tried(controller.name, [&] {
      // Whoever had it says that it stopped; the controller is told all the same, before anything else.
      file.controllers = {controller};
      file.axes.clear();
      for (const auto& [id, axis] : axes)
        if (axis.controller == controller.name) file.axes[id] = axis;
      const RigLock lock(file, "stop");
      const Rig rig = open_axes(file, {false, false, a.wire_log, a.speed, false});
      rig.stop_all();
      for (const auto& [id, axis] : file.axes) print_position(rig, id);
    });
  if (!trouble.empty())
    throw NotStopped(
        fmt::format("{}\nNot everything is known to stand: USE THE EMERGENCY STOP.", trouble));
  fmt::print("all axes stand\n");
  return kDone;
}

int simulate_command(const SimulateArguments& a) {
  const RigFile rig = load_rig(a.rig);
  if (!a.links.empty()) {
    require_writable(a.links, "the links", "--links");
    make_folder(a.links);
  }
  fmt::print("Simulated devices of {}{}; Ctrl-C ends.\n", rig.file,
             a.speed == 1.0 ? "" : fmt::format(", {:g} times as fast as real ones", a.speed));
  std::fflush(stdout);
  simulate_rig(rig, {a.links, a.faults, a.speed});
  return kDone;
}

}  // namespace turntable
