#include "src/record/csv.h"

#include <gtest/gtest.h>

#include <limits>

#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

TEST(Csv, WritesTheSameDigitsAlwaysAndQuotesOnlyWhatNeedsIt) {
  Csv csv({"name", "x_mm", "n"});
  csv.text("plain").number(1.0 / 3, 3).integer(-2).end_row();
  csv.text("a,\"b\"").number(-1e-9, 3).integer(0).end_row();
  csv.text("").number(std::numeric_limits<double>::quiet_NaN(), 3).empty().end_row();
  EXPECT_EQ(csv.str(), "name,x_mm,n\nplain,0.333,-2\n\"a,\"\"b\"\"\",0.000,0\n,,\n");
  const TemporaryFolder folder;
  csv.write(folder / "a.csv");
  EXPECT_EQ(slurp(folder / "a.csv"), csv.str());
}

TEST(Csv, ShowsNoNegativeZero) {
  EXPECT_EQ(fixed(-0.0004, 3), "0.000");
  EXPECT_EQ(fixed(-0.0006, 3), "-0.001");
  EXPECT_EQ(fixed(-0.4, 0), "0");
}

}  // namespace
}  // namespace turntable
