// From the information of a pose to its covariance.
#pragma once

#include "src/attitude/solver.h"

namespace turntable {

/// Of the information of T_y, added to that of T_z: keeps the height where parallel rays know nothing of
/// it, and nearly parallel ones let it serve as a scale (ml_ray.h).
constexpr double kHeightRidge = 1e-13;

/// N^-1 of a symmetric, positive N by its Cholesky factor, N = L L^T, a column of L^-1 at a time; NaN
/// if a pivot of L is below 1e-7 of the largest: what N does not determine has no covariance.
Matrix6d inverse_of_information(const Matrix6d& N);

}  // namespace turntable
