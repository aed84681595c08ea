#include "src/imaging/camera_models.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "src/core/errors.h"
#include "src/core/parallel.h"

namespace turntable {
namespace {

FittedCamera fit_ray_model(const CameraData& data) {
  const IrtFit fit = fit_irt(data.fit, data.planes, data.order, data.size);
  FittedCamera out;
  out.parameters = static_cast<int>(fit.model.coefficients().size());
  out.ray = [model = fit.model](const Vector2d& p) { return model.ray(p); };
  out.in_domain = [model = fit.model](const Vector2d& p) { return model.in_domain(p); };
  out.store = [fit, points = data.fit](Calibration& c) { c.set_irt(fit, points); };
  return out;
}

constexpr std::size_t kFewestOfView = 12;

/// The views without what is kept to judge by: a point of the pattern at its height, whichever image
/// shows it.
std::vector<PatternView> views_to_fit(const CameraData& data) {
  std::vector<PatternView> out;
  for (const PatternView& view : data.views) {
    PatternView kept{{}, {}, view.at_zero, view.z_mm};
    for (std::size_t i = 0; i < view.pixels_px.size(); ++i) {
      const auto judges = [&](const PlanePoint& p) {
        return p.z_mm == view.z_mm && p.on_plane_mm == view.on_pattern_mm[i];
      };
      if (view.at_zero && std::ranges::any_of(data.held_out, judges)) continue;
      kept.pixels_px.push_back(view.pixels_px[i]);
      kept.on_pattern_mm.push_back(view.on_pattern_mm[i]);
    }
    // What is left of a view that judges (points that not every image shows) ties nothing down.
    if (kept.pixels_px.size() >= kFewestOfView) out.push_back(std::move(kept));
  }
  return out;
}

template <CentralKind kKind>
FittedCamera fit_central_model(const CameraData& data) {
  const std::vector<PatternView> views = views_to_fit(data);
  // Without planes there is no frame to be tied to: the camera's own will do.
  if (!data.fit.empty() && std::ranges::none_of(views, &PatternView::at_zero))
    throw Error(fmt::format(
        "a {} camera needs a view at zero table angles, which ties it to the plane frame.",
        central_name(kKind)));
  const CentralModel model = fit_central(kKind, views, data.size);
  FittedCamera out;
  // f_x f_y c_x c_y, distortion, where the camera is, and the lean that the heights tell.
  const bool leans = std::ranges::any_of(views, [&](const PatternView& v) {
    return v.at_zero && v.z_mm != std::ranges::find_if(views, &PatternView::at_zero)->z_mm;
  });
  out.parameters = 4 + static_cast<int>(distortion_terms(kKind)) + 6 + (leans ? 2 : 0);
  out.ray = [model, planes = data.planes](const Vector2d& p) { return model.ray(p, planes); };
  out.in_domain = [model](const Vector2d& p) { return model.normalise(p).allFinite(); };
  out.store = [model](Calibration& c) { c.central.push_back(model); };
  return out;
}

constexpr std::array kModels{
    CameraModel{"irt", "imaging ray tracking: two polynomial maps", fit_ray_model},
    CameraModel{"pinhole", "pinhole without distortion", fit_central_model<CentralKind::kPinhole>},
    CameraModel{"brown", "pinhole with k1 k2 p1 p2 k3", fit_central_model<CentralKind::kBrown>},
    CameraModel{"rational", "brown with k4 k5 k6 below the fraction bar",
                fit_central_model<CentralKind::kRational>},
    CameraModel{"fisheye", "polynomial in the field angle, k1 to k4",
                fit_central_model<CentralKind::kFisheye>}};

/// sqrt |det d(x,y)/d(u,v)| at height z.
double mm_per_px(const FittedCamera& camera, const Vector2d& pixel, double z_mm,
                 const RayPlanes& planes) {
  const auto at = [&](double du, double dv) {
    return camera.ray(pixel + Vector2d(du, dv)).at(z_mm, planes);
  };
  const Vector2d du = at(0.5, 0) - at(-0.5, 0), dv = at(0, 0.5) - at(0, -0.5);
  return std::sqrt(std::abs(du.x() * dv.y() - du.y() * dv.x()));
}

struct Misses {
  double squares_mm = 0, squares_px = 0, max_mm = 0, max_px = 0;
  int count = 0;

  void add(double mm, double px) {
    squares_mm += mm * mm;
    squares_px += px * px;
    max_mm = std::max(max_mm, mm);
    max_px = std::max(max_px, px);
    ++count;
  }
};

Misses misses_of(const FittedCamera& camera, std::span<const PlanePoint> points,
                 const RayPlanes& planes) {
  Misses out;
  for (const PlanePoint& p : points) {
    const double miss = (camera.ray(p.pixel_px).at(p.z_mm, planes) - p.on_plane_mm).norm();
    out.add(miss, miss / mm_per_px(camera, p.pixel_px, p.z_mm, planes));
  }
  return out;
}

}  // namespace

const std::span<const CameraModel> kCameraModels(kModels);

const CameraModel* find_camera_model(std::string_view name) {
  const auto it = std::ranges::find(kCameraModels, name, &CameraModel::name);
  return it == kCameraModels.end() ? nullptr : &*it;
}

std::vector<ModelRow> compare_models(const CameraData& data) {
  std::vector<ModelRow> rows(kCameraModels.size());
  std::vector<std::optional<FittedCamera>> cameras(kCameraModels.size());
  parallel_for(kCameraModels.size(), [&](std::size_t i) {
    rows[i].name = kCameraModels[i].name;
    try {
      cameras[i] = kCameraModels[i].fit(data);
      rows[i].parameters = cameras[i]->parameters;
    } catch (const Error& e) {
      rows[i].why_not = e.what();
    }
  });

  const auto judged = [&](std::span<const PlanePoint> points) {
    std::vector<PlanePoint> kept;
    std::ranges::copy_if(points, std::back_inserter(kept), [&](const PlanePoint& p) {
      return std::ranges::all_of(
          cameras, [&](const auto& camera) { return !camera || camera->in_domain(p.pixel_px); });
    });
    return kept;
  };
  const std::vector<PlanePoint> fit = judged(data.fit), held_out = judged(data.held_out);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (!cameras[i]) continue;
    if (const Misses m = misses_of(*cameras[i], fit, data.planes); m.count > 0) {
      rows[i].fit_rms_mm = std::sqrt(m.squares_mm / m.count);
      rows[i].fit_max_mm = m.max_mm;
    }
    if (const Misses m = misses_of(*cameras[i], held_out, data.planes); m.count > 0) {
      rows[i].held_out_rms_mm = std::sqrt(m.squares_mm / m.count);
      rows[i].held_out_rms_px = std::sqrt(m.squares_px / m.count);
      rows[i].held_out_max_mm = m.max_mm;
      rows[i].held_out_max_px = m.max_px;
    }
  }
  return rows;
}

}  // namespace turntable
