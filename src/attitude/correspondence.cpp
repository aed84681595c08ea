#include "src/attitude/correspondence.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <optional>

#include "src/attitude/chi_square.h"
#include "src/attitude/p3p.h"
#include "src/attitude/ray_bundle.h"

namespace turntable {
namespace {

constexpr double kPointGate = 5.0;      // sigmas; also the price of a hidden point
constexpr double kMargin = 4.0;         // sigmas between the best and a rival
constexpr double kOverwhelming = 1e-6;  // chance below which no further triple is tried
constexpr long kMaxHypotheses = 1'000'000;
constexpr std::size_t kKept = 12;  // candidates kept while searching
constexpr int kUnseen = -1;

using Assignment = std::array<int, kMaxTargetPoints>;  // spot of point, kUnseen behind the target's
using Triple = std::array<int, 3>;

struct Pose {
  Matrix3d R;
  Vector3d T;  ///< of the target frame's origin
};

/// A spot as the search sees it: the miss of X is A X - b (two rows, perpendicular to the ray), and
/// from the bundle's centre it is in direction (u, -1).
struct Seen {
  int index = 0;  ///< among the caller's rays
  Eigen::Matrix<double, 2, 3> A;
  Vector2d b;
  Vector2d u;
  Vector3d direction;
};

struct Candidate {
  Assignment spot;
  int matched = 0;
  Pose pose;
  double S = 0.0;  ///< mm^2
  double Q = 0.0;
  bool acceptable = false;
};

/// The four points, three for the hypothesis, that a search starts from, and where the others stand
/// in its frame.
struct Basis {
  Triple points;
  Vector3d distances;
  Matrix3d frame;           ///< columns: orthonormal axes of the triangle, target frame
  std::vector<int> others;  ///< narrowest gate first
  std::vector<double> gate_mm;
  std::vector<int> fourths;  ///< farthest from the triangle's plane first
};

bool different(const Assignment& a, const Assignment& b) {
  for (std::size_t t = 0; t < a.size(); ++t)
    if (a[t] != kUnseen && b[t] != kUnseen && a[t] != b[t]) return true;
  return false;
}

Matrix3d triangle_frame(const Vector3d& x_1, const Vector3d& x_2, const Vector3d& x_3) {
  Matrix3d axes;
  axes.col(0) = (x_2 - x_1).normalized();
  axes.col(2) = axes.col(0).cross(x_3 - x_1).normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return axes;
}

double least_altitude(const Vector3d& x_1, const Vector3d& x_2, const Vector3d& x_3) {
  const double longest = std::sqrt(
      std::max({(x_2 - x_1).squaredNorm(), (x_3 - x_1).squaredNorm(), (x_3 - x_2).squaredNorm()}));
  return longest > 0.0 ? (x_2 - x_1).cross(x_3 - x_1).norm() / longest : 0.0;
}

class Search {
 public:
  Search(const TargetModel& target, std::span<const Ray> rays, const RayPlanes& planes,
         const CorrespondenceOptions& options)
      : target_(target), options_(options), n_(target.size()) {
    min_points_ = options.min_points == 0 ? n_ : options.min_points;
    prepare_spots(rays, planes);
  }

  Correspondence run();

 private:
  int spot_count() const { return static_cast<int>(spots_.size()); }
  Vector3d point(int t) const { return target_.points().col(t); }

  void prepare_spots(std::span<const Ray> rays, const RayPlanes& planes);
  Basis basis_of(const Triple& points) const;
  std::vector<Triple> triples() const;
  void try_triple(const Basis& basis, int i, int j, int k);
  void try_pose(const Basis& basis, const Triple& spots, const Pose& pose);
  void extend(Assignment spot, Pose pose);
  bool allowed(const Pose& pose) const;
  double fit(const Assignment& spot, Pose& pose) const;
  void offer(const Assignment& spot, const Pose& pose, double S);
  void exchange_neighbours(const Candidate& best);
  double chance(const Candidate& c) const;
  AssignedPose answer(const Candidate& c) const;
  double dof(int matched) const { return 2.0 * matched - (parallel_ ? 5.0 : 6.0); }

  const TargetModel& target_;
  const CorrespondenceOptions& options_;
  int n_;
  int min_points_ = 4;
  std::vector<Seen> spots_;
  bool converging_ = false;  ///< the bundle has a centre above the target, or is parallel
  bool parallel_ = false;
  Vector3d centre_ = Vector3d::Zero();
  double search_sigma_mm_ = 0.0;  ///< the caller's, and what the bundle misses its centre by
  double area_mm2_ = 0.0;
  std::vector<Candidate> kept_;  ///< by Q
};

void Search::prepare_spots(std::span<const Ray> rays, const RayPlanes& planes) {
  const double middle = 0.5 * (planes.a_mm + planes.b_mm);
  std::vector<Vector2d> at, slope;
  for (std::size_t r = 0; r < rays.size() && spot_count() < kMaxCorrespondenceSpots; ++r) {
    const Ray& ray = rays[r];
    if (!ray.at_a.allFinite() || !ray.at_b.allFinite()) continue;
    const Vector2d g = ray.slope(planes);
    const double gg = g.squaredNorm();
    // W^T W = 1 - g g^T / (1 + |g|^2): the in-plane miss, projected off the ray's direction.
    Eigen::Matrix2d W = Eigen::Matrix2d::Identity();
    if (gg > 0.0) W -= (1.0 - 1.0 / std::sqrt(1.0 + gg)) / gg * g * g.transpose();
    Seen seen;
    seen.index = static_cast<int>(r);
    seen.A << W, -W * g;
    seen.b = W * ray.at(0.0, planes);
    spots_.push_back(seen);
    at.push_back(ray.at(middle, planes));
    slope.push_back(g);
  }
  if (spots_.empty()) return;

  // Where the rays come closest: at + slope (c - middle) = const, least squares over all rays.
  const double m = static_cast<double>(at.size());
  Vector2d mean_at = Vector2d::Zero(), mean_slope = Vector2d::Zero();
  for (std::size_t r = 0; r < at.size(); ++r) mean_at += at[r] / m, mean_slope += slope[r] / m;
  double product = 0.0, square = 0.0, spread = 0.0;
  for (std::size_t r = 0; r < at.size(); ++r) {
    product += (at[r] - mean_at).dot(slope[r] - mean_slope);
    square += (slope[r] - mean_slope).squaredNorm();
    spread += (at[r] - mean_at).squaredNorm();
  }
  // One over the distance of the centre from the middle plane.
  const double opening = spread > 0.0 ? -product / spread : 0.0;
  const double least = 1.0 / (kParallelRadii * target_.radius_mm());
  parallel_ = std::abs(opening) <= least && std::sqrt(square) <= 2.0 * least * std::sqrt(spread);
  converging_ = parallel_ || opening > least;
  const double distance = parallel_ ? 1.0 / least : square > 0.0 ? -product / square : 0.0;
  centre_ << mean_at + mean_slope * distance, middle + distance;

  const double reach = 2.0 * target_.radius_mm() + planes.b_mm - planes.a_mm;
  double off = 0.0;
  Vector2d low = at[0], high = at[0];
  for (std::size_t r = 0; r < at.size(); ++r) {
    Seen& seen = spots_[r];
    seen.u = (at[r] - centre_.head<2>()) / distance;
    seen.direction = Vector3d(seen.u.x(), seen.u.y(), -1.0).normalized();
    off += (slope[r] + seen.u).squaredNorm() / (2.0 * m);
    low = low.cwiseMin(at[r]);
    high = high.cwiseMax(at[r]);
  }
  search_sigma_mm_ = std::hypot(options_.sigma_mm, parallel_ ? 0.0 : reach * std::sqrt(off));
  area_mm2_ = (high - low).prod();
}

Basis Search::basis_of(const Triple& points) const {
  Basis basis;
  basis.points = points;
  const Vector3d x_1 = point(points[0]), x_2 = point(points[1]), x_3 = point(points[2]);
  basis.distances << (x_1 - x_2).norm(), (x_1 - x_3).norm(), (x_2 - x_3).norm();
  basis.frame = triangle_frame(x_1, x_2, x_3);
  const double altitude = least_altitude(x_1, x_2, x_3);
  // A triangle seen at right angles tells its heights h from D^2 - h^2 only: dh = sqrt(2 D dD).
  const double tilt = std::sqrt(8.0 * search_sigma_mm_ * basis.distances.maxCoeff()) / altitude;
  std::vector<std::pair<double, int>> by_gate, by_height;
  for (int t = 0; t < n_; ++t) {
    if (std::ranges::find(points, t) != points.end()) continue;
    const Vector3d local = basis.frame.transpose() * (point(t) - x_1);
    const double lever = 1.0 + local.head<2>().norm() / altitude;
    const double height = std::abs(local.z());
    by_gate.emplace_back(kPointGate * search_sigma_mm_ * 2.0 * lever + tilt * height, t);
    by_height.emplace_back(-height, t);
  }
  std::ranges::sort(by_gate);
  std::ranges::sort(by_height);
  for (const auto& [gate, t] : by_gate) basis.others.push_back(t), basis.gate_mm.push_back(gate);
  for (const auto& [height, t] : by_height)
    if (-height > kMinThickness * target_.radius_mm()) basis.fourths.push_back(t);
  return basis;
}

/// Triangles with long altitudes first, each choice making its points less wanted by the next.
std::vector<Triple> Search::triples() const {
  std::vector<std::pair<double, Triple>> all;
  for (int a = 0; a < n_; ++a)
    for (int b = a + 1; b < n_; ++b)
      for (int c = b + 1; c < n_; ++c)
        if (const double altitude = least_altitude(point(a), point(b), point(c));
            altitude > kMinThickness * target_.radius_mm())
          all.emplace_back(altitude, Triple{a, b, c});
  const long m = spot_count(), each = m * (m - 1) * (m - 2);
  const std::size_t wanted =
      min_points_ == n_ ? 1 : static_cast<std::size_t>(std::max(1L, kMaxHypotheses / each));
  std::vector<Triple> out;
  std::array<double, kMaxTargetPoints> worth;
  worth.fill(1.0);
  while (out.size() < wanted && !all.empty()) {
    const auto value = [&](const std::pair<double, Triple>& entry) {
      double v = entry.first;
      for (const int t : entry.second) v *= worth[static_cast<std::size_t>(t)];
      return v;
    };
    const auto best = std::ranges::max_element(all, {}, value);
    for (const int t : best->second) worth[static_cast<std::size_t>(t)] *= 0.5;
    out.push_back(best->second);
    *best = all.back();
    all.pop_back();
  }
  return out;
}

bool Search::allowed(const Pose& pose) const {
  if (!(pose.R(2, 2) >= std::cos(options_.max_tilt_rad))) return false;
  if (options_.max_turn_rad < std::numbers::pi &&
      !((options_.R_near.transpose() * pose.R).trace() >=
        1.0 + 2.0 * std::cos(options_.max_turn_rad)))
    return false;
  const double z = pose.R.row(2).dot(point(0)) + pose.T.z();
  return parallel_ || (z >= options_.min_height_mm && z <= options_.max_height_mm);
}

/// Levenberg-Marquardt on the perpendicular misses of the matched points, from `pose` on; J of a
/// point is A [-[R p]x, 1] with p from the centroid, so that turn and shift hardly mix.
/// @return S in mm^2.
double Search::fit(const Assignment& spot, Pose& pose) const {
  std::array<int, kMaxTargetPoints> used;
  int k = 0;
  Vector3d centroid = Vector3d::Zero();
  for (int t = 0; t < n_; ++t)
    if (spot[static_cast<std::size_t>(t)] != kUnseen) {
      used[static_cast<std::size_t>(k++)] = t;
      centroid += point(t);
    }
  centroid /= k;
  Vector3d shift = pose.R * centroid + pose.T;
  const auto miss = [&](const Matrix3d& R, const Vector3d& position, int at) -> Vector2d {
    const int t = used[static_cast<std::size_t>(at)];
    const Seen& seen = spots_[static_cast<std::size_t>(spot[static_cast<std::size_t>(t)])];
    return seen.A * (R * (point(t) - centroid) + position) - seen.b;
  };
  const auto sum = [&](const Matrix3d& R, const Vector3d& position) {
    double S = 0.0;
    for (int at = 0; at < k; ++at) S += miss(R, position, at).squaredNorm();
    return S;
  };
  double S = sum(pose.R, shift), damping = 1e-4;
  const double settled = 1e-6 * options_.sigma_mm * options_.sigma_mm;
  for (int pass = 0; pass < 20; ++pass) {
    Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> gradient = Eigen::Matrix<double, 6, 1>::Zero();
    for (int at = 0; at < k; ++at) {
      const int t = used[static_cast<std::size_t>(at)];
      const Seen& seen = spots_[static_cast<std::size_t>(spot[static_cast<std::size_t>(t)])];
      const Vector3d p = pose.R * (point(t) - centroid);
      const Vector2d r = seen.A * (p + shift) - seen.b;
      Eigen::Matrix<double, 2, 6> J;
      for (int row = 0; row < 2; ++row) {
        const Vector3d a = seen.A.row(row);
        J.row(row) << p.cross(a).transpose(), a.transpose();
      }
      information += J.transpose() * J;
      gradient += J.transpose() * r;
    }
    Eigen::Matrix<double, 6, 6> damped = information;
    damped.diagonal() *= 1.0 + damping;
    damped.diagonal().array() += 1e-12 * information.trace();  // parallel rays see no height
    const Eigen::Matrix<double, 6, 1> step = -damped.ldlt().solve(gradient);
    const Matrix3d R = rotation_from_vector(step.head<3>()) * pose.R;
    const Vector3d position = shift + step.tail<3>();
    const double trial = sum(R, position);
    if (!(trial <= S)) {
      if (!std::isfinite(trial) || damping > 1e3) break;
      damping *= 10.0;
      continue;
    }
    const double gain = S - trial;
    pose.R = R;
    shift = position;
    S = trial;
    damping *= 0.1;
    if (gain <= settled + 1e-3 * S) break;
  }
  pose.T = shift - pose.R * centroid;
  return S;
}

void Search::offer(const Assignment& spot, const Pose& pose, double S) {
  Candidate c{spot, 0, pose, S, 0.0, false};
  for (int t = 0; t < n_; ++t) c.matched += spot[static_cast<std::size_t>(t)] != kUnseen;
  if (c.matched < min_points_ || !allowed(pose)) return;
  const double sigma2 = options_.sigma_mm * options_.sigma_mm;
  c.Q = S / sigma2 + kPointGate * kPointGate * (n_ - c.matched);
  c.acceptable = S / sigma2 <= chi2_quantile(dof(c.matched), kNormalQuantile9999);
  if (!std::isfinite(c.Q)) return;
  // The same assignment, or a part of it, may come from several hypotheses.
  const auto same = std::ranges::find_if(
      kept_, [&](const Candidate& other) { return !different(other.spot, spot); });
  if (same != kept_.end()) {
    if (same->Q <= c.Q) return;
    kept_.erase(same);
  }
  kept_.insert(std::ranges::upper_bound(kept_, c.Q, {}, &Candidate::Q), c);
  if (kept_.size() > kKept) kept_.pop_back();
}

/// From the fit to four points to all that agree with it.
void Search::extend(Assignment spot, Pose pose) {
  if (n_ == 4) return offer(spot, pose, fit(spot, pose));
  double S = 0.0;
  for (const double gate : {4.0 * kPointGate * options_.sigma_mm, kPointGate * options_.sigma_mm}) {
    // Nearest pairs first, each spot once.
    struct Pair {
      double miss;
      int point, spot;
    };
    std::vector<Pair> pairs;
    for (int t = 0; t < n_; ++t) {
      const Vector3d x = pose.R * point(t) + pose.T;
      for (int j = 0; j < spot_count(); ++j) {
        const Seen& seen = spots_[static_cast<std::size_t>(j)];
        const double miss = (seen.A * x - seen.b).squaredNorm();
        if (miss < gate * gate) pairs.push_back({miss, t, j});
      }
    }
    std::ranges::sort(pairs, {}, &Pair::miss);
    spot.fill(kUnseen);
    std::array<bool, kMaxCorrespondenceSpots> taken{};
    int matched = 0;
    for (const Pair& pair : pairs) {
      int& of_point = spot[static_cast<std::size_t>(pair.point)];
      bool& of_spot = taken[static_cast<std::size_t>(pair.spot)];
      if (of_point != kUnseen || of_spot) continue;
      of_point = pair.spot;
      of_spot = true;
      ++matched;
    }
    if (matched < min_points_) return;
    S = fit(spot, pose);
  }
  if (min_points_ < n_) {
    std::vector<Vector3d> seen;
    for (int t = 0; t < n_; ++t)
      if (spot[static_cast<std::size_t>(t)] != kUnseen) seen.push_back(point(t));
    if (!TargetModel::refusal(seen).empty() || TargetModel(seen).coplanar()) return;
  }
  offer(spot, pose, S);
}

void Search::try_pose(const Basis& basis, const Triple& spots, const Pose& pose) {
  const int may_hide = n_ - min_points_;
  const auto near = [&](int t, double gate, const auto& use) {
    const Vector3d x = pose.R * point(t) + pose.T;
    const double depth = centre_.z() - x.z();
    if (!(depth > 0.0)) return;
    const Vector2d u = (x.head<2>() - centre_.head<2>()) / depth;
    const double limit = gate * gate / (depth * depth);
    for (int j = 0; j < spot_count(); ++j) {
      if ((spots_[static_cast<std::size_t>(j)].u - u).squaredNorm() < limit && j != spots[0] &&
          j != spots[1] && j != spots[2])
        if (use(j)) return;
    }
  };
  std::array<double, kMaxTargetPoints> gate_of{};
  int unseen = 0;
  for (std::size_t o = 0; o < basis.others.size(); ++o) {
    bool found = false;
    near(basis.others[o], basis.gate_mm[o], [&](int) { return found = true; });
    if (!found && ++unseen > may_hide) return;
    gate_of[static_cast<std::size_t>(basis.others[o])] = found ? basis.gate_mm[o] : 0.0;
  }
  // One fourth point that is seen would do; among may_hide + 1 of them one is.
  const double gate =
      1.5 * chi2_quantile(2.0, kNormalQuantile9999) * search_sigma_mm_ * search_sigma_mm_;
  int tried = 0;
  for (const int fourth : basis.fourths) {
    const double fourth_gate = gate_of[static_cast<std::size_t>(fourth)];
    if (fourth_gate == 0.0) continue;
    if (tried++ > std::min(may_hide, 2)) break;
    near(fourth, fourth_gate, [&](int j) {
      Assignment spot;
      spot.fill(kUnseen);
      for (std::size_t p = 0; p < 3; ++p)
        spot[static_cast<std::size_t>(basis.points[p])] = spots[p];
      spot[static_cast<std::size_t>(fourth)] = j;
      Pose fitted = pose;
      const double S = fit(spot, fitted);
      if (n_ == 4)
        offer(spot, fitted, S);
      else if (S < gate)
        extend(spot, fitted);
      return false;
    });
  }
}

void Search::try_triple(const Basis& basis, int i, int j, int k) {
  const Vector3d &y_1 = spots_[static_cast<std::size_t>(i)].direction,
                 &y_2 = spots_[static_cast<std::size_t>(j)].direction,
                 &y_3 = spots_[static_cast<std::size_t>(k)].direction;
  const P3pSolutions solutions = solve_p3p(y_1, y_2, y_3, basis.distances);
  for (int s = 0; s < solutions.count; ++s) {
    const Vector3d& range = solutions.ranges[static_cast<std::size_t>(s)];
    const Vector3d x_1 = centre_ + range[0] * y_1, x_2 = centre_ + range[1] * y_2,
                   x_3 = centre_ + range[2] * y_3;
    Pose pose;
    pose.R = triangle_frame(x_1, x_2, x_3) * basis.frame.transpose();
    if (!(pose.R(2, 2) > std::cos(options_.max_tilt_rad) - 0.2)) continue;
    pose.T = (x_1 + x_2 + x_3 -
              pose.R * (point(basis.points[0]) + point(basis.points[1]) + point(basis.points[2]))) /
             3.0;
    if (pose.T.allFinite()) try_pose(basis, {i, j, k}, pose);
  }
}

/// Rivals beside the best: a point takes a neighbouring spot, and whose that was takes the point's.
void Search::exchange_neighbours(const Candidate& best) {
  struct Exchange {
    double S;
    Assignment spot;
  };
  std::vector<Exchange> exchanges;
  const auto miss = [&](int t, int j) {
    const Seen& seen = spots_[static_cast<std::size_t>(j)];
    return (seen.A * (best.pose.R * point(t) + best.pose.T) - seen.b).squaredNorm();
  };
  for (int t = 0; t < n_; ++t) {
    const int old = best.spot[static_cast<std::size_t>(t)];
    if (old == kUnseen) continue;
    for (int j = 0; j < spot_count(); ++j) {
      if (j == old) continue;
      Exchange e{best.S - miss(t, old) + miss(t, j), best.spot};
      e.spot[static_cast<std::size_t>(t)] = j;
      const auto owner = std::ranges::find(best.spot, j);
      if (owner != best.spot.end()) {
        const int u = static_cast<int>(owner - best.spot.begin());
        if (u < t) continue;
        e.S += miss(u, old) - miss(u, j);
        e.spot[static_cast<std::size_t>(u)] = old;
      }
      exchanges.push_back(e);
    }
  }
  const auto few = exchanges.begin() + std::min<std::ptrdiff_t>(6, std::ssize(exchanges));
  std::ranges::partial_sort(exchanges, few, {}, &Exchange::S);
  for (auto e = exchanges.begin(); e != few; ++e) {
    Pose pose = best.pose;
    const double S = fit(e->spot, pose);
    offer(e->spot, pose, S);
  }
}

double Search::chance(const Candidate& c) const {
  const double k = c.matched, n = n_, m = spot_count();
  const double log_ways = std::lgamma(n + 1) - std::lgamma(k + 1) - std::lgamma(n - k + 1) +
                          std::lgamma(m + 1) - std::lgamma(m - k + 1);
  const double log_fit =
      (k - 3) * std::log(std::numbers::pi * c.S / area_mm2_) - std::lgamma(k - 2);
  return 2.0 * (n_ - min_points_ + 1) * std::exp(log_ways + log_fit);
}

AssignedPose Search::answer(const Candidate& c) const {
  AssignedPose out;
  for (int t = 0; t < n_; ++t) {
    const int spot = c.spot[static_cast<std::size_t>(t)];
    out.spot_of_point.push_back(spot == kUnseen ? kUnseen
                                                : spots_[static_cast<std::size_t>(spot)].index);
  }
  out.R_plane_from_target = c.pose.R;
  out.position_mm = c.pose.R * point(0) + c.pose.T;
  if (parallel_) out.position_mm.z() = Solution::kNaN;
  out.rms_mm = std::sqrt(c.S / c.matched);
  return out;
}

Correspondence Search::run() {
  Correspondence out;
  if (spot_count() < min_points_) return out;
  out.status = CorrespondenceStatus::kNoFit;
  if (!converging_ || !(area_mm2_ > 0.0)) return out;

  const int m = spot_count();
  for (const Triple& triple : triples()) {
    const Basis basis = basis_of(triple);
    for (int i = 0; i < m; ++i)
      for (int j = 0; j < m; ++j)
        for (int k = 0; k < m; ++k)
          if (i != j && j != k && i != k) try_triple(basis, i, j, k);
    if (!kept_.empty() && kept_[0].acceptable && chance(kept_[0]) < kOverwhelming) break;
  }
  if (kept_.empty() || !kept_[0].acceptable) return out;

  const Candidate found = kept_[0];
  if (min_points_ < n_) {
    // Rivals that hide other points show the same spots: three of them against all triples.
    std::vector<int> seen;
    for (const int spot : found.spot)
      if (spot != kUnseen) seen.push_back(spot);
    for (int a = 0; a < n_; ++a)
      for (int b = a + 1; b < n_; ++b)
        for (int c = b + 1; c < n_; ++c) {
          if (least_altitude(point(a), point(b), point(c)) <= kMinThickness * target_.radius_mm())
            continue;
          const Basis basis = basis_of({a, b, c});
          Triple spots{seen[0], seen[1], seen[2]};
          std::ranges::sort(spots);
          do try_triple(basis, spots[0], spots[1], spots[2]);
          while (std::ranges::next_permutation(spots).found);
        }
  }
  exchange_neighbours(found);

  const Candidate& best = kept_[0];
  out.ranked.push_back(answer(best));
  out.chance = chance(best);
  bool ambiguous = !(out.chance <= options_.max_chance);
  const auto rival = std::find_if(kept_.begin() + 1, kept_.end(),
                                  [&](const Candidate& c) { return different(c.spot, best.spot); });
  if (rival != kept_.end()) {
    out.ranked.push_back(answer(*rival));
    const double s2 = best.S / (options_.sigma_mm * options_.sigma_mm * dof(best.matched));
    ambiguous = ambiguous || rival->Q - best.Q < kMargin * kMargin * std::max(1.0, s2);
  }
  out.status = ambiguous ? CorrespondenceStatus::kAmbiguous : CorrespondenceStatus::kMatched;
  return out;
}

}  // namespace

std::string_view correspondence_status_name(CorrespondenceStatus status) {
  switch (status) {
    case CorrespondenceStatus::kMatched:
      return "matched";
    case CorrespondenceStatus::kAmbiguous:
      return "ambiguous";
    case CorrespondenceStatus::kTooFewSpots:
      return "too_few_spots";
    case CorrespondenceStatus::kNoFit:
      return "no_fit";
  }
  return "?";
}

Correspondence correspond(const TargetModel& target, std::span<const Ray> rays,
                          const RayPlanes& planes, const CorrespondenceOptions& options) {
  assert(options.sigma_mm > 0.0);
  assert(options.min_points == 0 ||
         (options.min_points >= 4 && options.min_points <= target.size()));
  return Search(target, rays, planes, options).run();
}

}  // namespace turntable
