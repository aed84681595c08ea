#include "drivers/sim/catalog.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "drivers/sim/leadshine.h"
#include "drivers/sim/mc600.h"
#include "drivers/sim/sc300.h"
#include "drivers/sim/zaber_ascii.h"
#include "drivers/sim/zc300.h"
#include "src/core/errors.h"

namespace turntable::sim {
namespace {

/// Never made from the description itself: then the two could only agree.
std::unique_ptr<ControllerSimulator> simulate_described(const SimulatorSetup& setup) {
  const ControllerConfig& controller = setup.controller;
  if (controller.description == "zaber_ascii") return simulate_zaber_ascii(setup);
  throw ConfigError(
      "rig", fmt::format("/controllers/{}/description", controller.name),
      fmt::format("found \"{}\", simulated: zaber_ascii. Nothing here is written to behave like the "
                  "others. Name a real line, or rehearse with a simulated model.",
                  controller.description));
}

constexpr SimulatorModel kSimulators[] = {
    {"zolix-mc600", simulate_mc600},
    {"zolix-zc300", simulate_zc300},
    {"zolix-sc300", simulate_sc300},
    {"leadshine-pr", [](const SimulatorSetup& setup) { return simulate_leadshine(setup); }},
    {"described", simulate_described},
};

}  // namespace

std::span<const SimulatorModel> simulator_models() { return kSimulators; }

std::unique_ptr<ControllerSimulator> simulate_controller(std::string_view model,
                                                         const SimulatorSetup& setup) {
  const auto* row = std::ranges::find(kSimulators, model, &SimulatorModel::model);
  if (row == std::end(kSimulators)) {
    std::string known;
    for (const auto& s : kSimulators)
      known += fmt::format("{}{}", known.empty() ? "" : ", ", s.model);
    throw ConfigError("rig", "/controllers",
                      fmt::format("found model \"{}\", simulated: {}.", model, known));
  }
  return row->make(setup);
}

double simulated_reading(const ChannelConfig& channel, Time now) {
  return channel.mean +
         channel.amplitude * std::sin(2.0 * std::numbers::pi * seconds(now) / channel.period_s);
}

}  // namespace turntable::sim
