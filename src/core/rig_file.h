// What a rig file says (scenarios/rigs/README.md lists every field with its unit), defaults filled
// in from the stage table. Lengths mm, angles deg, times s, as in the file.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "src/core/image.h"
#include "src/core/json_document.h"
#include "src/core/stage_spec.h"

namespace turntable {

using Eigen::Vector2d;
using Eigen::Vector3d;

enum class AxisId { kStage, kYaw, kRoll, kPitch };
inline constexpr std::array kAllAxes{AxisId::kStage, AxisId::kYaw, AxisId::kRoll, AxisId::kPitch};
inline constexpr std::array kRotaryAxes{AxisId::kYaw, AxisId::kRoll, AxisId::kPitch};
std::string_view axis_name(AxisId axis);
/// @throws std::out_of_range; schema-checked names never do.
AxisId axis_from_name(std::string_view name);
std::string_view axis_unit(AxisId axis);  ///< "mm" or "deg"

enum class Payload { kCirclePattern, kLedTarget };
std::string_view payload_name(Payload payload);

enum class Parity { kNone, kEven, kOdd };

struct LineConfig {
  /// kTcp: a serial server, the controller's own bytes. kModbusTcp: a Modbus gateway.
  enum class Kind { kSimulated, kSerial, kTcp, kModbusTcp } kind = Kind::kSimulated;
  std::string serial_port;
  int baud = 0;  ///< 0 = what the controller model usually has
  Parity parity = Parity::kNone;
  int stop_bits = 1;
  std::string host;
  std::uint16_t tcp_port = 0;
};

/// A digital output of a controller that fires the camera. What switches it is the rig file's business:
/// a line of text, a holding register, or one bit of a holding register whose other bits stay.
struct OutputConfig {
  std::string name;
  std::string on_text, off_text;   ///< of controllers that speak text
  std::optional<int> register_at;  ///< wire address, of controllers that speak Modbus
  int slave = 1;
  std::optional<int> bit;          ///< 0 to 15, of that register; the values are 0 and 1 then
  std::uint16_t on_value = 1, off_value = 0;
  double pulse_s = 0.01;

  /// The bits of a register in which on and off differ, and their values: what is left of a register
  /// whose other bits are other outputs.
  std::uint16_t mask() const {
    return bit ? static_cast<std::uint16_t>(1u << *bit)
               : static_cast<std::uint16_t>(on_value ^ off_value);
  }
  std::uint16_t bits(bool on) const {
    const unsigned value = on ? on_value : off_value;
    return static_cast<std::uint16_t>((bit ? value << *bit : value) & mask());
  }
};

struct ControllerConfig {
  std::string name;   ///< key in the rig file
  std::string model;  ///< row of the controller catalogue
  LineConfig line;
  double reply_timeout_s = 0.0;      ///< 0 = what the model usually needs
  int address = 1;                   ///< Modbus slave of a controller that is one slave
  bool answers_while_moving = true;  ///< false: nothing but a stop is heard until a move has ended
  /// Of model "described": one that is shipped, or the path of a file that ends in .json.
  std::string description;
  /// Of that file, as a plan has frozen it; empty: it is read when it is needed.
  std::string description_text;
  std::vector<OutputConfig> outputs;
};

/// What keeps an axis from going on. Units of the axis.
struct AxisBound {
  std::string_view what;  ///< "soft limits" or "cable range"
  std::string place;      ///< JSON pointer in the rig file
  double lower{}, upper{};
};

/// Units of the axis: mm or deg, per second.
struct AxisConfig {
  AxisId id{};
  std::string controller;
  std::string channel;
  std::string stage_model;
  StageKind kind{};
  double steps_per_rev{}, drive_ratio{}, lead_mm{};
  double lower{}, upper{};  ///< soft limits; the overshoot has to stay inside too
  /// Where the cable stays free, and the overshoot too: mechanics may allow more. Infinite = not
  /// stated.
  double cable_lower = -std::numeric_limits<double>::infinity();
  double cable_upper = std::numeric_limits<double>::infinity();
  double initial_speed{}, speed{}, acceleration{}, home_speed{};
  double repeatability{};
  double backlash{};   ///< overshoot of the one-sided approach; sign = final direction; 0 = none
  double tolerance{};  ///< in-position window, half width
  bool tolerance_stated = false;  ///< in the rig file
  /// The least step that the controller can be sent to, and the least that it tells; 0 = its pulses. A
  /// fact of the controller's model, filled in from the catalogue of drivers.
  double sent_step{}, told_step{};
  /// The controller counts the other way: upwards where the rig's axis goes down.
  bool reversed = false;
  double settle_s{};  ///< time inside the window before a move counts as ended
  int retries{};

  std::string_view unit() const { return axis_unit(id); }
  /// What soft limits and cable both allow.
  double reach_lower() const { return std::max(lower, cable_lower); }
  double reach_upper() const { return std::min(upper, cable_upper); }
  bool has_cable() const { return cable_lower > -std::numeric_limits<double>::infinity(); }
  /// The soft limits or, if they allow `position`, the cable; nothing if both do. NaN is refused.
  std::optional<AxisBound> bound_against(double position) const;
  double per_step() const {
    return kind == StageKind::kRotary ? 360.0 / (drive_ratio * steps_per_rev)
                                      : lead_mm / steps_per_rev;
  }
  /// How fine a window may be: within it a goal cannot be told from its neighbours.
  double finest_window() const { return 0.5 * per_step() + 0.5 * told_step; }
  /// The least distance that the axis can be moved by.
  double least_move() const { return std::max(per_step(), sent_step); }
  /// The place nearest to `target` to which the axis can be sent: on the grid of what the controller is
  /// told, rounded to pulses by the controller.
  double on_grid(double target) const;
};

/// The axis as its controller sees it: the same, or its mirror image if it counts the other way.
AxisConfig controller_side(const AxisConfig& axis);

/// How an exposure is started.
struct TriggerConfig {
  enum class Source { kSoftware, kLine } source = Source::kSoftware;
  std::string line = "Line0";  ///< kLine: the camera's input
  bool rising = true;
  /// kLine: which output is wired to that input; empty = something this program does not know.
  std::string controller, output;
};

enum class FileOrder { kName, kNatural, kTime };

struct CameraConfig {
  std::string model;
  std::string device;      ///< "gige": id or address, empty = the only one; "usb": device or file
  bool simulated = false;  ///< "gige": the program serves the camera itself, on loopback
  std::string pixel_format = "Mono8";
  std::optional<double> exposure_us, gain;  ///< nothing = as the camera is set
  std::array<int, 2> offset_px{0, 0};       ///< of the region on the sensor
  int packet_bytes = 0;                     ///< "gige": 0 = found out by the library
  std::optional<int> stale_frames;  ///< "usb": thrown away before each exposure; nothing = 4 of a
                                    ///< device, 0 of a file
  TriggerConfig trigger;
  std::filesystem::path folder;  ///< of camera model "folder"
  bool replay = false;           ///< "folder": images taken earlier, in order
  std::string files = "*.png";   ///< "folder": which ones, names below the folder, * and ?
  FileOrder order = FileOrder::kName;
  std::string layout;  ///< "folder": the file of each pose, "{scenario}/{repeat}/{point:03}.png"
  double latency_s =
      0.0;  ///< "folder": from the beginning of an exposure to its whole file, at most
  bool latency_stated = false;  ///< in the rig file
  ImageSize image_size;
  double frame_timeout_s = 2.0;
  /// From the trigger to the end of the exposure, as far as the rig file tells, and to the file.
  double answer_s() const { return exposure_us.value_or(0.0) * 1e-6 + latency_s; }
  int retries = 2;
  double electrons_per_grey = 0.0;  ///< shot noise of image points; 0 = not counted
  /// Nominal geometry (drawings): used to predict the field of view and nothing else.
  double nominal_focal_px{};
  double nominal_height_mm{};  ///< camera above the base plane (z of its centre in the plane frame)
};

struct GimbalConfig {
  std::array<AxisId, 3> order_base_outwards{AxisId::kYaw, AxisId::kRoll, AxisId::kPitch};
  /// Unit vectors in the plane frame at zero angles, by order of kRotaryAxes (yaw, roll, pitch).
  std::array<Vector3d, 3> axes;
  Vector3d centre_at_stage_zero_mm = Vector3d::Zero();  ///< plane frame
  // What was found out about the real axes (`turntable identify`); they leave `axes`, in which
  // attitudes are stated, as they are.
  /// Rotation vector: the gimbal's frame against the plane frame.
  Vector3d plane_from_gimbal_deg = Vector3d::Zero();
  /// Angles by which the real axes miss right angles, base outwards: the second leans towards the
  /// first, the third towards the first, the third towards the second.
  Vector3d axis_tilt_deg = Vector3d::Zero();
};

/// kCircles: four bigger circles give direction. kCircleGrid: all equal. kAsymmetricCircles: every
/// other row shifted by half, columns counted within a row. kChessboard: inner corners.
enum class PatternKind { kCircles, kCircleGrid, kAsymmetricCircles, kChessboard };
inline constexpr std::array kAllPatternKinds{PatternKind::kCircles, PatternKind::kCircleGrid,
                                             PatternKind::kAsymmetricCircles,
                                             PatternKind::kChessboard};
std::string_view pattern_kind_name(PatternKind kind);

/// Lattice positions are (column, row) relative to the origin circle, x = column * spacing, y = row
/// * spacing.
struct PatternConfig {
  PatternKind kind = PatternKind::kCircles;
  int columns{}, rows{};
  int origin_column{},
      origin_row{};  ///< of the origin circle, counted from the corner with the least x and y
  double spacing_mm{}, radius_mm{}, direction_radius_mm{};
  std::vector<std::array<int, 2>>
      direction_circles;  ///< four (column, row) relative to the origin circle; kCircles only
  bool bright = true;     ///< bright circles on a dark ground
  Vector3d offset_mm = Vector3d::Zero();  ///< origin circle from the gimbal centre at zero angles
};

struct TargetConfig {
  std::vector<Vector3d> points_mm;  ///< target frame, origin at M0
  double led_radius_mm{};
  Vector3d offset_mm = Vector3d::Zero();  ///< M0 from the gimbal centre at zero angles
  double uncertainty_mm = 0.0;  ///< standard uncertainty of each coordinate; 0 = not stated
};

/// A standard uncertainty and where it is stated.
struct Tolerance {
  double sd = 0.0;
  std::string source;  ///< JSON pointer in the rig file, or "default"
};

/// How far the real rig may be from its drawings: what self-calibration starts from.
struct ToleranceConfig {
  Tolerance target_mm;       ///< each coordinate of an LED from M0
  Tolerance squareness_deg;  ///< lean of the stage's travel, towards x and towards y
  Tolerance mounting_deg;    ///< gimbal against the plane frame, target against its table; per axis
  Tolerance axes_deg;        ///< each angle between two rotary axes
  Tolerance offset_mm;       ///< gimbal centre, and M0 from it; each coordinate
  Tolerance stage_scale;     ///< of the travel, 1
};

/// A thin-walled lens that no camera model under test contains exactly: radial polynomial,
/// decentring, a tilted sensor and an entrance pupil that walks along the axis with the field
/// angle.
struct LensTruth {
  double focal_px{};
  Vector2d principal_point_px = Vector2d::Zero();
  std::array<double, 3> radial{};      ///< k1, k2, k3 of tan(theta)^2, ^4, ^6
  std::array<double, 2> decentring{};  ///< p1, p2
  Vector2d sensor_tilt_deg = Vector2d::Zero();
  double pupil_walk_mm_per_rad2{};
};

/// What is true of the simulated axis and unknown to the controller. Units of the axis.
struct AxisTruth {
  double repeatability{};   ///< two standard deviations of the random part of each arrival
  double backlash{};        ///< lost motion when the direction of approach changes
  double worm_amplitude{};  ///< periodic error, once per worm (motor) revolution
  double home_offset{};     ///< where the axis stands at power-up, from the reference
};

struct ImageTruth {
  double background_grey{}, led_peak_grey{};
  double circle_dark_grey{}, circle_bright_grey{};
  double blur_px{};  ///< standard deviation of the point spread
  double read_noise_grey{};
  double electrons_per_grey{};  ///< shot noise; 0 = none
};

struct SimulationConfig {
  std::uint64_t seed{};
  LensTruth lens;
  Vector3d camera_position_mm = Vector3d::Zero();  ///< plane frame
  Vector3d camera_rotation_deg =
      Vector3d::Zero();  ///< rotation vector, from looking straight down -z
  Vector2d stage_squareness_deg = Vector2d::Zero();  ///< lean of the travel towards x and y
  Vector3d plane_from_gimbal_deg =
      Vector3d::Zero();  ///< rotation vector: gimbal axes against the plane frame
  Vector3d table_from_target_deg = Vector3d::Zero();  ///< rotation vector: target against the table
  std::vector<Vector3d> target_errors_mm;             ///< real minus drawn LED positions
  Vector3d target_offset_error_mm = Vector3d::Zero();
  /// Rotation vector of each axis's real direction against its stated one, by order of kRotaryAxes.
  std::array<Vector3d, 3> axis_errors_deg{Vector3d::Zero(), Vector3d::Zero(), Vector3d::Zero()};
  double stage_scale = 1.0;  ///< real over stated travel
  std::map<AxisId, AxisTruth> axes;
  ImageTruth image;
};

/// What parts the whole from the fraction of a number in text.
enum class Decimal { kUnstated, kPoint, kComma };

/// A reading beside the motion: a temperature, a pressure, a supply. Values in `unit`.
struct ChannelConfig {
  std::string name;
  std::string unit;
  /// kFile: the first number of a text file (sysfs, or another program's). kAsk: a query in text and
  /// the first number of its answer. kRegister: a Modbus input or holding register. kSimulated: a
  /// sine of the rig's time.
  enum class Source { kFile, kAsk, kRegister, kSimulated } source = Source::kFile;
  std::filesystem::path path;            ///< kFile
  LineConfig line;                       ///< kAsk, kRegister
  double reply_timeout_s = 0.5;          ///< kAsk, kRegister
  std::string ask;                       ///< kAsk, without its CR
  Decimal decimal = Decimal::kUnstated;  ///< kFile, kAsk
  int register_at = 0;                   ///< kRegister: address on the wire
  int slave = 1;
  bool holding = false;                                ///< kRegister: function 3 instead of 4
  bool is_signed = false;                              ///< kRegister
  double mean = 0.0, amplitude = 0.0, period_s = 1.0;  ///< kSimulated
  double scale = 1.0, offset = 0.0;                    ///< value = scale * reading + offset

  /// Poses wait while the channel is outside: from when it leaves [lower, upper] until it has been
  /// inside [resume_lower, resume_upper] for `for_s`.
  struct Hold {
    double lower = 0.0, upper = 0.0;
    double resume_lower = 0.0, resume_upper = 0.0;
    double for_s = 0.0;
    double give_up_s = 0.0;  ///< the run ends after so long; 0 = never
  };
  std::optional<Hold> hold;
};

struct TelemetryConfig {
  double every_s = 10.0;
  std::vector<ChannelConfig> channels;
};

/// When is an image taken again in place?
struct InspectionConfig {
  int retakes = 2;           ///< of one image, at most
  double max_blur_px = 3.0;  ///< standard deviation of the blur
  double max_residual_mm{};  ///< of an LED from where the nominal camera would see it, a common
                             ///< offset apart
};

struct CalibrationSource {
  std::filesystem::path file;   ///< a finished calibration
  std::filesystem::path sweep;  ///< or the scenario that makes one
};

struct RigFile {
  std::string file;  ///< as named in messages
  std::string name;
  std::string title;
  std::vector<ControllerConfig> controllers;
  std::map<AxisId, AxisConfig> axes;
  CameraConfig camera;
  GimbalConfig gimbal;
  PatternConfig pattern;
  TargetConfig target;
  ToleranceConfig tolerances;
  CalibrationSource calibration;
  TelemetryConfig telemetry;
  InspectionConfig inspection;
  std::optional<SimulationConfig> simulation;
  std::string source;  ///< the text it was read from, for provenance

  const ControllerConfig& controller(const std::string& name) const;
  const AxisConfig& axis(AxisId id) const { return axes.at(id); }
  /// True if any device of the rig is simulated.
  bool simulated() const;
};

/// @throws ConfigError: schema, unknown stage or controller name, limits outside the stage's
/// travel, two axes on one channel, fewer than four or coplanar target points, direction circles
/// off the pattern, and the like.
RigFile load_rig_file(const std::filesystem::path& file);
/// The same from text (a frozen copy in a run folder). Relative paths are taken from `folder`.
RigFile parse_rig_file(const std::string& text, const std::string& name,
                       const std::filesystem::path& folder);

/// The section "pattern" of any file that has one, checked as a rig file's. `document` has passed its
/// schema. @throws ConfigError.
PatternConfig parse_pattern(const Json& document, const std::string& name);

}  // namespace turntable
