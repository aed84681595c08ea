#include "src/imaging/opencv_yaml.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>

#include "src/core/errors.h"
#include "src/imaging/monomial_table.h"

namespace turntable {
namespace {

/// As OpenCV 4.6's calibration sample writes it (its other keys shortened).
const std::string kSample = R"(%YAML:1.0
---
calibration_time: "Thu Apr  1 12:00:00 2021"
nr_of_frames: 12
image_width: 640
image_height: 480
board_width: 9
square_size: 50.
flags: 6
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.5746697810243404e+02, 0., 3.1950000000000000e+02, 0.,
       6.5746697810243404e+02, 2.3950000000000000e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -4.1802327018241026e-01, 5.0715243805833121e-01, 0., 0.,
       -5.7843596847939704e-01 ]
avg_reprojection_error: 3.8441890283270341e-01
)";

std::string exchanged(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

CentralModel model_of_kind(CentralKind kind) {
  CentralModel m;
  m.kind = kind;
  m.fx = 1945.0 + 1.0 / 3.0;
  m.fy = 1944.7;
  m.cx = 517.1;
  m.cy = 508.2;
  m.image_size = {1024, 1024};
  m.rms_px = 0.1;
  m.views = 15;
  const std::vector<double> all{-0.06, 0.1, 0.0003, -0.0002, 0.01, 1e-3, 0.02, -0.03};
  m.distortion.assign(all.begin(),
                      all.begin() + static_cast<std::ptrdiff_t>(distortion_terms(kind)));
  m.R_plane_from_camera = Vector3d(1, -1, -1).asDiagonal();
  return m;
}

TEST(OpenCvYaml, ReadsWhatOpenCvsCalibrationSampleWrites) {
  const CentralModel m = parse_opencv_yaml(kSample, "camera.yml");
  EXPECT_EQ(m.kind, CentralKind::kBrown);
  EXPECT_EQ(m.image_size, (ImageSize{640, 480}));
  EXPECT_EQ(m.fx, 657.46697810243404);
  EXPECT_EQ(m.cy, 239.5);
  EXPECT_EQ(m.distortion, (std::vector<double>{-0.41802327018241026, 0.50715243805833121, 0, 0,
                                               -0.57843596847939704}));
  EXPECT_EQ(m.rms_px, 0.38441890283270341);
  EXPECT_EQ(m.views, 12);
}

TEST(OpenCvYaml, EveryModelComesBackToTheLastDigit) {
  for (const CentralKind kind : kCentralKinds) {
    const CentralModel m = model_of_kind(kind);
    const std::string text = to_opencv_yaml(m);
    const CentralModel back = parse_opencv_yaml(text, "camera.yml");
    EXPECT_EQ(back.kind, kind);
    EXPECT_EQ(back.fx, m.fx);
    EXPECT_EQ(back.cy, m.cy);
    EXPECT_EQ(back.distortion, m.distortion);
    EXPECT_EQ(back.image_size, m.image_size);
    EXPECT_EQ(back.rms_px, m.rms_px);
    EXPECT_EQ(to_opencv_yaml(back), text);
  }
}

TEST(OpenCvYaml, TheSimplestModelWithAllCoefficientsIsTaken) {
  const auto with = [](const std::string& rows, const std::string& data) {
    const auto from = kSample.find("distortion_coefficients"), to = kSample.find("avg_repro");
    return parse_opencv_yaml(
        std::string(kSample).replace(from, to - from,
                                     "distortion_coefficients: !!opencv-matrix\n   rows: " + rows +
                                         "\n   cols: 1\n   dt: d\n   data: [ " + data + " ]\n"),
        "camera.yml");
  };
  EXPECT_EQ(with("5", "0., 0., 0., 0., 0.").kind, CentralKind::kPinhole);
  EXPECT_EQ(with("4", "-0.1, 0.1, 0., 0.").distortion, (std::vector<double>{-0.1, 0.1, 0, 0, 0}));
  EXPECT_EQ(with("8", "-0.1, 0.1, 0., 0., 0., 0., 0., 0.").kind, CentralKind::kBrown);
  EXPECT_EQ(with("14", "-0.1, 0.1, 0., 0., 0., 0.2, 0., 0., 0., 0., 0., 0., 0., 0.").kind,
            CentralKind::kRational);
  EXPECT_THROW(with("12", "-0.1, 0.1, 0., 0., 0., 0., 0., 0., 0.01, 0., 0., 0."), ConfigError);
  EXPECT_THROW(with("6", "-0.1, 0.1, 0., 0., 0., 0."), ConfigError);
}

TEST(OpenCvYaml, DamagedFilesAreRefusedWithTheKey) {
  for (const auto& [from, to, pointer] :
       {std::tuple{"image_width: 640", "", "/image_width"},
        {"image_width: 640", "image_width: 640.5", "/image_width"},
        {"image_height: 480", "image_height: 4", "/image_height"},
        {"image_height: 480", "image_height: tall", "/image_height"},
        {"camera_matrix", "camera_matriks", "/camera_matrix"},
        {"camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3",
         "camera_matrix: !!opencv-matrix\n   rows: 1\n   cols: 9", "/camera_matrix"},
        {"6.5746697810243404e+02, 0., ", "-6.5746697810243404e+02, 0., ", "/camera_matrix"},
        {"6.5746697810243404e+02, 0., ", "6.5746697810243404e+02, 0.5, ", "/camera_matrix"},
        {"6.5746697810243404e+02, 0., ", ".Nan, 0., ", "/camera_matrix"},
        {"fisheye_model: 0", "fisheye_model: 1", "/distortion_coefficients"},
        {"error: 3.8", "error: -3.8", "/avg_reprojection_error"},
        {"%YAML:1.0\n---\n", "", ""},
        {"calibration_time: \"", "calibration_time: [", ""}}) {
    try {
      parse_opencv_yaml(exchanged(kSample, from, to), "camera.yml");
      ADD_FAILURE() << "accepted " << to << " for " << from;
    } catch (const ConfigError& e) {
      EXPECT_EQ(e.pointer(), pointer) << e.what();
      EXPECT_EQ(e.file(), "camera.yml");
    }
  }
  EXPECT_THROW(parse_opencv_yaml("", "camera.yml"), ConfigError);
  EXPECT_THROW(parse_opencv_yaml("{}", "camera.yml"), ConfigError);
  EXPECT_THROW(load_opencv_yaml("/nowhere/camera.yml"), ConfigError);
}

TEST(OpenCvYaml, AnImportedCameraIsARayModelWithinAThousandthOfAPixel) {
  const RayPlanes planes{-570, -520};
  int last_order = 0;
  for (const CentralKind kind : {CentralKind::kPinhole, CentralKind::kBrown}) {
    CentralModel m = model_of_kind(kind);
    m.centre_mm = {1, 2, 700};  // no part of an imported camera, nor is the lean
    m.lean = {0.01, 0.02};
    const Calibration c = calibration_from_central(m, planes, "camera.yml");
    for (double u = 0; u <= 1023; u += 31)
      for (double v = 0; v <= 1023; v += 31) {
        ASSERT_TRUE(c.irt.in_domain({u, v}));
        const Ray fitted = c.irt.ray({u, v});
        // Back into the image through the exact model.
        const Vector3d in_camera(fitted.at_a.x(), -fitted.at_a.y(), -planes.a_mm);
        EXPECT_LT((m.project(in_camera) - Vector2d(u, v)).norm(), 2e-3);
      }
    EXPECT_GT(c.irt.order(), last_order);
    last_order = c.irt.order();
    EXPECT_LT(c.sigma_mm, 1e-3 * 520 / 1945);
    EXPECT_LT(c.irt.bundle_centre().first.norm(), 0.01);
    // Both pinhole sights are served, and the file holds all of it.
    EXPECT_NE(c.find_central("pinhole"), nullptr);
    EXPECT_NE(c.undistorting(), nullptr);
    const Calibration back = parse_calibration(calibration_to_json(c), "back");
    EXPECT_EQ(back.irt.coefficients(), c.irt.coefficients());
    EXPECT_FALSE(back.undistorting()->tied_to_plane);
  }
}

TEST(OpenCvYaml, ThePinholeBesideADistortedCameraIsTheNearestOne) {
  const CentralModel m = model_of_kind(CentralKind::kBrown);
  const Calibration c = calibration_from_central(m, {-570, -520}, "camera.yml");
  const CentralModel* pinhole = c.find_central("pinhole");
  ASSERT_NE(pinhole, nullptr);
  const auto miss = [&](const CentralModel& candidate) {
    double sum = 0.0;
    int n = 0;
    for (double u = 0; u <= 1023; u += 33)
      for (double v = 0; v <= 1023; v += 33) {
        const Vector2d t = m.normalise({u, v});
        sum += (candidate.project(t.homogeneous()) - Vector2d(u, v)).squaredNorm();
        ++n;
      }
    return std::sqrt(sum / n);
  };
  EXPECT_NEAR(pinhole->rms_px, miss(*pinhole), 0.1 * pinhole->rms_px);
  for (const double factor : {0.999, 1.001}) {
    CentralModel other = *pinhole;
    other.fx *= factor;
    EXPECT_GT(miss(other), miss(*pinhole));
  }
}

TEST(OpenCvYaml, PlanesBehindTheCameraAndPixelsWithoutARayAreRefused) {
  CentralModel m = model_of_kind(CentralKind::kBrown);
  EXPECT_THROW(calibration_from_central(m, {130, 180}, "camera.yml"), ConfigError);
  EXPECT_THROW(calibration_from_central(m, {-520, -570}, "camera.yml"), ConfigError);
  m.distortion = {-3.0, 0, 0, 0, 0};
  EXPECT_THROW(calibration_from_central(m, {-570, -520}, "camera.yml"), ConfigError);
}

TEST(MonomialTable, CsvIsTheSameCameraAndLatexHasARowPerTerm) {
  const Calibration c =
      calibration_from_central(model_of_kind(CentralKind::kBrown), {-570, -520}, "camera.yml");
  const Eigen::MatrixX4d monomials = c.irt.monomials(VDirection::kDown);
  const std::vector<MonomialTable> tables{{"ours", c.irt.order(), monomials}};
  const std::string csv = monomials_to_csv(tables);
  std::istringstream lines(csv);
  std::string line;
  std::getline(lines, line);
  EXPECT_EQ(line, "source,r,s,C_a_mm,D_a_mm,C_b_mm,D_b_mm");
  Eigen::MatrixX4d read(monomials.rows(), 4);
  for (Eigen::Index i = 0; i < read.rows(); ++i) {
    ASSERT_TRUE(std::getline(lines, line));
    int r = 0, s = 0;
    ASSERT_EQ(std::sscanf(line.c_str(), "ours,%d,%d,%lf,%lf,%lf,%lf", &r, &s, &read(i, 0),
                          &read(i, 1), &read(i, 2), &read(i, 3)),
              6);
    EXPECT_EQ(std::pair(r, s), IrtModel::terms(c.irt.order())[static_cast<std::size_t>(i)]);
  }
  EXPECT_FALSE(std::getline(lines, line));
  EXPECT_EQ(read, monomials);
  const std::string latex = monomials_to_latex(tables);
  EXPECT_EQ(std::ranges::count(latex, '\n'), monomials.rows() + 6);
  EXPECT_NE(latex.find("\\cdot 10^{"), std::string::npos);
}

}  // namespace
}  // namespace turntable
