// What a fit says about itself, against refits, repeated noise and another solver.
#include <gtest/gtest.h>

#include <Eigen/QR>
#include <cmath>

#include "src/core/errors.h"
#include "tests/imaging/lattice_points.h"
#include "tests/support/draws.h"
#include "tests/support/message_of.h"

namespace turntable {
namespace {

constexpr RayPlanes kPlanes{130, 180};

TEST(IrtStatistics, CoefficientsAreThoseOfAnOrthogonalFactorisation) {
  constexpr int kOrder = 5, kTerms = 21;
  const auto points = points_of({130, 150, 180}, 0.02);
  const IrtFit fit = fit_irt(points, kPlanes, kOrder, kSize);
  const auto count = static_cast<Eigen::Index>(points.size());
  ASSERT_EQ(fit.points, count);
  Eigen::MatrixXd A(count, 2 * kTerms), xy(count, 2);
  for (Eigen::Index i = 0; i < count; ++i) {
    const PlanePoint& p = points[static_cast<std::size_t>(i)];
    const double lambda = (p.z_mm - 130) / 50;
    double phi[kTerms];
    IrtModel::basis(p.pixel_px, kSize, kOrder, phi);
    for (int k = 0; k < kTerms; ++k) {
      A(i, k) = (1 - lambda) * phi[k];
      A(i, kTerms + k) = lambda * phi[k];
    }
    xy.row(i) = p.on_plane_mm.transpose();
  }
  const Eigen::MatrixXd expected = Eigen::HouseholderQR<Eigen::MatrixXd>(A).solve(xy);
  const Eigen::MatrixX4d& c = fit.model.coefficients();
  EXPECT_LT((c.leftCols(2) - expected.topRows(kTerms)).norm(), 1e-10 * expected.norm());
  EXPECT_LT((c.rightCols(2) - expected.bottomRows(kTerms)).norm(), 1e-10 * expected.norm());
}

TEST(IrtStatistics, LeftOutResidualsAreThoseOfFitsWithoutThePoint) {
  const auto points = within(points_of({130, 180}, 0.02), 80);
  const IrtFit fit = fit_irt(points, kPlanes, 4, kSize);
  ASSERT_EQ(fit.used.size(), points.size());
  double sum = 0.0, worst = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    auto others = points;
    others.erase(others.begin() + static_cast<std::ptrdiff_t>(i));
    const IrtFit refit = fit_irt(others, kPlanes, 4, kSize);
    ASSERT_TRUE(refit.outliers.empty());
    const Vector2d left_out = residual_mm(refit.model, points[i]);
    ASSERT_EQ(fit.used[i].index, i);
    worst = std::max(worst, (fit.used[i].left_out_mm - left_out).norm());
    sum += left_out.squaredNorm();
  }
  EXPECT_LT(worst, 1e-9);
  EXPECT_NEAR(fit.loo_rms_mm, std::sqrt(sum / static_cast<double>(points.size())), 1e-9);
  EXPECT_GT(fit.loo_rms_mm, 1.05 * fit.rms_mm);
}

TEST(IrtStatistics, LeveragesAddUpToTheNumberOfCoefficients) {
  const IrtFit fit = fit_irt(stated(points_of({130, 180}, 0.02), 0.02), kPlanes, 5, kSize);
  double sum = 0.0;
  for (const PointStatistics& p : fit.used) sum += p.leverage;
  EXPECT_NEAR(sum, 42.0, 1e-9);
}

TEST(IrtStatistics, StatedUncertaintyIsTheSpreadOverRepeatedNoiseInsideAndOutside) {
  constexpr double kNoise = 0.02;
  constexpr int kDraws = 1500;
  const auto truth = stated(within(points_of({130, 180}, 0.0), 120), kNoise);
  const IrtModel model = fit_irt(truth, kPlanes, 5, kSize).model;
  struct Place {
    double u, v, z;
  };
  // The calibrated square is about 102..921 px on the lower plane.
  const std::vector<Place> places = {{512, 512, 130},   {512, 512, 0},   {300, 700, 155},
                                     {115, 115, 130},   {910, 512, 180}, {961, 512, 130},
                                     {1002, 1002, 130}, {1060, 512, 0}};
  std::vector<double> sums(places.size(), 0.0);
  Random random = draws_of_this_test();
  for (int draw = 0; draw < kDraws; ++draw) {
    auto points = truth;
    add_noise(points, kNoise, random);
    const IrtModel noisy = fit_irt(points, kPlanes, 5, kSize).model;
    for (std::size_t i = 0; i < places.size(); ++i) {
      const auto& [u, v, z] = places[i];
      sums[i] +=
          (noisy.ray({u, v}).at(z, kPlanes) - model.ray({u, v}).at(z, kPlanes)).squaredNorm();
    }
  }
  for (std::size_t i = 0; i < places.size(); ++i) {
    const auto& [u, v, z] = places[i];
    const double observed = std::sqrt(sums[i] / (2.0 * kDraws));  // known to 1.8 %
    EXPECT_NEAR(model.sigma_mm({u, v}, z) / observed, 1.0, 0.07) << u << " " << v << " at " << z;
  }
}

TEST(IrtStatistics, UncertaintyGrowsOutsideTheCalibratedSquareAsThatOfAnyPolynomialOfOrderFive) {
  // 15 x 15 points to +-1: 0.8 at the corner, and 1.8, 3.5, 10 at 1.1, 1.2, 1.4 of the half range.
  std::vector<PlanePoint> points;
  for (const double z : {130.0, 180.0})
    for (int row = -7; row <= 7; ++row)
      for (int column = -7; column <= 7; ++column) {
        PlanePoint p;
        p.pixel_px = Vector2d(511.5, 511.5) + 50.0 * Vector2d(column, -row);
        p.on_plane_mm = Vector2d(column, row) * 20.0 * (700 - z) / 550;
        p.z_mm = z;
        p.sigma_px = 0.02;
        points.push_back(p);
      }
  const IrtModel model = fit_irt(points, kPlanes, 5, kSize).model;
  for (const auto& [reach, expected] :
       {std::pair{1.0, 0.8}, std::pair{1.1, 1.8}, std::pair{1.2, 3.5}, std::pair{1.4, 10.0}}) {
    const Vector2d pixel = Vector2d::Constant(511.5 + 350.0 * reach);
    EXPECT_NEAR(model.sigma_mm(pixel, 130) / (0.02 * model.mm_per_px(pixel, 130)), expected,
                0.15 * expected)
        << reach;
  }
}

TEST(IrtStatistics, ResidualsScaleTheUncertaintyOfPointsThatStateNoneOrTooLittle) {
  const auto points = points_of({130, 180}, 0.02);
  const Vector2d pixel(700, 300);
  const double right = fit_irt(stated(points, 0.02), kPlanes, 5, kSize).model.sigma_mm(pixel, 150);
  const IrtFit none = fit_irt(points, kPlanes, 5, kSize);
  EXPECT_TRUE(std::isnan(none.chi2_per_dof));
  EXPECT_NEAR(none.model.sigma_mm(pixel, 150) / right, 1.0, 0.1);
  const IrtFit bold = fit_irt(stated(points, 0.005), kPlanes, 5, kSize);
  EXPECT_NEAR(bold.chi2_per_dof, 16.0, 2.5);
  EXPECT_NEAR(bold.model.sigma_mm(pixel, 150) / right, 1.0, 0.1);
  // What was stated carefully is not talked down.
  const IrtFit careful = fit_irt(stated(points, 0.08), kPlanes, 5, kSize);
  EXPECT_NEAR(careful.chi2_per_dof, 1.0 / 16.0, 0.01);
  EXPECT_NEAR(careful.model.sigma_mm(pixel, 150) / right, 4.0, 0.4);
}

TEST(IrtStatistics, PointsWeighByWhatTheyState) {
  const auto truth = points_of({130, 180}, 0.0);
  auto points = stated(truth, 0.01);
  Random random = draws_of_this_test();
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (i % 2 == 0) points[i].sigma_px = 0.2;
    points[i].pixel_px += points[i].sigma_px * Vector2d(random.normal(), random.normal());
  }
  const auto error = [&](const IrtFit& fit) {
    double sum = 0.0;
    for (const PlanePoint& p : truth) sum += residual_mm(fit.model, p).squaredNorm();
    return std::sqrt(sum / static_cast<double>(truth.size()));
  };
  const IrtFit weighted = fit_irt(points, kPlanes, 5, kSize);
  EXPECT_NEAR(weighted.chi2_per_dof, 1.0, 0.2);
  EXPECT_LT(error(weighted), 0.3 * error(fit_irt(stated(points, 0.0), kPlanes, 5, kSize)));
}

TEST(IrtStatistics, OutliersLeaveNoTraceWhereverTheyAre) {
  const auto good = points_of({130, 180}, 0.02);
  auto points = good;
  // In the middle, at an edge, and at a corner, where the fit would rather follow the point.
  const auto corner = static_cast<std::size_t>(
      std::ranges::max_element(points, {}, [](const PlanePoint& p) { return p.pixel_px.sum(); }) -
      points.begin());
  const std::vector<std::size_t> bad = {points.size() / 4, 3, corner};
  for (const std::size_t i : bad) points[i].pixel_px += Vector2d(1.0, -0.7);
  const IrtFit fit = fit_irt(points, kPlanes, 5, kSize);
  ASSERT_EQ(fit.outliers.size(), bad.size());
  for (const std::size_t i : bad)
    EXPECT_EQ(std::ranges::count(fit.used, i, &PointStatistics::index), 0);
  std::vector<PlanePoint> rest;
  for (std::size_t i = 0; i < good.size(); ++i)
    if (!std::ranges::count(bad, i)) rest.push_back(good[i]);
  const IrtFit without = fit_irt(rest, kPlanes, 5, kSize);
  EXPECT_LT((fit.model.coefficients() - without.model.coefficients()).norm(), 1e-9);
}

TEST(IrtStatistics, APlaneThatShowsTwoColumnsCarriesOrderOneAndIsNamed) {
  auto points = points_of({130, 180}, 0.02);
  std::erase_if(points, [](const PlanePoint& p) {
    return p.z_mm > 150 && (std::abs(p.column) != 2 || std::abs(p.row) > 6);
  });
  const IrtFit fit = fit_irt(points, kPlanes, 1, kSize);
  ASSERT_EQ(fit.planes.size(), 2u);
  EXPECT_FALSE(fit.planes[0].is_strip());
  EXPECT_TRUE(fit.planes[1].is_strip());
  EXPECT_TRUE(fit.model.in_domain({512, 512}));
  EXPECT_FALSE(fit.model.in_domain({200, 512}));
  for (const int order : {2, 3, 4, 5}) {  // by noise, by condition, by count
    const std::string message =
        message_of<Error>([&] { (void)fit_irt(points, kPlanes, order, kSize); });
    EXPECT_NE(message.find("the plane z = 180 mm"), std::string::npos) << message;
    EXPECT_NE(message.find("carry order 1 at most"), std::string::npos) << message;
  }
}

TEST(IrtStatistics, APatternThatFillsPartOfTheImageIsNoStrip) {
  const IrtFit fit = fit_irt(within(points_of({130, 180}, 0.02), 80), kPlanes, 4, kSize);
  for (const FittedPlane& p : fit.planes) {
    EXPECT_FALSE(p.is_strip());
    EXPECT_LT(p.noise_gain, 1.0);
  }
}

TEST(IrtStatistics, MapsFlagWhatLiesOutsideTheDomain) {
  const IrtModel model =
      fit_irt(stated(within(points_of({130, 180}, 0.02), 100), 0.02), kPlanes, 5, kSize).model;
  const auto map = sigma_map(model, 130, 5);
  ASSERT_EQ(map.size(), 25u);
  EXPECT_EQ(map[1].pixel_px, Vector2d(255.75, 0));
  EXPECT_TRUE(map[12].in_domain);
  EXPECT_FALSE(map[0].in_domain);
  EXPECT_EQ(map[12].value, model.sigma_mm(map[12].pixel_px, 130));
  EXPECT_GT(map[0].value, 10 * map[12].value);
}

TEST(IrtStatistics, BundleMapShowsAPupilThatWalksAndNoneThatStands) {
  const auto largest = [](double walk_mm_per_rad2) {
    // Rays of a pupil that moves along the axis with the square of the field angle.
    std::vector<PlanePoint> points;
    for (const double z : {0.0, 180.0})
      for (int row = -7; row <= 7; ++row)
        for (int column = -7; column <= 7; ++column) {
          PlanePoint p;
          p.pixel_px = Vector2d(511.5, 511.5) + 70.0 * Vector2d(column, -row);
          const Vector2d slope = Vector2d(column, row) * (70.0 / 1945.0);
          p.on_plane_mm = slope * (700.0 + walk_mm_per_rad2 * slope.squaredNorm() - z);
          p.z_mm = z;
          points.push_back(p);
        }
    double out = 0.0;
    for (const MapPoint& p : bundle_map(fit_irt(points, {0, 180}, 3, kSize).model, 21))
      if (p.in_domain) out = std::max(out, p.value);
    return out;
  };
  EXPECT_LT(largest(0.0), 1e-9);
  // At the corner the pupil is 0.127 rad^2 x 10 mm off where it is in the middle, and the slope 0.36.
  EXPECT_GT(largest(10.0), 0.1);
  EXPECT_LT(largest(10.0), 1.27 * 0.36);
}

TEST(IrtStatistics, ScaleIsTheHeightBelowTheCameraOverItsFocalLength) {
  const IrtModel model = fit_irt(points_of({130, 180}, 0.0), kPlanes, 5, kSize).model;
  for (const double z : {0.0, 130.0, 180.0})
    EXPECT_NEAR(model.mm_per_px({512, 512}, z), (700 - z) / 1945, 0.01 * (700 - z) / 1945);
}

TEST(IrtStatistics, RaysTogetherHaveTheirOwnCovariancesAndWhatOneShareTheyBoth) {
  const IrtModel model = fit_irt(points_of({130, 180}, 0.02), kPlanes, 3, kSize).model;
  const std::vector<Vector2d> pixels{{400, 600}, {650, 300}, {400, 600}};
  const Eigen::MatrixXd joint = model.joint_ray_covariance(pixels);
  ASSERT_EQ(joint.rows(), 6);
  const double scale = joint.diagonal().maxCoeff();
  for (Eigen::Index t = 0; t < 3; ++t) {
    const Eigen::Matrix2d own = model.ray_covariance(pixels[static_cast<std::size_t>(t)]);
    EXPECT_NEAR(joint(t, t), own(0, 0), 1e-12 * scale);
    EXPECT_NEAR(joint(3 + t, t), own(1, 0), 1e-12 * scale);
    EXPECT_NEAR(joint(3 + t, 3 + t), own(1, 1), 1e-12 * scale);
  }
  EXPECT_NEAR(joint(0, 2), joint(0, 0), 1e-12 * scale);  // the same pixel
  EXPECT_GT(std::abs(joint(0, 1)), 1e-6 * scale);        // one polynomial
  EXPECT_LT((joint - joint.transpose()).norm(), 1e-12 * scale);
}

TEST(IrtStatistics, WithoutCovarianceTheUncertaintyIsNotKnownAndOneOfAnotherSizeIsRefused) {
  IrtModel model = fit_irt(points_of({130, 180}, 0.02), kPlanes, 3, kSize).model;
  const Eigen::MatrixXd covariance = model.covariance();
  ASSERT_EQ(covariance.rows(), 20);
  const double sigma = model.sigma_mm({400, 600}, 150);
  model.set_covariance({});
  EXPECT_TRUE(std::isnan(model.sigma_mm({400, 600}, 150)));
  EXPECT_TRUE(std::isnan(model.ray_covariance({400, 600})(0, 1)));
  EXPECT_THROW(model.set_covariance(Eigen::MatrixXd::Identity(10, 10)), Error);
  model.set_covariance(covariance);
  EXPECT_EQ(model.sigma_mm({400, 600}, 150), sigma);
}

}  // namespace
}  // namespace turntable
