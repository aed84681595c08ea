#include "drivers/camera_folder.h"

#include <gtest/gtest.h>

#include <functional>

#include "src/core/errors.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

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

FolderCamera camera_in(const TemporaryFolder& folder, Clock& clock, bool replay) {
  CameraConfig config;
  config.model = "folder";
  config.folder = folder.path();
  config.replay = replay;
  config.image_size = {4, 1};
  config.frame_timeout_s = 1.0;
  return FolderCamera({config, &clock, load, {}});
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
  EXPECT_THROW(camera.trigger(), TimeoutError);
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
