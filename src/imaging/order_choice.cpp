#include "src/imaging/order_choice.h"

#include <algorithm>

#include "src/core/errors.h"

namespace turntable {
namespace {

/// Of two figures this near each other neither is better: from 100 points an rms is known to 5 %.
constexpr double kAsGood = 1.05;

double judged_by(const OrderRow& row) {
  return row.held_out_points > 0 ? std::max(row.held_out_rms_mm, row.loo_rms_mm) : row.loo_rms_mm;
}

}  // namespace

std::vector<OrderRow> compare_orders(std::span<const PlanePoint> fit,
                                     std::span<const PlanePoint> held_out, RayPlanes planes,
                                     ImageSize size, int max_order) {
  std::vector<OrderRow> rows;
  std::vector<IrtFit> fits;
  for (int order = 1; order <= max_order; ++order) {
    OrderRow row;
    row.order = order;
    row.terms = (order + 1) * (order + 2) / 2;
    IrtFit f;
    try {
      f = fit_irt(fit, planes, order, size);
    } catch (const Error& e) {
      if (order == 1) throw;
      row.refused = e.what();
    }
    rows.push_back(row);
    fits.push_back(std::move(f));
  }

  std::vector<bool> kept_by_some(fit.size(), false);
  for (const IrtFit& f : fits)
    for (const PointStatistics& p : f.used) kept_by_some[p.index] = true;

  for (std::size_t i = 0; i < rows.size(); ++i) {
    OrderRow& row = rows[i];
    const IrtFit& f = fits[i];
    if (!row.refused.empty()) continue;
    row.points = f.points;
    row.outliers = static_cast<int>(f.outliers.size());
    row.rms_mm = f.rms_mm;
    row.condition = f.condition;
    row.max_leverage = f.max_leverage;
    row.chi2_per_dof = f.chi2_per_dof;

    // A point that another order follows is no outlier, and is left out of this fit already.
    std::vector<bool> used(fit.size(), false);
    for (const PointStatistics& p : f.used) used[p.index] = true;
    double left_out = f.loo_rms_mm * f.loo_rms_mm * f.points;
    int count = f.points;
    for (std::size_t k = 0; k < fit.size(); ++k)
      if (kept_by_some[k] && !used[k]) {
        left_out += residual_mm(f.model, fit[k]).squaredNorm();
        ++count;
      }
    row.loo_rms_mm = std::sqrt(left_out / count);

    double inside = 0.0, outside = 0.0, max = 0.0;
    for (const PlanePoint& p : held_out) {
      const double miss = residual_mm(f.model, p).norm();
      if (f.model.in_domain(p.pixel_px)) {
        inside += miss * miss;
        max = std::max(max, miss);
        ++row.held_out_points;
      } else {
        outside += miss * miss;
        ++row.outside_points;
      }
    }
    if (row.held_out_points > 0) {
      row.held_out_rms_mm = std::sqrt(inside / row.held_out_points);
      row.held_out_max_mm = max;
    }
    if (row.outside_points > 0) row.outside_rms_mm = std::sqrt(outside / row.outside_points);
  }
  return rows;
}

int choose_order(std::span<const OrderRow> rows) {
  double best = INFINITY;
  for (const OrderRow& row : rows)
    if (row.refused.empty()) best = std::min(best, judged_by(row));
  for (const OrderRow& row : rows)  // by order
    if (row.refused.empty() && judged_by(row) <= kAsGood * best) return row.order;
  throw Error(
      "no polynomial order can be chosen: the points carry none. Show more of the pattern.");
}

}  // namespace turntable
