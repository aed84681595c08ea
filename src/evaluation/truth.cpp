#include "src/evaluation/truth.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace turntable {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

Alignment closed_form(std::span<const Matrix3d> measured, std::span<const Matrix3d> gimbal) {
  Matrix3d M = Matrix3d::Zero();
  for (std::size_t k = 1; k < measured.size(); ++k)
    M += vector_from_rotation(measured[k] * measured[0].transpose()) *
         vector_from_rotation(gimbal[k] * gimbal[0].transpose()).transpose();
  // A little of the identity decides what the motions do not.
  M += 1e-6 * std::max(M.norm(), 1e-12) * Matrix3d::Identity();
  Alignment out;
  out.X = nearest_rotation(M);
  Matrix3d sum = Matrix3d::Zero();
  for (std::size_t k = 0; k < measured.size(); ++k)
    sum += (out.X * gimbal[k]).transpose() * measured[k];
  out.Y = nearest_rotation(sum);
  return out;
}

}  // namespace

std::string_view truth_level_name(TruthLevel level) {
  switch (level) {
    case TruthLevel::kPublished:
      return "as published";
    case TruthLevel::kAligned:
      return "aligned";
    case TruthLevel::kSelfCalibrated:
      return "self-calibrated";
  }
  return "?";
}

Alignment align(std::span<const Matrix3d> measured, std::span<const Matrix3d> gimbal) {
  if (measured.empty()) return {};
  Alignment out = closed_form(measured, gimbal);
  const auto misses = [&](Matrix6* N, Vector6* b) {
    double sum = 0.0;
    for (std::size_t k = 0; k < measured.size(); ++k) {
      const Matrix3d R = out.X * gimbal[k] * out.Y;
      const Vector3d e = vector_from_rotation(measured[k] * R.transpose());
      sum += e.squaredNorm();
      if (N == nullptr) continue;
      Eigen::Matrix<double, 3, 6> J;
      J << Matrix3d::Identity(), R;
      *N += J.transpose() * J;
      *b += J.transpose() * e;
    }
    return std::sqrt(sum / static_cast<double>(measured.size()));
  };
  for (int pass = 0; pass < 10; ++pass) {
    Matrix6 N = Matrix6::Zero();
    Vector6 b = Vector6::Zero();
    misses(&N, &b);
    // What the motions do not determine stays where it is.
    const Eigen::SelfAdjointEigenSolver<Matrix6> eigen(N);
    Vector6 step = Vector6::Zero();
    out.determined = 0;
    for (int i = 0; i < 6; ++i) {
      if (!(eigen.eigenvalues()(i) > 1e-6 * eigen.eigenvalues()(5))) continue;
      ++out.determined;
      const Vector6 v = eigen.eigenvectors().col(i);
      step += v * (v.dot(b) / eigen.eigenvalues()(i));
    }
    out.X = rotation_from_vector(step.head<3>()) * out.X;
    out.Y = out.Y * rotation_from_vector(step.tail<3>());
    if (step.norm() < 1e-12) break;
  }
  out.rms_rad = misses(nullptr, nullptr);
  return out;
}

}  // namespace turntable
