#include "src/report/html_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "src/core/errors.h"
#include "src/record/atomic_file.h"
#include "src/report/paper_svg.h"
#include "src/report/pdf.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

/// Points of two solvers, poses 7, 8 and 9, one of them measured by one solver only.
PosePoints points_of_two() {
  PosePoints points({"x", "y"});
  const Solver &one = kSolvers[0], &other = kSolvers[1];
  for (const auto& [solver, pose] :
       {std::pair(&one, 7), {&other, 7}, {&one, 8}, {&one, 9}, {&other, 9}})
    points.row(*solver, static_cast<std::size_t>(pose)).integer(pose).integer(2 * pose).end_row();
  return points;
}

/// They, and a third solver that has none.
Draft two_solvers() {
  const PosePoints points = points_of_two();
  const Solver &one = kSolvers[0], &other = kSolvers[1], &none = kSolvers[2];
  Draft draft;
  draft.figure.name = "two";
  draft.figure.caption = "Two <solvers> & their points.";
  points.draw(draft, one, "3", "4", solver_look(one, 0));
  points.draw(draft, none, "3", "4", solver_look(none, 2));
  points.draw(draft, other, "(1 * $3)", "4", solver_look(other, 1));
  draft.element("20 with lines title 'bound'").end_plot();
  draft.commands += "set key off\nset palette grey\n";
  points.draw(draft, other, "3", "4:4:4", "pt 7 lc palette", "splot");
  draft.end_plot();
  draft.commands = "set multiplot layout 1,2\n" + draft.commands + "unset multiplot\n";
  draft.figure.drawn = true;
  return draft;
}

std::string csv_of_two_solvers() { return points_of_two().csv(); }

/// An SVG is too long to be printed by a matcher.
bool has(const std::string& svg, const std::string& text) {
  return svg.find(text) != std::string::npos;
}

TEST(PosePoints, KeepsEachSolversRowsTogether) {
  const std::string one(kSolvers[0].name), other(kSolvers[1].name);
  EXPECT_EQ(points_of_two().csv(), "solver,pose,x,y\n" + one + ",7,7,14\n" + one + ",8,8,16\n" +
                                       one + ",9,9,18\n" + other + ",7,7,14\n" + other +
                                       ",9,9,18\n");
  EXPECT_TRUE(points_of_two().none_of(kSolvers[2]));
  EXPECT_FALSE(points_of_two().none_of(kSolvers[1]));
}

TEST(InlineSvg, TellsPointsOfSolversAndTheirPoses) {
  const Draft draft = two_solvers();
  const std::string svg = inline_svg(draw_svg(draft, csv_of_two_solvers()), draft.figure, "f3-");
  const auto group = [](const Solver& solver, const char* poses) {
    return "<g class=\"plot\" data-solver=\"" + std::string(solver.name) + "\" data-poses=\"" +
           poses + "\">";
  };
  for (const std::string& text :
       {group(kSolvers[0], "7 8 9"), group(kSolvers[1], "7 9"), std::string("<g class=\"plot\">\n"),
        std::string("id='f3-gpPt"), std::string("href='#f3-gpPt")})
    EXPECT_TRUE(has(svg, text)) << text;
  for (const char* text : {"unlinked", "<?xml", "xlink", "id='gp", "rgb("})
    EXPECT_FALSE(has(svg, text)) << text;
}

TEST(InlineSvg, LinksNothingWhereGnuplotLeftOutAPoint) {
  const Draft draft = two_solvers();
  std::string csv = csv_of_two_solvers();
  csv.replace(csv.find(",8,8,16"), 7, ",8,8,NaN");
  const std::string svg = inline_svg(draw_svg(draft, csv), draft.figure, "f0-");
  EXPECT_TRUE(has(svg, "class=\"unlinked\""));
  EXPECT_FALSE(has(svg, "data-poses=\"7 8 9"));
}

TEST(MarkdownToHtml, HasHeadersIdsAndNoForeignMarkup) {
  const std::string html = markdown_to_html(
      "# A <script>alert(1)</script> title\n\n## Same\n\n## Same\n\n| a | b |\n|---|--:|\n| x | 1 "
      "|\n\n<details><summary>More</summary>\n\ntext\n\n</details>\n\n<b>bold</b>\n");
  EXPECT_THAT(html, AllOf(HasSubstr("<h2 id=\"same\">"), HasSubstr("<h2 id=\"same-2\">"),
                          HasSubstr("<th scope=\"col\">a"),
                          HasSubstr("<th scope=\"col\" align=\"right\">b"),
                          HasSubstr("<details><summary>More</summary>"), HasSubstr("</details>")));
  EXPECT_THAT(html, AllOf(Not(HasSubstr("<script>")), Not(HasSubstr("<b>")), HasSubstr("<thead>")));
}

TEST(MarkdownToHtml, IdsOfLongHeadingsAreTheirFirstWords) {
  std::string words, letters(90, 'x');
  for (int i = 0; i < 30; ++i) words += "word ";
  const std::string html =
      markdown_to_html("## " + words + "one\n\n## " + words + "two\n\n## " + letters + "\n\n");
  std::string sixteen = "word";
  for (int i = 1; i < 16; ++i) sixteen += "-word";
  EXPECT_THAT(html, AllOf(HasSubstr("<h2 id=\"" + sixteen + "\">"),
                          HasSubstr("<h2 id=\"" + sixteen + "-2\">"),
                          HasSubstr("<h2 id=\"" + letters.substr(0, 80) + "\">")));
}

TEST(WriteHtml, PutsFiguresWithOneCaptionIntoThePage) {
  TemporaryFolder folder;
  const Draft draft = two_solvers();
  std::filesystem::create_directories(folder / "figures");
  write_atomically(folder / "figures/two.svg", draw_svg(draft, csv_of_two_solvers()));
  write_atomically(folder / "report.md",
                   "# Title\n\nText\n\n## Figures\n\n" + figures_markdown({draft.figure}));
  const Json poses{{"a", "</script>"}};
  const auto page = write_html(folder / "report.md", {draft.figure}, &poses);
  EXPECT_EQ(page, folder / "report.html");
  const std::string html = slurp(page);
  EXPECT_TRUE(html.starts_with("<!doctype html>\n<html lang=\"en\">"));
  EXPECT_THAT(
      html, AllOf(HasSubstr("<title>Title</title>"), HasSubstr("<a href=\"#figures\">Figures</a>"),
                  HasSubstr("<figure id=\"figure-two\">"), HasSubstr("{\"a\":\"<\\/script>\"}"),
                  HasSubstr("aria-labelledby=\"caption-two\""), Not(HasSubstr("<img"))));
  const std::string caption = "Two &lt;solvers&gt; &amp; their points.";
  EXPECT_EQ(html.find(caption), html.rfind(caption));
}

TEST(PageForPaper, HasFiguresAsImagesUnfoldedWithoutScriptOrLinksToFiles) {
  TemporaryFolder folder;
  std::filesystem::create_directories(folder / "figures");
  write_atomically(folder / "figures/two.svg", "<svg viewBox=\"0 0 9 9\"/>");
  write_atomically(folder / "report.md",
                   "# Title\n\n## Figures\n\n![Two points](figures/two.svg)\n\nTheir *caption* "
                   "([data](figures/two.csv))\n\n[above](#title), [paper](https://doi.org/1)\n\n"
                   "<details><summary>More</summary>\n\ntext\n\n</details>\n");
  const std::string page = page_for_paper(folder / "report.md");
  EXPECT_THAT(
      page,
      HasSubstr("<figure class=\"tall\">\n<img "
                "src=\"data:image/svg+xml;base64,PHN2ZyB2aWV3Qm94PSIwIDAgOSA5Ii8+\" alt=\"Two "
                "points\">\n<figcaption>Their <em>caption</em> "
                "(<a>data</a>)</figcaption>\n</figure>"));
  EXPECT_THAT(page, AllOf(HasSubstr("<a href=\"#title\">above"),
                          HasSubstr("<a href=\"https://doi.org/1\">paper"),
                          HasSubstr("<details open><summary>More"), Not(HasSubstr("<script"))));
}

TEST(MarksAsPaths, JoinsNeighboursThatLookTheSame) {
  const auto mark = [](int shape, const char* place, const char* colour) {
    return fmt::format(
        "\t<use xlink:href='#gpPt{}' transform='translate({}) scale(2.00)' color='{}'/>\n", shape,
        place, colour);
  };
  const std::string kind = "<path id='gpPt0' stroke-width='0.25' d='M-1,0'/>\n<g>\n";
  EXPECT_EQ(
      marks_as_paths(kind + mark(0, "1,2", "red") + mark(0, "3,4.5", "red") +
                     mark(0, "5,6", "blue") + mark(4, "7,8", "blue") + mark(6, "7,9", "blue") +
                     mark(99, "9,9", "red") + "</g>\n<text>no line end</text>"),
      kind +
          "<path d='M1,2m-2.00 0h4.00m-2.00 -2.00v4.00M3,4.5m-2.00 0h4.00m-2.00 -2.00v4.00' "
          "stroke='red' stroke-width='0.500' fill='none'/>\n"
          "<path d='M5,6m-2.00 0h4.00m-2.00 -2.00v4.00' stroke='blue' stroke-width='0.500' "
          "fill='none'/>\n"
          "<path d='M7,8m-2.00 -2.00h4.00v4.00h-4.00z' stroke='blue' stroke-width='0.500' "
          "fill='blue'/>\n"
          "<path d='M7,9h0' stroke='blue' stroke-width='4.50' stroke-linecap='round'/>\n" +
          mark(99, "9,9", "red") + "</g>\n<text>no line end</text>");
}

/// Corners of a path's piece as `marks_as_paths` writes it for a mark at the origin.
std::vector<std::pair<double, double>> corners(const std::string& svg) {
  const std::size_t begin = svg.find("d='M0,0") + 7;
  std::istringstream in(svg.substr(begin, svg.find('\'', begin) - begin));
  std::vector<std::pair<double, double>> out;
  double x = 0, y = 0;
  for (char c = 0; in >> c && c != 'z';) {
    double dx = 0, dy = 0;
    if (c == 'm' || c == 'l') in >> dx >> dy;
    if (c == 'h') in >> dx;
    if (c == 'v') in >> dy;
    out.emplace_back(x += dx, y += dy);
  }
  return out;
}

TEST(MarksAsPaths, DrawsGnuplotsShapes) {
  // As gnuplot's own <defs> have them, of half width 1; "up" is M0,-1.33 L-1.33,0.67 L1.33,0.67 z.
  using Corners = std::vector<std::pair<double, double>>;
  const Corners up{{0, -1.33}, {-1.33, 0.67}, {0, 0.67}, {1.33, 0.67}},
      down{{0, 1.33}, {1.33, -0.67}, {0, -0.67}, {-1.33, -0.67}},
      square{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}},
      diamond{{0, -1.41}, {1.41, 0}, {0, 1.41}, {-1.41, 0}};
  const std::map<int, Corners> shapes{{0, {{-1, 0}, {1, 0}, {0, -1}, {0, 1}}},
                                      {1, {{-1, -1}, {1, 1}, {1, -1}, {-1, 1}}},
                                      {3, square},
                                      {4, square},
                                      {7, up},
                                      {8, up},
                                      {9, down},
                                      {10, down},
                                      {11, diamond},
                                      {12, diamond}};
  for (const auto& [shape, expected] : shapes) {
    const std::string svg = marks_as_paths(fmt::format(
        "<use xlink:href='#gpPt{}' transform='translate(0,0) scale(1)' color='red'/>\n", shape));
    const Corners found = corners(svg);
    ASSERT_EQ(found.size(), expected.size()) << svg;
    for (std::size_t i = 0; i < found.size(); ++i) {
      EXPECT_NEAR(found[i].first, expected[i].first, 1e-9) << svg;
      EXPECT_NEAR(found[i].second, expected[i].second, 1e-9) << svg;
    }
    const bool filled = shape == 4 || shape == 8 || shape == 10 || shape == 12;
    EXPECT_THAT(svg, HasSubstr(filled ? "fill='red'" : "fill='none'"));
  }
}

/// A folder with programs of these names and shell scripts, which is all of PATH while this lives.
class OnlyPrograms {
 public:
  explicit OnlyPrograms(const std::vector<std::pair<std::string, std::string>>& scripts) {
    for (const auto& [name, script] : scripts) {
      const std::filesystem::path file = folder_ / name;
      write_atomically(file, "#!/bin/sh\n" + script + "\n");
      std::filesystem::permissions(file, std::filesystem::perms::owner_all);
    }
    ::setenv("PATH", folder_.path().c_str(), 1);
  }
  ~OnlyPrograms() { ::setenv("PATH", path_.c_str(), 1); }

 private:
  TemporaryFolder folder_;
  std::string path_ = std::getenv("PATH");
};

std::optional<std::string> printed(const std::filesystem::path& pdf) {
  PdfPrinter printer;
  printer.load("<!doctype html><title>t</title><p>text</p>");
  return printer.print(pdf);
}

TEST(PrintPdf, SaysWhatIsMissingWithoutChromium) {
  TemporaryFolder folder;
  const OnlyPrograms none({});
  const auto trouble = printed(folder / "page.pdf");
  ASSERT_TRUE(trouble.has_value());
  EXPECT_THAT(*trouble, AllOf(HasSubstr("Chromium"), HasSubstr("Install it")));
  EXPECT_FALSE(std::filesystem::exists(folder / "page.pdf"));
}

TEST(PrintPdf, SaysWhatBecameOfEachChromium) {
  TemporaryFolder folder;
  const std::string other = R"(printf '{"id":1,"result":{}}\000' >&4; read -r rest <&3)";
  const std::string refuses =
      R"(printf '{"id":1,"error":{"message":"not now"}}\000' >&4; read -r rest <&3)";
  const std::string noise = R"(printf 'usage\000' >&4; read -r rest <&3)";
  const OnlyPrograms programs({{"chromium-headless-shell", "exit 1"},
                               {"chromium", other},
                               {"chromium-browser", refuses},
                               {"google-chrome", noise}});
  const auto trouble = printed(folder / "page.pdf");
  ASSERT_TRUE(trouble.has_value());
  EXPECT_THAT(*trouble, AllOf(HasSubstr("chromium-headless-shell ended"),
                              HasSubstr("chromium answered something else"),
                              HasSubstr("chromium-browser refused: not now"),
                              HasSubstr("google-chrome answered what is no message"),
                              HasSubstr("from any browser")));
  EXPECT_FALSE(std::filesystem::exists(folder / "page.pdf"));
}

/// The answers of a Chromium, up to the page.
const std::string kAnswersUpToThePage =
    R"(printf '{"id":1,"result":{"targetId":"t"}}\000' >&4
printf '{"id":2,"result":{"sessionId":"s"}}\000{"id":3,"res' >&4
printf 'ult":{}}\000{"id":4,"result":{}}\000' >&4
printf '{"id":5,"result":{}}\000' >&4
)";
/// And of one that prints what it is told to.
std::string prints(const std::string& base64) {
  return kAnswersUpToThePage +
         R"(printf '{"method":"Page.lifecycleEvent","params":{"name":"load","loaderId":"blank"}}\000' >&4
printf '{"id":6,"result":{"loaderId":"l"}}\000' >&4
printf '{"method":"Page.lifecycleEvent","params":{"name":"load","loaderId":"l"}}\000' >&4
printf '{"id":7,"result":{"stream":"1"}}\000' >&4
printf '{"id":8,"result":{"base64Encoded":true,"eof":true,"data":")" +
         base64 + R"("}}\000' >&4; read -r rest <&3)";
}
constexpr const char* kWhole = "JVBERi0xLjQKJSVFT0YK";  // "%PDF-1.4\n%%EOF\n"

TEST(PrintPdf, TakesThePdfOfTheNextOneThatWorks) {
  TemporaryFolder folder;
  const OnlyPrograms programs({{"chromium-headless-shell", "exit 1"},
                               {"chromium", prints("JVBERi0xLjQK")},  // without an end
                               {"google-chrome", prints(kWhole)}});
  EXPECT_EQ(printed(folder / "page.pdf"), std::nullopt);
  EXPECT_EQ(slurp(folder / "page.pdf"), "%PDF-1.4\n%%EOF\n");
}

TEST(PrintPdf, DoesNotPrintAPageOfErrors) {
  TemporaryFolder folder;
  const OnlyPrograms programs(
      {{"chromium",
        kAnswersUpToThePage +
            R"(printf '{"id":6,"result":{"loaderId":"l","errorText":"net::ERR"}}\000' >&4
read -r rest <&3)"},
       {"google-chrome", kAnswersUpToThePage +
                             R"(printf '{"method":"Inspector.targetCrashed"}\000' >&4
read -r rest <&3)"}});
  const auto trouble = printed(folder / "page.pdf");
  ASSERT_TRUE(trouble.has_value());
  EXPECT_THAT(*trouble, AllOf(HasSubstr("chromium could not load the page: net::ERR"),
                              HasSubstr("google-chrome crashed with the page")));
}

/// Within half a minute, on whatever machine.
template <class Condition>
bool comes_true(const Condition& condition) {
  for (int i = 0; i < 3000; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

TEST(PrintPdf, EndsWhatItStartedAndIsLate) {
  TemporaryFolder folder, temporary;
  const char* const before = std::getenv("TMPDIR");
  const std::string kept = before == nullptr ? "" : before;
  ::setenv("TMPDIR", temporary.path().c_str(), 1);
  const std::filesystem::path pids = folder / "pids";
  std::optional<std::string> trouble;
  {
    // It hears nothing, and neither does its child.
    const OnlyPrograms programs(
        {{"chromium", "while :; do :; done & echo $$ $! > " + pids.string() + "; wait"},
         {"google-chrome", prints(kWhole)}});
    PdfPrinter printer(std::chrono::milliseconds(300));
    ASSERT_TRUE(comes_true([&] { return slurp(pids).ends_with('\n'); }));
    printer.load("text");
    trouble = printer.print(folder / "page.pdf");
  }
  before == nullptr ? ::unsetenv("TMPDIR") : ::setenv("TMPDIR", kept.c_str(), 1);
  ASSERT_TRUE(trouble.has_value());
  EXPECT_THAT(*trouble,
              AllOf(HasSubstr("chromium took too long"), Not(HasSubstr("google-chrome"))));
  EXPECT_TRUE(std::filesystem::is_empty(temporary.path()));
  std::istringstream in(slurp(pids));
  for (std::string process; in >> process;)
    EXPECT_TRUE(comes_true([&] {
      // What nobody waits for stays as a zombie, which runs no more.
      const std::string state = slurp("/proc/" + process + "/stat");
      return state.empty() || state.find(") Z") != std::string::npos;
    })) << process;
}

TEST(PrintPdf, SaysWhereThereIsNoRoom) {
  TemporaryFolder folder;
  const char* const before = std::getenv("TMPDIR");
  const std::string kept = before == nullptr ? "" : before;
  for (const char* const wrong : {"/proc", "/nowhere", "/dev/null"}) {
    ::setenv("TMPDIR", wrong, 1);
    const auto trouble = printed(folder / "page.pdf");
    ASSERT_TRUE(trouble.has_value());
    EXPECT_THAT(*trouble, AllOf(HasSubstr("not printed"), HasSubstr("TMPDIR")));
  }
  before == nullptr ? ::unsetenv("TMPDIR") : ::setenv("TMPDIR", kept.c_str(), 1);
  EXPECT_FALSE(std::filesystem::exists(folder / "page.pdf"));
}

}  // namespace
}  // namespace turntable
