#include "src/campaign/planning.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <set>
#include <tuple>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/motion_time.h"
#include "src/core/random.h"
#include "src/geometry/gimbal.h"
#include "src/record/csv.h"

namespace turntable {
namespace {

/// Part of the image's width and height that has to stay free on each side.
constexpr double kFieldMargin = 0.03;
constexpr std::size_t kListedViolations = 10;

/// Digit of `counter` for each range, outermost first; snake order turns a range round each time
/// the one outside it moves on, so that neighbours differ by one step of one axis.
std::vector<std::size_t> digits_of(std::size_t counter, const std::vector<AxisRange>& ranges,
                                   PoseOrder order) {
  std::vector<std::size_t> digits(ranges.size());
  for (std::size_t k = ranges.size(); k-- > 0;) {
    const std::size_t n = ranges[k].values_deg.size();
    digits[k] = counter % n;
    counter /= n;
    if (order == PoseOrder::kSnake && counter % 2 == 1) digits[k] = n - 1 - digits[k];
  }
  return digits;
}

/// By axis: seconds from each of a range's values to each other one, the last place standing for
/// zero.
class MoveTimes {
 public:
  MoveTimes(const std::vector<AxisRange>& ranges, const RigFile& rig) {
    for (const AxisRange& range : ranges) {
      std::vector<double> values = range.values_deg;
      values.push_back(0.0);
      const AxisConfig& axis = rig.axis(range.axis);
      auto& table = seconds_.emplace_back(values.size(), std::vector<double>(values.size()));
      for (std::size_t i = 0; i < values.size(); ++i)
        for (std::size_t j = 0; j < values.size(); ++j)
          table[i][j] = move_seconds(axis, values[i], values[j]);
    }
  }
  /// All axes move at once.
  double between(const std::vector<std::size_t>& from, const std::vector<std::size_t>& to) const {
    double longest = 0.0;
    for (std::size_t k = 0; k < to.size(); ++k)
      longest = std::max(longest, seconds_[k][from[k]][to[k]]);
    return longest;
  }
  std::vector<std::size_t> zero() const {
    std::vector<std::size_t> digits;
    for (const auto& table : seconds_) digits.push_back(table.size() - 1);
    return digits;
  }

 private:
  std::vector<std::vector<std::vector<double>>> seconds_;
};

/// Digits of every visit of one repeat, in order.
std::vector<std::vector<std::size_t>> visits_of(const Scenario& scenario, int repeat,
                                                const RigFile& rig) {
  std::size_t count = 1;
  for (const AxisRange& range : scenario.ranges) count *= range.values_deg.size();
  std::vector<std::vector<std::size_t>> visits;
  visits.reserve(count);
  for (std::size_t i = 0; i < count; ++i)
    visits.push_back(digits_of(i, scenario.ranges, scenario.order));
  if (scenario.order == PoseOrder::kRandom) {
    Random random(scenario.order_seed, "order of " + scenario.name,
                  static_cast<std::uint64_t>(repeat));
    for (std::size_t left = count; left > 1; --left)  // Fisher & Yates
      std::swap(visits[left - 1],
                visits[static_cast<std::size_t>(random.uniform() * static_cast<double>(left))]);
  }
  if (scenario.order == PoseOrder::kNearest) {
    const MoveTimes times(scenario.ranges, rig);
    std::vector<std::size_t> at = times.zero();
    for (std::size_t next = 0; next < count; ++next) {
      // Of several equally near the first as written, so that the order is one.
      const auto nearest = std::min_element(visits.begin() + static_cast<std::ptrdiff_t>(next),
                                            visits.end(), [&](const auto& a, const auto& b) {
                                              return times.between(at, a) < times.between(at, b);
                                            });
      std::rotate(visits.begin() + static_cast<std::ptrdiff_t>(next), nearest, nearest + 1);
      at = visits[next];
    }
  }
  return visits;
}

double& angle_of(PlannedPose& pose, AxisId axis) {
  return axis == AxisId::kYaw    ? pose.yaw_deg
         : axis == AxisId::kRoll ? pose.roll_deg
                                 : pose.pitch_deg;
}

void add_attitude(Plan& plan, const Scenario& scenario, const RigFile& rig) {
  PlannedPose pose;
  pose.scenario = plan.scenarios.size();
  pose.payload = scenario.payload;
  pose.stage_mm = scenario.stage_mm;
  pose.dwell_s = scenario.dwell_s;
  pose.images = scenario.images_per_pose;
  std::vector<std::vector<std::size_t>> visits;
  for (pose.repeat = 1; pose.repeat <= scenario.repeats; ++pose.repeat) {
    PlannedPose reference = pose;
    reference.role = PoseRole::kReference;
    plan.poses.push_back(reference);
    // A random order alone is another one in every repeat; the nearest takes the square of its poses to find.
    if (visits.empty() || scenario.order == PoseOrder::kRandom)
      visits = visits_of(scenario, pose.repeat, rig);
    for (std::size_t i = 0; i < visits.size(); ++i) {
      for (std::size_t k = 0; k < scenario.ranges.size(); ++k)
        angle_of(pose, scenario.ranges[k].axis) = scenario.ranges[k].values_deg[visits[i][k]];
      ++pose.point;
      plan.poses.push_back(pose);
      const auto every = static_cast<std::size_t>(scenario.return_every);
      if (every == 0 || (i + 1) % every != 0 || i + 1 == visits.size()) continue;
      PlannedPose back = reference;
      back.role = PoseRole::kReturn;
      back.point = ++pose.point;
      plan.poses.push_back(back);
    }
    pose.yaw_deg = pose.roll_deg = pose.pitch_deg = 0.0;
    pose.point = 0;
  }
}

void add_calibration(Plan& plan, const Scenario& scenario) {
  PlannedPose pose;
  pose.scenario = plan.scenarios.size();
  pose.payload = scenario.payload;
  pose.dwell_s = scenario.dwell_s;
  pose.images = scenario.images_per_plane;
  for (pose.repeat = 1; pose.repeat <= scenario.repeats; ++pose.repeat) {
    pose.point = 0;
    for (const CalibrationPlane& plane : scenario.planes) {
      pose.role = plane.fit ? PoseRole::kPlaneFit : PoseRole::kPlaneCheck;
      pose.stage_mm = plane.stage_mm;
      plan.poses.push_back(pose);
      ++pose.point;
    }
  }
  pose.repeat = 1;
  pose.role = PoseRole::kPinholeView;
  pose.point = 0;
  pose.images = 1;
  for (const PinholeView& view : scenario.pinhole_views) {
    pose.stage_mm = view.stage_mm;
    pose.yaw_deg = view.yaw_deg;
    pose.roll_deg = view.roll_deg;
    pose.pitch_deg = view.pitch_deg;
    plan.poses.push_back(pose);
    ++pose.point;
  }
  if (!scenario.return_to_first_plane) return;
  const CalibrationPlane& first = scenario.planes.front();
  pose.role = first.fit ? PoseRole::kPlaneFit : PoseRole::kPlaneCheck;
  pose.stage_mm = first.stage_mm;
  pose.yaw_deg = pose.roll_deg = pose.pitch_deg = 0.0;
  pose.images = scenario.images_per_plane;
  pose.point = 0;
  pose.repeat = scenario.repeats;
  plan.poses.push_back(pose);
}

void add_scenario(Plan& plan, const Scenario& s, const RigFile& rig) {
  if (s.kind == ScenarioKind::kCalibration)
    add_calibration(plan, s);
  else
    add_attitude(plan, s, rig);
  ScenarioInfo info{s.name, s.title, s.file, s.kind, s.table, s.polynomial_order, s.repeats, {}};
  for (const AxisRange& range : s.ranges) info.axes.push_back(range.axis);
  plan.scenarios.push_back(std::move(info));
}

std::string named(const Plan& plan, const PlannedPose& pose) {
  return fmt::format("pose {} (scenario {}, stage {} mm, yaw {}, roll {}, pitch {} deg)",
                     pose.index, plan.scenario_of(pose).name, pose.stage_mm, pose.yaw_deg,
                     pose.roll_deg, pose.pitch_deg);
}

/// Pointer of the whole pose, where no single axis is to blame.
std::string pointer_of(const Plan& plan, const PlannedPose& pose) {
  if (plan.scenario_of(pose).kind == ScenarioKind::kAttitude)
    return pose.role == PoseRole::kMeasure ? "/ranges" : "/stage_mm";
  return fmt::format("{}/{}", pose.role == PoseRole::kPinholeView ? "/pinhole_views" : "/planes",
                     pose.point);
}

class Violations {
 public:
  void add(const std::string& file, const std::string& pointer, const std::string& what) {
    if (count_++ == 0) std::tie(file_, pointer_) = std::tie(file, pointer);
    if (count_ <= kListedViolations)
      text_ += fmt::format("\n  {} at {}: {}", file, pointer.empty() ? "/" : pointer, what);
  }
  void throw_if_any() const {
    if (count_ == 0) return;
    throw ConfigError(
        file_, pointer_,
        fmt::format(
            "the plan is refused, nothing has moved. {} violation{}{}:{}", count_,
            count_ == 1 ? "" : "s",
            count_ > kListedViolations ? fmt::format(", the first {}", kListedViolations) : "",
            text_));
  }

 private:
  std::size_t count_ = 0;
  std::string file_, pointer_, text_;
};

void check_limits(const Plan& plan, const RigFile& rig, Violations& violations) {
  struct Refusal {
    std::string place, what;
  };
  const auto refusal = [&rig](const AxisConfig& axis, double target) -> std::optional<Refusal> {
    const double turn = target - axis.backlash;
    std::optional<AxisBound> bound = axis.bound_against(target);
    const bool itself = bound.has_value();
    if (!itself) bound = axis.bound_against(turn);
    if (!bound) return {};
    const std::string overshoot =
        itself ? ""
               : fmt::format(" is approached from {} {} (one-sided approach)", turn, axis.unit());
    return Refusal{bound->place,
                   fmt::format("{} target {} {}{}, allowed: {} to {} {} ({}, {} at {})",
                               axis_name(axis.id), target, axis.unit(), overshoot, bound->lower,
                               bound->upper, axis.unit(), bound->what, rig.file, bound->place)};
  };
  std::set<AxisId> without_zero;
  for (const AxisId id : kAllAxes)
    if (const auto refused = refusal(rig.axis(id), 0.0)) {
      without_zero.insert(id);
      violations.add(
          rig.file, refused->place,
          refused->what + ". Axes return to zero for every change of the payload: widen it.");
    }
  // A grid repeats the same target many times.
  std::set<std::tuple<std::size_t, AxisId, double>> told;
  for (const PlannedPose& pose : plan.poses)
    for (const AxisId id : kAllAxes) {
      const double target = pose.target(id);
      if (target == 0.0 && without_zero.contains(id)) continue;
      const auto refused = refusal(rig.axis(id), target);
      if (refused && told.emplace(pose.scenario, id, target).second)
        violations.add(plan.scenario_of(pose).file, pointer_of(plan, pose, id),
                       fmt::format("{}, first at pose {}. Choose a target inside.", refused->what,
                                   pose.index));
    }
}

/// A disc that should be seen, mm from the gimbal centre at zero angles.
struct Mark {
  Vector3d at;
  double radius_mm;
};

Mark pattern_mark(const PatternConfig& p, int column, int row, double radius_mm) {
  return {p.offset_mm + p.spacing_mm * Vector3d(column, row, 0), radius_mm};
}

/// What has to be in view of the pattern: the direction circles, as the rest may be cut off; of a
/// pattern without them, which is found whole or not at all, the ends of its outer rows.
std::vector<Mark> marks_of(const PatternConfig& p) {
  std::vector<Mark> marks;
  for (const auto& [column, row] : p.direction_circles)
    marks.push_back(pattern_mark(p, column, row, p.direction_radius_mm));
  if (p.kind == PatternKind::kCircles) return marks;
  const bool shifted = p.kind == PatternKind::kAsymmetricCircles;
  const int step = shifted ? 2 : 1;
  for (int row = 0; row < p.rows; ++row) {
    // A shifted row may reach further than the outermost one.
    const bool outer = row < step || row >= p.rows - step;
    const int first = shifted ? row % 2 : 0;
    if (!outer) continue;
    for (const int column : {first, first + step * (p.columns - 1)})
      marks.push_back(pattern_mark(p, column - p.origin_column, row - p.origin_row, p.radius_mm));
  }
  return marks;
}

std::vector<Mark> marks_of(const TargetConfig& target) {
  std::vector<Mark> marks;
  for (const Vector3d& led : target.points_mm)
    marks.push_back({target.offset_mm + led, target.led_radius_mm});
  return marks;
}

std::string mark_name(const RigFile& rig, Payload payload, std::size_t i) {
  if (payload == Payload::kLedTarget) return fmt::format("LED {}", i);
  if (rig.pattern.kind != PatternKind::kCircles) return fmt::format("outer pattern point {}", i);
  const auto& [column, row] = rig.pattern.direction_circles[i];
  return fmt::format("direction circle ({}, {})", column, row);
}

/// What is wrong with where a point would be seen; empty = nothing.
std::string outside_image(const RigFile& rig, Payload payload, std::size_t i, const ImagePoint& p) {
  if (!p.visible())
    return fmt::format("{} would stand {:.4g} mm {} the camera", mark_name(rig, payload, i),
                       std::abs(p.depth_mm), p.depth_mm < 0 ? "above" : "below");
  const double width = rig.camera.image_size.width, height = rig.camera.image_size.height;
  const double u = std::min(p.u_px, width - 1 - p.u_px) - kFieldMargin * width;
  const double v = std::min(p.v_px, height - 1 - p.v_px) - kFieldMargin * height;
  if (std::min(u, v) >= p.radius_px) return {};
  return fmt::format(
      "{} would be seen at ({:.0f}, {:.0f}) px, allowed: {:.0f} px inside an image of {} x {} px",
      mark_name(rig, payload, i), p.u_px, p.v_px,
      p.radius_px + kFieldMargin * (u < v ? width : height), width, height);
}

/// Smallest distance of any predicted point's edge from the image's edge, px.
double check_field(const Plan& plan, const RigFile& rig, Violations& violations) {
  const double width = rig.camera.image_size.width, height = rig.camera.image_size.height;
  double margin = std::numeric_limits<double>::infinity();
  for (const PlannedPose& pose : plan.poses) {
    const std::vector<ImagePoint> points = predicted_points(pose, rig);
    std::string what;
    for (std::size_t i = 0; i < points.size() && what.empty(); ++i) {
      const ImagePoint& p = points[i];
      what = outside_image(rig, pose.payload, i, p);
      margin = std::min({margin, p.u_px - p.radius_px, width - 1 - p.u_px - p.radius_px,
                         p.v_px - p.radius_px, height - 1 - p.v_px - p.radius_px});
    }
    if (!what.empty())
      violations.add(plan.scenario_of(pose).file, pointer_of(plan, pose),
                     fmt::format("{}: {}. Use smaller angles or another stage position.",
                                 named(plan, pose), what));
  }
  return margin;
}

std::uintmax_t image_bytes(const RigFile& rig, Payload payload, ArchiveMode mode) {
  if (mode == ArchiveMode::kNone) return 0;
  const auto pixels = static_cast<std::uintmax_t>(rig.camera.image_size.width) *
                      static_cast<std::uintmax_t>(rig.camera.image_size.height);
  if (mode == ArchiveMode::kFull || payload == Payload::kCirclePattern) return pixels;
  constexpr std::uintmax_t kSpotPx = 2 * kRegionMarginPx + 20;
  return std::min(pixels, 4096 + rig.target.points_mm.size() * kSpotPx * kSpotPx);
}

void check_disk(const Plan& plan, const RigFile& rig, const CheckOptions& options,
                PlanReport& report) {
  constexpr std::uintmax_t kPoseBytes = 4096;  // its lines in plan and journal
  for (const PlannedPose& pose : plan.poses) {
    const auto images = static_cast<std::uintmax_t>(pose.images);
    report.images += static_cast<std::size_t>(pose.images);
    report.disk_bytes += kPoseBytes + images * image_bytes(rig, pose.payload, options.archive);
  }
  if (options.out.empty()) return;
  std::error_code error;
  std::filesystem::path folder = std::filesystem::absolute(options.out);
  while (!std::filesystem::exists(folder, error) && folder.has_relative_path())
    folder = folder.parent_path();
  const auto space = std::filesystem::space(folder, error);
  if (error) return;  // creating the run folder will say what is wrong with it
  report.free_bytes = space.available;
  if (report.disk_bytes > report.free_bytes)
    throw ConfigError(folder.string(), "",
                      fmt::format("the run needs up to {:.0f} MB, {:.0f} MB are free. Make room; a "
                                  "new run may also go to another "
                                  "--out, or archive images as regions.",
                                  static_cast<double>(report.disk_bytes) / 1e6,
                                  static_cast<double>(report.free_bytes) / 1e6));
}

void sweep(AxisSweep& out, const AxisConfig& axis, const Plan& plan) {
  out.limit_lower = axis.lower;
  out.limit_upper = axis.upper;
  out.cable_lower = axis.cable_lower;
  out.cable_upper = axis.cable_upper;
  out.target_lower = std::numeric_limits<double>::infinity();
  out.target_upper = -out.target_lower;
  if (axis.sent_step > axis.per_step()) out.sent_step = axis.sent_step;
  out.swept_lower = std::min(0.0, -axis.backlash);
  out.swept_upper = std::max(0.0, -axis.backlash);
  double from = 0.0;
  for (const PlannedPose& pose : plan.poses) {
    const double to = pose.target(axis.id);
    out.target_lower = std::min(out.target_lower, to);
    out.target_upper = std::max(out.target_upper, to);
    for (const double at : {to, takes_overshoot(axis, from, to) ? to - axis.backlash : to}) {
      out.swept_lower = std::min(out.swept_lower, at);
      out.swept_upper = std::max(out.swept_upper, at);
    }
    if (std::abs(to - axis.on_grid(to)) > 1e-6 * axis.per_step()) ++out.off_grid;
    from = to;
  }
}

/// The reference switch of a table is passed once in every turn.
void remark_turns(const RigFile& rig, PlanReport& report) {
  for (const AxisId id : kRotaryAxes) {
    const AxisConfig& axis = rig.axis(id);
    if (axis.reach_upper() - axis.reach_lower() < 360.0) continue;
    report.remarks.push_back(fmt::format(
        "{} may turn from {:g} to {:g} deg, a full turn or more, and homing cannot tell one turn "
        "from the next: look at its cable before homing, or narrow {}.",
        axis_name(id), axis.reach_lower(), axis.reach_upper(),
        axis.has_cable() ? "cable_deg" : "limits_deg, or state cable_deg"));
  }
}

std::string shown_time(double s) {
  const auto whole = static_cast<long>(std::lround(s));
  if (whole < 60) return fmt::format("{:.1f} s", s);
  if (whole < 3600) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
  return fmt::format("{} h {:02} min", whole / 3600, whole % 3600 / 60);
}

}  // namespace

double AxisSweep::margin() const {
  return std::min(swept_lower - std::max(limit_lower, cable_lower),
                  std::min(limit_upper, cable_upper) - swept_upper);
}

Plan plan_campaign(const Campaign& campaign, const RigFile& rig) {
  Plan plan;
  plan.name = campaign.name;
  plan.title = campaign.title;
  plan.rig = freeze(rig.file, rig.source);
  if (!campaign.text.empty()) plan.sources.push_back(freeze(campaign.file, campaign.text));
  double poses = 0;
  for (const Scenario& s : campaign.scenarios) poses += static_cast<double>(s.total_poses());
  if (poses > static_cast<double>(kMaxPoses))
    throw ConfigError(
        campaign.file, "/steps",
        fmt::format(
            "found {:.4g} poses in all, allowed: at most {}. Take fewer scenarios or repeats.",
            poses, kMaxPoses));
  plan.poses.reserve(static_cast<std::size_t>(poses));
  for (const Scenario& s : campaign.scenarios) {
    add_scenario(plan, s, rig);
    plan.sources.push_back(freeze(s.file, s.text));
  }
  for (const ControllerConfig& controller : rig.controllers) {
    const std::string& file = controller.description;
    const auto same = [&](const FrozenText& source) { return source.file == file; };
    if (file.ends_with(".json") && std::ranges::none_of(plan.sources, same))
      plan.sources.push_back(freeze(file, controller.description_text.empty()
                                              ? read_text(file)
                                              : controller.description_text));
  }
  number_poses(plan);
  return plan;
}

std::vector<ImagePoint> predicted_points(const PlannedPose& pose, const RigFile& rig) {
  const Gimbal gimbal(rig.gimbal);
  const Matrix3d R = gimbal.rotation(pose.angles());
  const Vector3d centre = gimbal.centre_mm(pose.stage_mm);
  const double focal = rig.camera.nominal_focal_px;
  std::vector<ImagePoint> points;
  for (const Mark& mark :
       pose.payload == Payload::kLedTarget ? marks_of(rig.target) : marks_of(rig.pattern)) {
    // Nominal pinhole straight above, looking down -z; v runs down the image, y up.
    const Vector3d p = centre + R * mark.at;
    ImagePoint& point = points.emplace_back();
    point.depth_mm = rig.camera.nominal_height_mm - p.z();
    if (point.depth_mm <= mark.radius_mm) continue;
    point.u_px = 0.5 * (rig.camera.image_size.width - 1) + focal * p.x() / point.depth_mm;
    point.v_px = 0.5 * (rig.camera.image_size.height - 1) - focal * p.y() / point.depth_mm;
    point.radius_px = focal * mark.radius_mm / point.depth_mm;
  }
  return points;
}

std::string pointer_of(const Plan& plan, const PlannedPose& pose, AxisId axis) {
  const ScenarioInfo& scenario = plan.scenario_of(pose);
  if (scenario.kind == ScenarioKind::kAttitude) {
    if (axis == AxisId::kStage) return "/stage_mm";
    const auto range = std::ranges::find(scenario.axes, axis);
    return range == scenario.axes.end() ? "/ranges"
                                        : fmt::format("/ranges/{}", range - scenario.axes.begin());
  }
  return fmt::format("{}/{}_{}", pointer_of(plan, pose), axis_name(axis), axis_unit(axis));
}

std::vector<OrderTime> order_times(const Campaign& campaign, const RigFile& rig) {
  std::vector<OrderTime> times;
  for (std::size_t i = 0; i < campaign.scenarios.size(); ++i) {
    if (campaign.scenarios[i].kind != ScenarioKind::kAttitude) continue;
    Scenario s = campaign.scenarios[i];
    const PoseOrder chosen = s.order;
    for (const PoseOrder order : kPoseOrders) {
      if (order == PoseOrder::kNearest && s.pose_count() > kMaxNearestPoses) continue;
      s.order = order;
      OrderTime time{i, order, order == chosen, 0.0};
      Plan alone;  // without ids: nobody looks them up
      add_scenario(alone, s, rig);
      for (const PhaseTimes& t : pose_times(alone, rig)) time.motion_s += t.motion_s;
      times.push_back(time);
    }
  }
  return times;
}

std::vector<PhaseTimes> pose_times(const Plan& plan, const RigFile& rig) {
  std::vector<std::size_t> all(plan.poses.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  return pose_times(plan, rig, all);
}

std::vector<PhaseTimes> pose_times(const Plan& plan, const RigFile& rig,
                                   const std::vector<std::size_t>& places) {
  std::vector<PhaseTimes> times;
  times.reserve(places.size());
  std::array<double, kAllAxes.size()> at{};
  Payload payload = places.empty() ? Payload::kLedTarget : plan.poses[places.front()].payload;
  const auto go = [&](PhaseTimes& time, const auto& target_of) {
    double motion = 0.0, settle = 0.0;
    int legs = 0;
    for (std::size_t i = 0; i < kAllAxes.size(); ++i) {
      const AxisConfig& axis = rig.axis(kAllAxes[i]);
      const double to = target_of(kAllAxes[i]);
      if (to == at[i]) continue;
      if (const double s = move_seconds(axis, at[i], to); s > motion) {
        motion = s;
        time.slowest = axis.id;
        legs = takes_overshoot(axis, at[i], to) ? 2 : 1;
      }
      settle = std::max(settle, axis.settle_s);
      at[i] = to;
    }
    time.legs += legs;
    time.motion_s += motion;
    time.settle_s += settle;
  };
  for (const std::size_t place : places) {
    const PlannedPose& pose = plan.poses[place];
    PhaseTimes time;
    if (pose.payload != payload) go(time, [](AxisId) { return 0.0; });
    payload = pose.payload;
    go(time, [&pose](AxisId id) { return pose.target(id); });
    time.settle_s += pose.dwell_s;
    time.trigger_s = (kFrameSeconds + rig.camera.answer_s()) * pose.images;
    times.push_back(time);
  }
  return times;
}

PlanReport check_plan(const Plan& plan, const RigFile& rig, const CheckOptions& options) {
  Violations violations;
  PlanReport report;
  check_limits(plan, rig, violations);
  report.field_margin_px = check_field(plan, rig, violations);
  violations.throw_if_any();
  check_disk(plan, rig, options, report);
  for (std::size_t i = 0; i < kAllAxes.size(); ++i)
    sweep(report.axes[i], rig.axis(kAllAxes[i]), plan);
  remark_turns(rig, report);
  for (const PhaseTimes& time : pose_times(plan, rig)) {
    report.time.motion_s += time.motion_s;
    report.time.settle_s += time.settle_s;
    report.time.trigger_s += time.trigger_s;
  }
  return report;
}

std::string plan_summary(const Plan& plan, const PlanReport& report) {
  std::string out =
      fmt::format("{}: {} poses, {} images\n", plan.title, plan.poses.size(), report.images);
  std::vector<std::size_t> counts(plan.scenarios.size());
  for (const PlannedPose& pose : plan.poses) ++counts[pose.scenario];
  for (std::size_t i = 0; i < plan.scenarios.size(); ++i) {
    const ScenarioInfo& s = plan.scenarios[i];
    out +=
        fmt::format("  {:<20} {:>6} poses, {} repeat{}{}\n", s.name, counts[i], s.repeats,
                    s.repeats == 1 ? "" : "s", s.table ? fmt::format(", table {}", *s.table) : "");
  }
  const bool cables = std::ranges::any_of(
      report.axes, [](const AxisSweep& a) { return std::isfinite(a.cable_lower); });
  out += fmt::format("\n  {:<6} {:>20} {:>24} {:>20}{} {:>10}\n", "axis", "targets",
                     "swept with overshoot", "soft limits",
                     cables ? fmt::format(" {:>20}", "cable free") : "", "margin");
  for (std::size_t i = 0; i < kAllAxes.size(); ++i) {
    const AxisSweep& a = report.axes[i];
    const auto unit = axis_unit(kAllAxes[i]);
    const std::string cable =
        !cables ? ""
        : std::isfinite(a.cable_lower)
            ? fmt::format(" {:>8.3f} .. {:>8.3f}", a.cable_lower, a.cable_upper)
            : fmt::format(" {:>20}", "-");
    out += fmt::format(
        "  {:<6} {:>8.3f} .. {:>8.3f} {:>12.3f} .. {:>8.3f} {:>8.3f} .. {:>8.3f}{} {:>6.3f} {}\n",
        axis_name(kAllAxes[i]), a.target_lower, a.target_upper, a.swept_lower, a.swept_upper,
        a.limit_lower, a.limit_upper, cable, a.margin(), unit);
    if (a.off_grid > 0)
      out += fmt::format(
          "         {} poses of {} lie between two pulses{}; the nearest {} is taken\n", a.off_grid,
          axis_name(kAllAxes[i]),
          a.sent_step > 0
              ? fmt::format(", or off the steps of {:g} {} that the controller can be sent to",
                            a.sent_step, unit)
              : "",
          a.sent_step > 0 ? "pulse that can be reached" : "pulse");
  }
  out += fmt::format(
      "\n  field of view: every point stays {:.0f} px or more inside the image (nominal camera)\n",
      report.field_margin_px);
  out += fmt::format("  time: {} = motion {} + settling {} + exposures {} (homing apart)\n",
                     shown_time(report.time.total_s()), shown_time(report.time.motion_s),
                     shown_time(report.time.settle_s), shown_time(report.time.trigger_s));
  out += fmt::format("  disk: up to {:.1f} MB", static_cast<double>(report.disk_bytes) / 1e6);
  if (report.free_bytes > 0)
    out += fmt::format(" of {:.0f} MB free", static_cast<double>(report.free_bytes) / 1e6);
  out += "\n";
  for (const std::string& remark : report.remarks) out += fmt::format("  remark: {}\n", remark);
  return out;
}

void write_plan_csv(const Plan& plan, const RigFile& rig, const std::filesystem::path& file) {
  Csv csv({"index",    "id",        "scenario", "role",      "payload",  "repeat",   "point",
           "stage_mm", "yaw_deg",   "roll_deg", "pitch_deg", "dwell_s",  "images",   "motion_s",
           "settle_s", "trigger_s", "time_s",   "u_min_px",  "u_max_px", "v_min_px", "v_max_px"});
  const std::vector<PhaseTimes> times = pose_times(plan, rig);
  double time_s = 0.0;
  for (const PlannedPose& p : plan.poses) {
    csv.integer(static_cast<std::int64_t>(p.index)).text(p.id).text(plan.scenario_of(p).name);
    csv.text(role_name(p.role)).text(payload_name(p.payload)).integer(p.repeat).integer(p.point);
    csv.number(p.stage_mm, 4).number(p.yaw_deg, 4).number(p.roll_deg, 4).number(p.pitch_deg, 4);
    csv.number(p.dwell_s, 3).integer(p.images);
    const PhaseTimes& t = times[static_cast<std::size_t>(&p - plan.poses.data())];
    time_s += t.total_s();
    csv.number(t.motion_s, 3).number(t.settle_s, 3).number(t.trigger_s, 3).number(time_s, 3);
    // Of the discs, not of their centres: nothing the pose should show lies outside.
    double u_min = std::numeric_limits<double>::infinity(), u_max = -u_min;
    double v_min = u_min, v_max = -u_min;
    for (const ImagePoint& seen : predicted_points(p, rig)) {
      u_min = std::min(u_min, seen.u_px - seen.radius_px);
      u_max = std::max(u_max, seen.u_px + seen.radius_px);
      v_min = std::min(v_min, seen.v_px - seen.radius_px);
      v_max = std::max(v_max, seen.v_px + seen.radius_px);
    }
    csv.number(u_min, 2).number(u_max, 2).number(v_min, 2).number(v_max, 2);
    csv.end_row();
  }
  csv.write(file);
}

}  // namespace turntable
