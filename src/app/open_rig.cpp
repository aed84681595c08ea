#include "src/app/open_rig.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <charconv>
#include <csignal>
#include <cstdio>
#include <fstream>
#include <future>
#include <iostream>

#include "drivers/catalog.h"
#include "drivers/sim/camera.h"
#include "drivers/sim/catalog.h"
#include "drivers/sim/fault_file.h"
#include "drivers/sim/gige_peer.h"
#include "drivers/sim/serve.h"
#include "drivers/telemetry.h"
#include "protocols/serial.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/image_import.h"

namespace turntable {
namespace {

std::vector<AxisConfig> axes_on(const RigFile& file, const std::string& controller) {
  std::vector<AxisConfig> axes;
  for (const auto& [id, axis] : file.axes)
    if (axis.controller == controller) axes.push_back(axis);
  return axes;
}

/// Where a simulated axis really is, as the rig counts it.
double true_position(const RigFile& file, const sim::AxisModel& model, AxisId id, Time now) {
  return (file.axis(id).reversed ? -1.0 : 1.0) * model.true_position(now);
}

std::unique_ptr<sim::ControllerSimulator> simulator_for(const RigFile& file,
                                                        const ControllerConfig& controller) {
  std::vector<AxisConfig> axes = axes_on(file, controller.name);
  for (AxisConfig& axis : axes) axis = controller_side(axis);
  return sim::simulate_controller(controller.model, {std::move(axes), file.simulation->axes,
                                                     file.simulation->seed, controller});
}

/// The names of the controllers on a controller's line: "mc1", or "mc1+mc2" where they share it.
std::string talkers_on(const RigFile& file, const ControllerConfig& controller) {
  const std::string line = line_id(controller.line);
  std::string names;
  for (const ControllerConfig& other : file.controllers)
    if (other.name == controller.name || (!line.empty() && line_id(other.line) == line))
      names += (names.empty() ? "" : "+") + other.name;
  return names;
}

/// Writes every byte: "12.345678 mc1 > Position? X\r", or "12.345678 mc2 > 01 04 75 3b 00 0a".
class WireLogFile {
 public:
  explicit WireLogFile(const std::filesystem::path& file) : file_(file), out_(file, std::ios::app) {
    if (!out_) throw RecordError(file.string() + ": the wire log cannot be written.");
  }
  /// @param as_text false: binary, as hexadecimal bytes.
  void write(const std::string& line, bool as_text, Direction direction, std::string_view bytes,
             Time time) {
    std::string shown;
    for (const char c : bytes) {
      if (!as_text)
        shown += fmt::format("{}{:02x}", shown.empty() ? "" : " ", static_cast<unsigned char>(c));
      else if (c == '\r')
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
    // A run is worth more than its wire log.
    if (!out_ && !std::exchange(told_, true))
      spdlog::warn("{}: the wire log cannot be written any more; the run goes on", file_.string());
  }

 private:
  std::mutex mutex_;
  std::filesystem::path file_;
  std::ofstream out_;
  bool told_ = false;
};

void ask_to_mount(Payload payload, const std::vector<Controller*>& controllers) {
  const std::string what =
      payload == Payload::kCirclePattern ? "the circle pattern" : "the LED target (switched on)";
  if (::isatty(STDIN_FILENO) == 0)
    throw DeviceError(fmt::format(
        "{} has to be mounted on the table now, and nobody is there to be asked (no "
        "terminal). Run from a terminal, or confirm with --assume-mounted that it stays "
        "as it is.",
        what));
  ::tcflush(STDIN_FILENO, TCIFLUSH);  // a key pressed earlier confirms nothing
  fmt::print(stderr,
             "\nMount {} on the table, then press Enter (Ctrl-C twice ends the run): ", what);
  // Not blocked in a read: a stop from elsewhere has to come through.
  for (pollfd input{STDIN_FILENO, POLLIN, 0}; ::poll(&input, 1, 50) <= 0;) {
    throw_if_interrupted(kEndedAfterPose);
    throw_if_stopping_now();
    for (Controller* controller : controllers) controller->keep_alive();
  }
  std::string line;
  if (!std::getline(std::cin, line))
    throw Interrupted("interrupted while the payload was being changed");
}

/// The controllers, before there is a camera, and what the simulated ones hide.
struct Axes {
  Rig rig;
  std::vector<Controller*> controllers;  ///< by order of the rig file
  std::map<std::string, sim::ControllerSimulator*> simulators;
  std::map<AxisId, const sim::AxisModel*> models;
};

Axes open_controllers(const RigFile& file, const OpenRigOptions& options,
                      std::vector<std::string>* differences) {
  const auto simulated_line = [](const ControllerConfig& c) {
    return c.line.kind == LineConfig::Kind::kSimulated;
  };
  const bool all_simulated = std::ranges::all_of(file.controllers, simulated_line);
  if (!all_simulated && std::ranges::any_of(file.controllers, simulated_line))
    throw ConfigError(
        file.file, "/controllers",
        "mixes simulated and real lines, which keep different time. Serve the simulated ones with "
        "\"turntable simulate\" and name their ports here.");
  if (options.speed != 1.0 && !file.simulation)
    throw ConfigError(file.file, "/simulation",
                      "is missing, so these are real devices, whose time cannot run faster. Remove "
                      "--speed.");

  Axes axes;
  Rig& rig = axes.rig;
  rig.simulated = file.simulated();
  ManualClock* manual = nullptr;
  if (all_simulated) {
    auto clock = std::make_shared<ManualClock>();
    rig.clock = manual = clock.get();
    rig.owned.push_back(clock);
  } else {
    auto clock = std::make_shared<SystemClock>(options.speed);
    rig.clock = clock.get();
    rig.owned.push_back(clock);
  }

  std::shared_ptr<WireLogFile> wire_log;
  if (!options.wire_log.empty()) wire_log = std::make_shared<WireLogFile>(options.wire_log);

  check_controllers(file);
  std::map<std::string, SharedLine> lines;  // the real ones, by what stands for them
  for (const ControllerConfig& config : file.controllers) {
    const std::vector<AxisConfig> on_it = axes_on(file, config.name);
    if (on_it.empty())
      throw ConfigError(file.file, "/controllers/" + config.name,
                        "turns no axis. Remove it or give it one.");
    WireLog log;
    if (wire_log)
      log = [wire_log, name = talkers_on(file, config), as_text = !speaks_modbus(config)](
                Direction d, std::string_view bytes, Time t) {
        wire_log->write(name, as_text, d, bytes, t);
      };
    const std::string id = line_id(config.line);
    if (manual != nullptr) {
      std::shared_ptr<sim::ControllerSimulator> simulator = simulator_for(file, config);
      auto [near_side, far_side] = line_pair(config.name);
      near_side.set_log(std::move(log));
      lines.emplace(config.name, std::move(near_side));
      simulator->plug(std::move(far_side));
      for (const AxisConfig& axis : on_it) axes.models[axis.id] = &simulator->axis(axis.id);
      axes.simulators[config.name] = simulator.get();
      manual->attach(*simulator);
      rig.owned.push_back(simulator);
    } else if (!lines.contains(id)) {
      lines.emplace(id, open_line(config, log));
    }
    std::shared_ptr<Controller> controller =
        open_controller({config, on_it, lines.at(manual != nullptr ? config.name : id), rig.clock});
    rig.owned.push_back(controller);
    axes.controllers.push_back(controller.get());
    for (const AxisConfig& axis : on_it) {
      if (axis.id == AxisId::kStage) rig.stage = controller->linear_axis(axis.id);
      if (axis.id == AxisId::kYaw) rig.yaw = controller->rotary_axis(axis.id);
      if (axis.id == AxisId::kRoll) rig.roll = controller->rotary_axis(axis.id);
      if (axis.id == AxisId::kPitch) rig.pitch = controller->rotary_axis(axis.id);
    }
  }

  std::vector<std::string> found;
  for (Controller* controller : axes.controllers) {
    if (!options.connect) break;
    const std::vector<std::string> differs = controller->connect();
    if (options.configure)
      controller->configure();
    else
      found.insert(found.end(), differs.begin(), differs.end());
    rig.identities.push_back(controller->identity());
  }
  if (differences != nullptr)
    *differences = found;
  else if (!found.empty())
    throw DeviceError(fmt::format(
        "the controllers are not set up as {} says; nothing may move:\n  {}\nCorrect the rig "
        "file, or write its set-up into the controllers with --configure.",
        file.file, fmt::join(found, "\n  ")));

  // One that does not answer must not keep those on other lines waiting.
  const auto policy = manual != nullptr ? std::launch::deferred : std::launch::async;
  rig.stop_all = [controllers = axes.controllers, policy] {
    Attempts tried;
    for (Controller* controller : controllers) controller->forbid_all();
    for (const auto part : {&Controller::begin_stop_all, &Controller::finish_stop_all}) {
      std::vector<std::future<void>> parts;
      for (Controller* controller : controllers)
        parts.push_back(std::async(policy, [=] { (controller->*part)(); }));
      for (auto& done : parts) tried([&] { done.get(); });
    }
    tried.rethrow();
  };
  rig.keep_alive = [controllers = axes.controllers] {
    for (Controller* controller : controllers) controller->keep_alive();
  };
  rig.trust_references = [controllers = axes.controllers](std::span<const AxisId> ids) {
    for (Controller* controller : controllers)
      for (const AxisId id : ids) controller->trust_reference(id);
  };
  return axes;
}

/// Renders for a camera that is served on loopback; runs on the server's thread.
sim::GigePeer::Expose expose(std::shared_ptr<sim::World> world) {
  auto renderer = std::make_shared<sim::Renderer>(*world);
  return [world = std::move(world), renderer](std::uint64_t exposure) {
    try {
      return renderer->render(exposure);
    } catch (const Error&) {  // an axis that does not say where it is: a dark image
      return Image(world->image_size(), 0);
    }
  };
}

/// Makes the camera that the rig file asks for.
class CameraMaker {
 public:
  CameraMaker(const RigFile& file, const OpenRigOptions& options, Axes& axes)
      : file_(file), options_(options), axes_(axes), rig_(axes.rig) {}

  void make() {
    if (file_.camera.model == "simulated" || file_.camera.simulated)
      make_world();
    else
      rig_.mount = options_.assume_mounted ? std::function<void(Payload)>([](Payload) {})
                                           : [controllers = axes_.controllers](Payload payload) {
                                               ask_to_mount(payload, controllers);
                                             };
    if (file_.camera.model == "simulated")
      keep(make_simulated());
    else
      keep(open_camera(setup()));
    rig_.identities.push_back(rig_.camera->identity());
  }

 private:
  void make_world() {
    // A world on controllers that live in another process knows only what they report.
    const auto where = [file = file_, models = axes_.models, clock = rig_.clock, stage = rig_.stage,
                        yaw = rig_.yaw, roll = rig_.roll, pitch = rig_.pitch](AxisId id) {
      if (const auto it = models.find(id); it != models.end())
        return true_position(file, *it->second, id, clock->now());
      if (stage == nullptr) return 0.0;  // the camera alone
      if (id == AxisId::kStage) return stage->position().value;
      return (id == AxisId::kYaw ? yaw : id == AxisId::kRoll ? roll : pitch)->position().value;
    };
    world_ = std::make_shared<sim::World>(file_, where);
    rig_.mount = [world = world_](Payload payload) { world->mount(payload); };
    rig_.owned.push_back(world_);
  }

  std::unique_ptr<Camera> make_simulated() {
    auto camera =
        std::make_unique<sim::SimulatedCamera>(*rig_.clock, *world_, file_.camera.frame_timeout_s);
    if (file_.camera.trigger.source == TriggerConfig::Source::kLine) {
      camera->wire_input(file_.camera.trigger.rising, fire());
      wire_output([input = camera.get()](bool on) { input->input(on); });
    }
    return camera;
  }

  CameraSetup setup() {
    CameraSetup setup{file_.camera, rig_.clock,
                      [](const std::filesystem::path& image) { return import_image(image); },
                      fire()};
    if (file_.camera.simulated) {
      auto peer = std::make_shared<sim::GigePeer>(expose(world_), file_.camera.image_size);
      setup.config.device = peer->id();
      wire_output([peer = peer.get(), rising = file_.camera.trigger.rising](bool on) {
        if (on == rising) peer->hardware_trigger();
      });
      rig_.owned.push_back(std::move(peer));  // outlives the camera
    }
    return setup;
  }

  /// Pulses what is wired to the camera's input; empty if nothing that this program knows is.
  std::function<void()> fire() const {
    const TriggerConfig& trigger = file_.camera.trigger;
    for (std::size_t i = 0; i < file_.controllers.size(); ++i)
      if (!trigger.output.empty() && file_.controllers[i].name == trigger.controller)
        return [controller = axes_.controllers[i], output = trigger.output] {
          controller->pulse_output(output);
        };
    return {};
  }

  /// Lets the camera of a simulated rig see the edges of the output that is wired to it.
  void wire_output(std::function<void(bool on)> input) const {
    const auto simulator = axes_.simulators.find(file_.camera.trigger.controller);
    if (simulator == axes_.simulators.end()) return;
    simulator->second->on_output([input = std::move(input), wired = file_.camera.trigger.output](
                                     const std::string& name, bool on, Time) {
      if (name == wired) input(on);
    });
  }

  void keep(std::shared_ptr<Camera> camera) {
    rig_.camera = camera.get();
    rig_.owned.push_back(std::move(camera));
  }

  const RigFile& file_;
  const OpenRigOptions& options_;
  Axes& axes_;
  Rig& rig_;
  std::shared_ptr<sim::World> world_;
};

Rig open_only_camera(const RigFile& file) {
  if (!file.camera.trigger.output.empty())
    throw ConfigError(file.file, "/camera/trigger/output",
                      "fires the camera by a controller, which is not opened here. Let the "
                      "software, or something outside this rig, trigger it.");
  Axes axes;
  axes.rig.simulated = file.simulated();
  std::shared_ptr<Clock> clock;
  if (file.camera.model == "simulated")
    clock = std::make_shared<ManualClock>();
  else
    clock = std::make_shared<SystemClock>();
  axes.rig.clock = clock.get();
  axes.rig.owned.push_back(std::move(clock));
  const OpenRigOptions options{false, true, {}};
  CameraMaker(file, options, axes).make();
  axes.rig.mount(Payload::kLedTarget);
  return std::move(axes.rig);
}

Rig open_devices(const RigFile& file, const OpenRigOptions& options) {
  Axes axes = open_controllers(file, options, nullptr);
  CameraMaker(file, options, axes).make();
  axes.rig.channels =
      open_channels(file.telemetry, *axes.rig.clock, [clock = axes.rig.clock](const auto& channel) {
        return sim::simulated_reading(channel, clock->now());
      });
  return std::move(axes.rig);
}

/// Where the served axes really are, for a camera that looks from another thread.
class Whereabouts final : public Actor {
 public:
  Whereabouts(const RigFile& file, std::map<AxisId, const sim::AxisModel*> models)
      : file_(file), models_(std::move(models)) {}
  int descriptor() const override { return -1; }
  std::optional<Time> next_due() const override { return due_; }
  void act(Time now) override {
    for (const auto& [id, model] : models_) at(id) = true_position(file_, *model, id, now);
    due_ = now + std::chrono::milliseconds{5};
  }
  std::atomic<double>& at(AxisId id) { return places_.at(static_cast<std::size_t>(id)); }

 private:
  const RigFile& file_;
  std::map<AxisId, const sim::AxisModel*> models_;
  std::array<std::atomic<double>, kAllAxes.size()> places_{};
  Time due_{0};
};

/// A person at the simulated rig: "mount led_target" on standard input.
class Assistant final : public Actor {
 public:
  explicit Assistant(sim::World& world) : world_(world) {
    std::signal(SIGTTIN, SIG_IGN);  // in the background of a terminal there is nobody to be heard
  }
  int descriptor() const override { return gone_ ? -1 : STDIN_FILENO; }
  std::optional<Time> next_due() const override { return std::nullopt; }
  void act(Time) override {
    std::array<char, 256> buffer;
    const ssize_t n = ::read(STDIN_FILENO, buffer.data(), buffer.size());
    if (n <= 0) {
      gone_ = true;
      return;
    }
    heard_.append(buffer.data(), static_cast<std::size_t>(n));
    for (std::size_t end; (end = heard_.find('\n')) != heard_.npos; heard_.erase(0, end + 1)) {
      const std::string line = heard_.substr(0, end);
      const auto payload = std::ranges::find_if(
          kPayloads, [&](Payload p) { return line == fmt::format("mount {}", payload_name(p)); });
      if (payload == kPayloads.end()) {
        fmt::print("found \"{}\", allowed: mount circle_pattern, mount led_target\n", line);
      } else {
        world_.mount(*payload);
        fmt::print("mounted {}\n", payload_name(*payload));
      }
      std::fflush(stdout);
    }
  }

 private:
  static constexpr std::array kPayloads{Payload::kCirclePattern, Payload::kLedTarget};
  sim::World& world_;
  std::string heard_;
  bool gone_ = false;
};

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

void serve_devices(const RigFile& file, const ServeOptions& options) {
  if (!file.simulation)
    throw ConfigError(file.file, "/simulation",
                      "is missing: it says what is true of the simulated rig.");
  std::vector<sim::NamedFault> faults;
  if (!options.faults.empty()) faults = sim::load_fault_file(options.faults);
  check_controllers(file);
  std::vector<std::unique_ptr<sim::ControllerSimulator>> simulators;
  std::vector<sim::ServedController> served;
  for (const ControllerConfig& config : file.controllers) {
    simulators.push_back(simulator_for(file, config));
    sim::ServedController s;
    s.name = config.name;
    s.simulator = simulators.back().get();
    if (config.line.kind == LineConfig::Kind::kTcp ||
        config.line.kind == LineConfig::Kind::kModbusTcp)
      s.tcp_port = config.line.tcp_port;
    s.gateway = config.line.kind == LineConfig::Kind::kModbusTcp;
    s.line = line_id(config.line);
    if (!options.links.empty()) s.link = options.links / config.name;
    served.push_back(s);
  }
  for (const sim::NamedFault& named : faults) {
    const auto it = std::ranges::find(served, named.controller, &sim::ServedController::name);
    if (it == served.end())
      throw ConfigError(
          options.faults.string(), named.place,
          fmt::format("found \"{}\", allowed: a controller of {}.", named.controller, file.file));
    it->simulator->add_fault(named.fault);
  }
  SystemClock clock(options.speed);
  if (file.camera.model != "gige") return sim::serve_controllers(clock, served, std::cout);

  std::map<AxisId, const sim::AxisModel*> models;
  for (const auto& [id, axis] : file.axes)
    models[id] = &std::ranges::find(served, axis.controller, &sim::ServedController::name)
                      ->simulator->axis(id);
  Whereabouts where(file, models);
  const auto world =
      std::make_shared<sim::World>(file, [&where](AxisId id) { return where.at(id).load(); });
  Assistant assistant(*world);
  sim::GigePeer peer(expose(world), file.camera.image_size);
  for (const sim::ServedController& s : served)
    s.simulator->on_output([&peer, &file, name = s.name](const std::string& output, bool on, Time) {
      const TriggerConfig& trigger = file.camera.trigger;
      if (name == trigger.controller && output == trigger.output && on == trigger.rising)
        peer.hardware_trigger();
    });
  fmt::print(
      "camera {} ({}); \"mount led_target\" and \"mount circle_pattern\" change the "
      "payload\n",
      peer.address(), peer.id());
  std::fflush(stdout);
  sim::serve_controllers(clock, served, std::cout, {&where, &assistant});
}

}  // namespace

RigFile load_rig(const std::filesystem::path& file) {
  RigFile rig = load_rig_file(file);
  naming_the_file(rig, [&] { know_controllers(rig); });
  return rig;
}

std::vector<std::string> put_lines(RigFile& rig, const std::vector<std::string>& lines) {
  std::vector<std::string> names;
  for (const ControllerConfig& controller : rig.controllers) names.push_back(controller.name);
  std::vector<std::string> done;
  for (const std::string& text : lines) {
    const auto refuse = [&](const std::string& why) {
      throw ConfigError(
          "--line", "",
          fmt::format("found \"{}\", allowed: NAME=PORT or NAME=HOST:PORT, for example "
                      "mc1=/dev/ttyUSB1; {}.",
                      text, why));
    };
    const std::size_t equals = text.find('=');
    const std::string name = text.substr(0, equals);
    const auto controller = std::ranges::find(rig.controllers, name, &ControllerConfig::name);
    if (equals == text.npos || equals + 1 == text.size() || controller == rig.controllers.end())
      refuse(fmt::format("NAME is a controller of the rig: {}", fmt::join(names, ", ")));
    LineConfig& line = controller->line;
    if (line.kind == LineConfig::Kind::kSimulated)
      refuse(fmt::format("{} is simulated inside this program", name));
    const std::string before = line_id(line);
    const std::string where = text.substr(equals + 1);
    const std::size_t colon = where.rfind(':');
    int port = 0;
    const char* end = where.data() + where.size();
    if (colon == where.npos || where.find('/') != where.npos) {
      line.kind = LineConfig::Kind::kSerial;
      line.serial_port = where;
    } else if (const auto [stop, error] = std::from_chars(where.data() + colon + 1, end, port);
               error == std::errc() && stop == end && port >= 1 && port <= 65535 && colon > 0) {
      if (line.kind == LineConfig::Kind::kSerial) line.kind = LineConfig::Kind::kTcp;
      line.host = where.substr(0, colon);
      line.tcp_port = static_cast<std::uint16_t>(port);
    } else {
      refuse("a port of TCP is a number from 1 to 65535");
    }
    done.push_back(text);
    for (ControllerConfig& other : rig.controllers) {  // they have one line, wherever it is now
      if (before.empty() || line_id(other.line) != before) continue;
      other.line = line;
      done.push_back(fmt::format("{}={}", other.name, where));
    }
  }
  return done;
}

void know_rig(RigFile& rig) {
  naming_the_file(rig, [&] { know_controllers(rig); });
}

Rig open_rig(const RigFile& file, const OpenRigOptions& options) {
  return naming_the_file(file, [&] { return open_devices(file, options); });
}

Rig open_axes(const RigFile& file, const OpenRigOptions& options,
              std::vector<std::string>* differences) {
  return naming_the_file(
      file, [&] { return std::move(open_controllers(file, options, differences).rig); });
}

Rig open_camera_alone(const RigFile& file) {
  return naming_the_file(file, [&] { return open_only_camera(file); });
}

void simulate_rig(const RigFile& file, const ServeOptions& options) {
  naming_the_file(file, [&] { serve_devices(file, options); });
}

}  // namespace turntable
