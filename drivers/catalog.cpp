#include "drivers/catalog.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>

#include "drivers/camera_folder.h"
#include "drivers/camera_gige.h"
#include "drivers/camera_usb.h"
#include "drivers/leadshine_pr.h"
#include "drivers/zolix_mc600.h"
#include "drivers/zolix_sc300.h"
#include "drivers/zolix_zc300.h"
#include "protocols/serial.h"
#include "protocols/tcp.h"
#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr ControllerModel kControllers[] = {
    // model         baud    reply modbus key of its own          opens              identifies
    {"zolix-mc600", 19200, 1.0, false, "", open_zolix_mc600, identify_zolix_mc600},
    {"zolix-zc300", 115200, 0.2, true, "address", open_zolix_zc300, identify_zolix_zc300},
    {"zolix-sc300", 19200, 1.0, false, "answers_while_moving", open_zolix_sc300,
     identify_zolix_sc300},
    {"leadshine-pr", 38400, 0.3, true, "", open_leadshine_pr, identify_leadshine_pr},
};

std::vector<std::string> list_gige_cameras() {
  std::vector<std::string> lines;
  for (const FoundCamera& camera : find_gige_cameras())
    lines.push_back(fmt::format("{} ({} {}, serial {}, {} {})", camera.id, camera.vendor,
                                camera.model, camera.serial, camera.protocol, camera.address));
  return lines;
}

constexpr CameraModel kCameras[] = {
    // model   opens               finds
    {"folder", open_folder_camera, nullptr},
    {"gige", open_gige_camera, list_gige_cameras},
    {"usb", open_usb_camera, find_usb_cameras},
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

namespace {

const ControllerModel& model_of(const ControllerConfig& controller) {
  return row_of(kControllers, controller.model,
                fmt::format("/controllers/{}/model", controller.name));
}

}  // namespace

bool speaks_modbus(const ControllerConfig& controller) { return model_of(controller).modbus; }

void check_controller(const ControllerConfig& controller) {
  const std::string_view own_key = model_of(controller).own_key;
  const auto only_if_own = [&](std::string_view key, bool stated) {
    if (stated && key != own_key)
      throw ConfigError("rig", fmt::format("/controllers/{}/{}", controller.name, key),
                        fmt::format("found with model \"{}\", which does not use it. Remove it.",
                                    controller.model));
  };
  only_if_own("address", controller.address != 1);
  only_if_own("answers_while_moving", !controller.answers_while_moving);
  if (controller.line.kind == LineConfig::Kind::kModbusTcp && !speaks_modbus(controller))
    throw ConfigError("rig", fmt::format("/controllers/{}/line/modbus_tcp", controller.name),
                      fmt::format("{} does not speak Modbus. A serial server is a \"tcp\" line.",
                                  controller.model));
}

std::unique_ptr<Controller> open_controller(ControllerSetup setup) {
  check_controller(setup.controller);
  const ControllerModel& model = model_of(setup.controller);
  if (setup.controller.reply_timeout_s == 0)
    setup.controller.reply_timeout_s = model.reply_timeout_s;
  return model.open(std::move(setup));
}

Line open_line(const ControllerConfig& controller) {
  check_controller(controller);
  const LineConfig& line = controller.line;
  if (line.kind == LineConfig::Kind::kSerial)
    return open_serial(line.serial_port,
                       line.baud != 0 ? line.baud : model_of(controller).default_baud, line.parity,
                       line.stop_bits);
  assert(line.kind != LineConfig::Kind::kSimulated);  // that is one end of a line_pair
  return open_tcp(line.host, line.tcp_port, kConnectTimeout);
}

std::string identify(Clock& clock, const std::function<Line(const ControllerModel&)>& open) {
  for (const ControllerModel& model : kControllers) {
    try {
      if (const std::string who = model.identify(open(model), clock); !who.empty())
        return fmt::format("{} ({})", who, model.model);
    } catch (const Interrupted&) {
      throw;
    } catch (const Error& e) {
      return e.what();
    }
  }
  return "nobody that this program knows answers";
}

std::unique_ptr<Camera> open_camera(CameraSetup setup) {
  const CameraModel& row = row_of(kCameras, setup.config.model, "/camera/model");
  return row.open(std::move(setup));
}

}  // namespace turntable
