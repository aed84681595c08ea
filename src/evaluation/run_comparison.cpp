#include "src/evaluation/run_comparison.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <tuple>

#include "src/core/parallel.h"
#include "src/evaluation/clustered_bootstrap.h"

namespace turntable {
namespace {

/// Stage, yaw, roll and pitch as planned, mm and deg.
using Place = std::tuple<double, double, double, double>;
/// Place, repeat, number of the visit.
using VisitKey = std::tuple<Place, int, int>;
using PosesByVisit = std::map<VisitKey, const EvaluatedPose*>;

/// Poses to be judged, by scenario name.
std::map<std::string, PosesByVisit> judged_poses(const Evaluation& evaluation, const Plan& plan) {
  std::map<std::string, PosesByVisit> out;
  for (const EvaluatedPose& pose : evaluation.poses) {
    const PlannedPose& p = pose.planned;
    if (p.role != PoseRole::kMeasure) continue;
    PosesByVisit& poses = out[plan.scenario_of(p).name];
    VisitKey key{{p.stage_mm, p.yaw_deg, p.roll_deg, p.pitch_deg}, p.repeat, 0};
    while (poses.contains(key)) ++std::get<2>(key);
    poses[key] = &pose;
  }
  return out;
}

/// What a solver has of a pose; nullptr if it measured none.
const PoseResult* result_of(const EvaluatedPose& pose, const Solver* solver) {
  const auto found = std::ranges::find(pose.results, solver, &PoseResult::solver);
  return found != pose.results.end() && found->measured ? &*found : nullptr;
}

RunChange change_of(const std::string& scenario, const Solver* solver, const PosesByVisit& first,
                    const PosesByVisit& other) {
  RunChange out;
  out.scenario = scenario;
  out.solver = solver;
  // Results of either run, and whether the other one has a partner.
  struct Measured {
    Place place;
    const PoseResult* result;
    bool has_partner;
  };
  const auto judged = [&](const PosesByVisit& mine, const PosesByVisit& theirs,
                          std::size_t& failed) {
    std::vector<Measured> list;
    for (const auto& [key, pose] : mine) {
      const PoseResult* result = result_of(*pose, solver);
      if (result == nullptr) {
        ++failed;
        continue;
      }
      const auto partner = theirs.find(key);
      list.push_back({std::get<0>(key), result,
                      partner != theirs.end() && result_of(*partner->second, solver) != nullptr});
    }
    return list;
  };
  std::array<std::vector<Measured>, 2> runs{judged(first, other, out.first_failed),
                                            judged(other, first, out.other_failed)};
  const auto pairs =
      static_cast<std::size_t>(std::ranges::count_if(runs[0], &Measured::has_partner));
  out.paired = pairs > 0 && 2 * pairs >= std::min(runs[0].size(), runs[1].size());
  if (out.paired)
    for (std::vector<Measured>& run : runs) std::erase_if(run, std::not_fn(&Measured::has_partner));
  out.first_poses = runs[0].size();
  out.other_poses = runs[1].size();

  std::map<Place, std::size_t> clusters;
  for (const std::vector<Measured>& run : runs)
    for (const Measured& j : run) clusters.try_emplace(j.place, clusters.size());
  const auto columns = [&](const auto& of) {
    std::array<std::vector<ClusterSum>, 2> sums;
    for (std::size_t r = 0; r < 2; ++r) {
      sums[r].resize(clusters.size());
      for (const Measured& j : runs[r]) sums[r][clusters.at(j.place)].add(of(j.result->error));
    }
    return sums;
  };
  const auto squares = columns([](const PoseError& e) { return squared_error(e); });
  const auto rmse = [](const std::vector<ClusterSum>& sums) {
    ClusterSum all;
    for (const ClusterSum& s : sums) all.sum += s.sum, all.count += s.count;
    return cluster_rms(all);
  };
  out.first_rmse_deg = rmse(squares[0]);
  out.other_rmse_deg = rmse(squares[1]);
  out.change_deg =
      clustered(squares, [](const auto& s) { return cluster_rms(s[1]) - cluster_rms(s[0]); });
  out.change_share =
      clustered(squares, [](const auto& s) { return cluster_rms(s[1]) / cluster_rms(s[0]) - 1.0; });
  for (std::size_t a = 0; a < kToldAxes.size(); ++a)
    out.bias_change_deg[a] =
        clustered(columns([&](const PoseError& e) { return error_of(e, kToldAxes[a]); }),
                  [](const auto& s) { return cluster_mean(s[1]) - cluster_mean(s[0]); });
  return out;
}

std::string json_text(const Json* value) {
  if (value == nullptr) return "-";
  return value->is_string() ? value->get<std::string>() : value->dump();
}

}  // namespace

RunComparison compare_runs(const Evaluation& first, const Plan& first_plan, const Evaluation& other,
                           const Plan& other_plan) {
  RunComparison out;
  const auto poses = judged_poses(first, first_plan), other_poses = judged_poses(other, other_plan);
  std::vector<const Solver*> solvers;
  const auto has = [](const Evaluation& evaluation, const Solver* solver) {
    return std::ranges::find(evaluation.solvers, solver) != evaluation.solvers.end();
  };
  for (const Solver* solver : first.solvers)
    if (has(other, solver))
      solvers.push_back(solver);
    else
      out.only_first.push_back("solver " + std::string(solver->name));
  for (const Solver* solver : other.solvers)
    if (!has(first, solver)) out.only_other.push_back("solver " + std::string(solver->name));

  struct Both {
    const PosesByVisit *first, *other;
  };
  std::vector<Both> common;
  for (const ScenarioInfo& info : first_plan.scenarios) {
    const auto mine = poses.find(info.name);
    if (mine == poses.end()) continue;
    const auto theirs = other_poses.find(info.name);
    if (theirs == other_poses.end()) {
      out.only_first.push_back(info.name);
      continue;
    }
    CommonScenario& scenario = out.scenarios.emplace_back();
    scenario.name = info.name;
    for (const auto& [key, pose] : mine->second)
      ++(theirs->second.contains(key) ? scenario.both : scenario.only_first);
    scenario.only_other = theirs->second.size() - scenario.both;
    common.push_back({&mine->second, &theirs->second});
  }
  for (const ScenarioInfo& info : other_plan.scenarios)
    if (other_poses.contains(info.name) && !poses.contains(info.name))
      out.only_other.push_back(info.name);

  out.changes.resize(common.size() * solvers.size());
  parallel_for(out.changes.size(), [&](std::size_t i) {
    const std::size_t s = i / solvers.size();
    out.changes[i] = change_of(out.scenarios[s].name, solvers[i % solvers.size()], *common[s].first,
                               *common[s].other);
  });
  return out;
}

std::vector<RunFact> json_differences(const std::string& what, const Json& first,
                                      const Json& other) {
  const Json mine = first.flatten(), theirs = other.flatten();
  std::set<std::string> places;
  for (const Json* flat : {&mine, &theirs})
    for (const auto& [place, value] : flat->items()) places.insert(place);
  std::vector<RunFact> out;
  for (const std::string& place : places) {
    const auto a = mine.find(place), b = theirs.find(place);
    const Json* was = a == mine.end() ? nullptr : &*a;
    const Json* is = b == theirs.end() ? nullptr : &*b;
    if (was != nullptr && is != nullptr && *was == *is) continue;
    out.push_back({what, place, json_text(was), json_text(is)});
  }
  return out;
}

std::vector<RunFact> plan_differences(const Plan& first, const Plan& other) {
  std::vector<RunFact> out =
      json_differences("rig file", parse_json(first.rig.text, first.rig.file, "rig"),
                       parse_json(other.rig.text, other.rig.file, "rig"));
  const auto files = [](const Plan& plan) {
    Json json = Json::object();
    for (const FrozenText& source : plan.sources)
      json[std::filesystem::path(source.file).filename().string()] = source.sha256.substr(0, 16);
    return json;
  };
  for (RunFact& fact : json_differences("scenario file", files(first), files(other)))
    out.push_back(std::move(fact));
  if (first.poses.size() != other.poses.size())
    out.push_back(
        {"plan", "poses", std::to_string(first.poses.size()), std::to_string(other.poses.size())});
  return out;
}

}  // namespace turntable
