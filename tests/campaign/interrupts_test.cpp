// Every state of a run against everything that can interrupt it. Whatever comes when: what was taken
// is kept, the stop document is there, the axes stand within one poll of being told, and a run that
// goes on ends with every pose taken once.
#include <fmt/format.h>
#include <gmock/gmock.h>

#include <csignal>
#include <nlohmann/json.hpp>
#include <set>

#include "src/campaign/planning.h"
#include "src/campaign/runner.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/verify.h"
#include "tests/support/fake_rig.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

enum class Interruption { kPause, kCtrlC, kCtrlCTwice, kTerminate, kHangUp, kStop };

struct MatrixCase {
  const char* state;  ///< phase that the run reports
  Interruption interruption;
};

constexpr const char* kStates[] = {"homing",   "mounting", "moving",    "settling",
                                   "exposing", "paused",   "suspended", "finishing"};
constexpr std::pair<Interruption, const char*> kInterruptions[] = {
    {Interruption::kPause, "pause"},         {Interruption::kCtrlC, "ctrl_c"},
    {Interruption::kCtrlCTwice, "ctrl_c_2"}, {Interruption::kTerminate, "sigterm"},
    {Interruption::kHangUp, "sighup"},       {Interruption::kStop, "stop"}};

void interrupt(Interruption what) {
  switch (what) {
    case Interruption::kPause:  // turntable pause RUN
      return request_pause(true);
    case Interruption::kCtrlCTwice:
      std::raise(SIGINT);
      [[fallthrough]];
    case Interruption::kCtrlC:
      std::raise(SIGINT);
      return;
    case Interruption::kTerminate:
      std::raise(SIGTERM);
      return;
    case Interruption::kHangUp:
      std::raise(SIGHUP);
      return;
    case Interruption::kStop:  // turntable stop RUN
      return set_interrupt_level(2);
  }
}

class InterruptMatrix : public ::testing::TestWithParam<MatrixCase> {
 protected:
  void SetUp() override {
    for (const int signal : kSignals) ::sigaction(signal, nullptr, &saved_[signal]);
    install_interrupt_handlers();
    set_interrupt_level(0);
    request_pause(false);
    rig_file = load_rig_file(std::filesystem::path(TURNTABLE_SOURCE_DIR) /
                             "scenarios/rigs/simulated.json");
    rig_file.camera.image_size = {64, 48};
    rig_file.inspection.retakes = 0;
    ChannelConfig room;
    room.name = "room";
    room.unit = "degC";
    room.hold = {18.0, 24.0, 19.0, 23.0, 1.0, 0.0};
    rig_file.telemetry.channels = {room};
    rig_file.telemetry.every_s = 0.1;  // before every pose
    fake.rig.channels = {{"room", [this] { return room_degc; }}};
    Campaign campaign;
    campaign.name = campaign.title = "matrix";
    campaign.scenarios = {parse_scenario(
        R"({"format": "turntable-scenario/1", "name": "m", "title": "M", "kind": "attitude",
            "stage_mm": 120, "dwell_ms": 100,
            "ranges": [{"axis": "pitch", "values_deg": [-10, 10]},
                       {"axis": "yaw", "values_deg": [1, 2, 3]}]})",
        "m.json")};
    plan = plan_campaign(campaign, rig_file);
  }
  void TearDown() override {
    for (const int signal : kSignals) ::sigaction(signal, &saved_[signal], nullptr);
    set_interrupt_level(0);
    request_pause(false);
  }

  AcquireSummary take(const RunFolder& folder, const RunRecord* before) {
    AcquireOptions options;
    options.archive = ArchiveMode::kNone;
    options.before = before;
    return acquire(fake.rig, rig_file, plan, folder, {{"version", "test"}}, options,
                   [this](const Progress& p) { watch(p); });
  }

  void watch(const Progress& p) {
    const auto [state, interruption] = GetParam();
    const bool late = p.done >= 3 || p.phase == "homing" || p.phase == "mounting";
    // What leads to the state, if the run does not come there by itself.
    if (p.done == 3 && !interrupted) {
      if (std::string_view(state) == "paused") request_pause(true);
      if (std::string_view(state) == "suspended") room_degc = 30.0;
    }
    if (p.phase == state && late && !interrupted) {
      interrupted = true;
      moves_before = advances;
      interrupt(interruption);
      return;
    }
    if (!interrupted) return;
    if (p.phase == "suspended") room_degc = 21.0;
    // Somebody says that it goes on.
    if (p.phase == "paused" && ++paused_reports == 3) request_pause(false);
  }

  static constexpr int kSignals[] = {SIGINT, SIGTERM, SIGHUP, SIGPIPE};
  TemporaryFolder temporary;
  FakeRig fake{Image({64, 48}, 10)};
  RigFile rig_file;
  Plan plan;
  double room_degc = 21.0;
  bool interrupted = false;
  int paused_reports = 0, advances = 0, moves_before = 0;

 private:
  struct sigaction saved_[NSIG] = {};
};

TEST_P(InterruptMatrix, KeepsWhatWasTakenAndGoesOnToTheEnd) {
  const auto [state, interruption] = GetParam();
  const std::string_view in(state);
  for (auto* axis : {&fake.yaw, &fake.roll, &fake.pitch}) axis->on_advance = [this] { ++advances; };
  const RunFolder folder = RunFolder::create(temporary / "run", plan);
  const bool asks_to_wait =
      interruption == Interruption::kPause || interruption == Interruption::kCtrlC;
  // A first Ctrl-C in a pause is one more than what led there; nothing is left to end when all is
  // taken.
  const bool ends = in != "finishing" &&
                    (!asks_to_wait || (in == "paused" && interruption == Interruption::kCtrlC));
  if (ends) {
    EXPECT_THROW(take(folder, nullptr), Interrupted);
    EXPECT_GE(fake.stops(), 4) << "every axis is told to stop";
    EXPECT_FALSE(fake.moving());
    EXPECT_LE(advances - moves_before, 3) << "one poll of each axis at most";
    set_interrupt_level(0);
    room_degc = 21.0;
    const RunRecord before = read_run(folder);
    EXPECT_EQ(before.exit_status, "abort");
    EXPECT_THAT(before.reason, ::testing::HasSubstr("interrupted"));
    EXPECT_FALSE(before.complete());
    const std::size_t taken = before.poses.size();
    take(folder, &before);
    const RunRecord after = read_run(folder);
    EXPECT_EQ(after.sessions.size(), 2u);
    for (std::size_t i = 0; i < taken; ++i)
      EXPECT_EQ(after.poses[i].images[0].frame_id, before.poses[i].images[0].frame_id);
  } else {
    take(folder, nullptr);
    EXPECT_EQ(fake.stops(), 0);
  }
  set_interrupt_level(0);
  EXPECT_TRUE(interrupted) << "the run never came into this state";
  const RunRecord record = read_run(folder);
  EXPECT_TRUE(record.complete());
  EXPECT_EQ(record.exit_status, "success");

  int counted = 0;
  std::set<std::string> ids;
  std::vector<std::string> waits;
  read_journal(folder.journal(), [&](const JournalEntry& entry) {
    if (entry.name != "event") return;
    const Json& data = entry.doc.at("data");
    if (data.contains("interruption")) waits.push_back(data.at("interruption"));
    if (!data.contains("pose_id")) return;
    ++counted;
    ids.insert(data.at("pose_id").get<std::string>());
  });
  EXPECT_EQ(ids.size(), plan.poses.size());
  EXPECT_EQ(counted, static_cast<int>(plan.poses.size() + record.overlaps.size()));
  if (asks_to_wait && !ends && in != "finishing") {
    EXPECT_THAT(waits, ::testing::Contains(in == "suspended" ? "suspend" : "pause"));
  }
  EXPECT_EQ(waits.size() % 2, ends && (in == "suspended") ? 1u : 0u) << "each wait has its end";
  EXPECT_TRUE(verify_run(folder).sound());
}

std::vector<MatrixCase> all_cases() {
  std::vector<MatrixCase> cases;
  for (const char* state : kStates)
    for (const auto& [interruption, name] : kInterruptions) cases.push_back({state, interruption});
  return cases;
}

std::string case_name(const ::testing::TestParamInfo<MatrixCase>& tested) {
  const auto named = std::ranges::find(kInterruptions, tested.param.interruption,
                                       &std::pair<Interruption, const char*>::first);
  return fmt::format("{}_{}", tested.param.state, named->second);
}

INSTANTIATE_TEST_SUITE_P(States, InterruptMatrix, ::testing::ValuesIn(all_cases()), case_name);

}  // namespace
}  // namespace turntable
