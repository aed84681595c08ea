// solve, measure and track through the program.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cmath>
#include <numbers>
#include <sstream>

#include "src/core/json_document.h"
#include "src/core/rig_file.h"
#include "src/geometry/gimbal.h"
#include "src/record/image_archive.h"
#include "src/record/number_table.h"
#include "tests/app/background_program.h"
#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr double kRad = std::numbers::pi / 180.0;
const std::string kPublished = "scenarios/targets/published.json";
const std::vector<Vector3d> kLeds{
    {0, 0, 0}, {58.6, 13, -40}, {-40.6, 44.2, -40}, {-18, -57.2, -40}};

using Rows = std::vector<std::map<std::string, std::string>>;

/// A table as the program prints it. Text that is no row of it (progress, errors) fails.
Rows table_of(const std::string& text) {
  std::istringstream in(text);
  Rows rows;
  std::vector<std::string> header;
  for (std::string line; std::getline(in, line);) {
    std::vector<std::string> cells;
    std::istringstream cell_by_cell(line + ",");
    for (std::string cell; std::getline(cell_by_cell, cell, ',');) cells.push_back(cell);
    if (header.empty()) {
      header = cells;
      continue;
    }
    EXPECT_EQ(cells.size(), header.size()) << line;
    auto& row = rows.emplace_back();
    for (std::size_t i = 0; i < std::min(cells.size(), header.size()); ++i)
      row[header[i]] = cells[i];
  }
  return rows;
}

/// Of track: without what it says at the end, on standard error.
std::string without_summary(const std::string& output) {
  const std::size_t at = output.rfind('\n', output.size() - 2);
  EXPECT_THAT(output.substr(at + 1), HasSubstr(" lost; latency median "));
  return output.substr(0, at + 1);
}

double number_in(const std::map<std::string, std::string>& row, const std::string& column) {
  return std::stod(row.at(column));
}

Matrix3d rotation_in(const std::map<std::string, std::string>& row) {
  return Eigen::Quaterniond(number_in(row, "qw"), number_in(row, "qx"), number_in(row, "qy"),
                            number_in(row, "qz"))
      .toRotationMatrix();
}

// ---- points

/// A pinhole of somebody who has no rig, and points that it sees.
class PointsOfAPinhole : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<TemporaryFolder>();
    spill(*folder_ / "camera.yml", R"(%YAML:1.0
---
image_width: 1024
image_height: 1024
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1945., 0., 511.5, 0., 1945., 511.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0., 0., 0., 0., 0. ]
)");
    const Outcome made =
        turntable_program("calibrate " + (*folder_ / "camera.yml").string() +
                          " --planes -625,-575 --out " + (*folder_ / "camera").string());
    ASSERT_EQ(made.code, 0) << made.output;
  }
  static void TearDownTestSuite() { folder_.reset(); }

  static Vector2d pixel_of(int point, const Matrix3d& R, const Vector3d& at) {
    const Vector3d p = R * kLeds[static_cast<std::size_t>(point)] + at;
    return {511.5 - 1945.0 * p.x() / p.z(), 511.5 + 1945.0 * p.y() / p.z()};
  }
  static std::string with_camera(const std::string& more = "") {
    return " --calibration " + (*folder_ / "camera/calibration.json").string() +
           (more.find("--target") == std::string::npos ? " --target " + kPublished : "") + " " +
           more;
  }
  static std::string solve(const std::string& points, const std::string& more = "") {
    spill(*folder_ / "points.csv", points);
    return "solve " + (*folder_ / "points.csv").string() + with_camera(more);
  }
  static inline std::unique_ptr<TemporaryFolder> folder_;

  const Matrix3d R_ = rotation_from_vector({0.2, -0.3, 0.4});
  const Vector3d at_{5, -8, -590};
  /// Frame 7 by name with points in another order, frame 3 without the last point.
  std::string named_points() const {
    std::string text = "frame,point,u_px,v_px,sigma_px\n";
    for (const auto& [frame, point] :
         {std::pair{7, 2}, {7, 0}, {7, 3}, {7, 1}, {3, 0}, {3, 1}, {3, 2}}) {
      const Vector2d p = pixel_of(point, R_, at_);
      text += fmt::format("{},{},{:.9f},{:.9f},0.02\n", frame, point, p.x(), p.y());
    }
    return text;
  }
};

TEST_F(PointsOfAPinhole, BecomeAttitudesFrameByFrame) {
  const Outcome outcome = turntable_program(solve(named_points()));
  EXPECT_EQ(outcome.code, 4);
  const Rows rows = table_of(outcome.output);
  ASSERT_EQ(rows.size(), 2u) << outcome.output;
  EXPECT_EQ(rows[0].at("frame"), "7");
  EXPECT_EQ(rows[0].at("status"), "converged");
  EXPECT_LT(geodesic_angle(rotation_in(rows[0]), R_), 1e-5 * kRad);
  EXPECT_NEAR(number_in(rows[0], "rx_deg"), 0.2 / kRad, 1e-5);
  EXPECT_NEAR(number_in(rows[0], "z_mm"), -590.0, 1e-3);
  // f = 1945 px at 590 mm: 0.3 mm per px, 0.006 mm for a spot, on a target of 60 mm.
  EXPECT_GT(number_in(rows[0], "std_rx_deg"), 0.002);
  EXPECT_LT(number_in(rows[0], "std_rx_deg"), 0.05);
  EXPECT_EQ(rows[0].at("in_domain"), "1");
  EXPECT_EQ(rows[1].at("frame"), "3");
  EXPECT_EQ(rows[1].at("status"), "too few spots: 3 of 4");
  EXPECT_EQ(rows[1].at("qw"), "");
}

TEST_F(PointsOfAPinhole, AnglesAreThoseOfTheGimbal) {
  const Outcome outcome = turntable_program(solve(named_points()));
  const auto row = table_of(outcome.output).at(0);
  const RigFile rig = load_rig_file("scenarios/rigs/simulated.json");
  const GimbalAngles angles = Gimbal(rig.gimbal).angles(R_);
  EXPECT_NEAR(number_in(row, "yaw_deg"), angles.yaw / kRad, 1e-5);
  EXPECT_NEAR(number_in(row, "roll_deg"), angles.roll / kRad, 1e-5);
  EXPECT_NEAR(number_in(row, "pitch_deg"), angles.pitch / kRad, 1e-5);
}

TEST_F(PointsOfAPinhole, InAnyOrderAreFoundAmongOthersByEverySolver) {
  std::string points = "v_px,u_px,remark\n900.5,100.25,a reflection\n";
  for (const int point : {3, 1, 0, 2}) {
    const Vector2d p = pixel_of(point, R_, at_);
    points += fmt::format("{:.9f},{:.9f},\n", p.y(), p.x());
  }
  for (const std::string solver : {"ml_ray", "aopit", "posit_undistorted"}) {
    const Outcome outcome = turntable_program(solve(points, "--within 60 --solver " + solver));
    EXPECT_EQ(outcome.code, 0) << outcome.output;
    const Rows rows = table_of(outcome.output);
    ASSERT_EQ(rows.size(), 1u);
    EXPECT_LT(geodesic_angle(rotation_in(rows[0]), R_), 1e-4 * kRad) << solver;
    EXPECT_EQ(rows[0].at("std_rx_deg"), "") << "nobody knows the noise";
    EXPECT_EQ(rows[0].contains("residual_px"), solver == "posit_undistorted");
  }
}

TEST_F(PointsOfAPinhole, ThatContradictTheOthersAreLeftOutIfAsked) {
  spill(*folder_ / "six.json", R"({"format": "turntable-target/1", "points_mm": [[0, 0, 0],
      [58.6, 13, -40], [-40.6, 44.2, -40], [-18, -57.2, -40], [30, -40, -10], [-50, 0, -20]]})");
  std::vector<Vector3d> leds = kLeds;
  leds.insert(leds.end(), {{30, -40, -10}, {-50, 0, -20}});
  std::string points = "point,u_px,v_px,sigma_px\n";
  for (std::size_t t = 0; t < leds.size(); ++t) {
    const Vector3d p = R_ * leds[t] + at_;
    points += fmt::format("{},{:.9f},{:.9f},0.02\n", t,
                          511.5 - 1945.0 * p.x() / p.z() + (t == 4 ? 1.0 : 0.0),
                          511.5 + 1945.0 * p.y() / p.z());
  }
  const std::string six = "--target " + (*folder_ / "six.json").string();
  const auto with = table_of(turntable_program(solve(points, six + " --robust")).output).at(0);
  EXPECT_EQ(with.at("left_out"), "4");
  EXPECT_LT(geodesic_angle(rotation_in(with), R_), 1e-4 * kRad);
  const auto without = table_of(turntable_program(solve(points, six)).output).at(0);
  EXPECT_EQ(without.at("left_out"), "");
  EXPECT_GT(geodesic_angle(rotation_in(without), R_), 0.01 * kRad);
  EXPECT_GT(number_in(without, "chi2"), 100.0);
}

TEST_F(PointsOfAPinhole, ComeAsJsonIntoAFile) {
  const fs::path out = *folder_ / "attitudes.json";
  const Outcome outcome =
      turntable_program(solve(named_points(), "--format json --out " + out.string()));
  EXPECT_EQ(outcome.code, 4);
  EXPECT_EQ(outcome.output, "");
  const Json json = Json::parse(slurp(out));
  const Json& first = json.at("attitudes").at(0);
  EXPECT_EQ(first.at("frame"), "7");
  EXPECT_NEAR(first.at("position_mm").at(1).get<double>(), -8.0, 1e-3);
  EXPECT_GT(first.at("covariance_rad_mm").at(5).at(5).get<double>(), 0.0);
  EXPECT_EQ(first.at("residual_unit"), "mm");
  EXPECT_TRUE(json.at("attitudes").at(1).at("quaternion_wxyz").is_null());
}

TEST_F(PointsOfAPinhole, BadInputIsRefusedWithItsPlaceBeforeTheWork) {
  spill(*folder_ / "flat.json", R"({"format": "turntable-target/1",
      "points_mm": [[0, 0, 0], [60, 0, 0], [0, 60, 0], [-30, -40, 0]]})");
  spill(*folder_ / "line.json", R"({"format": "turntable-target/1",
      "points_mm": [[0, 0, 0], [60, 0, 0], [20, 0, 0], [-30, 0, 0]]})");
  const std::string flat = "--target " + (*folder_ / "flat.json").string();
  const std::string points = named_points();
  std::string unnamed = "u_px,v_px\n";
  for (int k = 0; k < 4; ++k) unnamed += fmt::format("{},{}\n", 100 * k, 200);
  struct Slip {
    std::string points, more, says;
  };
  for (const auto& [text, more, says] : std::vector<Slip>{
           {"u_px,w_px\n1,2\n", "", "column \"v_px\" is missing"},
           {"u_px,v_px\n1,2\n3,4\n", "",
            "found 2 points in a frame at most, allowed: the target's 4"},
           {"u_px,v_px,point\n1,2,0\n3,4,4\n", "", "allowed: the target's 4"},
           {points + "7,9,1,1,0.02\n", "", "line 9, column point: found 9, allowed: 0 to 3"},
           {points + "7,1,1,1,0.02\n", "", "line 9, column point: point 1 stands twice"},
           {points + "3,3,1,1,0\n", "", "line 9, column sigma_px: found 0, allowed: above 0"},
           {points, "--solver magic", "--solver: found \"magic\", allowed: posit, "},
           {points, "--camera fisheye", "no camera model \"fisheye\", allowed: irt, "},
           {points, flat + " --solver posit", "lie in a plane"},
           {unnamed, flat, "flat.json at /points_mm: lie in a plane"},
           {points, "--target " + (*folder_ / "line.json").string(), "on one line"},
           {points, "--target scenarios/quick/calibration.json", "found a scenario file"},
           {points, "--robust", "found a target of 4 points"},
           {points, "--robust --solver posit", "means nothing with solver posit"},
           {points, "--format xml", "xml"},
           {points, "--near 1,2", "--near: found 2 angles"},
           {points, "--within 200", "--within"},
           {points, "--out /nowhere/attitudes.csv", "/nowhere: is no folder"}}) {
    const Outcome outcome = turntable_program(solve(text, more));
    EXPECT_EQ(outcome.code, 2) << more << outcome.output;
    EXPECT_THAT(outcome.output, HasSubstr(says));
  }
  // In a plane, but named and with the solver that takes it: two attitudes, told from each other.
  EXPECT_THAT(turntable_program(solve(points, flat)).output, HasSubstr("7,"));
}

// ---- images

/// The LED images of a short run on the simulated rig, and what the run made of them.
class ImagesOfARun : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<TemporaryFolder>();
    const std::string scenarios = std::string(TURNTABLE_SOURCE_DIR) + "/scenarios/quick/";
    spill(*folder_ / "campaign.json", Json{{"format", "turntable-campaign/1"},
                                           {"name", "attitudes"},
                                           {"title", "camera and pitch"},
                                           {"steps",
                                            {{{"scenario", scenarios + "calibration.json"}},
                                             {{"scenario", scenarios + "uniaxial_x.json"}}}}}
                                          .dump());
    const Outcome made =
        turntable_program("run " + (*folder_ / "campaign.json").string() +
                          " --rig scenarios/rigs/simulated.json --solver ml_ray --out " +
                          (*folder_ / "run").string());
    ASSERT_EQ(made.code, 0) << made.output;
    fs::create_directories(images());
    for (const auto& row : table_of(slurp(*folder_ / "run/poses.csv"))) {
      const std::string name =
          fmt::format("{:06}-{}-1.png", std::stoi(row.at("index")), row.at("id"));
      fs::copy_file(*folder_ / "run/images" / name, images() / name);
    }
  }
  static void TearDownTestSuite() { folder_.reset(); }

  static fs::path images() { return *folder_ / "leds"; }
  static std::string with_camera() {
    return " --calibration " + (*folder_ / "run/calibration.json").string() + " --target " +
           kPublished;
  }
  static inline std::unique_ptr<TemporaryFolder> folder_;
};

TEST_F(ImagesOfARun, GiveTheAttitudesOfTheRunWithoutItsTurntable) {
  const Outcome outcome = turntable_program("measure " + images().string() + with_camera() +
                                            " --electrons-per-grey 40");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  const Rows rows = table_of(outcome.output);
  const Rows poses = table_of(slurp(*folder_ / "run/poses.csv"));
  ASSERT_EQ(rows.size(), poses.size());
  ASSERT_EQ(poses[0].at("role"), "reference");
  const Gimbal gimbal(load_rig_file("scenarios/rigs/simulated.json").gimbal);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    EXPECT_THAT(rows[k].at("file"), HasSubstr(poses[k].at("id")));
    const GimbalAngles a = gimbal.angles(rotation_in(rows[k]) * rotation_in(rows[0]).transpose());
    // Both tables are rounded to 1e-6 deg or less.
    EXPECT_NEAR(a.pitch / kRad, number_in(poses[k], "measured_pitch_deg"), 5e-6);
    EXPECT_NEAR(a.yaw / kRad, number_in(poses[k], "measured_yaw_deg"), 5e-6);
    EXPECT_GT(number_in(rows[k], "std_ry_deg"), 1e-4);
  }
}

TEST_F(ImagesOfARun, ThatCannotBeMeasuredAreRowsThatSayWhy) {
  TemporaryFolder odd;
  spill(odd / "1_dark.png", encode_png(Image({1024, 1024}, 12)));
  spill(odd / "2_small.png", encode_png(Image({640, 480}, 12)));
  spill(odd / "3_torn.png", slurp(fs::directory_iterator(images())->path()).substr(0, 900));
  fs::copy_file(fs::directory_iterator(images())->path(), odd / "4_good.png");
  const Outcome outcome = turntable_program("measure " + odd.path().string() + with_camera());
  EXPECT_EQ(outcome.code, 4);
  std::istringstream lines(outcome.output);
  std::string line;
  std::getline(lines, line);
  for (const char* says :
       {"1_dark.png,too few spots: 0 of 4,",
        "2_small.png,wrong size: 640 x 480 px instead of 1024 x 1024 px as calibrated,",
        "3_torn.png,unreadable: the file is cut off", "4_good.png,converged,"}) {
    std::getline(lines, line);
    EXPECT_THAT(line, HasSubstr(says));
  }
}

TEST_F(ImagesOfARun, AreTrackedFrameByFrame) {
  const Outcome measured = turntable_program("measure " + images().string() + with_camera());
  const Outcome tracked = turntable_program("track " + images().string() + with_camera());
  EXPECT_EQ(tracked.code, 0) << tracked.output;
  const Rows rows = table_of(without_summary(tracked.output)), expected = table_of(measured.output);
  ASSERT_EQ(rows.size(), expected.size());
  for (std::size_t k = 0; k < rows.size(); ++k) {
    EXPECT_EQ(fs::path(expected[k].at("file")).filename(), rows[k].at("frame"));
    for (const char* column : {"status", "rx_deg", "ry_deg", "rz_deg", "x_mm", "std_x_mm"})
      EXPECT_EQ(rows[k].at(column), expected[k].at(column)) << column;
    EXPECT_GT(number_in(rows[k], "latency_ms"), 0.0);
    EXPECT_THAT(rows[k].at("time_utc"), ::testing::EndsWith("Z"));
  }
}

TEST_F(ImagesOfARun, AreFollowedWhileTheyComeUntilCtrlC) {
  TemporaryFolder growing;
  const fs::path log = *folder_ / "follow.txt";
  BackgroundProgram program("track " + growing.path().string() + " --follow" + with_camera(), log);
  ASSERT_TRUE(program.prints("time_utc")) << program.output();
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(images())) files.push_back(entry.path());
  const std::string bytes = slurp(files[0]);
  // Whoever writes the first one pauses in the middle of it.
  spill(growing / "a.png", bytes.substr(0, bytes.size() / 2));
  std::this_thread::sleep_for(std::chrono::milliseconds{50});
  spill(growing / "a.png", bytes);
  ASSERT_TRUE(program.prints("a.png,converged")) << program.output();
  fs::copy_file(files[1], growing / "b.png");
  ASSERT_TRUE(program.prints("b.png,converged")) << program.output();
  program.signal(SIGINT);
  EXPECT_EQ(program.ended(), 0);
  EXPECT_TRUE(program.prints("2 frames, 0 lost; latency median")) << program.output();
}

TEST_F(ImagesOfARun, ComeFromTheCameraOfARigWhoseAxesAreLeftAlone) {
  const Outcome outcome =
      turntable_program("track scenarios/rigs/simulated.json --frames 3" + with_camera());
  EXPECT_EQ(outcome.code, 0) << outcome.output;
  const Rows rows = table_of(without_summary(outcome.output));
  ASSERT_EQ(rows.size(), 3u);
  for (const auto& row : rows) EXPECT_EQ(row.at("status"), "converged");
}

TEST_F(ImagesOfARun, BadInputIsRefused) {
  TemporaryFolder empty;
  const std::string one = fs::directory_iterator(images())->path().string();
  for (const auto& [arguments, says] : std::vector<std::pair<std::string, std::string>>{
           {"measure /nowhere.png", "/nowhere.png: does not exist"},
           {"measure " + empty.path().string(), "holds no images"},
           {"track " + empty.path().string(), "holds no images"},
           {"track " + one, "is no folder"},
           {"track scenarios/rigs/simulated.json --follow", "--follow: goes with a folder"},
           {"track scenarios/rigs/gige.json --frames 1", "wrong size"},
           {"track /nowhere", "cannot be read"},
           {"track " + images().string() + " --frames 0", "frames"}}) {
    const Outcome outcome = turntable_program(arguments + with_camera());
    EXPECT_EQ(outcome.code, 2) << arguments << outcome.output;
    EXPECT_THAT(outcome.output, HasSubstr(says));
  }
}

}  // namespace
}  // namespace turntable
