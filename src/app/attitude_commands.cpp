// Attitudes for people without a rig: from a table of image points (solve), from images (measure),
// from a camera or a folder while it fills (track).
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <functional>
#include <iostream>
#include <iterator>
#include <map>
#include <set>
#include <thread>

#include "src/app/attitude_output.h"
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
#include "src/record/image_import.h"
#include "src/record/number_table.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;

/// Why there is nothing to measure.
struct Complaint {
  std::string status, message;

  bool empty() const { return status.empty(); }
  void to(TargetMeasurement& measurement) const {
    measurement.status = status;
    measurement.message = message;
  }
};

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
    search_.max_turn_rad = rad_from_deg(a.within_deg.value_or(180.0));
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
    // Rays through one centre fit a target of any size, so that no test of fit can tell.
    if (target_.radius_mm() < 1.0)
      spdlog::warn(
          "{}: its points reach {:.2g} mm only. They are taken as mm: check that they are not "
          "metres.",
          file_.file, target_.radius_mm());
    if (solver_.name == "opencv_epnp" && target_.size() == 4)
      spdlog::warn("opencv_epnp is made for five points and more; this target has four.");
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

  /// Of an image that cannot be measured; empty if it can.
  Complaint size_complaint(ImageSize size) const {
    if (size == image_size()) return {};
    return {"wrong_size", fmt::format("{} x {} px instead of {} x {} px as calibrated", size.width,
                                      size.height, image_size().width, image_size().height)};
  }

  /// What std_* do not count is said once, before the work.
  void say_what_std_lacks() const {
    if (&sensor_.solver() != &default_solver()) return;  // the others state none
    std::vector<std::string> lacks;
    if (!sensor_.states_rays())
      lacks.push_back(fmt::format("rays ({} states no covariance of them)", calibration_.source));
    if (!(file_.uncertainty_mm > 0.0))
      lacks.push_back(fmt::format("target ({} states no uncertainty_mm)", file_.file));
    if (!lacks.empty())
      spdlog::info("std_* do not count the uncertainty of: {}.", fmt::join(lacks, ", "));
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
    if (a.within_deg && !(*a.within_deg > 0.0 && *a.within_deg <= 180.0))
      throw ConfigError(
          "--within", "",
          fmt::format("found {}, allowed: above 0, at most 180, deg.", *a.within_deg));
    if (a.near_deg.empty()) return Matrix3d::Identity();
    if (a.near_deg.size() != 3)
      throw ConfigError("--near", "",
                        fmt::format("found {} angles, allowed: yaw, roll and pitch, deg, separated "
                                    "by commas.",
                                    a.near_deg.size()));
    for (const double angle : a.near_deg)
      if (!(std::abs(angle) <= 360.0))
        throw ConfigError("--near", "", fmt::format("found {}, allowed: -360 to 360, deg.", angle));
    if (!a.within_deg)
      throw ConfigError("--near", "",
                        "means nothing without --within: say how far from there to look.");
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

/// Lines on all cores. Ctrl-C ends the work, and the lines that are done stay, in their order.
/// @return exit code so far: kInterrupted or kDone.
int make_lines(std::vector<AttitudeLine>& lines, std::string_view what,
               const std::function<void(std::size_t)>& make) {
  const std::size_t count = lines.size();
  std::vector<char> made(count, 0);
  try {
    ProgressLine progress("measuring");
    std::atomic<std::size_t> done{0};
    parallel_for(count, [&](std::size_t i) {
      make(i);
      made[i] = 1;
      progress.update(++done, count, what);
    });
  } catch (const Interrupted&) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < count; ++i)
      if (made[i] != 0) {
        if (kept != i) lines[kept] = std::move(lines[i]);
        ++kept;
      }
    lines.resize(kept);
    spdlog::warn("interrupted: {} of {} {} are done.", kept, count, what);
    return kInterrupted;
  }
  return kDone;
}

int put(const AttitudeArguments& a, const Instrument& instrument, const std::string& first,
        std::span<const AttitudeLine> lines, int code) {
  const int all =
      put_attitudes(a, instrument.sensor(), instrument.target_file().uncertainty_mm, first, lines);
  return code == kDone ? all : code;
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
  Complaint complaint;
};

Loaded load(const Instrument& instrument, const fs::path& file) {
  Loaded out;
  try {
    out.image = import_image(file);
    out.complaint = instrument.size_complaint(out.image.size());
  } catch (const ConfigError& e) {
    out.complaint = {"unreadable", e.message()};
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
      out.loaded.complaint = {"no_frame", "the camera did not answer in time"};
    }
    return out;
  }

 private:
  const Instrument& instrument_;
  Rig rig_;
};

/// Of values in ms; "-" of none.
std::string quantile_text(std::vector<double> values, double share) {
  if (values.empty()) return "-";
  const auto k = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::ranges::nth_element(values, values.begin() + k);
  return fmt::format("{:.3f}", values[static_cast<std::size_t>(k)]);
}

/// Nothing at the end, or when interrupted.
using FrameSource = std::function<std::optional<NextFrame>()>;

/// Follows the target from frame to frame. @return exit code.
int track(const Instrument& instrument, const FrameSource& next, int frames,
          double electrons_per_grey) {
  std::vector<std::string> header = attitude_columns("frame", instrument.sensor().residual_unit());
  header.insert(header.begin(), "time_utc");
  header.push_back("latency_ms");
  const std::size_t header_length = Csv(header).str().size();
  instrument.say_what_std_lacks();
  bool heard = print_out(Csv(header).str());

  std::optional<MeasuredAttitude> last;
  std::vector<double> latencies_ms;
  int taken = 0, lost = 0;
  bool hinted = false;
  const auto start = SteadyClock::now();
  while (heard && (frames == 0 || taken < frames)) {
    const std::optional<NextFrame> frame = next();
    if (!frame) break;
    ++taken;
    AttitudeLine line{frame->name, {}};
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
      frame->loaded.complaint.to(line.measurement);
    }
    const MeasuredAttitude& attitude = line.measurement.attitude;
    if (!attitude.has_attitude())
      ++lost;
    else if (attitude.position_mm.allFinite())
      last = attitude;
    if (attitude.status == SolveStatus::kDoesNotFit && !hinted) {
      hint_at_misfit();
      hinted = true;
    }
    Csv csv(header);
    csv.text(time);
    add_attitude_cells(csv, line);
    csv.number(latency_ms, 3).end_row();
    heard = print_out(std::string_view(csv.str()).substr(header_length));  // "| head" ends it
  }
  const double elapsed = std::chrono::duration<double>(SteadyClock::now() - start).count();
  fmt::print(stderr, "{} frames, {} lost; latency median {} ms, p99 {} ms; {:.1f} frames/s\n",
             taken, lost, quantile_text(latencies_ms, 0.5), quantile_text(latencies_ms, 0.99),
             taken / std::max(elapsed, 1e-9));
  return lost > 0 && heard && interrupt_level() == 0 ? kFailedPoses : kDone;
}

}  // namespace

int solve_command(const SolveArguments& a) {
  const Instrument instrument(a);
  check_out(a, std::vector{a.points, a.calibration, a.target});
  const bool piped = a.points == "-";
  const std::string file = piped ? "standard input" : a.points.string();
  const NumberTable table = number_table(
      piped ? std::string(std::istreambuf_iterator<char>(std::cin), {}) : read_text(a.points), file,
      {"u_px", "v_px"}, {"frame", "point", "sigma_px"});
  if (!table.unused.empty())
    spdlog::info("{}: columns that are not used: {}. Known: u_px, v_px, frame, point, sigma_px.",
                 file, fmt::join(table.unused, ", "));
  const bool named = table.has("point");
  if (named && (a.within_deg || !a.near_deg.empty()))
    throw ConfigError(file, "column point",
                      "tells which spot is which, so that --within and --near mean nothing. "
                      "Remove them, or the column.");
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

  if (table.has("sigma_px")) instrument.say_what_std_lacks();
  std::vector<AttitudeLine> lines(frames.size());
  const int code = make_lines(lines, "frames", [&](std::size_t k) {
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
      Complaint{"too_few_spots", fmt::format("{} of {}", seen, instrument.points())}.to(out);
      return;
    }
    for (const int row : order[k]) add(static_cast<std::size_t>(row));
    out = instrument.measure_named(spots);
  });
  return put(a, instrument, "frame", lines, code);
}

int measure_command(const MeasureArguments& a) {
  const Instrument instrument(a);
  instrument.check_depth(
      "Raise one point, or find the spots yourself and use \"turntable solve\".");
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
  std::vector<fs::path> inputs = files;
  inputs.insert(inputs.end(), {a.calibration, a.target});
  check_out(a, inputs);
  instrument.say_what_std_lacks();
  std::vector<AttitudeLine> lines(files.size());
  const int code = make_lines(lines, "images", [&](std::size_t i) {
    lines[i].name = files[i].string();
    const Loaded loaded = load(instrument, files[i]);
    if (loaded.complaint.empty())
      lines[i].measurement = instrument.measure(spots_in(loaded.image, a.electrons_per_grey));
    else
      loaded.complaint.to(lines[i].measurement);
  });
  return put(a, instrument, "file", lines, code);
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
  if (const Complaint complaint = instrument.size_complaint(rig.camera.image_size);
      !complaint.empty())
    throw ConfigError(rig.file, "/camera/image_size_px",
                      "wrong size: " + complaint.message + ". Calibrate at the camera's size.");
  TriggeredSource source(instrument, rig);
  return track(
      instrument, [&] { return source.next(); }, a.frames,
      a.electrons_per_grey > 0.0 ? a.electrons_per_grey : rig.camera.electrons_per_grey);
}

}  // namespace turntable
