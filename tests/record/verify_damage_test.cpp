// What may happen to a run on its disk: each damage is detected and named, and nothing else is lost.
#include <fmt/format.h>
#include <gmock/gmock.h>

#include <boost/crc.hpp>
#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "src/record/pose_document.h"
#include "src/record/run_journal.h"
#include "src/record/sha256.h"
#include "src/record/verify.h"
#include "tests/record/small_plan.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// A small run with one image per pose.
class DamagedRun : public ::testing::Test {
 protected:
  DamagedRun() {
    RunJournal journal(folder, {{"plan_sha256", plan_sha256(plan)}});
    journal.baseline({0, 0, 0, 0});
    for (const PlannedPose& pose : plan.poses) {
      const std::string bytes = "image of " + pose.id;
      TakenPose taken;
      taken.planned = pose;
      TakenImage& archived = taken.images.emplace_back();
      archived.file = fmt::format("images/{}.png", pose.index);
      archived.sha256 = sha256_hex(bytes);
      spill(image(pose.index), bytes);
      journal.pose(taken, "motion");
    }
    journal.stop("success", "");
    text = slurp(folder.journal());
  }
  std::filesystem::path image(std::size_t pose) const {
    return folder.root() / fmt::format("images/{}.png", pose);
  }
  /// With their line ends.
  std::vector<std::string> lines() const {
    std::vector<std::string> out;
    for (std::size_t from = 0, end; from < text.size(); from = end + 1) {
      end = text.find('\n', from);
      out.push_back(text.substr(from, end + 1 - from));
    }
    return out;
  }
  /// Writes the journal with other times, and the CRC that belongs to them.
  void spill_with_times(const std::vector<std::pair<std::string, double>>& utc_and_mono) {
    std::string out;
    std::size_t i = 0;
    for (const std::string& line : lines()) {
      std::string body = line.substr(0, line.rfind(",\"utc\""));
      body += fmt::format(R"(,"utc":"{}","mono_s":{:.6f})", utc_and_mono.at(i).first,
                          utc_and_mono.at(i).second);
      ++i;
      boost::crc_32_type crc;
      crc.process_bytes(body.data(), body.size());
      crc.process_byte('}');
      out += fmt::format("{},\"crc\":\"{:08x}\"}}\n", body, crc.checksum());
    }
    spill(folder.journal(), out);
  }

  TemporaryFolder temporary;
  const Plan plan = small_plan();
  const RunFolder folder = RunFolder::create(temporary / "run", plan);
  std::string text;  ///< of the journal
};

TEST_F(DamagedRun, ThatIsNotIsSound) {
  const RunFindings findings = verify_run(folder);
  EXPECT_THAT(findings.damage, IsEmpty());
  EXPECT_THAT(findings.remarks, IsEmpty());
  EXPECT_EQ(findings.lines, plan.poses.size() + 5);
  EXPECT_EQ(findings.images, plan.poses.size());
}

TEST_F(DamagedRun, AByteAlteredInTheMiddleOfTheJournalIsFoundAndItsLineNamed) {
  // Up to the end of the line before the last: what the last line holds may be a torn write.
  const std::size_t last = text.rfind('\n', text.size() - 2);
  std::size_t tried = 0;
  for (std::size_t at = 0; at < last; at += 11) {
    const char others[] = {static_cast<char>(text[at] ^ 1), static_cast<char>(text[at] ^ 0x80),
                           '\n'};
    const char other = others[tried++ % std::size(others)];
    if (other == text[at]) continue;
    std::string damaged = text;
    damaged[at] = other;
    spill(folder.journal(), damaged);
    const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<long>(at), '\n');
    const auto names_it =
        AllOf(HasSubstr("journal.jsonl"), HasSubstr(fmt::format("line {} ", line)));
    try {
      read_journal(folder.journal(), [](const JournalEntry&) {});
      FAIL() << "no error for byte " << at;
    } catch (const ConfigError& e) {
      ASSERT_THAT(e.what(), names_it) << "byte " << at;
    }
    if (tried % 20 == 0) {
      ASSERT_THAT(verify_run(folder).damage, ElementsAre(names_it)) << "byte " << at;
    }
  }
}

TEST_F(DamagedRun, AJournalCutOffAtALineEndKeepsEveryLineBefore) {
  std::string kept;
  std::size_t poses = 0;
  for (const std::string& line : lines()) {
    kept += line;
    poses += line.find("\"pose_id\":\"") != std::string::npos;
    spill(folder.journal(), kept);
    const RunState state = read_run_state(folder);
    EXPECT_EQ(state.poses_taken(), poses);
    EXPECT_FALSE(state.torn);
    const RunFindings findings = verify_run(folder);
    EXPECT_THAT(findings.damage, IsEmpty());
    const bool whole = kept.size() == text.size();
    EXPECT_EQ(findings.remarks.empty(), whole);
    if (!whole) {
      EXPECT_THAT(findings.remarks.front(), HasSubstr("no stop document"));
    }
  }
  EXPECT_EQ(poses, plan.poses.size());
}

TEST_F(DamagedRun, ALineThatWasTakenOutOrPutTwiceIsNamed) {
  const std::vector<std::string> all = lines();
  for (std::size_t out = 0; out + 2 < all.size(); ++out) {
    std::string without, twice;
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (i != out) without += all[i];
      twice += i == out ? all[i] + all[i] : all[i];
    }
    spill(folder.journal(), without);
    EXPECT_THAT(verify_run(folder).damage,
                ElementsAre(HasSubstr(fmt::format("line {} has sequence number", out + 1))));
    spill(folder.journal(), twice);
    EXPECT_THAT(verify_run(folder).damage,
                ElementsAre(HasSubstr(fmt::format("line {} has sequence number", out + 2))));
  }
}

TEST_F(DamagedRun, AnImageThatIsMissingEmptyCutAlteredOrNoFileIsNamedAndNoOther) {
  const std::string whole = slurp(image(1));
  const auto expect_lost = [&](const char* what) {
    const RunFindings findings = verify_run(folder);
    EXPECT_THAT(findings.damage, ElementsAre(AllOf(HasSubstr("images/1.png"), HasSubstr("pose 1"),
                                                   HasSubstr("turntable resume"))))
        << what;
    EXPECT_THAT(findings.lost_poses, ElementsAre(1)) << what;
    EXPECT_EQ(findings.images, plan.poses.size());
    EXPECT_EQ(read_run(folder).poses.size(), plan.poses.size());
  };
  spill(image(1), "");
  expect_lost("empty");
  spill(image(1), whole.substr(0, whole.size() / 2));
  expect_lost("cut");
  for (std::size_t at = 0; at < whole.size(); ++at) {
    std::string altered = whole;
    altered[at] ^= 4;
    spill(image(1), altered);
    expect_lost("altered");
  }
  std::filesystem::remove(image(1));
  expect_lost("missing");
  std::filesystem::create_directory(image(1));
  expect_lost("a folder");
  std::filesystem::remove(image(1));
  std::filesystem::create_symlink("/dev/zero", image(1));
  expect_lost("a device");
}

TEST_F(DamagedRun, AByteAlteredAnywhereInThePlanIsFound) {
  const std::string whole = slurp(folder.plan());
  for (std::size_t at = 0; at < whole.size(); at += 7) {
    std::string altered = whole;
    altered[at] = altered[at] == ' ' ? '\t' : static_cast<char>(altered[at] ^ 1);
    spill(folder.plan(), altered);
    const RunFindings findings = verify_run(folder);
    ASSERT_THAT(findings.damage, ElementsAre(HasSubstr("plan.json"))) << "byte " << at;
  }
  spill(folder.plan(), whole.substr(0, whole.size() / 2));
  EXPECT_THAT(verify_run(folder).damage, ElementsAre(HasSubstr("plan.json")));
  spill(folder.plan(), whole);
  EXPECT_TRUE(verify_run(folder).sound());
}

TEST_F(DamagedRun, AClockThatWasSetBackIsSaidAndLosesNothing) {
  using Times = std::vector<std::pair<std::string, double>>;
  Times times;
  const std::size_t count = lines().size();
  for (std::size_t i = 0; i < count; ++i)
    times.emplace_back(fmt::format("2026-03-29T03:00:{:02}.250Z", i),
                       100.25 + static_cast<double>(i));
  spill_with_times(times);
  EXPECT_THAT(verify_run(folder).remarks, IsEmpty());

  // An hour back before line 5: from there on every time is earlier than that of line 4.
  for (std::size_t i = 4; i < count; ++i)
    times[i].first = fmt::format("2026-03-29T02:00:{:02}.250Z", i);
  spill_with_times(times);
  RunFindings findings = verify_run(folder);
  EXPECT_THAT(findings.damage, IsEmpty());
  EXPECT_THAT(findings.remarks,
              ElementsAre(AllOf(HasSubstr("line 5"), HasSubstr("set back by 3600.0 s"),
                                HasSubstr("from 2026-03-29T03:00:03.250Z"),
                                HasSubstr("to 2026-03-29T02:00:04.250Z"))));
  const RunState state = read_run_state(folder);
  EXPECT_EQ(state.poses_taken(), plan.poses.size());
  ASSERT_EQ(state.clock_steps.size(), 1u);
  EXPECT_EQ(state.clock_steps[0].line, 5u);
  EXPECT_NEAR(state.clock_steps[0].step_s, -3600.0, 1e-6);

  // A day ahead, over the end of a year.
  for (std::size_t i = 4; i < count; ++i)
    times[i].first = fmt::format("2027-03-29T03:00:{:02}.250Z", i);
  spill_with_times(times);
  EXPECT_THAT(verify_run(folder).remarks,
              ElementsAre(HasSubstr(fmt::format("jumped ahead by {:.1f} s", 365 * 86400.0))));
  // A clock that is slewed, and one that stands still while a minute passes.
  for (std::size_t i = 4; i < count; ++i)
    times[i] = {fmt::format("2026-03-29T03:00:{:02}.250Z", i), 102.0 + static_cast<double>(i)};
  spill_with_times(times);
  EXPECT_THAT(verify_run(folder).remarks, IsEmpty());
  for (std::size_t i = 4; i < count; ++i) times[i].second += 60.0;
  spill_with_times(times);
  EXPECT_THAT(verify_run(folder).remarks, ElementsAre(HasSubstr("set back by 6")));
}

TEST_F(DamagedRun, AnotherSessionMayFollowAReboot) {
  const RunState before = read_run_state(folder);
  {
    RunJournal journal(folder, {}, before);
    journal.baseline({0, 0, 0, 0});
    journal.stop("success", "");
  }
  text = slurp(folder.journal());
  std::vector<std::pair<std::string, double>> times;
  const std::size_t count = lines().size(), first = before.journal.next_seq - 1;
  for (std::size_t i = 0; i < count; ++i)
    times.emplace_back(fmt::format("2026-03-{}T03:00:{:02}.000Z", i < first ? 28 : 29, i),
                       (i < first ? 90000.0 : 10.0) + static_cast<double>(i));
  spill_with_times(times);
  EXPECT_THAT(verify_run(folder).remarks, IsEmpty());
  for (std::size_t i = first; i < count; ++i)
    times[i].first = fmt::format("2026-03-27T03:00:{:02}.000Z", i);
  spill_with_times(times);
  EXPECT_THAT(
      verify_run(folder).remarks,
      ElementsAre(AllOf(HasSubstr(fmt::format("line {}:", first + 1)), HasSubstr("set back"))));
  EXPECT_EQ(read_run_state(folder).sessions.size(), 2u);
}

TEST(FullDisk, LeavesNoPlanAndAFolderThatCanBeTriedAgain) {
  const TemporaryFolder temporary;
  {
    const FileSizeLimit limit(100);
    try {
      RunFolder::create(temporary / "run", small_plan());
      FAIL() << "no error";
    } catch (const RecordError& e) {
      EXPECT_THAT(e.what(), AllOf(HasSubstr("plan.json"), HasSubstr("Make room")));
    }
  }
  EXPECT_THROW(RunFolder::open(temporary / "run"), ConfigError);
  EXPECT_NO_THROW(RunFolder::create(temporary / "run", small_plan()));
}

TEST_F(DamagedRun, AFullDiskKeepsEveryLineThatWasAcknowledged) {
  const RunState before = read_run_state(folder);
  for (const rlim_t more : {0, 1, 100, 1000}) {
    {
      const FileSizeLimit limit(text.size() + more);
      EXPECT_THROW(RunJournal(folder, {{"big", std::string(2000, 'x')}}, before), RecordError);
    }
    EXPECT_EQ(slurp(folder.journal()), text) << more;
  }
  EXPECT_TRUE(verify_run(folder).sound());
}

}  // namespace
}  // namespace turntable
