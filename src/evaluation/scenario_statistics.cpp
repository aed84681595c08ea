#include "src/evaluation/scenario_statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include "src/core/parallel.h"
#include "src/evaluation/clustered_bootstrap.h"
#include "src/evaluation/direction_effect.h"

namespace turntable {
namespace {

/// A measured pose of a scenario, and how each told axis came to it: +1 up, -1 down, 0 not moved yet.
struct Visit {
  const EvaluatedPose* pose;
  std::array<int, 3> direction;
};

/// Visits of one scenario, by the angles that they were sent to, in the order of the first visit.
struct Visited {
  std::size_t scenario;
  std::vector<Visit> visits;
  std::vector<std::vector<std::size_t>> by_angles;  ///< places in `visits`
};

std::vector<Visited> visited_scenarios(const Evaluation& evaluation) {
  std::vector<Visited> out;
  std::map<std::size_t, std::size_t> place;  // scenario -> in out
  std::vector<std::map<std::tuple<double, double, double, double>, std::size_t>> angles;
  const std::vector<std::array<int, 3>> directions = approach_directions(evaluation);
  for (std::size_t k = 0; k < evaluation.poses.size(); ++k) {
    const EvaluatedPose& pose = evaluation.poses[k];
    const PlannedPose& p = pose.planned;
    if (p.role != PoseRole::kMeasure) continue;
    const auto [it, is_new] = place.try_emplace(p.scenario, out.size());
    if (is_new) {
      out.push_back({p.scenario, {}, {}});
      angles.emplace_back();
    }
    Visited& v = out[it->second];
    const auto [group, first] = angles[it->second].try_emplace(
        std::tuple(p.stage_mm, p.yaw_deg, p.roll_deg, p.pitch_deg), v.by_angles.size());
    if (first) v.by_angles.emplace_back();
    v.by_angles[group->second].push_back(v.visits.size());
    v.visits.push_back({&pose, directions[k]});
  }
  return out;
}

/// For every group the sum of `of(visit)` where it is finite.
template <class Of>
std::vector<ClusterSum> sums_of(const Visited& v, const Of& of) {
  std::vector<ClusterSum> out(v.by_angles.size());
  for (std::size_t g = 0; g < out.size(); ++g)
    for (const std::size_t k : v.by_angles[g])
      if (const double x = of(v.visits[k]); std::isfinite(x)) {
        out[g].sum += x;
        out[g].count += 1.0;
      }
  return out;
}

/// Where the same angles were come to from both sides, these are compared; else all poses at one angle of the axis.
WithInterval direction_effect_of(const Visited& v, std::size_t told, std::size_t solver_place) {
  const auto errors = [&](const auto& place_of) {
    std::vector<DirectedError> out;
    for (std::size_t g = 0; g < v.by_angles.size(); ++g)
      for (const std::size_t k : v.by_angles[g]) {
        const PoseResult& r = v.visits[k].pose->results[solver_place];
        const int direction = v.visits[k].direction[told];
        if (r.measured && direction != 0)
          out.push_back({place_of(g), v.visits[k].pose->planned.repeat, direction,
                         error_of(r.error, kToldAxes[told])});
      }
    return out;
  };
  const WithInterval same = direction_effect(errors([](std::size_t g) { return g; }));
  if (std::isfinite(same.interval.lower)) return same;
  std::map<double, std::size_t> angles;
  return direction_effect(errors([&](std::size_t g) {
    const double at = v.visits[v.by_angles[g].front()].pose->planned.target(kToldAxes[told]);
    return angles.try_emplace(at, angles.size()).first->second;
  }));
}

ScenarioStatistics statistics_of(const Visited& v, std::size_t solver_place, const Solver* solver) {
  ScenarioStatistics out;
  out.scenario = v.scenario;
  out.solver = solver;
  std::vector<PoseError> errors;
  for (const Visit& visit : v.visits) {
    out.repeats = std::max(out.repeats, visit.pose->planned.repeat);
    if (const PoseResult& r = visit.pose->results[solver_place]; r.measured)
      errors.push_back(r.error);
  }
  out.pooled = error_statistics(errors, v.visits.size() - errors.size());
  const auto result = [&](const Visit& visit) -> const PoseResult& {
    return visit.pose->results[solver_place];
  };
  out.rmse_total_deg = clustered<1>({sums_of(v,
                                             [&](const Visit& visit) {
                                               return result(visit).measured
                                                          ? squared_error(result(visit).error)
                                                          : Solution::kNaN;
                                             })},
                                    [](const auto& s) { return cluster_rms(s[0]); });
  for (std::size_t a = 0; a < 3; ++a) {
    AxisDetail& detail = out.axes[a];
    const AxisId axis = kToldAxes[a];
    std::vector<double> magnitudes;
    for (const PoseError& e : errors) magnitudes.push_back(std::abs(error_of(e, axis)));
    detail.percentile95_deg = percentile(magnitudes, 0.95);

    double squares = 0.0, freedom = 0.0;
    for (const std::vector<std::size_t>& group : v.by_angles) {
      std::vector<double> same;
      for (const std::size_t k : group)
        if (result(v.visits[k]).measured) same.push_back(error_of(result(v.visits[k]).error, axis));
      if (same.size() < 2) continue;
      const double s = standard_deviation(same);
      squares += s * s * static_cast<double>(same.size() - 1);
      freedom += static_cast<double>(same.size() - 1);
    }
    detail.repeatability_deg = freedom > 0.0 ? std::sqrt(squares / freedom) : Solution::kNaN;

    detail.forward_minus_backward_deg = direction_effect_of(v, a, solver_place);
  }
  return out;
}

PairedComparison compare(const Visited& v, const Evaluation& evaluation, std::size_t first,
                         std::size_t other) {
  PairedComparison out;
  out.scenario = v.scenario;
  out.first = evaluation.solvers[first];
  out.other = evaluation.solvers[other];
  std::size_t nearer = 0;
  for (const Visit& visit : v.visits) {
    const PoseResult &a = visit.pose->results[first], &b = visit.pose->results[other];
    if (a.measured && b.measured) {
      ++out.poses;
      nearer += squared_error(b.error) < squared_error(a.error);
    } else {
      out.only_first += a.measured;
      out.only_other += b.measured;
    }
  }
  out.share_other_nearer = out.poses == 0
                               ? Solution::kNaN
                               : static_cast<double>(nearer) / static_cast<double>(out.poses);
  const auto of = [&](std::size_t solver) {
    return sums_of(v, [&, solver](const Visit& visit) {
      const auto& r = visit.pose->results;
      return r[first].measured && r[other].measured ? squared_error(r[solver].error)
                                                    : Solution::kNaN;
    });
  };
  out.first_rmse_deg =
      clustered<1>({of(first)}, [](const auto& s) { return cluster_rms(s[0]); }).value;
  out.change_deg = clustered<2>(
      {of(first), of(other)}, [](const auto& s) { return cluster_rms(s[1]) - cluster_rms(s[0]); });
  return out;
}

Iso230 iso230_of(const Visited& v, std::size_t solver_place, const Solver* solver, AxisId axis) {
  Iso230 out;
  out.scenario = v.scenario;
  out.solver = solver;
  out.axis = axis;
  const std::size_t told =
      static_cast<std::size_t>(std::ranges::find(kToldAxes, axis) - kToldAxes.begin());
  struct OneWay {
    double mean, s;
  };
  struct Position {
    std::optional<OneWay> up, down;
  };
  std::vector<Position> positions;
  std::size_t fewest = std::numeric_limits<std::size_t>::max();
  for (const std::vector<std::size_t>& group : v.by_angles) {
    const auto one_way = [&](int direction) -> std::optional<OneWay> {
      std::vector<double> deviations;
      for (const std::size_t k : group)
        if (const Visit& visit = v.visits[k];
            visit.direction[told] == direction && visit.pose->results[solver_place].measured)
          deviations.push_back(error_of(visit.pose->results[solver_place].error, axis));
      if (deviations.empty()) return {};
      fewest = std::min(fewest, deviations.size());
      return OneWay{mean(deviations), standard_deviation(deviations)};
    };
    Position p{one_way(1), one_way(-1)};
    if (p.up || p.down) positions.push_back(p);
  }
  out.positions = positions.size();
  if (positions.empty()) return out;
  out.approaches = static_cast<int>(fewest);
  // The first position is the end where a sweep turns round: it may know one direction only.
  out.bidirectional =
      std::ranges::any_of(positions, [](const Position& p) { return p.up && p.down; });

  double lowest = 1e300, highest = -1e300, lowest_limit = 1e300, highest_limit = -1e300;
  double lowest_mean = 1e300, highest_mean = -1e300, largest_spread = 0.0, largest_reversal = 0.0;
  std::size_t used = 0;
  for (const Position& p : positions) {
    if (out.bidirectional && !(p.up && p.down)) continue;
    ++used;
    for (const auto& way : {p.up, p.down}) {
      if (!way) continue;
      lowest = std::min(lowest, way->mean);
      highest = std::max(highest, way->mean);
      lowest_limit = std::min(lowest_limit, way->mean - 2.0 * way->s);
      highest_limit = std::max(highest_limit, way->mean + 2.0 * way->s);
      largest_spread = std::max(largest_spread, 4.0 * way->s);
    }
    if (p.up && p.down) {
      const double reversal = p.up->mean - p.down->mean, middle = 0.5 * (p.up->mean + p.down->mean);
      largest_reversal = std::max(largest_reversal, std::abs(reversal));
      largest_spread =
          std::max(largest_spread, 2.0 * p.up->s + 2.0 * p.down->s + std::abs(reversal));
      lowest_mean = std::min(lowest_mean, middle);
      highest_mean = std::max(highest_mean, middle);
    }
  }
  const bool range = used > 1;
  if (range) out.systematic_deg = highest - lowest;
  if (out.approaches > 1) {  // of one approach nothing is known of s
    if (range) out.accuracy_deg = highest_limit - lowest_limit;
    out.repeatability_deg = largest_spread;
  }
  if (out.bidirectional) {
    if (range) out.mean_range_deg = highest_mean - lowest_mean;
    out.reversal_deg = largest_reversal;
  }
  return out;
}

}  // namespace

std::vector<std::array<int, 3>> approach_directions(const Evaluation& evaluation) {
  std::vector<std::array<int, 3>> out;
  std::array<double, 3> last{0.0, 0.0, 0.0};
  std::array<int, 3> direction{0, 0, 0};
  for (const EvaluatedPose& pose : evaluation.poses) {
    for (std::size_t a = 0; a < 3; ++a) {
      const double target = pose.planned.target(kToldAxes[a]);
      if (target != last[a]) direction[a] = target > last[a] ? 1 : -1;
      last[a] = target;
    }
    out.push_back(direction);
  }
  return out;
}

std::vector<ScenarioStatistics> scenario_statistics(const Evaluation& evaluation) {
  const std::vector<Visited> scenarios = visited_scenarios(evaluation);
  const std::size_t solvers = evaluation.solvers.size();
  std::vector<ScenarioStatistics> out(scenarios.size() * solvers);
  parallel_for(out.size(), [&](std::size_t i) {
    out[i] = statistics_of(scenarios[i / solvers], i % solvers, evaluation.solvers[i % solvers]);
  });
  return out;
}

ChangeVerdict change_verdict(const WithInterval& change, double first) {
  if (!std::isfinite(change.value)) return ChangeVerdict::kNothing;
  if (!std::isfinite(change.interval.lower)) return ChangeVerdict::kTooFew;
  const double little = 0.01 * first;
  if (change.interval.lower > -little && change.interval.upper < little)
    return ChangeVerdict::kSame;
  if (change.interval.upper < 0.0) return ChangeVerdict::kBetter;
  if (change.interval.lower > 0.0) return ChangeVerdict::kWorse;
  return ChangeVerdict::kCannotTell;
}

std::string_view change_verdict_name(ChangeVerdict verdict) {
  switch (verdict) {
    case ChangeVerdict::kBetter:
      return "better";
    case ChangeVerdict::kWorse:
      return "worse";
    case ChangeVerdict::kSame:
      return "the same within 1 %";
    case ChangeVerdict::kCannotTell:
      return "not told apart";
    case ChangeVerdict::kTooFew:
      return "too few poses";
    case ChangeVerdict::kNothing:
      return "not compared";
  }
  return "?";
}

std::vector<PairedComparison> paired_comparisons(const Evaluation& evaluation) {
  const std::vector<Visited> scenarios = visited_scenarios(evaluation);
  struct Pair {
    std::size_t scenario, first, other;
  };
  std::vector<Pair> pairs;
  for (std::size_t s = 0; s < scenarios.size(); ++s)
    for (std::size_t a = 0; a < evaluation.solvers.size(); ++a)
      for (std::size_t b = a + 1; b < evaluation.solvers.size(); ++b) pairs.push_back({s, a, b});
  std::vector<PairedComparison> out(pairs.size());
  parallel_for(pairs.size(), [&](std::size_t i) {
    out[i] = compare(scenarios[pairs[i].scenario], evaluation, pairs[i].first, pairs[i].other);
  });
  return out;
}

std::vector<Iso230> iso230(const Evaluation& evaluation, const Plan& plan) {
  std::vector<Iso230> out;
  for (const Visited& v : visited_scenarios(evaluation)) {
    const ScenarioInfo& info = plan.scenarios[v.scenario];
    if (info.axes.size() != 1) continue;
    for (std::size_t k = 0; k < evaluation.solvers.size(); ++k)
      out.push_back(iso230_of(v, k, evaluation.solvers[k], info.axes.front()));
  }
  return out;
}

}  // namespace turntable
