// Simulators by the controller's model name: the counterpart of drivers/catalog.h.
#pragma once

#include <memory>
#include <span>
#include <string_view>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

struct SimulatorModel {
  std::string_view model;
  std::unique_ptr<ControllerSimulator> (*make)(const SimulatorSetup&);
};

std::span<const SimulatorModel> simulator_models();

/// @throws ConfigError for an unknown model or channel.
std::unique_ptr<ControllerSimulator> simulate_controller(std::string_view model,
                                                         const SimulatorSetup& setup);

/// A channel of telemetry whose source is simulated, before scale and offset: a sine of the time.
double simulated_reading(const ChannelConfig& channel, Time now);

}  // namespace turntable::sim
