// How far a pose's points are seen from their sightings on a pinhole.
#pragma once

#include <cmath>
#include <span>

#include "src/attitude/target.h"

namespace turntable {

/// Root mean square over the points of |(x, y)/z - normalised_t| for R M0Mt + T, in normalised units.
/// NaN if a point is not in front of the camera (z > 0).
inline double reprojection_rms(const TargetModel& target, std::span<const Vector2d> normalised,
                               const Matrix3d& R, const Vector3d& T) {
  double sum = 0.0;
  for (int t = 0; t < target.size(); ++t) {
    const Vector3d point = R * (target.points().col(t) - target.points().col(0)) + T;
    if (!(point.z() > 0.0)) return std::nan("");
    sum += (point.head<2>() / point.z() - normalised[static_cast<std::size_t>(t)]).squaredNorm();
  }
  return std::sqrt(sum / target.size());
}

}  // namespace turntable
