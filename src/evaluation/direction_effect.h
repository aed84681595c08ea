// Does it matter from where an axis came? Errors of poses at the same place, come to from below and from above:
//   e = place + repeat + d (forward - backward) + noise,   d = +-1/2
// by least squares, with an interval from Student's t (N. R. Draper, H. Smith, Applied Regression Analysis, 1998, 1.4
// and 14). A repeat has a term of its own, since the error of its initial pose is in all of its poses.
#pragma once

#include <cstddef>
#include <span>

#include "src/evaluation/statistics.h"

namespace turntable {

struct DirectedError {
  std::size_t place = 0;  ///< poses of one place are compared with each other
  int repeat = 0;
  int direction = 0;  ///< how the axis last moved before the pose: +1 up, -1 down
  double error = 0.0;
};

/// Forward minus backward, in the unit of the errors, with its 95 % interval. NaN where the errors cannot tell it: one
/// direction only at every place, or one per repeat; an interval of NaN where nothing is left to judge the noise by.
/// @throws std::invalid_argument: a direction of zero.
WithInterval direction_effect(std::span<const DirectedError> errors);

}  // namespace turntable
