// Lattice points of a rig's pattern as its camera truly sees them, with pixel noise on request.
#pragma once

#include <cmath>
#include <vector>

#include "drivers/sim/lens.h"
#include "src/core/random.h"
#include "src/imaging/irt.h"
#include "tests/support/simulated_view.h"

namespace turntable {

constexpr ImageSize kSize{1024, 1024};

inline void add_noise(std::vector<PlanePoint>& points, double noise_px, Random& random) {
  for (PlanePoint& p : points) p.pixel_px += noise_px * Vector2d(random.normal(), random.normal());
}

/// The pattern on planes at heights z; what comes within 10 px of the border is not seen.
inline std::vector<PlanePoint> points_of(const std::vector<double>& heights, double noise_px,
                                         std::uint64_t draw = 0, const std::string& rig = "ideal") {
  SimulatedView view(shipped_rig(rig));
  view.world().mount(Payload::kCirclePattern);
  Random random(draw, "irt_test points");
  std::vector<PlanePoint> points;
  for (const double z : heights) {
    view.stand(z, 0, 0, 0);
    for (int row = -7; row <= 7; ++row)
      for (int column = -9; column <= 9; ++column) {
        PlanePoint p;
        p.on_plane_mm = Vector2d(column, row) * 20.0;
        p.pixel_px = view.pixel_of({p.on_plane_mm.x(), p.on_plane_mm.y(), 0});
        if (p.pixel_px.minCoeff() < 10 || p.pixel_px.maxCoeff() > 1013) continue;
        p.z_mm = z;
        p.column = column;
        p.row = row;
        points.push_back(p);
      }
  }
  add_noise(points, noise_px, random);
  return points;
}

/// Those within `reach_mm` of the pattern's origin in x and y.
inline std::vector<PlanePoint> within(std::vector<PlanePoint> points, double reach_mm) {
  std::erase_if(
      points, [&](const PlanePoint& p) { return p.on_plane_mm.cwiseAbs().maxCoeff() > reach_mm; });
  return points;
}

inline std::vector<PlanePoint> stated(std::vector<PlanePoint> points, double sigma_px) {
  for (PlanePoint& p : points) p.sigma_px = sigma_px;
  return points;
}

}  // namespace turntable
