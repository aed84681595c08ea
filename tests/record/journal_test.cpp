#include "src/record/journal.h"

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <boost/crc.hpp>
#include <nlohmann/json.hpp>
#include <set>

#include "src/core/errors.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

std::vector<std::string> names_in(const std::filesystem::path& file,
                                  JournalReadout* readout = nullptr) {
  std::vector<std::string> names;
  const auto result =
      read_journal(file, [&](const JournalEntry& e) { names.push_back(e.name + e.doc.dump()); });
  if (readout != nullptr) *readout = result;
  return names;
}

class JournalTest : public ::testing::Test {
 protected:
  JournalTest() {
    Journal journal(file);
    journal.append("start", {{"uid", "a"}});
    journal.append("event", {{"n", 1}});
    journal.append("stop", {{"ok", true}});
    journal.sync();
    text = slurp(file);
  }
  TemporaryFolder folder;
  std::filesystem::path file = folder / "journal.jsonl";
  std::string text;
};

TEST_F(JournalTest, ReadsBackWhatWasWritten) {
  JournalReadout readout;
  EXPECT_THAT(
      names_in(file, &readout),
      ::testing::ElementsAre(R"(start{"uid":"a"})", R"(event{"n":1})", R"(stop{"ok":true})"));
  EXPECT_EQ(readout.next_seq, 4u);
  EXPECT_EQ(readout.valid_bytes, text.size());
  EXPECT_FALSE(readout.torn);
}

TEST_F(JournalTest, ItsCrcIsThatOfTheLineWithoutTheCrcMember) {
  const std::string line = text.substr(0, text.find('\n'));
  const std::string bare = line.substr(0, line.size() - 18) + "}";  // the recipe of journal.h
  EXPECT_EQ(Json::parse(bare).at("seq"), 1);
  boost::crc_32_type crc;
  crc.process_bytes(bare.data(), bare.size());
  EXPECT_EQ(Json::parse(line).at("crc"), fmt::format("{:08x}", crc.checksum()));
}

TEST(JournalCrc, IsTheOneOfZlib) {
  boost::crc_32_type crc;
  crc.process_bytes("123456789", 9);
  EXPECT_EQ(crc.checksum(), 0xcbf43926u);
}

TEST_F(JournalTest, IsReadableWhereverItWasCutOff) {
  const std::size_t second = text.find('\n') + 1, third = text.find('\n', second) + 1;
  for (std::size_t length = 0; length <= text.size(); ++length) {
    spill(file, text.substr(0, length));
    JournalReadout readout;
    const auto names = names_in(file, &readout);
    const std::size_t whole = length < second        ? 0
                              : length < third       ? 1
                              : length < text.size() ? 2
                                                     : 3;
    ASSERT_EQ(names.size(), whole) << length;
    const bool between = length == 0 || text[length - 1] == '\n';
    ASSERT_EQ(readout.torn.has_value(), !between) << length;
    ASSERT_EQ(readout.valid_bytes,
              text.rfind('\n', length == 0 ? 0 : length - 1) == std::string::npos || length < second
                  ? 0
                  : text.rfind('\n', length - 1) + 1)
        << length;
  }
}

TEST_F(JournalTest, RefusesDamageBeforeTheLastLineAndNamesTheLine) {
  const std::size_t second = text.find('\n') + 1;
  for (const std::size_t at : {std::size_t{3}, second - 10, second + 30}) {
    std::string damaged = text;
    damaged[at] = damaged[at] == 'x' ? 'y' : 'x';
    spill(file, damaged);
    try {
      names_in(file);
      FAIL() << "no error for byte " << at;
    } catch (const ConfigError& e) {
      EXPECT_THAT(e.what(), HasSubstr(at < second ? "line 1" : "line 2"));
    }
  }
}

TEST_F(JournalTest, RefusesAMissingLine) {
  const std::size_t second = text.find('\n') + 1, third = text.find('\n', second) + 1;
  std::string without = text.substr(0, second) + text.substr(third);
  spill(file, without + text.substr(third));
  EXPECT_THROW(names_in(file), ConfigError);
}

TEST_F(JournalTest, IsNeverStartedOverAnotherOne) {
  EXPECT_THROW(Journal{file}, RecordError);
  EXPECT_EQ(slurp(file), text);
}

TEST(Journal, TakesBackALineThatDoesNotFitOnTheDisk) {
  const TemporaryFolder folder;
  Journal journal(folder / "j");
  journal.append("start", {{"uid", "a"}});
  {
    const FileSizeLimit limit(500);
    EXPECT_THROW(journal.append("event", {{"text", std::string(2000, 'x')}}), RecordError);
  }
  journal.append("stop", {{"reason", "disk full"}});
  EXPECT_EQ(names_in(folder / "j").size(), 2u);
}

TEST(Journal, ReplacesWhatIsNotUtf8) {
  const TemporaryFolder folder;
  Journal journal(folder / "j");
  journal.append("start", {{"identity", "MC600 \xff\xfe"}});
  EXPECT_EQ(names_in(folder / "j").size(), 1u);
}

TEST(Uid, IsAVersion4UuidAndNeverTheSame) {
  std::set<std::string> seen;
  for (int i = 0; i < 1000; ++i) {
    const std::string uid = new_uid();
    ASSERT_EQ(uid.size(), 36u);
    ASSERT_EQ(uid[14], '4');
    ASSERT_THAT("89ab", HasSubstr(std::string(1, uid[19])));
    ASSERT_TRUE(seen.insert(uid).second);
  }
}

}  // namespace
}  // namespace turntable
