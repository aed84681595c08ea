#include "src/imaging/calibration.h"

#include <gtest/gtest.h>

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
  EXPECT_FALSE(c.pinhole.has_value());
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

TEST(Calibration, FileKeepsEveryDigit) {
  Calibration c = load_calibration(table1());
  c.pinhole = PinholeModel{1945.25, 1944.75, 517.5, 508.25,
                           {},      0.75,    15,    rotation_from_vector({3.1, 0.01, -0.02})};
  c.pinhole_distorted = *c.pinhole;
  c.pinhole_distorted->distortion = {-0.06, 0.1, 0.0003, -0.0002, 0.01};
  c.planes = {{0.0, false, 255, 0.002, 0.006}, {130.0, true, 210, 0.001, 0.002}};
  const Calibration back = parse_calibration(calibration_to_json(c), "copy");
  for (const Vector2d& p : {Vector2d(10, 20), Vector2d(512.25, 700.5)}) {
    EXPECT_EQ(back.irt.ray(p).at_a, c.irt.ray(p).at_a);
    EXPECT_EQ(back.irt.ray(p).at_b, c.irt.ray(p).at_b);
    EXPECT_EQ(back.pinhole_distorted->normalise(p), c.pinhole_distorted->normalise(p));
  }
  EXPECT_LT((back.pinhole->R_plane_from_camera - c.pinhole->R_plane_from_camera).norm(), 1e-12);
  EXPECT_EQ(back.planes.size(), 2u);
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

TEST(Pinhole, NormaliseUndoesItsOwnDistortion) {
  PinholeModel m{
      1000, 1000, 500, 500, {-0.2, 0.05, 0.001, -0.002, 0.01}, 0, 3, Matrix3d::Identity()};
  const Vector2d n = m.normalise({800, 300});
  const double r2 = n.squaredNorm();
  const double radial = 1 - 0.2 * r2 + 0.05 * r2 * r2 + 0.01 * r2 * r2 * r2;
  const double x = n.x() * radial + 2 * 0.001 * n.x() * n.y() - 0.002 * (r2 + 2 * n.x() * n.x());
  const double y = n.y() * radial + 0.001 * (r2 + 2 * n.y() * n.y()) - 2 * 0.002 * n.x() * n.y();
  EXPECT_NEAR(x, 0.3, 1e-9);
  EXPECT_NEAR(y, -0.2, 1e-9);
}

}  // namespace
}  // namespace turntable
