#include "src/campaign/inspection.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "src/campaign/planning.h"
#include "src/vision/matching.h"
#include "src/vision/pattern.h"
#include "src/vision/spots.h"

namespace turntable {
namespace {

/// Pixels of a box and two more on each side, as far as the image goes.
struct Window {
  Window(ImageView image, const PixelBox& box)
      : left(std::max(box.left - 2, 0)),
        top(std::max(box.top - 2, 0)),
        right(std::min(box.right + 2, image.width - 1)),
        bottom(std::min(box.bottom + 2, image.height - 1)) {}
  bool border(int u, int v) const { return u == left || u == right || v == top || v == bottom; }
  template <class F>
  void each(ImageView image, F&& f) const {
    for (int v = top; v <= bottom; ++v)
      for (int u = left; u <= right; ++u) f(u, v, static_cast<double>(image.row(v)[u]));
  }
  int left, top, right, bottom;
};

double spot_blur_px(ImageView image, const Spot& spot, double radius_px) {
  const Window window(image, spot.box);
  double ground = 0.0;
  int pixels = 0;
  window.each(image, [&](int u, int v, double grey) {
    if (!window.border(u, v)) return;
    ground += grey;
    ++pixels;
  });
  ground /= std::max(pixels, 1);
  double light = 0.0, uu = 0.0, vv = 0.0, uv = 0.0;
  window.each(image, [&](int u, int v, double grey) {
    const double w = std::max(0.0, grey - ground);
    const double x = u - spot.centre_px.x(), y = v - spot.centre_px.y();
    light += w;
    uu += w * x * x;
    vv += w * y * y;
    uv += w * x * y;
  });
  if (!(light > 0.0)) return 0.0;
  const double half = 0.5 * (uu - vv), mean = 0.5 * (uu + vv);
  const double larger = (mean + std::hypot(half, uv)) / light;
  return std::sqrt(std::max(0.0, larger - 0.25 * radius_px * radius_px));
}

double edge_blur_px(ImageView image, const PixelBox& box) {
  const Window window(image, box);
  double low = 255.0, high = 0.0;
  window.each(image, [&](int, int, double grey) {
    low = std::min(low, grey);
    high = std::max(high, grey);
  });
  int between = 0;
  window.each(image, [&](int, int, double grey) {
    const double part = (grey - low) / std::max(high - low, 1.0);
    between += part > 0.25 && part < 0.75;
  });
  const double circumference =
      std::numbers::pi * 0.5 * ((box.right - box.left + 1) + (box.bottom - box.top + 1));
  return between / circumference / 1.35;
}

std::string blur_complaint(double blur_px, const RigFile& rig) {
  if (blur_px <= rig.inspection.max_blur_px) return {};
  return fmt::format("blurred by {:.1f} px, allowed: {} px", blur_px, rig.inspection.max_blur_px);
}

/// @param spots brightest first.
std::string led_complaint(ImageView image, const std::vector<Spot>& spots, const PlannedPose& pose,
                          const RigFile& rig) {
  const std::size_t leds = rig.target.points_mm.size();
  if (spots.size() < leds)
    return fmt::format("{} spots, allowed: {} LEDs or more", spots.size(), leds);
  if (spots.size() > kMaxSpots)
    return fmt::format("{} bright spots, allowed: at most {}", spots.size(), kMaxSpots);

  const std::vector<ImagePoint> predicted = predicted_points(pose, rig);
  const double height = rig.camera.nominal_height_mm, focal = rig.camera.nominal_focal_px;
  const double u0 = 0.5 * (image.width - 1), v0 = 0.5 * (image.height - 1);
  const auto on_plane = [&](double u, double v, double z) {
    return Vector2d((u - u0) * (height - z) / focal, -(v - v0) * (height - z) / focal);
  };
  std::vector<Vector3d> points;
  for (const ImagePoint& p : predicted) {
    if (!p.visible()) return {};  // the plan's check has its say about that
    const double z = height - p.depth_mm;
    const Vector2d at = on_plane(p.u_px, p.v_px, z);
    points.emplace_back(at.x(), at.y(), z);
  }
  const RayPlanes planes{0.0, 0.5 * height};
  std::vector<Ray> rays;
  for (const Spot& spot : spots) {
    const double u = spot.centre_px.x(), v = spot.centre_px.y();
    rays.push_back({on_plane(u, v, planes.a_mm), on_plane(u, v, planes.b_mm)});
  }
  const Match match = match_to_prediction(points, rays, planes, rig.inspection.max_residual_mm);
  if (match.status != MatchStatus::kMatched)
    return fmt::format(
        "LEDs not where the nominal camera would see them ({}{}), allowed: {:.3g} mm",
        match_status_name(match.status),
        match.point >= 0 ? fmt::format(", LED {}", match.point) : "",
        rig.inspection.max_residual_mm);
  double blur = 0.0;
  for (std::size_t i = 0; i < leds; ++i) {
    const Spot& spot = spots[static_cast<std::size_t>(match.ray_of_point[i])];
    if (spot.saturated) return fmt::format("LED {} is clipped: expose less", i);
    blur = std::max(blur, spot_blur_px(image, spot, predicted[i].radius_px));
  }
  return blur_complaint(blur, rig);
}

std::string pattern_complaint(ImageView image, const PatternSearch& search, const RigFile& rig) {
  if (search.status != PatternStatus::kFound)
    return fmt::format("pattern: {}", pattern_status_name(search.status));
  if (rig.pattern.kind == PatternKind::kChessboard) return {};
  std::vector<double> blurs;
  for (const PatternPoint& point : search.points) blurs.push_back(edge_blur_px(image, point.box));
  const auto middle = blurs.begin() + static_cast<std::ptrdiff_t>(blurs.size() / 2);
  std::nth_element(blurs.begin(), middle, blurs.end());
  return blur_complaint(*middle, rig);
}

}  // namespace

Inspection inspect(ImageView image, const PlannedPose& pose, const RigFile& rig) {
  Inspection out;
  if (pose.payload == Payload::kCirclePattern) {
    const PatternSearch search = find_pattern(image, rig.pattern);
    out.target_seen = search.status == PatternStatus::kFound;
    out.complaint = pattern_complaint(image, search, rig);
    return out;
  }
  const SpotSearch search =
      find_spots(image, {.electrons_per_grey = rig.camera.electrons_per_grey});
  out.spots.emplace();
  for (const Spot& s : search.spots) {
    if (out.regions.size() == kMaxSpots) break;
    out.spots->push_back(
        {s.centre_px.x(), s.centre_px.y(), s.sigma_px, s.peak_grey, s.area_px, s.saturated});
    out.regions.push_back({s.box.left, s.box.top, s.box.right, s.box.bottom});
  }
  out.target_seen = search.spots.size() >= rig.target.points_mm.size();
  // An image that did not show what it should is kept whole: somebody will want to know why.
  out.worth_regions = out.target_seen && search.spots.size() <= kMaxSpots;
  out.complaint = led_complaint(image, search.spots, pose, rig);
  return out;
}

}  // namespace turntable
