// What an image says about itself, before the rig moves on: is what it should show there, sharp,
// not clipped, and where it belongs? A pose whose image is bad is taken again in place instead of
// being found next morning.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "src/core/image.h"
#include "src/core/rig_file.h"
#include "src/record/image_archive.h"
#include "src/record/run_folder.h"

namespace turntable {

/// More bright things than this in an LED image are a lamp or a window, and such an image is kept
/// whole.
constexpr std::size_t kMaxSpots = 32;

struct Inspection {
  std::optional<std::vector<TakenSpot>> spots;  ///< LED target only; brightest first
  std::vector<Region> regions;                  ///< of these spots
  bool target_seen = false;    ///< as many spots as LEDs, or more; the pattern found
  bool worth_regions = false;  ///< nothing outside `regions` will be missed
  std::string complaint;       ///< the gravest one, for people; empty = a good image
};

/// Checks by `rig.inspection` and the nominal camera, which knows no lens: gross errors only.
/// LED target: number of spots; each LED near its prediction (match_to_prediction); none of them
/// clipped; blur. Pattern: found; blur of its circles.
/// Blur of a spot: sqrt(m - r^2/4), m the larger principal second moment of its light and r the
/// predicted radius; of a circle's edge: pixels between a quarter and three quarters of its contrast
/// per pixel of circumference, over 1.35 (a Gaussian edge). px.
Inspection inspect(ImageView image, const PlannedPose& pose, const RigFile& rig);

}  // namespace turntable
