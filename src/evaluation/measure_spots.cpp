#include "src/evaluation/measure_spots.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>

#include "src/attitude/correspondence.h"
#include "src/vision/matching.h"
#include "src/vision/spots.h"

namespace turntable {
namespace {

/// Of a target or a spot whose uncertainty nobody states.
constexpr double kAssumedTargetSigmaMm = 0.02;
constexpr double kAssumedSpotSigmaPx = 0.1;

std::vector<Vector3d> points_of(const TargetModel& target) {
  std::vector<Vector3d> points;
  for (int t = 0; t < target.size(); ++t) points.push_back(target.points().col(t));
  return points;
}

/// Standard deviation of a ray's coordinates at the target, the target's own included.
double sigma_at_target_mm(const AttitudeSensor& sensor, const SpotList& spots,
                          double target_uncertainty_mm) {
  const RayPlanes& planes = sensor.planes();
  const double middle = 0.5 * (planes.a_mm + planes.b_mm);
  double sigma_px = 0.0;
  for (const double s : spots.sigmas_px) sigma_px = std::max(sigma_px, s);
  if (!(sigma_px > 0.0)) sigma_px = kAssumedSpotSigmaPx;
  const Vector2d& at = spots.centres_px.front();
  const double mm_per_px = (sensor.ray(at + Vector2d(0.5, 0.0)).at(middle, planes) -
                            sensor.ray(at - Vector2d(0.5, 0.0)).at(middle, planes))
                               .norm();
  const double target_mm =
      target_uncertainty_mm > 0.0 ? target_uncertainty_mm : kAssumedTargetSigmaMm;
  const double sigma = std::hypot(sigma_px * mm_per_px, target_mm);
  return std::isfinite(sigma) ? sigma : target_mm;
}

/// Fills in the attitude for spots that are known.
void solve_matched(const AttitudeSensor& sensor, const SpotList& spots,
                   double target_uncertainty_mm, TargetMeasurement& out) {
  std::vector<Vector2d> points;
  std::vector<Eigen::Matrix2d> covariances;
  for (const int spot : out.spot_of_point) {
    const auto i = static_cast<std::size_t>(spot);
    points.push_back(spots.centres_px[i]);
    if (!spots.sigmas_px.empty() && spots.sigmas_px[i] > 0.0)
      covariances.push_back(spots.sigmas_px[i] * spots.sigmas_px[i] * Eigen::Matrix2d::Identity());
  }
  if (covariances.size() != points.size()) covariances.clear();
  out.attitude = sensor.measure(points, covariances);
  out.uncertainty = sensor.uncertainty(points, covariances, out.attitude, target_uncertainty_mm);
  out.status = status_name(out.attitude.status);
}

}  // namespace

double match_gate_mm(std::span<const Vector3d> points_mm) {
  double smallest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < points_mm.size(); ++i)
    for (std::size_t j = i + 1; j < points_mm.size(); ++j)
      smallest = std::min(smallest, (points_mm[i] - points_mm[j]).norm());
  return 0.25 * smallest;
}

TargetMeasurement measure_named_spots(const AttitudeSensor& sensor, const SpotList& spots,
                                      double target_uncertainty_mm) {
  TargetMeasurement out;
  out.spot_of_point.resize(spots.centres_px.size());
  std::iota(out.spot_of_point.begin(), out.spot_of_point.end(), 0);
  solve_matched(sensor, spots, target_uncertainty_mm, out);
  return out;
}

SpotList spots_in(ImageView image, double electrons_per_grey) {
  SpotList list;
  for (const Spot& spot : find_spots(image, {.electrons_per_grey = electrons_per_grey}).spots) {
    list.centres_px.push_back(spot.centre_px);
    list.sigmas_px.push_back(spot.sigma_px);
  }
  return list;
}

TargetMeasurement measure_spots(const AttitudeSensor& sensor, const SpotList& spots,
                                const TargetSearch& search, const MeasuredAttitude* near) {
  const TargetModel& target = sensor.target();
  TargetMeasurement out;
  if (spots.centres_px.size() < static_cast<std::size_t>(target.size())) {
    out.status = fmt::format("too few spots: {} of {}", spots.centres_px.size(), target.size());
    return out;
  }
  std::vector<Ray> rays;
  for (const Vector2d& centre : spots.centres_px) rays.push_back(sensor.ray(centre));

  if (near != nullptr) {
    const std::vector<Vector3d> points = points_of(target);
    std::vector<Vector3d> predicted;
    for (const Vector3d& p : points)
      predicted.push_back(near->R_plane_from_target * (p - points.front()) + near->position_mm);
    const Match match =
        match_to_prediction(predicted, rays, sensor.planes(), match_gate_mm(points));
    out.status = match_status_name(match.status);
    if (match.status == MatchStatus::kMatched) {
      out.predicted = true;
      out.spot_of_point = match.ray_of_point;
      solve_matched(sensor, spots, search.target_uncertainty_mm, out);
      if (out.attitude.has_attitude() || target.coplanar()) return out;
      out = {};
    } else if (target.coplanar()) {
      return out;
    }
  } else if (target.coplanar()) {
    throw std::invalid_argument("correspondence without a prediction needs a target with depth");
  }

  CorrespondenceOptions options;
  options.sigma_mm = sigma_at_target_mm(sensor, spots, search.target_uncertainty_mm);
  options.R_near = search.R_near;
  options.max_turn_rad = search.max_turn_rad;
  const Correspondence found = correspond(target, rays, sensor.planes(), options);
  switch (found.status) {
    case CorrespondenceStatus::kMatched:
      out.spot_of_point = found.ranked.front().spot_of_point;
      solve_matched(sensor, spots, search.target_uncertainty_mm, out);
      break;
    case CorrespondenceStatus::kAmbiguous:
      out.status = match_status_name(MatchStatus::kAmbiguous);
      break;
    case CorrespondenceStatus::kTooFewSpots:
      out.status = match_status_name(MatchStatus::kTooFewSpots);
      break;
    case CorrespondenceStatus::kNoFit:
      out.status = "no target";
      break;
  }
  return out;
}

}  // namespace turntable
