// From the images of a calibration sweep to a calibrated camera.
#pragma once

#include <functional>
#include <vector>

#include "src/imaging/calibration.h"
#include "src/record/run_folder.h"

namespace turntable {

/// A calibration and the points it was made from, for figures.
struct CalibrationResult {
  Calibration calibration;
  std::vector<PlanePoint>
      points;  ///< every circle of every plane, averaged over the plane's images
};

struct CalibrateOptions {
  int order = 0;  ///< polynomial order; 0 = as the scenario says
  std::function<void(std::size_t done, std::size_t total)>
      progress;  ///< images; called from several threads
};

/// Takes the plane's height from the stage's read-back position (plane frame: origin at the
/// pattern's origin circle at stage position 0). Planes marked "fit" enter the rays, "check" planes
/// are judged by them; every view enters the pinhole baselines, which are left out if the sweep has
/// no tilted views.
/// @throws ConfigError: no calibration poses, an image that cannot be read, no pattern in an image
/// (naming the file and what was seen), a left-handed result. Error: points that do not carry the
/// order.
CalibrationResult calibrate(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                            const CalibrateOptions& options = {});

/// What a calibration made from this plan's sweep names as its source.
std::string calibration_source(const Plan& plan);

/// The circles of every plane whose images are still there, for figures of a calibration made
/// earlier.
/// @throws as `calibrate`.
std::vector<PlanePoint> plane_points(const RunRecord& record, const RunFolder& folder,
                                     const RigFile& rig);

/// True if the plan has a calibration sweep.
bool has_calibration_sweep(const Plan& plan);

}  // namespace turntable
