#include "drivers/catalog.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <charconv>

#include "drivers/camera_folder.h"
#include "drivers/camera_gige.h"
#include "drivers/camera_usb.h"
#include "drivers/controller_description.h"
#include "drivers/described_text.h"
#include "drivers/leadshine_pr.h"
#include "drivers/zolix_mc600.h"
#include "drivers/zolix_sc300.h"
#include "drivers/zolix_zc300.h"
#include "protocols/modbus_master.h"
#include "protocols/serial.h"
#include "protocols/tcp.h"
#include "src/core/errors.h"

namespace turntable {
namespace {

// An MC600 takes the five decimals that its driver sends, and shows three in what is known of it; a
// ZC300 cuts distances off to thousandths.
// What a described controller needs, and the steps it can be told, its description says.
constexpr ControllerModel kControllers[] = {
    // model        baud   reply modbus sent  told  key of its own  opens             identifies
    {"zolix-mc600", 19200, 1.0, false, 1e-5, 1e-3, "", open_zolix_mc600, identify_zolix_mc600,
     kUnconfirmedMc600},
    {"zolix-zc300", 115200, 0.4, true, 1e-3, 0.0, "address", open_zolix_zc300, identify_zolix_zc300,
     kUnconfirmedZc300},
    {"zolix-sc300", 19200, 1.0, false, 0.0, 0.0, "answers_while_moving", open_zolix_sc300,
     identify_zolix_sc300, kUnconfirmedSc300},
    {"leadshine-pr", 38400, 0.3, true, 0.0, 0.0, "", open_leadshine_pr, identify_leadshine_pr,
     kUnconfirmedLeadshine},
    {"described", 9600, 1.0, false, 0.0, 0.0, "description", open_described_text,
     identify_described_text, kUnconfirmedDescribed},
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

namespace {

bool is_described(const ControllerConfig& controller) {
  return model_of(controller).own_key == "description";
}

/// Of the serial line, where that is known. Behind a serial server it is not: the slowest usual one.
int baud_of(const ControllerConfig& controller) {
  constexpr int kBehindServer = 9600;
  if (controller.line.kind == LineConfig::Kind::kTcp) return kBehindServer;
  if (controller.line.baud != 0) return controller.line.baud;
  return is_described(controller) ? load_description(controller).baud
                                  : model_of(controller).default_baud;
}

/// The Modbus slaves that a controller of the rig file stands for: itself, or one for each axis.
std::vector<int> slaves_of(const RigFile& rig, const ControllerConfig& controller) {
  if (model_of(controller).own_key == "address") return {controller.address};
  std::vector<int> slaves;
  for (const auto& [id, axis] : rig.axes) {
    int slave = 0;
    const char* end = axis.channel.data() + axis.channel.size();
    if (axis.controller == controller.name &&
        std::from_chars(axis.channel.data(), end, slave).ec == std::errc())
      slaves.push_back(slave);
  }
  return slaves;
}

void check_shared(const RigFile& rig, const ControllerConfig& a, const ControllerConfig& b) {
  const auto refuse = [&](std::string_view key, const std::string& why) {
    throw ConfigError("rig", fmt::format("/controllers/{}/{}", b.name, key), why);
  };
  const std::string same =
      fmt::format("is the line of controller {} too (/controllers/{}/line)", a.name, a.name);
  for (const ControllerConfig* controller : {&a, &b})
    if (!speaks_modbus(*controller))
      refuse("line",
             fmt::format("{}, and {} cannot share a line: it does not answer by address, as "
                         "Modbus does. Give each controller a line of its own.",
                         same, controller->model));
  if (a.line.kind != b.line.kind)
    refuse("line", same +
                       ", which one of them calls a serial server (\"tcp\") and the other a Modbus "
                       "gateway (\"modbus_tcp\"). Correct one of them.");
  if (baud_of(a) != baud_of(b) || a.line.parity != b.line.parity ||
      a.line.stop_bits != b.line.stop_bits)
    refuse("line", fmt::format("{}, at another baud rate, parity or number of stop bits ({} and {} "
                               "baud). All on one line have to be set alike.",
                               same, baud_of(a), baud_of(b)));
  const std::vector<int> taken = slaves_of(rig, a);
  for (const int slave : slaves_of(rig, b))
    if (std::ranges::find(taken, slave) != taken.end())
      refuse(model_of(b).own_key == "address" ? "address" : "line",
             fmt::format(
                 "slave {} on this line is controller {}'s already. Give every slave of a line "
                 "an address of its own.",
                 slave, a.name));
}

}  // namespace

bool speaks_modbus(const ControllerConfig& controller) { return model_of(controller).modbus; }

std::vector<std::string> unconfirmed_of(const ControllerConfig& controller) {
  const std::span<const std::string_view> assumed = model_of(controller).unconfirmed;
  std::vector<std::string> sentences;
  if (is_described(controller)) sentences = load_description(controller).unconfirmed();
  sentences.insert(sentences.end(), assumed.begin(), assumed.end());
  return sentences;
}

void check_controllers(const RigFile& rig) {
  for (auto b = rig.controllers.begin(); b != rig.controllers.end(); ++b) {
    check_controller(*b);
    const std::string line = line_id(b->line);
    for (auto a = rig.controllers.begin(); a != b; ++a)
      if (!line.empty() && line_id(a->line) == line) check_shared(rig, *a, *b);
  }
}

namespace {

void know_axis(AxisConfig& axis, const ControllerConfig& controller) {
  axis.sent_step = model_of(controller).sent_step;
  axis.told_step = model_of(controller).told_step;
  if (is_described(controller)) {
    const ControllerDescription description = load_description(controller);
    check_axis(description, controller_side(axis));
    axis.sent_step = axis.told_step = description.position.step(axis);
  }
  if (!axis.tolerance_stated)
    axis.tolerance = std::max(axis.tolerance, 0.5 * axis.per_step() + axis.told_step);
}

}  // namespace

void know_controllers(RigFile& rig) {
  check_controllers(rig);
  for (auto& [id, axis] : rig.axes) {
    const auto controller =
        std::ranges::find(rig.controllers, axis.controller, &ControllerConfig::name);
    know_axis(axis, *controller);
    if (axis.tolerance < axis.finest_window() - 1e-12)
      throw ConfigError(
          "rig", fmt::format("/axes/{}/tolerance_{}", axis_name(id), axis.unit()),
          fmt::format("found {:g} {}, allowed: at least {:g} {}. A pulse is {:g} {}, and {} tells "
                      "positions in steps of {:g} {}: a finer window cannot be seen to be reached.",
                      axis.tolerance, axis.unit(), axis.finest_window(), axis.unit(),
                      axis.per_step(), axis.unit(), controller->model, axis.told_step,
                      axis.unit()));
  }
}

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
  only_if_own("description", !controller.description.empty());
  if (controller.line.kind == LineConfig::Kind::kModbusTcp && !speaks_modbus(controller))
    throw ConfigError("rig", fmt::format("/controllers/{}/line/modbus_tcp", controller.name),
                      fmt::format("{} does not speak Modbus. A serial server is a \"tcp\" line.",
                                  controller.model));
}

std::unique_ptr<Controller> open_controller(ControllerSetup setup) {
  check_controller(setup.controller);
  const ControllerModel& model = model_of(setup.controller);
  if (setup.controller.reply_timeout_s == 0)
    setup.controller.reply_timeout_s = is_described(setup.controller)
                                           ? load_description(setup.controller).reply_timeout_s
                                           : model.reply_timeout_s;
  for (AxisConfig& axis : setup.axes) know_axis(axis, setup.controller);
  if (model.modbus && setup.controller.line.kind != LineConfig::Kind::kModbusTcp)
    setup.line.want_silence(rtu_silence(baud_of(setup.controller)));
  return model.open(std::move(setup));
}

SharedLine open_line(const ControllerConfig& controller, const WireLog& log) {
  check_controller(controller);
  const LineConfig config = controller.line;
  assert(config.kind != LineConfig::Kind::kSimulated);  // that is one end of a line_pair
  return SharedLine([config, baud = baud_of(controller), log] {
    Line line = config.kind == LineConfig::Kind::kSerial
                    ? open_serial(config.serial_port, baud, config.parity, config.stop_bits)
                    : open_tcp(config.host, config.tcp_port, kConnectTimeout);
    if (config.kind == LineConfig::Kind::kSerial) line.set_byte_time(from_seconds(11.0 / baud));
    line.set_log(log);
    return line;
  });
}

std::string identify(Clock& clock, const std::function<Line(const ControllerModel&)>& open) {
  for (const ControllerModel& model : kControllers) {
    try {
      SharedLine line(open(model));
      if (model.modbus) line.want_silence(rtu_silence(model.default_baud));
      if (const std::string who = model.identify(line, clock); !who.empty())
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
