// How good is this camera? A calibration as text, tables, figures, and files for other programs.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "src/evaluation/calibration_set.h"
#include "src/record/csv.h"
#include "src/report/drawing.h"

namespace turntable {

/// Numbers with short explanations, as Markdown: planes, orders, camera models, stage, outliers.
std::string calibration_text(const Calibration& calibration);

/// The comparison of polynomial orders, one row each.
Csv orders_csv(const std::vector<OrderRow>& orders);

/// Writes <folder>/*.csv (and an image) for:
///   figure8_pattern                     one processed image with the points' names, and a detail
///   figure9_positions                   recalculated against standard positions of every plane
///   figure10_residuals_<z>mm            residuals of a plane: contour map, and in 3D
///   calibration_vectors_<z>mm           the same as arrows
///   calibration_coverage                where in the image the points lie, and the domain
///   calibration_orders                  residuals against the polynomial order
///   calibration_uncertainty             standard uncertainty of a ray over the image
///   calibration_bundle                  distance of each ray from the bundle's centre
/// Those that need points or a covariance are left out if there are none.
/// @throws RecordError.
std::vector<Draft> calibration_drafts(const std::filesystem::path& folder,
                                      const Calibration& calibration,
                                      const std::optional<CalibrationSet>& set);

/// calibration.json, calibration.md and .html, figures/, tables/table1.{csv,md,tex}, tables/orders.csv,
/// tables/models.csv, and opencv/<model>.yml for each central model. @return calibration.html.
/// @throws RecordError.
std::filesystem::path write_calibration_report(const std::filesystem::path& folder,
                                               const Calibration& calibration,
                                               const std::optional<CalibrationSet>& set);

}  // namespace turntable
