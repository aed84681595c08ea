// Files that a colleague sends, changed at random, through everything that reads them. Under the address and
// undefined-behaviour sanitizers; laws: no crash, no other exception than the project's own with the file's name in it,
// no input that takes longer than kPatience_s or asks for more than kMost_mb at once, nothing printed by a library.
// Every input follows from its reader's name and its number: HOSTILE_FILES=100000 tries so many of each reader (the
// default is what a test has time for), HOSTILE_FIRST=4711 begins there.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/time.h>
#include <unistd.h>

#include <boost/crc.hpp>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "drivers/controller_description.h"
#include "drivers/sim/fault_file.h"
#include "drivers/telemetry.h"
#include "src/campaign/planning.h"
#include "src/campaign/scenario.h"
#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/rig_file.h"
#include "src/core/target_file.h"
#include "src/evaluation/calibration_set.h"
#include "src/imaging/calibration.h"
#include "src/imaging/opencv_yaml.h"
#include "src/record/image_archive.h"
#include "src/record/image_import.h"
#include "src/record/number_table.h"
#include "src/record/run_folder.h"
#include "src/record/run_journal.h"
#include "tests/support/draws.h"
#include "tests/support/temporary_folder.h"

namespace {
// Where the program is, for whatever ends it.
char now_reading[200] = "";
void say_where() {
  const std::size_t size = std::strlen(now_reading);
  [[maybe_unused]] const auto ignored = ::write(STDOUT_FILENO, now_reading, size);
}
void out_of_patience(int) {
  say_where();
  constexpr char kWhy[] = ": takes too long\n";
  [[maybe_unused]] const auto ignored = ::write(STDOUT_FILENO, kWhy, sizeof kWhy - 1);
  std::abort();
}
}  // namespace

extern "C" const char* __asan_default_options() {
  return "max_allocation_size_mb=1500:hard_rss_limit_mb=4000:detect_leaks=0";
}
extern "C" void __asan_on_error() { say_where(); }

namespace turntable {
namespace {

namespace fs = std::filesystem;

constexpr int kPatience_s = 20;  ///< of the processor's time

std::size_t pick(Random& random, std::size_t count) {
  return static_cast<std::size_t>(random.uniform() * static_cast<double>(count));
}

template <class T>
const T& one_of(Random& random, const std::vector<T>& from) {
  return from[pick(random, from.size())];
}

const std::vector<std::string>& numbers() {
  static const std::vector<std::string> list{"0",
                                             "-0.0",
                                             "-1",
                                             "1e-300",
                                             "1e308",
                                             "-1e308",
                                             "1e400",
                                             "2147483647",
                                             "2147483648",
                                             "-2147483649",
                                             "4294967296",
                                             "9007199254740993",
                                             "18446744073709551616",
                                             "1e9",
                                             "1000000",
                                             "0.1",
                                             "3.5",
                                             "1e-9",
                                             "nan",
                                             "-inf",
                                             "0x10",
                                             "1,5",
                                             "000001"};
  return list;
}

const std::vector<std::string>& texts() {
  static const std::vector<std::string> list{"",
                                             std::string(4000, 'a'),
                                             std::string(100'000, 'a'),
                                             "../../../../etc/passwd",
                                             "/dev/zero",
                                             "/dev/stdin",
                                             "/proc/self/mem",
                                             ".",
                                             "line\nline",
                                             std::string("nul\0nul", 7),
                                             "\xc3\xa9\xe2\x82\xac",
                                             "\xff\xfe",
                                             "%s%n{}",
                                             " "};
  return list;
}

/// Of bytes that may be anything.
std::string changed_bytes(std::string text, Random& random,
                          const std::vector<std::string>& corpus) {
  const std::size_t changes = 1 + pick(random, 4);
  for (std::size_t i = 0; i < changes; ++i) {
    const std::size_t at = pick(random, text.size() + 1);
    const std::size_t length =
        std::min(text.size() - at, 1 + pick(random, random.uniform() < 0.8 ? 8 : 400));
    switch (pick(random, 9)) {
      case 0:
        if (at < text.size()) text[at] = static_cast<char>(random());
        break;
      case 1:
        if (at < text.size()) text[at] = static_cast<char>(text[at] ^ (1 << pick(random, 8)));
        break;
      case 2:
        text.erase(at, length);
        break;
      case 3:
        text.insert(at, text.substr(at, length));
        break;
      case 4:
        text.resize(at);
        break;
      case 5: {
        const std::string& other = one_of(random, corpus);
        text.insert(at, other.substr(pick(random, other.size() + 1), 1 + pick(random, 200)));
        break;
      }
      case 6: {  // the next number becomes another one
        const std::size_t digit = text.find_first_of("0123456789", at);
        if (digit == std::string::npos) break;
        const std::size_t end = text.find_first_not_of("0123456789.eE+-", digit);
        text.replace(digit, (end == std::string::npos ? text.size() : end) - digit,
                     one_of(random, numbers()));
        break;
      }
      case 7: {
        std::string piece = text.substr(at, length), many;
        const std::size_t times = 1 + pick(random, 2000);
        for (std::size_t k = 0; k < times; ++k) many += piece;
        text.insert(at, many);
        break;
      }
      default:
        text.insert(at, one_of(random, texts()));
    }
  }
  return text;
}

Json any_value(Random& random, const Json& document) {
  switch (pick(random, 8)) {
    case 0: {
      const Json number = Json::parse(one_of(random, numbers()), nullptr, false);
      return number.is_discarded() ? Json(nullptr) : number;
    }
    case 1: {
      const std::string& text = one_of(random, texts());
      return Json::parse(Json(text).dump(-1, ' ', false, Json::error_handler_t::replace));
    }
    case 2:
      return nullptr;
    case 3:
      return Json::array();
    case 4:
      return Json::object();
    case 5: {
      Json deep = 1;
      for (int i = 0; i < 200; ++i) deep = Json::array({deep});
      return deep;
    }
    case 6:
      return random.uniform(-200.0, 200.0);
    default: {  // something of its own from elsewhere
      const Json flat = document.flatten();
      if (!flat.is_object() || flat.empty()) return 1;
      auto it = flat.begin();
      std::advance(it, static_cast<std::ptrdiff_t>(pick(random, flat.size())));
      return *it;
    }
  }
}

/// A node of the document, the root apart.
Json* node_of(Json& document, Random& random) {
  Json* at = &document;
  for (;;) {
    if (at->empty() || !at->is_structured()) return at;
    auto it = at->begin();
    std::advance(it, static_cast<std::ptrdiff_t>(pick(random, at->size())));
    at = &*it;
    if (!at->is_structured() || random.uniform() < 0.25) return at;
  }
}

std::string changed_json(const std::string& text, Random& random) {
  Json document = Json::parse(text);
  const std::size_t changes = 1 + pick(random, 3);
  for (std::size_t i = 0; i < changes; ++i) {
    Json* node = node_of(document, random);
    switch (pick(random, 5)) {
      case 0:
        if (node->is_structured() && !node->empty()) {
          auto it = node->begin();
          std::advance(it, static_cast<std::ptrdiff_t>(pick(random, node->size())));
          node->erase(it);
        }
        break;
      case 1:
        if (node->is_array() && !node->empty()) {
          const Json item = (*node)[pick(random, node->size())];
          const std::size_t times = 1 + pick(random, random.uniform() < 0.8 ? 3 : 3000);
          for (std::size_t k = 0; k < times; ++k) node->push_back(item);
        } else if (node->is_object()) {
          (*node)[one_of(random, std::vector<std::string>{"", "format", "name", "unknown",
                                                          "a/b~c"})] = any_value(random, document);
        }
        break;
      case 2:
        if (node->is_number()) {
          const double x = node->get<double>();
          *node = one_of(
              random, std::vector<double>{-x, 10 * x, x / 10, x + 1, 1e6 * x, std::floor(x) + 0.5});
        }
        break;
      default:
        *node = any_value(random, document);
    }
  }
  std::string out = document.dump(1, ' ', false, Json::error_handler_t::replace);
  return random.uniform() < 0.05 ? changed_bytes(out, random, {text}) : out;
}

std::string whole_line(const std::string& body) {  // as the journal writes it
  boost::crc_32_type crc;
  crc.process_bytes(body.data(), body.size());
  crc.process_byte('}');
  char member[32];
  std::snprintf(member, sizeof member, ",\"crc\":\"%08x\"}\n", crc.checksum());
  return body + member;
}

/// Lines whose checksums are right again: what is behind them is to be reached.
std::string changed_journal(const std::string& text, Random& random) {
  if (random.uniform() < 0.2) return changed_bytes(text, random, {text});
  std::vector<std::string> lines;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size() - 1);
    lines.push_back(text.substr(at, end + 1 - at));
    at = end + 1;
  }
  const std::size_t changes = 1 + pick(random, 2);
  for (std::size_t i = 0; i < changes && !lines.empty(); ++i) {
    const std::size_t at = pick(random, lines.size());
    switch (pick(random, 6)) {
      case 0:
        lines.erase(lines.begin() + static_cast<std::ptrdiff_t>(at));
        break;
      case 1:
        lines.insert(lines.begin() + static_cast<std::ptrdiff_t>(at),
                     lines[pick(random, lines.size())]);
        break;
      default: {
        Json line = Json::parse(lines[at].substr(0, lines[at].size() - 19) + "}", nullptr, false);
        if (!line.is_object()) break;
        Json doc = Json::parse(changed_json(line["doc"].dump(), random), nullptr, false);
        if (doc.is_discarded()) break;
        line["doc"] = doc;
        lines[at] = line.dump();
        lines[at].pop_back();
        lines[at] = whole_line(lines[at]);
      }
    }
  }
  std::string out;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    Json line = Json::parse(lines[i], nullptr, false);
    if (line.is_object() && random.uniform() < 0.95) {
      line.erase("crc");
      line["seq"] = i + 1;
      std::string body = line.dump();
      body.pop_back();
      lines[i] = whole_line(body);
    }
    out += lines[i];
  }
  return out;
}

/// Chunks whose checksums are right again.
std::string changed_image(std::string bytes, Random& random,
                          const std::vector<std::string>& corpus) {
  bytes = changed_bytes(std::move(bytes), random, corpus);
  if (!bytes.starts_with("\x89PNG\r\n\x1a\n") || random.uniform() < 0.2) return bytes;
  for (std::size_t at = 8; at + 12 <= bytes.size();) {
    std::size_t length = 0;
    for (std::size_t i = 0; i < 4; ++i)
      length = length << 8 | static_cast<unsigned char>(bytes[at + i]);
    if (length > bytes.size() - at - 12) break;
    boost::crc_32_type crc;
    crc.process_bytes(bytes.data() + at + 4, 4 + length);
    for (unsigned i = 0; i < 4; ++i)
      bytes[at + 8 + length + i] = static_cast<char>(crc.checksum() >> (24 - 8 * i) & 0xff);
    at += 12 + length;
  }
  return bytes;
}

std::vector<std::string> shipped(std::initializer_list<const char*> files) {
  std::vector<std::string> texts;
  for (const char* file : files)
    texts.push_back(slurp(fs::path(TURNTABLE_SOURCE_DIR) / "scenarios" / file));
  return texts;
}

int setting(const char* name, int otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr ? std::atoi(text) : otherwise;
}

class HostileFiles : public ::testing::Test {
 protected:
  using Change = std::function<std::string(const std::string&, Random&)>;

  /// @param normal how many inputs a test has time for.
  void hold(int normal, const std::string& name, const std::vector<std::string>& corpus,
            const Change& change, const std::function<void(const fs::path&)>& read) {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    const fs::path file = folder_ / name;
    const int first = setting("HOSTILE_FIRST", 0), count = setting("HOSTILE_FILES", normal);
    std::signal(SIGPROF, out_of_patience);
    int refused = 0, read_well = 0;
    for (int i = first; i < first + count; ++i) {
      std::snprintf(now_reading, sizeof now_reading,
                    "HOSTILE_FIRST=%d HOSTILE_FILES=1 --gtest_filter=HostileFiles.%s\n", i,
                    info->name());
      Random random = draws_of_this_test(static_cast<std::uint64_t>(i));
      const std::string input = change(one_of(random, corpus), random);
      spill(file, input);
      const itimerval patience{{0, 0}, {kPatience_s, 0}}, none{};
      ::setitimer(ITIMER_PROF, &patience, nullptr);
      try {
        read(file);
        ++read_well;
      } catch (const Error& e) {
        ++refused;
        const std::string what = e.what();
        EXPECT_NE(what.find(folder_.path().string()), what.npos) << now_reading << what;
      } catch (const std::exception& e) {
        ADD_FAILURE() << now_reading << "another kind of error: " << e.what();
      }
      ::setitimer(ITIMER_PROF, &none, nullptr);
      if (HasFatalFailure() || ::testing::Test::HasFailure()) break;
    }
    std::printf("%d refused, %d read\n", refused, read_well);
    // Where nothing is ever read, the rules stand for the first line of the reader alone.
    if (count >= 80) {
      EXPECT_GT(read_well, count / 50);
    }
  }

  Change json() const {
    return [](const std::string& text, Random& random) {
      return random.uniform() < 0.7 ? changed_json(text, random)
                                    : changed_bytes(text, random, {text});
    };
  }
  Change bytes(const std::vector<std::string>& corpus) const {
    return [corpus](const std::string& text, Random& random) {
      return changed_bytes(text, random, corpus);
    };
  }

  TemporaryFolder folder_;
};

TEST_F(HostileFiles, RigFile) {
  hold(120, "rig.json",
       shipped({"rigs/simulated.json", "rigs/lab_example.json", "rigs/lab_modbus_gige.json",
                "rigs/leadshine.json", "rigs/two_zc300.json", "rigs/sc300_zc300.json"}),
       json(), [](const fs::path& file) { (void)load_rig_file(file); });
}

TEST_F(HostileFiles, Scenario) {
  const RigFile rig = load_rig_file(fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/rigs/ideal.json");
  hold(160, "scenario.json",
       shipped({"quick/triaxial_xyz.json", "quick/calibration.json", "uniaxial_x.json",
                "quick/biaxial_xz.json"}),
       json(), [&rig](const fs::path& file) {
         const Campaign campaign = load_campaign(file);
         if (campaign.scenarios.front().total_poses() > 2000) return;
         const Plan plan = plan_campaign(campaign, rig);
         const PlanReport report = check_plan(plan, rig);
         (void)plan_summary(plan, report);
         (void)order_times(campaign, rig);
         (void)parse_plan(plan_text(plan), file.string());
       });
}

TEST_F(HostileFiles, Campaign) {
  fs::create_directories(folder_ / "quick");
  for (const char* name : {"triaxial_xyz.json", "calibration.json"})
    spill(folder_ / "quick" / name,
          slurp(fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/quick" / name));
  const std::vector<std::string> corpus{
      R"({"format": "turntable-campaign/1", "name": "quick", "title": "Quick", "steps": [
          {"scenario": "quick/calibration.json"}, {"scenario": "quick/triaxial_xyz.json", "repeats": 2}]})"};
  hold(80, "campaign.json", corpus, json(),
       [](const fs::path& file) { (void)load_campaign(file); });
}

TEST_F(HostileFiles, Target) {
  hold(80, "target.json", shipped({"targets/corner_75mm.json", "targets/published.json"}), json(),
       [](const fs::path& file) { (void)load_target(file); });
}

TEST_F(HostileFiles, CalibrationResult) {
  hold(80, "calibration.json", shipped({"calibrations/paper_table1.json"}), json(),
       [](const fs::path& file) { (void)load_calibration(file); });
}

TEST_F(HostileFiles, DescriptionOfAController) {
  std::vector<std::string> corpus;
  for (const char* name : {"zaber_ascii", "ideal_aerosmith", "acutrol"})
    corpus.push_back(slurp(fs::path(TURNTABLE_SOURCE_DIR) / "drivers/described" /
                           (std::string(name) += ".json")));
  hold(120, "controller.json", corpus, json(),
       [](const fs::path& file) { (void)parse_description(read_text(file), file.string()); });
}

TEST_F(HostileFiles, Faults) {
  hold(80, "faults.json", shipped({"faults/example.json"}), json(),
       [](const fs::path& file) { (void)sim::load_fault_file(file); });
}

constexpr const char* kPoints =
    "x_mm,y_mm,z_mm,u_px,v_px,sigma_px\n0,0,0,100,100,0.1\n10,0,0,110,100,0.1\n0,10,0,100,110,0.1\n"
    "0,0,50,100,100,0.1\n10,0,50,112,100,0.1\n0,10,50,100,112,0.1\n";
constexpr const char* kSet =
    R"({"format": "turntable-calibration-set/1", "name": "lab", "polynomial_order": 1,
  "image_size_px": [200, 160], "points": {"file": "points.csv", "v_counts": "down"},
  "planes": [{"z_mm": 0, "use": "fit"}, {"z_mm": 50, "use": "fit"}]})";
constexpr const char* kImages =
    R"({"format": "turntable-calibration-set/1", "name": "lab",
  "pattern": {"columns": 5, "rows": 4, "origin": [2, 2], "spacing_mm": 10, "radius_mm": 2.5, "circles": "bright"},
  "planes": [{"z_mm": 0, "use": "fit", "images": ["image.png"]}, {"z_mm": 50, "use": "fit", "images": ["image.png"]}]})";

TEST_F(HostileFiles, CalibrationSet) {
  spill(folder_ / "points.csv", kPoints);
  spill(folder_ / "image.png", encode_png(Image({60, 40}, 7)));
  hold(80, "set.json", {kSet, kImages}, json(),
       [](const fs::path& file) { (void)load_calibration_set(file); });
}

TEST_F(HostileFiles, CalibrationPoints) {
  spill(folder_ / "set.json", kSet);
  hold(120, "points.csv", {kPoints}, bytes({kPoints}),
       [this](const fs::path&) { (void)load_calibration_set(folder_ / "set.json"); });
}

TEST_F(HostileFiles, PointTable) {
  const std::vector<std::string> corpus{
      "u_px,v_px,frame,point,sigma_px\n1.5,2.5,0,0,0.1\n3,4,0,1,0.1\n",
      "\xEF\xBB\xBFu_px,v_px\r\n1,2\r\n\r\n3,4\r\n"};
  hold(120, "points.csv", corpus, bytes(corpus), [](const fs::path& file) {
    (void)read_number_table(file, {"u_px", "v_px"}, {"frame", "point", "sigma_px"});
  });
}

TEST_F(HostileFiles, CameraOfOpenCv) {
  std::vector<std::string> corpus;
  for (const char* ending : {".yml", ".xml", ".json"}) {
    cv::FileStorage file(ending, cv::FileStorage::WRITE | cv::FileStorage::MEMORY);
    file << "image_width" << 640 << "image_height" << 480 << "camera_matrix"
         << cv::Mat(cv::Matx33d(800, 0, 320, 0, 800, 240, 0, 0, 1)) << "distortion_coefficients"
         << cv::Mat(cv::Matx<double, 5, 1>(-0.1, 0.01, 0, 0, 0)) << "avg_reprojection_error" << 0.1
         << "nr_of_frames" << 12;
    corpus.push_back(file.releaseAndGetString());
  }
  hold(160, "camera.yml", corpus, bytes(corpus), [](const fs::path& file) {
    (void)calibration_from_central(load_opencv_yaml(file), {-800, -600}, file.string());
  });
}

TEST_F(HostileFiles, Telemetry) {
  const std::vector<std::string> corpus{"T=21.5 C\n", "2026-01-31 12:00:00;+21,5;;45 %\r\n",
                                        "-1.5e1"};
  hold(200, "room.txt", corpus, bytes(corpus), [](const fs::path& file) {
    try {
      (void)first_number(slurp(file));
    } catch (const ProtocolError& e) {
      throw ProtocolError(file.string() + ": " + e.what());  // as the channel does that asks
    }
  });
}

/// A run of a few poses, as text.
struct RunTexts {
  std::string plan, journal;
  explicit RunTexts(const fs::path& at) {
    const fs::path scenarios = fs::path(TURNTABLE_SOURCE_DIR) / "scenarios";
    Campaign campaign = load_campaign(scenarios / "quick/uniaxial_z.json");
    campaign.scenarios.front().ranges.front().values_deg.resize(2);
    const Plan plan_of_it = plan_campaign(campaign, load_rig_file(scenarios / "rigs/ideal.json"));
    const RunFolder folder = RunFolder::create(at, plan_of_it);
    {
      RunJournal out(
          folder,
          {{"plan_name", "x"}, {"plan_sha256", plan_sha256(plan_of_it)}, {"archive", "regions"}});
      out.baseline({});
      for (const PlannedPose& pose : plan_of_it.poses) {
        TakenPose taken;
        taken.planned = pose;
        taken.images.resize(1);
        taken.images.front().spots = std::vector<TakenSpot>(2);
        out.pose(taken, campaign.scenarios.front().name);
      }
      out.interruption("pause", "asked for");
      out.time({{"wall_s", 1.0}});
      out.stop("success", "");
    }
    plan = slurp(folder.plan());
    journal = slurp(folder.journal());
  }
};

TEST_F(HostileFiles, JournalOfARun) {
  const RunTexts run(folder_ / "run");
  hold(
      120, "run/journal.jsonl", {run.journal},
      [](const std::string& text, Random& random) { return changed_journal(text, random); },
      [](const fs::path& file) { (void)read_run(RunFolder::open(file.parent_path())); });
}

TEST_F(HostileFiles, PlanOfARun) {
  const RunTexts run(folder_ / "run");
  hold(80, "run/plan.json", {run.plan}, json(),
       [](const fs::path& file) { (void)read_run(RunFolder::open(file.parent_path())); });
}

TEST_F(HostileFiles, Image) {
  std::vector<std::string> corpus;
  cv::Mat grey(24, 32, CV_8UC1), colour(24, 32, CV_8UC3), deep(24, 32, CV_16UC1);
  cv::theRNG().state = 1;
  cv::randu(grey, 0, 255);
  cv::randu(colour, 0, 255);
  cv::randu(deep, 0, 65535);
  for (const char* ending : {".png", ".bmp", ".tiff", ".pgm", ".ppm", ".jpg"})
    for (const cv::Mat& image : {grey, colour, deep}) {
      if (image.depth() == CV_16U && std::string(ending) == ".jpg") continue;
      std::vector<unsigned char> encoded;
      try {
        if (cv::imencode(ending, image, encoded))
          corpus.emplace_back(encoded.begin(), encoded.end());
      } catch (const cv::Exception&) {
      }
    }
  // What the libraries below OpenCV have to say belongs into the message.
  const fs::path said = folder_ / "said";
  const int stderr_before = ::dup(STDERR_FILENO);
  const int to_file = ::open(said.c_str(), O_WRONLY | O_CREAT, 0644);
  ASSERT_GE(to_file, 0);
  ::dup2(to_file, STDERR_FILENO);
  hold(
      240, "image.png", corpus,
      [&](const std::string& text, Random& random) { return changed_image(text, random, corpus); },
      [](const fs::path& file) {
        try {
          (void)load_image(file);
        } catch (const ConfigError&) {
        }
        (void)import_image(file);
      });
  ::dup2(stderr_before, STDERR_FILENO);
  ::close(stderr_before);
  ::close(to_file);
  EXPECT_EQ(slurp(said), "");
}

}  // namespace
}  // namespace turntable
