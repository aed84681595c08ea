#include "src/evaluation/calibrate.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <map>

#include "src/core/errors.h"
#include "src/core/parallel.h"
#include "src/record/sha256.h"
#include "src/vision/pattern.h"

namespace turntable {
namespace {

/// Mean centre of every circle over the images of one pose.
struct PoseView {
  const TakenPose* pose = nullptr;
  std::map<std::array<int, 2>, Vector2d> centres_px;  ///< (row, column) -> mean
};

PoseView view_of(const TakenPose& pose, const RunFolder& folder, const RigFile& rig) {
  PoseView view;
  view.pose = &pose;
  std::map<std::array<int, 2>, int> seen;
  for (const TakenImage& taken : pose.images) {
    const Image image = load_image(folder, taken);
    const std::string file = (folder.root() / taken.file).string();
    if (image.size() != rig.camera.image_size)
      throw ConfigError(
          file, "",
          fmt::format("found {} x {} px, allowed: {} x {} px as the rig file says.", image.width,
                      image.height, rig.camera.image_size.width, rig.camera.image_size.height));
    const PatternSearch search = find_pattern(image, rig.pattern);
    if (search.status != PatternStatus::kFound)
      throw ConfigError(
          file, "",
          fmt::format(
              "{} ({} round components seen, {} cut by the border). Check focus, light and the "
              "pattern section of the rig file.",
              pattern_status_name(search.status), search.candidates, search.cut_by_border));
    for (const PatternPoint& c : search.points) {
      view.centres_px.try_emplace({c.row, c.column}, Vector2d::Zero()).first->second += c.centre_px;
      ++seen[{c.row, c.column}];
    }
  }
  for (auto& [key, centre] : view.centres_px) centre /= seen[key];
  // A circle near the border that only some images show would average other noise than its
  // neighbours.
  std::erase_if(view.centres_px, [&](const auto& entry) {
    return seen[entry.first] != static_cast<int>(pose.images.size());
  });
  return view;
}

/// Circles of a pose of the zero-angle planes, at the height that the stage read back.
std::vector<PlanePoint> points_of(const PoseView& view, double spacing_mm) {
  std::vector<PlanePoint> points;
  for (const auto& [key, centre] : view.centres_px)
    points.push_back(
        {centre, Vector2d(key[1], key[0]) * spacing_mm, view.pose->stage.position, key[1], key[0]});
  return points;
}

PatternView pattern_view(const PoseView& view, double spacing_mm) {
  PatternView out;
  for (const auto& [key, centre] : view.centres_px) {
    out.pixels_px.push_back(centre);
    out.on_pattern_mm.emplace_back(key[1] * spacing_mm, key[0] * spacing_mm);
  }
  out.at_zero = view.pose->planned.role != PoseRole::kPinholeView;
  out.z_mm = out.at_zero ? view.pose->stage.position : 0.0;
  return out;
}

bool shows_a_plane(const TakenPose& pose) {
  return pose.planned.role == PoseRole::kPlaneFit || pose.planned.role == PoseRole::kPlaneCheck;
}

}  // namespace

std::vector<PlanePoint> plane_points(const RunRecord& record, const RunFolder& folder,
                                     const RigFile& rig) {
  std::vector<PlanePoint> points;
  for (const TakenPose& pose : record.poses) {
    if (!shows_a_plane(pose)) continue;
    const bool archived = std::ranges::all_of(pose.images, [&](const TakenImage& image) {
      return !image.file.empty() && std::filesystem::exists(folder.root() / image.file);
    });
    if (!archived) continue;
    const auto more = points_of(view_of(pose, folder, rig), rig.pattern.spacing_mm);
    points.insert(points.end(), more.begin(), more.end());
  }
  return points;
}

std::string calibration_source(const Plan& plan) {
  return fmt::format("{} (plan {})", plan.name, sha256_hex(plan_text(plan)).substr(0, 12));
}

bool has_calibration_sweep(const Plan& plan) {
  return std::ranges::any_of(
      plan.scenarios, [](const ScenarioInfo& s) { return s.kind == ScenarioKind::kCalibration; });
}

CalibrationResult calibrate(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                            const CalibrateOptions& options) {
  std::vector<const TakenPose*> poses;
  std::size_t images = 0;
  int order = options.order;
  for (const TakenPose& pose : record.poses) {
    const ScenarioInfo& scenario = record.plan.scenario_of(pose.planned);
    if (scenario.kind != ScenarioKind::kCalibration) continue;
    poses.push_back(&pose);
    images += pose.images.size();
    if (order == 0) order = scenario.polynomial_order;
  }
  if (poses.empty())
    throw ConfigError(folder.root().string(), "",
                      "holds no images of a calibration sweep. Run a campaign with a calibration "
                      "scenario, or name a "
                      "calibration with --calibration.");

  std::vector<PoseView> views(poses.size());
  std::atomic<std::size_t> done{0};
  parallel_for(poses.size(), [&](std::size_t i) {
    views[i] = view_of(*poses[i], folder, rig);
    done += poses[i]->images.size();
    if (options.progress) options.progress(done, images);
  });

  CalibrationResult result;
  std::vector<PlanePoint> fit_points;
  std::vector<PlaneResidual> planes;
  std::vector<std::vector<PlanePoint>> plane_points;
  RayPlanes ray_planes{INFINITY, -INFINITY};
  std::vector<PatternView> pinhole_views;
  bool tilted = false;
  for (const PoseView& view : views) {
    pinhole_views.push_back(pattern_view(view, rig.pattern.spacing_mm));
    if (view.pose->planned.role == PoseRole::kPinholeView) {
      tilted = true;
      continue;
    }
    const double z = view.pose->stage.position;
    const bool fitted = view.pose->planned.role == PoseRole::kPlaneFit;
    std::vector<PlanePoint> points = points_of(view, rig.pattern.spacing_mm);
    if (fitted) {
      ray_planes.a_mm = std::min(ray_planes.a_mm, z);
      ray_planes.b_mm = std::max(ray_planes.b_mm, z);
      fit_points.insert(fit_points.end(), points.begin(), points.end());
    }
    result.points.insert(result.points.end(), points.begin(), points.end());
    PlaneResidual plane;
    plane.z_mm = z;
    plane.fitted = fitted;
    planes.push_back(plane);
    plane_points.push_back(std::move(points));
  }

  const IrtFit fit = fit_irt(fit_points, ray_planes, order, rig.camera.image_size);
  check_handedness(fit.model, folder.root().string());
  for (std::size_t i = 0; i < planes.size(); ++i) {
    double sum = 0.0;
    for (const PlanePoint& p : plane_points[i]) {
      // A circle outside the fitted area is extrapolation: no statement about the model there.
      if (!fit.model.in_domain(p.pixel_px)) continue;
      const double miss = residual_mm(fit.model, p).norm();
      sum += miss * miss;
      planes[i].max_mm = std::max(planes[i].max_mm, miss);
      ++planes[i].points;
    }
    planes[i].rms_mm = planes[i].points > 0 ? std::sqrt(sum / planes[i].points) : 0.0;
  }

  Calibration& c = result.calibration;
  c.source = calibration_source(record.plan);
  c.simulated = rig.simulated();
  c.irt = fit.model;
  c.sigma_mm = fit.sigma_mm;
  c.points = fit.points;
  c.outliers = fit.outliers;
  c.planes = planes;
  if (tilted) {
    constexpr std::array kKinds{CentralKind::kPinhole, CentralKind::kBrown};
    c.central.resize(kKinds.size());
    parallel_for(kKinds.size(), [&](std::size_t i) {
      c.central[i] = fit_central(kKinds[i], pinhole_views, rig.camera.image_size);
    });
  }
  return result;
}

}  // namespace turntable
