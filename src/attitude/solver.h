// Attitude solvers behind one table. A solver is a free function in a file pair of its own plus one
// line of `kSolvers` (solver.cpp); the command line, the law tests, the benchmark and the report
// iterate the table.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>

#include "src/attitude/target.h"
#include "src/geometry/ray.h"
#include "src/geometry/rotation.h"

namespace turntable {

using Matrix6d = Eigen::Matrix<double, 6, 6>;

/// What a solver sees of an image, and with it the frame its answer is in.
enum class Sight {
  kRays,        ///< rays of the calibrated camera; answers R_plane_from_target
  kPinholeRaw,  ///< a distortion-free pinhole applied to the pixels; answers R_camera_from_target
  kPinholeUndistorted,  ///< pinhole after removing distortion; answers R_camera_from_target
};
std::string_view sight_name(Sight sight);  ///< "rays", "pinhole_raw", "pinhole_undistorted"
/// Frame of the answer: "plane" (z towards the camera) or "camera" (x right, y down, z forward).
std::string_view frame_name(Sight sight);

/// How the noise of a spot's centre moves its ray: n ~ N(0, 1) in two directions moves the ray by
/// `at_a` n on plane a and by `at_b` n on plane b. For a spot with covariance L L^T px^2 it is
/// d(x, y)/d(u, v) L.
struct RaySpread {
  Eigen::Matrix2d at_a, at_b;  ///< mm

  Eigen::Matrix2d at(double z_mm, const RayPlanes& planes) const {
    return at_a + (z_mm - planes.a_mm) / (planes.b_mm - planes.a_mm) * (at_b - at_a);
  }
};

/// One image of the target, in the target's order of points. Only the members of the solver's sight
/// are read.
struct Observation {
  std::span<const Ray> rays = {};  ///< kRays: one per point, mm in the plane frame
  RayPlanes planes = {};           ///< kRays
  /// Pinhole sights: (x/z, y/z) of each point in the camera frame, made by the camera model of the
  /// sight.
  std::span<const Vector2d> normalised = {};
  /// kRays: one per point, or none: then the noise is not known, every point's miss weighs the same,
  /// and no solver states a covariance.
  std::span<const RaySpread> spreads = {};
};

enum class SolveStatus {
  kConverged,
  kHeightUndefined,  ///< attitude converged; the rays are too parallel to tell the height
  /// As converged, but a sighting lies outside the calibrated part of the image. Solvers do not know
  /// it; whoever made the sightings states it.
  kOutsideDomain,
  kAmbiguous,     ///< two attitudes explain the sightings; the better one is in the solution, the
                  ///< other one in its rival
  kNotConverged,  ///< max_iterations passed; the last iterate is in the solution
  kDegenerate,  ///< the observation does not determine an attitude (coincident rays, points behind
                ///< the camera, divergence)
  kCoplanarTarget,  ///< the method does not take targets whose points lie in a plane
  kInvalidInput,    ///< wrong number of points, NaN or infinity, planes out of order
};
/// "converged", "height_undefined", "outside_domain", "ambiguous", "not_converged", "degenerate",
/// "coplanar_target", "invalid_input".
std::string_view status_name(SolveStatus status);

struct SolveOptions {
  /// Largest change of any point's iterate from pass to pass; in `Solver::tolerance_unit`.
  double tolerance = 1e-9;
  int max_iterations = 200;
  /// More than four points: those that contradict the others are left out (methods that say so).
  bool robust = false;
};

/// The second attitude of a target whose points lie in a plane, or nearly so.
struct Rival {
  Matrix3d R;
  Vector3d position_mm;
  double residual;  ///< as `Solution::residual`
};

/// What a solve came to. Every number is finite when the status is kConverged.
struct Solution {
  SolveStatus status = SolveStatus::kInvalidInput;
  /// R_plane_from_target (kRays) or R_camera_from_target (pinhole sights): the rotation nearest to
  /// rows_ijk.
  Matrix3d R = Matrix3d::Constant(kNaN);
  /// i, j, k as the method leaves them: not exactly orthonormal under noise.
  Matrix3d rows_ijk = Matrix3d::Constant(kNaN);
  /// M0 in the same frame, mm; z is the paper's m (kRays) or Z0 (pinhole). z is NaN when the height
  /// is undefined.
  Vector3d position_mm = Vector3d::Constant(kNaN);
  int iterations = 0;
  /// Root mean square over the points: distance from the ray, mm (kRays), or reprojection, in
  /// normalised units (pinhole; times the focal length it is in pixels).
  double residual = kNaN;
  /// Of (delta, position): rad^2, rad mm, mm^2, where exp([delta]x) R is the true rotation (left
  /// perturbation, as in cramer_rao.h). From the noise of the spots alone. NaN where the method has
  /// none, or nothing is known of the noise; its rows of z are NaN when the height is undefined.
  Matrix6d covariance = Matrix6d::Constant(kNaN);
  /// Sum of squared residuals in standard deviations; NaN as above.
  double chi2 = kNaN;
  double dof = kNaN;  ///< of chi2: two per point that was used, less what the pose has taken
  /// Points left out by `SolveOptions::robust`, bit t = point t.
  std::uint32_t left_out = 0;
  std::optional<Rival> rival;

  bool has_attitude() const {
    return status == SolveStatus::kConverged || status == SolveStatus::kHeightUndefined ||
           (status == SolveStatus::kOutsideDomain && R.allFinite());
  }

  static constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
};

/// Rows i and j are perpendicular without noise. When the sine of their angle ends below this, what
/// is left is not an attitude with an error but no attitude: kDegenerate.
constexpr double kMinSine = 0.1;

/// Never throws, never allocates (rows that do say so), and may be called from several threads at
/// once.
using SolveFunction = Solution (*)(const TargetModel&, const Observation&, const SolveOptions&);

struct Solver {
  std::string_view name;   ///< for command lines and tables
  std::string_view title;  ///< for people
  Sight sight;
  SolveFunction function;
  SolveOptions defaults;
  std::string_view tolerance_unit;
  std::string_view reference;  ///< where the method is published
  /// Takes targets whose points lie in a plane; the others answer kCoplanarTarget.
  bool coplanar = false;
  bool by_default = false;  ///< shown where nobody chose solvers
  /// Library code behind the row: it may allocate, and its answers need not be exact.
  bool peer = false;

  Solution operator()(const TargetModel& target, const Observation& observation) const {
    return function(target, observation, defaults);
  }
};

extern const std::span<const Solver> kSolvers;
/// @return nullptr if there is no such row.
const Solver* find_solver(std::string_view name);
/// What is taken where nobody chose: maximum likelihood on rays.
const Solver& default_solver();

/// Many sightings of one target on all cores; `solutions[i]` belongs to `observations[i]`.
void solve_all(const Solver& solver, const SolveOptions& options, const TargetModel& target,
               std::span<const Observation> observations, std::span<Solution> solutions);

}  // namespace turntable
