// Which polynomial order the points justify. Training residuals fall with every order; two others do
// not: those on planes kept out of the fit, which show a model that bends between the planes, and
// those of points each left out of the fit in turn (Allen 1974, PRESS), which show one that follows
// the noise of single points. An order is as good as the worse of the two, and of orders that are
// equally good the lowest is right. Units: mm.
#pragma once

#include <cmath>
#include <span>
#include <string>
#include <vector>

#include "src/imaging/irt.h"

namespace turntable {

/// One order of a comparison; lengths of residuals in the plane.
struct OrderRow {
  int order = 0;
  int terms = 0;  ///< per map
  int points = 0, outliers = 0;
  double rms_mm = NAN;  ///< of the fitted points
  /// Of the fitted points, each left out in turn, and of those that only this order calls outliers:
  /// an order too stiff for the edge of the image shall not look better for dropping it.
  double loo_rms_mm = NAN;
  double held_out_rms_mm = NAN;  ///< of the held-out points inside the domain
  double held_out_max_mm = NAN;
  int held_out_points = 0;      ///< inside the domain
  double outside_rms_mm = NAN;  ///< of the held-out points outside the domain
  int outside_points = 0;
  double condition = NAN, max_leverage = NAN, chi2_per_dof = NAN;
  std::string refused;  ///< why there is no such fit; empty if there is one
};

/// One row per order, 1 to max_order; an order that the points do not carry has its reason.
/// @throws Error if not even order 1 can be fitted.
std::vector<OrderRow> compare_orders(std::span<const PlanePoint> fit,
                                     std::span<const PlanePoint> held_out, RayPlanes planes,
                                     ImageSize size, int max_order = 9);

/// The lowest order whose larger one of held-out and leave-one-out rms is within 5 % of the smallest;
/// without held-out points in the domain leave-one-out alone judges.
/// @throws Error if every order is refused.
int choose_order(std::span<const OrderRow> rows);

}  // namespace turntable
