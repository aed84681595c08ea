#include "src/attitude/information.h"

#include <algorithm>
#include <cmath>

namespace turntable {

Matrix6d inverse_of_information(const Matrix6d& N) {
  constexpr double kMinPivot = 1e-7;
  Matrix6d L = Matrix6d::Zero(), K = Matrix6d::Zero();  // K = L^-1
  double smallest = INFINITY, largest = 0.0;
  for (Eigen::Index j = 0; j < 6; ++j) {
    double square = N(j, j);
    for (Eigen::Index k = 0; k < j; ++k) square -= L(j, k) * L(j, k);
    L(j, j) = std::sqrt(square);  // NaN if N is not positive, and then so is everything
    smallest = std::min(smallest, L(j, j));
    largest = std::max(largest, L(j, j));
    for (Eigen::Index i = j + 1; i < 6; ++i) {
      double sum = N(i, j);
      for (Eigen::Index k = 0; k < j; ++k) sum -= L(i, k) * L(j, k);
      L(i, j) = sum / L(j, j);
    }
  }
  if (!(L.allFinite() && smallest > kMinPivot * largest)) return Matrix6d::Constant(Solution::kNaN);
  for (Eigen::Index j = 0; j < 6; ++j) {
    K(j, j) = 1.0 / L(j, j);
    for (Eigen::Index i = j + 1; i < 6; ++i) {
      double sum = 0.0;
      for (Eigen::Index k = j; k < i; ++k) sum += L(i, k) * K(k, j);
      K(i, j) = -sum / L(i, i);
    }
  }
  return K.transpose().lazyProduct(K);
}

}  // namespace turntable
