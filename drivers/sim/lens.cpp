#include "drivers/sim/lens.h"

#include <Eigen/LU>
#include <cmath>

namespace turntable::sim {

Lens::Lens(const LensTruth& truth)
    : truth_(truth),
      tilt_(std::tan(truth.sensor_tilt_deg.x() / kDegPerRad),
            std::tan(truth.sensor_tilt_deg.y() / kDegPerRad)) {}

Vector2d Lens::distort(const Vector2d& t) const {
  const auto [k1, k2, k3] = truth_.radial;
  const auto [p1, p2] = truth_.decentring;
  const double r2 = t.squaredNorm();
  const double radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const Vector2d d(t.x() * radial + 2 * p1 * t.x() * t.y() + p2 * (r2 + 2 * t.x() * t.x()),
                   t.y() * radial + 2 * p2 * t.x() * t.y() + p1 * (r2 + 2 * t.y() * t.y()));
  return d / (1.0 + d.dot(tilt_));
}

Vector2d Lens::project(const Vector3d& p) const {
  // The pupil moves by millimetres where the object is hundreds away: a few passes reach the last
  // digit.
  double pupil = 0.0;
  for (int pass = 0; pass < 30; ++pass) {
    const double theta = std::atan2(p.head<2>().norm(), p.z() - pupil);
    const double next = truth_.pupil_walk_mm_per_rad2 * theta * theta;
    const bool done = std::abs(next - pupil) < 1e-12;
    pupil = next;
    if (done) break;
  }
  return truth_.principal_point_px + truth_.focal_px * distort(p.head<2>() / (p.z() - pupil));
}

CameraRay Lens::ray(const Vector2d& pixel) const {
  const Vector2d wanted = (pixel - truth_.principal_point_px) / truth_.focal_px;
  Vector2d t = wanted;
  for (int pass = 0; pass < 50; ++pass) {
    const Vector2d miss = distort(t) - wanted;
    if (miss.norm() < 1e-13) break;
    constexpr double h = 1e-7;
    Eigen::Matrix2d J;
    J.col(0) = (distort(t + Vector2d(h, 0)) - distort(t - Vector2d(h, 0))) / (2 * h);
    J.col(1) = (distort(t + Vector2d(0, h)) - distort(t - Vector2d(0, h))) / (2 * h);
    t -= J.inverse() * miss;
  }
  const double theta = std::atan(t.norm());
  return {t, truth_.pupil_walk_mm_per_rad2 * theta * theta};
}

}  // namespace turntable::sim
