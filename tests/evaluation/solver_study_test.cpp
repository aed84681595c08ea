// What the solvers are held to: the claims about noise, lenses and the basin, on other draws than the
// reference study's.
#include "src/evaluation/solver_study.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <map>
#include <sstream>

#include "src/core/json_document.h"
#include "src/core/rig_file.h"
#include "src/core/units.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

constexpr std::size_t kPoses = 10000;
constexpr std::uint64_t kSeed = 20190511;

std::vector<const Solver*> rows_named(std::initializer_list<const char*> names) {
  std::vector<const Solver*> rows;
  for (const char* name : names) rows.push_back(find_solver(name));
  return rows;
}

/// Standard deviation of RMSE / bound over `poses`, at most: a squared angle with one degree of
/// freedom has a relative variance of 2, with three 2/3, and a root halves it.
double ratio_sd(std::size_t poses) { return 0.5 * std::sqrt(2.0 / static_cast<double>(poses)); }
/// Of the mean of a chi-square of three degrees of freedom.
double squared_error_sd(std::size_t poses) { return std::sqrt(6.0 / static_cast<double>(poses)); }

struct Judged {
  NoiseRow row;
  Judgement posit, aopit, aopit_ray, ml_ray;
};

/// Every target, pose range, lens and noise of the study, judged once for all tests.
const std::vector<Judged>& judged() {
  static const std::vector<Judged> all = [] {
    std::vector<Judged> out;
    const auto solvers = rows_named({"posit_undistorted", "aopit", "aopit_ray", "ml_ray"});
    for (const StudySetting& base : noise_settings({}))
      for (const double walk_mm : kStudyWalks_mm)
        for (const double noise_px : kStudyNoises_px) {
          NoiseRow row{base, walk_mm, {}};
          row.setting.lens.walk_over_field(walk_mm);
          row.setting.noise_px = noise_px;
          const auto j = judge_solvers(row.setting, solvers, kPoses, kSeed, 0);
          out.push_back({row, j[0], j[1], j[2], j[3]});
        }
    return out;
  }();
  return all;
}

std::string name_of(const Judged& j) {
  std::ostringstream text;
  text << j.row.setting.target << ", " << j.row.setting.poses.name << ", " << j.row.walk_mm
       << " mm, " << j.row.setting.noise_px << " px";
  return text.str();
}

TEST(NoiseStudy, HasTheTargetsLensesAndNoisesThatWereAskedFor) {
  std::map<std::string, int> cases;
  for (const Judged& j : judged()) ++cases[j.row.setting.target + "/" + j.row.setting.poses.name];
  const std::map<std::string, int> expected{{"default/general", 8},
                                            {"default/half_turn", 8},
                                            {"axes/quarter_turns", 8},
                                            {"corner_75/general", 8}};
  EXPECT_EQ(cases, expected);
}

TEST(NoiseStudy, MaximumLikelihoodStaysWithinAHundredthAndAHalfOfTheBoundOnEveryLens) {
  for (const Judged& j : judged())
    EXPECT_LT(j.ml_ray.over_bound, 1.015 + 3.0 * ratio_sd(kPoses)) << name_of(j);
  // All targets and poses of one noise and lens together, where chance has less to say.
  double squares = 0.0, bounds = 0.0;
  std::size_t cases = 0;
  for (const Judged& j : judged())
    if (j.row.walk_mm == 0.0 && j.row.setting.noise_px == kStudyNoises_px[0]) {
      squares += std::pow(j.ml_ray.rmse_deg / j.ml_ray.bound_deg, 2);
      bounds += 1.0;
      ++cases;
    }
  EXPECT_NEAR(std::sqrt(squares / bounds), 1.0, 0.015 + 2.0 * ratio_sd(cases * kPoses));
}

TEST(NoiseStudy, MaximumLikelihoodStatesTheUncertaintyThatItHas) {
  for (const Judged& j : judged())
    EXPECT_NEAR(j.ml_ray.squared_error, 3.0, 0.03 * 3.0 + 3.0 * squared_error_sd(kPoses))
        << name_of(j);
}

TEST(NoiseStudy, AopitOnRaysIsAsNearTheBoundAsPositOnCentralLensesAndStaysThereOnOthers) {
  std::map<std::string, double> central;  // RMSE over bound
  for (const Judged& j : judged()) {
    const std::string what = j.row.setting.target + j.row.setting.poses.name;
    if (j.row.walk_mm == 0.0) {
      // The same fixed point: what differs is rounding and where the iteration stops.
      EXPECT_LT(j.aopit_ray.over_bound, 1.001 * j.posit.over_bound) << name_of(j);
      if (j.row.setting.noise_px == kStudyNoises_px[0]) central[what] = j.aopit_ray.over_bound;
    }
    // The same poses and noise on every lens, so that chance has little to say here.
    EXPECT_NEAR(j.aopit_ray.over_bound, central[what], 0.01) << name_of(j);
    EXPECT_LT(j.aopit_ray.over_bound, 1.21) << name_of(j);
  }
}

TEST(NoiseStudy, NeitherOfTheTwoFailsOrFlips) {
  for (const Judged& j : judged())
    for (const Judgement* judgement : {&j.aopit_ray, &j.ml_ray}) {
      EXPECT_EQ(judgement->poses, kPoses);
      EXPECT_EQ(judgement->no_attitude, 0u) << name_of(j);
      EXPECT_EQ(judgement->flipped, 0u) << name_of(j);
      EXPECT_EQ(judgement->success(), kPoses) << name_of(j);
      // Nothing strays beyond what noise can explain.
      EXPECT_LT(judgement->largest_deg, std::max(1.0, 20.0 * judgement->bound_deg)) << name_of(j);
      EXPECT_FALSE(judgement->heavy_tail()) << name_of(j);
    }
}

TEST(NoiseStudy, SolversThatTakeTheLensForCentralLoseWhatItWalks) {
  for (const Judged& j : judged()) {
    if (j.row.setting.noise_px != 0.05 || j.row.walk_mm == 0.0) continue;
    // Millimetres: seen in pairs. Centimetres: tens of percent.
    const double loss = j.row.walk_mm == 2.0 ? 1.002 : j.row.walk_mm == 12.0 ? 1.1 : 1.5;
    EXPECT_GT(j.posit.over_bound, loss * j.aopit_ray.over_bound) << name_of(j);
    if (j.row.walk_mm == 30.0) {
      EXPECT_GT(j.aopit.over_bound, 1.02 * j.aopit_ray.over_bound) << name_of(j);
    }
  }
}

// A few poses in ten thousand, whose start is poor, make the RMSE of AOPIT as published.
TEST(NoiseStudy, FewPosesThatMakeAnRmseAreNoticed) {
  bool noticed = false;
  for (const Judged& j : judged()) {
    for (const Judgement* judgement : {&j.posit, &j.aopit, &j.aopit_ray, &j.ml_ray}) {
      EXPECT_LT(judgement->median_deg, judgement->percentile95_deg) << name_of(j);
      EXPECT_LT(judgement->percentile95_deg, judgement->largest_deg) << name_of(j);
      EXPECT_GT(judgement->worst_share, 0.01) << name_of(j);
    }
    EXPECT_FALSE(j.posit.heavy_tail()) << name_of(j);
    noticed = noticed || j.aopit.heavy_tail();
    // The bulk of its poses is as good as that of the others.
    if (j.aopit.heavy_tail()) {
      EXPECT_LT(j.aopit.median_deg, 1.1 * j.posit.median_deg) << name_of(j);
    }
  }
  EXPECT_TRUE(noticed);
}

TEST(StudyScene, JacobianOfTheLensIsWhatMovingAPointDoesToItsImage) {
  Random random = draws_of_this_test();
  for (const double walk_mm : {0.0, 2.0, 30.0, -30.0}) {
    SceneLens lens;
    lens.walk_over_field(walk_mm);
    const auto image = [&](const Vector3d& X) -> Vector2d {
      const Vector2d g = ray_through(X, lens).slope(lens.planes);
      return lens.focal_px * Vector2d(-g.x(), g.y());
    };
    for (int draw = 0; draw < 50; ++draw) {
      const Vector3d X(random.uniform(-150, 150), random.uniform(-150, 150),
                       random.uniform(50, 200));
      const ImageJacobian J = image_jacobian(X, lens);
      for (Eigen::Index k = 0; k < 3; ++k) {
        const Vector3d step = 1e-3 * Vector3d::Unit(k);
        EXPECT_LT((J.col(k) - (image(X + step) - image(X - step)) / 2e-3).norm(), 1e-6);
      }
    }
    // On the axis too, where the field angle has no derivative.
    EXPECT_LT((image_jacobian({0, 0, 150}, lens).leftCols<2>() -
               lens.focal_px / 550.0 * Eigen::Matrix2d(Vector2d(1, -1).asDiagonal()))
                  .norm(),
              1e-9);
  }
}

TEST(StudyScene, ACentralCameraIsRightHalfWayBetweenThePlanesAndNowhereElse) {
  SceneLens lens;
  lens.walk_over_field(12.0);
  const Vector3d pupil = lens.central_pupil_mm();
  EXPECT_NEAR(pupil.z(), 708.0, 1e-9);
  // M0 half-way between the planes, the others below.
  const TargetScene scene = make_scene(default_target(), Matrix3d::Identity(), {20, 10, 155}, lens);
  const auto straight = [&](std::size_t t) -> Vector2d {
    const Vector3d X = R_camera_from_plane() * (scene.target_mm[t] + scene.origin_mm - pupil);
    return X.head<2>() / X.z();
  };
  EXPECT_LT((scene.normalised[0] - straight(0)).norm(), 1e-12);
  EXPECT_GT((scene.normalised[1] - straight(1)).norm() * lens.focal_px, 0.1);
}

TEST(StudyScene, DefaultTargetIsTheOneOfTheSimulatedRig) {
  const RigFile rig = load_rig_file(TURNTABLE_SOURCE_DIR "/scenarios/rigs/simulated.json");
  ASSERT_EQ(rig.target.points_mm.size(), default_target().size());
  for (std::size_t t = 0; t < default_target().size(); ++t)
    EXPECT_EQ(rig.target.points_mm[t], default_target()[t]);
}

TEST(BasinStudy, FactorsChangeWhatTheirNamesSay) {
  const StudyOptions options;
  StudySetting setting = basin_centre(options);
  set_factor(setting, Factor::kDepth, 0.5);
  EXPECT_NEAR(depth_ratio(setting.target_mm), 0.5, 1e-12);
  set_factor(setting, Factor::kViewAngle, 70.0);
  set_factor(setting, Factor::kDistance, 2000.0);
  set_factor(setting, Factor::kNoise, 0.0);
  for (std::uint64_t i = 0; i < 50; ++i) {
    const TargetScene scene = study_scene(setting, kSeed, i);
    EXPECT_NEAR(deg_from_rad(std::acos(scene.R_plane_from_target(2, 2))), 70.0, 1e-9);
    EXPECT_NEAR(scene.lens.centre_mm.z() - scene.origin_mm.z(), 2000.0, 2000.0 * 30.0 / 550.0);
    EXPECT_TRUE(scene.spreads.empty());
  }
}

TEST(BasinStudy, DeepTargetsAreSolvedAtAnyViewAngle) {
  const auto solvers = rows_named({"posit_undistorted", "aopit_ray", "ml_ray"});
  for (const double view_deg : {0.0, 40.0, 80.0}) {
    StudySetting setting = basin_centre({});
    set_factor(setting, Factor::kViewAngle, view_deg);
    for (const Judgement& j : judge_solvers(setting, solvers, 200, kSeed, 0)) {
      EXPECT_EQ(j.success(), 200u) << view_deg;
      EXPECT_LT(j.largest_deg, std::max(1.0, 20.0 * j.bound_deg)) << view_deg;
    }
  }
}

// Too thick to count as coplanar, too flat for the fixed points of scaled orthography: a limit of
// theirs, kept visible, which maximum likelihood does not share.
TEST(BasinStudy, FlatTargetsAreSolvedByMaximumLikelihoodAndNotByFixedPoints) {
  const auto solvers = rows_named({"posit_undistorted", "aopit_ray", "ml_ray"});
  for (const double ratio : {0.02, 0.05})
    for (const double view_deg : {0.0, 20.0, 40.0}) {
      StudySetting setting = basin_centre({});
      set_factor(setting, Factor::kDepth, ratio);
      set_factor(setting, Factor::kViewAngle, view_deg);
      const auto judgements = judge_solvers(setting, solvers, 500, kSeed, 0);
      EXPECT_GT(judgements[2].success_rate(), 0.95) << ratio << ", " << view_deg;
      EXPECT_LE(judgements[2].flipped, 5u) << ratio << ", " << view_deg;
      if (view_deg > 0.0) continue;
      EXPECT_EQ(judgements[0].success(), 0u);
      EXPECT_EQ(judgements[1].success(), 0u);
    }
}

// A limit that grew with the noise would have it so.
TEST(BasinStudy, NoSolverGainsByWorseImages) {
  const auto solvers = rows_named({"opencv_epnp", "ml_ray"});
  std::vector<Judgement> before;
  for (const double noise_px : {0.05, 0.5, 5.0}) {
    StudySetting setting = basin_centre({});
    setting.noise_px = noise_px;
    const auto now = judge_solvers(setting, solvers, 500, kSeed, 0);
    for (std::size_t s = 0; s < before.size(); ++s)
      EXPECT_LE(now[s].success_95().lower, before[s].success_95().upper) << noise_px << ", " << s;
    before = now;
  }
}

TEST(SolverStudy, DoesNotDependOnTheNumberOfPosesOrOnWhoElseIsJudged) {
  StudySetting setting = noise_settings({}).front();
  const TargetScene early = study_scene(setting, kSeed, 7);
  setting.lens.walk_over_field(30.0);
  const TargetScene walking = study_scene(setting, kSeed, 7);
  EXPECT_EQ(early.R_plane_from_target, walking.R_plane_from_target);
  EXPECT_EQ(early.origin_mm, walking.origin_mm);
  const auto alone = judge_solvers(setting, rows_named({"ml_ray"}), 300, kSeed, 200);
  const auto together =
      judge_solvers(setting, rows_named({"posit_undistorted", "ml_ray"}), 300, kSeed, 200);
  EXPECT_EQ(alone[0].rmse_deg, together[1].rmse_deg);
  EXPECT_EQ(alone[0].over_bound_95.lower, together[1].over_bound_95.lower);
  EXPECT_EQ(alone[0].squared_error_95.upper, together[1].squared_error_95.upper);
  const auto other = judge_solvers(setting, rows_named({"ml_ray"}), 300, kSeed + 1, 0);
  EXPECT_NE(alone[0].rmse_deg, other[0].rmse_deg);
}

TEST(SolverStudy, IntervalsHoldWhatTheyAreAbout) {
  const StudySetting setting = noise_settings({}).front();
  const Judgement j = judge_solvers(setting, rows_named({"ml_ray"}), 1000, kSeed, 500)[0];
  EXPECT_LT(j.over_bound_95.lower, j.over_bound);
  EXPECT_GT(j.over_bound_95.upper, j.over_bound);
  // Twice 1.96 standard deviations of a mean of 1000.
  EXPECT_NEAR(j.squared_error_95.upper - j.squared_error_95.lower,
              2.0 * 1.96 * squared_error_sd(1000), 0.3 * 2.0 * 1.96 * squared_error_sd(1000));
  Judgement rare;
  rare.poses = 1000;
  EXPECT_NEAR(rare.success_95().lower, 1.0 - 3.84 / 1003.84, 1e-4);
  EXPECT_EQ(rare.success_95().upper, 1.0);
}

TEST(SolverStudy, IsDoneInParts) {
  StudyOptions options;
  options.poses = 40;
  options.reference_targets = false;
  options.solvers = rows_named({"ml_ray"});
  std::atomic<std::size_t> last{0}, total{0};
  const SolverStudy result = study(options, [&](std::size_t done, std::size_t of) {
    for (std::size_t seen = last; seen < done && !last.compare_exchange_weak(seen, done);) {
    }
    total = of;
  });
  EXPECT_EQ(last.load(), total.load());
  EXPECT_EQ(result.noise.size(), 16u);
  EXPECT_EQ(result.map.size(), 81u);
  EXPECT_EQ(result.map_poses, 1u);
  for (const NoiseRow& row : result.noise) EXPECT_EQ(row.judgements.at(0).poses, 40u);
}

TEST(SolverStudy, TargetsInAPlaneHaveNoDepthToVary) {
  StudyOptions options;
  options.poses = 40;
  options.reference_targets = false;
  options.target_mm = {{0, 0, 0}, {60, 0, 0}, {0, 60, 0}, {-60, -60, 0}};
  options.solvers = rows_named({"ml_ray", "aopit_ray"});
  const SolverStudy result = study(options);
  EXPECT_TRUE(result.map.empty());
  for (const BasinRow& row : result.basin) EXPECT_NE(row.factor, Factor::kDepth);
  for (const NoiseRow& row : result.noise) {
    EXPECT_GT(row.judgements[0].success(), 0u);
    EXPECT_EQ(row.judgements[1].no_attitude, 40u);
    EXPECT_TRUE(std::isnan(row.judgements[1].over_bound));
  }
}

std::vector<std::string> cells_of(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream in(line);
  for (std::string cell; std::getline(in, cell, ',');) cells.push_back(cell);
  return cells;
}

// One row of results/reference/solver_study, made again.
TEST(ReferenceStudy, RowOfMaximumLikelihoodOnTheDefaultTargetComesOutAgain) {
  std::istringstream csv(
      read_text(TURNTABLE_SOURCE_DIR "/results/reference/solver_study/tables/noise.csv"));
  std::string line;
  std::getline(csv, line);
  const std::vector<std::string> header = cells_of(line);
  std::map<std::string, std::string> found;
  while (std::getline(csv, line)) {
    const std::vector<std::string> cells = cells_of(line);
    std::map<std::string, std::string> row;
    for (std::size_t i = 0; i < cells.size(); ++i) row[header.at(i)] = cells[i];
    if (row["target"] == "default" && row["poses_of"] == "general" && row["solver"] == "ml_ray" &&
        row["pupil_walk_mm"] == "12.0" && row["noise_px"] == "0.050")
      found = row;
  }
  ASSERT_FALSE(found.empty());
  StudySetting setting = noise_settings({}).front();
  setting.lens.walk_over_field(12.0);
  setting.noise_px = 0.05;
  const Judgement j =
      judge_solvers(setting, rows_named({"ml_ray"}), std::stoul(found["poses"]), 1, 0)[0];
  // A better start or another stop may change the last digits, not what the row says.
  EXPECT_NEAR(j.rmse_deg, std::stod(found["rmse_deg"]), 1e-4 * j.rmse_deg);
  EXPECT_NEAR(j.bound_deg, std::stod(found["bound_deg"]), 1e-4 * j.bound_deg);
  EXPECT_NEAR(j.squared_error, std::stod(found["normalised_squared_error"]), 1e-3);
  EXPECT_EQ(std::to_string(j.no_attitude), found["no_attitude"]);
  EXPECT_EQ(std::to_string(j.flipped), found["flipped"]);
}

}  // namespace
}  // namespace turntable
