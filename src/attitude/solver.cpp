#include "src/attitude/solver.h"

#include <algorithm>
#include <array>
#include <cassert>

#include "src/attitude/aopit.h"
#include "src/attitude/aopit_ray.h"
#include "src/attitude/ml_ray.h"
#include "src/attitude/oi_ray.h"
#include "src/attitude/opencv_pnp.h"
#include "src/attitude/posit.h"
#include "src/attitude/prsoi.h"
#include "src/core/parallel.h"

namespace turntable {
namespace {

constexpr std::string_view kDeMenthon = "DeMenthon & Davis, IJCV 15 (1995) 123-141";
constexpr std::string_view kGuo =
    "Guo et al., ISA Transactions 2019, doi:10.1016/j.isatra.2019.05.009";

// Stop criteria: relative to Z0 on a pinhole, mm on rays.
constexpr SolveOptions kRelative{1e-9, 200};
constexpr SolveOptions kLength{1e-8, 200};
constexpr SolveOptions kStillToCome{1e-8, 3000};  // mm, of all steps that would follow
constexpr SolveOptions kLastStep{1e-5, 200};      // mm, of a step that is still taken
constexpr std::string_view kTheirs = "none";      // peers stop by their own rules

// Traits at the end of a row.
constexpr bool kCoplanar = true, kByDefault = true, kPeer = true;

// clang-format off
constexpr std::array kTable{
    Solver{"posit", "POSIT, distortion-free pinhole", Sight::kPinholeRaw,
           solve_posit, kRelative, "1", kDeMenthon, !kCoplanar, kByDefault},
    Solver{"posit_undistorted", "POSIT, undistorted points", Sight::kPinholeUndistorted,
           solve_posit, kRelative, "1", kDeMenthon, !kCoplanar, kByDefault},
    Solver{"aopit", "AOPIT as published", Sight::kRays,
           solve_aopit, kLength, "mm", kGuo, !kCoplanar, kByDefault},
    Solver{"aopit_ray", "AOPIT on general rays", Sight::kRays,
           solve_aopit_ray, kLength, "mm", "extension of Guo et al. 2019 to any ray bundle", !kCoplanar, kByDefault},
    Solver{"ml_ray", "maximum likelihood on rays", Sight::kRays,
           solve_ml_ray, kLastStep, "mm", "Gauss-Newton from aopit_ray", kCoplanar, kByDefault},
    Solver{"oi_ray", "orthogonal iteration on rays", Sight::kRays,
           solve_oi_ray, kStillToCome, "mm", "Lu, Hager & Mjolsness, IEEE TPAMI 22 (2000) 610-622, on rays", kCoplanar},
    Solver{"prsoi", "scaled orthography on rays", Sight::kRays,
           solve_prsoi, kLength, "mm", "after Sun et al., PLoS ONE 10(7) (2015) e0134029"},
    Solver{"opencv_sqpnp", "OpenCV, SQPNP", Sight::kPinholeUndistorted,
           solve_opencv_sqpnp, {}, kTheirs, "Terzakis & Lourakis, ECCV 2020, 478-494", kCoplanar, !kByDefault, kPeer},
    Solver{"opencv_epnp", "OpenCV, EPnP", Sight::kPinholeUndistorted,
           solve_opencv_epnp, {}, kTheirs, "Lepetit et al., IJCV 81 (2009) 155-166", !kCoplanar, !kByDefault, kPeer},
    Solver{"opencv_iterative", "OpenCV, AP3P and iterative", Sight::kPinholeUndistorted,
           solve_opencv_iterative, {}, kTheirs, "Ke & Roumeliotis, CVPR 2017; Levenberg-Marquardt", kCoplanar, !kByDefault, kPeer},
};
// clang-format on

}  // namespace

constinit const std::span<const Solver> kSolvers{kTable};

std::string_view sight_name(Sight sight) {
  switch (sight) {
    case Sight::kRays:
      return "rays";
    case Sight::kPinholeRaw:
      return "pinhole_raw";
    case Sight::kPinholeUndistorted:
      return "pinhole_undistorted";
  }
  return "?";
}

std::string_view frame_name(Sight sight) { return sight == Sight::kRays ? "plane" : "camera"; }

std::string_view status_name(SolveStatus status) {
  switch (status) {
    case SolveStatus::kConverged:
      return "converged";
    case SolveStatus::kHeightUndefined:
      return "height_undefined";
    case SolveStatus::kOutsideDomain:
      return "outside_domain";
    case SolveStatus::kAmbiguous:
      return "ambiguous";
    case SolveStatus::kNotConverged:
      return "not_converged";
    case SolveStatus::kDegenerate:
      return "degenerate";
    case SolveStatus::kCoplanarTarget:
      return "coplanar_target";
    case SolveStatus::kInvalidInput:
      return "invalid_input";
  }
  return "?";
}

const Solver* find_solver(std::string_view name) {
  const auto row = std::ranges::find(kSolvers, name, &Solver::name);
  return row == kSolvers.end() ? nullptr : &*row;
}

const Solver& default_solver() { return *find_solver("ml_ray"); }

void solve_all(const Solver& solver, const SolveOptions& options, const TargetModel& target,
               std::span<const Observation> observations, std::span<Solution> solutions) {
  assert(observations.size() == solutions.size());
  // A solve takes about a microsecond, taking the next piece of work a tenth of one.
  constexpr std::size_t kChunk = 256;
  parallel_for((observations.size() + kChunk - 1) / kChunk, [&](std::size_t chunk) {
    const std::size_t end = std::min(observations.size(), (chunk + 1) * kChunk);
    for (std::size_t i = chunk * kChunk; i < end; ++i)
      solutions[i] = solver.function(target, observations[i], options);
  });
}

}  // namespace turntable
