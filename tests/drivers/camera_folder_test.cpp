#include "drivers/camera_folder.h"

#include <gmock/gmock.h>

#include <functional>
#include <map>
#include <thread>

#include "src/core/errors.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

/// Does something once, at its time on the manual clock: the camera's own software.
class Later final : public Actor {
 public:
  Later(Time due, std::function<void()> action) : due_(due), action_(std::move(action)) {}
  int descriptor() const override { return -1; }
  std::optional<Time> next_due() const override {
    return done_ ? std::nullopt : std::optional(due_);
  }
  void act(Time now) override {
    if (done_ || now < due_) return;
    done_ = true;
    action_();
  }

 private:
  Time due_;
  std::function<void()> action_;
  bool done_ = false;
};

/// An "image" whose grey value is the file's first byte; '!' is a file that is not (yet) an image.
Image load(const std::filesystem::path& file) {
  const std::string bytes = slurp(file);
  if (bytes.empty() || bytes[0] == '!') throw ConfigError(file.string(), "", "is cut off");
  return Image({static_cast<int>(bytes.size()), 1}, static_cast<std::uint8_t>(bytes[0]));
}

CameraConfig config_of(const TemporaryFolder& folder, bool replay) {
  CameraConfig config;
  config.model = "folder";
  config.folder = folder.path();
  config.replay = replay;
  config.image_size = {4, 1};
  config.frame_timeout_s = 1.0;
  return config;
}

FolderCamera camera_in(const TemporaryFolder& folder, Clock& clock, bool replay) {
  return FolderCamera({config_of(folder, replay), &clock, load, {}});
}

/// Writes a file whose image is `grey`, with the folders above it.
void put(const TemporaryFolder& folder, const std::string& name, char grey) {
  std::filesystem::create_directories((folder / name).parent_path());
  spill(folder / name, std::string(4, grey));
}

/// The first pixels of all images, in the order they come.
std::string replayed(const CameraConfig& config) {
  ManualClock clock;
  FolderCamera camera({config, &clock, load, {}});
  std::string out;
  try {
    for (;;) out += static_cast<char>(camera.trigger().image.pixels.front());
  } catch (const DeviceError&) {  // used up
  }
  return out;
}

template <class Work>
std::string refusal(Work&& work) {
  try {
    work();
    return "none";
  } catch (const ConfigError& e) {
    return e.what();
  }
}

TEST(FolderCamera, ReturnsOnlyAnImageThatAppearedAfterTheTrigger) {
  const TemporaryFolder folder;
  spill(folder / "a_stale.png", "AAAA");
  ManualClock clock;
  Later saved(from_seconds(0.3), [&] { spill(folder / "b.png", "BBBB"); });
  clock.attach(saved);
  FolderCamera camera = camera_in(folder, clock, false);
  EXPECT_EQ(camera.trigger().image.pixels.front(), 'B');
  EXPECT_THROW(camera.trigger(), TimeoutError);  // neither the stale one nor the same one twice
}

TEST(FolderCamera, WaitsUntilASlowFileIsAnImage) {
  const TemporaryFolder folder;
  ManualClock clock;
  Later begun(from_seconds(0.1), [&] { spill(folder / "c.png", "!..."); });
  Later ended(from_seconds(0.5), [&] { spill(folder / "c.png", "CCCC"); });
  clock.attach(begun);
  clock.attach(ended);
  EXPECT_EQ(camera_in(folder, clock, false).trigger().image.pixels.front(), 'C');
}

/// Software that exposes every 0.1 s, and has each image in the folder `lag_s` later. An image's grey
/// value tells when it was exposed: 'A' in the first 0.1 s.
class FreeRunningSoftware final : public Actor {
 public:
  FreeRunningSoftware(double lag_s, std::function<void(char grey, int n)> save)
      : lag_(from_seconds(lag_s)), save_(std::move(save)) {}
  int descriptor() const override { return -1; }
  std::optional<Time> next_due() const override { return n_ * kPeriod + lag_; }
  void act(Time now) override {
    for (; now >= n_ * kPeriod + lag_; ++n_) save_(static_cast<char>('A' + n_ % 64), n_);
  }
  static constexpr Time kPeriod = std::chrono::milliseconds{100};

 private:
  Time lag_;
  std::function<void(char, int)> save_;
  int n_ = 0;
};

TEST(FolderCamera, TakesNoImageThatWasExposedBeforeTheTrigger) {
  for (const double lag_s : {0.02, 0.3, 0.5}) {
    const TemporaryFolder folder;
    ManualClock clock;
    FreeRunningSoftware software(lag_s, [&](char grey, int n) {
      put(folder, "img" + std::to_string(1000 + n) + ".png", grey);
    });
    clock.attach(software);
    CameraConfig config = config_of(folder, false);
    config.latency_s = 0.5;
    config.latency_stated = true;
    FolderCamera camera({config, &clock, load, {}});
    for (int k = 0; k < 5; ++k) {
      clock.sleep_for(std::chrono::milliseconds{137});
      const Time asked = clock.now();
      const int exposed = camera.try_out().image.pixels.front() - 'A';
      EXPECT_GE(exposed * FreeRunningSoftware::kPeriod, asked) << lag_s;
    }
  }
}

TEST(FolderCamera, RefusesAFreeRunningSoftwareCameraWhoseLatencyNobodyStates) {
  const TemporaryFolder folder;
  ManualClock clock;
  FreeRunningSoftware software(
      0.3, [&](char grey, int n) { put(folder, "img" + std::to_string(1000 + n) + ".png", grey); });
  clock.attach(software);
  FolderCamera camera = camera_in(folder, clock, false);
  try {
    camera.try_out();
    FAIL() << "accepted";
  } catch (const ConfigError& e) {
    EXPECT_THAT(e.what(), AllOf(HasSubstr("without being asked"), HasSubstr("latency_ms")));
  }
}

TEST(FolderCamera, AcceptsOneThatSavesWhenItIsTold) {
  const TemporaryFolder folder;
  ManualClock clock;
  Later saved(from_seconds(0.3), [&] { put(folder, "b.png", 'B'); });
  clock.attach(saved);
  EXPECT_EQ(camera_in(folder, clock, false).try_out().image.pixels.front(), 'B');
}

TEST(FolderCamera, KnowsANewImageUnderAnOldName) {
  using Save = std::function<void(const TemporaryFolder&, char, int)>;
  const std::map<std::string, Save> ways{
      {"rewritten", [](const TemporaryFolder& f, char grey, int) { put(f, "latest.png", grey); }},
      {"replaced",
       [](const TemporaryFolder& f, char grey, int) {
         put(f, "new.tmp", grey);
         std::filesystem::rename(f / "new.tmp", f / "latest.png");
       }},
      {"ring written over", [](const TemporaryFolder& f, char grey,
                               int n) { put(f, "img" + std::to_string(n % 3) + ".png", grey); }},
      {"ring moved away", [](const TemporaryFolder& f, char grey, int n) {
         for (int i = 0; i < 3 && n % 3 == 0 && n > 0; ++i)
           std::filesystem::rename(f / ("img" + std::to_string(i) + ".png"),
                                   f / ("old" + std::to_string(n + i) + ".bak"));
         put(f, "img" + std::to_string(n % 3) + ".png", grey);
       }}};
  for (const auto& [way, save] : ways) {
    SCOPED_TRACE(way);
    const TemporaryFolder folder;
    ManualClock clock;
    FreeRunningSoftware software(0.02, [&, save = save](char grey, int n) {
      save(folder, grey, n);
      std::this_thread::sleep_for(std::chrono::milliseconds{6});  // file systems tell times apart
    });
    clock.attach(software);
    CameraConfig config = config_of(folder, false);
    config.latency_s = 0.05;
    config.latency_stated = true;
    FolderCamera camera({config, &clock, load, {}});
    int last = -1;
    for (int k = 0; k < 8; ++k) {
      const Time asked = clock.now();
      const int exposed = camera.trigger().image.pixels.front() - 'A';
      EXPECT_GE(exposed * FreeRunningSoftware::kPeriod, asked);
      EXPECT_GT(exposed, last);
      last = exposed;
    }
  }
}

TEST(FolderCamera, SaysThatAFileIsRewrittenAllTheTime) {
  const TemporaryFolder folder;
  ManualClock clock;
  int n = 0;
  struct Rewriting final : Actor {
    explicit Rewriting(std::function<void()> w) : write(std::move(w)) {}
    int descriptor() const override { return -1; }
    std::optional<Time> next_due() const override { return due; }
    void act(Time now) override {
      if (now < due) return;
      write();
      due = now + std::chrono::milliseconds{15};
    }
    std::function<void()> write;
    Time due{0};
  } rewriting(
      [&] { spill(folder / "c.png", std::string(static_cast<std::size_t>(4 + n++ % 2), 'C')); });
  clock.attach(rewriting);
  FolderCamera camera = camera_in(folder, clock, false);
  try {
    camera.trigger();
    FAIL() << "taken";
  } catch (const TimeoutError& e) {
    EXPECT_THAT(e.what(), HasSubstr("is being rewritten all the time"));
  }
}

TEST(FolderCamera, NamesAFileThatNeverBecomesOneOrHasAnotherSize) {
  const TemporaryFolder folder;
  ManualClock clock;
  spill(folder / "bad.png", "!...");
  FolderCamera camera = camera_in(folder, clock, true);
  try {
    camera.trigger();
    FAIL() << "accepted";
  } catch (const DeviceError& e) {
    EXPECT_NE(std::string(e.what()).find("bad.png"), std::string::npos);
  }
  spill(folder / "bad.png", "too long");
  EXPECT_THROW(camera.trigger(), DeviceError);
}

TEST(FolderCamera, ReplaysByNameAndCountsFrames) {
  const TemporaryFolder folder;
  ManualClock clock;
  spill(folder / "2.png", "2222");
  spill(folder / "1.png", "1111");
  spill(folder / "notes.txt", "text");
  FolderCamera camera = camera_in(folder, clock, true);
  const Frame first = camera.trigger(), second = camera.trigger();
  EXPECT_EQ(first.image.pixels.front(), '1');
  EXPECT_EQ(second.image.pixels.front(), '2');
  EXPECT_EQ(second.id, first.id + 1);
  EXPECT_THROW(camera.trigger(), DeviceError);
}

TEST(FolderCamera, SelectsFilesByPatternAndSubfolder) {
  const TemporaryFolder folder;
  put(folder, "run1/cam1.bmp", 'a');
  put(folder, "run1/cam22.bmp", 'b');
  put(folder, "run2/cam3.bmp", 'c');
  put(folder, "run2/cam4.png", 'd');
  put(folder, "run2/deep/cam5.bmp", 'e');
  put(folder, "cam6.bmp", 'f');
  put(folder, "cam[7].bmp", 'g');
  put(folder, ".cam8.bmp", 'h');  // hidden, as unfinished files often are
  CameraConfig config = config_of(folder, true);
  const auto found = [&](const char* files) {
    config.files = files;
    return replayed(config);
  };
  EXPECT_EQ(found("*/cam*.bmp"), "abc");
  EXPECT_EQ(found("run1/cam?.bmp"), "a");
  EXPECT_EQ(found("run2/*"), "cd");
  EXPECT_EQ(found("*.bmp"), "fg");  // * stays within a name
  EXPECT_EQ(found("cam[7].bmp"), "g");
  EXPECT_THAT(refusal([&] { found("*.tif"); }),
              AllOf(HasSubstr("/camera/files"), HasSubstr("\"*.tif\""), HasSubstr("replay")));
}

TEST(FolderCamera, OrdersByNameNumberOrTime) {
  const TemporaryFolder folder;
  put(folder, "img10.png", 'c');
  put(folder, "img2.png", 'b');
  put(folder, "img1.png", 'a');
  CameraConfig config = config_of(folder, true);
  EXPECT_EQ(replayed(config), "acb");
  config.order = FileOrder::kNatural;
  EXPECT_EQ(replayed(config), "abc");
  const auto now = std::filesystem::last_write_time(folder / "img1.png");
  std::filesystem::last_write_time(folder / "img1.png", now + std::chrono::seconds(5));
  std::filesystem::last_write_time(folder / "img2.png", now);
  std::filesystem::last_write_time(folder / "img10.png", now);  // equal times: by name
  config.order = FileOrder::kTime;
  EXPECT_EQ(replayed(config), "cba");
}

TEST(NaturalLess, ComparesRunsOfDigitsAsNumbers) {
  EXPECT_TRUE(natural_less("img2", "img10"));
  EXPECT_TRUE(natural_less("a9b10", "a10b1"));
  EXPECT_TRUE(natural_less("img", "img1"));
  EXPECT_TRUE(natural_less("cam2/99", "cam10/1"));
  EXPECT_TRUE(natural_less("18446744073709551616", "18446744073709551617"));
  EXPECT_FALSE(natural_less("img10", "img2"));
  EXPECT_FALSE(natural_less("img007", "img7"));
  EXPECT_FALSE(natural_less("img7", "img007"));
}

TEST(FolderCamera, NewImagesFollowThePatternToo) {
  const TemporaryFolder folder;
  ManualClock clock;
  Later wrong(from_seconds(0.1), [&] { put(folder, "a/preview.png", 'p'); });
  Later right(from_seconds(0.3), [&] { put(folder, "a/cam1.bmp", 'c'); });
  clock.attach(wrong);
  clock.attach(right);
  CameraConfig config = config_of(folder, false);
  config.files = "*/cam*.bmp";
  FolderCamera camera({config, &clock, load, {}});
  EXPECT_EQ(camera.trigger().image.pixels.front(), 'c');
  EXPECT_THROW(camera.trigger(), TimeoutError);
}

TEST(FolderCamera, RefusesAPlanThatNeedsMoreImagesThanAreLeft) {
  const TemporaryFolder folder;
  put(folder, "1.png", '1');
  put(folder, "2.png", '2');
  ManualClock clock;
  FolderCamera camera = camera_in(folder, clock, true);
  std::vector<Exposure> plan(2);
  camera.check(plan);
  camera.trigger();
  EXPECT_THAT(
      refusal([&] { camera.check(plan); }),
      AllOf(HasSubstr(folder.path().string()), HasSubstr("found 1 images"), HasSubstr("needs 2")));
}

class FolderCameraWithLayout : public ::testing::Test {
 protected:
  FolderCamera open(const std::string& layout) {
    CameraConfig config = config_of(folder, true);
    config.layout = layout;
    return FolderCamera({config, &clock, load, {}});
  }
  Exposure pose(int repeat, std::size_t point, double yaw_deg) {
    return {"scan",  repeat, point, 10 * static_cast<std::size_t>(repeat) + point, 1, 120.5,
            yaw_deg, 0,      0};
  }

  TemporaryFolder folder;
  ManualClock clock;
};

TEST_F(FolderCameraWithLayout, LooksUpTheFileOfEachPose) {
  put(folder, "scan/r2/p003_+010.5.png", 'a');
  put(folder, "scan/r2/p001_-000.1.png", 'b');
  put(folder, "120.5_0.3_0_0_21_1.png", 'c');
  FolderCamera camera = open("{scenario}/r{repeat}/p{point:03}_{yaw_deg:+06.1f}.png");
  camera.announce(pose(2, 3, 10.5));
  EXPECT_EQ(camera.trigger().image.pixels.front(), 'a');
  EXPECT_EQ(camera.trigger().image.pixels.front(), 'a');  // a trigger repeated
  camera.announce(pose(2, 1, -0.1));
  EXPECT_EQ(camera.trigger().image.pixels.front(), 'b');
  FolderCamera other = open("{stage_mm}_{yaw_deg}_{roll_deg}_{pitch_deg}_{index}_{image}.png");
  Exposure sum = pose(2, 1, 0.1 + 0.2);
  sum.pitch_deg = -0.0;
  other.announce(sum);
  EXPECT_EQ(other.trigger().image.pixels.front(), 'c');
}

TEST_F(FolderCameraWithLayout, IsRefusedWhenOpenedIfItIsNone) {
  for (const char* layout : {"{angle}.png", "{point", "{scenario:03d}.png", "{yaw_deg:+06.1q}"})
    EXPECT_THAT(refusal([&] { open(layout); }),
                AllOf(HasSubstr("/camera/layout"), HasSubstr(layout), HasSubstr("{pitch_deg}")))
        << layout;
}

TEST_F(FolderCameraWithLayout, FindsAllMissingFilesBeforeAnythingMoves) {
  put(folder, "r1_p0.png", 'a');
  const FolderCamera camera = open("r{repeat}_p{point}.png");
  camera.check(std::vector{pose(1, 0, 0)});
  EXPECT_THAT(refusal([&] {
                camera.check(std::vector{pose(1, 0, 0), pose(1, 1, 5), pose(1, 2, 7)});
              }),
              AllOf(HasSubstr("2 of the plan's 3 images"), HasSubstr("r1_p1.png"),
                    HasSubstr("pose 11"), HasSubstr("yaw 5 deg")));
}

TEST_F(FolderCameraWithLayout, IsRefusedIfItDoesNotTellPosesApart) {
  put(folder, "+5.png", 'a');
  put(folder, "+0.png", 'b');
  const FolderCamera camera = open("{yaw_deg:+.0f}.png");
  camera.check(std::vector{pose(1, 0, 0), pose(1, 1, 5), pose(1, 2, 0)});  // at zero again
  for (const Exposure& other : {pose(2, 0, 0), pose(1, 3, 0.2)})
    EXPECT_THAT(refusal([&] {
                  camera.check(std::vector{pose(1, 0, 0), other});
                }),
                AllOf(HasSubstr("+0.png"), HasSubstr("Add what tells them apart")));
}

TEST_F(FolderCameraWithLayout, NamesFileAndPoseIfAnImageVanishedOrIsDamaged) {
  FolderCamera camera = open("p{point}.png");
  EXPECT_THROW(camera.trigger(), DeviceError);  // nothing was announced
  for (const char* content : {"", "!..."}) {
    if (*content != 0) spill(folder / "p4.png", content);
    camera.announce(pose(1, 4, 8));
    try {
      camera.trigger();
      FAIL() << "accepted";
    } catch (const DeviceError& e) {
      EXPECT_THAT(e.what(), AllOf(HasSubstr("p4.png"), HasSubstr("point 4"), HasSubstr("yaw 8")));
    }
  }
}

TEST(FolderCamera, RefusesAFolderThatIsNotThere) {
  const TemporaryFolder folder;
  ManualClock clock;
  CameraConfig config;
  config.folder = folder / "missing";
  EXPECT_THROW(open_folder_camera({config, &clock, load, {}}), ConfigError);
}

}  // namespace
}  // namespace turntable
