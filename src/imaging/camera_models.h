// The camera models that the project can fit, as a table, and their comparison on points that no
// model has seen. To add one: a file pair, and a line in `kCameraModels`.
#pragma once

#include <functional>
#include <span>
#include <string_view>
#include <vector>

#include "src/imaging/calibration.h"

namespace turntable {

/// What a calibration sweep yields, cleaned of outliers.
struct CameraData {
  std::vector<PlanePoint> fit;
  /// Points that judge: whole planes, or single points of the fitted ones. Models that are fitted
  /// to views do not see these points either, should the views hold them.
  std::vector<PlanePoint> held_out;
  RayPlanes planes;
  int order = 5;  ///< of the ray model
  std::vector<PatternView> views;
  ImageSize size;
};

/// A camera model after its fit.
struct FittedCamera {
  int parameters = 0;
  std::function<Ray(const Vector2d& pixel_px)> ray;  ///< in the plane frame, between data.planes
  std::function<bool(const Vector2d& pixel_px)> in_domain;
  std::function<void(Calibration&)> store;  ///< puts it where `calibration_to_json` writes it from
};

struct CameraModel {
  std::string_view name, title;
  /// @throws Error if the data do not carry the model, or do not tie it to the plane frame.
  FittedCamera (*fit)(const CameraData&);
};

/// "irt", then the central ones from the simplest to the richest.
extern const std::span<const CameraModel> kCameraModels;
/// nullptr if there is none of that name.
const CameraModel* find_camera_model(std::string_view name);

/// Every model of the table, in its order: fitted to the same data and judged on the same held-out
/// points, those that lie in the domain of every model that could be fitted. A miss in mm is taken
/// at the point's height; in pixels it is that, divided by the model's own local mm per px. A model
/// that the data do not carry has a reason instead of numbers. Models are fitted side by side.
std::vector<ModelRow> compare_models(const CameraData& data);

}  // namespace turntable
