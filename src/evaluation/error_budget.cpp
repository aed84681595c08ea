#include "src/evaluation/error_budget.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "src/core/parallel.h"
#include "src/core/units.h"
#include "src/evaluation/attitude_sensor.h"

namespace turntable {
namespace {

using AxisErrors = Eigen::Array3d;  ///< by `kToldAxes`, deg

constexpr std::size_t place_of(Cause cause) { return static_cast<std::size_t>(cause); }

Cause cause_of(ParameterGroup group) {
  switch (group) {
    case ParameterGroup::kMounting:
      return Cause::kAlignment;
    case ParameterGroup::kTargetMounting:
      return Cause::kTargetMounting;
    case ParameterGroup::kOffset:
    case ParameterGroup::kCentre:
      return Cause::kPlace;
    case ParameterGroup::kAxes:
      return Cause::kAxes;
    case ParameterGroup::kStage:
      return Cause::kStage;
    case ParameterGroup::kTarget:
      return Cause::kTarget;
  }
  return Cause::kTarget;
}

/// An image of the target that a drawn rig would give, and how it moves.
struct Image0 {
  TablePosition at;
  ArrivalNumbers arrivals{};
  Matrix3d R_gimbal;  ///< as published
  std::vector<Vector2d> points_px;
  std::vector<Eigen::Matrix2d> px_per_mm;            ///< of a miss in the plane at the LED's height
  Eigen::MatrixXd by_value;                          ///< 2 n x values, px per unit
  Eigen::Matrix<double, Eigen::Dynamic, 4> by_axis;  ///< 2 n x kAllAxes, px per mm, per deg
  std::vector<Eigen::Matrix2d> covariances_px2;      ///< of the spots; empty if not stated

  Eigen::Matrix2d covariance_px2(std::size_t led) const {
    if (!covariances_px2.empty()) return covariances_px2[led];
    return kAssumedSpotSigmaPx * kAssumedSpotSigmaPx * Eigen::Matrix2d::Identity();
  }
};

/// Everything that is the same for all poses.
struct Bench {
  const BudgetInput& in;
  Gimbal gimbal;
  Eigen::VectorXd drawing, prior_sd;
  std::array<double, kAllAxes.size()> pulse;  ///< unit of the axis
};

/// Image points of the LEDs by Newton's method with the Jacobian of the start: they are shifted by
/// pixels, over which a lens hardly bends.
void move_to(const IrtModel& irt, const Eigen::VectorXd& leds_mm,
             std::span<const Eigen::Matrix2d> px_per_mm, std::span<Vector2d> points_px) {
  for (int step = 0; step < 3; ++step)
    for (std::size_t i = 0; i < points_px.size(); ++i) {
      const Vector3d led = leds_mm.segment<3>(3 * static_cast<Eigen::Index>(i));
      points_px[i] +=
          px_per_mm[i] * (led.head<2>() - irt.ray(points_px[i]).at(led.z(), irt.planes()));
    }
}

Eigen::Matrix2d px_per_mm(const IrtModel& irt, const Vector2d& px, double z_mm) {
  Eigen::Matrix2d J;
  for (int c = 0; c < 2; ++c) {
    const Vector2d h = 0.5 * Vector2d::Unit(c);
    J.col(c) = irt.ray(px + h).at(z_mm, irt.planes()) - irt.ray(px - h).at(z_mm, irt.planes());
  }
  return J.inverse();
}

Image0 drawn_image(const Bench& b, const EvaluatedPose& pose, const ArrivalNumbers& arrivals) {
  const IrtModel& irt = b.in.calibration.irt;
  Image0 out;
  out.at.stage_mm = pose.stage_mm;
  out.at.angles = {rad_from_deg(pose.read_back_deg.yaw), rad_from_deg(pose.read_back_deg.roll),
                   rad_from_deg(pose.read_back_deg.pitch)};
  out.arrivals = arrivals;
  out.R_gimbal = b.gimbal.rotation(out.at.angles);
  RigModel::Derivatives d;
  const Eigen::VectorXd leds = b.in.model.leds(b.drawing, out.at, &d);
  out.points_px = pose.points_px;
  out.covariances_px2 = pose.covariances_px2;
  const std::size_t n = out.points_px.size();
  for (int pass = 0; pass < 2; ++pass) {  // the second with the Jacobian where the first ended
    out.px_per_mm.clear();
    for (std::size_t i = 0; i < n; ++i)
      out.px_per_mm.push_back(
          px_per_mm(irt, out.points_px[i], leds(3 * static_cast<Eigen::Index>(i) + 2)));
    move_to(irt, leds, out.px_per_mm, out.points_px);
  }
  out.by_value.resize(2 * static_cast<Eigen::Index>(n), b.in.model.size());
  out.by_axis.resize(2 * static_cast<Eigen::Index>(n), 4);
  for (std::size_t i = 0; i < n; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    Eigen::Matrix<double, 2, 3> miss;  // in the plane, of a move of the LED
    miss << Eigen::Matrix2d::Identity(), -irt.ray(out.points_px[i]).slope(irt.planes());
    const Eigen::Matrix<double, 2, 3> px = out.px_per_mm[i] * miss;
    out.by_value.middleRows<2>(2 * k) = px * d.by_value.middleRows<3>(3 * k);
    out.by_axis.middleRows<2>(2 * k) = px * d.by_axis.middleRows<3>(3 * k);
  }
  return out;
}

/// A solver that jumps from one answer to another between neighbouring image points has no derivative.
constexpr double kMaxBend = 0.2;

/// What one pose adds to the lines of one solver. Squares are of axis errors, deg^2.
struct PoseShare {
  bool measured = false, counts = false;
  AxisErrors camera, observed;
  Eigen::Array3Xd by_value;                             ///< e_k(j), a column per value
  AxisErrors spots, rays, repeatability, quantisation;  ///< mean squares
  AxisErrors found;
};

class OneSolver {
 public:
  OneSolver(const Bench& bench, const TargetModel& target, const Solver& solver, std::size_t place)
      : bench_(bench), sensor_(bench.in.calibration, target, solver), place_(place) {}

  const Solver& solver() const { return sensor_.solver(); }

  std::optional<Matrix3d> attitude(std::span<const Vector2d> points_px, const Image0& image) const {
    const MeasuredAttitude m = sensor_.measure(points_px, image.covariances_px2);
    if (!m.has_attitude()) return {};
    return m.R_plane_from_target;
  }

  AxisErrors error(const Matrix3d& R, const Matrix3d& R_initial, const Image0& image,
                   const Image0& initial) const {
    const PoseError e = pose_error(bench_.gimbal, relative_attitude(R, R_initial),
                                   relative_attitude(image.R_gimbal, initial.R_gimbal));
    return {e.pitch_deg, e.roll_deg, e.yaw_deg};
  }

  PoseShare share(const EvaluatedPose& pose, const Image0& image, const Image0& initial,
                  const std::vector<Vector2d>& found_px,
                  const std::vector<Vector2d>& found_initial_px) const;

 private:
  /// d error / d image points, 3 x 2 n: of the pose, or of its initial pose.
  std::optional<Eigen::Matrix3Xd> derivative(const Image0& image, const Image0& initial,
                                             const Matrix3d& R, const Matrix3d& R_initial,
                                             bool of_initial) const {
    constexpr double kStepPx = 0.1;
    const Image0& moved = of_initial ? initial : image;
    const AxisErrors here = error(R, R_initial, image, initial);
    Eigen::Matrix3Xd A(3, 2 * static_cast<Eigen::Index>(moved.points_px.size()));
    std::vector<Vector2d> points = moved.points_px;
    double slope = 0.0, bend = 0.0;
    for (Eigen::Index c = 0; c < A.cols(); ++c) {
      double& coordinate = points[static_cast<std::size_t>(c / 2)](c % 2);
      const double at = coordinate;
      std::array<AxisErrors, 2> e;
      for (int side = 0; side < 2; ++side) {
        coordinate = at + (side == 0 ? -kStepPx : kStepPx);
        const auto R_moved = attitude(points, moved);
        if (!R_moved) return {};
        e[static_cast<std::size_t>(side)] = of_initial ? error(R, *R_moved, image, initial)
                                                       : error(*R_moved, R_initial, image, initial);
      }
      coordinate = at;
      A.col(c) = (e[1] - e[0]) / (2.0 * kStepPx);
      slope = std::max(slope, (e[1] - e[0]).matrix().norm());
      bend = std::max(bend, (e[1] + e[0] - 2.0 * here).matrix().norm());
    }
    if (bend > kMaxBend * slope) return {};
    return A;
  }

  const Bench& bench_;
  AttitudeSensor sensor_;
  std::size_t place_;  ///< in the evaluation's solvers
};

AxisErrors spot_squares(const Eigen::Matrix3Xd& A, const Image0& image) {
  AxisErrors out = AxisErrors::Zero();
  for (std::size_t i = 0; i < image.points_px.size(); ++i) {
    const Eigen::Matrix2d C = image.covariance_px2(i);
    const auto block = A.middleCols<2>(2 * static_cast<Eigen::Index>(i));
    out += (block * C * block.transpose()).diagonal().array();
  }
  return out;
}

/// Both images are looked at through the same rays, whose errors are alike where the rays are near.
AxisErrors ray_squares(const Bench& b, const Eigen::Matrix3Xd& A, const Eigen::Matrix3Xd& A_initial,
                       const Image0& image, const Image0& initial) {
  const IrtModel& irt = b.in.calibration.irt;
  std::vector<Vector2d> points = image.points_px;
  points.insert(points.end(), initial.points_px.begin(), initial.points_px.end());
  const auto n = static_cast<Eigen::Index>(points.size());
  const Eigen::MatrixXd joint = irt.joint_ray_covariance(points);  // on a, then on b
  const auto heights = [&](const Image0& at) { return b.in.model.leds(b.drawing, at.at); };
  const Eigen::VectorXd here = heights(image), there = heights(initial);
  Eigen::MatrixXd at_height(n, 2 * n);
  at_height.setZero();
  Eigen::Matrix3Xd G(3, 2 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const bool first = i < n / 2;
    const Eigen::Index own = first ? i : i - n / 2;
    const double z = (first ? here : there)(3 * own + 2);
    const double share = (z - irt.planes().a_mm) / (irt.planes().b_mm - irt.planes().a_mm);
    at_height(i, i) = 1.0 - share;
    at_height(i, n + i) = share;
    // A ray that is too far right by 1 mm is an image point that is too far left.
    G.middleCols<2>(2 * i) = (first ? A : A_initial).middleCols<2>(2 * own) *
                             (first ? image : initial).px_per_mm[static_cast<std::size_t>(own)];
  }
  const Eigen::MatrixXd M = at_height * joint * at_height.transpose();
  AxisErrors out = AxisErrors::Zero();
  for (int coordinate = 0; coordinate < 2; ++coordinate) {
    Eigen::Matrix3Xd one(3, n);
    for (Eigen::Index i = 0; i < n; ++i) one.col(i) = G.col(2 * i + coordinate);
    out += (one * M * one.transpose()).diagonal().array();
  }
  return out;
}

PoseShare OneSolver::share(const EvaluatedPose& pose, const Image0& image, const Image0& initial,
                           const std::vector<Vector2d>& found_px,
                           const std::vector<Vector2d>& found_initial_px) const {
  PoseShare out;
  const PoseResult& result = pose.results[place_];
  if (!result.measured) return out;
  out.measured = true;
  const auto R = attitude(image.points_px, image);
  const auto R_initial = attitude(initial.points_px, initial);
  if (!R || !R_initial) return out;
  const auto A = derivative(image, initial, *R, *R_initial, false);
  const auto A_initial = derivative(image, initial, *R, *R_initial, true);
  if (!A || !A_initial) return out;
  out.observed = {result.error.pitch_deg, result.error.roll_deg, result.error.yaw_deg};
  out.camera = error(*R, *R_initial, image, initial);
  out.by_value = (*A * image.by_value + *A_initial * initial.by_value).array();
  out.spots = spot_squares(*A, image) + spot_squares(*A_initial, initial);
  out.rays = sensor_.solver().sight == Sight::kRays && sensor_.states_rays()
                 ? ray_squares(bench_, *A, *A_initial, image, initial)
                 : AxisErrors::Zero();
  out.repeatability = out.quantisation = AxisErrors::Zero();
  const Eigen::Matrix<double, 3, 4> by_axis = *A * image.by_axis;
  const Eigen::Matrix<double, 3, 4> by_initial_axis = *A_initial * initial.by_axis;
  for (std::size_t a = 0; a < kAllAxes.size(); ++a) {
    if (image.arrivals[a] == initial.arrivals[a]) continue;  // has not moved: the same error
    const auto c = static_cast<Eigen::Index>(a);
    const AxisErrors both =
        by_axis.col(c).array().square() + by_initial_axis.col(c).array().square();
    out.repeatability += both * std::pow(bench_.in.model.arrival_sd()[a], 2);
    out.quantisation += both * std::pow(bench_.pulse[a], 2) / 12.0;  // even over a pulse
  }
  if (!found_px.empty()) {
    const auto R_found = attitude(found_px, image);
    const auto R_found_initial = attitude(found_initial_px, initial);
    if (!R_found || !R_found_initial) return out;
    out.found = error(*R_found, *R_found_initial, image, initial);
  }
  out.counts = true;
  return out;
}

Contribution contribution(const AxisErrors& mean_squares) {
  Contribution out;
  for (std::size_t a = 0; a < 3; ++a)
    out.axis_deg[a] = std::sqrt(std::max(0.0, mean_squares(static_cast<Eigen::Index>(a))));
  return out;
}

/// A scenario's measured poses that can be asked, each with the initial pose of its repeat.
struct Member {
  std::size_t pose, initial;  ///< places in Evaluation::poses
};

/// The values of one drawn rig and the errors of its arrivals.
struct DrawnRig {
  Eigen::VectorXd values;
  std::uint64_t number;
  double arrival(std::size_t axis, int arrival_number) const {
    return draw("arrival", axis, arrival_number).normal();
  }
  /// Where in its pulse the axis stands, in [-0.5, 0.5).
  double within_pulse(std::size_t axis, int arrival_number) const {
    return draw("pulse", axis, arrival_number).uniform(-0.5, 0.5);
  }

 private:
  Random draw(std::string_view what, std::size_t axis, int arrival_number) const {
    return Random(
        number, what,
        static_cast<std::uint64_t>(axis) << 32 | static_cast<std::uint32_t>(arrival_number));
  }
};

std::string amount(const Tolerance& tolerance, std::string_view unit) {
  if (unit == "1") return fmt::format("{:g} ({})", tolerance.sd, tolerance.source);
  return fmt::format("{:g} {} ({})", tolerance.sd, unit, tolerance.source);
}

/// "0.1 mm (default)", of every tolerance once; what is known of the noise.
std::array<std::string, kCauses> amounts_of(const BudgetInput& in,
                                            const std::vector<Image0>& images) {
  std::array<std::string, kCauses> out;
  const auto add = [](std::string& text, std::string_view separator, const std::string& one) {
    if (text.find(one) == std::string::npos)
      text += (text.empty() ? "" : std::string(separator)) + one;
  };
  for (const RigParameter& p : in.model.parameters())
    add(out[place_of(cause_of(p.group))], "; ", amount(p.prior, p.unit));
  out[place_of(Cause::kCamera)] = "image points of a rig as drawn, without noise";
  std::vector<double> sigmas;
  for (const Image0& image : images)
    for (const Eigen::Matrix2d& C : image.covariances_px2)
      sigmas.push_back(std::sqrt(0.5 * C.trace()));
  out[place_of(Cause::kSpots)] =
      sigmas.empty()
          ? fmt::format("{:g} px (assumed)", kAssumedSpotSigmaPx)
          : fmt::format("{:.4f} px in the median (stated by the spots)", percentile(sigmas, 0.5));
  out[place_of(Cause::kRays)] =
      in.calibration.irt.covariance().size() > 0
          ? fmt::format("covariance of the calibration, {} points of {:.4f} mm",
                        in.calibration.points, in.calibration.sigma_mm)
          : "not stated by the calibration";
  bool one_sided = true;
  for (const AxisId axis : kToldAxes) {
    const AxisConfig& a = in.rig.axis(axis);
    add(out[place_of(Cause::kRepeatability)], ", ",
        fmt::format("{} {:g} deg", axis_name(axis), 0.5 * a.repeatability));
    add(out[place_of(Cause::kQuantisation)], ", ",
        fmt::format("{} {:g} deg", axis_name(axis), a.per_step()));
    one_sided = one_sided && a.backlash != 0.0;
  }
  out[place_of(Cause::kRepeatability)] += " (rig file, one standard deviation)";
  out[place_of(Cause::kQuantisation)] += " a pulse, even over it";
  out[place_of(Cause::kBacklash)] =
      one_sided ? "none: every axis is approached from one side, with overshoot"
                : "stated nowhere, and not every axis has an overshoot";
  return out;
}

/// Image points of a drawn rig: its values, the errors of its arrivals, noise.
std::vector<Vector2d> seen_by(const Bench& bench, const DrawnRig& rig, const Image0& image,
                              Random& noise) {
  TablePosition at = image.at;
  for (std::size_t a = 0; a < kAllAxes.size(); ++a) {
    const double e = bench.in.model.arrival_sd()[a] * rig.arrival(a, image.arrivals[a]) +
                     bench.pulse[a] * rig.within_pulse(a, image.arrivals[a]);
    if (kAllAxes[a] == AxisId::kStage)
      at.stage_mm += e;
    else
      at.angles[kAllAxes[a]] += rad_from_deg(e);
  }
  std::vector<Vector2d> points = image.points_px;
  move_to(bench.in.calibration.irt, bench.in.model.leds(rig.values, at), image.px_per_mm, points);
  for (std::size_t i = 0; i < points.size(); ++i)
    points[i] += image.covariance_px2(i).llt().matrixL() * Vector2d(noise.normal(), noise.normal());
  return points;
}

/// Total RMSE of one drawn rig by every solver, all on the same images; NaN of one that measured none.
/// Takes every `stride`-th pose.
Eigen::ArrayXd total_of_drawn_rig(const Bench& bench, const std::vector<OneSolver>& solvers,
                                  const std::vector<Image0>& images,
                                  const std::vector<Member>& members, std::size_t stride,
                                  std::uint64_t draw) {
  Random random(1, "drawn rig", draw);
  DrawnRig rig{bench.drawing, 1 + draw};
  for (Eigen::Index j = 0; j < rig.values.size(); ++j)
    rig.values(j) += bench.prior_sd(j) * random.normal();
  std::map<std::size_t, std::vector<Vector2d>> initial_px;
  Eigen::ArrayXd squares = Eigen::ArrayXd::Zero(static_cast<Eigen::Index>(solvers.size()));
  Eigen::ArrayXd counts = squares;
  for (std::size_t m = 0; m < members.size(); m += stride) {
    const Image0 &image = images[members[m].pose], &initial = images[members[m].initial];
    std::vector<Vector2d>& at_start = initial_px[members[m].initial];
    if (at_start.empty()) at_start = seen_by(bench, rig, initial, random);
    const std::vector<Vector2d> points = seen_by(bench, rig, image, random);
    for (std::size_t k = 0; k < solvers.size(); ++k) {
      const auto R = solvers[k].attitude(points, image);
      const auto R_initial = solvers[k].attitude(at_start, initial);
      if (!R || !R_initial) continue;
      const auto s = static_cast<Eigen::Index>(k);
      squares(s) += solvers[k].error(*R, *R_initial, image, initial).square().sum();
      counts(s) += 1.0;
    }
  }
  return (squares / counts).sqrt();
}

/// The lines of one solver from what its poses add to them.
ErrorBudget sum_of(const std::vector<PoseShare>& shares, const Bench& bench,
                   const std::array<std::string, kCauses>& amounts,
                   const std::array<double, 3>& backlash_deg) {
  const std::vector<RigParameter>& parameters = bench.in.model.parameters();
  const auto P = static_cast<Eigen::Index>(parameters.size());
  const auto line_of = [&](Eigen::Index j) {
    return place_of(cause_of(parameters[static_cast<std::size_t>(j)].group));
  };
  ErrorBudget budget;
  Eigen::Array3Xd value_squares = Eigen::Array3Xd::Zero(3, P);
  std::array<AxisErrors, kCauses> drawn, found;
  drawn.fill(AxisErrors::Zero());
  found.fill(AxisErrors::Zero());
  AxisErrors found_all = AxisErrors::Zero(), observed = AxisErrors::Zero();
  for (const PoseShare& s : shares) {
    budget.left_out += s.measured && !s.counts;
    if (!s.counts) continue;
    ++budget.poses;
    observed += s.observed.square();
    value_squares += s.by_value.square();
    drawn[place_of(Cause::kCamera)] += s.camera.square();
    drawn[place_of(Cause::kSpots)] += s.spots;
    drawn[place_of(Cause::kRays)] += s.rays;
    drawn[place_of(Cause::kRepeatability)] += s.repeatability;
    drawn[place_of(Cause::kQuantisation)] += s.quantisation;
    if (!bench.in.values) continue;
    found_all += s.found.square();
    std::array<AxisErrors, kCauses> effects;
    effects.fill(AxisErrors::Zero());
    for (Eigen::Index j = 0; j < P; ++j)
      effects[line_of(j)] += ((*bench.in.values)(j)-bench.drawing(j)) * s.by_value.col(j);
    for (std::size_t c = 0; c < kCauses; ++c) found[c] += effects[c].square();
  }
  if (budget.poses == 0) return budget;
  const double n = static_cast<double>(budget.poses);
  for (Eigen::Index j = 0; j < P; ++j)
    drawn[line_of(j)] += value_squares.col(j) * std::pow(bench.prior_sd(j), 2);
  constexpr std::array kNoise{Cause::kSpots, Cause::kRays, Cause::kRepeatability,
                              Cause::kQuantisation};
  found[place_of(Cause::kCamera)] = drawn[place_of(Cause::kCamera)];
  for (const Cause noise : kNoise) found[place_of(noise)] = drawn[place_of(noise)];
  for (std::size_t a = 0; a < 3; ++a)
    found[place_of(Cause::kBacklash)](static_cast<Eigen::Index>(a)) =
        n * std::pow(backlash_deg[a], 2);

  AxisErrors sum_drawn = AxisErrors::Zero();
  for (std::size_t c = 0; c < kCauses; ++c) {
    BudgetLine line{static_cast<Cause>(c), amounts[c], contribution(drawn[c] / n), {}};
    if (bench.in.values) line.found = contribution(found[c] / n);
    sum_drawn += drawn[c] / n;
    budget.lines.push_back(std::move(line));
  }
  budget.drawn = contribution(sum_drawn);
  budget.observed = contribution(observed / n);
  if (bench.in.values) {
    // The camera's line is in what all values make together.
    AxisErrors all = found_all + found[place_of(Cause::kBacklash)];
    for (const Cause noise : kNoise) all += found[place_of(noise)];
    budget.found = contribution(all / n);
  }
  return budget;
}

}  // namespace

std::string_view cause_name(Cause cause) {
  switch (cause) {
    case Cause::kCamera:
      return "camera model and solver";
    case Cause::kSpots:
      return "noise of the image points";
    case Cause::kRays:
      return "uncertainty of the rays";
    case Cause::kTarget:
      return "target geometry";
    case Cause::kTargetMounting:
      return "target turned on its table";
    case Cause::kAlignment:
      return "alignment of gimbal and plane frame";
    case Cause::kAxes:
      return "angles between the axes";
    case Cause::kStage:
      return "squareness and scale of the stage";
    case Cause::kPlace:
      return "place of the target";
    case Cause::kRepeatability:
      return "repeatability of the axes";
    case Cause::kBacklash:
      return "backlash";
    case Cause::kQuantisation:
      return "quantisation (pulses)";
  }
  return "";
}

double Contribution::total_deg() const { return total_rmse(axis_deg[0], axis_deg[1], axis_deg[2]); }

std::vector<ErrorBudget> error_budgets(const BudgetInput& input) {
  const Evaluation& evaluation = input.evaluation;
  const std::vector<std::optional<std::size_t>> initial = initial_poses(evaluation);
  std::map<std::size_t, std::vector<Member>> scenarios;
  for (std::size_t i = 0; i < evaluation.poses.size(); ++i) {
    const EvaluatedPose& p = evaluation.poses[i];
    if (p.planned.role == PoseRole::kMeasure && !p.points_px.empty() && initial[i] &&
        !evaluation.poses[*initial[i]].points_px.empty())
      scenarios[p.planned.scenario].push_back({i, *initial[i]});
  }

  Bench bench{input, Gimbal(input.rig.gimbal), input.model.drawing(), input.model.prior_sd(), {}};
  for (std::size_t a = 0; a < kAllAxes.size(); ++a)
    bench.pulse[a] = input.rig.axis(kAllAxes[a]).per_step();
  const std::vector<ArrivalNumbers> arrivals = arrival_numbers(input.record);
  std::vector<Image0> images(evaluation.poses.size());
  std::vector<std::vector<Vector2d>> found_px(evaluation.poses.size());
  parallel_for(images.size(), [&](std::size_t i) {
    const EvaluatedPose& pose = evaluation.poses[i];
    if (pose.points_px.empty()) return;
    images[i] = drawn_image(bench, pose, arrivals[pose.planned.index]);
    if (!input.values) return;
    found_px[i] = images[i].points_px;
    move_to(input.calibration.irt, input.model.leds(*input.values, images[i].at),
            images[i].px_per_mm, found_px[i]);
  });
  const std::array<std::string, kCauses> amounts = amounts_of(input, images);

  // Every pose is solved dozens of times: rows that are there to be compared with are not worth that,
  // unless nothing else was asked for.
  const TargetModel target(input.rig.target.points_mm);
  const bool has_default = std::ranges::any_of(evaluation.solvers, &Solver::by_default);
  std::vector<OneSolver> solvers;
  for (std::size_t k = 0; k < evaluation.solvers.size(); ++k)
    if (!has_default || evaluation.solvers[k]->by_default)
      solvers.emplace_back(bench, target, *evaluation.solvers[k], k);

  std::vector<ErrorBudget> out;
  std::size_t done = 0;
  const auto tell = [&] {
    if (input.progress) input.progress(++done, scenarios.size() * (1 + solvers.size()));
  };
  for (const auto& [scenario, members] : scenarios) {
    const std::size_t stride = (members.size() + kBudgetPoses - 1) / kBudgetPoses;
    std::vector<Eigen::ArrayXd> totals(kBudgetDraws);
    parallel_for(kBudgetDraws, [&](std::size_t draw) {
      totals[draw] = total_of_drawn_rig(bench, solvers, images, members, stride, draw);
    });
    tell();
    const auto direction = input.backlash_deg.find(scenario);
    const std::array<double, 3> backlash =
        direction == input.backlash_deg.end() ? std::array<double, 3>{} : direction->second;
    for (std::size_t k = 0; k < solvers.size(); ++k) {
      std::vector<PoseShare> shares(members.size());
      parallel_for(members.size(), [&](std::size_t m) {
        const auto& [pose, at_start] = members[m];
        shares[m] = solvers[k].share(evaluation.poses[pose], images[pose], images[at_start],
                                     found_px[pose], found_px[at_start]);
      });
      tell();
      ErrorBudget budget = sum_of(shares, bench, amounts, backlash);
      if (budget.poses == 0) continue;
      budget.scenario = scenario;
      budget.solver = &solvers[k].solver();
      std::vector<double> of_rigs;
      for (const Eigen::ArrayXd& total : totals)
        if (const double t = total(static_cast<Eigen::Index>(k)); std::isfinite(t))
          of_rigs.push_back(t);
      budget.monte_carlo_deg = {root_mean_square(of_rigs),
                                {percentile(of_rigs, 0.025), percentile(of_rigs, 0.975)}};
      out.push_back(std::move(budget));
    }
  }
  return out;
}

std::map<std::size_t, std::array<double, 3>> backlash_found(const Evaluation& evaluation,
                                                            const CrossValidation& judged) {
  const auto& errors = judged.errors[static_cast<std::size_t>(TruthLevel::kSelfCalibrated)];
  std::map<std::size_t, std::array<double, 3>> out;
  if (errors.empty()) return out;
  const std::vector<std::array<int, 3>> directions = approach_directions(evaluation);
  const std::vector<std::optional<std::size_t>> initial = initial_poses(evaluation);
  struct Sums {
    double n = 0, d = 0, dd = 0, e = 0, de = 0, ee = 0;
  };
  std::map<std::size_t, std::array<Sums, 3>> sums;
  for (std::size_t j = 0; j < judged.poses.size(); ++j) {
    const std::optional<PoseError>& error = errors.back()[j];
    if (!error) continue;
    const std::size_t at = judged.poses[j];
    const PlannedPose& p = evaluation.poses[at].planned;
    const std::size_t at_start = *initial[at];
    const std::array<double, 3> e{error->pitch_deg, error->roll_deg, error->yaw_deg};
    for (std::size_t a = 0; a < 3; ++a) {
      Sums& s = sums[p.scenario][a];
      const double d = directions[at][a] - directions[at_start][a];
      s.n += 1;
      s.d += d;
      s.dd += d * d;
      s.e += e[a];
      s.de += d * e[a];
      s.ee += e[a] * e[a];
    }
  }
  for (const auto& [scenario, axes] : sums)
    for (std::size_t a = 0; a < 3; ++a) {
      const Sums& s = axes[a];
      const double spread = s.dd - s.d * s.d / s.n;
      double& found = out[scenario][a];
      if (s.n < 4 || spread <= 0.0) continue;  // one direction only
      const double h = (s.de - s.d * s.e / s.n) / spread;
      const double rest = s.ee - s.e * s.e / s.n - h * h * spread;
      const double se = std::sqrt(std::max(0.0, rest) / (s.n - 2.0) / spread);
      if (std::abs(h) > 3.0 * se) found = std::abs(h) * std::sqrt(s.dd / s.n);
    }
  return out;
}

std::vector<ErrorBudget> error_budgets(const RunRecord& record, const RigFile& rig,
                                       const Calibration& calibration, const Evaluation& evaluation,
                                       const TruthLevels& levels, const BudgetProgress& progress) {
  if (!levels.model) {
    const RigModel model(rig, made_on_stage(calibration, record.plan));
    return error_budgets({record, rig, calibration, evaluation, model, {}, {}, progress});
  }
  BudgetInput input{record, rig,     calibration, evaluation, *levels.model, levels.found.values,
                    {},     progress};
  if (!levels.judged.poses.empty()) input.backlash_deg = backlash_found(evaluation, levels.judged);
  return error_budgets(input);
}

}  // namespace turntable
