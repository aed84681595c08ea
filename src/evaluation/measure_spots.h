// From the spots of one image to the attitude of the target: which spot is which point, then the
// sensor. With a prediction (the image before, say) the nearest spots are taken; without one, or
// where it does not fit any more, the target is looked for among all spots.
#pragma once

#include <numbers>
#include <span>
#include <string>
#include <vector>

#include "src/evaluation/attitude_sensor.h"

namespace turntable {

/// How far a spot may lie from where its point is predicted, mm: a quarter of the smallest distance
/// between two points. Beyond it a match means nothing.
double match_gate_mm(std::span<const Vector3d> points_mm);

/// Spots of an image, in any order. Standard uncertainty of each coordinate, px: one per spot, or
/// none.
struct SpotList {
  std::vector<Vector2d> centres_px;
  std::vector<double> sigmas_px;
};

struct TargetMeasurement {
  MeasuredAttitude attitude;
  /// NaN without a covariance.
  PoseUncertainty uncertainty{MeasuredAttitude{}.covariance, MeasuredAttitude{}.covariance,
                              MeasuredAttitude{}.covariance};
  /// `status_name`, or why the spots are not known: "too few spots: 2 of 4", "ambiguous spots", "no
  /// target".
  std::string status;
  bool predicted = false;          ///< the prediction told which spot is which point
  std::vector<int> spot_of_point;  ///< index into the spots; empty if not known
};

/// What is known before the target is looked for.
struct TargetSearch {
  double target_uncertainty_mm = 0.0;  ///< of each coordinate of its points; 0 = not known
  /// Attitudes within `max_turn_rad` of it are looked for: a target that looks the same after a
  /// turn needs this.
  Matrix3d R_near = Matrix3d::Identity();
  double max_turn_rad = std::numbers::pi;
};

/// The spots that `find_spots` sees. @param electrons_per_grey of the camera; 0 = shot noise not
/// counted.
SpotList spots_in(ImageView image, double electrons_per_grey);

/// Points that no spot shows are not made up: without all of them there is no attitude.
/// @param near a measurement that has an attitude and a position, or nullptr.
/// @throws std::invalid_argument if there is no prediction and the target's points lie in a plane,
/// for which `correspond` has no answer.
TargetMeasurement measure_spots(const AttitudeSensor& sensor, const SpotList& spots,
                                const TargetSearch& search = {},
                                const MeasuredAttitude* near = nullptr);

/// The same for spots that stand in the target's order, one per point.
TargetMeasurement measure_named_spots(const AttitudeSensor& sensor, const SpotList& spots,
                                      double target_uncertainty_mm = 0.0);

}  // namespace turntable
