// A finished camera calibration and its file (schema: scenarios/schema/calibration.schema.json).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "src/imaging/irt.h"
#include "src/imaging/pinhole.h"

namespace turntable {

/// Residuals of the ray model on one plane.
struct PlaneResidual {
  double z_mm = 0.0;
  bool fitted = true;  ///< false: kept out of the fit
  int points = 0;
  double rms_mm = 0.0;  ///< of the residual's length
  double max_mm = 0.0;
};

struct Calibration {
  std::string source;  ///< run or publication it comes from
  bool simulated = false;
  IrtModel irt;
  double sigma_mm = 0.0;  ///< of one coordinate of one circle
  int points = 0;
  std::vector<PlanePoint> outliers;
  std::vector<PlaneResidual> planes;
  std::optional<PinholeModel> pinhole;            ///< without distortion
  std::optional<PinholeModel> pinhole_distorted;  ///< with distortion
};

/// As JSON text, ready to be written.
std::string calibration_to_json(const Calibration& calibration);
/// @throws ConfigError: schema, coefficients that do not match the order, left-handed model.
Calibration load_calibration(const std::filesystem::path& file);
Calibration parse_calibration(const std::string& text, const std::string& name);

}  // namespace turntable
