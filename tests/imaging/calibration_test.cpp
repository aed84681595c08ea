#include "src/imaging/calibration.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "src/core/json_document.h"

namespace turntable {
namespace {

std::string table1() {
  return std::string(TURNTABLE_SOURCE_DIR) + "/scenarios/calibrations/paper_table1.json";
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

TEST(Calibration, PublishedTable1LoadsWithVCountedUpward) {
  const Calibration c = load_calibration(table1());
  const auto [centre, spread] = c.irt.bundle_centre();
  // The page on handedness: centre about (43.5, -12.7, 700.2), rays within 0.46 mm rms.
  // (over another grid of pixels, hence the tolerance in z and in the spread).
  EXPECT_NEAR(centre.z(), 700.2, 0.5);
  EXPECT_NEAR(centre.x(), 43.5, 0.1);
  EXPECT_NEAR(centre.y(), -12.7, 0.1);
  EXPECT_NEAR(spread, 0.46, 0.1);
  EXPECT_TRUE(c.central.empty());
  EXPECT_EQ(c.find_central("pinhole"), nullptr);
  EXPECT_EQ(c.undistorting(), nullptr);
}

TEST(Calibration, PublishedTable1WithVCountedDownwardIsRefusedClearly) {
  const std::string text =
      replaced(read_text(table1()), "\"v_direction\": \"up\"", "\"v_direction\": \"down\"");
  try {
    parse_calibration(text, "table1_down.json");
    FAIL() << "accepted";
  } catch (const ConfigError& e) {
    const std::string what = e.what();
    EXPECT_NE(what.find("table1_down.json"), std::string::npos);
    EXPECT_NE(what.find("left-handed"), std::string::npos);
    EXPECT_NE(what.find("\"v_direction\": \"up\""), std::string::npos);
  }
}

CentralModel central(CentralKind kind) {
  CentralModel m;
  m.kind = kind;
  m.fx = 1945.25;
  m.fy = 1944.0 + 1.0 / 3.0;
  m.cx = 517.1;
  m.cy = 508.7;
  const std::vector<double> all{-0.06, 0.1, 0.0003, -0.0002, 0.01, 1e-3, 0.02, -0.03};
  m.distortion.assign(all.begin(),
                      all.begin() + static_cast<std::ptrdiff_t>(distortion_terms(kind)));
  m.rms_px = 0.1 + 0.2;
  m.views = 15;
  m.R_plane_from_camera = rotation_from_vector({3.1, 0.01, -0.02});
  m.centre_mm = {43.49, -12.67, 700.45};
  m.lean = {0.00035, -0.000175};
  m.tied_to_plane = true;
  m.image_size = {1024, 1024};
  return m;
}

/// With every part of the file, in numbers that binary fractions do not hold exactly.
Calibration full() {
  Calibration c = load_calibration(table1());
  c.sigma_mm = 0.1;
  c.points = 450;
  c.loo_rms_mm = 0.7;
  c.chi2_per_dof = 1.1;
  c.condition = 2.9;
  c.max_leverage = 0.3;
  for (const CentralKind kind : kCentralKinds) c.central.push_back(central(kind));
  c.planes = {{0.0, false, 255, 0.002, 0.006}, {130.0, true, 210, 0.001, 0.002}};
  PlanePoint outlier;
  outlier.pixel_px = {1.0 / 3.0, 2.0 / 3.0};
  outlier.z_mm = 130.0;
  outlier.column = -3;
  outlier.row = 4;
  c.outliers = {outlier};
  c.stage = {{130.0, 130.0003, 2, -0.0004}, {180.0, 179.9998, 1, 0.0}};
  ModelRow irt;
  irt.name = "irt";
  irt.parameters = 84;
  irt.fit_rms_mm = 0.0021;
  irt.fit_max_mm = 0.0065;
  irt.held_out_rms_mm = 0.0033;
  irt.held_out_max_mm = 0.0084;
  irt.held_out_rms_px = 0.0091;
  irt.held_out_max_px = 0.023;
  ModelRow fisheye;
  fisheye.name = "fisheye";
  fisheye.why_not = "no \"view\" at zero table angles";
  c.models = {irt, fisheye};
  c.images = {{"images/0001.png", std::string(64, 'a')}};
  return c;
}

TEST(Calibration, FileKeepsEveryDigit) {
  const Calibration c = full();
  const std::string text = calibration_to_json(c);
  const Calibration back = parse_calibration(text, "copy");
  EXPECT_EQ(calibration_to_json(back), text);
  EXPECT_EQ(back.irt.coefficients(), c.irt.coefficients());
  for (const CentralModel& m : c.central) {
    const CentralModel* read = back.find_central(central_name(m.kind));
    ASSERT_NE(read, nullptr);
    EXPECT_EQ(read->distortion, m.distortion);
    EXPECT_EQ(read->fy, m.fy);
    EXPECT_EQ(read->rms_px, m.rms_px);
    EXPECT_EQ(read->R_plane_from_camera, m.R_plane_from_camera);
    EXPECT_EQ(read->centre_mm, m.centre_mm);
    EXPECT_EQ(read->lean, m.lean);
    EXPECT_EQ(read->tied_to_plane, m.tied_to_plane);
    EXPECT_EQ(read->image_size, m.image_size);
  }
  EXPECT_EQ(back.undistorting(), back.find_central("brown"));
  EXPECT_EQ(back.loo_rms_mm, c.loo_rms_mm);
  EXPECT_EQ(back.chi2_per_dof, c.chi2_per_dof);
  EXPECT_EQ(back.condition, c.condition);
  EXPECT_EQ(back.max_leverage, c.max_leverage);
  ASSERT_EQ(back.planes.size(), 2u);
  EXPECT_EQ(back.outliers.at(0).pixel_px, c.outliers[0].pixel_px);
  ASSERT_EQ(back.stage.size(), 2u);
  EXPECT_EQ(back.stage[0].stage_mm, 130.0003);
  EXPECT_EQ(back.stage[0].drift_mm, -0.0004);
  ASSERT_EQ(back.models.size(), 2u);
  EXPECT_EQ(back.models[0].held_out_max_px, 0.023);
  EXPECT_TRUE(std::isnan(back.models[1].held_out_max_px));
  EXPECT_EQ(back.models[1].why_not, c.models[1].why_not);
  EXPECT_EQ(back.images.at(0).sha256, c.images[0].sha256);
}

TEST(Calibration, WhatIsNotKnownIsLeftOutOfTheFile) {
  const std::string text = calibration_to_json(load_calibration(table1()));
  for (const char* key : {"null", "loo_rms_mm", "chi2_per_dof", "central", "models", "stage"})
    EXPECT_EQ(text.find(key), std::string::npos) << key;
  EXPECT_TRUE(std::isnan(parse_calibration(text, "copy").chi2_per_dof));
}

TEST(Calibration, EveryMisuseOfItsPartsIsRefusedWithThePlace) {
  const Json whole = Json::parse(calibration_to_json(full()));
  const auto at = [](const char* pointer) { return Json::json_pointer(pointer); };
  for (const auto& [place, value, pointer] :
       {std::tuple<const char*, Json, const char*>{"/central/1/distortion", Json{1, 2}, nullptr},
        {"/central/0/distortion", Json{0.1}, nullptr},
        {"/central/0/model", "brown", "/central/0/distortion"},
        {"/central/2", whole.at("central").at(1), "/central/2/model"},
        {"/central/3/model", "thick", nullptr},
        {"/central/1/fx_px", 0, nullptr},
        {"/central/1/views", -1, nullptr},
        {"/central/1/centre_mm", Json{1, 2}, nullptr},
        {"/central/1/lean", Json{1}, nullptr},
        {"/central/1/R_plane_from_camera", Json{{1, 0, 0}, {0, 1, 0}, {0, 0, -1}}, nullptr},
        {"/central/1/R_plane_from_camera", Json{{1, 0, 0}, {0, 1, 0}, {0, 0.01, 1}}, nullptr},
        {"/models/0/fit_rms_mm", -1, nullptr},
        {"/models/0/parameters", "many", nullptr},
        {"/stage/0/visits", 0, nullptr},
        {"/stage/1/read_back_mm", "here", nullptr},
        {"/images/0/sha256", "abc", nullptr},
        {"/irt/chi2_per_dof", -0.1, nullptr},
        {"/irt/planes/1/fitted", 1, nullptr},
        {"/irt/outliers/0/pixel_px", Json{1}, nullptr},
        {"/irt/domain_px", Json{{0, 0}, {1, 1}}, nullptr}}) {
    Json damaged = whole;
    damaged[at(place)] = value;
    try {
      parse_calibration(damaged.dump(), "camera.json");
      ADD_FAILURE() << "accepted " << value.dump() << " at " << place;
    } catch (const ConfigError& e) {
      EXPECT_EQ(e.pointer(), pointer ? pointer : place) << e.what();
      EXPECT_EQ(e.file(), "camera.json");
      EXPECT_NE(e.message().find("found"), std::string::npos) << e.what();
      EXPECT_NE(e.message().find("allowed"), std::string::npos) << e.what();
    }
  }
}

TEST(Calibration, DamagedFilesAreRefusedWithThePlace) {
  const std::string text = read_text(table1());
  for (const auto& [from, to, place] :
       {std::tuple{"\"order\": 5", "\"order\": 4", "/irt/terms"},
        {"\"order\": 5", "\"order\": \"five\"", "/irt/order"},
        {"[0, 0], ", "[0, 1], ", "/irt/terms/1"},
        {"\"plane_b_mm\": 180", "\"plane_b_mm\": 130", "/irt/plane_b_mm"},
        {"\"source\"", "\"sauce\"", "/"},
        {"1024, 1024", "1024", "/image_size_px"},
        {"\"basis\": \"monomial\"", "\"basis\": \"legendre\"", "/irt/v_direction"}}) {
    try {
      parse_calibration(replaced(text, from, to), "camera.json");
      ADD_FAILURE() << "accepted " << to;
    } catch (const ConfigError& e) {
      EXPECT_EQ(e.pointer(), place) << e.what();
      EXPECT_EQ(e.file(), "camera.json");
    }
  }
}

}  // namespace
}  // namespace turntable
