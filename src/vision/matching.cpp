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
  int worst = -1;      ///< point
  bool mutual = true;  ///< every ray's nearest point is the one that took it
  int ambiguous =
      -1;  ///< first point that is not mutual or has a runner-up less than twice as far,
           ///< or nearer than half the gate
};

Pairing pair(std::span<const Vector3d> points, std::span<const Ray> rays, const RayPlanes& planes,
             const Vector3d& shift, double gate_mm) {
  Eigen::MatrixXd d(static_cast<Eigen::Index>(points.size()),
                    static_cast<Eigen::Index>(rays.size()));
  for (Eigen::Index i = 0; i < d.rows(); ++i)
    for (Eigen::Index j = 0; j < d.cols(); ++j) {
      const double miss = distance_mm(points[static_cast<std::size_t>(i)] + shift,
                                      rays[static_cast<std::size_t>(j)], planes);
      // Not via miss: the clamp at zero inside a distance turns NaN into a perfect fit.
      const bool finite = points[static_cast<std::size_t>(i)].allFinite() &&
                          rays[static_cast<std::size_t>(j)].at_a.allFinite() &&
                          rays[static_cast<std::size_t>(j)].at_b.allFinite();
      d(i, j) = finite ? miss : std::numeric_limits<double>::infinity();
    }

  Pairing out;
  for (Eigen::Index i = 0; i < d.rows(); ++i) {
    Eigen::Index best = 0, back = 0;
    const double nearest = d.row(i).minCoeff(&best);
    d.col(best).minCoeff(&back);
    bool ambiguous = back != i;
    out.mutual = out.mutual && back == i;
    for (Eigen::Index j = 0; j < d.cols(); ++j)
      ambiguous = ambiguous || (j != best && d(i, j) < std::max(2.0 * nearest, 0.5 * gate_mm));
    if (ambiguous && out.ambiguous < 0) out.ambiguous = static_cast<int>(i);
    if (out.worst < 0 || nearest > out.worst_mm) {
      out.worst = static_cast<int>(i);
      out.worst_mm = nearest;
    }
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
  match.status = MatchStatus::kMatched;
  if (!(pairing.worst_mm <= gate_mm)) {
    match.status = MatchStatus::kTooFar;
    match.point = pairing.worst;
  } else if (pairing.ambiguous >= 0) {
    match.status = MatchStatus::kAmbiguous;
    match.point = pairing.ambiguous;
  }
  return match;
}

}  // namespace turntable
