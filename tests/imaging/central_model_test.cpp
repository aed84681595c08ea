#include "src/imaging/central_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/calib3d.hpp>

#include "src/core/errors.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

constexpr ImageSize kSize{1024, 1024};

CentralModel model_of(CentralKind kind) {
  CentralModel m;
  m.kind = kind;
  m.fx = 1945;
  m.fy = 1940;
  m.cx = 517;
  m.cy = 508;
  m.image_size = kSize;
  const std::vector<double> brown{-0.12, 0.15, 0.001, -0.002, 0.05};
  switch (kind) {
    case CentralKind::kPinhole:
      break;
    case CentralKind::kBrown:
      m.distortion = brown;
      break;
    case CentralKind::kRational:
      m.distortion = brown;
      m.distortion.insert(m.distortion.end(), {0.1, -0.05, 0.02});
      break;
    case CentralKind::kFisheye:
      m.fx = m.fy = 500;  // 45 deg at the edge of the image
      m.distortion = {0.02, -0.01, 0.003, -0.0005};
      break;
  }
  m.R_plane_from_camera =
      rotation_from_vector({0.02, -0.03, 0.1}) * Vector3d(1, -1, -1).asDiagonal();
  // The wide lens stands nearer, so that the pattern fills its view.
  m.lean = {4e-4, -2e-4};
  m.centre_mm = {12, -7, kind == CentralKind::kFisheye ? 401.0 : 701.0};
  return m;
}

/// OpenCV's own projection.
Vector2d projected_by_opencv(const CentralModel& m, const Vector3d& point_camera) {
  const cv::Matx33d K(m.fx, 0, m.cx, 0, m.fy, m.cy, 0, 0, 1);
  const std::vector<cv::Point3d> points{{point_camera.x(), point_camera.y(), point_camera.z()}};
  const cv::Vec3d none(0, 0, 0);
  std::vector<cv::Point2d> pixels;
  if (m.kind == CentralKind::kFisheye)
    cv::fisheye::projectPoints(points, pixels, none, none, K, m.distortion);
  else
    cv::projectPoints(points, none, none, K, m.distortion, pixels);
  return {pixels[0].x, pixels[0].y};
}

/// Views of a 15 x 15 pattern, 20 mm apart: three heights at zero angles, and tilted ones.
std::vector<PatternView> views_of(const CentralModel& m, bool at_zero, double noise_px) {
  Random random = draws_of_this_test(static_cast<std::uint64_t>(m.kind));
  std::vector<PatternView> views;
  const auto look = [&](const Matrix3d& R, double z, bool zero) {
    PatternView view;
    view.at_zero = zero;
    view.z_mm = zero ? z : 0.0;
    for (int row = -7; row <= 7; ++row)
      for (int column = -7; column <= 7; ++column) {
        const Vector2d on_pattern = Vector2d(column, row) * 20.0;
        const Vector3d in_plane = R * Vector3d(on_pattern.x(), on_pattern.y(), 0) +
                                  Vector3d(m.lean.x(), m.lean.y(), 1) * z;
        const Vector2d pixel =
            m.project(m.R_plane_from_camera.transpose() * (in_plane - m.centre_mm));
        view.pixels_px.emplace_back(pixel + noise_px * Vector2d(random.normal(), random.normal()));
        view.on_pattern_mm.push_back(on_pattern);
      }
    views.push_back(view);
  };
  if (at_zero)
    for (const double z : {0.0, 130.0, 180.0}) look(Matrix3d::Identity(), z, true);
  for (const double tilt : {-0.35, 0.3})
    for (const double yaw : {0.0, 1.5, 0.8}) {
      const Matrix3d turn = rotation_from_vector({0, 0, yaw});
      look(turn * rotation_from_vector({tilt, 0, 0}), 100.0 + 40.0 * yaw, false);
    }
  return views;
}

class EveryCentralModel : public testing::TestWithParam<CentralKind> {
 protected:
  const CentralModel model = model_of(GetParam());
};

TEST_P(EveryCentralModel, ProjectsAsOpenCvDoes) {
  Random random = draws_of_this_test();
  for (int i = 0; i < 200; ++i) {
    const Vector3d point(150 * random.normal(), 150 * random.normal(), 700);
    if (std::abs(point.x()) > 180 || std::abs(point.y()) > 180) continue;
    EXPECT_LT((model.project(point) - projected_by_opencv(model, point)).norm(), 1e-9);
  }
}

TEST_P(EveryCentralModel, NormaliseUndoesProject) {
  for (double x = -180; x <= 180; x += 30)
    for (double y = -180; y <= 180; y += 30) {
      const Vector2d tangents = Vector2d(x, y) / 700.0;
      EXPECT_LT((model.normalise(model.project({x, y, 700})) - tangents).norm(), 1e-13);
    }
}

TEST_P(EveryCentralModel, ItsRayGoesThroughTheCentreAndBackToThePixel) {
  const RayPlanes planes{130, 180};
  for (const Vector2d& pixel : {Vector2d(517, 508), Vector2d(100, 900), Vector2d(800, 30)}) {
    const Ray ray = model.ray(pixel, planes);
    const Vector2d shift = -model.lean * model.centre_mm.z();
    const Vector3d centre = model.centre_mm + Vector3d(shift.x(), shift.y(), 0);
    EXPECT_LT(distance_mm(centre, ray, planes), 1e-10);
    for (const double z : {0.0, 150.0}) {
      const Vector2d at = ray.at(z, planes) + model.lean * z;
      const Vector3d in_camera =
          model.R_plane_from_camera.transpose() * (Vector3d(at.x(), at.y(), z) - model.centre_mm);
      EXPECT_LT((projected_by_opencv(model, in_camera) - pixel).norm(), 1e-9);
    }
  }
}

TEST_P(EveryCentralModel, PointsMadeWithItComeBackAsIt) {
  const std::vector<PatternView> views = views_of(model, true, 0.01);
  const CentralModel found = fit_central(GetParam(), views, kSize);
  EXPECT_EQ(found.views, 9);
  EXPECT_TRUE(found.tied_to_plane);
  EXPECT_EQ(found.distortion.size(), model.distortion.size());
  EXPECT_LT(found.rms_px, 0.02);
  EXPECT_LT((found.centre_mm - model.centre_mm).norm(), 0.2);
  EXPECT_LT((found.lean - model.lean).norm(), 1e-4);
  EXPECT_LT(geodesic_angle(found.R_plane_from_camera, model.R_plane_from_camera), 2e-4);
  // Coefficients trade against each other; what counts is where the rays go.
  const RayPlanes planes{130, 180};
  for (const Vector2d& pixel : views[1].pixels_px) {
    const Ray a = found.ray(pixel, planes), b = model.ray(pixel, planes);
    EXPECT_LT((a.at_a - b.at_a).norm(), 0.01);
    EXPECT_LT((a.at_b - b.at_b).norm(), 0.01);
  }
}

INSTANTIATE_TEST_SUITE_P(CentralModel, EveryCentralModel, testing::ValuesIn(kCentralKinds),
                         [](const auto& test) { return std::string(central_name(test.param)); });

TEST(CentralModel, WithoutAViewAtZeroThePlaneFrameIsTheCameraTurnedOver) {
  const CentralModel found = fit_central(
      CentralKind::kPinhole, views_of(model_of(CentralKind::kPinhole), false, 0.0), kSize);
  EXPECT_FALSE(found.tied_to_plane);
  EXPECT_EQ(found.R_plane_from_camera, Matrix3d(Vector3d(1, -1, -1).asDiagonal()));
  EXPECT_EQ(found.centre_mm, Vector3d::Zero());
  EXPECT_NEAR(found.fx, 1945, 0.1);
}

TEST(CentralModel, OutsideItsDomainTheAnswerIsNotANumber) {
  CentralModel m = model_of(CentralKind::kBrown);
  EXPECT_FALSE(m.project({0, 0, -1}).allFinite());
  m.distortion = {-0.5, 0, 0, 0, 0};
  // r (1 - r^2 / 2) turns back at r = sqrt(2/3), where it is 0.544.
  EXPECT_TRUE(m.normalise({m.cx + 0.54 * m.fx, m.cy}).allFinite());
  EXPECT_FALSE(m.normalise({m.cx + 0.55 * m.fx, m.cy}).allFinite());
  EXPECT_FALSE(m.project({0.9, 0, 1}).allFinite());
  CentralModel wide = model_of(CentralKind::kFisheye);
  wide.distortion = {0, 0, 0, 0};
  EXPECT_TRUE(wide.normalise({wide.cx + 1.57 * wide.fx, wide.cy}).allFinite());
  EXPECT_FALSE(wide.normalise({wide.cx + 1.58 * wide.fx, wide.cy}).allFinite());
}

TEST(CentralModel, TooFewViewsOrPointsAreRefused) {
  auto views = views_of(model_of(CentralKind::kPinhole), false, 0.0);
  EXPECT_THROW(fit_central(CentralKind::kBrown, std::span(views).first(2), kSize), Error);
  views[1].pixels_px.resize(5);
  views[1].on_pattern_mm.resize(5);
  EXPECT_THROW(fit_central(CentralKind::kBrown, views, kSize), Error);
}

TEST(CentralModel, ViewsFromOneDirectionAreRefusedOrFittedButNeverNonsense) {
  // Parallel views of a plane leave the focal length open.
  const CentralModel model = model_of(CentralKind::kPinhole);
  auto views = views_of(model, true, 0.0);
  views.resize(3);
  try {
    const CentralModel found = fit_central(CentralKind::kFisheye, views, kSize);
    EXPECT_TRUE(std::isfinite(found.rms_px) && found.fx > 0);
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("fisheye"), std::string::npos);
  }
}

}  // namespace
}  // namespace turntable
