// "turntable calibrate" as a lab uses it: every kind of source once, and its misuses.
#include <gtest/gtest.h>

#include <vector>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

constexpr const char* kPattern = R"("pattern": {
    "columns": 21, "rows": 15, "origin": [10, 6], "spacing_mm": 20, "radius_mm": 5,
    "direction_radius_mm": 7, "direction_circles": [[0, 0], [-1, 1], [2, 1], [0, 4]],
    "circles": "bright"})";

Outcome calibrate(const fs::path& source, const fs::path& out, const std::string& more = "") {
  return turntable_program("calibrate \"" + source.string() + "\" --out \"" + out.string() + "\" " +
                           more);
}

/// A quick sweep, taken once by the program itself, and a lab's folder with its images: plane_0, plane_130, plane_180
/// and view_1 to view_6.
class Calibrate : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    lab_ = new TemporaryFolder;
    const Outcome run = turntable_program(
        "calibrate scenarios/quick/calibration.json --rig scenarios/rigs/simulated.json --out " +
        (*lab_ / "run").string());
    ASSERT_EQ(run.code, 0) << run.output;
    const std::vector<std::string> names{"plane_0", "plane_130", "plane_180", "view_1", "view_2",
                                         "view_3",  "view_4",    "view_5",    "view_6"};
    for (const auto& entry : fs::directory_iterator(*lab_ / "run/images"))
      if (const auto pose = static_cast<std::size_t>(std::stoi(entry.path().filename().string()));
          pose < names.size())
        fs::copy_file(entry.path(), *lab_ / (names[pose] + ".png"));
    spill(*lab_ / "empty.png", "");
    spill(*lab_ / "words.png", "no image");
    spill(*lab_ / "pixel.pgm", std::string("P5 1 1 255\n") + "\x40");
    const std::string whole = slurp(*lab_ / "plane_180.png");
    spill(*lab_ / "half.png", whole.substr(0, whole.size() / 2));
    fs::copy_file(*lab_ / "plane_130.png", *lab_ / "copy.png");
    spill(*lab_ / "points.csv", points());
    spill(*lab_ / "points.json", point_set("points.csv"));
  }
  static void TearDownTestSuite() {
    delete lab_;
    lab_ = nullptr;
  }

  static fs::path lab(const std::string& file) { return *lab_ / file; }

  static std::string set(const std::string& sources, const std::string& order = "3") {
    return R"({"format": "turntable-calibration-set/1", "name": "lab", "polynomial_order": )" +
           order + ", " + sources + "}";
  }
  static std::string planes(const std::string& images_at_180 = R"("plane_180.png")",
                            const std::string& low = "130", const std::string& high = "180") {
    return std::string(kPattern) + R"(, "planes": [
      {"z_mm": )" +
           low + R"(, "use": "fit", "images": ["plane_130.png"]},
      {"z_mm": )" +
           high + R"(, "use": "fit", "images": [)" + images_at_180 + "]}]";
  }
  static std::string views(int count) {
    std::string list;
    for (int i = 1; i <= count; ++i)
      list += (i > 1 ? ", " : "") + ("\"view_" + std::to_string(i)) + ".png\"";
    return std::string(kPattern) + R"(, "views": [)" + list + "]";
  }
  static std::string point_set(const std::string& file, const std::string& more = "") {
    return set(R"("image_size_px": [1024, 1024], "planes": [{"z_mm": 0, "use": "fit"},
      {"z_mm": 100, "use": "fit"}], "points": {"file": ")" +
                   file + "\"" + more + "}",
               "1");
  }
  /// A pinhole 800 mm above z = 0, f = 2000 px, looking down; y up, v down.
  static std::string points() {
    std::string csv = "x_mm,y_mm,z_mm,u_px,v_px\n";
    for (const int z : {0, 100})
      for (int x = -100; x <= 100; x += 50)
        for (int y = -100; y <= 100; y += 50)
          csv += std::to_string(x) + "," + std::to_string(y) + "," + std::to_string(z) + "," +
                 std::to_string(511.5 + 2000.0 * x / (800 - z)) + "," +
                 std::to_string(511.5 - 2000.0 * y / (800 - z)) + "\n";
    return csv;
  }

  struct Misuse {
    std::string source, arguments;
    std::vector<std::string> says;
  };
  /// Exit code 2, one error with these words, no words of a library, nothing written.
  static void expect_refused(const Misuse& misuse) {
    TemporaryFolder folder;
    const Outcome outcome = calibrate(misuse.source, folder / "out", misuse.arguments);
    const std::string what = misuse.source + " " + misuse.arguments + ": " + outcome.output;
    EXPECT_EQ(outcome.code, 2) << what;
    for (const std::string& words : misuse.says)
      EXPECT_NE(outcome.output.find(words), std::string::npos)
          << "no \"" << words << "\" in " << what;
    EXPECT_EQ(outcome.output.find("unexpected: "), std::string::npos) << what;
    EXPECT_EQ(outcome.output.find("OpenCV("), std::string::npos) << what;
    const auto error = outcome.output.find("error: ");
    ASSERT_NE(error, std::string::npos) << what;
    EXPECT_EQ(outcome.output.find("error: ", error + 1), std::string::npos) << what;
    EXPECT_FALSE(fs::exists(folder / "out")) << what;
  }

  static TemporaryFolder* lab_;
};

TemporaryFolder* Calibrate::lab_ = nullptr;

void expect_calibration(const fs::path& folder, const std::vector<std::string>& more = {}) {
  for (const std::string file : {"calibration.json", "calibration.md", "tables/table1.csv"})
    EXPECT_TRUE(fs::is_regular_file(folder / file)) << file;
  // Nothing can be drawn of an ideal camera that came as numbers: then there is no folder.
  EXPECT_FALSE(fs::exists(folder / "figures") && fs::is_empty(folder / "figures"));
  for (const std::string& file : more) EXPECT_TRUE(fs::is_regular_file(folder / file)) << file;
}

TEST_F(Calibrate, FromPlanesAndViewsOfALabInAFolderWithSpaces) {
  TemporaryFolder folder;
  spill(lab("my plate.json"), set(planes() + R"(, "views": ["view_1.png", "view_2.png",
      "view_3.png", "view_4.png"])"));
  const Outcome outcome = calibrate(lab("my plate.json"), folder / "o p");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  expect_calibration(folder / "o p",
                     {"opencv/brown.yml", "tables/orders.csv", "tables/models.csv"});
  EXPECT_EQ(
      turntable_program("calibrate \"" + (folder / "o p/calibration.json").string() + "\"").code,
      0);
  // The paper's residuals are of other planes.
  EXPECT_EQ(slurp(folder / "o p/calibration.md").find("published"), std::string::npos);
}

TEST_F(Calibrate, FromViewsAlone) {
  TemporaryFolder folder;
  spill(lab("views.json"), set(views(6), "4"));
  const Outcome outcome = calibrate(lab("views.json"), folder / "out");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  expect_calibration(folder / "out", {"opencv/brown.yml"});
}

TEST_F(Calibrate, FromPointsAndAgainOverItsOwnResult) {
  TemporaryFolder folder;
  for (int time = 0; time < 2; ++time) {
    const Outcome outcome = calibrate(lab("points.json"), folder / "out");
    ASSERT_EQ(outcome.code, 0) << outcome.output;
    expect_calibration(folder / "out");
  }
}

TEST_F(Calibrate, FromARunToOpenCvAndBack) {
  TemporaryFolder folder;
  const Outcome there = calibrate(lab("run"), folder / "there");
  ASSERT_EQ(there.code, 0) << there.output;
  expect_calibration(folder / "there", {"opencv/brown.yml", "opencv/pinhole.yml"});
  const fs::path camera = folder / "there/opencv/brown.yml";
  const Outcome back = calibrate(camera, folder / "back", "--planes=-700,-500");
  ASSERT_EQ(back.code, 0) << back.output;
  expect_calibration(folder / "back");
  EXPECT_EQ(slurp(camera), slurp(folder / "back/opencv/brown.yml"));

  const std::string yml = slurp(camera);
  spill(lab("cut.yml"), yml.substr(0, yml.size() / 2));
  for (const Misuse& misuse : std::vector<Misuse>{
           {camera.string(), "", {"--planes", "brown.yml", "-800,-600"}},
           {camera.string(), "--planes=-500,-700", {"--planes", "-500,-700", "farther one first"}},
           {camera.string(), "--planes=-700", {"--planes", "two heights"}},
           {camera.string(), "--planes=-inf,-500", {"--planes", "-inf"}},
           {camera.string(), "--planes=nan,-500", {"--planes", "nan"}},
           {camera.string(), "--planes=-700,-699.9999", {"--planes", "apart by"}},
           {camera.string(), "--planes=-700,-500 --order 3", {"--order"}},
           {camera.string(), "--planes=-700,-500 --rig nowhere.json", {"--rig"}},
           {lab("cut.yml").string(),
            "--planes=-700,-500",
            {"cut.yml", "is not a camera file", "cut off"}},
           {(folder / "there/calibration.json").string(), "--order 3", {"--order", "finished"}},
           {(folder / "there/calibration.json").string(), "--planes=-700,-500", {"--planes"}}})
    expect_refused(misuse);
}

TEST_F(Calibrate, RefusesMisuseOfSetsWithFileAndPlace) {
  struct Bad {
    std::string set;
    std::vector<std::string> says;
  };
  const std::string pattern = kPattern;
  const std::vector<Bad> bad{
      {set(planes(R"("nowhere.png")")), {"nowhere.png", "no such file"}},
      {set(planes(R"("run")")), {"/run", "is a folder"}},
      {set(planes(R"("empty.png")")), {"empty.png", "is empty"}},
      {set(planes(R"("words.png")")), {"words.png", "no image", "Allowed: PNG"}},
      {set(planes(R"("half.png")")), {"half.png", "cut off"}},
      {set(planes(R"("pixel.pgm")")), {"pixel.pgm", "1 x 1 px", "1024 x 1024 px"}},
      {set(planes(R"("copy.png")")), {"copy.png", "the same image as", "plane_130.png"}},
      {set(planes(R"("plane_180.png")", "180", "130")), {"set.json", "towards the camera"}},
      {set(planes(R"("plane_180.png")", "0.130", "0.180")), {"set.json", "deg from z", "in mm"}},
      {set(planes(R"("plane_180.png")", "130", "130")), {"/planes/1/z_mm", "twice"}},
      {set(planes(R"("plane_180.png")", "130", "1e300")), {"/planes/1/z_mm", "100000"}},
      {set(R"("image_size_px": [1280, 1024], )" + planes()), {"1024 x 1024", "image_size_px"}},
      {set(views(2)), {"set.json", "found 2", "at least three"}},
      {set(views(5), "\"auto\""), {"set.json", "polynomial_order"}},
      {set(pattern), {"neither planes nor views"}},
      {set(R"("views": ["view_1.png"])"), {"\"pattern\"", "\"points\""}},
      {set(pattern + R"(, "planes": [{"z_mm": 130, "use": "fit", "images": ["plane_130.png"]},
           {"z_mm": 0, "use": "check", "images": ["plane_0.png"]}])"),
       {"/planes", "at least 2"}},
      {set(pattern + R"(, "planes": [{"z_mm": 130, "use": "fit", "images": ["plane_130.png"]},
           {"z_mm": 180, "use": "fit"}])"),
       {"/planes/1", "no images"}},
      {"{\"name\": \"caf\xe9\"}", {"set.json", "UTF-8"}},
      {"", {"set.json", "is empty"}},
  };
  for (const Bad& b : bad) {
    spill(lab("set.json"), b.set);
    expect_refused({lab("set.json").string(), "", b.says});
  }
  for (const std::string order : {"0", "10", "1e9"})
    expect_refused(
        {lab("points.json").string(), "--order=" + order, {"--order", "\"" + order + "\""}});
  expect_refused({lab("points.json").string(), "--order 9", {"points.json", "order 9", "lower"}});
  expect_refused({lab("points.json").string(), "--planes=-7,-5", {"--planes"}});
  expect_refused({lab("points.json").string(), "--rig x.json", {"--rig"}});
  expect_refused({std::string(5000, 'a'), "", {"cannot be read"}});
}

TEST_F(Calibrate, RefusesMisuseOfPointsWithFileAndLine) {
  const std::string good = points(), head = good.substr(0, good.find('\n') + 1);
  const std::string rows = good.substr(head.size());
  const auto with = [](std::string text, const std::string& from, const std::string& to) {
    text.replace(text.find(from), from.size(), to);
    return text;
  };
  struct Bad {
    std::string csv, more;
    std::vector<std::string> says;
  };
  std::string line;  // y = 0 only
  for (const int z : {0, 100})
    for (int x = -100; x <= 100; x += 10)
      line += std::to_string(x) + ",0," + std::to_string(z) + "," + std::to_string(500 + 2 * x) +
              ",500\n";
  for (const Bad& b : std::vector<Bad>{
           {with(good, "x_mm", "x"), "", {"bad.csv at line 1", "\"x_mm\" is missing", "commas"}},
           {with(good, "v_px", "v_px,x_mm"), "", {"line 1", "\"x_mm\" stands twice"}},
           {with(good, "-100,-100,0", "nan,-100,0"), "", {"line 2, column x_mm", "nan"}},
           {with(good, "-100,-100,0", "-100,0"), "", {"line 2", "4 cells"}},
           {with(good, "-100,-100,0", "-100,-100,7"), "", {"line 2", "z = 7 mm"}},
           {good + rows, "", {"bad.csv at line 52", "a second time", "line 2"}},
           {with(good, ",261.", ",9261."), "", {"bad.csv at line 2", "pixel", "1024 x 1024"}},
           {good, R"(, "v_counts": "up")", {"left-handed"}},
           {good, R"(, "refine": {"circles": "bright", "reach_px": 0})", {"reach_px"}},
           {good, R"(, "refine": {"circles": "bright"})", {"/planes/0", "no images"}},
           {"", "", {"bad.csv", "no rows"}},
           {std::string("x\0_", 3) + good, "", {"bad.csv", "no plain text"}},
           {head + line, "", {"bad.json", "strip"}}}) {
    spill(lab("bad.csv"), b.csv);
    spill(lab("bad.json"), point_set("bad.csv", b.more));
    expect_refused({lab("bad.json").string(), "", b.says});
  }
  spill(lab("bad.json"), set(R"("image_size_px": [1024, 1024], "planes": [
      {"z_mm": 130, "use": "fit", "images": ["plane_130.png"]},
      {"z_mm": 180, "use": "fit", "images": ["plane_180.png"]}], "points": {"file": "points.csv"})"));
  expect_refused({lab("bad.json").string(), "", {"/planes/0/images", "refine"}});
  spill(lab("dark.csv"), "x_mm,y_mm,z_mm,u_px,v_px\n0,0,130,5,5\n20,0,130,9,5\n0,20,180,5,5\n");
  spill(lab("bad.json"), set(R"("planes": [
      {"z_mm": 130, "use": "fit", "images": ["plane_130.png"]},
      {"z_mm": 180, "use": "fit", "images": ["plane_180.png"]}], "points": {"file": "dark.csv",
      "refine": {"circles": "bright", "reach_px": 0.001}})"));
  expect_refused({lab("bad.json").string(), "", {"/points/refine", "0.001 px", "130 mm"}});
}

TEST_F(Calibrate, NeverWritesOverOtherThings) {
  TemporaryFolder folder;
  spill(folder / "file", "precious");
  fs::create_directories(folder / "notes");
  spill(folder / "notes/notes.txt", "precious");
  fs::create_directories(folder / "blocked/calibration.json");
  for (const std::string out : {"file", "file/below", "notes", "blocked"}) {
    const Outcome outcome = calibrate(lab("points.json"), folder / out);
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_NE(outcome.output.find("--out"), std::string::npos) << outcome.output;
  }
  EXPECT_EQ(calibrate(lab("points.json"), lab("run")).code, 2);
  EXPECT_EQ(slurp(folder / "file"), "precious");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder / "notes"), fs::directory_iterator()), 1);
  // A disk that takes nothing is no slip of the user's.
  const Outcome nowhere = calibrate(lab("points.json"), "/proc/nowhere");
  EXPECT_EQ(nowhere.code, 3) << nowhere.output;
  EXPECT_NE(nowhere.output.find("can be written"), std::string::npos) << nowhere.output;
}

}  // namespace
}  // namespace turntable
