#include "protocols/ascii_dialog.h"

#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

#include "src/core/errors.h"
#include "tests/support/wire_record.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

/// Answers each command with scripted pieces, each after a delay.
class Scripted final : public Actor {
 public:
  struct Piece {
    Time delay;
    std::string bytes;
  };
  explicit Scripted(Line line) : line_(std::move(line)) {}
  void on(const std::string& command, std::vector<Piece> pieces) {
    script_.emplace_back(command, std::move(pieces));
  }
  void say(const std::string& bytes) { line_.write_available(bytes, Time{0}); }

  int descriptor() const override { return line_.descriptor(); }
  std::optional<Time> next_due() const override {
    return due_.empty() ? std::nullopt : std::optional(due_.front().delay);
  }
  void act(Time now) override {
    std::array<char, 256> buffer;
    got += std::string(buffer.data(), line_.read_available(buffer, now));
    std::size_t end;
    while ((end = got.find('\r', read_)) != std::string::npos) {
      const std::string command = got.substr(read_, end - read_);
      read_ = end + 1;
      for (const auto& [text, pieces] : script_)
        if (text == command)
          for (const Piece& piece : pieces) due_.push_back({now + piece.delay, piece.bytes});
    }
    while (!due_.empty() && due_.front().delay <= now) {
      line_.write_available(due_.front().bytes, now);
      due_.erase(due_.begin());
    }
  }

  std::string got;

 private:
  Line line_;
  std::vector<std::pair<std::string, std::vector<Piece>>> script_;
  std::vector<Piece> due_;
  std::size_t read_ = 0;
};

class AsciiDialogTest : public ::testing::Test {
 protected:
  AsciiDialogTest() : AsciiDialogTest(line_pair("line")) {}
  explicit AsciiDialogTest(std::pair<Line, Line> ends)
      : peer(std::move(ends.second)),
        dialog(std::move(ends.first), clock, [this](std::string_view line) {
          if (!line.starts_with("!")) return false;
          unsolicited.emplace_back(line);
          return true;
        }) {
    clock.attach(peer);
  }

  std::string ask(const std::string& command) {
    return dialog.ask(command, milliseconds{1000},
                      [](std::string_view line) { return line.starts_with("="); });
  }

  ManualClock clock;
  Scripted peer;
  AsciiDialog dialog;
  std::vector<std::string> unsolicited;
};

TEST_F(AsciiDialogTest, EndsACommandWithCarriageReturnAlone) {
  peer.on("a", {{{}, "=1\r"}});
  EXPECT_EQ(ask("a"), "=1");
  EXPECT_EQ(peer.got, "a\r");
}

TEST_F(AsciiDialogTest, PutsASplitAnswerTogether) {
  peer.on("a", {{{}, "="}, {milliseconds{100}, "12"}, {milliseconds{200}, "3\r=4"}});
  EXPECT_EQ(ask("a"), "=123");
  EXPECT_EQ(clock.now(), milliseconds{200});
}

TEST_F(AsciiDialogTest, ToleratesLineFeedsAndEmptyLines) {
  peer.on("a", {{{}, "\r\n\r=1\n\r"}});
  EXPECT_EQ(ask("a"), "=1");
}

TEST_F(AsciiDialogTest, HandsOverUnsolicitedLinesWhereverTheyCome) {
  peer.on("a", {{{}, "!x\r=1\r!y\r"}});
  peer.on("b", {{{}, "=2\r!z\r"}});
  peer.say("!early\r");
  EXPECT_EQ(ask("a"), "=1");
  EXPECT_EQ(ask("b"), "=2");
  clock.sleep_for(milliseconds{1});
  dialog.pump();
  EXPECT_EQ(unsolicited, (std::vector<std::string>{"!early", "!x", "!y", "!z"}));
}

TEST_F(AsciiDialogTest, SkipsNoiseBeforeTheAnswer) {
  peer.on("a", {{{}, "\x7f\x01 noise\r=1\r"}});
  EXPECT_EQ(ask("a"), "=1");
}

TEST_F(AsciiDialogTest, DropsALineThatIsTooLongAndReadsOn) {
  peer.on("a", {{{}, std::string(5000, 'x')}, {milliseconds{5}, "tail\r=1\r"}});
  EXPECT_EQ(ask("a"), "=1");
}

TEST_F(AsciiDialogTest, DoesNotTakeAStaleLineForTheAnswer) {
  peer.on("a", {{{}, "=new\r"}});
  peer.say("=old\r");
  EXPECT_EQ(ask("a"), "=new");
}

TEST_F(AsciiDialogTest, TimesOutOnSilenceAndNamesTheCommand) {
  try {
    ask("a");
    FAIL();
  } catch (const TimeoutError& error) {
    EXPECT_NE(std::string(error.what()).find("\"a\""), std::string::npos);
  }
  EXPECT_EQ(clock.now(), milliseconds{1000});
}

TEST_F(AsciiDialogTest, TellsWrongAnswersFromNone) {
  peer.on("a", {{{}, "what?\x01\r"}});
  try {
    ask("a");
    FAIL();
  } catch (const ProtocolError& error) {
    EXPECT_NE(std::string(error.what()).find("what?\\x01"), std::string::npos);
  }
}

TEST_F(AsciiDialogTest, GetsBackIntoStepAfterALateAnswer) {
  peer.on("a", {{milliseconds{1020}, "=late\r"}});
  peer.on("b", {{{}, "=b\r"}});
  EXPECT_THROW(ask("a"), TimeoutError);
  EXPECT_FALSE(dialog.in_step());
  dialog.resync(milliseconds{50}, milliseconds{300});
  EXPECT_TRUE(dialog.in_step());
  EXPECT_EQ(ask("b"), "=b");
  EXPECT_EQ(peer.got, "a\r\rb\r");
}

TEST_F(AsciiDialogTest, EndsAHalfSentCommandBeforeAnUrgentOne) {
  EXPECT_THROW(ask("a"), TimeoutError);
  peer.on("b", {{{}, "=b\r"}});
  EXPECT_EQ(ask("b"), "=b");  // no time for a resync
  EXPECT_EQ(peer.got, "a\r\rb\r");
}

TEST_F(AsciiDialogTest, GivesWayWhileItWaits) {
  EXPECT_THROW(
      dialog.ask(
          "a", milliseconds{1000}, [](std::string_view) { return true; }, [] { return true; }),
      TimeoutError);
  EXPECT_LE(clock.now(), milliseconds{20});
}

TEST_F(AsciiDialogTest, TellsWhatIsNotAnsweredAndStaysInStep) {
  peer.on("a", {{{}, "=1\r"}});
  dialog.tell("go", milliseconds{100});
  EXPECT_TRUE(dialog.in_step());
  EXPECT_EQ(ask("a"), "=1");
  EXPECT_EQ(peer.got, "go\ra\r");
  EXPECT_THROW(ask("b"), TimeoutError);
  dialog.tell("go", milliseconds{100});  // ends what may have been half sent
  EXPECT_FALSE(dialog.in_step());
  clock.sleep_for(milliseconds{1});
  EXPECT_TRUE(peer.got.ends_with("b\r\rgo\r")) << peer.got;
}

TEST_F(AsciiDialogTest, AnEchoIsNoAnswerWhereThatIsSaid) {
  peer.on("=a", {{{}, "=a\r\n"}, {milliseconds{400}, "=1\r\n"}});
  EXPECT_EQ(ask("=a"), "=a");
  dialog.drop_echo();
  dialog.resync(milliseconds{500}, milliseconds{1000});
  EXPECT_EQ(ask("=a"), "=1");
  peer.on("b", {{{}, "=a\r"}});  // once, and no more
  EXPECT_EQ(dialog.ask("b", milliseconds{100}, [](std::string_view) { return true; }), "=a");
}

TEST_F(AsciiDialogTest, HearsALineOutThatIsHalfHere) {
  const auto patient = [] { return false; };
  peer.on("go", {{{}, "!do"}, {milliseconds{60}, "ne\r"}});
  dialog.tell("go", milliseconds{100});
  clock.sleep_for(milliseconds{1});
  dialog.hear_out(patient);
  EXPECT_EQ(unsolicited, std::vector<std::string>{"!done"});
  EXPECT_EQ(clock.now(), milliseconds{60});
  peer.say("noise");
  clock.sleep_for(milliseconds{1});
  for (int i = 0; i < 3; ++i) dialog.hear_out(patient);  // waited for once
  EXPECT_EQ(clock.now(), milliseconds{161});
}

TEST_F(AsciiDialogTest, BlanksAroundALineAreNotPartOfIt) {
  peer.on("a", {{{}, " \t=1 \r"}});
  EXPECT_EQ(ask("a"), "=1");
  EXPECT_EQ(tidy("?x , 12"), "?X,12");
  EXPECT_EQ(tidy("POSITION? X,\t1.5 ,ok"), "POSITION? X,1.5,OK");
  EXPECT_EQ(in_quotes("E\x01"), "\"E\\x01\"");
}

TEST_F(AsciiDialogTest, ResyncWaitsForTheAnswerToItsCrWhereThereIsOne) {
  EXPECT_THROW(ask("a"), TimeoutError);
  peer.on("", {{milliseconds{350}, "OK\r"}});
  peer.say("=late\r");
  const Time before = clock.now();
  dialog.resync(milliseconds{50}, milliseconds{1000},
                [](std::string_view line) { return line == "OK"; });
  EXPECT_EQ(clock.now() - before, milliseconds{400});
  EXPECT_TRUE(dialog.in_step());
  peer.on("b", {{{}, "=b\r"}});
  EXPECT_EQ(ask("b"), "=b");
  EXPECT_THROW(ask("c"), TimeoutError);
  dialog.resync(
      milliseconds{50}, milliseconds{1000}, [](std::string_view) { return false; },
      [] { return true; });
  EXPECT_FALSE(dialog.in_step());  // it gave way
}

TEST_F(AsciiDialogTest, ResyncEndsEvenIfTheLineNeverGetsQuiet) {
  std::vector<Scripted::Piece> babble;
  for (int i = 0; i < 100; ++i) babble.push_back({milliseconds{10 * i}, "babble"});
  peer.on("a", babble);
  EXPECT_THROW(ask("a"), ProtocolError);
  peer.on("", babble);
  const Time before = clock.now();
  dialog.resync(milliseconds{50}, milliseconds{300});
  EXPECT_LE(clock.now() - before, milliseconds{301});
}

}  // namespace
}  // namespace turntable
