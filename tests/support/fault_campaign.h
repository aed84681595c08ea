// A short scenario on a rig of simulated controllers on which a seeded random choice of things goes
// wrong. The rules: the run completes with correct data, or ends with an error that says why; then
// the axes stand; no motion command went out twice; no axis passed a limit.
#pragma once

#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "drivers/catalog.h"
#include "drivers/sim/catalog.h"
#include "src/campaign/planning.h"
#include "src/campaign/runner.h"
#include "src/core/errors.h"
#include "src/core/random.h"
#include "tests/support/fake_rig.h"
#include "tests/support/simulated_controller.h"
#include "tests/support/temporary_folder.h"

namespace turntable {

/// Stage, yaw, roll and pitch on as many controllers of one model as their channels ask for.
class SimulatedAxes {
 public:
  SimulatedAxes(const ControllerVariant& variant, std::uint64_t seed, ManualClock& clock)
      : clock_(clock) {
    const std::vector<AxisConfig> channels = axes_of(variant.model);
    const std::vector<AxisConfig> all = four_axes();
    for (std::size_t first = 0; first < all.size(); first += channels.size()) {
      std::vector<AxisConfig> axes(
          all.begin() + static_cast<std::ptrdiff_t>(first),
          all.begin() + static_cast<std::ptrdiff_t>(std::min(all.size(), first + channels.size())));
      for (std::size_t i = 0; i < axes.size(); ++i) axes[i].channel = channels[i].channel;
      ControllerConfig config;
      config.name = "mc" + std::to_string(simulators.size() + 1);
      config.model = variant.model;
      config.answers_while_moving = variant.answers_while_moving;
      config.description = variant.description();
      if (variant.gateway) config.line.kind = LineConfig::Kind::kModbusTcp;
      simulators.push_back(sim::simulate_controller(variant.model, {axes, {}, seed, config}));
      simulators.back()->note_requests();
      auto [near, far] = line_pair(config.name);
      simulators.back()->plug(std::move(far));
      clock.attach(*simulators.back());
      controllers.push_back(open_controller({config, axes, std::move(near), &clock}));
      for (const AxisConfig& axis : axes) place_[axis.id] = simulators.size() - 1;
    }
  }
  ~SimulatedAxes() {
    controllers.clear();
    for (const auto& simulator : simulators) clock_.detach(*simulator);
  }
  SimulatedAxes(const SimulatedAxes&) = delete;
  SimulatedAxes& operator=(const SimulatedAxes&) = delete;

  void connect(Rig& rig) {
    for (const auto& controller : controllers) controller->connect();
    rig.clock = &clock_;
    rig.stage = at(AxisId::kStage).linear_axis(AxisId::kStage);
    rig.yaw = at(AxisId::kYaw).rotary_axis(AxisId::kYaw);
    rig.roll = at(AxisId::kRoll).rotary_axis(AxisId::kRoll);
    rig.pitch = at(AxisId::kPitch).rotary_axis(AxisId::kPitch);
    rig.simulated = true;
    rig.stop_all = [this] {
      Attempts tried;
      for (const auto& controller : controllers) controller->forbid_all();
      for (const auto& controller : controllers) tried([&] { controller->begin_stop_all(); });
      for (const auto& controller : controllers) tried([&] { controller->finish_stop_all(); });
      tried.rethrow();
    };
  }
  /// The controller that has the axis.
  std::size_t place(AxisId id) const { return place_.at(id); }
  const sim::AxisModel& model(AxisId id) const { return simulators[place(id)]->axis(id); }

  std::vector<std::unique_ptr<sim::ControllerSimulator>> simulators;
  std::vector<std::unique_ptr<Controller>> controllers;

 private:
  Controller& at(AxisId id) { return *controllers[place_.at(id)]; }
  ManualClock& clock_;
  std::map<AxisId, std::size_t> place_;
};

/// What became of a run, and which rule it broke.
struct FaultedRun {
  bool completed = false;
  std::string error;   ///< why it ended, if it did not complete
  std::string faults;  ///< that were armed
  std::vector<std::string> broken;
};

class FaultCampaign {
 public:
  explicit FaultCampaign(ControllerVariant variant) : variant_(std::move(variant)) {
    rig_file_ = load_rig_file(std::filesystem::path(TURNTABLE_SOURCE_DIR) /
                              "scenarios/rigs/simulated.json");
    rig_file_.camera.image_size = {64, 48};
    rig_file_.telemetry = {};
    rig_file_.inspection.retakes = 0;  // the images are dark
    const auto axes = four_axes();
    for (const AxisConfig& axis : axes) rig_file_.axes[axis.id] = axis;
    Campaign campaign;
    campaign.name = campaign.title = "faults";
    campaign.scenarios = {parse_scenario(
        R"({"format": "turntable-scenario/1", "name": "f", "title": "F", "kind": "attitude",
            "stage_mm": 12, "dwell_ms": 0,
            "ranges": [{"axis": "pitch", "values_deg": [-4, 4]}, {"axis": "roll", "values_deg": [3]},
                       {"axis": "yaw", "values_deg": [-5, 6]}]})",
        "faults.json")};
    plan_ = plan_campaign(campaign, rig_file_);
  }

  FaultedRun run(std::uint64_t number) {
    FaultedRun outcome;
    Random draws(number, "fault campaign of " + variant_.name());
    const auto broken = [&](std::string rule) { outcome.broken.push_back(std::move(rule)); };
    // Files in memory: it is not the disk that is on trial.
    const TemporaryFolder folder(std::filesystem::exists("/dev/shm") ? "/dev/shm" : "/tmp");
    FakeRig fake(Image({64, 48}, 10));
    SimulatedAxes axes(variant_, number, fake.clock);
    axes.connect(fake.rig);
    const auto kinds = sim::all_faults();
    std::set<std::size_t> deaf,
        stuck;  ///< controllers that may not hear a stop; with a motor that hangs
    std::set<sim::FaultKind> drawn;
    for (int n = 1 + static_cast<int>(draws() % 3); n > 0; --n) {
      sim::Fault fault;
      // A table that stands while its motor turns is beyond what a pulse counter can see. And where a
      // place that nobody asked for is the report of the end (SC300), an answer that comes twice, while
      // the counter has just become 0 by a power cycle, is such a report.
      const auto beyond_seeing = [&](sim::FaultKind kind) {
        const bool twice = kind == sim::FaultKind::kDuplicatedLine;
        return kind == sim::FaultKind::kBlockedTable ||
               (variant_.model == "zolix-sc300" && (twice || kind == sim::FaultKind::kReset) &&
                drawn.contains(twice ? sim::FaultKind::kReset : sim::FaultKind::kDuplicatedLine));
      };
      do fault.kind = kinds[draws() % kinds.size()];
      while (beyond_seeing(fault.kind));
      drawn.insert(fault.kind);
      constexpr std::array kVerbs{"move", "move", "status", "status", "home", "stop", ""};
      fault.verb = kVerbs[draws() % kVerbs.size()];
      fault.nth = 1 + static_cast<int>(draws() % (fault.verb == "move" ? 12 : 60));
      fault.times = draws.uniform() < 0.1 ? -1 : 1;
      fault.delay_s = draws.uniform(0, 2);
      fault.text = fault.kind == sim::FaultKind::kErrorReply ? refusal() : "";
      const std::size_t where = draws() % axes.simulators.size();
      const bool silent =
          fault.kind == sim::FaultKind::kSilence || fault.kind == sim::FaultKind::kErrorReply;
      if (fault.kind == sim::FaultKind::kUnplugged || (silent && fault.times < 0))
        deaf.insert(where);
      if (fault.kind == sim::FaultKind::kStuckAxis) stuck.insert(where);
      outcome.faults +=
          fmt::format("{} on \"{}\" {} x {} after {:.3f} s; ", sim::fault_name(fault.kind),
                      fault.verb, fault.nth, fault.times, fault.delay_s);
      axes.simulators[where]->add_fault(fault);
    }
    std::size_t pose = 0;
    fake.camera.on_trigger = [&] {
      const PlannedPose& planned = plan_.poses[pose++];
      for (const AxisId id : kAllAxes) {
        const AxisConfig& axis = rig_file_.axis(id);
        const double truth = axes.model(id).true_position(fake.clock.now());
        if (std::abs(truth - planned.target(id)) > axis.tolerance + 1e-6)
          broken(fmt::format("an image of pose {} was taken with {} at {} instead of {}", pose - 1,
                             axis_name(id), truth, planned.target(id)));
        if (axes.model(id).moving(fake.clock.now()))
          broken(fmt::format("an image was taken while {} moved", axis_name(id)));
      }
    };
    AcquireOptions options;
    options.archive = ArchiveMode::kNone;
    const RunFolder run_folder = RunFolder::create(folder / "run", plan_);
    try {
      acquire(fake.rig, rig_file_, plan_, run_folder, {{"version", "test"}}, options);
      outcome.completed = true;
      if (pose != plan_.poses.size()) broken("completed with poses missing");
    } catch (const Error& e) {
      outcome.error = e.what();
      if (outcome.error.size() < 20) broken("the error says nothing: " + outcome.error);
    }
    if (read_run(run_folder).torn) broken("the journal is torn");
    if (seconds(fake.clock.now()) > 3600) broken("it took hours");
    // Who cannot be told to stop ends his move by himself; all others stand by now.
    const Time ended = fake.clock.now();
    if (!deaf.empty()) fake.clock.sleep_for(std::chrono::seconds{60});
    for (const AxisId id : kAllAxes) {
      const sim::AxisModel& model = axes.model(id);
      const AxisConfig& axis = rig_file_.axis(id);
      const std::size_t controller = axes.place(id);
      const Time now = fake.clock.now();
      if (model.moving(deaf.contains(controller) ? now : ended) && !stuck.contains(controller))
        broken(fmt::format("{} still moves", axis_name(id)));
      if (model.lowest(now) < axis.lower || model.highest(now) > axis.upper)
        broken(fmt::format("{} was between {} and {}", axis_name(id), model.lowest(now),
                           model.highest(now)));
      for (const auto& simulator : axes.simulators) check_sent_once(*simulator, id, broken);
    }
    return outcome;
  }

 private:
  /// Two motion commands for an axis that has not moved in between: one of them is a repetition.
  static void check_sent_once(const sim::ControllerSimulator& simulator, AxisId id,
                              const std::function<void(std::string)>& broken) {
    double last = std::nan("");
    for (const auto& request : simulator.requests()) {
      if (request.kind == "reset") last = std::nan("");  // the counter is 0 afterwards
      if (request.axis != id) continue;
      if (request.kind == "home") last = std::nan("");
      if (request.kind != "move") continue;
      if (last == request.counter)
        broken(fmt::format("{} was told to move twice from {}", axis_name(id), last));
      last = request.counter;
    }
  }
  std::string refusal() const { return variant_.model.starts_with("zolix-mc") ? "E02" : "04"; }

  ControllerVariant variant_;
  RigFile rig_file_;
  Plan plan_;
};

}  // namespace turntable
