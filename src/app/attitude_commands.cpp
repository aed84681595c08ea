// Attitudes for people without a rig: from a table of image points (solve), from images (measure),
// from a camera or a folder while it fills (track).
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "src/app/commands.h"
#include "src/app/open_rig.h"
#include "src/app/progress.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/core/json_document.h"
#include "src/core/parallel.h"
#include "src/core/target_file.h"
#include "src/core/units.h"
#include "src/evaluation/measure_spots.h"
#include "src/geometry/gimbal.h"
#include "src/record/atomic_file.h"
#include "src/record/csv.h"
#include "src/record/image_import.h"
#include "src/record/number_table.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;

const Gimbal& default_gimbal() {
  static const Gimbal gimbal([] {
    GimbalConfig config;  // by order of yaw, roll, pitch
    config.axes = {Vector3d::UnitZ(), Vector3d::UnitY(), Vector3d::UnitX()};
    return config;
  }());
  return gimbal;
}

/// Camera, target and solver as the command line names them, checked as a whole.
class Instrument {
 public:
  explicit Instrument(const AttitudeArguments& a)
      : solver_(solver_of(a)),
        calibration_(calibration_of(a)),
        file_(load_target(a.target)),
        target_(target_of(file_)),
        sensor_(calibration_, target_, solver_, a.camera, a.robust) {
    search_.target_uncertainty_mm = file_.uncertainty_mm;
    search_.R_near = near_of(a);
    search_.max_turn_rad = rad_from_deg(a.within_deg);
    if (a.robust && &solver_ != &default_solver())
      throw ConfigError(
          "--robust", "",
          fmt::format("means nothing with solver {}, allowed: {}, which leaves points "
                      "out. Remove one of the two.",
                      solver_.name, default_solver().name));
    if (a.robust && target_.size() <= 4)
      throw ConfigError(
          "--robust", "",
          fmt::format("found a target of {} points, allowed: more than four, so that one may be "
                      "left out. Remove it.",
                      target_.size()));
  }
  Instrument(const Instrument&) = delete;
  Instrument& operator=(const Instrument&) = delete;

  const AttitudeSensor& sensor() const { return sensor_; }
  const TargetFile& target_file() const { return file_; }
  int points() const { return target_.size(); }
  ImageSize image_size() const { return calibration_.irt.image_size(); }

  /// Without named points, correspondence has to find the target.
  void check_depth(const std::string& what_to_do) const {
    if (target_.coplanar())
      throw ConfigError(
          file_.file, "/points_mm",
          "lie in a plane: which spot is which point cannot be told then. " + what_to_do);
  }

  TargetMeasurement measure(const SpotList& spots, const MeasuredAttitude* near = nullptr) const {
    return measure_spots(sensor_, spots, search_, near);
  }

  TargetMeasurement measure_named(const SpotList& spots) const {
    return measure_named_spots(sensor_, spots, file_.uncertainty_mm);
  }

  /// What the verb prints of an image that cannot be measured; empty if it can.
  std::string size_complaint(ImageSize size) const {
    if (size == image_size()) return {};
    return fmt::format("wrong size: {} x {} px instead of {} x {} px as calibrated", size.width,
                       size.height, image_size().width, image_size().height);
  }

 private:
  static const Solver& solver_of(const AttitudeArguments& a) {
    if (a.solver.empty()) return default_solver();
    if (const Solver* solver = find_solver(a.solver)) return *solver;
    std::vector<std::string_view> known;
    for (const Solver& s : kSolvers) known.push_back(s.name);
    throw ConfigError("--solver", "",
                      fmt::format("found \"{}\", allowed: {}.", a.solver, fmt::join(known, ", ")));
  }
  static Matrix3d near_of(const AttitudeArguments& a) {
    if (a.near_deg.empty()) return Matrix3d::Identity();
    if (a.near_deg.size() != 3)
      throw ConfigError("--near", "",
                        fmt::format("found {} angles, allowed: yaw, roll and pitch, deg, separated "
                                    "by commas.",
                                    a.near_deg.size()));
    return default_gimbal().rotation(
        {rad_from_deg(a.near_deg[0]), rad_from_deg(a.near_deg[1]), rad_from_deg(a.near_deg[2])});
  }
  static Calibration calibration_of(const AttitudeArguments& a) {
    Calibration calibration = load_calibration(a.calibration);
    calibration.source = a.calibration.string();  // what complaints name
    return calibration;
  }
  static TargetModel target_of(const TargetFile& file) {
    if (const std::string refusal = TargetModel::refusal(file.points_mm); !refusal.empty())
      throw ConfigError(file.file, "/points_mm", refusal + ".");
    return TargetModel(file.points_mm);
  }

  const Solver& solver_;
  Calibration calibration_;
  TargetFile file_;
  TargetModel target_;
  AttitudeSensor sensor_;
  TargetSearch search_;
};

// ---- what is printed

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

/// One line of output.
struct Line {
  std::string name;  ///< of the frame or file
  TargetMeasurement measurement;
};

std::vector<std::string> columns(const std::string& first, std::string_view residual_unit) {
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
          fmt::format("residual_{}", residual_unit),
          "in_domain",
          "left_out"};
}

void add_numbers(Csv& csv, const Eigen::Ref<const Eigen::VectorXd>& values, int decimals) {
  for (Eigen::Index i = 0; i < values.size(); ++i) csv.number(values(i), decimals);
}

/// The cells of a line, without its end.
void add_cells(Csv& csv, const Line& line) {
  const MeasuredAttitude& a = line.measurement.attitude;
  const Shown s = shown(line.measurement);
  csv.text(line.name).text(line.measurement.status);
  add_numbers(csv, s.vector_deg, 6);
  add_numbers(csv, s.quaternion, 9);
  add_numbers(csv, s.yaw_roll_pitch_deg, 6);
  add_numbers(csv, a.position_mm, 5);
  add_numbers(csv, s.std_deg, 6);
  add_numbers(csv, s.std_mm, 5);
  csv.number(a.chi2, 4).number(a.residual, 6);
  if (line.measurement.spot_of_point.empty())
    csv.empty();
  else
    csv.integer(a.in_domain);
  csv.text(fmt::format("{}", fmt::join(points_left_out(a), " ")));
}

/// Null if there is none of them; NaN becomes null.
Json numbers(const Eigen::Ref<const Eigen::VectorXd>& values) {
  if (values.size() == 0 || values.array().isNaN().all()) return nullptr;
  Json out = Json::array();
  for (Eigen::Index i = 0; i < values.size(); ++i) out.push_back(values(i));
  return out;
}

Json json_of(const std::string& first, const Line& line, std::string_view residual_unit) {
  const MeasuredAttitude& a = line.measurement.attitude;
  const Shown s = shown(line.measurement);
  Json json;
  json[first] = line.name;
  json["status"] = line.measurement.status;
  json["rotation_vector_deg"] = numbers(s.vector_deg);
  json["quaternion_wxyz"] = numbers(s.quaternion);
  json["yaw_roll_pitch_deg"] = numbers(s.yaw_roll_pitch_deg);
  json["position_mm"] = numbers(a.position_mm);
  json["std_rotation_deg"] = numbers(s.std_deg);
  json["std_position_mm"] = numbers(s.std_mm);
  json["covariance_rad_mm"] = nullptr;
  json["chi2"] = a.chi2;
  json["residual"] = a.residual;
  json["residual_unit"] = residual_unit;
  json["iterations"] = a.iterations;
  json["in_domain"] = nullptr;
  json["spot_of_point"] = line.measurement.spot_of_point;
  json["left_out"] = points_left_out(a);
  const PoseUncertainty& u = line.measurement.uncertainty;
  const Matrix6d total = u.total();
  if (!total.array().isNaN().all()) {
    json["covariance_rad_mm"] = Json::array();
    for (int i = 0; i < 6; ++i) json["covariance_rad_mm"].push_back(numbers(total.col(i)));
    const auto add_part = [&json](const char* source, const Matrix6d& part) {
      json["std_by_source"][source]["rotation_deg"] = numbers(std_deg(part));
      json["std_by_source"][source]["position_mm"] = numbers(std_mm(part));
    };
    add_part("spots", u.spots);
    add_part("rays", u.rays);
    add_part("target", u.target);
  }
  if (!line.measurement.spot_of_point.empty()) json["in_domain"] = a.in_domain;
  if (a.rival) {
    json["rival"]["quaternion_wxyz"] = numbers(quaternion_of(a.rival->R));
    json["rival"]["position_mm"] = numbers(a.rival->position_mm);
    json["rival"]["residual"] = a.rival->residual;
  }
  return json;
}

/// Checked before the work.
void check_out(const AttitudeArguments& a) {
  if (a.out.empty()) return;
  std::error_code error;
  if (fs::is_directory(a.out, error))
    throw ConfigError(a.out.string(), "", "is a folder, allowed: a file (--out).");
  const fs::path folder = fs::absolute(a.out, error).parent_path();
  if (!fs::is_directory(folder, error))
    throw ConfigError(folder.string(), "", "is no folder. Make it, or choose another --out.");
}

/// Prints or writes all lines. @return exit code.
int put(const AttitudeArguments& a, const Instrument& instrument, const std::string& first,
        const std::vector<Line>& lines) {
  const std::string_view unit = instrument.sensor().residual_unit();
  std::string text;
  if (a.format == "json") {
    Json json;
    json["solver"] = instrument.sensor().solver().name;
    if (!a.camera.empty()) json["camera"] = a.camera;
    json["calibration"] = a.calibration.string();
    json["target"] = a.target.string();
    json["attitudes"] = Json::array();
    for (const Line& line : lines) json["attitudes"].push_back(json_of(first, line, unit));
    text = json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
  } else {
    Csv csv(columns(first, unit));
    for (const Line& line : lines) {
      add_cells(csv, line);
      csv.end_row();
    }
    text = csv.str();
  }
  if (a.out.empty())
    fmt::print("{}", text);
  else
    write_atomically(a.out, text);
  const bool all = std::ranges::all_of(
      lines, [](const Line& line) { return line.measurement.attitude.has_attitude(); });
  return all ? kDone : kFailedPoses;
}

// ---- solve

/// The rows of one frame, in the order of the table.
struct PointFrame {
  std::string name;
  std::vector<std::size_t> rows;
};

std::vector<PointFrame> frames_of(const NumberTable& table) {
  std::vector<PointFrame> frames;
  std::map<double, std::size_t> index;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    const double id = table.has("frame") ? table.at("frame")[row] : 0.0;
    const auto [at, fresh] = index.try_emplace(id, frames.size());
    if (fresh) frames.push_back({fmt::format("{}", id), {}});
    frames[at->second].rows.push_back(row);
  }
  return frames;
}

/// Row of every point, or -1. @throws ConfigError: no such point, or one that stands twice.
std::vector<int> rows_by_point(const NumberTable& table, const PointFrame& frame, int points,
                               const std::string& file) {
  std::vector<int> rows(static_cast<std::size_t>(points), -1);
  for (const std::size_t row : frame.rows) {
    const double value = table.at("point")[row];
    const std::string place = fmt::format("line {}, column point", table.lines[row]);
    if (value != std::floor(value) || value < 0.0 || value >= points)
      throw ConfigError(
          file, place,
          fmt::format("found {}, allowed: 0 to {}, the points of the target.", value, points - 1));
    int& at = rows[static_cast<std::size_t>(value)];
    if (at >= 0)
      throw ConfigError(file, place,
                        fmt::format("point {} stands twice in this frame. Remove one, or number "
                                    "the frames (column \"frame\").",
                                    value));
    at = static_cast<int>(row);
  }
  return rows;
}

// ---- images

bool is_image_name(const fs::path& file) {
  static const std::set<std::string> endings{".png", ".bmp", ".tif", ".tiff", ".pgm",
                                             ".ppm", ".pnm", ".jpg", ".jpeg"};
  std::string ending = file.extension().string();
  std::ranges::transform(ending, ending.begin(), [](unsigned char c) { return std::tolower(c); });
  return endings.contains(ending) && !file.filename().string().starts_with('.');
}

/// By name.
std::vector<fs::path> images_in(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error))
    if (is_image_name(it->path())) files.push_back(it->path());
  if (error) throw ConfigError(folder.string(), "", "cannot be listed: " + error.message() + ".");
  std::ranges::sort(files);
  return files;
}

/// An image, or why there is none.
struct Loaded {
  Image image;
  std::string complaint;
};

Loaded load(const Instrument& instrument, const fs::path& file) {
  Loaded out;
  try {
    out.image = import_image(file);
    out.complaint = instrument.size_complaint(out.image.size());
  } catch (const ConfigError& e) {
    out.complaint = "unreadable: " + e.message();
  }
  return out;
}

// ---- track

/// What a source of frames has next.
struct NextFrame {
  std::string name;
  Loaded loaded;
};

/// Images of a folder by name; followed, also those that come later.
class FolderSource {
 public:
  FolderSource(const Instrument& instrument, fs::path folder, bool follow)
      : instrument_(instrument), folder_(std::move(folder)), follow_(follow) {
    refill();
    if (waiting_.empty() && !follow_)
      throw ConfigError(folder_.string(), "",
                        "holds no images (png, bmp, tif, pgm, ppm, jpg). Name another folder, or "
                        "wait for them with --follow.");
  }

  /// Nothing at the end, or when interrupted.
  std::optional<NextFrame> next() {
    while (interrupt_level() == 0) {
      if (waiting_.empty() && follow_) refill();
      if (!waiting_.empty()) {
        const fs::path file = waiting_.back();
        Loaded loaded = load(instrument_, file);
        // Whoever writes it may not have done yet.
        if (follow_ && loaded.image.pixels.empty() && !has_aged(file)) {
          std::this_thread::sleep_for(kPoll);
          continue;
        }
        waiting_.pop_back();
        return NextFrame{file.filename().string(), std::move(loaded)};
      }
      if (!follow_) break;
      std::this_thread::sleep_for(kPoll);
    }
    return std::nullopt;
  }

 private:
  static constexpr std::chrono::milliseconds kPoll{2};
  static constexpr std::chrono::milliseconds kGrain{50};
  static constexpr std::chrono::seconds kPatience{2};

  void refill() {
    // Listing a big folder is work; whether it changed is one question. Its time has a grain.
    std::error_code error;
    const fs::file_time_type changed = fs::last_write_time(folder_, error);
    if (!error && changed == listed_ && fs::file_time_type::clock::now() - changed > kGrain) return;
    for (const fs::path& file : images_in(folder_))
      if (seen_.insert(file).second) waiting_.push_back(file);
    std::ranges::reverse(waiting_);  // taken from the back
    listed_ = changed;
  }

  /// It has not grown for so long that nobody writes it any more.
  static bool has_aged(const fs::path& file) {
    std::error_code error;
    const auto written = fs::last_write_time(file, error);
    return error || fs::file_time_type::clock::now() - written > kPatience;
  }

  const Instrument& instrument_;
  fs::path folder_;
  bool follow_;
  fs::file_time_type listed_ = fs::file_time_type::min();  ///< the folder's, when it was listed
  std::set<fs::path> seen_;
  std::vector<fs::path> waiting_;  ///< last name first
};

/// The camera of a rig, triggered again and again.
class TriggeredSource {
 public:
  TriggeredSource(const Instrument& instrument, const RigFile& file)
      : instrument_(instrument), rig_(open_camera_alone(file)) {}

  std::optional<NextFrame> next() {
    if (interrupt_level() > 0) return std::nullopt;
    NextFrame out;
    try {
      Frame frame = rig_.camera->trigger();
      out.name = fmt::format("{}", frame.id);
      out.loaded.image = std::move(frame.image);
      out.loaded.complaint = instrument_.size_complaint(out.loaded.image.size());
    } catch (const Interrupted&) {
      return std::nullopt;
    } catch (const TimeoutError&) {
      out.loaded.complaint = "no frame";
    }
    return out;
  }

 private:
  const Instrument& instrument_;
  Rig rig_;
};

/// Of values in ms; NaN of none.
double quantile(std::vector<double> values, double share) {
  if (values.empty()) return NAN;
  const auto k = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::ranges::nth_element(values, values.begin() + k);
  return values[static_cast<std::size_t>(k)];
}

/// Nothing at the end, or when interrupted.
using FrameSource = std::function<std::optional<NextFrame>()>;

/// Follows the target from frame to frame. @return exit code.
int track(const Instrument& instrument, const FrameSource& next, int frames,
          double electrons_per_grey) {
  std::vector<std::string> header = columns("frame", instrument.sensor().residual_unit());
  header.insert(header.begin(), "time_utc");
  header.push_back("latency_ms");
  const std::size_t header_length = Csv(header).str().size();
  fmt::print("{}", Csv(header).str());

  std::optional<MeasuredAttitude> last;
  std::vector<double> latencies_ms;
  int taken = 0, lost = 0;
  bool heard = std::fflush(stdout) == 0;
  const auto start = SteadyClock::now();
  while (heard && (frames == 0 || taken < frames)) {
    const std::optional<NextFrame> frame = next();
    if (!frame) break;
    ++taken;
    Line line{frame->name, {}};
    const std::string time = utc_now();
    double latency_ms = NAN;
    if (frame->loaded.complaint.empty()) {
      const auto in_memory = SteadyClock::now();
      const SpotList spots = spots_in(frame->loaded.image, electrons_per_grey);
      line.measurement = instrument.measure(spots, last ? &*last : nullptr);
      latency_ms =
          std::chrono::duration<double, std::milli>(SteadyClock::now() - in_memory).count();
      latencies_ms.push_back(latency_ms);
    } else {
      line.measurement.status = frame->loaded.complaint;
    }
    const MeasuredAttitude& attitude = line.measurement.attitude;
    if (!attitude.has_attitude())
      ++lost;
    else if (attitude.position_mm.allFinite())
      last = attitude;
    Csv csv(header);
    csv.text(time);
    add_cells(csv, line);
    csv.number(latency_ms, 3).end_row();
    fmt::print("{}", std::string_view(csv.str()).substr(header_length));
    heard = std::fflush(stdout) == 0;  // "| head" ends it
  }
  const double elapsed = std::chrono::duration<double>(SteadyClock::now() - start).count();
  fmt::print(stderr,
             "{} frames, {} lost; latency median {:.3f} ms, p99 {:.3f} ms; {:.1f} frames/s\n",
             taken, lost, quantile(latencies_ms, 0.5), quantile(latencies_ms, 0.99),
             taken / std::max(elapsed, 1e-9));
  return lost > 0 && interrupt_level() == 0 ? kFailedPoses : kDone;
}

}  // namespace

int solve_command(const SolveArguments& a) {
  const Instrument instrument(a);
  check_out(a);
  const std::string file = a.points.string();
  const NumberTable table =
      read_number_table(a.points, {"u_px", "v_px"}, {"frame", "point", "sigma_px"});
  const bool named = table.has("point");
  if (!named)
    instrument.check_depth("Give the table a column \"point\" (from 0, in the target's order).");
  if (table.has("sigma_px"))
    for (std::size_t row = 0; row < table.rows(); ++row)
      if (!(table.at("sigma_px")[row] > 0.0))
        throw ConfigError(file, fmt::format("line {}, column sigma_px", table.lines[row]),
                          fmt::format("found {}, allowed: above 0, px. Leave the column out if it "
                                      "is not known.",
                                      table.at("sigma_px")[row]));
  const std::vector<PointFrame> frames = frames_of(table);
  const auto most = std::ranges::max(frames, {}, [](const PointFrame& f) { return f.rows.size(); });
  if (static_cast<int>(most.rows.size()) < instrument.points())
    throw ConfigError(
        file, "",
        fmt::format("found {} points in a frame at most, allowed: the target's {} or "
                    "more. Name the target that was seen ({}).",
                    most.rows.size(), instrument.points(), instrument.target_file().file));
  std::vector<std::vector<int>> order(frames.size());  // complaints come before the work
  if (named)
    for (std::size_t k = 0; k < frames.size(); ++k)
      order[k] = rows_by_point(table, frames[k], instrument.points(), file);

  std::vector<Line> lines(frames.size());
  parallel_for(frames.size(), [&](std::size_t k) {
    lines[k].name = frames[k].name;
    TargetMeasurement& out = lines[k].measurement;
    SpotList spots;
    const auto add = [&](std::size_t row) {
      spots.centres_px.emplace_back(table.at("u_px")[row], table.at("v_px")[row]);
      if (table.has("sigma_px")) spots.sigmas_px.push_back(table.at("sigma_px")[row]);
    };
    if (!named) {
      for (const std::size_t row : frames[k].rows) add(row);
      out = instrument.measure(spots);
      return;
    }
    const auto seen = std::ranges::count_if(order[k], [](int row) { return row >= 0; });
    if (seen < instrument.points()) {
      out.status = fmt::format("too few spots: {} of {}", seen, instrument.points());
      return;
    }
    for (const int row : order[k]) add(static_cast<std::size_t>(row));
    out = instrument.measure_named(spots);
  });
  return put(a, instrument, "frame", lines);
}

int measure_command(const MeasureArguments& a) {
  const Instrument instrument(a);
  instrument.check_depth(
      "Raise one point, or find the spots yourself and use \"turntable solve\".");
  check_out(a);
  std::vector<fs::path> files;
  for (const fs::path& given : a.images) {
    std::error_code error;
    if (!fs::exists(given, error))
      throw ConfigError(given.string(), "", "does not exist, allowed: an image or a folder.");
    if (!fs::is_directory(given, error)) {
      files.push_back(given);
      continue;
    }
    const std::vector<fs::path> inside = images_in(given);
    if (inside.empty())
      throw ConfigError(given.string(), "",
                        "holds no images (png, bmp, tif, pgm, ppm, jpg). Name another folder.");
    files.insert(files.end(), inside.begin(), inside.end());
  }
  std::vector<Line> lines(files.size());
  {
    ProgressLine progress("measuring");
    std::atomic<std::size_t> done{0};
    parallel_for(files.size(), [&](std::size_t i) {
      lines[i].name = files[i].string();
      const Loaded loaded = load(instrument, files[i]);
      if (loaded.complaint.empty())
        lines[i].measurement = instrument.measure(spots_in(loaded.image, a.electrons_per_grey));
      else
        lines[i].measurement.status = loaded.complaint;
      progress.update(++done, files.size(), "images");
    });
  }
  return put(a, instrument, "file", lines);
}

int track_command(const TrackArguments& a) {
  stop_at_first_interrupt();  // there is no pose to finish
  const Instrument instrument(a);
  instrument.check_depth("Raise one point.");
  std::error_code error;
  if (fs::is_directory(a.source, error)) {
    FolderSource source(instrument, a.source, a.follow);
    return track(
        instrument, [&] { return source.next(); }, a.frames, a.electrons_per_grey);
  }
  if (a.follow) throw ConfigError("--follow", "", "goes with a folder of images. Remove it.");
  if (is_image_name(a.source))
    throw ConfigError(a.source.string(), "",
                      "is no folder, allowed: a folder of images, or a rig file. One image: "
                      "\"turntable measure\".");
  const RigFile rig = load_rig_file(a.source);
  if (const std::string complaint = instrument.size_complaint(rig.camera.image_size);
      !complaint.empty())
    throw ConfigError(rig.file, "/camera/image_size_px",
                      complaint + ". Calibrate at the camera's size.");
  TriggeredSource source(instrument, rig);
  return track(
      instrument, [&] { return source.next(); }, a.frames,
      a.electrons_per_grey > 0.0 ? a.electrons_per_grey : rig.camera.electrons_per_grey);
}

}  // namespace turntable
