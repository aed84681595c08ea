// What most people would take instead: OpenCV's solvers on undistorted pinhole coordinates, as rows
// of the same table (peers: judged by the same laws and benchmark, not built for accuracy here).
//   opencv_sqpnp      G. Terzakis, M. Lourakis, A consistently fast and globally optimal solution to
//                     the perspective-n-point problem, ECCV 2020, 478-494
//   opencv_epnp       V. Lepetit, F. Moreno-Noguer, P. Fua, EPnP: an accurate O(n) solution to the
//                     PnP problem, IJCV 81 (2009) 155-166
//   opencv_iterative  Levenberg-Marquardt on the reprojection from the pose that AP3P (T. Ke,
//                     S. Roumeliotis, CVPR 2017) finds for the first four points, or EPnP's where it
//                     finds none: without a start it refuses four points
// Symbols:
//   object points -> target.vectors() and 0, mm: positions are M0's
//   image points  -> observation.normalised, camera matrix 1
//   rvec, tvec    -> R = R_camera_from_target, position_mm
//   residual      -> rms reprojection, normalised units
// Domain (measured without noise, OpenCV 4.6; tests/attitude/solver_laws_test.cpp):
//   opencv_sqpnp      any target, planes included; of four points it takes a wrong minimum in 3 of
//                     1000 draws, and in 10 where they are the corner of a cube. Its thresholds are
//                     absolute and suit millimetres: the same points in metres come out wrong by more
//                     than 10 deg in a fifth (corner) to three quarters (published target) of cases
//   opencv_epnp       five points and more, but not where their cloud has two equal axes (a pyramid
//                     on a square: up to 2 mm off). Of four points it is off by degrees (median 4, every twentieth
//                     above 16): they leave its four control points more unknowns than equations. In
//                     noise the answer depends on how the target's own frame lies. Targets in a plane
//                     are refused: its control points would coincide
//   opencv_iterative  any target, planes included
// Planes get one answer and no rival: a second pose is never stated, and in noise iterative ends in it
// as often as AP3P starts near it.
// Outside: sightings on one line, and what OpenCV refuses, throws on, answers with NaN or with points
// behind the camera, are kDegenerate. The stop rules are OpenCV's own (options
// are not read, iterations is 0); it allocates.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

Solution solve_opencv_sqpnp(const TargetModel& target, const Observation& observation,
                            const SolveOptions& options);
Solution solve_opencv_epnp(const TargetModel& target, const Observation& observation,
                           const SolveOptions& options);
Solution solve_opencv_iterative(const TargetModel& target, const Observation& observation,
                                const SolveOptions& options);

}  // namespace turntable
