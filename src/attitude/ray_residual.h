// Residual of a point against its ray in standard deviations of its spot, and its derivative: the
// terms of ml_ray.h that its refinement and the propagation of uncertainty share.
#pragma once

#include <cmath>

#include "src/attitude/solver.h"

namespace turntable {

/// r = W m, W = S(z)^-1, m the in-plane miss of X, and d r / d X = [W, dz].
struct RayResidual {
  Vector2d r;
  Eigen::Matrix2d W;  ///< standard deviations per mm of miss
  Vector2d dz;

  Vector3d row(Eigen::Index i) const { return {W(i, 0), W(i, 1), dz(i)}; }
};

/// A sighting as residuals read it: the ray at_a + g (z - a), and S(z) = S_a + S_slope (z - a).
struct Sighted {
  Vector2d at_a, g;
  Eigen::Matrix2d S_a, S_slope;

  /// @param spread nullptr: a perpendicular miss of 1 mm is one standard deviation.
  Sighted(const Ray& ray, const RaySpread* spread, const RayPlanes& planes)
      : at_a(ray.at_a), g(ray.slope(planes)) {
    if (spread != nullptr) {
      S_a = spread->at_a;
      S_slope = (spread->at_b - spread->at_a) / (planes.b_mm - planes.a_mm);
      return;
    }
    // In the plane a perpendicular miss of 1 mm is an ellipse, 1 + g g^T, and this is its root.
    const double gg = g.squaredNorm();
    S_a.setIdentity();
    if (gg > 0.0) S_a += (std::sqrt(1.0 + gg) - 1.0) / gg * g * g.transpose();
    S_slope.setZero();
  }
  Sighted() = default;

  /// @param depth_mm height of X above plane a.
  RayResidual residual(const Vector3d& X, double depth_mm) const {
    const Eigen::Matrix2d S = S_a + depth_mm * S_slope;
    RayResidual out;
    out.W << S(1, 1), -S(0, 1), -S(1, 0), S(0, 0);
    out.W /= S(0, 0) * S(1, 1) - S(0, 1) * S(1, 0);
    out.r = out.W * (X.head<2>() - at_a - g * depth_mm);
    out.dz = -out.W * (g + S_slope * out.r);
    return out;
  }
};

}  // namespace turntable
