// The published tables, built into the program (results/published/paper_tables.json).
#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

namespace turntable {

struct PublishedRow {
  std::string method;  ///< as the paper names it
  int repeat = 1;
  double max_pitch_deg{}, max_roll_deg{}, max_yaw_deg{};
  double rmse_pitch_deg{}, rmse_roll_deg{}, rmse_yaw_deg{}, rmse_total_deg{};
};

struct PublishedTable {
  std::string title;
  std::vector<PublishedRow> rows;
};

/// Table 3, 4 or 5. @throws std::out_of_range for another number.
const PublishedTable& published_table(int number);

struct PublishedCoefficients {
  int order = 0;
  double plane_a_mm{}, plane_b_mm{};
  Eigen::MatrixX4d monomials;  ///< as IrtModel::monomials, v counted upward
};
const PublishedCoefficients& published_coefficients();

/// Largest residual on a plane (figure 10), mm: by the plane's height in mm (0 = base).
const std::map<int, double>& published_plane_residuals_mm();

}  // namespace turntable
