#include "src/record/number_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "src/core/errors.h"
#include "tests/support/message_of.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class NumberTables : public ::testing::Test {
 protected:
  NumberTable read(std::string_view text) {
    spill(folder_ / "t.csv", text);
    return read_number_table(folder_ / "t.csv", {"x_mm", "u_px"}, {"sigma_px"});
  }
  std::string refusal(std::string_view text) {
    return message_of<ConfigError>([&] { read(text); });
  }
  TemporaryFolder folder_;
};

TEST_F(NumberTables, AreReadByTheNamesOfTheirColumns) {
  const NumberTable t =
      read("\xEF\xBB\xBFname, u_px ,x_mm\r\nfirst,1.5,-2\r\n\r\n\"second\",2e3,0.25\r\n");
  EXPECT_THAT(t.at("x_mm"), ElementsAre(-2, 0.25));
  EXPECT_THAT(t.at("u_px"), ElementsAre(1.5, 2000));
  EXPECT_THAT(t.lines, ElementsAre(2, 4));
  EXPECT_FALSE(t.has("sigma_px"));
  EXPECT_THAT(read("sigma_px,x_mm,u_px\n0.02,1,2").at("sigma_px"), ElementsAre(0.02));
}

TEST_F(NumberTables, SayWhereTheyAreWrong) {
  EXPECT_THAT(refusal("x_mm,v_px\n1,2\n"), HasSubstr("\"u_px\" is missing"));
  EXPECT_THAT(refusal("x_mm,u_px\n1,2\n1,two\n"), AllOf(HasSubstr("line 3"), HasSubstr("two")));
  EXPECT_THAT(refusal("x_mm,u_px\n1,nan\n"), HasSubstr("finite"));
  EXPECT_THAT(refusal("x_mm,u_px\n1,\n"), HasSubstr("found \"\""));
  EXPECT_THAT(refusal("x_mm,u_px\n1,2,3\n"), HasSubstr("found 3 cells"));
  EXPECT_THAT(refusal("x_mm,u_px\n"), HasSubstr("no rows"));
  EXPECT_THAT(refusal(""), HasSubstr("no rows"));
}

}  // namespace
}  // namespace turntable
