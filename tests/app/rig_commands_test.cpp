// The rig by hand, on devices that another process serves as if they were real: status, home, move,
// stop, devices; one mover at a time; faults from a file.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/app/background_program.h"
#include "tests/app/program.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

void replace(std::string& text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  ASSERT_NE(at, std::string::npos) << "no " << from;
  text.replace(at, from.size(), to);
}

/// A rig file whose lines are served by `simulate`, four times as fast as real ones: on a busy machine
/// a moment's pause of either process must not look like a stalled axis.
class ServedRig : public ::testing::Test {
 protected:
  /// @param lines for each controller in turn: "pty", or how its line is stated.
  void serve(const std::string& rig, const std::vector<std::string>& lines,
             const std::string& options = "", const std::string& more_from = "",
             const std::string& more_to = "") {
    std::string text = slurp(kScenarios / "rigs" / (rig + ".json"));
    for (std::size_t i = 0; i < lines.size(); ++i)
      replace(text, R"("line": {"simulated": {}})",
              R"("line": )" + (lines[i] == "pty"
                                   ? R"({"serial": {"port": ")" +
                                         (folder / ("mc" + std::to_string(i + 1))).string() + "\"}}"
                                   : lines[i]));
    replace(text, "../calibration_sweep.json", (kScenarios / "calibration_sweep.json").string());
    if (!more_from.empty()) replace(text, more_from, more_to);
    spill(file, text);
    server =
        std::make_unique<BackgroundProgram>("simulate " + file.string() + " --speed 4 --links " +
                                                folder.path().string() + " " + options,
                                            folder / "server.log");
    ASSERT_TRUE(server->prints(lines.back().find("port\": 1") == std::string::npos ? "/dev/pts/"
                                                                                   : "127.0.0.1:"))
        << server->output();
  }
  Outcome rig(const std::string& verb, const std::string& more = "") {
    return turntable_program(verb + " --rig " + file.string() + " --speed 4 " + more);
  }
  static std::string tcp(const std::string& kind, int port) {
    return "{\"" + kind + R"(": {"host": "127.0.0.1", "port": )" + std::to_string(port) + "}}";
  }

  TemporaryFolder folder;
  fs::path file = folder / "rig.json";
  std::unique_ptr<BackgroundProgram> server;
};

TEST_F(ServedRig, IsHomedAndMovedAndAskedByHand) {
  serve("two_zc300", {"pty", tcp("modbus_tcp", 15021)});
  Outcome o = rig("status");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("ZC300-3A serial"));
  EXPECT_THAT(o.output, HasSubstr("yaw "));
  EXPECT_THAT(o.output, HasSubstr("What this program assumes of a zolix-zc300 and no manual"));
  EXPECT_THAT(o.output, HasSubstr("Check the angle of the first move."));

  o = rig("move yaw 10");
  EXPECT_EQ(o.code, 2);
  EXPECT_THAT(o.output, HasSubstr("--homed"));
  o = rig("move yaw 10", "--homed");  // the controller knows better
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("not been homed since it was switched on"));

  o = rig("home");
  ASSERT_EQ(o.code, 0) << o.output;
  o = rig("move yaw 10 pitch -5.5", "--homed --wire-log " + (folder / "wire.log").string());
  ASSERT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("10.00000 deg"));
  EXPECT_THAT(o.output, HasSubstr("-5.50000 deg"));
  EXPECT_THAT(slurp(folder / "wire.log"), HasSubstr("mc1 > 01 04 75 3b 00 0a"));
  o = rig("move yaw -2.5", "--relative --homed");
  ASSERT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("7.50000 deg"));
  o = rig("move yaw 95", "--homed");
  EXPECT_EQ(o.code, 2);
  EXPECT_THAT(o.output, HasSubstr("Nothing was sent"));
  for (const char* wrong : {"move yaw", "move jaw 3 --home", "move yaw ten --home",
                            "move yaw 1 yaw 2 --home", "move yaw 1 --home --homed", "home jaw"})
    EXPECT_EQ(rig(wrong).code, 2) << wrong;
  o = rig("stop");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("all axes stand"));
  EXPECT_THAT(o.output, HasSubstr("7.50000"));
}

TEST_F(ServedRig, SaysWhatIsSetUpDifferently) {
  serve("simulated", {"pty"});
  std::string text = slurp(file);
  replace(text, R"("stage": "zolix-tsa200",)", R"("stage": "zolix-tsa200", "speed_mm_s": 15,)");
  spill(file, text);
  Outcome o = rig("status");
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("SetSpeed? X: wanted 15, found 20"));
  o = rig("home stage");
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("SetSpeed? X: wanted 15, found 20"));
  EXPECT_EQ(rig("stop").code, 0);  // always
  o = rig("home stage", "--configure");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_EQ(rig("status").code, 0);
}

TEST_F(ServedRig, RefusesASecondMoverAndCanBeStoppedFromAnotherProcess) {
  serve("simulated", {"pty"});
  const std::string run = "run " + (kScenarios / "uniaxial_z.json").string() + " --rig " +
                          file.string() + " --speed 4 --out " + (folder / "run").string();
  BackgroundProgram campaign(run, folder / "run.log");
  ASSERT_TRUE(campaign.prints("run: ")) << campaign.output();

  Outcome o = rig("move yaw 5", "--home");
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("in use by process"));
  EXPECT_THAT(o.output, HasSubstr("uniaxial_z.json"));
  o = turntable_program("devices --port " + (folder / "mc1").string());
  EXPECT_THAT(o.output, HasSubstr("in use by process"));
  o = rig("status");
  EXPECT_EQ(o.code, 0);
  EXPECT_THAT(o.output, HasSubstr("in use by process"));

  o = rig("stop");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("was told to stop and has let go"));
  EXPECT_THAT(o.output, HasSubstr("all axes stand"));
  EXPECT_EQ(campaign.ended(), 130);
  EXPECT_THAT(slurp(folder / "run/journal.jsonl"), HasSubstr("\"exit_status\":\"abort\""));
}

TEST_F(ServedRig, SharesALineBetweenTwoControllersAlsoWhileItIsStopped) {
  const std::string line = R"({"serial": {"port": ")" + (folder / "mc1").string() + "\"}}";
  serve("two_zc300", {line, line + R"(, "address": 2)"});
  Outcome o = rig("home");
  ASSERT_EQ(o.code, 0) << o.output;
  BackgroundProgram mover("move stage 150 yaw -80 roll -40 pitch -40 --homed --rig " +
                              file.string() + " --speed 4 --wire-log " +
                              (folder / "wire.log").string(),
                          folder / "move.log");
  const std::string last_told = "mc1+mc2 > 02 10 75 61 00 03 06 00 64 00 32";  // pitch, on mc2
  for (int i = 0; i < 1000 && slurp(folder / "wire.log").find(last_told) == std::string::npos; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds{10});
  mover.signal(SIGINT);
  EXPECT_EQ(mover.ended(), 130) << mover.output();
  EXPECT_THAT(mover.output(), Not(HasSubstr("EMERGENCY")));
  o = rig("stop");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("all axes stand"));
}

TEST_F(ServedRig, WakesASuspendedMoverToStopIt) {
  serve("simulated", {"pty"});
  ASSERT_EQ(rig("home stage").code, 0);
  BackgroundProgram mover("move stage 190 --homed --rig " + file.string() +
                              " --speed 4 --wire-log " + (folder / "wire.log").string(),
                          folder / "move.log");
  for (int i = 0; i < 1000 && slurp(folder / "wire.log").find("GoPosition") == std::string::npos;
       ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds{10});
  mover.signal(SIGSTOP);
  const Outcome o = rig("stop");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("was told to stop and has let go"));
  EXPECT_THAT(o.output, HasSubstr("all axes stand"));
  EXPECT_THAT(o.output, Not(HasSubstr("stage     190.00000")));
  EXPECT_EQ(mover.ended(), 130);
}

TEST_F(ServedRig, IsFreeAgainAfterAMoverIsKilled) {
  serve("simulated", {"pty"});
  BackgroundProgram mover("run " + (kScenarios / "uniaxial_z.json").string() + " --rig " +
                              file.string() + " --speed 4 --out " + (folder / "run").string(),
                          folder / "run.log");
  ASSERT_TRUE(mover.prints("run: ")) << mover.output();
  EXPECT_EQ(rig("home yaw").code, 3);
  mover.signal(SIGKILL);
  EXPECT_EQ(mover.ended(), 128 + SIGKILL);
  const Outcome o = rig("stop");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("all axes stand"));
  EXPECT_THAT(o.output, Not(HasSubstr("was told to stop")));
  EXPECT_EQ(rig("home yaw").code, 0);
}

TEST_F(ServedRig, IsLeftStandingByACtrlC) {
  serve("simulated", {"pty"});
  BackgroundProgram mover("move stage 190 --home --rig " + file.string() +
                              " --speed 4 --wire-log " + (folder / "wire.log").string(),
                          folder / "move.log");
  for (int i = 0; i < 1000 && slurp(folder / "wire.log").find("GoPosition") == std::string::npos;
       ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds{10});
  mover.signal(SIGINT);
  EXPECT_EQ(mover.ended(), 130);
  const std::string before = rig("status").output;
  EXPECT_THAT(before, Not(HasSubstr("stage       0.00000")));
  EXPECT_THAT(before, Not(HasSubstr("stage     190.00000")));
  EXPECT_EQ(rig("status").output, before);
}

TEST_F(ServedRig, IsStoppedAsFarAsItCanBeReached) {
  serve("two_zc300", {"pty", tcp("modbus_tcp", 15023)});
  std::string text = slurp(file);
  replace(text, "15023", "15024");  // nobody is there
  spill(file, text);
  const Outcome o = rig("stop");
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("yaw "));  // on the controller that answers
  EXPECT_THAT(o.output, HasSubstr("mc2: 127.0.0.1:15024"));
  EXPECT_THAT(o.output, HasSubstr("USE THE EMERGENCY STOP"));
  EXPECT_THAT(o.output, Not(HasSubstr("all axes stand")));
}

TEST(SimulatedRig, CannotBeStoppedFromElsewhereAndSaysSo) {
  const Outcome o = turntable_program("stop --rig scenarios/rigs/simulated.json");
  EXPECT_EQ(o.code, 2);
  EXPECT_THAT(o.output, HasSubstr("simulated inside each program"));
}

TEST_F(ServedRig, MovesAnAxisWhoseNeighboursHaveNotBeenHomed) {
  serve("two_zc300", {"pty", "pty"});
  EXPECT_EQ(rig("home yaw").code, 0);
  Outcome o = rig("move yaw 10", "--homed");
  EXPECT_EQ(o.code, 0) << o.output;
  o = rig("move roll 5", "--homed");
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("axis roll"));
}

TEST_F(ServedRig, RefusesARelativeMoveThatIsLessThanHalfAPulse) {
  serve("simulated", {"pty"});
  EXPECT_EQ(rig("home yaw").code, 0);
  Outcome o = rig("move yaw 0.0006", "--relative --homed");
  EXPECT_EQ(o.code, 2);
  EXPECT_THAT(o.output, HasSubstr("at least half of 0.00125 deg"));
  o = rig("move yaw 0.001", "--relative --homed");
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("0.00125 deg, asked for 0.001 (the nearest of places 0.00125"));
}

TEST_F(ServedRig, GoesOnWithARunOnAnAdapterThatCameBackUnderAnotherName) {
  serve("simulated", {"pty"});
  const fs::path run = folder / "run";
  BackgroundProgram taken(
      "run " + (kScenarios / "quick/uniaxial_z.json").string() + " --rig " + file.string() +
          " --speed 4 --solver aopit --assume-mounted --calibration " +
          (kScenarios / "calibrations/paper_table1.json").string() + " --out " + run.string(),
      folder / "run.log");
  for (int i = 0; i < 3000 && slurp(run / "journal.jsonl").find("pose_id") == std::string::npos;
       ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds{10});
  server.reset();
  EXPECT_EQ(taken.ended(), 3) << taken.output();

  fs::create_directory(folder / "new");
  server = std::make_unique<BackgroundProgram>(
      "simulate " + file.string() + " --speed 4 --links " + (folder / "new").string(),
      folder / "server.log");
  ASSERT_TRUE(server->prints("/dev/pts/"));
  fs::remove(folder / "mc1");
  const std::string resume = "resume " + run.string() + " --speed 4 --assume-mounted ";
  Outcome o = turntable_program(resume);
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("resume RUN --line"));
  o = turntable_program(resume + "--line mc2=/dev/ttyUSB1");
  EXPECT_EQ(o.code, 2);
  EXPECT_THAT(o.output, HasSubstr("a controller of the rig: mc1"));
  o = turntable_program(resume + "--line mc1=" + (folder / "new/mc1").string());
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(slurp(run / "journal.jsonl"), HasSubstr("\"other_lines\":[\"mc1="));
}

TEST_F(ServedRig, GoesWrongByAFile) {
  spill(folder / "faults.json",
        R"({"format": "turntable-faults/1", "faults": [
            {"controller": "mc1", "fault": "emergency_stop", "on": "move", "nth": 2, "after_ms": 100}]})");
  serve("two_zc300", {"pty", tcp("tcp", 15022)}, "--faults " + (folder / "faults.json").string());
  const Outcome o = rig("move yaw 10", "--home");
  EXPECT_EQ(o.code, 3);
  EXPECT_THAT(o.output, HasSubstr("the emergency stop is pressed"));
}

TEST_F(ServedRig, IsIdentifiedByQueriesAlone) {
  const std::vector<std::pair<std::string, std::string>> kWho{
      {"simulated", "Zolix MC600"},
      {"two_zc300", "Zolix ZC300"},
      {"sc300_zc300", "Zolix SC300"},
      {"leadshine", "Leadshine drives in PR mode, slaves 1 2 3 4"}};
  int port = 15030;
  for (const auto& [name, who] : kWho) {
    std::vector<std::string> lines{"pty"};
    if (name == "two_zc300" || name == "sc300_zc300") lines.push_back(tcp("tcp", port++));
    serve(name, lines);
    const Outcome o = turntable_program("devices --port " + (folder / "mc1").string() + " --port " +
                                        (folder / "bus1").string());
    EXPECT_THAT(o.output, HasSubstr(who));
    server.reset();
  }
}

TEST_F(ServedRig, RefusesBadFaultFiles) {
  for (
      const auto& [text, says] : std::vector<std::pair<std::string, std::string>>{
          {R"({"format": "turntable-faults/1", "faults": []})", "/faults"},
          {R"({"format": "turntable-faults/1", "faults": [{"controller": "mc1", "fault": "gremlin"}]})",
           "/faults/0/fault"},
          {R"({"format": "turntable-faults/1", "faults": [{"controller": "mc9", "fault": "silence"}]})",
           "/faults/0/controller"}}) {
    spill(folder / "faults.json", text);
    const Outcome o = turntable_program("simulate scenarios/rigs/simulated.json --faults " +
                                        (folder / "faults.json").string());
    EXPECT_EQ(o.code, 2);
    EXPECT_THAT(o.output, HasSubstr(says));
  }
}

// ---- the camera

TEST_F(ServedRig, ShowsItsCameraOnLoopbackAndItsPayloadIsChangedByHand) {
  const Outcome calibrated = turntable_program(
      "run " + (kScenarios / "campaigns/quick.json").string() +
      " --rig scenarios/rigs/gige.json --out " + (folder / "calibrated").string());
  ASSERT_EQ(calibrated.code, 0) << calibrated.output;
  serve("gige", {"pty"}, "", "\"simulated\": {},\n", "\"device\": \"127.0.0.1\",\n");
  EXPECT_THAT(server->output(), HasSubstr("camera 127.0.0.1"));
  EXPECT_THAT(turntable_program("devices").output, HasSubstr("gige camera: Aravis-Fake-SIM01"));
  server->say("mount led_target\n");
  EXPECT_TRUE(server->prints("mounted led_target"));
  server->say("mount elephant\n");
  EXPECT_TRUE(server->prints("allowed: mount circle_pattern, mount led_target"));
  // A scenario on it, both protocols between two processes.
  const Outcome o =
      rig("run " + (kScenarios / "quick/uniaxial_x.json").string(),
          "--assume-mounted --calibration " + (folder / "calibrated/calibration.json").string() +
              " --out " + (folder / "run").string());
  EXPECT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("5 poses, 0 failed"));
}

}  // namespace
}  // namespace turntable
