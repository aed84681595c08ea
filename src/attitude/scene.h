// Synthetic sightings with known answers, made without any of the solvers' own code: a target in the
// plane frame and a camera above it whose entrance pupil may walk along its axis. Point level: no
// image is drawn, a spot is its true centre plus Gaussian noise.
//   p(theta) = C_z + c theta^2                       height of the pupil as direction theta sees it
//   g = -(X - C)_xy / (p(theta) - X_z),  tan theta = |g|     slope d(x, y)/dz of the ray through X
//   u = -f g_x,  v = f g_y                           image point off the principal point, px
// Source: mathematics of the rig, sections 1 and 5; a pupil that moves with the field angle: D. B.
// Gennery, Generalized camera calibration including fish-eye lenses, IJCV 68 (2006) 239-266. Symbols:
//   C -> centre_mm, mm     c -> pupil_walk_mm_per_rad2     f -> focal_px     theta: off the axis, rad
//
// What a central camera makes of such a lens: a calibration on the two planes puts its pupil where
// the slopes fit best, and its distortion takes what is left at one depth. For a field evenly
// covered to theta_max that is c sum(theta^2 g^2)/sum(g^2) = 2/3 c theta_max^2 above C, and exact half
// way between the planes. The pinhole sights see the point there.
// Domain: points below the pupil. Outside, rays are of no use, and the Jacobian is NaN.
#pragma once

#include <vector>

#include "src/attitude/cramer_rao.h"
#include "src/attitude/solver.h"
#include "src/core/random.h"

namespace turntable {

/// Looks down -z of the plane frame, x right and y up.
struct SceneLens {
  Vector3d centre_mm{0, 0, 700};  ///< entrance pupil as the axis sees it
  double pupil_walk_mm_per_rad2 = 0.0;
  bool telecentric = false;  ///< rays parallel to z; the scale is the one plane a would have
  double focal_px = 1945.0;
  double half_field_px = 512.0;  ///< from the principal point to the edge of the image
  RayPlanes planes{130.0, 180.0};

  double half_field_rad() const;
  /// Lets the pupil walk by `walk_mm` from the axis to the edge of the image.
  void walk_over_field(double walk_mm);
  /// Pupil of the central camera that a calibration would find.
  Vector3d central_pupil_mm() const;
};

struct TargetScene {
  std::vector<Vector3d> target_mm;  ///< the first one is M0
  Matrix3d R_plane_from_target;
  Vector3d origin_mm;  ///< M0 in the plane frame
  SceneLens lens;

  std::vector<Ray> rays;             ///< noise-free unless noise was added
  std::vector<Vector2d> normalised;  ///< the central camera's, x right, y down, z forward
  std::vector<RaySpread> spreads;    ///< of the noise that was added; none without noise

  Observation observation() const { return {rays, lens.planes, normalised, spreads}; }
  /// Truth in the frame of a solver's answer.
  Matrix3d truth(Sight sight) const;
  Vector3d true_position(Sight sight) const;
};

/// Camera x along plane x, camera z down: a half turn about x.
inline Matrix3d R_camera_from_plane() { return Vector3d(1.0, -1.0, -1.0).asDiagonal(); }

/// The ray of slope `g` through the entrance pupil as that direction sees it.
Ray ray_along(const Vector2d& g, const SceneLens& lens);
/// The ray through `point_mm` and the entrance pupil as that point sees it.
Ray ray_through(const Vector3d& point_mm, const SceneLens& lens);
/// d(u, v)/d(x, y, z) at `point_mm`, for the Cramer-Rao bound.
ImageJacobian image_jacobian(const Vector3d& point_mm, const SceneLens& lens);

TargetScene make_scene(std::vector<Vector3d> target_mm, const Matrix3d& R_plane_from_target,
                       const Vector3d& origin_mm, const SceneLens& lens);

/// Noise of `sigma_px` on each image coordinate, the same for every sight, taken along by the lens.
/// To be called once on a scene without noise.
void add_image_noise(TargetScene& scene, double sigma_px, Random& random);

/// Of the scene's pose, with the Jacobians of its lens.
PoseBound scene_bound(const TargetModel& target, const TargetScene& scene, double sigma_px);

/// About an axis of any direction, by up to `max_deg`.
Matrix3d random_rotation(Random& random, double max_deg);

/// The target of the simulated rig (scenarios/rigs/simulated.json), after the published one: M0 at the
/// apex, three LEDs on 60 mm, 40 mm deep.
std::vector<Vector3d> default_target();

}  // namespace turntable
