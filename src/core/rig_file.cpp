#include "src/core/rig_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr std::array<std::string_view, 4> kAxisNames{"stage", "yaw", "roll", "pitch"};

double number(const Json& v) { return v.get<double>(); }
Vector3d vector3(const Json& v) { return {number(v.at(0)), number(v.at(1)), number(v.at(2))}; }
Vector2d vector2(const Json& v) { return {number(v.at(0)), number(v.at(1))}; }
Vector3d vector3_or_zero(const Json& object, const char* key) {
  return object.contains(key) ? vector3(object.at(key)) : Vector3d::Zero();
}
Vector2d vector2_or_zero(const Json& object, const char* key) {
  return object.contains(key) ? vector2(object.at(key)) : Vector2d::Zero();
}

/// Reads one rig file; `at` places every complaint.
class Reader {
 public:
  Reader(const Json& json, std::string name, const std::filesystem::path& folder)
      : json_(json), name_(std::move(name)), folder_(folder) {}

  RigFile read() {
    RigFile rig;
    rig.file = name_;
    rig.name = json_.at("name");
    rig.title = json_.value("title", rig.name);
    read_controllers(rig);
    for (const AxisId id : kAllAxes) rig.axes[id] = axis(rig, id);
    check_channels(rig);
    rig.camera = camera(rig);
    rig.gimbal = gimbal();
    rig.pattern = pattern();
    if ((rig.gimbal.centre_at_stage_zero_mm + rig.pattern.offset_mm).norm() > 1e-6)
      fail("/pattern/offset_mm",
           "and /gimbal/centre_at_stage_zero_mm do not add up to zero: the plane frame's origin "
           "is the pattern's origin circle at stage position 0 and zero angles.");
    rig.target = target();
    rig.tolerances = tolerances();
    if (json_.contains("calibration")) {
      const Json& c = json_.at("calibration");
      if (c.contains("file")) rig.calibration.file = folder_ / c.at("file").get<std::string>();
      if (c.contains("sweep")) rig.calibration.sweep = folder_ / c.at("sweep").get<std::string>();
    }
    if (json_.contains("telemetry")) rig.telemetry = telemetry(rig);
    rig.inspection = inspection(rig);
    if (json_.contains("simulation")) rig.simulation = simulation(rig);
    const bool drawn =
        rig.pattern.kind == PatternKind::kCircles || rig.pattern.kind == PatternKind::kCircleGrid;
    if (rig.simulation && !drawn)
      fail("/pattern/kind", fmt::format("found {}, allowed in a rig with a simulation: circles or "
                                        "circle_grid; others are not drawn.",
                                        pattern_kind_name(rig.pattern.kind)));
    if (rig.simulated() && !rig.simulation)
      fail("/simulation",
           "is missing, but a device of this rig is simulated. Add the section (see "
           "scenarios/rigs/simulated.json) or give the device a real line.");
    return rig;
  }

  PatternConfig pattern() const {
    const Json& p = json_.at("pattern");
    PatternConfig pattern;
    const std::string kind = p.value("kind", "circles");
    pattern.kind = *std::ranges::find(kAllPatternKinds, kind, pattern_kind_name);
    const bool directed = pattern.kind == PatternKind::kCircles;
    const bool round = pattern.kind != PatternKind::kChessboard;
    for (const auto& [key, wanted] : {std::pair{"radius_mm", round},
                                      {"circles", round},
                                      {"direction_radius_mm", directed},
                                      {"direction_circles", directed}}) {
      if (wanted && !p.contains(key))
        fail("/pattern",
             fmt::format("\"{}\" is missing; kind {} needs it{}.", key, kind,
                         key == std::string_view("circles") ? " (\"bright\" or \"dark\")" : ""));
      if (!wanted && p.contains(key))
        fail(fmt::format("/pattern/{}", key), fmt::format("means nothing with kind {}.", kind));
    }
    pattern.columns = p.at("columns");
    pattern.rows = p.at("rows");
    pattern.origin_column = p.at("origin").at(0);
    pattern.origin_row = p.at("origin").at(1);
    pattern.spacing_mm = p.at("spacing_mm");
    pattern.offset_mm = vector3_or_zero(p, "offset_mm");
    const int lattice_columns =
        pattern.kind == PatternKind::kAsymmetricCircles ? 2 * pattern.columns : pattern.columns;
    if (pattern.origin_column >= lattice_columns || pattern.origin_row >= pattern.rows)
      fail("/pattern/origin",
           fmt::format("found [{}, {}], allowed: inside the {} x {} pattern.",
                       pattern.origin_column, pattern.origin_row, lattice_columns, pattern.rows));
    if (round) {
      pattern.radius_mm = p.at("radius_mm");
      pattern.bright = p.at("circles") == "bright";
      // Neighbours of an asymmetric grid stand diagonally.
      const double nearest =
          pattern.spacing_mm * (pattern.kind == PatternKind::kAsymmetricCircles ? 1.41421356 : 1.0);
      if (!directed && 2 * pattern.radius_mm >= nearest)
        fail("/pattern/radius_mm",
             "neighbouring circles touch. Make them smaller than the spacing.");
    }
    if (directed) read_direction_circles(p, pattern);
    return pattern;
  }

 private:
  [[noreturn]] void fail(const std::string& pointer, const std::string& message) const {
    throw ConfigError(name_, pointer, message);
  }

  void read_controllers(RigFile& rig) const {
    for (const auto& [key, c] : json_.at("controllers").items()) {
      ControllerConfig controller;
      controller.name = key;
      controller.model = c.at("model");
      controller.reply_timeout_s = c.value("reply_timeout_ms", 0.0) / 1000.0;
      controller.address = c.value("address", 1);
      controller.answers_while_moving = c.value("answers_while_moving", true);
      controller.description = c.value("description", "");
      if (controller.description.ends_with(".json"))
        controller.description = (folder_ / controller.description).string();
      controller.line = line(c.at("line"));
      if (c.contains("outputs"))
        for (const auto& [name, output] : c.at("outputs").items())
          controller.outputs.push_back(read_output(key, name, output, controller.address));
      rig.controllers.push_back(std::move(controller));
    }
  }

  static LineConfig line(const Json& l) {
    LineConfig line;
    if (l.contains("serial")) {
      const Json& serial = l.at("serial");
      line.kind = LineConfig::Kind::kSerial;
      line.serial_port = serial.at("port");
      line.baud = serial.value("baud", 0);
      const std::string parity = serial.value("parity", "none");
      line.parity = parity == "even"  ? Parity::kEven
                    : parity == "odd" ? Parity::kOdd
                                      : Parity::kNone;
      line.stop_bits = serial.value("stop_bits", 1);
    }
    for (const auto& [key, kind] : {std::pair("tcp", LineConfig::Kind::kTcp),
                                    std::pair("modbus_tcp", LineConfig::Kind::kModbusTcp)}) {
      if (!l.contains(key)) continue;
      line.kind = kind;
      line.host = l.at(key).at("host");
      line.tcp_port = l.at(key).at("port");
    }
    return line;
  }

  OutputConfig read_output(const std::string& controller, const std::string& name, const Json& o,
                           int slave) const {
    OutputConfig output;
    output.name = name;
    output.pulse_s = o.value("pulse_ms", 10.0) / 1000.0;
    const std::string at = fmt::format("/controllers/{}/outputs/{}", controller, name);
    const bool text = o.at("on").is_string();
    if (o.at("off").is_string() != text || o.contains("register") == text)
      fail(at,
           "found a mixture, allowed: \"on\" and \"off\" as texts that the controller "
           "understands, or \"register\" with \"on\" and \"off\" as numbers.");
    if (text && o.contains("bit"))
      fail(at + "/bit",
           "found with texts, allowed: with \"register\". Texts switch an output as they are.");
    if (text) {
      output.on_text = o.at("on");
      output.off_text = o.at("off");
    } else {
      output.register_at = o.at("register").get<int>();
      output.slave = o.value("slave", slave);
      output.on_value = o.at("on");
      output.off_value = o.at("off");
      if (o.contains("bit")) {
        output.bit = o.at("bit").get<int>();
        if (output.on_value > 1 || output.off_value > 1 || output.on_value == output.off_value)
          fail(at, fmt::format("found \"on\" {} and \"off\" {} of one bit, allowed: 1 and 0, or 0 "
                               "and 1 for an output that is on when its bit is off.",
                               output.on_value, output.off_value));
      }
    }
    return output;
  }

  AxisConfig axis(const RigFile& rig, AxisId id) const {
    const std::string at = fmt::format("/axes/{}", axis_name(id));
    const Json& a = json_.at("axes").at(std::string(axis_name(id)));
    AxisConfig axis;
    axis.id = id;
    axis.controller = a.at("controller");
    axis.channel = a.at("channel");
    axis.stage_model = a.at("stage");
    if (std::ranges::find(rig.controllers, axis.controller, &ControllerConfig::name) ==
        rig.controllers.end())
      fail(at + "/controller",
           fmt::format("found \"{}\", allowed: {}. Name a controller of this file.",
                       axis.controller, controller_names(rig)));
    const StageSpec* spec = find_stage_spec(axis.stage_model);
    if (spec == nullptr)
      fail(at + "/stage",
           fmt::format("found \"{}\", allowed: {}. Name a stage of the table and override "
                       "what differs.",
                       axis.stage_model, stage_names(id)));
    const bool linear = id == AxisId::kStage;
    if ((spec->kind == StageKind::kLinear) != linear)
      fail(at + "/stage", fmt::format("found \"{}\", which is {}; allowed: {}.", axis.stage_model,
                                      linear ? "rotary" : "linear", stage_names(id)));
    const std::string unit(axis.unit());
    const auto value = [&](const std::string& key, double standard) {
      return a.value(key, standard);
    };
    axis.kind = spec->kind;
    axis.steps_per_rev = value("steps_per_rev", spec->steps_per_rev);
    axis.drive_ratio = value("drive_ratio", spec->drive_ratio);
    axis.lead_mm = value("lead_mm", spec->lead_mm);
    axis.initial_speed = value("initial_speed_" + unit + "_s", spec->initial_speed);
    axis.speed = value("speed_" + unit + "_s", spec->speed);
    axis.acceleration = value("acceleration_" + unit + "_s2", spec->acceleration);
    axis.home_speed = value("home_speed_" + unit + "_s", spec->home_speed);
    axis.repeatability = value("repeatability_" + unit, spec->repeatability);
    axis.backlash = value("backlash_" + unit, spec->backlash);
    axis.tolerance = value("tolerance_" + unit, 1.5 * axis.per_step());
    axis.tolerance_stated = a.contains("tolerance_" + unit);
    axis.reversed = a.value("direction", 1) < 0;
    axis.settle_s = value("settle_ms", 100.0) / 1000.0;
    axis.retries = a.value("retries", 2);

    axis.lower = spec->travel_lower;
    axis.upper = spec->travel_upper;
    const std::string key = "limits_" + unit;
    if (a.contains(key)) {
      axis.lower = a.at(key).at(0);
      axis.upper = a.at(key).at(1);
      if (!(axis.lower < axis.upper))
        fail(at + "/" + key,
             fmt::format("found [{}, {}] {}, allowed: lower < upper. Put the lower limit first.",
                         axis.lower, axis.upper, unit));
      const bool on_and_on = spec->endless && a.contains("cable_deg");
      if (!on_and_on && (axis.lower < spec->travel_lower || axis.upper > spec->travel_upper))
        fail(at + "/" + key,
             fmt::format(
                 "found [{}, {}] {}, allowed: inside the travel of {}, [{}, {}] {}{}.", axis.lower,
                 axis.upper, unit, axis.stage_model, spec->travel_lower, spec->travel_upper, unit,
                 spec->endless ? "; more where \"cable_deg\" says how far the cable goes" : ""));
    }
    read_cable(a, at, axis);
    if (axis.speed < axis.initial_speed)
      fail(
          at,
          fmt::format(
              "speed {} {}/s is below the initial speed {} {}/s. Raise the one or lower the other.",
              axis.speed, unit, axis.initial_speed, unit));
    if (axis.reach_upper() - axis.reach_lower() <= 2 * std::abs(axis.backlash))
      fail(at, fmt::format("{} [{}, {}] {} leave no room for the approach overshoot of {} {}.",
                           axis.has_cable() ? "limits and cable, together" : "limits",
                           axis.reach_lower(), axis.reach_upper(), unit, axis.backlash, unit));
    if (axis.tolerance < 0.5 * axis.per_step())
      fail(at + "/tolerance_" + unit,
           fmt::format("found {} {}, allowed: at least half a pulse, {} {}; the controller cannot "
                       "come closer.",
                       axis.tolerance, unit, 0.5 * axis.per_step(), unit));
    return axis;
  }

  void read_cable(const Json& a, const std::string& at, AxisConfig& axis) const {
    if (!a.contains("cable_deg")) return;
    axis.cable_lower = a.at("cable_deg").at(0);
    axis.cable_upper = a.at("cable_deg").at(1);
    if (!(axis.cable_lower <= 0.0 && axis.cable_upper >= 0.0 &&
          axis.cable_lower < axis.cable_upper))
      fail(at + "/cable_deg",
           fmt::format("found [{}, {}] deg, allowed: lower < upper with 0 between them. The angles "
                       "count from home, where the cable has to be free.",
                       axis.cable_lower, axis.cable_upper));
  }

  static std::string controller_names(const RigFile& rig) {
    std::string names;
    for (const auto& c : rig.controllers) names += (names.empty() ? "" : ", ") + c.name;
    return names;
  }
  static std::string stage_names(AxisId id) {
    std::string names;
    for (const auto& spec : stage_specs())
      if ((spec.kind == StageKind::kLinear) == (id == AxisId::kStage))
        names += (names.empty() ? "" : ", ") + std::string(spec.model);
    return names;
  }

  void check_channels(const RigFile& rig) const {
    std::map<std::pair<std::string, std::string>, AxisId> taken;
    for (const auto& [id, axis] : rig.axes) {
      const auto [it, fresh] = taken.emplace(std::pair(axis.controller, axis.channel), id);
      if (!fresh)
        fail(fmt::format("/axes/{}/channel", axis_name(id)),
             fmt::format("channel {} of controller {} already turns axis {}. Give each axis its "
                         "own channel.",
                         axis.channel, axis.controller, axis_name(it->second)));
    }
  }

  CameraConfig camera(const RigFile& rig) const {
    const Json& c = json_.at("camera");
    CameraConfig camera;
    camera.model = c.at("model");
    // A key that its model does not look at would mislead.
    const auto only_for = [&](std::initializer_list<const char*> keys,
                              std::initializer_list<std::string_view> models) {
      for (const char* key : keys)
        if (c.contains(key) && std::ranges::find(models, camera.model) == models.end())
          fail(fmt::format("/camera/{}", key),
               fmt::format("found with camera model \"{}\", which does not use it. Remove it.",
                           camera.model));
    };
    only_for({"folder", "replay", "files", "order", "layout", "latency_ms"}, {"folder"});
    only_for({"simulated", "packet_bytes"}, {"gige"});
    only_for({"device", "exposure_us", "gain"}, {"gige", "usb"});
    only_for({"pixel_format", "offset_px"}, {"gige"});
    only_for({"stale_frames"}, {"usb"});
    only_for({"trigger"}, {"gige", "simulated"});

    camera.device = c.value("device", "");
    camera.simulated = c.contains("simulated");
    if (camera.simulated && !camera.device.empty())
      fail("/camera/device", "is meaningless for a camera that this program serves itself.");
    if (camera.model == "usb" && camera.device.empty())
      fail("/camera/device",
           "is missing: camera model \"usb\" needs a device such as /dev/video0, or a video file.");
    // "usb": a device by name or number; anything else is a file beside the rig file.
    if (camera.model == "usb" && camera.device.find_first_not_of("0123456789") != std::string::npos)
      camera.device = (folder_ / camera.device).string();
    camera.pixel_format = c.value("pixel_format", camera.pixel_format);
    if (c.contains("exposure_us")) camera.exposure_us = number(c.at("exposure_us"));
    if (c.contains("gain")) camera.gain = number(c.at("gain"));
    if (c.contains("offset_px")) camera.offset_px = c.at("offset_px").get<std::array<int, 2>>();
    camera.packet_bytes = c.value("packet_bytes", 0);
    if (c.contains("stale_frames")) camera.stale_frames = c.at("stale_frames").get<int>();
    if (c.contains("trigger")) camera.trigger = trigger(rig, c.at("trigger"));

    if (c.contains("folder")) camera.folder = folder_ / c.at("folder").get<std::string>();
    if (camera.model == "folder" && camera.folder.empty())
      fail("/camera/folder", "is missing: camera model \"folder\" needs the folder of the images.");
    camera.replay = c.value("replay", false);
    camera.files = c.value("files", camera.files);
    const std::string order = c.value("order", "name");
    camera.order = order == "natural" ? FileOrder::kNatural
                   : order == "time"  ? FileOrder::kTime
                                      : FileOrder::kName;
    camera.layout = c.value("layout", "");
    if (!camera.layout.empty() && !camera.replay)
      fail("/camera/layout", "says where images taken earlier are: it needs \"replay\": true.");
    for (const char* key : {"files", "order"})
      if (!camera.layout.empty() && c.contains(key))
        fail(fmt::format("/camera/{}", key),
             "found beside a layout, which names every file by itself. Remove the one or the "
             "other.");

    camera.latency_stated = c.contains("latency_ms");
    camera.latency_s = c.value("latency_ms", 0.0) / 1000.0;
    if (camera.latency_stated && camera.replay)
      fail("/camera/latency_ms", "is for images that are still to come: remove it, or \"replay\".");

    camera.image_size = {c.at("image_size_px").at(0), c.at("image_size_px").at(1)};
    camera.frame_timeout_s = c.value("frame_timeout_ms", 2000.0) / 1000.0;
    if (camera.exposure_us && *camera.exposure_us * 1e-6 >= camera.frame_timeout_s)
      fail("/camera/exposure_us",
           fmt::format(
               "found {:g} us, allowed: less than frame_timeout_ms, {:g} ms here, within which "
               "the whole frame has to be there. Shorten the one or raise the other.",
               *camera.exposure_us, 1000 * camera.frame_timeout_s));
    camera.retries = c.value("retries", 2);
    camera.electrons_per_grey = c.value("electrons_per_grey", 0.0);
    camera.nominal_focal_px = c.at("nominal_focal_px");
    camera.nominal_height_mm = c.at("nominal_height_mm");
    return camera;
  }

  TriggerConfig trigger(const RigFile& rig, const Json& t) const {
    TriggerConfig trigger;
    if (t.at("source") == "software") {
      if (t.size() > 1)
        fail("/camera/trigger", "found more than \"source\": a software trigger has no wiring.");
      return trigger;
    }
    trigger.source = TriggerConfig::Source::kLine;
    trigger.line = t.value("line", trigger.line);
    trigger.rising = t.value("activation", "rising") == "rising";
    if (!t.contains("output")) return trigger;
    trigger.controller = t.at("output").at("controller");
    trigger.output = t.at("output").at("name");
    for (const ControllerConfig& controller : rig.controllers)
      if (controller.name == trigger.controller &&
          std::ranges::find(controller.outputs, trigger.output, &OutputConfig::name) !=
              controller.outputs.end())
        return trigger;
    fail("/camera/trigger/output",
         fmt::format("found output \"{}\" of controller \"{}\", which this file does not describe. "
                     "Add it to /controllers/{}/outputs.",
                     trigger.output, trigger.controller, trigger.controller));
  }

  GimbalConfig gimbal() const {
    const Json& g = json_.at("gimbal");
    GimbalConfig gimbal;
    if (g.contains("order_base_outwards"))
      for (std::size_t i = 0; i < 3; ++i)
        gimbal.order_base_outwards[i] =
            axis_from_name(g.at("order_base_outwards").at(i).get<std::string>());
    gimbal.axes = {Vector3d::UnitZ(), Vector3d::UnitY(),
                   Vector3d::UnitX()};  // yaw, roll, pitch = z, y, x
    if (g.contains("axes"))
      for (std::size_t i = 0; i < 3; ++i) {
        const std::string key(axis_name(kRotaryAxes[i]));
        if (!g.at("axes").contains(key)) continue;
        gimbal.axes[i] = vector3(g.at("axes").at(key));
        if (gimbal.axes[i].norm() < 1e-6)
          fail("/gimbal/axes/" + key, "has no length. State a direction.");
        gimbal.axes[i].normalize();
      }
    const auto& [yaw, roll, pitch] = gimbal.axes;
    if (std::abs(std::abs(yaw.dot(roll.cross(pitch))) - 1.0) > 1e-9)
      fail("/gimbal/axes",
           "the three axes are not at right angles. State nominal directions; small errors of "
           "the real axes are the business of the evaluation.");
    gimbal.centre_at_stage_zero_mm = vector3(g.at("centre_at_stage_zero_mm"));
    gimbal.plane_from_gimbal_deg = vector3_or_zero(g, "plane_from_gimbal_deg");
    gimbal.axis_tilt_deg = vector3_or_zero(g, "axis_tilt_deg");
    return gimbal;
  }

  void read_direction_circles(const Json& p, PatternConfig& pattern) const {
    pattern.direction_radius_mm = p.at("direction_radius_mm");
    if (pattern.direction_radius_mm < 1.15 * pattern.radius_mm)
      fail("/pattern/direction_radius_mm",
           fmt::format(
               "found {} mm, allowed: at least 1.15 times radius_mm ({} mm), or the bigger circles "
               "cannot be told apart.",
               pattern.direction_radius_mm, pattern.radius_mm));
    if (2 * pattern.direction_radius_mm >= pattern.spacing_mm)
      fail("/pattern/direction_radius_mm",
           "neighbouring circles touch. Make them smaller than the spacing.");
    for (std::size_t i = 0; i < 4; ++i) {
      const Json& d = p.at("direction_circles").at(i);
      const std::array<int, 2> at{d.at(0), d.at(1)};
      const int column = at[0] + pattern.origin_column, row = at[1] + pattern.origin_row;
      const std::string place = fmt::format("/pattern/direction_circles/{}", i);
      if (column < 0 || column >= pattern.columns || row < 0 || row >= pattern.rows)
        fail(place, fmt::format("found [{}, {}], which lies off the pattern.", at[0], at[1]));
      if (std::ranges::find(pattern.direction_circles, at) != pattern.direction_circles.end())
        fail(place, fmt::format("[{}, {}] is stated twice.", at[0], at[1]));
      pattern.direction_circles.push_back(at);
    }
    if (std::ranges::find(pattern.direction_circles, std::array{0, 0}) ==
        pattern.direction_circles.end())
      fail("/pattern/direction_circles",
           "[0, 0] is not among them; the origin circle is a bigger one.");
    check_direction_circles(pattern);
  }

  /// Three on one line give no homography; a symmetric arrangement gives more than one reading.
  void check_direction_circles(const PatternConfig& pattern) const {
    const auto& d = pattern.direction_circles;
    for (std::size_t i = 0; i < 4; ++i)
      for (std::size_t j = i + 1; j < 4; ++j)
        for (std::size_t k = j + 1; k < 4; ++k)
          if ((d[j][0] - d[i][0]) * (d[k][1] - d[i][1]) ==
              (d[k][0] - d[i][0]) * (d[j][1] - d[i][1]))
            fail("/pattern/direction_circles",
                 "three of them lie on one line. Choose four in general position.");
    const auto relative = [&](int a, int b, int c,
                              int e) {  // the set under one lattice symmetry, from its own corner
      std::vector<std::array<int, 2>> moved;
      for (const auto& p : d) moved.push_back({a * p[0] + b * p[1], c * p[0] + e * p[1]});
      std::ranges::sort(moved);
      const auto corner = moved.front();
      for (auto& p : moved) p = {p[0] - corner[0], p[1] - corner[1]};
      return moved;
    };
    const auto as_is = relative(1, 0, 0, 1);
    for (const auto& [a, b, c, e] : {std::array{0, -1, 1, 0},
                                     {-1, 0, 0, -1},
                                     {0, 1, -1, 0},
                                     {1, 0, 0, -1},
                                     {-1, 0, 0, 1},
                                     {0, 1, 1, 0},
                                     {0, -1, -1, 0}})
      if (relative(a, b, c, e) == as_is)
        fail("/pattern/direction_circles",
             "the four look the same after a turn or a reflection, so that the pattern's direction "
             "is ambiguous.");
  }

  TargetConfig target() const {
    const Json& t = json_.at("target");
    TargetConfig target;
    for (const Json& p : t.at("points_mm")) target.points_mm.push_back(vector3(p));
    target.led_radius_mm = t.at("led_radius_mm");
    target.offset_mm = vector3_or_zero(t, "offset_mm");
    target.uncertainty_mm = t.value("uncertainty_mm", 0.0);
    if (target.points_mm.front().norm() > 0)
      fail("/target/points_mm/0",
           "found a point off the origin, allowed: [0, 0, 0]. M0 is the target's origin.");
    // Singular values of the vectors from M0, as roots of the eigenvalues of their 3 x 3 normal
    // matrix.
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    for (const Vector3d& p : target.points_mm) normal += p * p.transpose();
    const Vector3d extent =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(normal, Eigen::EigenvaluesOnly)
            .eigenvalues()
            .cwiseMax(0.0)
            .cwiseSqrt();
    if (!(extent(0) > 1e-2 * extent(2)))
      fail("/target/points_mm", fmt::format("the points lie in one plane (smallest to largest "
                                            "extent {:.2g}), allowed: at least 0.01. "
                                            "The attitude solvers need depth: raise one LED.",
                                            extent(2) > 0 ? extent(0) / extent(2) : 0.0));
    for (std::size_t i = 0; i < target.points_mm.size(); ++i)
      for (std::size_t j = i + 1; j < target.points_mm.size(); ++j)
        if ((target.points_mm[i] - target.points_mm[j]).norm() < 2 * target.led_radius_mm)
          fail(fmt::format("/target/points_mm/{}", j), fmt::format("overlaps point {}.", i));
    return target;
  }

  ToleranceConfig tolerances() const {
    const auto stated = [&](const char* key, Tolerance standard) -> Tolerance {
      if (!json_.contains("tolerances") || !json_.at("tolerances").contains(key)) return standard;
      return {number(json_.at("tolerances").at(key)), fmt::format("/tolerances/{}", key)};
    };
    const double target_mm = json_.at("target").value("uncertainty_mm", 0.0);
    ToleranceConfig t;
    t.target_mm =
        stated("target_mm", target_mm > 0.0 ? Tolerance{target_mm, "/target/uncertainty_mm"}
                                            : Tolerance{0.1, "default"});
    t.squareness_deg = stated("squareness_deg", {0.25, "default"});
    t.mounting_deg = stated("mounting_deg", {0.5, "default"});
    t.axes_deg = stated("axes_deg", {0.05, "default"});
    t.offset_mm = stated("offset_mm", {0.5, "default"});
    t.stage_scale = stated("stage_scale", {1e-4, "default"});
    return t;
  }

  /// One talker on a line: answers to two would be mixed. A Modbus gateway keeps its clients apart.
  void check_lines(const RigFile& rig, const TelemetryConfig& telemetry) const {
    const auto same = [](const LineConfig& a, const LineConfig& b) {
      return a.kind == b.kind && a.serial_port == b.serial_port && a.host == b.host &&
             a.tcp_port == b.tcp_port;
    };
    for (const ChannelConfig& channel : telemetry.channels) {
      if (channel.line.kind == LineConfig::Kind::kSimulated) continue;
      const std::string at = fmt::format("/telemetry/channels/{}/line", channel.name);
      for (const ControllerConfig& controller : rig.controllers)
        if (same(channel.line, controller.line) &&
            channel.line.kind != LineConfig::Kind::kModbusTcp)
          fail(at,
               fmt::format("is the line of controller {} (/controllers/{}/line), allowed: a line "
                           "of its own, or a Modbus gateway.",
                           controller.name, controller.name));
      for (const ChannelConfig& other : telemetry.channels)
        if (same(channel.line, other.line) &&
            (channel.source != other.source || channel.line.baud != other.line.baud ||
             channel.line.parity != other.line.parity ||
             channel.line.stop_bits != other.line.stop_bits))
          fail(at, fmt::format("is that of channel {} with another language or set-up, allowed: "
                               "the same for all channels of a line.",
                               other.name));
    }
  }

  TelemetryConfig telemetry(const RigFile& rig) const {
    const Json& t = json_.at("telemetry");
    TelemetryConfig telemetry;
    telemetry.every_s = t.value("every_s", telemetry.every_s);
    for (const auto& [name, c] : t.at("channels").items())
      telemetry.channels.push_back(channel(name, c));
    check_lines(rig, telemetry);
    return telemetry;
  }

  ChannelConfig channel(const std::string& name, const Json& c) const {
    using Source = ChannelConfig::Source;
    const std::string at = "/telemetry/channels/" + name;
    ChannelConfig channel;
    if (name.empty() || name.size() > 40 ||
        name.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789_") != name.npos)
      fail("/telemetry/channels",
           fmt::format("found the name \"{}\", allowed: 1 to 40 small letters, digits and _.",
                       name));
    for (const std::string_view taken :
         {"pose_id", "pose_index", "image_files", "rig_time_s", "trouble", "interruption", "reason",
          "session", "suspended", "elapsed_s", "time", "unix_time_s", "utc"})
      if (name == taken)
        fail(at, "is a name that journal and tables need themselves. Choose another.");
    channel.name = name;
    channel.unit = c.at("unit");
    if (std::ranges::any_of(channel.unit, [](unsigned char byte) { return byte < ' '; }))
      fail(at + "/unit", "found a control character, allowed: text on one line, such as \"degC\".");
    std::vector<std::string> sources;
    for (const auto& [key, source] :
         {std::pair("file", Source::kFile), std::pair("ask", Source::kAsk),
          std::pair("register", Source::kRegister), std::pair("simulated", Source::kSimulated)}) {
      if (!c.contains(key)) continue;
      channel.source = source;
      sources.emplace_back(key);
    }
    const bool wired = channel.source == Source::kAsk || channel.source == Source::kRegister;
    if (sources.size() != 1 || c.contains("line") != wired)
      fail(at,
           fmt::format("found {}{}, allowed: exactly one of \"file\", \"simulated\", \"ask\" "
                       "with a \"line\", and \"register\" with a \"line\".",
                       sources.empty() ? "no source" : fmt::format("{}", fmt::join(sources, ", ")),
                       c.contains("line") ? " with a line" : ""));
    for (const char* key : {"slave", "holding", "signed"})
      if (c.contains(key) && channel.source != Source::kRegister)
        fail(at + "/" + key, "means something only beside \"register\". Remove it.");
    if (channel.source == Source::kFile) channel.path = folder_ / c.at("file").get<std::string>();
    if (wired) channel.line = line(c.at("line"));
    if (wired && channel.line.kind == LineConfig::Kind::kSimulated)
      fail(at + "/line",
           "is simulated; a simulated channel needs none: state \"simulated\" instead.");
    channel.reply_timeout_s = c.value("reply_timeout_ms", 500.0) / 1000.0;
    channel.ask = c.value("ask", "");
    if (c.contains("decimal")) {
      if (channel.source != Source::kFile && channel.source != Source::kAsk)
        fail(at + "/decimal", "is for readings in text. Remove it.");
      channel.decimal = c.at("decimal") == "comma" ? Decimal::kComma : Decimal::kPoint;
    }
    channel.register_at = c.value("register", 0);
    channel.slave = c.value("slave", 1);
    channel.holding = c.value("holding", false);
    channel.is_signed = c.value("signed", false);
    if (channel.source == Source::kSimulated) {
      const Json& sine = c.at("simulated");
      channel.mean = sine.at("mean");
      channel.amplitude = sine.value("amplitude", 0.0);
      channel.period_s = sine.value("period_s", 3600.0);
    }
    channel.scale = c.value("scale", 1.0);
    channel.offset = c.value("offset", 0.0);
    if (c.contains("hold")) channel.hold = hold(at + "/hold", c.at("hold"));
    return channel;
  }

  ChannelConfig::Hold hold(const std::string& at, const Json& h) const {
    ChannelConfig::Hold hold;
    hold.lower = h.at("outside").at(0);
    hold.upper = h.at("outside").at(1);
    const Json& resume = h.contains("resume_inside") ? h.at("resume_inside") : h.at("outside");
    hold.resume_lower = resume.at(0);
    hold.resume_upper = resume.at(1);
    hold.for_s = h.value("for_s", 0.0);
    hold.give_up_s = h.value("give_up_s", 0.0);
    if (!(hold.lower < hold.upper))
      fail(at + "/outside",
           fmt::format("found [{}, {}], allowed: lower < upper. Put the lower first.", hold.lower,
                       hold.upper));
    if (!(hold.resume_lower < hold.resume_upper) || hold.resume_lower < hold.lower ||
        hold.resume_upper > hold.upper)
      fail(at + "/resume_inside",
           fmt::format(
               "found [{}, {}], allowed: lower < upper, and inside [{}, {}]: a band no wider "
               "than the one that is left.",
               hold.resume_lower, hold.resume_upper, hold.lower, hold.upper));
    return hold;
  }

  InspectionConfig inspection(const RigFile& rig) const {
    InspectionConfig inspection;
    // As near as the evaluation has to come to tell the LEDs apart.
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < rig.target.points_mm.size(); ++i)
      for (std::size_t j = i + 1; j < rig.target.points_mm.size(); ++j)
        nearest = std::min(nearest, (rig.target.points_mm[i] - rig.target.points_mm[j]).norm());
    inspection.max_residual_mm = 0.25 * nearest;
    if (!json_.contains("inspection")) return inspection;
    const Json& i = json_.at("inspection");
    inspection.retakes = i.value("retakes", inspection.retakes);
    inspection.max_blur_px = i.value("max_blur_px", inspection.max_blur_px);
    inspection.max_residual_mm = i.value("max_residual_mm", inspection.max_residual_mm);
    return inspection;
  }

  SimulationConfig simulation(const RigFile& rig) const {
    const Json& s = json_.at("simulation");
    SimulationConfig sim;
    sim.seed = s.at("seed");
    const Json& lens = s.at("lens");
    sim.lens.focal_px = lens.at("focal_px");
    sim.lens.principal_point_px = vector2(lens.at("principal_point_px"));
    if (lens.contains("radial")) sim.lens.radial = lens.at("radial").get<std::array<double, 3>>();
    if (lens.contains("decentring"))
      sim.lens.decentring = lens.at("decentring").get<std::array<double, 2>>();
    sim.lens.sensor_tilt_deg = vector2_or_zero(lens, "sensor_tilt_deg");
    sim.lens.pupil_walk_mm_per_rad2 = lens.value("pupil_walk_mm_per_rad2", 0.0);
    sim.camera_position_mm = s.contains("camera_position_mm")
                                 ? vector3(s.at("camera_position_mm"))
                                 : Vector3d(0, 0, rig.camera.nominal_height_mm);
    sim.camera_rotation_deg = vector3_or_zero(s, "camera_rotation_deg");
    sim.stage_squareness_deg = vector2_or_zero(s, "stage_squareness_deg");
    sim.plane_from_gimbal_deg = vector3_or_zero(s, "plane_from_gimbal_deg");
    sim.table_from_target_deg = vector3_or_zero(s, "table_from_target_deg");
    sim.target_offset_error_mm = vector3_or_zero(s, "target_offset_error_mm");
    if (s.contains("axis_errors_deg"))
      for (std::size_t i = 0; i < kRotaryAxes.size(); ++i)
        sim.axis_errors_deg[i] =
            vector3_or_zero(s.at("axis_errors_deg"), axis_name(kRotaryAxes[i]).data());
    sim.stage_scale = s.value("stage_scale", 1.0);
    sim.target_errors_mm.assign(rig.target.points_mm.size(), Vector3d::Zero());
    if (s.contains("target_errors_mm")) {
      const Json& errors = s.at("target_errors_mm");
      if (errors.size() != sim.target_errors_mm.size())
        fail("/simulation/target_errors_mm",
             fmt::format("found {} rows, allowed: one per target point, {}.", errors.size(),
                         sim.target_errors_mm.size()));
      for (std::size_t i = 0; i < errors.size(); ++i)
        sim.target_errors_mm[i] = vector3(errors.at(i));
    }
    for (const AxisId id : kAllAxes) {
      AxisTruth truth;
      const std::string name(axis_name(id)), unit(axis_unit(id));
      if (s.contains("axes") && s.at("axes").contains(name)) {
        const Json& a = s.at("axes").at(name);
        truth.repeatability = a.value("repeatability_" + unit, 0.0);
        truth.backlash = a.value("backlash_" + unit, 0.0);
        truth.worm_amplitude = a.value("worm_amplitude_" + unit, 0.0);
        truth.home_offset = a.value("home_offset_" + unit, 0.0);
      }
      sim.axes[id] = truth;
    }
    const Json& image = s.at("image");
    sim.image = {image.at("background_grey"),
                 image.at("led_peak_grey"),
                 image.at("circle_dark_grey"),
                 image.at("circle_bright_grey"),
                 image.at("blur_px"),
                 image.value("read_noise_grey", 0.0),
                 image.value("electrons_per_grey", 0.0)};
    return sim;
  }

  const Json& json_;
  std::string name_;
  const std::filesystem::path& folder_;
};

}  // namespace

std::string_view axis_name(AxisId axis) { return kAxisNames.at(static_cast<std::size_t>(axis)); }

AxisId axis_from_name(std::string_view name) {
  for (const AxisId id : kAllAxes)
    if (axis_name(id) == name) return id;
  throw std::out_of_range("no axis of this name");
}

std::string_view axis_unit(AxisId axis) { return axis == AxisId::kStage ? "mm" : "deg"; }

double AxisConfig::on_grid(double target) const {
  const double step = per_step();
  // Where pulses are coarser than what can be sent, each of them can be asked for.
  const double sent = sent_step > step ? sent_step * std::round(target / sent_step) : target;
  return step * static_cast<double>(std::llround(sent / step));
}

AxisConfig controller_side(const AxisConfig& axis) {
  AxisConfig seen = axis;
  if (!axis.reversed) return seen;
  seen.lower = -axis.upper;
  seen.upper = -axis.lower;
  seen.cable_lower = -axis.cable_upper;
  seen.cable_upper = -axis.cable_lower;
  seen.backlash = -axis.backlash;
  return seen;
}

std::optional<AxisBound> AxisConfig::bound_against(double position) const {
  if (!(position >= lower && position <= upper))
    return AxisBound{"soft limits", fmt::format("/axes/{}/limits_{}", axis_name(id), unit()), lower,
                     upper};
  if (!(position >= cable_lower && position <= cable_upper))
    return AxisBound{"cable range", fmt::format("/axes/{}/cable_{}", axis_name(id), unit()),
                     cable_lower, cable_upper};
  return {};
}

std::string_view payload_name(Payload payload) {
  return payload == Payload::kCirclePattern ? "circle_pattern" : "led_target";
}

std::string_view pattern_kind_name(PatternKind kind) {
  switch (kind) {
    case PatternKind::kCircles:
      return "circles";
    case PatternKind::kCircleGrid:
      return "circle_grid";
    case PatternKind::kAsymmetricCircles:
      return "asymmetric_circles";
    case PatternKind::kChessboard:
      return "chessboard";
  }
  return "?";
}

const ControllerConfig& RigFile::controller(const std::string& controller_name) const {
  return *std::ranges::find(controllers, controller_name, &ControllerConfig::name);
}

bool RigFile::simulated() const {
  return camera.model == "simulated" || camera.simulated ||
         std::ranges::any_of(telemetry.channels,
                             [](const ChannelConfig& c) {
                               return c.source == ChannelConfig::Source::kSimulated;
                             }) ||
         std::ranges::any_of(controllers, [](const ControllerConfig& c) {
           return c.line.kind == LineConfig::Kind::kSimulated;
         });
}

RigFile parse_rig_file(const std::string& text, const std::string& name,
                       const std::filesystem::path& folder) {
  const Json json = parse_json(text, name, "rig");
  RigFile rig = Reader(json, name, folder).read();
  rig.source = text;
  return rig;
}

PatternConfig parse_pattern(const Json& document, const std::string& name) {
  return Reader(document, name, {}).pattern();
}

RigFile load_rig_file(const std::filesystem::path& file) {
  return parse_rig_file(read_text(file), file.string(), file.parent_path());
}

}  // namespace turntable
