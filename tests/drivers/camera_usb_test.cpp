#include "drivers/camera_usb.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <numeric>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include "drivers/catalog.h"
#include "src/core/errors.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr ImageSize kSize{64, 48};

/// Frame k is grey 20 * k + 10 all over: its number survives any compression.
cv::Scalar stamp(int k) { return cv::Scalar::all(20 * k + 10); }
int number_on(const Frame& frame) {
  const auto& pixels = frame.image.pixels;
  const int sum = std::accumulate(pixels.begin(), pixels.end(), 0);
  return sum / static_cast<int>(pixels.size()) / 20;
}

CameraConfig usb(const std::filesystem::path& device) {
  CameraConfig config;
  config.model = "usb";
  config.device = device.string();
  config.image_size = kSize;
  return config;
}

std::string refusal_by_usb(const CameraConfig& config) {
  ManualClock clock;
  try {
    open_usb_camera({config, &clock, {}, {}});
    return "none";
  } catch (const Error& e) {
    return e.what();
  }
}

class UsbCameraOnFiles : public ::testing::Test {
 protected:
  std::unique_ptr<Camera> open(const CameraConfig& config) {
    return open_camera({config, &clock, {}, {}});  // by its row of the table
  }
  std::filesystem::path write_video(int frames) {
    const std::filesystem::path file = folder / "stamped.avi";
    cv::VideoWriter video(file.string(), cv::CAP_OPENCV_MJPEG,
                          cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 25.0,
                          {kSize.width, kSize.height});
    EXPECT_TRUE(video.isOpened());
    for (int k = 0; k < frames; ++k)
      video.write(cv::Mat(kSize.height, kSize.width, CV_8UC3, stamp(k)));
    return file;
  }
  std::filesystem::path write_sequence(int frames, int type = CV_8UC1, double scale = 1) {
    for (int k = 0; k < frames; ++k)
      cv::imwrite((folder / fmt::format("shot_{:03}.png", k)).string(),
                  cv::Mat(kSize.height, kSize.width, type, stamp(k) * scale));
    return folder / "shot_%03d.png";
  }

  TemporaryFolder folder;
  ManualClock clock;
};

TEST_F(UsbCameraOnFiles, ReturnsTheFramesOfAVideoOneByOne) {
  const auto camera = open(usb(write_video(4)));
  EXPECT_EQ(camera->image_size(), kSize);
  for (int k = 0; k < 4; ++k) {
    clock.sleep_for(from_seconds(1));
    const Frame frame = camera->trigger();
    EXPECT_EQ(number_on(frame), k);
    EXPECT_EQ(frame.id, static_cast<std::uint64_t>(k));
    EXPECT_EQ(seconds(frame.timestamp), k + 1.0);
    EXPECT_EQ(frame.image.size(), kSize);
  }
}

TEST_F(UsbCameraOnFiles, ThrowsStaleFramesAwayIfTheRigFileSaysSoAndCountsThem) {
  CameraConfig config = usb(write_video(9));
  config.stale_frames = 2;
  const auto camera = open(config);
  for (const int k : {2, 5, 8}) {
    const Frame frame = camera->trigger();
    EXPECT_EQ(number_on(frame), k);
    EXPECT_EQ(frame.id, static_cast<std::uint64_t>(k));
  }
}

TEST_F(UsbCameraOnFiles, SaysWhenTheFileEnds) {
  const auto camera = open(usb(write_video(2)));
  camera->trigger();
  camera->trigger();
  for (int again = 0; again < 2; ++again) try {
      camera->trigger();
      FAIL() << "a frame out of nothing";
    } catch (const DeviceError& e) {
      EXPECT_THAT(e.what(), AllOf(HasSubstr("stamped.avi"), HasSubstr("ends after 2 frames")));
    }
}

TEST_F(UsbCameraOnFiles, ReadsAnImageSequence) {
  const auto camera = open(usb(write_sequence(3)));
  for (int k = 0; k < 3; ++k) EXPECT_EQ(camera->trigger().image.pixels.front(), 20 * k + 10);
  EXPECT_THROW(camera->trigger(), DeviceError);
}

TEST_F(UsbCameraOnFiles, KeepsTheUpperEightOfSixteenBits) {
  const auto camera = open(usb(write_sequence(3, CV_16UC1, 256)));
  for (int k = 0; k < 3; ++k) EXPECT_EQ(camera->trigger().image.pixels.front(), 20 * k + 10);
}

TEST_F(UsbCameraOnFiles, TurnsColourIntoLuma) {
  cv::imwrite((folder / "shot_000.png").string(),
              cv::Mat(kSize.height, kSize.width, CV_8UC3, cv::Scalar(10, 100, 200)));  // b, g, r
  const auto camera = open(usb(folder / "shot_%03d.png"));
  EXPECT_EQ(camera->trigger().image.pixels.front(), 120);  // 1.14 + 58.7 + 59.8 = 119.64
  EXPECT_THAT(camera->identity(), AllOf(HasSubstr("shot_%03d.png"), HasSubstr("luma")));
}

TEST_F(UsbCameraOnFiles, RefusesAnotherSizeWhenItIsOpened) {
  CameraConfig config = usb(write_video(1));
  config.image_size = {64, 64};
  EXPECT_THAT(refusal_by_usb(config), AllOf(HasSubstr("height 48"), HasSubstr("wanted: 64")));
}

TEST_F(UsbCameraOnFiles, RefusesWhatIsNotThereOrNoVideo) {
  EXPECT_THAT(refusal_by_usb(usb(folder / "missing.avi")),
              AllOf(HasSubstr("/camera/device"), HasSubstr("missing.avi"), HasSubstr("Allowed")));
  EXPECT_THAT(refusal_by_usb(usb(folder / "missing_%02d.png")), HasSubstr("cannot be opened"));
  spill(folder / "text.avi", "not a video");
  EXPECT_THAT(refusal_by_usb(usb(folder / "text.avi")), HasSubstr("cannot be opened"));
}

TEST_F(UsbCameraOnFiles, RefusesToExposeWhatWasTakenEarlier) {
  CameraConfig config = usb(write_video(1));
  config.gain = 3;
  EXPECT_THAT(refusal_by_usb(config), AllOf(HasSubstr("/camera/gain"), HasSubstr("taken earlier")));
}

TEST(UsbCamera, SaysWhichDevicesThereAreIfTheOneAskedForIsNot) {
  for (const char* device : {"/dev/video963", "963"})
    EXPECT_THAT(refusal_by_usb(usb(device)),
                AllOf(HasSubstr("/dev/video963"), HasSubstr("Devices that capture")));
  EXPECT_THAT(find_usb_cameras(), Each(AllOf(StartsWith("/dev/video"), HasSubstr(": "))));
}

/// A camera that exposes without being asked: frame k is ready at (k + 1) intervals, and began to
/// be exposed two intervals earlier. A driver keeps the first `depth` frames that nobody fetched.
class FreeRunning {
 public:
  FreeRunning(ManualClock& clock, Time interval, std::size_t depth)
      : clock_(clock), interval_(interval), depth_(depth) {}

  bool grab() {
    fill();
    if (buffer_.empty()) {
      clock_.sleep_until(ready_at(next_));
      fill();
    }
    last_ = buffer_.front();
    buffer_.erase(buffer_.begin());
    ++grabs;
    return true;
  }
  Time last_began() const { return ready_at(last_) - 2 * interval_; }

  int grabs = 0;

 private:
  Time ready_at(int k) const { return (k + 1) * interval_; }
  void fill() {
    for (; ready_at(next_) <= clock_.now(); ++next_)
      if (buffer_.size() < depth_) buffer_.push_back(next_);
  }

  ManualClock& clock_;
  Time interval_;
  std::size_t depth_;
  std::vector<int> buffer_;
  int next_ = 0;
  int last_ = 0;
};

TEST(GrabAfterNow, NeverReturnsAFrameThatBeganBeforeTheTriggerWhateverTheBuffer) {
  constexpr Time kInterval = std::chrono::milliseconds(40);
  for (const std::size_t depth : {1u, 4u, 10u, 31u})
    for (const int stale : {0, 1, 4})
      for (const double pause_s : {0.0, 0.007, 0.039, 0.04, 0.11, 3.0}) {
        ManualClock clock;
        FreeRunning camera(clock, kInterval, depth);
        for (int exposure = 0; exposure < 5; ++exposure) {
          clock.sleep_for(from_seconds(pause_s));
          const Time trigger = clock.now();
          ASSERT_TRUE(grab_after_now([&] { return camera.grab(); }, clock, stale, kInterval));
          ASSERT_GE(camera.last_began(), trigger) << depth << " " << stale << " " << pause_s;
          ASSERT_LE(clock.now() - trigger, (stale + 4) * kInterval);
        }
      }
}

TEST(GrabAfterNow, EndsAlsoIfFramesComeFasterThanTheCameraSays) {
  ManualClock clock;
  FreeRunning camera(clock, std::chrono::milliseconds(5), 4);
  EXPECT_TRUE(
      grab_after_now([&] { return camera.grab(); }, clock, 4, std::chrono::milliseconds(100)));
  EXPECT_LT(camera.grabs, 50);
}

TEST(GrabAfterNow, TakesWhatAFileHasAndSaysIfItHasNothing) {
  ManualClock clock;
  int frames = 0;
  const auto grab = [&] { return ++frames <= 3; };
  EXPECT_TRUE(grab_after_now(grab, clock, 0, Time{0}));
  EXPECT_EQ(frames, 1);
  EXPECT_TRUE(grab_after_now(grab, clock, 1, Time{0}));
  EXPECT_EQ(frames, 3);
  EXPECT_FALSE(grab_after_now(grab, clock, 0, Time{0}));
}

}  // namespace
}  // namespace turntable
