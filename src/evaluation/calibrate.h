// From named points to a calibrated camera.
#pragma once

#include "src/evaluation/calibration_set.h"

namespace turntable {

/// The ray model through the planes marked to be fitted, judged by the others and by leaving each
/// point out in turn; every central model that the views carry; all of them compared on the same
/// points. Without planes (boards held by hand) the rays come from the views alone (free_views.h):
/// then the plane frame is the camera frame turned over.
/// @throws ConfigError: a left-handed result. Error: points that do not carry the order.
Calibration calibrate(const CalibrationSet& set);

}  // namespace turntable
