// Controllers that a file describes: templates, what is refused in a description, and the shipped ones
// against peers that were written from other sources. The laws run over the Zaber simulator.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "drivers/catalog.h"
#include "drivers/controller_description.h"
#include "drivers/motion.h"
#include "drivers/text_template.h"
#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "tests/support/axis_configs.h"
#include "tests/support/described_peers.h"
#include "tests/support/message_of.h"
#include "tests/support/simulated_controller.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Pair;
using ::testing::UnorderedElementsAre;

Json shipped_json(const std::string& name) {
  return Json::parse(read_text(std::filesystem::path(TURNTABLE_SOURCE_DIR) / "drivers" /
                               "described" / (name + ".json")));
}

// ---- templates

TEST(TextTemplate, IsFilledInAndFoundAgain) {
  const TextTemplate move("/{axis} {id} move abs {value}");
  EXPECT_EQ(move.fill({{"axis", "1 2"}, {"id", "7"}, {"value", "-12.5"}}), "/1 2 7 move abs -12.5");
  const TextTemplate reply("@{axis} {id} OK {state} {warning} {value}");
  const auto found = reply.find("@01 2 07 ok  BUSY -- -1.25e2 ", {{"axis", "1 2"}, {"id", "7"}});
  ASSERT_TRUE(found);
  EXPECT_THAT(*found,
              UnorderedElementsAre(Pair("axis", "01 2"), Pair("id", "07"), Pair("state", "BUSY"),
                                   Pair("warning", "--"), Pair("value", "-1.25e2")));
}

TEST(TextTemplate, DoesNotFitWhatIsNotTheWholeLine) {
  const TextTemplate reply("@{axis} OK {state} {value}");
  for (const char* line : {"", "@", "@1 OK IDLE", "@1 OK IDLE 5x", "@2 OK IDLE 5", "@10 OK IDLE 5",
                           "@1 RJ IDLE 5", "x@1 OK IDLE 5", "@1 OK IDLE 5 6", "@1 OK IDLE +-5"})
    EXPECT_FALSE(reply.find(line, {{"axis", "1"}, {"id", ""}})) << line;
  EXPECT_TRUE(reply.find("@001 OK IDLE +5", {{"axis", "1"}, {"id", ""}}));
}

TEST(TextTemplate, TakesAnythingWhereItSaysSo) {
  EXPECT_TRUE(TextTemplate("{any}?{any}").find("MOV12?", {}));
  EXPECT_TRUE(TextTemplate("{any}").find("", {}));
  EXPECT_FALSE(TextTemplate("{text}").find("", {}));
  EXPECT_EQ(TextTemplate("P={values};").find("p=1, -2;3;", {})->at("values"), "1, -2;3");
  EXPECT_TRUE(TextTemplate("OK {any}").find("ok", {}));
}

TEST(TextTemplate, SaysWhatIsWrongWithItsBraces) {
  for (const char* text : {"{axis", "axis}", "{ax{is}", "{}", "a } b", "{a}{b}"})
    EXPECT_THROW(TextTemplate{text}, std::invalid_argument) << text;
}

TEST(TextTemplate, EndsAWordWhereTheLettersAfterItBegin) {
  EXPECT_EQ(TextTemplate("S={state};{any}").find("s=Busy;x;y", {})->at("state"), "Busy");
  EXPECT_FALSE(TextTemplate("S={state};").find("S=;", {}));
}

TEST(TextTemplate, EndsSoonOnALongLineOfNoise) {
  const TextTemplate reply("{any}a{a}a{b}a{c}a{d}a{e}a{f}a{text}x");
  EXPECT_FALSE(reply.find(std::string(256, 'a'), {}));
}

// ---- descriptions

TEST(ControllerDescriptions, ThatAreShippedNameTheirSourcesAndSayThatNobodyTriedThem) {
  const std::vector<std::string> names = shipped_descriptions();
  EXPECT_THAT(names, UnorderedElementsAre("acutrol", "ideal_aerosmith", "zaber_ascii"));
  for (const std::string& name : names) {
    ControllerConfig config;
    config.name = "mc1";
    config.model = "described";
    config.description = name;
    const ControllerDescription description = load_description(config);
    EXPECT_TRUE(description.untried) << name;
    EXPECT_FALSE(description.sources.empty()) << name;
    const std::vector<std::string> unconfirmed = unconfirmed_of(config);
    ASSERT_GT(unconfirmed.size(), 2u) << name;
    EXPECT_THAT(unconfirmed[0], AllOf(HasSubstr("never tried"), HasSubstr(description.sources[0])));
    for (const std::string& sentence : unconfirmed)
      EXPECT_TRUE(sentence.ends_with('.')) << sentence;
  }
}

TEST(ControllerDescriptions, OfTheReadmeIsOneThatIsTaken) {
  const std::string readme =
      read_text(std::filesystem::path(TURNTABLE_SOURCE_DIR) / "drivers" / "README.md");
  const std::size_t begin = readme.find("```json") + 7;
  const ControllerDescription description =
      parse_description(readme.substr(begin, readme.find("```", begin) - begin), "README.md");
  EXPECT_EQ(description.settings.front().wanted(rotary_axis(AxisId::kYaw, "A")), "25.00");
  EXPECT_EQ(description.status.size(), 2u);
}

TEST(ControllerDescriptions, AreTakenOrRefusedWhateverStandsInThem) {
  Random draws = draws_of_this_test();
  const std::string whole = shipped_json("zaber_ascii").dump();
  int refused = 0;
  for (int i = 0; i < 300; ++i) {
    std::string text = whole;
    for (int k = 0; k < 3; ++k)
      text[static_cast<std::size_t>(draws.uniform(0, static_cast<double>(text.size() - 1)))] =
          static_cast<char>(draws.uniform(32, 127));
    try {
      parse_description(text, "mine.json");
    } catch (const ConfigError& e) {
      ++refused;
      EXPECT_THAT(e.what(), HasSubstr("mine.json"));
    }
  }
  EXPECT_GT(refused, 100);
}

struct DescriptionMisuse {
  const char* name;
  const char* place;  ///< that is changed, "" = removed below
  const char* to;     ///< JSON; "" = removed
  const char* told;   ///< place in the message
  const char* found;  ///< in the message
};

TEST(ControllerDescriptions, AreRefusedWithFileAndPlaceAndWhatIsAllowed) {
  const DescriptionMisuse kMisuses[] = {
      {"no question for the position", "/commands/status",
       R"([{"send": "/{axis} {id}", "reply": "@{axis} OK {state}"}])", "/commands/status",
       "nothing tells the position"},
      {"no axis in a move", "/commands/move/send", R"("/1 move abs {value}")",
       "/commands/move/send", "with the place {axis}"},
      {"no axis in a question", "/commands/status/0/send", R"("/1 get pos")",
       "/commands/status/0/send", "with the place {axis}"},
      {"no goal in a move", "/commands/move/send", R"("/{axis} move abs")", "/commands/move/send",
       "with the place {value}"},
      {"a place that nobody knows", "/commands/move/send", R"("/{axis} move {values} {value}")",
       "/commands/move/send", "place {values}, allowed here: {axis}, {id}, {value}"},
      {"a word without a list", "/commands/home/reply", R"("@{axis} OK {status}")",
       "/commands/home/reply", "list its words under /words/status"},
      {"too much that is open", "/refused", R"("{any}a{any}b{any}")", "/refused", "two of them"},
      {"an open brace", "/commands/stop/send", R"("/{axis stop")", "/commands/stop/send",
       "partner"},
      {"a factor of 0", "/position/factor", "0", "/position/factor", "0"},
      {"an unknown check sum", "/line/checksum", R"("crc16")", "/line/checksum", "zaber_lrc"},
      {"an unknown unit", "/position/unit", R"("inches")", "/position/unit", "pulses"},
      {"an unknown meaning", "/words/state/IDLE", R"("stopped")", "/words/state/IDLE",
       "\"moving\", \"ended\""},
      {"a fault without a word to a person", "/words/warning/FS", R"("fault")", "/words/warning/FS",
       "fault: <what to tell a person>"},
      {"a list with the name of a place", "/words/value", R"({"1": "ended"})", "/words/value",
       "means something else already"},
      {"no homing, and no absolute positions", "/commands/home", "", "/commands",
       "has no \"home\""},
      {"homing, and absolute positions", "/position/reference", R"("absolute")", "/commands/home",
       "Remove one of them"},
      {"nothing that tells the end", "/words/state/IDLE", R"("nothing")", "/still_ms",
       "nothing tells that a motion has ended"},
      {"no answer said", "/accepted", "", "/commands/move", "no \"accepted\""},
      {"no stop", "/commands/stop", "", "/commands", "stop"},
      {"another key", "/speed", "1", "", "unknown key \"speed\""},
      {"another format", "/format", R"("turntable-rig/1")", "/format",
       "turntable-controller-description/1"},
      {"all positions, and not whose", "/commands/status/0/reply", R"("{values}")",
       "/commands/status/0/reply", "List the \"channels\""},
      {"a setting of nothing", "/commands/settings/0/of", "", "/commands/settings/0", "\"of\""},
      {"a setting without unit", "/commands/settings/0/unit", "", "/commands/settings/0",
       "\"unit\""},
      {"a setting that is not told", "/commands/settings/0/ask/reply", R"("@{axis} OK {any}")",
       "/commands/settings/0/ask/reply", "with the place {value}"},
  };
  for (const DescriptionMisuse& misuse : kMisuses) {
    SCOPED_TRACE(misuse.name);
    Json json = shipped_json("zaber_ascii");
    const Json::json_pointer place(misuse.place);
    if (*misuse.to == '\0')
      json.at(place.parent_pointer()).erase(place.back());
    else
      json[place] = Json::parse(misuse.to);
    const std::string message =
        message_of<ConfigError>([&] { parse_description(json.dump(), "mine.json"); });
    EXPECT_THAT(message,
                AllOf(HasSubstr("mine.json"), HasSubstr(misuse.told), HasSubstr(misuse.found)));
  }
}

RigFile described_rig(const std::string& description, const std::vector<AxisConfig>& axes) {
  RigFile rig;
  ControllerConfig config;
  config.name = "mc1";
  config.model = "described";
  config.description = description;
  rig.controllers.push_back(config);
  for (AxisConfig axis : axes) {
    axis.controller = "mc1";
    rig.axes[axis.id] = axis;
  }
  return rig;
}

TEST(ControllerDescriptions, OfARigAreFoundByNameOrFileAndNothingElse) {
  const std::vector<AxisConfig> yaw{rotary_axis(AxisId::kYaw, "1 1")};
  RigFile rig = described_rig("zaber_ascii", yaw);
  EXPECT_NO_THROW(know_controllers(rig));
  rig = described_rig("zabre", yaw);
  EXPECT_THAT(message_of<ConfigError>([&] { know_controllers(rig); }),
              AllOf(HasSubstr("/controllers/mc1/description"), HasSubstr("found \"zabre\""),
                    HasSubstr("zaber_ascii"), HasSubstr(".json")));
  rig = described_rig("", yaw);
  EXPECT_THAT(message_of<ConfigError>([&] { know_controllers(rig); }), HasSubstr("is missing"));
  rig = described_rig("zaber_ascii", yaw);
  rig.controllers[0].model = "zolix-mc600";
  EXPECT_THAT(message_of<ConfigError>([&] { know_controllers(rig); }),
              HasSubstr("/controllers/mc1/description: found with model \"zolix-mc600\""));
  const TemporaryFolder folder;
  const std::string file = (folder / "own.json").string();
  Json own = shipped_json("zaber_ascii");
  std::ofstream(file) << own.dump();
  rig = described_rig(file, yaw);
  EXPECT_NO_THROW(know_controllers(rig));
  own["commands"]["move"]["send"] = "/{axis} go";
  std::ofstream(file) << own.dump();
  EXPECT_THAT(message_of<ConfigError>([&] { know_controllers(rig); }),
              HasSubstr(file + " at /commands/move/send"));
  rig = described_rig((folder / "none.json").string(), yaw);
  EXPECT_THROW(know_controllers(rig), ConfigError);
}

TEST(ControllerDescriptions, TellTheGridAndTheRangeOfAnAxis) {
  RigFile rig = described_rig("zaber_ascii", {rotary_axis(AxisId::kYaw, "1 1")});
  know_controllers(rig);
  EXPECT_EQ(rig.axis(AxisId::kYaw).sent_step, 0.0);
  EXPECT_EQ(rig.axis(AxisId::kYaw).told_step, 0.0);
  rig = described_rig("ideal_aerosmith", {rotary_axis(AxisId::kYaw, "1")});
  know_controllers(rig);
  EXPECT_NEAR(rig.axis(AxisId::kYaw).sent_step, 1e-4, 1e-12);
  rig = described_rig("ideal_aerosmith", {rotary_axis(AxisId::kYaw, "2")});
  EXPECT_THAT(message_of<ConfigError>([&] { know_controllers(rig); }),
              HasSubstr("/axes/yaw/channel: found \"2\", allowed on ideal_aerosmith: 1"));
  AxisConfig wide = rotary_axis(AxisId::kYaw, "1");
  wide.upper = 200;
  rig = described_rig("acutrol", {wide});
  EXPECT_THAT(message_of<ConfigError>([&] { know_controllers(rig); }),
              AllOf(HasSubstr("/axes/yaw/limits_deg"), HasSubstr("within (-180, 180)")));
}

TEST(ControllerDescriptions, AreNotSimulatedUnlessSomebodyWroteASimulator) {
  ControllerConfig config;
  config.name = "mc1";
  config.model = "described";
  config.description = "acutrol";
  EXPECT_THAT(
      message_of<ConfigError>([&] {
        sim::simulate_controller("described", {{}, {}, 1, config});
      }),
      AllOf(HasSubstr("/controllers/mc1/description"), HasSubstr("simulated: zaber_ascii")));
}

// ---- Zaber

TEST(DescribedZaber, SaysWhatTheMakersOwnLibrarySays) {
  SimulatedController rig({"described"});
  rig.ready();
  rig.move(rig.yaw(), 10);
  const std::string sent = rig.wire.sent();
  // The rule that makes ":8D" of "01 0 OK IDLE -- 0" and ":C9" of "1 0 foo 2" in the maker's tests.
  EXPECT_TRUE(sent.starts_with("/1 1 1 get maxspeed:56\r\n")) << sent.substr(0, 40);
  EXPECT_THAT(sent, HasSubstr(" move abs 7600:"));  // the overshoot of 0.5 deg before 10 deg
  EXPECT_THAT(sent, HasSubstr(" move abs 8000:"));
  EXPECT_THAT(sent, HasSubstr("/1 2 "));
}

TEST(DescribedZaber, ThatWasResetIsNotBelieved) {
  SimulatedController rig({"described"});
  rig.ready();
  rig.move(rig.yaw(), 5);
  rig.fault({.kind = sim::FaultKind::kReset, .verb = "move", .delay_s = 0.05});
  EXPECT_THAT(message_of<DeviceError>([&] { rig.move(rig.yaw(), 0); }), HasSubstr("reset"));
  EXPECT_FALSE(rig.yaw().homed());
  EXPECT_THAT(message_of<DeviceError>([&] { rig.controller->trust_reference(AxisId::kYaw); }),
              HasSubstr("not been homed"));
  rig.yaw().home();
  EXPECT_NEAR(rig.move(rig.yaw(), 5).position.value, 5.0, 0.000625);
}

TEST(DescribedZaber, IsRefusedInPlainWords) {
  SimulatedController rig({"described"});
  rig.ready();
  rig.fault({.kind = sim::FaultKind::kErrorReply, .verb = "move", .text = "PARKED"});
  EXPECT_THAT(message_of<DeviceError>([&] { rig.move(rig.yaw(), 5); }),
              AllOf(HasSubstr("axis yaw"), HasSubstr("was refused with"),
                    HasSubstr("the device is parked")));
}

// ---- the others, with every manner

std::vector<Manners> described_manners() {
  return {{.name = "plain", .line_end = "\r\n"},
          {.name = "lf", .line_end = "\n"},
          {.name = "blanks", .line_end = "\r\n", .blanks = true},
          {.name = "late", .line_end = "\r\n", .reply = milliseconds{300}},
          {.name = "halves", .line_end = "\r\n", .second_half = milliseconds{80}},
          {.name = "banner", .line_end = "\r\n", .banner = "Ready to work"}};
}

template <class Peer>
class DescribedPeerTest : public ::testing::TestWithParam<Manners> {
 protected:
  void open(const std::string& description, const std::vector<AxisConfig>& axes) {
    auto [near, far] = line_pair("line");
    peer = std::make_unique<Peer>(std::move(far), GetParam());
    clock.attach(*peer);
    config.name = "mc1";
    config.model = "described";
    config.description = description;
    controller = open_controller({config, axes, std::move(near), &clock});
  }
  ~DescribedPeerTest() override {
    controller.reset();
    if (peer) clock.detach(*peer);
  }
  static AxisConfig table(const std::string& channel, AxisId id = AxisId::kYaw) {
    AxisConfig axis = rotary_axis(id, channel);
    axis.tolerance = 0.002;
    axis.lower = -90;
    axis.upper = 90;
    return axis;
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Arrival<Degrees> move(double to) {
    yaw().start(Degrees{to});
    while (!yaw().advance()) {
    }
    return yaw().arrival();
  }
  std::ptrdiff_t said_with(const std::string& part) const {
    return std::ranges::count_if(
        peer->heard, [&](const std::string& s) { return s.find(part) != std::string::npos; });
  }
  void moves_and_stops() {
    for (const double to : {12.345, -5.0, 20.0, 0.0}) {
      const Arrival<Degrees> arrival = move(to);
      EXPECT_FALSE(arrival.missed) << to;
      EXPECT_NEAR(arrival.position.value, to, 0.002) << to;
    }
    EXPECT_THROW(yaw().start(Degrees{91}), LimitError);
    yaw().start(Degrees{-60});
    clock.sleep_for(milliseconds{300});
    yaw().stop();
    EXPECT_FALSE(peer->moving(clock.now()));
    EXPECT_TRUE(yaw().homed());
    EXPECT_NEAR(move(-3).position.value, -3, 0.002);
  }

  ManualClock clock;
  ControllerConfig config;
  std::unique_ptr<Peer> peer;
  std::unique_ptr<Controller> controller;
};

const auto kMannersName = [](const auto& manners) { return std::string(manners.param.name); };

class DescribedAerosmith : public DescribedPeerTest<AerosmithPeer> {};
INSTANTIATE_TEST_SUITE_P(, DescribedAerosmith, ::testing::ValuesIn(described_manners()),
                         kMannersName);

TEST_P(DescribedAerosmith, IsSetUpHomedMovedAndStopped) {
  for (const bool echo : {false, true}) {
    if (peer) clock.detach(*peer);
    open("ideal_aerosmith", {table("1")});
    peer->echo_in_answer = echo;
    controller->configure();
    EXPECT_EQ(peer->speed, 25);
    EXPECT_THAT(controller->connect(), IsEmpty());
    EXPECT_THAT(controller->identity(), HasSubstr("VEL cannot be read"));
    EXPECT_THROW(yaw().start(Degrees{1}), DeviceError);  // not homed
    yaw().home();
    moves_and_stops();
    EXPECT_EQ(peer->said("HOM"), 1);
    EXPECT_EQ(peer->said("MOV12.3450"), 1);
    controller.reset();
  }
}

TEST_P(DescribedAerosmith, ThatRefusesIsQuoted) {
  Json own = shipped_json("ideal_aerosmith");
  own["commands"]["move"]["send"] = "GOTO{value}";
  const TemporaryFolder folder;
  std::ofstream(folder / "own.json") << own.dump();
  open((folder / "own.json").string(), {table("1")});
  controller->configure();
  yaw().home();
  EXPECT_THAT(message_of<DeviceError>([&] { move(5); }), HasSubstr("was refused with \"?\""));
  EXPECT_EQ(said_with("GOTO"), 1);
}

TEST_P(DescribedAerosmith, ThatDoesNotHearAMoveIsNeverToldAgain) {
  open("ideal_aerosmith", {table("1")});
  controller->configure();
  yaw().home();
  peer->mute_to = "MOV";  // carried out, and not answered
  move(5);
  EXPECT_EQ(said_with("MOV5.0000"), 1);
  EXPECT_NEAR(peer->place('1', clock.now()), 5, 1e-4);
  peer->mute_to.clear();
  peer->deaf_to = "MOV";
  EXPECT_THAT(message_of<Error>([&] { move(-7); }),
              AllOf(HasSubstr("axis yaw"), HasSubstr("acknowledged")));
  EXPECT_EQ(said_with("MOV-7"), 1);
  EXPECT_FALSE(yaw().homed());
  yaw().stop();
  EXPECT_GE(peer->said("STO"), 1);
  peer->deaf_to = "HOM";
  EXPECT_THROW(yaw().home(), Error);  // it stands, and perhaps at 0
  EXPECT_FALSE(yaw().homed());
}

class DescribedAcutrol : public DescribedPeerTest<AcutrolPeer> {};
INSTANTIATE_TEST_SUITE_P(, DescribedAcutrol, ::testing::ValuesIn(described_manners()),
                         kMannersName);

TEST_P(DescribedAcutrol, IsSetUpMovedAndStoppedWithoutHoming) {
  open("acutrol", {table("1"), table("2", AxisId::kRoll)});
  EXPECT_EQ(controller->connect().size(), 4u);  // limits of rate and acceleration
  EXPECT_FALSE(yaw().homed());
  controller->configure();
  EXPECT_EQ(peer->rate['1'], 25);
  EXPECT_EQ(peer->acceleration['2'], 50);
  EXPECT_TRUE(yaw().homed());                      // its positions are absolute
  EXPECT_NEAR(yaw().position().value, -10, 1e-9);  // 350 of a turn
  moves_and_stops();
  yaw().home();  // goes to 0
  EXPECT_NEAR(yaw().position().value, 0, 0.002);
  EXPECT_NEAR(peer->place('2', clock.now()), 350, 1e-9);
  EXPECT_EQ(said_with("Position 1,12.3450;:Mode:Position 1"), 1);
}

TEST_P(DescribedAcutrol, ThatStandsStillIsNotTakenForArrived) {
  open("acutrol", {table("1")});
  controller->configure();
  peer->closed['1'] = false;  // somebody opens the interlock
  EXPECT_THAT(message_of<Error>([&] { move(5); }), HasSubstr("axis yaw"));
  EXPECT_FALSE(yaw().homed());
  EXPECT_EQ(said_with(":Demand:Position"), 1);  // never again
  peer->fault = true;
  EXPECT_THAT(message_of<DeviceError>([&] { yaw().home(); }),
              HasSubstr("interlock reports a fault"));
}

TEST_P(DescribedAcutrol, OverItsOwnPortNeedsADescriptionOfOnesOwn) {
  Json own = shipped_json("acutrol");
  own["line"]["answer_skips"] = 8;
  const TemporaryFolder folder;
  std::ofstream(folder / "own.json") << own.dump();
  open((folder / "own.json").string(), {table("1")});
  peer->tcp = true;
  controller->configure();
  moves_and_stops();
}

}  // namespace
}  // namespace turntable
