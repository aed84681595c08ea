#include "src/evaluation/solver_study.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numbers>

#include "src/core/parallel.h"
#include "src/core/units.h"
#include "src/evaluation/statistics.h"

namespace turntable {
namespace {

constexpr double kNormal95 = 1.959964;  // quantile of 97.5 %
constexpr int kResamples = 1000;
constexpr std::size_t kScenesAtOnce = 64;

/// One solver's answer to one scene, deg.
struct StudyAnswer {
  double error_deg = Solution::kNaN;  ///< NaN: no attitude
  double squared_error = Solution::kNaN;
};

StudyAnswer answer_of(const Solver& solver, const TargetModel& target, const TargetScene& scene) {
  const Solution s = solver(target, scene.observation());
  if (!s.has_attitude()) return {};
  const Matrix3d truth = scene.truth(solver.sight);
  const Vector3d delta = vector_from_rotation(truth * s.R.transpose());
  const Matrix3d C = s.covariance.topLeftCorner<3, 3>();
  return {deg_from_rad(geodesic_angle(truth, s.R)), delta.dot(C.inverse() * delta)};
}

Judgement judgement_of(std::span<const StudyAnswer> answers, std::span<const double> bounds_deg,
                       double noise_px, int resamples, const Random& random) {
  Judgement j;
  j.poses = answers.size();
  std::vector<Vector2d> squares;  // e^2 and b^2
  std::vector<double> errors, normalised;
  for (std::size_t i = 0; i < answers.size(); ++i) {
    const double error = answers[i].error_deg, bound = bounds_deg[i];
    if (std::isnan(error)) {
      ++j.no_attitude;
      continue;
    }
    if (error > kFlipped_deg) ++j.flipped;
    errors.push_back(error);
    squares.emplace_back(error * error, bound * bound);
    if (std::isfinite(answers[i].squared_error)) normalised.push_back(answers[i].squared_error);
  }
  if (squares.empty()) return j;
  const auto n = static_cast<double>(squares.size());
  Vector2d sum = Vector2d::Zero();
  for (const Vector2d& s : squares) sum += s;
  j.rmse_deg = std::sqrt(sum.x() / n);
  std::ranges::sort(errors);
  j.median_deg = percentile(errors, 0.5);
  j.percentile95_deg = percentile(errors, 0.95);
  j.largest_deg = errors.back();
  double worst = 0.0;
  for (const double e : std::span(errors).last(std::max<std::size_t>(1, errors.size() / 100)))
    worst += e * e;
  if (sum.x() > 0.0) j.worst_share = worst / sum.x();
  if (noise_px > 0.0) {
    j.bound_deg = std::sqrt(sum.y() / n);
    j.over_bound = j.rmse_deg / j.bound_deg;
    j.over_bound_95 = bootstrap_interval(
        squares.size(),
        [&](std::span<const std::size_t> drawn) {
          Vector2d resampled = Vector2d::Zero();
          for (const std::size_t i : drawn) resampled += squares[i];
          return std::sqrt(resampled.x() / resampled.y());
        },
        random, resamples);
  }
  if (!normalised.empty()) {
    j.squared_error = mean(normalised);
    j.squared_error_95 = bootstrap_interval(
        normalised.size(),
        [&](std::span<const std::size_t> drawn) {
          double resampled = 0.0;
          for (const std::size_t i : drawn) resampled += normalised[i];
          return resampled / static_cast<double>(drawn.size());
        },
        random, resamples);
  }
  return j;
}

SceneLens study_lens(double focal_px, double half_field_px, double distance_mm) {
  SceneLens lens;
  lens.focal_px = focal_px;
  lens.half_field_px = half_field_px;
  lens.centre_mm.z() = 0.5 * (lens.planes.a_mm + lens.planes.b_mm) + distance_mm;
  return lens;
}

/// As in the published geometry: M0 within 50 mm of the axis and 30 mm along it, 550 mm away.
void place_at(PoseRange& poses, double distance_mm) {
  poses.lateral_mm = distance_mm * 50.0 / 550.0;
  poses.along_mm = distance_mm * 30.0 / 550.0;
}

double across(std::span<const Vector3d> target_mm) {
  double size = 0.0;
  for (const Vector3d& p : target_mm) size = std::max(size, (p - target_mm[0]).head<2>().norm());
  return size;
}

double deep(std::span<const Vector3d> target_mm) {
  double low = target_mm[0].z(), high = low;
  for (const Vector3d& p : target_mm) {
    low = std::min(low, p.z());
    high = std::max(high, p.z());
  }
  return high - low;
}

/// Counts poses over everything that is judged.
class StudyCount {
 public:
  StudyCount(std::size_t total, const StudyProgress& progress)
      : total_(total), progress_(progress) {}
  void operator()(std::size_t more) {
    const std::size_t done = done_ += more;
    if (progress_) progress_(done, total_);
  }

 private:
  std::size_t total_;
  std::atomic<std::size_t> done_{0};
  const StudyProgress& progress_;
};

}  // namespace

TargetScene study_scene(const StudySetting& setting, std::uint64_t seed, std::uint64_t index) {
  const PoseRange& p = setting.poses;
  Random random(seed, fmt::format("study, {}, {}", setting.target, p.name), index);
  // The same draws in every setting, so that lenses, noises and factors are compared on like poses.
  const double heading = random.uniform(-std::numbers::pi, std::numbers::pi);
  const double view = rad_from_deg(std::lerp(p.view_low_deg, p.view_high_deg, random.uniform()));
  const double turn = random.uniform(-1.0, 1.0);
  const Vector3d place(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0),
                       random.uniform(-1.0, 1.0));
  Matrix3d turned = Matrix3d::Identity();
  if (p.quarter_turns) {
    Matrix3d quarter;  // exact, no rounded cosines
    quarter << 0, -1, 0, 1, 0, 0, 0, 0, 1;
    for (std::uint64_t k = 0; k < index % 4; ++k) turned = quarter * turned;
  } else {
    turned = rotation_from_vector({0, 0, rad_from_deg(p.turn_deg + p.turn_spread_deg * turn)});
  }
  const Matrix3d tilted =
      rotation_from_vector(view * Vector3d(std::cos(heading), std::sin(heading), 0.0));
  const RayPlanes& planes = setting.lens.planes;
  const Vector3d origin(p.lateral_mm * place.x(), p.lateral_mm * place.y(),
                        0.5 * (planes.a_mm + planes.b_mm) + p.along_mm * place.z());
  TargetScene scene = make_scene(setting.target_mm, tilted * turned, origin, setting.lens);
  if (setting.noise_px > 0.0) add_image_noise(scene, setting.noise_px, random);
  return scene;
}

Interval Judgement::success_95() const {
  if (poses == 0) return {Solution::kNaN, Solution::kNaN};
  const auto n = static_cast<double>(poses);
  const double p = success_rate(), zz = kNormal95 * kNormal95;
  const double middle = (p + zz / (2.0 * n)) / (1.0 + zz / n);
  const double half =
      kNormal95 / (1.0 + zz / n) * std::sqrt(p * (1.0 - p) / n + zz / (4.0 * n * n));
  return {std::max(0.0, middle - half), std::min(1.0, middle + half)};
}

std::vector<Judgement> judge_solvers(const StudySetting& setting,
                                     std::span<const Solver* const> solvers, std::size_t poses,
                                     std::uint64_t seed, int resamples,
                                     const std::function<void(std::size_t)>& done) {
  const TargetModel target(setting.target_mm);
  std::vector<double> bounds(poses);
  std::vector<std::vector<StudyAnswer>> answers(solvers.size(), std::vector<StudyAnswer>(poses));
  parallel_for((poses + kScenesAtOnce - 1) / kScenesAtOnce, [&](std::size_t chunk) {
    const std::size_t begin = chunk * kScenesAtOnce, end = std::min(poses, begin + kScenesAtOnce);
    for (std::size_t i = begin; i < end; ++i) {
      const TargetScene scene = study_scene(setting, seed, i);
      bounds[i] = scene_bound(target, scene, setting.noise_px).total_std_deg();
      for (std::size_t s = 0; s < solvers.size(); ++s)
        answers[s][i] = answer_of(*solvers[s], target, scene);
    }
    if (done) done(end - begin);
  });
  std::vector<Judgement> judgements(solvers.size());
  parallel_for(solvers.size(), [&](std::size_t s) {
    judgements[s] = judgement_of(answers[s], bounds, setting.noise_px, resamples,
                                 Random(seed, "study, bootstrap"));
  });
  return judgements;
}

std::vector<const Solver*> study_solvers() {
  std::vector<const Solver*> solvers;
  for (const Solver& solver : kSolvers)
    if (solver.sight != Sight::kPinholeRaw) solvers.push_back(&solver);
  return solvers;
}

std::vector<StudySetting> noise_settings(const StudyOptions& options) {
  const SceneLens lens = study_lens(options.focal_px, options.half_field_px, options.distance_mm);
  std::vector<StudySetting> bases{
      {options.target, options.target_mm, {.name = "general"}, lens},
      {options.target,
       options.target_mm,
       {.name = "half_turn", .view_high_deg = 5.0, .turn_deg = 180.0, .turn_spread_deg = 5.0},
       lens}};
  for (StudySetting& base : bases) place_at(base.poses, options.distance_mm);
  if (options.reference_targets) {
    // Points that share their x or y with M0, and stay so where the target is not turned.
    const std::vector<Vector3d> axes{{0, 0, 0}, {60, 0, -40}, {0, 60, -40}, {-60, 0, -40}};
    bases.push_back({"axes",
                     axes,
                     {.name = "quarter_turns", .view_high_deg = 0.0, .quarter_turns = true},
                     study_lens(1945.0, 512.0, 550.0)});
    const std::vector<Vector3d> corner{{0, 0, 0}, {75, 0, 0}, {0, 75, 0}, {0, 0, 75}};
    bases.push_back({"corner_75",
                     corner,
                     {.name = "general", .view_high_deg = 30.0},
                     study_lens(1800.0, 512.0, 1e3)});
    place_at(bases.back().poses, 1e3);
  }
  return bases;
}

std::string_view factor_name(Factor factor) {
  switch (factor) {
    case Factor::kViewAngle:
      return "view_angle";
    case Factor::kDistance:
      return "distance";
    case Factor::kDepth:
      return "depth_ratio";
    case Factor::kNoise:
      return "noise";
  }
  return "?";
}

std::string_view factor_unit(Factor factor) {
  switch (factor) {
    case Factor::kViewAngle:
      return "deg";
    case Factor::kDistance:
      return "mm";
    case Factor::kDepth:
      return "1";
    case Factor::kNoise:
      return "px";
  }
  return "?";
}

std::string_view factor_label(Factor factor) {
  switch (factor) {
    case Factor::kViewAngle:
      return "view angle / deg";
    case Factor::kDistance:
      return "distance / mm";
    case Factor::kDepth:
      return "depth over size of the target";
    case Factor::kNoise:
      return "noise / px";
  }
  return "?";
}

StudySetting basin_centre(const StudyOptions& options) {
  StudySetting centre{options.target,
                      options.target_mm,
                      {.name = "basin", .view_low_deg = 30.0, .view_high_deg = 30.0},
                      study_lens(options.focal_px, options.half_field_px, options.distance_mm)};
  place_at(centre.poses, options.distance_mm);
  centre.noise_px = 0.5;  // where the weaker methods begin to fail
  return centre;
}

double depth_ratio(std::span<const Vector3d> target_mm) {
  return deep(target_mm) / across(target_mm);
}

std::vector<double> factor_values(Factor factor, const StudyOptions& options) {
  switch (factor) {
    case Factor::kViewAngle:
      return {0, 10, 20, 30, 40, 50, 60, 70, 80};
    case Factor::kDistance: {
      // In sizes of the target: perspective is strong near it and gone far away.
      std::vector<double> distances;
      for (const double sizes : {1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, 50.0, 100.0, 200.0})
        distances.push_back(std::round(sizes * TargetModel(options.target_mm).radius_mm()));
      return distances;
    }
    case Factor::kDepth:
      if (!(deep(options.target_mm) > 0.0)) return {};
      return {0.05, 0.06, 0.07, 0.1, 0.15, 0.3, 0.6, 1.0, 2.0};
    case Factor::kNoise:
      return {0.0, 0.01, 0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0};
  }
  return {};
}

void set_factor(StudySetting& setting, Factor factor, double value) {
  switch (factor) {
    case Factor::kViewAngle:
      setting.poses.view_low_deg = setting.poses.view_high_deg = value;
      break;
    case Factor::kDistance:
      setting.lens = study_lens(setting.lens.focal_px, setting.lens.half_field_px, value);
      place_at(setting.poses, value);
      break;
    case Factor::kDepth: {
      const double stretch = value / depth_ratio(setting.target_mm);
      for (Vector3d& p : setting.target_mm)
        p.z() = setting.target_mm[0].z() + stretch * (p.z() - setting.target_mm[0].z());
      break;
    }
    case Factor::kNoise:
      setting.noise_px = value;
      break;
  }
}

SolverStudy study(StudyOptions options, const StudyProgress& progress) {
  if (options.solvers.empty()) options.solvers = study_solvers();
  SolverStudy study{std::move(options), {}, {}, {}};
  const StudyOptions& o = study.options;
  study.basin_poses = std::max<std::size_t>(1, o.poses / 10);
  study.map_poses = std::max<std::size_t>(1, o.poses / 40);

  for (const StudySetting& base : noise_settings(o))
    for (const double walk_mm : kStudyWalks_mm)
      for (const double noise_px : kStudyNoises_px) {
        study.noise.push_back({base, walk_mm, {}});
        study.noise.back().setting.lens.walk_over_field(walk_mm);
        study.noise.back().setting.noise_px = noise_px;
      }
  const StudySetting centre = basin_centre(o);
  std::vector<StudySetting> basin, map;
  for (const Factor factor : kFactors)
    for (const double value : factor_values(factor, o)) {
      basin.push_back(centre);
      set_factor(basin.back(), factor, value);
      study.basin.push_back({factor, value, {}});
    }
  for (const double ratio : factor_values(Factor::kDepth, o))
    for (const double view_deg : factor_values(Factor::kViewAngle, o)) {
      map.push_back(centre);
      set_factor(map.back(), Factor::kDepth, ratio);
      set_factor(map.back(), Factor::kViewAngle, view_deg);
      study.map.push_back({view_deg, ratio, {}});
    }

  StudyCount count(study.noise.size() * o.poses + basin.size() * study.basin_poses +
                       map.size() * study.map_poses,
                   progress);
  const auto judge = [&](const StudySetting& setting, std::size_t poses, int resamples) {
    return judge_solvers(setting, o.solvers, poses, o.seed, resamples,
                         [&](std::size_t more) { count(more); });
  };
  for (NoiseRow& row : study.noise) row.judgements = judge(row.setting, o.poses, kResamples);
  for (std::size_t i = 0; i < basin.size(); ++i)
    study.basin[i].judgements = judge(basin[i], study.basin_poses, 0);
  for (std::size_t i = 0; i < map.size(); ++i)
    study.map[i].judgements = judge(map[i], study.map_poses, 0);
  return study;
}

}  // namespace turntable
