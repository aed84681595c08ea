// Time per attitude of every row of the solver table, with OpenCV's SQPNP on the same problems as
// the peer, and the accuracy that the time buys. A wrong answer fails the benchmark; time never
// does.
#include <benchmark/benchmark.h>

#include <cmath>
#include <functional>
#include <opencv2/calib3d.hpp>
#include <vector>

#include "src/attitude/cramer_rao.h"
#include "src/attitude/solver.h"
#include "src/core/units.h"
#include "tests/attitude/problems.h"

namespace turntable {
namespace {

constexpr int kProblems = 1000;
constexpr double kNoisePx = 0.05;

struct Set {
  std::vector<problems::Problem> exact, noisy;
  double bound_deg = 0.0;  ///< root mean square over the problems
};

// The published geometry: 4 points on 60 mm, 40 mm deep, about 550 mm away, +-35 deg, f = 1945 px.
const Set& set() {
  static const Set the_set = [] {
    Set s;
    Random random(1, "attitude benchmark");
    double squares = 0.0;
    for (int n = 0; n < kProblems; ++n) {
      s.exact.push_back(problems::random_problem(random));
      const problems::Problem& p = s.exact.back();
      s.noisy.push_back(p);
      problems::add_noise(s.noisy.back(), kNoisePx, random);
      squares += std::pow(
          cramer_rao_bound_pinhole(TargetModel(p.target_mm), p.R_plane_from_target, p.origin_mm,
                                   p.lens.centre_mm, problems::kFocalPx, kNoisePx)
              .total_std_deg(),
          2);
    }
    s.bound_deg = std::sqrt(squares / kProblems);
    return s;
  }();
  return the_set;
}

// Solves one problem; NaN if there is no answer.
using Solve = std::function<Matrix3d(const problems::Problem&)>;

struct Accuracy {
  double rmse_deg = 0.0;
  double worst_deg = 0.0;
};

Accuracy accuracy(const Solve& solve, const std::vector<problems::Problem>& all, Sight sight) {
  Accuracy out;
  double squares = 0.0;
  for (const problems::Problem& p : all) {
    const Matrix3d R = solve(p);
    const double error =
        R.allFinite() ? deg_from_rad(geodesic_angle(p.truth(sight), R)) : std::nan("");
    squares += error * error;
    out.worst_deg = error > out.worst_deg ? error : out.worst_deg;
  }
  out.rmse_deg = std::sqrt(squares / static_cast<double>(all.size()));
  return out;
}

/// @param exact_deg worst error allowed without noise; @param over_bound RMSE allowed over the
/// Cramer-Rao bound.
void run(benchmark::State& state, const Solve& solve, Sight sight, double exact_deg,
         double over_bound) {
  const Accuracy exact = accuracy(solve, set().exact, sight);
  const Accuracy noisy = accuracy(solve, set().noisy, sight);
  // Negated, so that a NaN fails.
  if (!(exact.rmse_deg <= exact_deg && exact.worst_deg <= exact_deg)) {
    state.SkipWithError("wrong without noise");
    return;
  }
  if (!(noisy.rmse_deg / set().bound_deg <= over_bound)) {
    state.SkipWithError("too far above the Cramer-Rao bound");
    return;
  }
  std::size_t next = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(solve(set().noisy[next]));
    if (++next == set().noisy.size()) next = 0;
  }
  state.counters["rmse_deg"] = noisy.rmse_deg;
  state.counters["rmse_over_bound"] = noisy.rmse_deg / set().bound_deg;
  state.counters["worst_deg"] = noisy.worst_deg;
}

void solver_row(benchmark::State& state, const Solver& solver, double tolerance) {
  const TargetModel target(problems::published_target());
  SolveOptions options = solver.defaults;
  if (tolerance > 0.0) options.tolerance = tolerance;
  const Solve solve = [&](const problems::Problem& p) -> Matrix3d {
    return solver.function(target, p.observation(), options).R;
  };
  run(state, solve, solver.sight, tolerance > 0.0 ? 0.01 : 1e-6, 1.3);
}

void opencv_sqpnp(benchmark::State& state) {
  std::vector<cv::Point3d> object;
  for (const Vector3d& p : problems::published_target()) object.emplace_back(p.x(), p.y(), p.z());
  const cv::Mat camera = cv::Mat::eye(3, 3, CV_64F);
  std::vector<cv::Point2d> image(object.size());
  cv::Mat rvec, tvec;
  const Solve solve = [&](const problems::Problem& p) -> Matrix3d {
    for (std::size_t t = 0; t < image.size(); ++t)
      image[t] = {p.normalised[t].x(), p.normalised[t].y()};
    if (!cv::solvePnP(object, image, camera, cv::noArray(), rvec, tvec, false, cv::SOLVEPNP_SQPNP))
      return Matrix3d::Constant(std::nan(""));
    return rotation_from_vector({rvec.at<double>(0), rvec.at<double>(1), rvec.at<double>(2)});
  };
  cv::setNumThreads(1);
  run(state, solve, Sight::kPinholeUndistorted, 1e-3, 1.3);
}

const bool kRegistered = [] {
  for (const Solver& solver : kSolvers) {
    benchmark::RegisterBenchmark(("attitude/" + std::string(solver.name)).c_str(), solver_row,
                                 solver, 0.0);
    // What a thousandth of the bound needs: 1e-5 of the target's size.
    benchmark::RegisterBenchmark(("attitude/" + std::string(solver.name) + "/coarse").c_str(),
                                 solver_row, solver, solver.tolerance_unit == "mm" ? 6e-4 : 1e-5);
  }
  benchmark::RegisterBenchmark("attitude/peer/opencv_sqpnp", opencv_sqpnp);
  return true;
}();

}  // namespace
}  // namespace turntable

BENCHMARK_MAIN();
