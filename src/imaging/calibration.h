// A finished camera calibration and its file (schema: scenarios/schema/calibration.schema.json).
#pragma once

#include <filesystem>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "src/imaging/central_model.h"
#include "src/imaging/irt.h"
#include "src/imaging/order_choice.h"

namespace turntable {

/// Residuals of the ray model on one plane.
struct PlaneResidual {
  double z_mm = 0.0;
  bool fitted = true;  ///< false: kept out of the fit
  int points = 0;
  double rms_mm = 0.0;  ///< of the residual's length; NaN if no point lies in the calibrated area
  double max_mm = 0.0;
  /// As in `FittedPlane`; NaN for a plane kept out of the fit.
  double coverage = std::numeric_limits<double>::quiet_NaN();
  double noise_gain = std::numeric_limits<double>::quiet_NaN();
};

/// How one plane was visited: where the stage read itself back, and how the pattern came to lie.
struct PlaneVisits {
  double z_mm = 0.0;      ///< asked for
  double stage_mm = 0.0;  ///< mean of what was read back
  int visits = 0;
  double drift_mm = 0.0;  ///< read back at the last visit minus the first
  /// Mean shift of the pattern's points between the same; NaN if they share none.
  Vector2d drift_px = Vector2d::Zero();
  /// Its length on the plane; NaN as above, or if there was one visit.
  double drift_plane_mm = std::numeric_limits<double>::quiet_NaN();
  /// Standard deviation of a point's image over the repeats of the sweep (each approached anew; a
  /// return at its end is none), u and v together, pooled over the points that all of them show. The
  /// noise of the images is in it. NaN with fewer than two repeats.
  double repeat_rms_px = std::numeric_limits<double>::quiet_NaN();
  double repeat_rms_mm = std::numeric_limits<double>::quiet_NaN();  ///< the same on the plane
};

/// One camera model judged beside the others (`compare_models`). NaN where it has no value.
struct ModelRow {
  std::string name;
  int parameters = 0;  ///< of the map from pixel to ray
  double fit_rms_mm = std::numeric_limits<double>::quiet_NaN();
  double fit_max_mm = std::numeric_limits<double>::quiet_NaN();
  double held_out_rms_mm = std::numeric_limits<double>::quiet_NaN();
  double held_out_max_mm = std::numeric_limits<double>::quiet_NaN();
  double held_out_rms_px = std::numeric_limits<double>::quiet_NaN();
  double held_out_max_px = std::numeric_limits<double>::quiet_NaN();
  std::string why_not;  ///< empty if it was fitted
};

/// An image that the calibration was made from.
struct UsedImage {
  std::string file;    ///< relative to the run folder
  std::string sha256;  ///< 64 lower-case hexadecimal digits
};

struct Calibration {
  std::string source;  ///< run or publication it comes from
  bool simulated = false;
  IrtModel irt;           ///< with its covariance, if known
  double sigma_mm = 0.0;  ///< of one coordinate of one circle
  int points = 0;
  /// Statistics of the fit (`IrtFit`); NaN = not known.
  double loo_rms_mm = std::numeric_limits<double>::quiet_NaN();
  double chi2_per_dof = std::numeric_limits<double>::quiet_NaN();
  double condition = std::numeric_limits<double>::quiet_NaN();
  double max_leverage = std::numeric_limits<double>::quiet_NaN();
  std::vector<PlanePoint> outliers;
  std::vector<PlaneResidual> planes;
  std::vector<PlaneVisits> stage;
  std::vector<OrderRow> orders;
  std::vector<ModelRow> models;
  std::vector<UsedImage> images;
  std::vector<CentralModel> central;

  /// The ray model with the statistics of its fit, and a row of `planes` for each fitted plane.
  /// @param given the points that `fit_irt` was given, in the same order
  void set_irt(const IrtFit& fit, std::span<const PlanePoint> given);
  /// The central model of that kind ("pinhole", "brown", "rational", "fisheye"), or nullptr.
  const CentralModel* find_central(std::string_view name) const;
  /// The one that takes distortion out: "brown", else "rational", else "fisheye", or nullptr.
  const CentralModel* undistorting() const;
};

/// As JSON text, ready to be written.
std::string calibration_to_json(const Calibration& calibration);
/// @throws ConfigError: schema, coefficients that do not match the order, left-handed model.
Calibration load_calibration(const std::filesystem::path& file);
Calibration parse_calibration(const std::string& text, const std::string& name);

}  // namespace turntable
