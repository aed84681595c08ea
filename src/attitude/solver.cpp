#include "src/attitude/solver.h"

#include <algorithm>
#include <array>

#include "src/attitude/aopit.h"
#include "src/attitude/aopit_ray.h"
#include "src/attitude/posit.h"

namespace turntable {
namespace {

constexpr std::string_view kDeMenthon = "DeMenthon & Davis, IJCV 15 (1995) 123-141";
constexpr std::string_view kGuo =
    "Guo et al., ISA Transactions 2019, doi:10.1016/j.isatra.2019.05.009";

// Stop criteria: relative to Z0 on a pinhole, mm on rays.
constexpr SolveOptions kRelative{1e-9, 200};
constexpr SolveOptions kLength{1e-8, 200};

// clang-format off
constexpr std::array kTable{
    Solver{"posit", "POSIT, distortion-free pinhole", Sight::kPinholeRaw,
           solve_posit, kRelative, "1", kDeMenthon},
    Solver{"posit_undistorted", "POSIT, undistorted points", Sight::kPinholeUndistorted,
           solve_posit, kRelative, "1", kDeMenthon},
    Solver{"aopit", "AOPIT as published", Sight::kRays,
           solve_aopit, kLength, "mm", kGuo},
    Solver{"aopit_ray", "AOPIT on general rays", Sight::kRays,
           solve_aopit_ray, kLength, "mm", "extension of Guo et al. 2019 to any ray bundle"},
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
    case SolveStatus::kNotConverged:
      return "not_converged";
    case SolveStatus::kDegenerate:
      return "degenerate";
    case SolveStatus::kInvalidInput:
      return "invalid_input";
  }
  return "?";
}

const Solver* find_solver(std::string_view name) {
  const auto row = std::ranges::find(kSolvers, name, &Solver::name);
  return row == kSolvers.end() ? nullptr : &*row;
}

}  // namespace turntable
