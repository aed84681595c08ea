#include "src/evaluation/calibrate.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

#include "src/core/errors.h"
#include "src/core/parallel.h"
#include "src/imaging/camera_models.h"
#include "src/imaging/free_views.h"

namespace turntable {
namespace {

bool any_tilted(const CalibrationSet& set) {
  return std::ranges::any_of(set.views, [](const PatternView& v) { return !v.at_zero; });
}

PlaneResidual kept_out_residual(const IrtModel& model, const SeenPlane& plane) {
  PlaneResidual out;
  out.z_mm = plane.z_mm;
  out.fitted = false;
  double sum = 0.0;
  for (const PlanePoint& p : plane.points) {
    // A point outside the fitted area is extrapolation: no statement about the model there.
    if (!model.in_domain(p.pixel_px)) continue;
    const double miss = residual_mm(model, p).norm();
    sum += miss * miss;
    out.max_mm = std::max(out.max_mm, miss);
    ++out.points;
  }
  if (out.points == 0) out.max_mm = NAN;
  out.rms_mm = std::sqrt(sum / out.points);  // NaN of none
  return out;
}

/// Every central model that the views carry, side by side, into the calibration; none if the pattern
/// was never tilted, because then focal length and distance cannot be told apart.
void add_central_models(const CalibrationSet& set, Calibration& c) {
  if (!any_tilted(set)) return;
  CameraData data;
  data.views = set.views;
  data.size = set.size;
  data.planes = c.irt.planes();
  if (!set.planes.empty()) data.fit = set.points(true);
  std::vector<std::optional<FittedCamera>> fitted(kCameraModels.size());
  parallel_for(fitted.size(), [&](std::size_t i) {
    if (kCameraModels[i].name == "irt") return;  // is there already
    try {
      fitted[i] = kCameraModels[i].fit(data);
    } catch (const Error&) {
      // `compare_models` says why.
    }
  });
  for (const auto& model : fitted)
    if (model) model->store(c);
}

/// What no camera shows, and slips of units and signs do.
void check_depths(const IrtModel& model, const std::vector<PlanePoint>& points,
                  const std::string& name) {
  constexpr double kSteepest = 20.0;  // tan of 87 deg
  constexpr double kTelecentric = 1e-3;
  const RayPlanes planes = model.planes();
  double leans = 0.0, at_a = 0.0, at_b = 0.0;
  for (const PlanePoint& p : points) {
    const Ray ray = model.ray(p.pixel_px);
    leans = std::max(leans, (ray.at_b - ray.at_a).head<2>().norm() / (planes.b_mm - planes.a_mm));
    at_a += model.mm_per_px(p.pixel_px, planes.a_mm);
    at_b += model.mm_per_px(p.pixel_px, planes.b_mm);
  }
  if (!(leans < kSteepest))
    throw ConfigError(
        name, "",
        fmt::format("the rays between the planes at {:g} and {:g} mm lean up to {:.2f} deg from z, "
                    "allowed: below 87 deg. Are all heights and spacings in mm, and the heights "
                    "those of the images?",
                    planes.a_mm, planes.b_mm, std::atan(leans) * 180.0 / std::numbers::pi));
  if (at_b > (1.0 + kTelecentric) * at_a)
    throw ConfigError(
        name, "",
        fmt::format("the pattern looks smaller at {:g} mm than at {:g} mm, allowed: heights that "
                    "grow towards the camera. Change the signs of the heights, or put each image "
                    "to its own height.",
                    planes.b_mm, planes.a_mm));
}

bool same_point(const PlanePoint& a, const PlanePoint& b) {
  return a.row == b.row && a.column == b.column && a.z_mm == b.z_mm;
}

/// What every model is judged on: the planes kept out; where there are none, every seventh point of
/// the others is kept out for this.
std::vector<ModelRow> compare(const CalibrationSet& set, const IrtFit& fit, int order) {
  CameraData data{{}, set.points(false), fit.model.planes(), order, {}, set.size};
  const bool no_plane_kept_out = data.held_out.empty();
  const std::vector<PlanePoint> points = set.points(true);
  std::size_t count = 0;
  for (const PlanePoint& p : points) {
    if (std::ranges::any_of(fit.outliers, [&](const PlanePoint& o) { return same_point(o, p); }))
      continue;
    const bool judge = no_plane_kept_out && ++count % 7 == 0;
    (judge ? data.held_out : data.fit).push_back(p);
  }
  if (any_tilted(set)) data.views = set.views;
  std::vector<ModelRow> rows = compare_models(data);
  if (data.views.empty())
    for (ModelRow& row : rows)
      if (!row.why_not.empty())
        row.why_not =
            "needs views of the tilted pattern: from level planes alone, focal length and distance "
            "cannot be told apart.";
  return rows;
}

Calibration from_planes(const CalibrationSet& set, int order) {
  const std::vector<PlanePoint> fitted = set.points(true), held_out = set.points(false);
  RayPlanes planes{INFINITY, -INFINITY};
  for (const SeenPlane& plane : set.planes)
    if (plane.fit) {
      planes.a_mm = std::min(planes.a_mm, plane.z_mm);
      planes.b_mm = std::max(planes.b_mm, plane.z_mm);
    }
  Calibration c;
  c.orders = compare_orders(fitted, held_out, planes, set.size);
  if (order == kOrderByResiduals) order = choose_order(c.orders);
  const IrtFit fit = fit_irt(fitted, planes, order, set.size);
  check_handedness(fit.model, set.name);
  check_depths(fit.model, fitted, set.name);
  c.set_irt(fit, fitted);
  for (const SeenPlane& plane : set.planes)
    if (!plane.fit) c.planes.push_back(kept_out_residual(fit.model, plane));
  std::ranges::sort(c.planes, {}, &PlaneResidual::z_mm);
  c.models = compare(set, fit, order);
  add_central_models(set, c);
  return c;
}

// ---- boards held by hand

std::vector<FreeView> free_views(std::span<const PatternView> views) {
  std::vector<FreeView> out;
  for (const PatternView& view : views) {
    FreeView free;
    free.pixels_px = view.pixels_px;
    for (const Vector2d& p : view.on_pattern_mm) free.on_target_mm.emplace_back(p.x(), p.y(), 0.0);
    out.push_back(std::move(free));
  }
  return out;
}

/// Scale in the middle of what was seen, mm per px: views tell residuals in pixels.
double mm_per_px(const FreeViewsFit& fit, ImageSize size) {
  const RayPlanes planes = fit.model.planes();
  return fit.model.mm_per_px({0.5 * (size.width - 1), 0.5 * (size.height - 1)},
                             0.5 * (planes.a_mm + planes.b_mm));
}

/// With fewer, none can be kept out.
constexpr std::size_t kViewsToChoose = 6;

/// @throws Error if the fit ended on its way.
FreeViewsFit converged(FreeViewsFit fit) {
  if (!fit.converged)
    throw Error(fmt::format(
        "rays of order {} and the poses of the views do not settle. Lower the order, or take more "
        "views at different tilts.",
        fit.order));
  return fit;
}

/// One row per order: every third view is kept out, and only its pose is fitted afterwards.
std::vector<OrderRow> compare_free_orders(std::span<const FreeView> views, ImageSize size) {
  std::vector<FreeView> train, test;
  for (std::size_t i = 0; i < views.size(); ++i)
    (i % 3 == 2 && views.size() >= kViewsToChoose ? test : train).push_back(views[i]);
  std::vector<OrderRow> rows(9);
  parallel_for(rows.size(), [&](std::size_t i) {
    OrderRow& row = rows[i];
    row.order = static_cast<int>(i) + 1;
    row.terms = static_cast<int>(IrtModel::terms(row.order).size());
    try {
      const FreeViewsFit fit = converged(fit_rays(train, size, row.order));
      const double scale = mm_per_px(fit, size);
      row.points = fit.points;
      row.outliers = static_cast<int>(fit.outliers.size());
      row.rms_mm = fit.rms_px * scale;
      double sum = 0.0;
      for (const FreeView& view : test) {
        const ViewPose pose = fit_pose(fit.model, view);
        if (!pose.converged) throw Error("the pose of a view that was kept out cannot be found.");
        const double count = static_cast<double>(view.pixels_px.size());
        sum += pose.rms_px * pose.rms_px * count;
        row.held_out_points += static_cast<int>(count);
      }
      if (row.held_out_points > 0)
        row.held_out_rms_mm = std::sqrt(sum / row.held_out_points) * scale;
    } catch (const Error& e) {
      row.refused = e.what();
    }
  });
  return rows;
}

/// The lowest order whose views kept out are within 5 % of the best, as `choose_order`.
int choose_free_order(std::span<const OrderRow> rows) {
  double best = INFINITY;
  for (const OrderRow& row : rows)
    if (row.refused.empty()) best = std::min(best, row.held_out_rms_mm);
  for (const OrderRow& row : rows)
    if (row.refused.empty() && row.held_out_rms_mm <= 1.05 * best) return row.order;
  throw Error(
      "the order of the ray model cannot be chosen: none of them fits. State "
      "polynomial_order, or take more views at different tilts.");
}

Calibration from_views(const CalibrationSet& set, int order) {
  const std::vector<FreeView> views = free_views(set.views);
  if (order == kOrderByResiduals && views.size() < kViewsToChoose)
    throw ConfigError(
        set.name, "",
        fmt::format("found {} views, needed {} to choose the order by views kept out. "
                    "State polynomial_order (or --order), or take more views at "
                    "different tilts.",
                    views.size(), kViewsToChoose));
  Calibration c;
  c.orders = compare_free_orders(views, set.size);
  if (order == kOrderByResiduals) order = choose_free_order(c.orders);
  const FreeViewsFit fit = converged(fit_rays(views, set.size, order));
  check_handedness(fit.model, set.name);
  c.irt = fit.model;
  c.sigma_mm = fit.sigma_px * mm_per_px(fit, set.size);
  c.points = fit.points;
  for (const FreeViewsFit::Outlier& o : fit.outliers) {
    PlanePoint point;
    point.pixel_px = views[o.view].pixels_px[o.point];
    point.on_plane_mm = views[o.view].on_target_mm[o.point].head<2>();
    // Named by its view and its place in it: there is no plane.
    point.row = static_cast<int>(o.view);
    point.column = static_cast<int>(o.point);
    c.outliers.push_back(point);
  }
  add_central_models(set, c);
  return c;
}

}  // namespace

Calibration calibrate(const CalibrationSet& set) {
  const int order = set.order;
  Calibration c;
  try {
    c = set.planes.empty() ? from_views(set, order) : from_planes(set, order);
  } catch (const ConfigError&) {
    throw;
  } catch (const Interrupted&) {
    throw;
  } catch (const Error& e) {  // of the fit, which does not know where its points come from
    throw ConfigError(set.name, "", e.what());
  }
  c.source = set.source;
  c.simulated = set.simulated;
  c.images = set.images;
  c.stage = set.stage;
  return c;
}

}  // namespace turntable
