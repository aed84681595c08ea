#include "src/app/open_rig.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <iostream>

#include "drivers/catalog.h"
#include "drivers/sim/camera.h"
#include "drivers/sim/catalog.h"
#include "drivers/sim/serve.h"
#include "src/core/errors.h"
#include "src/record/image_import.h"

namespace turntable {
namespace {

std::vector<AxisConfig> axes_on(const RigFile& file, const std::string& controller) {
  std::vector<AxisConfig> axes;
  for (const auto& [id, axis] : file.axes)
    if (axis.controller == controller) axes.push_back(axis);
  return axes;
}

std::unique_ptr<sim::ControllerSimulator> simulator_for(const RigFile& file,
                                                        const ControllerConfig& controller) {
  return sim::simulate_controller(controller.model, {axes_on(file, controller.name),
                                                     file.simulation->axes, file.simulation->seed});
}

/// Writes every byte as text: "12.345678 mc1 > Position? X\r".
class WireLogFile {
 public:
  explicit WireLogFile(const std::filesystem::path& file) : out_(file, std::ios::app) {
    if (!out_) throw RecordError(file.string() + ": the wire log cannot be written.");
  }
  void write(const std::string& line, Direction direction, std::string_view bytes, Time time) {
    std::string shown;
    for (const char c : bytes) {
      if (c == '\r')
        shown += "\\r";
      else if (c == '\n')
        shown += "\\n";
      else if (c >= 0x20 && c < 0x7f)
        shown += c;
      else
        shown += fmt::format("\\x{:02x}", static_cast<unsigned char>(c));
    }
    const std::lock_guard lock(mutex_);
    out_ << fmt::format("{:.6f} {} {} {}\n", seconds(time), line,
                        direction == Direction::kSent ? '>' : '<', shown)
         << std::flush;
  }

 private:
  std::mutex mutex_;
  std::ofstream out_;
};

void ask_to_mount(Payload payload) {
  const std::string what =
      payload == Payload::kCirclePattern ? "the circle pattern" : "the LED target (switched on)";
  if (::isatty(STDIN_FILENO) == 0)
    throw DeviceError(fmt::format(
        "{} has to be mounted on the table now, and nobody is there to be asked (no "
        "terminal). Run from a terminal, or confirm with --assume-mounted that it stays "
        "as it is.",
        what));
  fmt::print(stderr, "\nMount {} on the table, then press Enter (Ctrl-C ends the run): ", what);
  std::string line;
  if (!std::getline(std::cin, line))
    throw Interrupted("interrupted while the payload was being changed");
}

Rig open_devices(const RigFile& file, const OpenRigOptions& options) {
  const auto simulated_line = [](const ControllerConfig& c) {
    return c.line.kind == LineConfig::Kind::kSimulated;
  };
  const bool all_simulated = std::ranges::all_of(file.controllers, simulated_line);
  if (!all_simulated && std::ranges::any_of(file.controllers, simulated_line))
    throw ConfigError(
        file.file, "/controllers",
        "mixes simulated and real lines, which keep different time. Serve the simulated ones with "
        "\"turntable simulate\" and name their ports here.");
  Rig rig;
  rig.simulated = file.simulated();
  ManualClock* manual = nullptr;
  if (all_simulated) {
    auto clock = std::make_shared<ManualClock>();
    rig.clock = manual = clock.get();
    rig.owned.push_back(clock);
  } else {
    auto clock = std::make_shared<SystemClock>();
    rig.clock = clock.get();
    rig.owned.push_back(clock);
  }

  std::shared_ptr<WireLogFile> wire_log;
  if (!options.wire_log.empty()) wire_log = std::make_shared<WireLogFile>(options.wire_log);

  std::map<AxisId, const sim::AxisModel*> models;
  std::vector<Controller*> controllers;
  for (const ControllerConfig& config : file.controllers) {
    const std::vector<AxisConfig> axes = axes_on(file, config.name);
    if (axes.empty())
      throw ConfigError(file.file, "/controllers/" + config.name,
                        "turns no axis. Remove it or give it one.");
    std::optional<Line> near_end;
    if (manual != nullptr) {
      std::shared_ptr<sim::ControllerSimulator> simulator = simulator_for(file, config);
      auto [near_side, far_side] = line_pair(config.name);
      near_end.emplace(std::move(near_side));
      simulator->plug(std::move(far_side));
      for (const AxisConfig& axis : axes) models[axis.id] = &simulator->axis(axis.id);
      manual->attach(*simulator);
      rig.owned.push_back(simulator);
    } else {
      near_end.emplace(open_line(config));
    }
    if (wire_log)
      near_end->set_log(
          [wire_log, name = config.name](Direction d, std::string_view bytes, Time t) {
            wire_log->write(name, d, bytes, t);
          });
    std::shared_ptr<Controller> controller =
        open_controller({config, axes, std::move(*near_end), rig.clock});
    rig.owned.push_back(controller);
    controllers.push_back(controller.get());
    for (const AxisConfig& axis : axes) {
      if (axis.id == AxisId::kStage) rig.stage = controller->linear_axis(axis.id);
      if (axis.id == AxisId::kYaw) rig.yaw = controller->rotary_axis(axis.id);
      if (axis.id == AxisId::kRoll) rig.roll = controller->rotary_axis(axis.id);
      if (axis.id == AxisId::kPitch) rig.pitch = controller->rotary_axis(axis.id);
    }
  }

  std::string differences;
  for (Controller* controller : controllers) {
    const std::vector<std::string> found = controller->connect();
    if (options.configure)
      controller->configure();
    else
      for (const std::string& difference : found) differences += "\n  " + difference;
    rig.identities.push_back(controller->identity());
  }
  if (!differences.empty())
    throw DeviceError(fmt::format(
        "the controllers are not set up as {} says; nothing may move:{}\nCorrect the rig "
        "file, or write its set-up into the controllers with --configure.",
        file.file, differences));

  rig.stop_all = [controllers] {
    std::exception_ptr first;
    for (Controller* controller : controllers) {
      try {
        controller->stop_all();
      } catch (...) {
        if (!first) first = std::current_exception();
      }
    }
    if (first) std::rethrow_exception(first);
  };

  if (file.camera.model == "simulated") {
    // A world on controllers that live in another process knows only what they report.
    const auto where = [models, clock = rig.clock, stage = rig.stage, yaw = rig.yaw,
                        roll = rig.roll, pitch = rig.pitch](AxisId id) {
      if (const auto it = models.find(id); it != models.end())
        return it->second->true_position(clock->now());
      if (id == AxisId::kStage) return stage->position().value;
      return (id == AxisId::kYaw ? yaw : id == AxisId::kRoll ? roll : pitch)->position().value;
    };
    auto world = std::make_shared<sim::World>(file, where);
    auto camera =
        std::make_shared<sim::SimulatedCamera>(*rig.clock, *world, file.camera.frame_timeout_s);
    rig.camera = camera.get();
    rig.mount = [world](Payload payload) { world->mount(payload); };
    rig.owned.push_back(world);
    rig.owned.push_back(camera);
  } else {
    const std::shared_ptr<Camera> camera =
        open_camera({file.camera,
                     rig.clock,
                     [](const std::filesystem::path& image) { return import_image(image); },
                     {}});
    rig.camera = camera.get();
    rig.owned.push_back(camera);
    rig.mount =
        options.assume_mounted ? std::function<void(Payload)>([](Payload) {}) : ask_to_mount;
  }
  rig.identities.push_back(rig.camera->identity());
  return rig;
}

/// The drivers do not know the rig file's name.
template <class Work>
auto naming_the_file(const RigFile& file, Work&& work) {
  try {
    return work();
  } catch (const ConfigError& e) {
    if (e.file() != "rig") throw;
    throw ConfigError(file.file, e.pointer(), e.message());
  }
}

void serve_devices(const RigFile& file, const std::filesystem::path& links) {
  if (!file.simulation)
    throw ConfigError(file.file, "/simulation",
                      "is missing: it says what is true of the simulated rig.");
  std::vector<std::unique_ptr<sim::ControllerSimulator>> simulators;
  std::vector<sim::ServedController> served;
  for (const ControllerConfig& config : file.controllers) {
    simulators.push_back(simulator_for(file, config));
    sim::ServedController s;
    s.name = config.name;
    s.simulator = simulators.back().get();
    if (config.line.kind == LineConfig::Kind::kTcp) s.tcp_port = config.line.tcp_port;
    if (!links.empty()) s.link = links / config.name;
    served.push_back(s);
  }
  SystemClock clock;
  sim::serve_controllers(clock, served, std::cout);
}

}  // namespace

Rig open_rig(const RigFile& file, const OpenRigOptions& options) {
  return naming_the_file(file, [&] { return open_devices(file, options); });
}

void simulate_rig(const RigFile& file, const std::filesystem::path& links) {
  naming_the_file(file, [&] { serve_devices(file, links); });
}

}  // namespace turntable
