// What the camera model gains and what the solver gains, on one run: every camera model of the
// calibration with every solver, from the same image points.
//   e_k^2 = pitch^2 + roll^2 + yaw^2 error of pose k,  RMSE = sqrt(mean e^2)   (statistics.h)
//   change = RMSE - RMSE of the other cell, over the poses that both have measured
// The RMSE of a cell is over the poses that it has measured: cells with failures are to be compared by
// their changes, and their failures count first.
// Intervals are 95 %, by drawing poses again (paired for changes). The noise of a repeat's initial
// pose is in all of its poses alike, and no interval here knows of it.
#pragma once

#include <string>
#include <vector>

#include "src/attitude/solver.h"
#include "src/evaluation/evaluate.h"
#include "src/evaluation/statistics.h"

namespace turntable {

struct CameraSolverCell {
  std::string camera;  ///< as in `camera_names`
  const Solver* solver = nullptr;
  std::size_t poses = 0;   ///< that were to be measured
  std::size_t failed = 0;  ///< of them
  WithInterval rmse_deg;
  WithInterval from_first_solver_deg;   ///< change against the first solver with the same camera
  WithInterval from_camera_before_deg;  ///< change against the same solver with the camera before
};

struct CameraComparison {
  std::string run;                      ///< its folder, of a run that is set beside another one
  std::string rig;                      ///< its title
  std::vector<std::string> cameras;     ///< simplest first: "pinhole", the undistorting one, "irt"
  std::vector<const Solver*> solvers;   ///< posit, aopit, aopit_ray, ml_ray, opencv_sqpnp
  std::vector<CameraSolverCell> cells;  ///< by camera, then solver
};

/// @param evaluation of a run with this rig and calibration: its poses' points are solved again.
CameraComparison compare_cameras(const Evaluation& evaluation, const RigFile& rig,
                                 const Calibration& calibration);

}  // namespace turntable
