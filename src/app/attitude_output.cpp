#include "src/app/attitude_output.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/units.h"
#include "src/record/atomic_file.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

/// An attitude as numbers for people; NaN where there is none.
struct Shown {
  Vector3d vector_deg = Vector3d::Constant(NAN);
  Eigen::Vector4d quaternion = Eigen::Vector4d::Constant(NAN);  ///< w x y z, w >= 0
  Vector3d yaw_roll_pitch_deg = Vector3d::Constant(NAN);
  Vector3d std_deg = Vector3d::Constant(NAN), std_mm = Vector3d::Constant(NAN);
};

Eigen::Vector4d quaternion_of(const Matrix3d& R) {
  const Eigen::Quaterniond q(R);
  return (q.w() < 0.0 ? -1.0 : 1.0) * Eigen::Vector4d(q.w(), q.x(), q.y(), q.z());
}

/// Standard uncertainties: about x, y, z, deg; and along them, mm.
Vector3d std_deg(const Matrix6d& covariance) {
  return deg_from_rad(1.0) * covariance.diagonal().head<3>().cwiseSqrt();
}
Vector3d std_mm(const Matrix6d& covariance) { return covariance.diagonal().tail<3>().cwiseSqrt(); }

Shown shown(const TargetMeasurement& m) {
  Shown out;
  const Matrix3d& R = m.attitude.R_plane_from_target;
  if (!R.allFinite()) return out;
  out.vector_deg = deg_from_rad(1.0) * vector_from_rotation(R);
  out.quaternion = quaternion_of(R);
  const GimbalAngles angles = default_gimbal().angles(R);
  out.yaw_roll_pitch_deg = deg_from_rad(1.0) * Vector3d(angles.yaw, angles.roll, angles.pitch);
  out.std_deg = std_deg(m.uncertainty.total());
  out.std_mm = std_mm(m.uncertainty.total());
  return out;
}

std::vector<int> points_left_out(const MeasuredAttitude& a) {
  std::vector<int> points;
  for (int t = 0; t < kMaxTargetPoints; ++t)
    if (a.left_out >> t & 1u) points.push_back(t);
  return points;
}

void add_numbers(Csv& csv, const Eigen::Ref<const Eigen::VectorXd>& values, int decimals) {
  for (Eigen::Index i = 0; i < values.size(); ++i) csv.number(values(i), decimals);
}

/// Null if there is none of them; NaN becomes null.
Json numbers(const Eigen::Ref<const Eigen::VectorXd>& values) {
  if (values.size() == 0 || values.array().isNaN().all()) return nullptr;
  Json out = Json::array();
  for (Eigen::Index i = 0; i < values.size(); ++i) out.push_back(values(i));
  return out;
}

Json json_of(const std::string& first, const AttitudeLine& line, const AttitudeSensor& sensor,
             bool target_stated) {
  const MeasuredAttitude& a = line.measurement.attitude;
  const Shown s = shown(line.measurement);
  Json json;
  json[first] = line.name;
  json["status"] = line.measurement.status;
  json["message"] = line.measurement.message;
  json["rotation_vector_deg"] = numbers(s.vector_deg);
  json["quaternion_wxyz"] = numbers(s.quaternion);
  json["yaw_roll_pitch_deg"] = numbers(s.yaw_roll_pitch_deg);
  json["position_mm"] = numbers(a.position_mm);
  json["std_rotation_deg"] = numbers(s.std_deg);
  json["std_position_mm"] = numbers(s.std_mm);
  json["covariance_rad_mm"] = nullptr;
  json["chi2"] = a.chi2;
  const Fit& fit = line.measurement.fit;
  json["dof"] = nullptr;
  if (std::isfinite(fit.misfit())) json["dof"] = fit.dof;
  json["misfit"] = fit.misfit();
  json["residual"] = a.residual;
  json["residual_unit"] = sensor.residual_unit();
  json["iterations"] = a.iterations;
  json["in_domain"] = nullptr;
  json["spot_of_point"] = line.measurement.spot_of_point;
  json["left_out"] = points_left_out(a);
  const PoseUncertainty& u = line.measurement.uncertainty;
  const Matrix6d total = u.total();
  if (!total.array().isNaN().all()) {
    json["covariance_rad_mm"] = Json::array();
    for (int i = 0; i < 6; ++i) json["covariance_rad_mm"].push_back(numbers(total.col(i)));
    const auto add_part = [&json](const char* source, bool stated, const Matrix6d& part) {
      Json& out = json["std_by_source"][source] = nullptr;
      if (!stated) return;
      out["rotation_deg"] = numbers(std_deg(part));
      out["position_mm"] = numbers(std_mm(part));
    };
    add_part("spots", true, u.spots);
    add_part("rays", sensor.states_rays(), u.rays);
    add_part("target", target_stated, u.target);
  }
  if (!line.measurement.spot_of_point.empty()) json["in_domain"] = a.in_domain;
  if (a.rival) {
    json["rival"]["quaternion_wxyz"] = numbers(quaternion_of(a.rival->R));
    json["rival"]["position_mm"] = numbers(a.rival->position_mm);
    json["rival"]["residual"] = a.rival->residual;
  }
  return json;
}

}  // namespace

const Gimbal& default_gimbal() {
  static const Gimbal gimbal([] {
    GimbalConfig config;  // by order of yaw, roll, pitch
    config.axes = {Vector3d::UnitZ(), Vector3d::UnitY(), Vector3d::UnitX()};
    return config;
  }());
  return gimbal;
}

std::vector<std::string> attitude_columns(const std::string& first,
                                          std::string_view residual_unit) {
  return {first,
          "status",
          "rx_deg",
          "ry_deg",
          "rz_deg",
          "qw",
          "qx",
          "qy",
          "qz",
          "yaw_deg",
          "roll_deg",
          "pitch_deg",
          "x_mm",
          "y_mm",
          "z_mm",
          "std_rx_deg",
          "std_ry_deg",
          "std_rz_deg",
          "std_x_mm",
          "std_y_mm",
          "std_z_mm",
          "chi2",
          "dof",
          "misfit",
          fmt::format("residual_{}", residual_unit),
          "in_domain",
          "left_out",
          "message"};
}

void add_attitude_cells(Csv& csv, const AttitudeLine& line) {
  const MeasuredAttitude& a = line.measurement.attitude;
  const Shown s = shown(line.measurement);
  csv.text(line.name).text(line.measurement.status);
  add_numbers(csv, s.vector_deg, 6);
  add_numbers(csv, s.quaternion, 9);
  add_numbers(csv, s.yaw_roll_pitch_deg, 6);
  add_numbers(csv, a.position_mm, 5);
  add_numbers(csv, s.std_deg, 6);
  add_numbers(csv, s.std_mm, 5);
  csv.number(a.chi2, 4);
  const Fit& fit = line.measurement.fit;
  if (std::isfinite(fit.misfit()))
    csv.integer(fit.dof);
  else
    csv.empty();
  csv.number(fit.misfit(), 4).number(a.residual, 6);
  if (line.measurement.spot_of_point.empty())
    csv.empty();
  else
    csv.integer(a.in_domain);
  csv.text(fmt::format("{}", fmt::join(points_left_out(a), " "))).text(line.measurement.message);
}

bool print_out(std::string_view text) {
  while (!text.empty()) {
    const ssize_t written = ::write(STDOUT_FILENO, text.data(), text.size());
    if (written >= 0)
      text.remove_prefix(static_cast<std::size_t>(written));
    else if (errno == EPIPE)
      return false;
    else if (errno != EINTR)
      throw RecordError(
          fmt::format("standard output cannot be written: {}. Make room, or name a "
                      "file with --out.",
                      std::generic_category().message(errno)));
  }
  return true;
}

void check_out(const AttitudeArguments& a, std::span<const fs::path> inputs) {
  if (a.out.empty()) return;
  std::error_code error;
  if (fs::is_directory(a.out, error))
    throw ConfigError(a.out.string(), "", "is a folder, allowed: a file (--out).");
  const fs::path folder = fs::absolute(a.out, error).parent_path();
  if (!fs::is_directory(folder, error))
    throw ConfigError(folder.string(), "", "is no folder. Make it, or choose another --out.");
  for (const fs::path& input : inputs)
    if (fs::equivalent(a.out, input, error))
      throw ConfigError(a.out.string(), "",
                        fmt::format("is {}, which is read, allowed: another file. Choose another "
                                    "--out.",
                                    input.string()));
}

void hint_at_misfit() {
  spdlog::warn(
      "does_not_fit: check the order of points, the direction of v, units (mm), and the "
      "calibration.");
}

int put_attitudes(const AttitudeArguments& a, const AttitudeSensor& sensor,
                  double target_uncertainty_mm, const std::string& first,
                  std::span<const AttitudeLine> lines) {
  std::string text;
  if (a.format == "json") {
    Json json;
    json["solver"] = sensor.solver().name;
    if (!a.camera.empty()) json["camera"] = a.camera;
    json["calibration"] = a.calibration.string();
    json["target"] = a.target.string();
    json["attitudes"] = Json::array();
    for (const AttitudeLine& line : lines)
      json["attitudes"].push_back(json_of(first, line, sensor, target_uncertainty_mm > 0.0));
    text = json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
  } else {
    Csv csv(attitude_columns(first, sensor.residual_unit()));
    for (const AttitudeLine& line : lines) {
      add_attitude_cells(csv, line);
      csv.end_row();
    }
    text = csv.str();
  }
  if (!a.out.empty())
    write_atomically(a.out, text);
  else if (!print_out(text))
    return kDone;
  const auto does_not_fit = [](const AttitudeLine& line) {
    return line.measurement.attitude.status == SolveStatus::kDoesNotFit;
  };
  if (std::ranges::any_of(lines, does_not_fit)) hint_at_misfit();
  const bool all = std::ranges::all_of(
      lines, [](const AttitudeLine& line) { return line.measurement.attitude.has_attitude(); });
  return all ? kDone : kFailedPoses;
}

}  // namespace turntable
