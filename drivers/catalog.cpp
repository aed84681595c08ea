#include "drivers/catalog.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>

#include "drivers/zolix_mc600.h"
#include "protocols/serial.h"
#include "protocols/tcp.h"
#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr ControllerModel kControllers[] = {
    // model       baud   opens
    {"zolix-mc600", 19200, open_zolix_mc600},
};

constexpr Time kConnectTimeout = std::chrono::seconds{5};

}  // namespace

std::span<const ControllerModel> controller_models() { return kControllers; }

std::unique_ptr<Controller> open_controller(ControllerSetup setup) {
  const std::string& model = setup.controller.model;
  const auto* row = std::ranges::find(kControllers, model, &ControllerModel::model);
  if (row == std::end(kControllers)) {
    std::string known;
    for (const auto& c : kControllers)
      known += fmt::format("{}{}", known.empty() ? "" : ", ", c.model);
    throw ConfigError("rig", fmt::format("/controllers/{}/model", setup.controller.name),
                      fmt::format("found \"{}\", allowed: {}.", model, known));
  }
  return row->open(std::move(setup));
}

Line open_line(const LineConfig& config) {
  if (config.kind == LineConfig::Kind::kSerial) return open_serial(config.serial_port, config.baud);
  assert(config.kind == LineConfig::Kind::kTcp);  // a simulated line is one end of a line_pair
  return open_tcp(config.host, config.tcp_port, kConnectTimeout);
}

}  // namespace turntable
