#include "src/imaging/irt.h"

#include <gtest/gtest.h>

#include <cmath>

#include "src/core/errors.h"
#include "tests/imaging/lattice_points.h"

namespace turntable {
namespace {

double rms(const IrtModel& model, const std::vector<PlanePoint>& points) {
  double sum = 0;
  int n = 0;
  for (const PlanePoint& p : points)
    if (model.in_domain(p.pixel_px)) {
      sum += residual_mm(model, p).squaredNorm();
      ++n;
    }
  return std::sqrt(sum / n);
}

TEST(Irt, FitsAPhysicalLensToMicrometresAndPredictsAPlaneItHasNotSeen) {
  const IrtFit fit = fit_irt(points_of({130, 180}, 0.0), {130, 180}, 5, kSize);
  EXPECT_LT(rms(fit.model, points_of({130, 180}, 0.0)), 0.002);
  EXPECT_LT(rms(fit.model, points_of({0}, 0.0)), 0.006);
  EXPECT_TRUE(fit.outliers.empty());
}

TEST(Irt, ErrorFallsWithTheOrderUntilTheLensIsExhausted) {
  double last = INFINITY;
  for (const int order : {1, 3, 5}) {
    const double held_out = rms(fit_irt(points_of({130, 180}, 0.0), {130, 180}, order, kSize).model,
                                points_of({150}, 0.0));
    EXPECT_LT(held_out, 0.5 * last);
    last = held_out;
  }
}

TEST(Irt, UsesEveryPlaneItIsGiven) {
  const IrtFit two = fit_irt(points_of({100, 200}, 0.05), {100, 200}, 5, kSize);
  const IrtFit five = fit_irt(points_of({100, 125, 150, 175, 200}, 0.05), {100, 200}, 5, kSize);
  EXPECT_LT(rms(five.model, points_of({160}, 0.0)), rms(two.model, points_of({160}, 0.0)));
}

TEST(Irt, NamesAnOutlierAndLeavesItOut) {
  auto points = points_of({130, 180}, 0.02);
  points[37].pixel_px.x() += 3.0;
  const IrtFit fit = fit_irt(points, {130, 180}, 5, kSize);
  ASSERT_EQ(fit.outliers.size(), 1u);
  EXPECT_EQ(fit.outliers[0].column, points[37].column);
  EXPECT_EQ(fit.outliers[0].row, points[37].row);
}

TEST(Irt, RefusesAnOrderThatThePointsDoNotCarry) {
  auto points = points_of({130, 180}, 0.0);
  points.resize(50);
  EXPECT_THROW(fit_irt(points, {130, 180}, 5, kSize), Error);
  EXPECT_THROW(fit_irt(points_of({130}, 0.0), {130, 180}, 5, kSize), Error);
  EXPECT_THROW(fit_irt(points_of({130, 180}, 0.0), {180, 130}, 5, kSize), Error);
  EXPECT_THROW(fit_irt(points_of({130, 180}, 0.0), {130, 180}, 10, kSize), Error);
}

TEST(Irt, MonomialsAreTheSameModelCountedEitherWay) {
  const IrtModel model = fit_irt(points_of({130, 180}, 0.0), {130, 180}, 5, kSize).model;
  for (const VDirection v : {VDirection::kDown, VDirection::kUp}) {
    const Eigen::MatrixX4d m = model.monomials(v);
    const IrtModel back =
        IrtModel::from_monomials(kSize, model.planes(), 5, m, v, model.domain_hull_px());
    const auto terms = IrtModel::terms(5);
    for (const Vector2d& pixel : {Vector2d(100, 200), Vector2d(512, 800), Vector2d(900, 50)}) {
      const double row = v == VDirection::kDown ? pixel.y() : 1023 - pixel.y();
      Eigen::RowVector4d sum = Eigen::RowVector4d::Zero();
      for (std::size_t i = 0; i < terms.size(); ++i)
        sum += m.row(static_cast<Eigen::Index>(i)) * std::pow(pixel.x(), terms[i].first) *
               std::pow(row, terms[i].second);
      const Ray ray = model.ray(pixel);
      EXPECT_NEAR(sum(0), ray.at_a.x(), 1e-7);
      EXPECT_NEAR(sum(3), ray.at_b.y(), 1e-7);
      EXPECT_LT((back.ray(pixel).at_a - ray.at_a).norm(), 1e-7);
    }
  }
}

TEST(Irt, DomainIsWhereEveryFittedPlaneWasSeen) {
  // A pattern smaller than the view spreads over more pixels on the nearer plane.
  std::vector<PlanePoint> points;
  double reach[2] = {0, 0};
  for (const PlanePoint& p : points_of({130, 180}, 0.0)) {
    if (p.on_plane_mm.cwiseAbs().maxCoeff() > 80) continue;
    points.push_back(p);
    double& r = reach[p.z_mm > 150];
    r = std::max(r, p.pixel_px.x());
  }
  ASSERT_GT(reach[1], reach[0] + 10);
  const IrtModel model = fit_irt(points, {130, 180}, 3, kSize).model;
  EXPECT_TRUE(model.in_domain({reach[0] - 5, 512}));
  EXPECT_FALSE(model.in_domain({0.5 * (reach[0] + reach[1]), 512}));
}

TEST(Irt, DomainIsTheHullOfTheCalibratedPixels) {
  const IrtModel model = fit_irt(points_of({130, 180}, 0.0), {130, 180}, 5, kSize).model;
  EXPECT_TRUE(model.in_domain({512, 512}));
  EXPECT_FALSE(model.in_domain({-5, 512}));
  EXPECT_FALSE(model.in_domain({1023, 1023}));
}

TEST(Irt, LeftHandedModelsAreRefusedWithAdvice) {
  auto points = points_of({130, 180}, 0.0);
  for (PlanePoint& p : points) p.on_plane_mm.y() = -p.on_plane_mm.y();
  const IrtModel model = fit_irt(points, {130, 180}, 5, kSize).model;
  try {
    check_handedness(model, "camera.json");
    FAIL() << "accepted";
  } catch (const ConfigError& e) {
    EXPECT_NE(std::string(e.what()).find("left-handed"), std::string::npos);
    EXPECT_NE(std::string(e.what()).find("v_direction"), std::string::npos);
  }
}

}  // namespace
}  // namespace turntable
