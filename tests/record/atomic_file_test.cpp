#include "src/record/atomic_file.h"

#include <gmock/gmock.h>

#include "src/core/errors.h"
#include "src/record/sha256.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

std::size_t files_in(const std::filesystem::path& folder) {
  return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder),
                                                std::filesystem::directory_iterator()));
}

TEST(AtomicFile, ReplacesAFileWhole) {
  const TemporaryFolder folder;
  write_atomically(folder / "a.txt", "old and longer");
  write_atomically(folder / "a.txt", "new");
  EXPECT_EQ(slurp(folder / "a.txt"), "new");
  EXPECT_EQ(files_in(folder.path()), 1u);
}

TEST(AtomicFile, LeavesTheOldFileAndNothingElseWhenTheDiskIsFull) {
  const TemporaryFolder folder;
  write_atomically(folder / "a.txt", "old");
  {
    const FileSizeLimit limit(1000);
    try {
      write_atomically(folder / "a.txt", std::string(5000, 'x'));
      FAIL() << "no error";
    } catch (const RecordError& e) {
      EXPECT_THAT(e.what(), HasSubstr((folder / "a.txt").string()));
      EXPECT_THAT(e.what(), HasSubstr("Make room"));
    }
  }
  EXPECT_EQ(slurp(folder / "a.txt"), "old");
  EXPECT_EQ(files_in(folder.path()), 1u);
}

TEST(AtomicFile, NamesTheFileAndTheCauseWhenItCannotBeCreated) {
  try {
    write_atomically("/proc/turntable/a.txt", "x");
    FAIL() << "no error";
  } catch (const RecordError& e) {
    EXPECT_THAT(e.what(), HasSubstr("/proc/turntable/a.txt"));
    EXPECT_THAT(e.what(), HasSubstr("No such file"));
  }
}

TEST(Sha256, AgreesWithTheStandardsExample) {  // FIPS 180-2, appendix B.1
  EXPECT_EQ(sha256_hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

}  // namespace
}  // namespace turntable
