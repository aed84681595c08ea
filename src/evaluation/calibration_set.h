// Everything that a camera is calibrated from: named points on planes and in tilted views, with the
// images they come from. Two sources: the images of a sweep that this program ran, and images or
// points that a lab has already (scenarios/calibration_sets/README.md).
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "src/core/image.h"
#include "src/imaging/calibration.h"
#include "src/record/run_folder.h"
#include "src/vision/pattern.h"

namespace turntable {

/// The pattern on one plane: the mean of all its images, of every visit.
struct SeenPlane {
  double z_mm = 0.0;  ///< mean of what the stage read back, or as stated
  bool fit = true;    ///< false: kept out of the fit, to judge it
  std::vector<PlanePoint> points;
};

/// One image with what was found in it, for a picture.
struct PatternExample {
  std::string file;
  Image image;
  std::vector<PatternPoint> points;
};

struct CalibrationSet {
  std::string name;    ///< of messages: the run folder or the file
  std::string source;  ///< what the calibration will name as its source
  bool simulated = false;
  ImageSize size;
  double spacing_mm = 0.0;  ///< between neighbours on the pattern, for pictures; 0 = unknown
  int order = 0;            ///< of the ray model; kOrderByResiduals = the residuals decide
  std::vector<SeenPlane> planes;
  std::vector<PatternView> views;  ///< every image of a pattern, for models of a central camera
  std::vector<PlaneVisits> stage;  ///< of a sweep
  std::vector<UsedImage> images;
  std::vector<std::string> remarks;  ///< what was left out, and what cannot be known
  std::optional<PatternExample> example;

  /// Of the planes that are fitted, or of those kept out.
  std::vector<PlanePoint> points(bool fitted) const;
};

/// Images done, of how many. Called from several threads.
using ImageProgress = std::function<void(std::size_t done, std::size_t total)>;

/// A run's calibration sweep. Heights are the stage's read-back positions (plane frame: origin at
/// the pattern's origin circle at stage position 0); images of one plane, of all its visits, are
/// averaged circle by circle.
/// @throws ConfigError: no calibration poses, an image that cannot be read, no pattern in an image
/// (naming the file and what was seen).
CalibrationSet sweep_set(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                         const ImageProgress& progress = {});

/// A file of format "turntable-calibration-set/1". Paths in it are taken from its folder.
/// @throws ConfigError: schema; an image or point file that cannot be read, images of several sizes,
/// no pattern in an image, a point without a plane, fewer than two planes to fit.
CalibrationSet load_calibration_set(const std::filesystem::path& file,
                                    const ImageProgress& progress = {});

/// True if the plan has a calibration sweep.
bool has_calibration_sweep(const Plan& plan);
/// True if a run is evaluated with what its own sweep gives unless somebody names another calibration: it has a sweep,
/// and was given none.
bool calibrates_itself(const RunState& run);
/// True if a calibration was made from the images of this run's sweep, and not from those of another run of its plan.
bool is_of_own_sweep(const Calibration& calibration, const RunRecord& record);
/// What a calibration made from this plan's sweep names as its source.
std::string calibration_source(const Plan& plan);

}  // namespace turntable
