#include "src/record/verify.h"

#include <gmock/gmock.h>

#include "src/record/atomic_file.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class ComparedOutputs : public ::testing::Test {
 protected:
  ComparedOutputs() {
    for (const char* name : {"stored", "again"}) {
      std::filesystem::create_directory(folder / name);
      spill(folder / name / "a.csv", "x,y\n1,2.000\n3,4.000\n");
      spill(folder / name / "b.csv", "x\n");
    }
  }
  RunFindings compared() {
    RunFindings findings;
    compare_outputs(folder / "stored", folder / "again", "Make it anew.", findings);
    return findings;
  }
  TemporaryFolder folder;
};

TEST_F(ComparedOutputs, AreSoundIfTheyAreTheSameBytes) {
  EXPECT_TRUE(compared().sound());
  EXPECT_EQ(compared().outputs, 2u);
}

TEST_F(ComparedOutputs, AreNamedWithTheFirstLineThatDiffers) {
  spill(folder / "stored/a.csv", "x,y\n1,2.000\n3,4.001\n5,6\n");
  EXPECT_THAT(compared().damage,
              ElementsAre(AllOf(HasSubstr("a.csv"), HasSubstr("line 3"), HasSubstr("\"3,4.001\""),
                                HasSubstr("\"3,4.000\""), HasSubstr("Make it anew."))));
}

TEST_F(ComparedOutputs, AreNamedWhereverTheyWereCutOrGoOn) {
  const std::string whole = slurp(folder / "again/a.csv");
  for (std::size_t length = 0; length < whole.size(); ++length) {
    spill(folder / "stored/a.csv", whole.substr(0, length));
    const auto line =
        1 + std::count(whole.begin(), whole.begin() + static_cast<long>(length), '\n');
    ASSERT_THAT(compared().damage, ElementsAre(HasSubstr("line " + std::to_string(line) + " is")))
        << length;
  }
  spill(folder / "stored/a.csv", whole + "5,6\n");
  EXPECT_THAT(compared().damage, ElementsAre(AllOf(HasSubstr("line 4"), HasSubstr("not there"))));
}

TEST_F(ComparedOutputs, ShowOnlyThePieceOfALongLineThatDiffers) {
  const std::string left(500, 'a'), right(500, 'z');
  spill(folder / "stored/a.csv", left + "1" + right);
  spill(folder / "again/a.csv", left + "2" + right);
  ASSERT_EQ(compared().damage.size(), 1u);
  EXPECT_THAT(compared().damage[0], AllOf(HasSubstr("a1z"), HasSubstr("a2z")));
  EXPECT_LT(compared().damage[0].size(), 400u);
}

TEST_F(ComparedOutputs, ThatAreMissingOrBesideAreNamed) {
  std::filesystem::remove(folder / "stored/a.csv");
  spill(folder / "stored/notes.txt", "");
  EXPECT_THAT(compared().damage, ElementsAre(AllOf(HasSubstr("a.csv"), HasSubstr("is missing")),
                                             HasSubstr("notes.txt")));
  std::filesystem::remove_all(folder / "stored");
  EXPECT_EQ(compared().damage.size(), 2u);
}

TEST_F(ComparedOutputs, MayHaveWhatAKilledWriterLeft) {
  const StagedFile left(folder / "stored/c.csv", "half");
  const RunFindings findings = compared();
  EXPECT_TRUE(findings.sound());
  EXPECT_THAT(findings.remarks, ElementsAre(HasSubstr("c.csv.tmp")));
}

}  // namespace
}  // namespace turntable
