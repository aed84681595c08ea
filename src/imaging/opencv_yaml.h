// Camera files of OpenCV's calibration sample (samples/cpp/tutorial_code/calib3d/camera_calibration):
// image_width, image_height, fisheye_model, camera_matrix, distortion_coefficients,
// avg_reprojection_error; YAML or XML, through cv::FileStorage. They
// say nothing of a pattern or a stage: an imported camera's plane frame is its own frame turned over
// (x right, y up, z towards the camera, origin in its centre), so that planes in front of it lie at
// negative heights.
#pragma once

#include <filesystem>
#include <string>

#include "src/imaging/calibration.h"

namespace turntable {

/// The file's text. `R_plane_from_camera`, `centre_mm` and `lean` have no place in it.
std::string to_opencv_yaml(const CentralModel& model);

/// The camera alone, of the simplest kind that has all its coefficients that are not zero: pinhole,
/// brown (4 or 5 numbers), rational (8); fisheye (4) with the flag `fisheye_model`. 12 and 14 numbers
/// (thin prism, tilt) are accepted if those beyond the eighth are zero.
/// @throws ConfigError with the file and the key: what is missing, found, allowed.
CentralModel load_opencv_yaml(const std::filesystem::path& file);
CentralModel parse_opencv_yaml(const std::string& text, const std::string& name);

/// A full calibration from a central model: its exact rays over the whole image, as a ray model of
/// the lowest order (up to 9) that misses them by less than 1e-3 px everywhere, else of order 9; the
/// misfit on plane b is its sigma_mm. With the model go the pinhole nearest to its rays (for a
/// pinhole: a brown without distortion), so that a camera that came as numbers serves every solver.
/// @throws ConfigError (file `source`) if pixels of the image have no ray, or the planes are not
/// in front of the camera.
Calibration calibration_from_central(const CentralModel& model, RayPlanes planes,
                                     const std::string& source);

}  // namespace turntable
