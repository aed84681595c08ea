// The drivers of the text controllers against peers that were written from other people's programs
// and not from our simulators, with every manner that a line or a firmware may have.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>

#include "drivers/catalog.h"
#include "drivers/motion.h"
#include "drivers/zolix_mc600.h"
#include "drivers/zolix_sc300.h"
#include "protocols/ascii_dialog.h"
#include "src/core/errors.h"
#include "tests/support/axis_configs.h"
#include "tests/support/message_of.h"
#include "tests/support/text_peer.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<Manners> all_manners() {
  return {{.name = "plain"},
          {.name = "echo", .echo = true},
          {.name = "echo_and_crlf", .echo = true, .line_end = "\r\n"},
          {.name = "crlf", .line_end = "\r\n"},
          {.name = "lower_case", .lower_case = true},
          {.name = "blanks", .blanks = true},
          {.name = "banner", .banner = "Zolix Instruments\rready"},
          {.name = "late", .reply = milliseconds{300}},
          {.name = "later", .reply = milliseconds{420}},
          {.name = "late_with_echo", .echo = true, .reply = milliseconds{420}},
          {.name = "halves", .second_half = milliseconds{80}},
          {.name = "busy", .busy_every = 7},
          {.name = "all_at_once",
           .echo = true,
           .line_end = "\r\n",
           .lower_case = true,
           .blanks = true,
           .banner = "Zolix",
           .reply = milliseconds{250},
           .second_half = milliseconds{60},
           .busy_every = 11}};
}

template <class Peer>
class Foreign : public ::testing::TestWithParam<Manners> {
 protected:
  /// A peer on a fresh line, and a driver that knows nothing of it.
  void open(const std::string& model, Manners manners) {
    auto [near, far] = line_pair("line");
    if (peer) clock.detach(*peer);
    peer = std::make_unique<Peer>(std::move(far), std::move(manners));
    clock.attach(*peer);
    config.name = "mc";
    config.model = model;
    controller = open_controller(
        {config, {rotary_axis(AxisId::kYaw, "X"), linear_axis("Y")}, std::move(near), &clock});
  }
  ~Foreign() override {
    controller.reset();
    if (peer) clock.detach(*peer);
  }
  Axis<Degrees>& yaw() { return *controller->rotary_axis(AxisId::kYaw); }
  Arrival<Degrees> move(double to) {
    yaw().start(Degrees{to});
    while (!yaw().advance()) {
    }
    return yaw().arrival();
  }
  /// Everything that a campaign does with an axis.
  void works() {
    controller->configure();
    EXPECT_THAT(controller->connect(), IsEmpty());
    yaw().home();
    EXPECT_NEAR(yaw().position().value, 0, 1e-9);
    for (const double to : {12.345, -5.0, 20.0}) {
      const Arrival<Degrees> arrival = move(to);
      EXPECT_FALSE(arrival.missed) << to;
      EXPECT_NEAR(arrival.position.value, to, 0.001875);
    }
    yaw().start(Degrees{-20});
    clock.sleep_for(milliseconds{300});
    yaw().stop();
    EXPECT_FALSE(peer->moving(clock.now()));
    EXPECT_NEAR(move(-3).position.value, -3, 0.001875);
  }

  ManualClock clock;
  ControllerConfig config;
  std::unique_ptr<Peer> peer;
  std::unique_ptr<Controller> controller;
};

const auto kNamed = [](const auto& manners) { return std::string(manners.param.name); };

// ---- SC300

class ForeignSc300 : public Foreign<Sc300Peer> {};
INSTANTIATE_TEST_SUITE_P(, ForeignSc300, ::testing::ValuesIn(all_manners()), kNamed);

TEST_P(ForeignSc300, IsSetUpHomedMovedAndStopped) {
  open("zolix-sc300", GetParam());
  works();
  EXPECT_EQ(peer->said("HX"), 1);
  EXPECT_EQ(peer->registers.at("FX"), "800");
}

TEST_P(ForeignSc300, IsToldByTheNameItGivesItself) {
  open("zolix-sc300", GetParam());
  controller->configure();
  const std::string who = upper(controller->identity());
  EXPECT_THAT(who, HasSubstr(": SC300-1B SC300_V1.0 ID0000"));
}

TEST_P(ForeignSc300, IsWaitedForWhereItMovesInSilence) {
  Manners manners = GetParam();
  manners.silent_while_moving = true;
  config.answers_while_moving = false;
  open("zolix-sc300", manners);
  works();
}

TEST_P(ForeignSc300, ThatRefusesQuestionsWhileItMovesIsWaitedFor) {
  Manners manners = GetParam();
  manners.busy = "E1";
  config.answers_while_moving = false;
  open("zolix-sc300", manners);
  works();
  config.answers_while_moving = true;  // a rig file that says otherwise is told so
  manners.busy_every = 0;
  open("zolix-sc300", manners);
  controller->configure();
  EXPECT_THAT(message_of<DeviceError>([&] {
                yaw().home();
                move(25);
              }),
              AllOf(HasSubstr("refused with E1"), HasSubstr("answers_while_moving")));
}

TEST_P(ForeignSc300, ThatIsLaterThanItsTimeoutIsSaidToBe) {
  Manners manners = GetParam();
  manners.reply = milliseconds{1700};
  open("zolix-sc300", manners);
  EXPECT_THAT(message_of<Error>([&] { controller->connect(); }),
              AnyOf(HasSubstr("within 1 s"), HasSubstr("raise reply_timeout_ms")));
  config.reply_timeout_s = 3;
  open("zolix-sc300", manners);
  controller->configure();
  EXPECT_THAT(upper(controller->identity()), HasSubstr(": SC300-1B SC300_V1.0 ID0000"));
}

TEST_P(ForeignSc300, MayReportAnEndBetweenAnyQuestionAndItsAnswer) {
  Manners manners = GetParam();
  manners.busy_every = 0;  // a lost question leaves a doubt: better homed twice than not
  open("zolix-sc300", manners);
  controller->configure();
  for (peer->way_home = 100; peer->way_home < 4000; peer->way_home += 100) {  // 5 ms each
    SCOPED_TRACE(peer->way_home);
    ASSERT_NO_THROW(yaw().home());
    EXPECT_TRUE(yaw().homed());
    move(1);
  }
}

TEST_P(ForeignSc300, IsFound) {
  auto [near, far] = line_pair("line");
  Sc300Peer found(std::move(far), GetParam());
  clock.attach(found);
  EXPECT_THAT(upper(identify_zolix_sc300(std::move(near), clock)), HasSubstr("ZOLIX SC300_V1.0"));
  clock.detach(found);
}

// ---- MC600

class ForeignMc600 : public Foreign<Mc600Peer> {};
INSTANTIATE_TEST_SUITE_P(, ForeignMc600, ::testing::ValuesIn(all_manners()), kNamed);

TEST_P(ForeignMc600, IsSetUpHomedMovedAndStopped) {
  open("zolix-mc600", GetParam());
  works();
  EXPECT_EQ(peer->said("GoHome X"), 1);
  EXPECT_EQ(peer->settings.at("SETOFFSET X"), "0");
}

TEST_P(ForeignMc600, ThatRefusesQuestionsWhileItMovesIsWaitedFor) {
  Manners manners = GetParam();
  manners.busy = "E02";
  open("zolix-mc600", manners);
  works();
}

TEST_P(ForeignMc600, MayShowFewerDigitsAsLongAsTheyTellTheWindow) {
  for (const int decimals : {4, 3}) {
    open("zolix-mc600", GetParam());
    peer->decimals = decimals;
    works();
  }
  open("zolix-mc600", GetParam());
  peer->decimals = 1;
  controller->configure();
  yaw().home();
  EXPECT_THAT(message_of<DeviceError>([&] { move(12.345); }),
              AllOf(HasSubstr("11.8"), HasSubstr("1 digits after the point")));
}

TEST_P(ForeignMc600, ThatIsBusyKeepingASettingIsToldTheNextOneAgain) {
  open("zolix-mc600", GetParam());
  peer->keeping = milliseconds{350};  // KYKY's program waits so long
  controller->configure();
  EXPECT_EQ(peer->settings.at("SETACCSPEED Y"), "50");
}

TEST_P(ForeignMc600, ThatRefusesThemForEverIsQuoted) {
  Manners manners = GetParam();
  manners.busy_every = 0;
  open("zolix-mc600", manners);
  controller->configure();
  yaw().home();
  yaw().start(Degrees{20});
  peer->replies["Position? X"] = "E17";
  peer->mute_reports = true;
  EXPECT_THAT(message_of<DeviceError>([&] {
                while (!yaw().advance()) {
                }
              }),
              HasSubstr("\"Position? X\" was refused with E17"));
}

TEST_P(ForeignMc600, IsFound) {
  auto [near, far] = line_pair("line");
  Mc600Peer found(std::move(far), GetParam());
  clock.attach(found);
  EXPECT_EQ(identify_zolix_mc600(std::move(near), clock), "Zolix MC600");
  clock.detach(found);
}

}  // namespace
}  // namespace turntable
