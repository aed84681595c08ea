#include "src/imaging/order_choice.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <iostream>
#include <sstream>

#include "src/core/errors.h"
#include "tests/imaging/lattice_points.h"
#include "tests/support/draws.h"
#include "tests/support/real_data.h"

namespace turntable {
namespace {

OrderRow row_of(int order, double held_out, double left_out) {
  OrderRow row;
  row.order = order;
  row.held_out_points = held_out > 0 ? 100 : 0;
  row.held_out_rms_mm = held_out;
  row.loo_rms_mm = left_out;
  return row;
}

void print(std::span<const OrderRow> rows) {
  for (const OrderRow& r : rows)
    std::cout
        << (r.refused.empty()
                ? fmt::format(
                      "order {}: fitted {:.4f}, left out {:.4f}, held out {:.4f} ({} points), "
                      "outside {:.4f} ({}) mm rms; condition {:.3g}, leverage {:.2f}\n",
                      r.order, r.rms_mm, r.loo_rms_mm, r.held_out_rms_mm, r.held_out_points,
                      r.outside_rms_mm, r.outside_points, r.condition, r.max_leverage)
                : fmt::format("order {}: {}\n", r.order, r.refused));
}

/// Rms over all held-out points, inside and outside the domain.
double all_held_out(const OrderRow& r) {
  const double in = r.held_out_points, out = r.outside_points;
  return std::sqrt(((in > 0 ? in * r.held_out_rms_mm * r.held_out_rms_mm : 0.0) +
                    (out > 0 ? out * r.outside_rms_mm * r.outside_rms_mm : 0.0)) /
                   (in + out));
}

TEST(OrderChoice, TakesTheLowestOfThoseThatAreEquallyGoodByTheirWorseFigure) {
  // The published plate: held-out planes alone would choose the highest order.
  const OrderRow plate[] = {row_of(1, .0224, .0246), row_of(2, .0095, .0108),
                            row_of(3, .0088, .0114), row_of(4, .0074, .0141),
                            row_of(5, .0053, .0187)};
  EXPECT_EQ(choose_order(plate), 2);
  const OrderRow near[] = {row_of(4, .0104, .0100), row_of(5, .0100, .0099),
                           row_of(6, .0099, .0100)};
  EXPECT_EQ(choose_order(near), 4);
  const OrderRow no_planes[] = {row_of(1, 0, .02), row_of(2, 0, .01), row_of(3, 0, .011)};
  EXPECT_EQ(choose_order(no_planes), 2);
  OrderRow refused = row_of(1, .001, .001);
  refused.refused = "too few points";
  EXPECT_THROW(choose_order({&refused, 1}), Error);
}

TEST(OrderChoice, OfTheSimulatedRigGivesChiSquareOneAndMicrometresOnEveryPlane) {
  constexpr double kNoise = 0.005;
  const auto fit = stated(points_of({130, 180}, kNoise, 1, "simulated"), kNoise);
  const auto base = points_of({0}, kNoise, 2, "simulated");
  const RayPlanes planes{130, 180};
  const auto rows = compare_orders(fit, base, planes, kSize);
  print(rows);
  const int order = choose_order(rows);
  const IrtFit chosen = fit_irt(fit, planes, order, kSize);
  std::cout << fmt::format("chosen: order {}, chi2/dof {:.3f}, max {:.4f} mm\n", order,
                           chosen.chi2_per_dof, chosen.max_mm);
  EXPECT_TRUE(chosen.outliers.empty());
  EXPECT_GE(chosen.chi2_per_dof, 0.8);
  EXPECT_LE(chosen.chi2_per_dof, 1.2);
  EXPECT_LE(chosen.max_mm, 0.02);
  const OrderRow& row = rows[static_cast<std::size_t>(order - 1)];
  EXPECT_GT(row.held_out_points, 100);
  EXPECT_LE(row.held_out_max_mm, 0.03);
}

TEST(OrderChoice, DoesNotFlatterAnOrderThatDropsWhatItCannotFollow) {
  auto points = points_of({130, 180}, 0.005, 3, "simulated");
  points[100].pixel_px.x() += 5.0;  // and this is an outlier to every order that can tell
  const auto rows = compare_orders(points, {}, {130, 180}, kSize, 6);
  print(rows);
  ASSERT_GT(rows[2].outliers, rows[4].outliers);
  EXPECT_EQ(rows[4].outliers, 1);
  const IrtFit stiff = fit_irt(points, {130, 180}, 3, kSize);
  EXPECT_GT(rows[2].loo_rms_mm, 1.05 * stiff.loo_rms_mm);
  EXPECT_LT(rows[3].loo_rms_mm, rows[2].loo_rms_mm);
  EXPECT_EQ(choose_order(rows), 5);
}

// Real data: points of cameras that nobody here built.

TEST(OrderChoice, OnARealSteppedTargetRecognisesTheStripAndStaysAtOrderOne) {
  const auto folder = real_data();
  if (!folder) GTEST_SKIP() << "NOT TESTED: no real data, set TURNTABLE_REAL";
  std::ifstream in(*folder / "myptv_camera_1" / "cam1_cal_points");
  std::vector<PlanePoint> fit, held_out;
  PlanePoint p;
  while (in >> p.pixel_px.x() >> p.pixel_px.y() >> p.on_plane_mm.x() >> p.on_plane_mm.y() >> p.z_mm)
    (p.z_mm == -6.0 ? held_out : fit).push_back(p);
  ASSERT_EQ(fit.size(), 332u);
  ASSERT_EQ(held_out.size(), 89u);
  const ImageSize size{1280, 1024};
  const auto rows = compare_orders(fit, held_out, {-12, 0}, size);
  print(rows);
  EXPECT_EQ(choose_order(rows), 1);
  EXPECT_NEAR(all_held_out(rows[0]), 0.11, 0.01);
  // The step at -12 mm shows two columns of dots.
  for (std::size_t i = 1; i < rows.size(); ++i) {
    EXPECT_NE(rows[i].refused.find("z = -12 mm"), std::string::npos) << rows[i].refused;
    EXPECT_NE(rows[i].refused.find("order 1 at most"), std::string::npos) << rows[i].refused;
  }
  const IrtFit linear = fit_irt(fit, {-12, 0}, 1, size);
  EXPECT_TRUE(linear.planes[0].is_strip());
  EXPECT_FALSE(linear.planes[1].is_strip());
  EXPECT_GT(rows[0].outside_points, 40);
  EXPECT_NO_THROW(check_handedness(linear.model, "stepped target"));
}

TEST(OrderChoice, OnARealPlateIsTwoAndOrderFiveFollowsTheNoise) {
  const auto folder = real_data();
  if (!folder) GTEST_SKIP() << "NOT TESTED: no real data, set TURNTABLE_REAL";
  std::ifstream in(*folder / "piv_case_e_camera_1" / "points.csv");
  std::vector<PlanePoint> fit, held_out;
  std::string line;
  std::getline(in, line);
  while (std::getline(in, line)) {
    std::ranges::replace(line, ',', ' ');
    std::istringstream fields(line);
    int plane = 0;
    // The dots are at these v counted from the top, as everywhere in this project.
    PlanePoint p;
    fields >> plane >> p.z_mm >> p.on_plane_mm.x() >> p.on_plane_mm.y() >> p.pixel_px.x() >>
        p.pixel_px.y();
    ASSERT_TRUE(fields) << line;
    (std::abs(p.z_mm) == 3.0 ? fit : held_out).push_back(p);
  }
  ASSERT_EQ(fit.size(), 72u);
  ASSERT_EQ(held_out.size(), 180u);
  const auto rows = compare_orders(fit, held_out, {-3, 3}, kSize);
  print(rows);
  EXPECT_EQ(choose_order(rows), 2);
  // The training residual falls to the end; what a point left out says grows after order 2.
  for (std::size_t i = 1; i < 5; ++i) EXPECT_LT(rows[i].rms_mm, rows[i - 1].rms_mm);
  EXPECT_GT(rows[4].loo_rms_mm, 1.5 * rows[1].loo_rms_mm);
  EXPECT_GT(rows[4].max_leverage, 0.9);
  // Held-out planes alone would not tell: they stay where they were.
  EXPECT_LT(all_held_out(rows[4]), 1.1 * all_held_out(rows[1]));
  EXPECT_FALSE(rows[5].refused.empty());  // 36 points do not carry 28 terms
  EXPECT_NO_THROW(check_handedness(fit_irt(fit, {-3, 3}, 2, kSize).model, "plate"));
}

}  // namespace
}  // namespace turntable
