#include "src/vision/matching.h"

#include <Eigen/Core>
#include <algorithm>
#include <limits>

namespace turntable {
namespace {

/// Nearest ray per point, after the points are shifted sideways by `shift`.
struct Pairing {
  std::vector<int> ray_of_point;
  double worst_mm = 0.0;
  bool mutual = true;
  bool distinct = true;  ///< every runner-up at least twice as far, and half the gate
};

Pairing pair(std::span<const Vector3d> points, std::span<const Ray> rays, const RayPlanes& planes,
             const Vector3d& shift, double gate_mm) {
  Eigen::MatrixXd d(static_cast<Eigen::Index>(points.size()),
                    static_cast<Eigen::Index>(rays.size()));
  for (Eigen::Index i = 0; i < d.rows(); ++i)
    for (Eigen::Index j = 0; j < d.cols(); ++j)
      d(i, j) = distance_mm(points[static_cast<std::size_t>(i)] + shift,
                            rays[static_cast<std::size_t>(j)], planes);

  Pairing out;
  for (Eigen::Index i = 0; i < d.rows(); ++i) {
    Eigen::Index best = 0, back = 0;
    const double nearest = d.row(i).minCoeff(&best);
    d.col(best).minCoeff(&back);
    out.mutual = out.mutual && back == i;
    for (Eigen::Index j = 0; j < d.cols(); ++j)
      if (j != best && d(i, j) < std::max(2.0 * nearest, 0.5 * gate_mm)) out.distinct = false;
    out.worst_mm = std::max(out.worst_mm, nearest);
    out.ray_of_point.push_back(static_cast<int>(best));
  }
  return out;
}

}  // namespace

std::string_view match_status_name(MatchStatus status) {
  switch (status) {
    case MatchStatus::kMatched:
      return "matched";
    case MatchStatus::kTooFewSpots:
      return "too few spots";
    case MatchStatus::kAmbiguous:
      return "ambiguous spots";
    case MatchStatus::kTooFar:
      return "spots off the prediction";
  }
  return "?";
}

Match match_to_prediction(std::span<const Vector3d> predicted, std::span<const Ray> rays,
                          const RayPlanes& planes, double gate_mm) {
  Match match;
  if (rays.size() < predicted.size() || predicted.empty()) return match;
  Pairing pairing = pair(predicted, rays, planes, Vector3d::Zero(), gate_mm);
  if (pairing.mutual) {
    Vector3d shift = Vector3d::Zero();
    for (std::size_t i = 0; i < predicted.size(); ++i) {
      const Ray& ray = rays[static_cast<std::size_t>(pairing.ray_of_point[i])];
      shift.head<2>() += ray.at(predicted[i].z(), planes) - predicted[i].head<2>();
    }
    shift /= static_cast<double>(predicted.size());
    if (shift.norm() < gate_mm) pairing = pair(predicted, rays, planes, shift, gate_mm);
  }
  match.ray_of_point = pairing.ray_of_point;
  match.worst_mm = pairing.worst_mm;
  match.status = !pairing.mutual || !pairing.distinct ? MatchStatus::kAmbiguous
                 : pairing.worst_mm > gate_mm         ? MatchStatus::kTooFar
                                                      : MatchStatus::kMatched;
  return match;
}

}  // namespace turntable
