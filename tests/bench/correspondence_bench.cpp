// Time per correspondence without a prediction, and the shares of the answers over the same seeded
// scenes: points of the target, image noise, spots that are no points, all points seen, tilts up to
// 40 deg at any turn about z. The rig's own target is all but symmetric: only attitudes within
// 45 deg of the upright one are drawn and looked for. A share of wrong matches above what
// `max_chance` allows fails the benchmark, and so do scenes of low noise that are not matched; time
// never does. The peer, rpg_monocular_pose_estimator (Faessler et al., ICRA 2014), votes over P3P
// hypotheses with a tolerance of 3 px; it is not linked.
#include <benchmark/benchmark.h>

#include <string>
#include <vector>

#include "src/attitude/correspondence.h"
#include "src/core/units.h"
#include "tests/attitude/correspondence_scenes.h"

namespace turntable {
namespace {

struct Case {
  int points;  ///< 0: the rig's target
  double noise_px;
  int strays;
};

void run(benchmark::State& state, const Case& c) {
  Random random(1, "correspondence benchmark");
  const bool rig = c.points == 0;
  const int scenes = c.points > 16 ? 30 : c.points > 8 ? 60 : 500;
  std::vector<problems::Scene> all;
  for (int k = 0; k < scenes; ++k) {
    const std::vector<Vector3d> points =
        rig ? problems::rig_target() : problems::spaced_target(random, c.points);
    const Vector3d origin(random.uniform(-50, 50), random.uniform(-50, 50),
                          random.uniform(120, 180));
    const Matrix3d turn = rotation_from_vector(
        {0, 0, rig ? 0.0 : random.uniform(-std::numbers::pi, std::numbers::pi)});
    all.push_back(problems::scene(
        random, problems::make(points, turn * problems::random_rotation(random, 40), origin),
        c.noise_px, c.strays));
  }
  const auto solve = [&](const problems::Scene& s) {
    CorrespondenceOptions options;
    options.sigma_mm = s.sigma_mm;
    options.max_tilt_rad = rad_from_deg(45.0);
    if (rig) options.max_turn_rad = rad_from_deg(45.0);
    return correspond(TargetModel(s.truth.target_mm), s.rays, problems::kPlanes, options);
  };
  double right = 0, wrong = 0, ambiguous = 0;
  for (const problems::Scene& s : all) {
    const Correspondence found = solve(s);
    ambiguous += found.status == CorrespondenceStatus::kAmbiguous;
    if (found.status != CorrespondenceStatus::kMatched) continue;
    ++(found.ranked[0].spot_of_point == s.spot_of_point ? right : wrong);
  }
  if (wrong > 0.01 * scenes) {
    state.SkipWithError("matched wrongly");
    return;
  }
  if (c.noise_px < 0.1 && right < 0.95 * scenes) {
    state.SkipWithError("rarely matched");
    return;
  }
  std::size_t next = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(solve(all[next]));
    if (++next == all.size()) next = 0;
  }
  state.counters["right"] = right / scenes;
  state.counters["wrong"] = wrong / scenes;
  state.counters["ambiguous"] = ambiguous / scenes;
  state.counters["none"] = (scenes - right - wrong - ambiguous) / scenes;
}

const bool kRegistered = [] {
  std::vector<Case> cases;
  for (const int points : {0, 4, 8, 16, 32})
    for (const double noise_px : {0.05, 0.5})
      for (const int strays : {0, 2, 4}) cases.push_back({points, noise_px, strays});
  cases.push_back({32, 0.05, 8});
  for (const Case& c : cases)
    benchmark::RegisterBenchmark(
        ("correspondence/" + (c.points == 0 ? "rig" : std::to_string(c.points) + "_points") + "/" +
         (c.noise_px < 0.1 ? "0.05px" : "0.5px") + "/" + std::to_string(c.strays) + "_strays")
            .c_str(),
        run, c)
        ->Unit(benchmark::kMillisecond);
  return true;
}();

}  // namespace
}  // namespace turntable

BENCHMARK_MAIN();
