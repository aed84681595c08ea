#include "drivers/catalog.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>

#include "drivers/camera_folder.h"
#include "drivers/leadshine_pr.h"
#include "drivers/zolix_mc600.h"
#include "protocols/serial.h"
#include "protocols/tcp.h"
#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr ControllerModel kControllers[] = {
    // model       baud   opens
    {"zolix-mc600", 19200, open_zolix_mc600},
    {"leadshine-pr", 38400, open_leadshine_pr},
};

constexpr CameraModel kCameras[] = {
    // model   opens
    {"folder", open_folder_camera},
};

constexpr Time kConnectTimeout = std::chrono::seconds{5};

/// The row of a table with that model. @throws ConfigError at `pointer` that lists the others.
template <class Row, std::size_t N>
const Row& row_of(const Row (&table)[N], std::string_view model, const std::string& pointer) {
  const Row* row = std::ranges::find(table, model, &Row::model);
  if (row != std::end(table)) return *row;
  std::string known;
  for (const Row& other : table)
    known += fmt::format("{}{}", known.empty() ? "" : ", ", other.model);
  throw ConfigError("rig", pointer, fmt::format("found \"{}\", allowed: {}.", model, known));
}

}  // namespace

std::span<const ControllerModel> controller_models() { return kControllers; }
std::span<const CameraModel> camera_models() { return kCameras; }

std::unique_ptr<Controller> open_controller(ControllerSetup setup) {
  const ControllerModel& row = row_of(kControllers, setup.controller.model,
                                      fmt::format("/controllers/{}/model", setup.controller.name));
  return row.open(std::move(setup));
}

Line open_line(const ControllerConfig& controller) {
  const LineConfig& line = controller.line;
  if (line.kind == LineConfig::Kind::kSerial) {
    const ControllerModel& row = row_of(kControllers, controller.model,
                                        fmt::format("/controllers/{}/model", controller.name));
    return open_serial(line.serial_port, line.baud != 0 ? line.baud : row.default_baud, line.parity,
                       line.stop_bits);
  }
  assert(line.kind != LineConfig::Kind::kSimulated);  // that is one end of a line_pair
  return open_tcp(line.host, line.tcp_port, kConnectTimeout);
}

std::unique_ptr<Camera> open_camera(CameraSetup setup) {
  const CameraModel& row = row_of(kCameras, setup.config.model, "/camera/model");
  return row.open(std::move(setup));
}

}  // namespace turntable
