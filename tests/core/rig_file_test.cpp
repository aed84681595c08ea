#include "src/core/rig_file.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <limits>

#include "src/core/errors.h"

namespace turntable {
namespace {

const std::filesystem::path kRigs = std::filesystem::path(TURNTABLE_SOURCE_DIR) / "scenarios/rigs";

std::string text_of(const char* name) { return read_text(kRigs / name); }

TEST(RigFile, EveryShippedOneLoads) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kRigs)) {
    if (entry.path().extension() != ".json") continue;
    EXPECT_NO_THROW(load_rig_file(entry.path())) << entry.path();
    ++count;
  }
  EXPECT_GE(count, 3);
}

TEST(RigFile, TakesDefaultsFromTheStageTableAndOverridesThem) {
  const RigFile rig = load_rig_file(kRigs / "simulated.json");
  EXPECT_DOUBLE_EQ(rig.axis(AxisId::kYaw).per_step(), 0.00125);
  EXPECT_DOUBLE_EQ(rig.axis(AxisId::kYaw).speed, 25.0);
  EXPECT_DOUBLE_EQ(rig.axis(AxisId::kYaw).repeatability, 0.005);
  EXPECT_DOUBLE_EQ(rig.axis(AxisId::kStage).repeatability, 0.003);
  EXPECT_DOUBLE_EQ(rig.axis(AxisId::kRoll).upper, 45.0);
  EXPECT_TRUE(rig.simulated());
}

TEST(RigFile, TakesWhereTheCableStaysFreeAndThenLetsATableTurnOn) {
  std::string text = text_of("simulated.json");
  const std::string limits = "\"limits_deg\": [-90, 90]";
  EXPECT_FALSE(parse_rig_file(text, "rig.json", kRigs).axis(AxisId::kYaw).has_cable());
  text.replace(text.find(limits), limits.size(),
               "\"limits_deg\": [-500, 500], \"cable_deg\": [-400, 300]");
  const RigFile rig = parse_rig_file(text, "rig.json", kRigs);
  const AxisConfig& yaw = rig.axis(AxisId::kYaw);
  EXPECT_DOUBLE_EQ(yaw.reach_lower(), -400);
  EXPECT_DOUBLE_EQ(yaw.reach_upper(), 300);
  EXPECT_FALSE(yaw.bound_against(300).has_value());
  EXPECT_EQ(yaw.bound_against(301).value().place, "/axes/yaw/cable_deg");
  EXPECT_EQ(yaw.bound_against(501).value().place, "/axes/yaw/limits_deg");
  EXPECT_TRUE(yaw.bound_against(std::numeric_limits<double>::quiet_NaN()).has_value());
}

TEST(RigFile, SaysOfEachToleranceWhereItComesFrom) {
  std::string text = text_of("simulated.json");
  const ToleranceConfig none = parse_rig_file(text, "rig.json", kRigs).tolerances;
  EXPECT_EQ(none.target_mm.sd, 0.1);
  EXPECT_EQ(none.target_mm.source, "default");
  EXPECT_EQ(none.stage_scale.sd, 1e-4);
  text.replace(text.find("\"led_radius_mm\""), 0, "\"uncertainty_mm\": 0.02, ");
  EXPECT_EQ(parse_rig_file(text, "rig.json", kRigs).tolerances.target_mm.sd, 0.02);
  EXPECT_EQ(parse_rig_file(text, "rig.json", kRigs).tolerances.target_mm.source,
            "/target/uncertainty_mm");
  text.replace(text.find("\"calibration\""), 0,
               "\"tolerances\": {\"target_mm\": 0.03, \"axes_deg\": 0.01}, ");
  const ToleranceConfig stated = parse_rig_file(text, "rig.json", kRigs).tolerances;
  EXPECT_EQ(stated.target_mm.sd, 0.03);
  EXPECT_EQ(stated.target_mm.source, "/tolerances/target_mm");
  EXPECT_EQ(stated.axes_deg.sd, 0.01);
  EXPECT_EQ(stated.squareness_deg.source, "default");
}

struct Slip {
  std::string from, to, pointer, says;
};

TEST(RigFile, EverySlipIsNamedWithItsPlace) {
  const std::string text = text_of("simulated.json");
  const std::vector<Slip> slips{
      {"\"seed\": 20190511,", "", "/simulation", "\"seed\" is missing"},
      {"\"calibration\"", "\"tolerances\": {\"axes_deg\": 0}, \"calibration\"",
       "/tolerances/axes_deg", "found 0"},
      {"\"stage_squareness_deg\"", "\"stage_scale\": 2, \"stage_squareness_deg\"",
       "/simulation/stage_scale", "found 2"},
      {"\"seed\"", "\"sede\"", "/simulation", "unknown key \"sede\""},
      {"\"retries\": 2", "\"retries\": \"two\"", "/camera/retries", "found \"two\""},
      {"\"zolix-rak200\"", "\"rak-9000\"", "/axes/yaw/stage", "zolix-rak200"},
      {"\"controller\": \"mc1\", \"channel\": \"Y\"", "\"controller\": \"mc2\", \"channel\": \"Y\"",
       "/axes/yaw/controller", "mc1"},
      {"[-1, 200]", "[-1, 200], \"direction\": 0", "/axes/stage/direction", "found 0"},
      {"[-90, 90]", "[-90, 90], \"direction\": -1", "/axes/yaw", "direction"},
      {"\"model\": \"simulated\"", "\"model\": \"simulated\", \"latency_ms\": 5",
       "/camera/latency_ms", "does not use it"},
      {"\"model\": \"simulated\"",
       "\"model\": \"folder\", \"folder\": \".\", \"replay\": true, \"latency_ms\": 5",
       "/camera/latency_ms", "still to come"},
      {"\"model\": \"simulated\"", "\"model\": \"gige\", \"exposure_us\": 500000",
       "/camera/exposure_us", "less than frame_timeout_ms, 500 ms"},
      {"[-90, 90]", "[90, -90]", "/axes/yaw/limits_deg", "lower < upper"},
      {"[-90, 90]", "[-900, 900]", "/axes/yaw/limits_deg", "inside the travel"},
      {"[-90, 90]", "[-900, 900]", "/axes/yaw/limits_deg", "cable_deg"},
      {"[-90, 90]", "[-90, 90], \"cable_deg\": [10, 200]", "/axes/yaw/cable_deg",
       "with 0 between them"},
      {"[-90, 90]", "[-90, 90], \"cable_deg\": [200, -200]", "/axes/yaw/cable_deg",
       "lower < upper"},
      {"[-90, 90]", "[-90, 90], \"cable_deg\": [-0.4, 0.4]", "/axes/yaw",
       "limits and cable, together [-0.4, 0.4] deg leave no room"},
      {"[-90, 90]", "[-90, 90], \"cable_deg\": [-180, \"far\"]", "/axes/yaw/cable_deg/1",
       "found \"far\""},
      {"[-1, 200]", "[-1, 200], \"cable_deg\": [-1, 1]", "/axes/stage", "cable_deg"},
      {"\"channel\": \"Y\"", "\"channel\": \"Z\"", "/axes/roll/channel", "already turns"},
      {"[-18.0, -57.2, -40]", "[-18.0, -57.2, \"-40\"]", "/target/points_mm/3/2", "found \"-40\""},
      {", [-18.0, -57.2, -40]", "", "/target/points_mm", "minItems 4"},
      {"[[0, 0, 0], [58.6, 13.0, -40], [-40.6, 44.2, -40], [-18.0, -57.2, -40]]",
       "[[0, 0, 0], [58.6, 13.0, 0], [-40.6, 44.2, 0], [-18.0, -57.2, 0]]", "/target/points_mm",
       "one plane"},
      {"[[0, 0, 0], [58.6", "[[1, 0, 0], [58.6", "/target/points_mm/0", "M0"},
      {"\"led_radius_mm\"", "\"uncertainty_mm\": -0.01, \"led_radius_mm\"",
       "/target/uncertainty_mm", "found -0.01"},
      {"[0, 0], [-1, 1], [2, 1], [0, 4]", "[0, 0], [-1, 1], [2, 1], [0, 3]",
       "/pattern/direction_circles", "ambiguous"},
      {"[0, 0], [-1, 1], [2, 1], [0, 4]", "[0, 0], [-1, 1], [2, 1], [0, 40]",
       "/pattern/direction_circles/3", "off the pattern"},
      {"\"direction_radius_mm\": 7", "\"direction_radius_mm\": 5.1", "/pattern/direction_radius_mm",
       "1.15"},
      {"\"offset_mm\": [0, 0, 0]\n  },\n  \"target\"",
       "\"offset_mm\": [0, 0, 3]\n  },\n  \"target\"", "/pattern/offset_mm", "add up to zero"},
      {"\"pattern\": {", "\"pattern\": {\n    \"kind\": \"circle_grid\",",
       "/pattern/direction_radius_mm", "means nothing with kind circle_grid"},
      {"\"pattern\": {", "\"pattern\": {\n    \"kind\": \"chessboard\",", "/pattern/radius_mm",
       "means nothing with kind chessboard"},
      {"\"direction_radius_mm\": 7,", "", "/pattern", "kind circles needs it"},
      {"\"roll\": [0, 1, 0]", "\"roll\": [0, 1, 1]", "/gimbal/axes", "right angles"},
      {"\"format\": \"turntable-rig/1\"", "\"format\": \"turntable-scenario/1\"", "/format",
       "not a rig file"},
      {"\"electrons_per_grey\": 40,", "\"electrons_per_grey\": 0,", "/camera/electrons_per_grey",
       "electrons_per_grey"},
      {"\"seed\": 20190511,", "\"seed\": 1, \"seed\": 2,", "", "\"seed\" stands twice"},
      {"\"nominal_focal_px\": 1945", "\"nominal_focal_px\": NaN", "", "not valid JSON at line"},
      {"\"nominal_focal_px\": 1945", "\"nominal_focal_px\": 1e999", "", "number overflow"},
  };
  for (const Slip& slip : slips) {
    std::string broken = text;
    const auto at = broken.find(slip.from);
    ASSERT_NE(at, std::string::npos) << slip.from;
    broken.replace(at, slip.from.size(), slip.to);
    try {
      parse_rig_file(broken, "rig.json", kRigs);
      ADD_FAILURE() << "accepted: " << slip.to;
    } catch (const ConfigError& e) {
      EXPECT_EQ(e.file(), "rig.json");
      EXPECT_EQ(e.pointer(), slip.pointer) << e.what();
      EXPECT_NE(std::string(e.what()).find(slip.says), std::string::npos) << e.what();
    }
  }
}

/// simulated.json with another camera; `more` are its own keys.
RigFile with_camera(const std::string& more) {
  std::string text = text_of("simulated.json");
  const std::string model = "\"model\": \"simulated\"";
  text.replace(text.find(model), model.size(), more);
  return parse_rig_file(text, "rig.json", kRigs);
}

/// The ideal rig with one more section.
RigFile rig_with(const std::string& section) {
  std::string text = text_of("ideal.json");
  const std::string before = "\"simulation\": {";
  text.insert(text.find(before), section + ", ");
  return parse_rig_file(text, "rig.json", kRigs);
}

TEST(RigFile, TakesChannelsOfTelemetryWithTheirBands) {
  const RigFile rig = rig_with(R"("telemetry": {"every_s": 5, "channels": {
      "room": {"unit": "degC", "file": "temp", "scale": 0.001,
               "hold": {"outside": [19, 23], "resume_inside": [20, 22], "for_s": 60, "give_up_s": 900}},
      "granite": {"unit": "degC", "ask": "T?", "line": {"tcp": {"host": "here", "port": 7777}}},
      "air": {"unit": "hPa", "register": 3, "slave": 4, "signed": true, "holding": true,
              "line": {"serial": {"port": "/dev/ttyUSB3"}}}}})");
  ASSERT_EQ(rig.telemetry.channels.size(), 3u);
  EXPECT_EQ(rig.telemetry.every_s, 5.0);
  for (const ChannelConfig& channel : rig.telemetry.channels) {
    if (channel.name == "room") {
      EXPECT_EQ(channel.path, kRigs / "temp");
      ASSERT_TRUE(channel.hold);
      EXPECT_EQ(channel.hold->resume_upper, 22.0);
      EXPECT_EQ(channel.hold->give_up_s, 900.0);
    }
    if (channel.name == "granite") {
      EXPECT_EQ(channel.source, ChannelConfig::Source::kAsk);
    }
    if (channel.name == "air") {
      EXPECT_EQ(channel.source, ChannelConfig::Source::kRegister);
      EXPECT_TRUE(channel.holding && channel.is_signed);
    }
  }
  EXPECT_EQ(rig_with(R"("inspection": {"retakes": 5})").inspection.retakes, 5);
}

TEST(RigFile, RefusesTelemetryThatMakesNoSense) {
  const auto refused = [](const std::string& channel) {
    try {
      rig_with(R"("telemetry": {"channels": {"room": {"unit": "degC", )" + channel + "}}}");
    } catch (const ConfigError& e) {
      return e.pointer();
    }
    return std::string("taken");
  };
  const std::string at = "/telemetry/channels/room";
  EXPECT_EQ(refused(R"("scale": 2)"), at);
  EXPECT_EQ(refused(R"("file": "a", "ask": "T?")"), at);
  EXPECT_EQ(refused(R"("ask": "T?")"), at);
  EXPECT_EQ(refused(R"("file": "a", "line": {"tcp": {"host": "b", "port": 1}})"), at);
  EXPECT_EQ(refused(R"("file": "a", "slave": 2)"), at + "/slave");
  EXPECT_EQ(refused(R"("file": "a", "decimal": "dot")"), at + "/decimal");
  EXPECT_EQ(refused(R"("simulated": {"mean": 1}, "decimal": "comma")"), at + "/decimal");
  EXPECT_EQ(refused(R"("file": "a", "decimal": "comma")"), "taken");
  EXPECT_EQ(refused(R"("file": "a", "hold": {"outside": [3, 2]})"), at + "/hold/outside");
  EXPECT_EQ(refused(R"("file": "a", "hold": {"outside": [2, 3], "resume_inside": [1, 2.5]})"),
            at + "/hold/resume_inside");
  EXPECT_EQ(refused(R"("file": "a", "hold": {"outside": [2, 3], "resume_inside": [2.5, 2.5]})"),
            at + "/hold/resume_inside");
  EXPECT_EQ(refused(R"("ask": "T?", "line": {"simulated": {}})"), at + "/line");
  EXPECT_EQ(refused(R"("file": "a"}, "Temp": {"unit": "1", "file": "b")"), "/telemetry/channels");
  EXPECT_EQ(refused(R"("file": "a"}, "pose_id": {"unit": "1", "file": "b")"),
            "/telemetry/channels/pose_id");
  const std::string port = R"("line": {"serial": {"port": "/dev/ttyUSB9"}})";
  EXPECT_EQ(
      refused(R"("ask": "T?", )" + port + R"(}, "water": {"unit": "degC", "register": 1, )" + port),
      at + "/line");
}

TEST(RigFile, RefusesTelemetryOnAControllersLine) {
  std::string text = text_of("lab_example.json");
  const std::string before = "\"calibration\":";
  const auto serial = text.find("\"serial\"");
  const std::string line = text.substr(serial, text.find('}', serial) - serial + 1);
  ASSERT_NE(text.find(before), std::string::npos);
  text.insert(text.find(before),
              R"("telemetry": {"channels": {"room": {"unit": "degC", "ask": "T?", )"
              R"("line": {)" +
                  line + "}}}}, ");
  try {
    parse_rig_file(text, "rig.json", kRigs);
    ADD_FAILURE() << "taken";
  } catch (const ConfigError& e) {
    EXPECT_EQ(e.pointer(), "/telemetry/channels/room/line");
  }
}

TEST(RigFile, TakesAVideoFileFromBesideItselfAndADeviceAsItIs) {
  const auto device = [](const std::string& name) {
    return with_camera(R"("model": "usb", "device": ")" + name + "\"").camera.device;
  };
  EXPECT_EQ(device("shots/%03d.png"), (kRigs / "shots/%03d.png").string());
  EXPECT_EQ(device("/dev/video2"), "/dev/video2");
  EXPECT_EQ(device("2"), "2");
  const RigFile rig = with_camera(R"("model": "usb", "device": "0", "stale_frames": 0)");
  EXPECT_EQ(rig.camera.stale_frames, 0);
  EXPECT_FALSE(with_camera(R"("model": "usb", "device": "0")").camera.stale_frames.has_value());
}

TEST(RigFile, RefusesCameraKeysThatWouldNotBeLookedAt) {
  const std::string folder = R"("model": "folder", "folder": "x", )";
  for (const auto& [more, pointer] : std::vector<std::pair<std::string, std::string>>{
           {folder + R"("layout": "{point}.png")", "/camera/layout"},
           {folder + R"("replay": true, "layout": "{point}.png", "files": "*.png")",
            "/camera/files"},
           {folder + R"("replay": true, "layout": "{point}.png", "order": "time")",
            "/camera/order"},
           {folder + R"("stale_frames": 1)", "/camera/stale_frames"},
           {R"("model": "usb", "device": "0", "files": "*")", "/camera/files"},
           {R"("model": "usb")", "/camera/device"}})
    try {
      with_camera(more);
      ADD_FAILURE() << "accepted: " << more;
    } catch (const ConfigError& e) {
      EXPECT_EQ(e.pointer(), pointer) << e.what();
    }
}

TEST(RigFile, CountsShotNoiseOnlyIfTheCamerasElectronsAreStated) {
  EXPECT_EQ(load_rig_file(kRigs / "simulated.json").camera.electrons_per_grey, 40.0);
  EXPECT_EQ(load_rig_file(kRigs / "lab_example.json").camera.electrons_per_grey, 0.0);
}

TEST(RigFile, ThatIsNotThereIsNamed) {
  EXPECT_THROW(load_rig_file("/nowhere/rig.json"), ConfigError);
  EXPECT_THROW(load_rig_file(kRigs), ConfigError);
  EXPECT_THROW(parse_rig_file("", "empty.json", kRigs), ConfigError);
}

TEST(RigFile, FindsAControllersDescriptionByNameOrBesideItself) {
  std::string text = text_of("lab_example.json");
  EXPECT_EQ(parse_rig_file(text, "rig.json", kRigs).controllers.front().description, "");
  const std::string line = "\"line\"";
  text.insert(text.find(line, text.find("\"controllers\"")), "\"description\": \"zaber_ascii\", ");
  EXPECT_EQ(parse_rig_file(text, "rig.json", kRigs).controllers.front().description, "zaber_ascii");
  text.replace(text.find("zaber_ascii"), 11, "own/mine.json");
  EXPECT_EQ(parse_rig_file(text, "rig.json", kRigs).controllers.front().description,
            (kRigs / "own/mine.json").string());
}

TEST(RigFile, MayNameOneBitOfARegisterAsAnOutput) {
  const auto outputs = [](const std::string& output) {
    std::string text = text_of("lab_modbus_gige.json");
    const std::string here = R"({"register": 30064, "bit": 0, "on": 1, "off": 0, "pulse_ms": 5})";
    text.replace(text.find(here), here.size(), output);
    return parse_rig_file(text, "rig.json", kRigs).controllers[0].outputs.at(0);
  };
  const OutputConfig third = outputs(R"({"register": 30064, "bit": 2, "on": 0, "off": 1})");
  EXPECT_EQ(third.mask(), 4);
  EXPECT_EQ(third.bits(true), 0);
  EXPECT_EQ(third.bits(false), 4);
  EXPECT_EQ(outputs(R"({"register": 30064, "on": 6, "off": 2})").mask(), 4);
  for (const char* wrong : {R"({"register": 30064, "bit": 16, "on": 1, "off": 0})",
                            R"({"register": 30064, "bit": 0, "on": 2, "off": 0})",
                            R"({"register": 30064, "bit": 0, "on": 1, "off": 1})",
                            R"({"bit": 0, "on": "Open", "off": "Close"})"})
    EXPECT_THROW(outputs(wrong), ConfigError) << wrong;
}

}  // namespace
}  // namespace turntable
