#include "src/report/table.h"

#include <gtest/gtest.h>

#include <limits>

namespace turntable {
namespace {

Table small() {
  return {
      "small",
      "A table",
      {{"method", "method"},
       {"rmse_deg", "RMSE / deg"},
       {"change_deg", "change / deg", 3},
       {"hidden", ""},
       {"poses", "poses"}},
      {{"a_b", -0.12345678, WithInterval{0.5, {0.25, 0.75}}, 1.0, std::int64_t{7}},
       {"50 % & more", Rounded{0.25, 3}, std::monostate{}, 2.0, std::monostate{}},
       {"none", std::numeric_limits<double>::quiet_NaN(), std::monostate{}, 3.0, std::int64_t{0}}}};
}

TEST(Table, CsvHasUnitsAndBounds) {
  EXPECT_EQ(table_csv(small()),
            "method,rmse_deg,change_deg,change_lower_deg,change_upper_deg,hidden,poses\n"
            "a_b,-0.123457,0.50000,0.25000,0.75000,1.000000,7\n"
            "50 % & more,0.250,,,,2.000000,\n"
            "none,,,,,3.000000,0\n");
}

TEST(Table, MarkdownIsForReading) {
  EXPECT_EQ(table_markdown(small()),
            "| method | RMSE / deg | change / deg | poses |\n"
            "|---|--:|--:|--:|\n"
            "| a_b | -0.1235 | 0.500 [0.250, 0.750] | 7 |\n"
            "| 50 % & more | 0.250 | | |\n"
            "| none | - | | 0 |\n");
}

TEST(Table, MarkdownOfAnybodysTextReadsAsItStands) {
  EXPECT_EQ(markdown_text("Yaw in [-30, 30) deg"), "Yaw in \\[-30, 30) deg");
  EXPECT_EQ(markdown_text("A|B <b> *x* `y` a\\b ~z~ [k](l)"),
            "A\\|B \\<b> \\*x\\* \\`y\\` a\\\\b \\~z\\~ \\[k\\](l)");
  EXPECT_EQ(markdown_text("quick_biaxial_xz _x_ R & D &amp; #1 no #"),
            "quick_biaxial_xz \\_x\\_ R & D \\&amp; #1 no \\#");
  EXPECT_EQ(markdown_text("two\nlines, \xc3\xa4"), "two lines, \xc3\xa4");
  Table table = small();
  table.rows.front().front() = "a|b";
  EXPECT_NE(table_markdown(table).find("| a\\|b | -0.1235 |"), std::string::npos);
}

TEST(Table, LatexEscapes) {
  EXPECT_EQ(table_latex(small()),
            "% A table\n\\begin{tabular}{lrrr}\n\\hline\n"
            "method & RMSE / deg & change / deg & poses \\\\\n\\hline\n"
            "a\\_b & $-0.1235$ & $0.500 [0.250, 0.750]$ & $7$ \\\\\n"
            "50 \\% \\& more & $0.250$ &  &  \\\\\n"
            "none & - &  & $0$ \\\\\n\\hline\n\\end{tabular}\n");
  EXPECT_EQ(latex_text("x<y\\_^"), "x$<$y\\textbackslash{}\\_\\textasciicircum{}");
}

}  // namespace
}  // namespace turntable
