// Every rig that is shipped gives the same tables on the same scenarios: what moves the axes and
// takes the images is a matter of the rig file alone.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Rigs : public ::testing::Test {
 protected:
  Outcome run(const std::string& rig, const std::string& name,
              const std::string& campaign = "campaigns/quick.json") {
    return turntable_program("run scenarios/" + campaign + " --rig " + rig + " --out " +
                             (folder / name).string());
  }
  void expect_same_tables(const std::string& a, const std::string& b) {
    int compared = 0;
    for (const auto& entry : fs::directory_iterator(folder / a / "tables")) {
      if (entry.path().extension() != ".csv") continue;
      EXPECT_EQ(slurp(entry.path()), slurp(folder / b / "tables" / entry.path().filename()))
          << entry.path().filename() << " of " << b;
      ++compared;
    }
    EXPECT_GE(compared, 5);
  }
  TemporaryFolder folder;
};

TEST_F(Rigs, OfEveryControllerGiveTheSameTables) {
  ASSERT_EQ(run("scenarios/rigs/simulated.json", "simulated").code, 0);
  for (const std::string rig : {"two_zc300", "sc300_zc300", "leadshine", "described_zaber"}) {
    const Outcome o = run("scenarios/rigs/" + rig + ".json", rig);
    ASSERT_EQ(o.code, 0) << o.output;
    expect_same_tables("simulated", rig);
  }
}

TEST_F(Rigs, WhoseStageCountsTheOtherWayGiveTheSameTables) {
  const fs::path rigs = fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/rigs";
  std::string text = slurp(rigs / "ideal.json");
  const std::string stage = "\"stage\": \"zolix-tsa200\"";
  ASSERT_NE(text.find(stage), text.npos);
  text.replace(text.find(stage), stage.size(), stage + ", \"direction\": -1");
  const std::string sweep = "../calibration_sweep.json";
  if (const auto at = text.find(sweep); at != text.npos)
    text.replace(at, sweep.size(), (rigs / sweep).lexically_normal().string());
  fs::create_directory(folder / "rig");
  spill(folder / "rig/ideal.json", text);
  ASSERT_EQ(run("scenarios/rigs/ideal.json", "usual").code, 0);
  const Outcome o = run((folder / "rig/ideal.json").string(), "reversed");
  ASSERT_EQ(o.code, 0) << o.output;
  expect_same_tables("usual", "reversed");
}

TEST_F(Rigs, WithAGigeCameraGiveTables) {
  const Outcome o = run("scenarios/rigs/gige.json", "gige");
  ASSERT_EQ(o.code, 0) << o.output;
  EXPECT_THAT(o.output, HasSubstr("Aravis"));
  // Every image came from the world as it stood: a stale or wrong one would be degrees off. The sensor
  // is a third as wide as the other rigs', and so is the accuracy.
  const std::string key = "aopit_ray          total RMSE ";
  int scenarios = 0;
  for (auto at = o.output.find(key); at != o.output.npos; at = o.output.find(key, at + 1)) {
    EXPECT_LT(std::stod(o.output.substr(at + key.size())), 0.1);
    ++scenarios;
  }
  EXPECT_EQ(scenarios, 5);
}

/// The rig file with an output of its controller wired to the camera.
std::string triggered(const std::string& rig, const std::string& outputs) {
  std::string text = slurp(kScenarios / "rigs" / (rig + ".json"));
  const auto put = [&](const std::string& after, const std::string& more) {
    const auto at = text.find(after);
    ASSERT_NE(at, std::string::npos) << after;
    text.insert(at + after.size(), more);
  };
  put(R"("camera": {)",
      R"("trigger": {"source": "line", "line": "Line0", "output": {"controller": "mc1", "name": "camera"}},)");
  put(R"("line": {"simulated": {}})", R"(, "outputs": {"camera": )" + outputs + "}");
  const auto at = text.find("../calibration_sweep.json");
  text.replace(at, 25, (kScenarios / "calibration_sweep.json").string());
  return text;
}

TEST_F(Rigs, MayFireTheirCameraByAnOutputOfTheController) {
  const std::string by_text = R"({"on": "SetOutput 1,1", "off": "SetOutput 1,0", "pulse_ms": 2})",
                    by_register = R"({"register": 30064, "bit": 1, "on": 1, "off": 0, "pulse_ms": 2})";
  ASSERT_EQ(run("scenarios/rigs/simulated.json", "software").code, 0);
  for (const auto& [rig, outputs] :
       {std::pair<std::string, std::string>{"simulated", by_text}, {"two_zc300", by_register}}) {
    spill(folder / "rig.json", triggered(rig, outputs));
    const Outcome o = run((folder / "rig.json").string(), rig);
    ASSERT_EQ(o.code, 0) << o.output;
    expect_same_tables("software", rig);
  }
  // The same wire to a GigE camera's input.
  spill(folder / "rig.json", triggered("gige", by_text));
  const Outcome o = run((folder / "rig.json").string(), "gige", "quick/uniaxial_x.json");
  EXPECT_EQ(o.code, 0) << o.output;
  // The wrong kind of words for the controller, and an output that is not there.
  spill(folder / "rig.json", triggered("simulated", by_register));
  Outcome wrong = run((folder / "rig.json").string(), "wrong");
  EXPECT_EQ(wrong.code, 2);
  EXPECT_THAT(wrong.output, HasSubstr("/controllers/mc1/outputs/camera"));
  std::string text = triggered("simulated", by_text);
  text.replace(text.find(R"("name": "camera")"), 16, R"("name": "lights")");
  spill(folder / "rig.json", text);
  wrong = run((folder / "rig.json").string(), "wrong");
  EXPECT_EQ(wrong.code, 2);
  EXPECT_THAT(wrong.output, HasSubstr("/camera/trigger/output"));
}

TEST_F(Rigs, BehindAModbusGatewayHaveToSpeakModbus) {
  std::string text = slurp(kScenarios / "rigs/simulated.json");
  text.replace(text.find(R"({"simulated": {}})"), 17,
               R"({"modbus_tcp": {"host": "127.0.0.1", "port": 15099}})");
  text.replace(text.find("../calibration_sweep.json"), 25,
               (kScenarios / "calibration_sweep.json").string());
  spill(folder / "rig.json", text);
  const Outcome o = run((folder / "rig.json").string(), "out");
  EXPECT_EQ(o.code, 2);
  EXPECT_THAT(o.output, HasSubstr("does not speak Modbus"));
  EXPECT_FALSE(fs::exists(folder / "out"));
}

}  // namespace
}  // namespace turntable
