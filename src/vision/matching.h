// Which spot is which LED, from where the turntable says the LEDs are.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "src/geometry/ray.h"

namespace turntable {

enum class MatchStatus { kMatched, kTooFewSpots, kAmbiguous, kTooFar };
std::string_view match_status_name(MatchStatus status);

struct Match {
  MatchStatus status = MatchStatus::kTooFewSpots;
  std::vector<int> ray_of_point;  ///< index into `rays` per point; meaningful if matched
  double worst_mm = 0.0;          ///< largest distance of a matched ray from its predicted point
  /// The point that the status is about: the farthest from its ray if too far, the first that is
  /// ambiguous; -1 otherwise.
  int point = -1;
};

/// Pairs every predicted point (plane frame, mm) with the ray that passes nearest to it. Accepted
/// only if each pairing is mutual, nearer than `gate_mm`, and each runner-up is twice as far and
/// half the gate away at least: ambiguity is an answer, and a reflection beside an LED is
/// ambiguous. A common offset of the whole target is taken out first, since prediction errors are
/// mostly common. A point without any ray inside the gate is too far, whatever the others are. Rays
/// and points that are not finite pair with nothing. Targets denser than half the gate are always
/// ambiguous here; src/attitude/correspondence.h needs no prediction.
Match match_to_prediction(std::span<const Vector3d> predicted, std::span<const Ray> rays,
                          const RayPlanes& planes, double gate_mm);

}  // namespace turntable
