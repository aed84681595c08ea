// Rays of the imaging ray-tracking model: a pixel sees one point on each of two planes z = a and z
// = b of the plane frame, and the ray is the line through the two.
#pragma once

#include <algorithm>
#include <cmath>

#include "src/geometry/rotation.h"

namespace turntable {

/// Heights of the two planes, mm, in the plane frame (z towards the camera); a < b.
struct RayPlanes {
  double a_mm = 0.0;
  double b_mm = 0.0;
};

/// Points (x, y) in mm on plane a and on plane b.
struct Ray {
  Vector2d at_a = Vector2d::Zero();
  Vector2d at_b = Vector2d::Zero();

  /// d(x, y)/dz, dimensionless.
  Vector2d slope(const RayPlanes& planes) const {
    return (at_b - at_a) / (planes.b_mm - planes.a_mm);
  }
  /// (x, y) at height z, mm.
  Vector2d at(double z_mm, const RayPlanes& planes) const {
    return at_a + slope(planes) * (z_mm - planes.a_mm);
  }
};

/// Perpendicular distance of a point from the ray, mm.
inline double distance_mm(const Vector3d& point, const Ray& ray, const RayPlanes& planes) {
  const Vector2d g = ray.slope(planes);
  const Vector2d miss = point.head<2>() - ray.at(point.z(), planes);
  // The in-plane miss, projected off the ray's direction (g, 1).
  const double along = miss.dot(g);
  return std::sqrt(std::max(0.0, miss.squaredNorm() - along * along / (1.0 + g.squaredNorm())));
}

}  // namespace turntable
