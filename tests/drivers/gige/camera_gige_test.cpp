// The driver on a peer that speaks GigE Vision, over loopback and in real time. Only one peer can
// be served on a computer: tests of other programs that serve one take the same ctest lock, and
// whoever comes second waits.
#include "drivers/camera_gige.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <iostream>
#include <optional>
#include <string>
#include <thread>

#include "drivers/catalog.h"
#include "drivers/sim/gige_peer.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"

namespace turntable {
namespace {

using sim::GigePeer;
using ::testing::AllOf;
using ::testing::HasSubstr;
using RealClock = std::chrono::steady_clock;

constexpr ImageSize kSize{320, 240};
constexpr uid_t kNobody = 65534;

std::uint8_t scene(int u, int v) { return static_cast<std::uint8_t>(3 * u + 7 * v); }

/// The scene, stamped with the number of the exposure in its first four pixels.
Image stamped(std::uint64_t exposure, ImageSize size = kSize) {
  Image image(size, 0);
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u) image.row(v)[u] = scene(u, v);
  for (int i = 0; i < 4; ++i)
    image.pixels[static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(exposure >> (8 * i));
  return image;
}

std::uint64_t stamp(const Image& image) {
  std::uint64_t exposure = 0;
  for (int i = 3; i >= 0; --i) exposure = exposure << 8 | image.pixels[static_cast<std::size_t>(i)];
  return exposure;
}

std::unique_ptr<GigePeer> serve(
    sim::GigePeerOptions options = {},
    const GigePeer::Expose& expose = [](std::uint64_t n) { return stamped(n); }) {
  for (int waited_s = 0;; ++waited_s) {
    try {
      return std::make_unique<GigePeer>(expose, kSize, options);
    } catch (const LineError&) {  // somebody else has the port
      if (waited_s >= 60) throw;
      std::this_thread::sleep_for(std::chrono::seconds{1});
    }
  }
}

class GigeDriver : public ::testing::Test {
 protected:
  CameraSetup setup() {
    CameraSetup setup;
    setup.config.model = "gige";
    setup.config.device = "127.0.0.1";
    setup.config.image_size = kSize;
    setup.config.frame_timeout_s = 5;
    setup.clock = &clock_;
    return setup;
  }

  CameraSetup line_setup(double timeout_s) {
    CameraSetup on_line = setup();
    on_line.config.trigger.source = TriggerConfig::Source::kLine;
    on_line.config.frame_timeout_s = timeout_s;
    return on_line;
  }

  template <class E>
  std::string refusal(CameraSetup setup) {
    try {
      GigeCamera camera(std::move(setup));
    } catch (const E& e) {
      return e.what();
    }
    ADD_FAILURE() << "not refused";
    return {};
  }

  SystemClock clock_;
};

/// Every id from the first frame to the last is somewhere.
void expect_all_accounted_for(const GigeStatistics& s, std::uint64_t first, std::uint64_t last) {
  EXPECT_EQ(last - first + 1, s.delivered + s.incomplete + s.missing + s.stale);
}

TEST_F(GigeDriver, AnswersEachOf600SoftwareTriggersWithItsOwnFrameOverTheWrapOfTheIds) {
  std::atomic<std::uint64_t> asked{0};  // every exposure is stamped with the trigger it is made for
  const auto peer = serve({}, [&](std::uint64_t) { return stamped(asked); });
  GigeCamera camera(setup());
  std::uint64_t first = 0, last = 0;
  Time before{-1};
  for (std::uint64_t k = 1; k <= 600; ++k) {
    asked = k;
    const Frame frame = camera.trigger();
    ASSERT_EQ(frame.image.pixels, stamped(k).pixels);
    ASSERT_GT(frame.timestamp, before);
    before = frame.timestamp;
    if (k == 1) first = frame.id;
    if (k > 1) {
      ASSERT_GT(frame.id, last);
    }
    last = frame.id;
  }
  const GigeStatistics s = camera.statistics();
  std::cout << fmt::format("ids {} to {}: {} delivered, {} incomplete, {} missing, {} stale\n",
                           first, last, s.delivered, s.incomplete, s.missing, s.stale);
  EXPECT_GT(last, 65535u);
  EXPECT_EQ(s.delivered, 600u);
  EXPECT_EQ(s.incomplete + s.missing + s.retriggered, 0u);
  expect_all_accounted_for(s, first, last);
}

TEST_F(GigeDriver, DeliversAllOf200FramesAlthoughPacketsAreLost) {
  std::atomic<std::uint64_t> asked{0};
  const auto peer =
      serve({.lost_packets_per_1000 = 20}, [&](std::uint64_t) { return stamped(asked); });
  CameraSetup lossy = setup();
  lossy.config.packet_bytes = 9000;  // 11 packets a frame: every fifth frame is hit
  lossy.config.retries = 20;
  GigeCamera camera(std::move(lossy));
  std::uint64_t first = 0, last = 0, incomplete_before_first = 0;
  for (std::uint64_t k = 1; k <= 200; ++k) {
    asked = k;
    const Frame frame = camera.trigger();
    ASSERT_EQ(frame.image.pixels, stamped(k).pixels);
    if (k == 1) {
      first = frame.id;
      incomplete_before_first = camera.statistics().incomplete;
    }
    last = frame.id;
  }
  GigeStatistics s = camera.statistics();
  std::cout << fmt::format("ids {} to {}: {} delivered, {} incomplete, {} missing, {} stale\n",
                           first, last, s.delivered, s.incomplete, s.missing, s.stale);
  EXPECT_EQ(s.delivered, 200u);
  EXPECT_GT(s.incomplete, 0u);
  EXPECT_EQ(s.retriggered, s.incomplete);
  s.incomplete -= incomplete_before_first;
  expect_all_accounted_for(s, first, last);
}

TEST_F(GigeDriver, GivesUpOnFramesThatNeverArriveWholeAndSaysHowManyWereLost) {
  // Of 53 packets a frame every second one: none comes whole, and none goes unseen. (Of nine packets
  // in ten, all those of a frame are lost once in 250 frames: then nothing came.)
  const auto peer = serve({.lost_packets_per_1000 = 500});
  CameraSetup hopeless = setup();
  hopeless.config.packet_bytes = 1500;
  hopeless.config.retries = 2;
  GigeCamera camera(std::move(hopeless));
  try {
    camera.trigger();
    FAIL() << "delivered";
  } catch (const TimeoutError& e) {
    EXPECT_THAT(e.what(), AllOf(HasSubstr("3 frames of this trigger came incomplete"),
                                HasSubstr("packets were lost"), HasSubstr("3 frames incomplete")));
  }
  EXPECT_EQ(camera.statistics().retriggered, 2u);
  EXPECT_EQ(camera.statistics().delivered, 0u);
}

TEST_F(GigeDriver, IsOpenedByTheCatalogAndNamesItself) {
  const auto peer = serve({.serial = "RIG07"});
  CameraSetup by_id = setup();
  by_id.config.device = peer->id();
  const std::unique_ptr<Camera> camera = open_camera(std::move(by_id));
  EXPECT_THAT(camera->identity(),
              AllOf(HasSubstr("Aravis Fake"), HasSubstr("serial RIG07"), HasSubstr("Mono8")));
  EXPECT_EQ(camera->image_size(), kSize);
  EXPECT_EQ(camera->trigger().image.size(), kSize);
}

TEST_F(GigeDriver, FindsThePeerAndOpensItIfItIsTheOnlyOne) {
  const auto peer = serve({.serial = "RIG08"});
  const std::vector<FoundCamera> found = find_gige_cameras();
  const auto at = std::ranges::find(found, peer->id(), &FoundCamera::id);
  ASSERT_NE(at, found.end());
  EXPECT_EQ(at->vendor, "Aravis");
  EXPECT_EQ(at->model, "Fake");
  EXPECT_EQ(at->serial, "RIG08");
  EXPECT_EQ(at->address, peer->address());
  EXPECT_EQ(at->protocol, "GigEVision");
  CameraSetup any = setup();
  any.config.device.clear();
  if (found.size() == 1) {
    EXPECT_EQ(GigeCamera(std::move(any)).trigger().image.size(), kSize);
  } else {  // real ones are connected to this computer
    EXPECT_THAT(refusal<DeviceError>(std::move(any)), HasSubstr("RIG08"));
  }
}

TEST_F(GigeDriver, SaysWhatIsThereIfTheNamedOneIsNot) {
  const auto peer = serve({.serial = "RIG09"});
  CameraSetup other = setup();
  other.config.device = "Basler-12345";
  EXPECT_THAT(refusal<DeviceError>(other),
              AllOf(HasSubstr("\"Basler-12345\" cannot be opened"), HasSubstr("Aravis-Fake-RIG09"),
                    HasSubstr("127.0.0.1")));
}

TEST_F(GigeDriver, SaysSoIfThereIsNoCamera) {
  if (!find_gige_cameras().empty()) GTEST_SKIP() << "a camera is connected to this computer";
  CameraSetup any = setup();
  any.config.device.clear();
  EXPECT_THAT(refusal<DeviceError>(any), HasSubstr("No camera was found. Check power"));
}

TEST_F(GigeDriver, RefusesAPixelFormatThatTheCameraDoesNotOffer) {
  const auto peer = serve();
  CameraSetup twelve = setup();
  twelve.config.pixel_format = "Mono12";
  EXPECT_THAT(refusal<DeviceError>(twelve),
              AllOf(HasSubstr("found pixel_format Mono12"), HasSubstr("Mono8, RGB8, Mono16")));
}

TEST_F(GigeDriver, RefusesARegionThatTheSensorDoesNotHave) {
  const auto peer = serve();
  CameraSetup large = setup();
  large.config.image_size = {640, 240};
  EXPECT_THAT(refusal<DeviceError>(large),
              AllOf(HasSubstr("region of width 640 px from 0 px"), HasSubstr("1 to 320 px")));
  CameraSetup shifted = setup();
  shifted.config.offset_px = {0, 1};
  EXPECT_THAT(refusal<DeviceError>(shifted),
              AllOf(HasSubstr("region of height 240 px from 1 px"), HasSubstr("1 to 240 px")));
}

TEST_F(GigeDriver, RefusesASettingThatReadsBackDifferently) {
  const auto peer = serve();
  CameraSetup fine = setup();
  fine.config.exposure_us = 10.5;  // the peer has whole microseconds
  EXPECT_THAT(refusal<DeviceError>(fine),
              AllOf(HasSubstr("ExposureTime reads 10"), HasSubstr("after it was set to 10.5")));
  CameraSetup gain = setup();
  gain.config.gain = 2.5;
  EXPECT_THAT(refusal<DeviceError>(gain),
              AllOf(HasSubstr("Gain reads 2"), HasSubstr("after it was set to 2.5")));
  CameraSetup brief = setup();
  brief.config.exposure_us = 1;
  EXPECT_THAT(refusal<DeviceError>(brief),
              AllOf(HasSubstr("found exposure_us 1,"), HasSubstr("allowed: 10 to")));
}

TEST_F(GigeDriver, RefusesATriggerThatTheCameraDoesNotHave) {
  const auto peer = serve();
  CameraSetup line = line_setup(1);
  line.config.trigger.line = "Line7";
  EXPECT_THAT(refusal<DeviceError>(line),
              AllOf(HasSubstr("found trigger source Line7"), HasSubstr("Line0, Software")));
  line.config.trigger.line = "Line0";
  line.config.trigger.rising = false;
  EXPECT_THAT(refusal<DeviceError>(line),
              AllOf(HasSubstr("TriggerActivation was refused"), HasSubstr("FallingEdge")));
}

TEST_F(GigeDriver, TakesTheRegionThatWasAskedForAndSetsExposureAndGain) {
  const auto peer = serve();
  CameraSetup part = setup();
  part.config.image_size = {100, 50};
  part.config.offset_px = {20, 30};
  part.config.exposure_us = 2000;
  part.config.gain = 3;
  GigeCamera camera(std::move(part));
  const Frame frame = camera.trigger();
  ASSERT_EQ(frame.image.size(), (ImageSize{100, 50}));
  EXPECT_EQ(frame.image.pixels.front(), scene(20, 30));
  EXPECT_EQ(frame.image.pixels.back(), scene(119, 79));
}

TEST_F(GigeDriver, TurnsMono16Into8BitsAndSaysSo) {
  const auto peer = serve();
  CameraSetup sixteen = setup();
  sixteen.config.pixel_format = "Mono16";
  sixteen.config.retries = 20;
  {
    GigeCamera camera(std::move(sixteen));
    EXPECT_THAT(camera.identity(),
                HasSubstr("Mono16 used as 8 bit: the upper eight of its 16 bits"));
    const Frame frame = camera.trigger();
    EXPECT_EQ(frame.image.pixels, stamped(stamp(frame.image)).pixels);
  }
  // The camera keeps its registers; the next one to open it sets its own.
  EXPECT_THAT(GigeCamera(setup()).identity(), HasSubstr("Mono8"));
}

TEST_F(GigeDriver, FiresTheLineAndTakesTheFrame) {
  const auto peer = serve();
  CameraSetup wired = line_setup(5);
  int fired = 0;
  wired.fire = [&] {
    ++fired;
    peer->hardware_trigger();
  };
  GigeCamera camera(std::move(wired));
  for (std::uint64_t k = 0; k < 50; ++k) ASSERT_EQ(stamp(camera.trigger().image), k);
  EXPECT_EQ(fired, 50);
  EXPECT_EQ(camera.statistics().delivered, 50u);
}

TEST_F(GigeDriver, WaitsForALineThatSomebodyElseFires) {
  const auto peer = serve();
  GigeCamera camera(line_setup(5));
  std::jthread somebody([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds{200});
    peer->hardware_trigger();
  });
  EXPECT_EQ(stamp(camera.trigger().image), 0u);
}

TEST_F(GigeDriver, TimesOutIfTheLineNeverComesAndNeverReturnsTheFrameThatComesLater) {
  const auto peer = serve();
  GigeCamera camera(line_setup(0.3));
  try {
    camera.trigger();
    FAIL() << "delivered";
  } catch (const TimeoutError& e) {
    EXPECT_THAT(e.what(), AllOf(HasSubstr("no frame within 0.3 s of the trigger"),
                                HasSubstr("wiring of Line0"), HasSubstr("rising edge")));
  }
  peer->hardware_trigger();  // exposure 0 answers nobody
  std::this_thread::sleep_for(std::chrono::milliseconds{300});
  EXPECT_THROW(camera.trigger(), TimeoutError);
  EXPECT_EQ(camera.statistics().stale, 1u);
  EXPECT_EQ(camera.statistics().delivered, 0u);
}

TEST_F(GigeDriver, NeverReturnsFramesFromBeforeTheTrigger) {
  const auto peer = serve();
  CameraSetup wired = line_setup(5);
  wired.fire = [&] { peer->hardware_trigger(); };
  GigeCamera camera(std::move(wired));
  const std::uint64_t first = camera.trigger().id;
  peer->hardware_trigger();  // 1 and 2, behind the driver's back
  peer->hardware_trigger();
  std::this_thread::sleep_for(std::chrono::milliseconds{300});
  const Frame frame = camera.trigger();
  EXPECT_EQ(stamp(frame.image), 3u);
  EXPECT_EQ(frame.id, first + 3);
  EXPECT_EQ(camera.statistics().stale, 2u);
  expect_all_accounted_for(camera.statistics(), first, frame.id);
}

TEST_F(GigeDriver, TellsAFrameThatComesLateFromItsOwnByTheCamerasClock) {
  std::atomic<bool> slow = false;
  const auto peer = serve({}, [&](std::uint64_t n) {
    if (slow.exchange(false)) std::this_thread::sleep_for(std::chrono::milliseconds{700});
    return stamped(n);
  });
  CameraSetup hasty = setup();
  hasty.config.frame_timeout_s = 0.4;
  GigeCamera camera(std::move(hasty));
  const Frame first = camera.trigger();
  slow = true;
  EXPECT_THROW(camera.trigger(), TimeoutError);
  const Frame frame = camera.trigger();  // while the frame before it is still on its way
  EXPECT_EQ(stamp(frame.image), stamp(first.image) + 2);
  EXPECT_EQ(frame.id, first.id + 2);
  EXPECT_EQ(camera.statistics().stale, 1u);
  expect_all_accounted_for(camera.statistics(), first.id, frame.id);
}

TEST_F(GigeDriver, TakesItsOwnFrameAfterATriggerThatWasNeverAnswered) {
  const auto peer = serve();
  CameraSetup wired = line_setup(0.5);
  bool connected = true;
  wired.fire = [&] {
    if (connected) peer->hardware_trigger();
  };
  GigeCamera camera(std::move(wired));
  camera.trigger();
  connected = false;
  EXPECT_THROW(camera.trigger(), TimeoutError);
  connected = true;
  EXPECT_EQ(stamp(camera.trigger().image), 1u);
  EXPECT_EQ(camera.statistics().stale, 0u);
}

TEST_F(GigeDriver, StopsWaitingWhenAStopIsUrgent) {
  const auto peer = serve();
  GigeCamera camera(line_setup(30));
  std::jthread operator_at_the_keyboard([] {
    std::this_thread::sleep_for(std::chrono::milliseconds{200});
    set_interrupt_level(2);
  });
  const auto began = RealClock::now();
  EXPECT_THROW(camera.trigger(), Interrupted);
  EXPECT_LT(RealClock::now() - began, std::chrono::seconds{5});
  set_interrupt_level(0);
}

TEST_F(GigeDriver, NoticesThatTheCameraItWaitsForIsGoneAndOpensAnother) {
  {
    const auto peer = serve();
    GigeCamera camera(line_setup(60));
    std::jthread plug([&] {
      std::this_thread::sleep_for(std::chrono::milliseconds{200});
      peer->kill();
    });
    const auto began = RealClock::now();
    try {
      camera.trigger();
      FAIL() << "delivered";
    } catch (const LineError& e) {
      EXPECT_THAT(e.what(), HasSubstr("control lost (unplugged, powered off"));
    }
    EXPECT_LT(RealClock::now() - began, std::chrono::seconds{15});  // the heartbeat takes 5
    EXPECT_THROW(camera.trigger(), LineError);
  }
  const auto peer = serve();
  EXPECT_EQ(GigeCamera(setup()).trigger().image.size(), kSize);
}

TEST_F(GigeDriver, NoticesThatTheCameraIsGoneInTheMiddleOfARun) {
  const auto peer = serve();
  GigeCamera camera(setup());
  camera.trigger();
  peer->kill();
  try {
    for (;;) camera.trigger();  // one frame may be on its way
  } catch (const LineError& e) {
    EXPECT_THAT(e.what(), HasSubstr("control lost"));
  }
}

TEST_F(GigeDriver, SaysSoIfAnotherProgramHasTheCamera) {
  const auto peer = serve();
  GigeCamera first(setup());
  EXPECT_THAT(refusal<DeviceError>(setup()), HasSubstr("controlled by another program"));
  EXPECT_EQ(first.trigger().image.size(), kSize);
}

TEST(GigePeer, IsServedOncePerComputer) {
  const auto peer = serve();
  EXPECT_THROW(GigePeer([](std::uint64_t n) { return stamped(n); }, kSize), LineError);
}

/// Root and everybody else receive frames on different paths inside Aravis.
TEST(GigeAsNobody, WorksToo) {
  if (geteuid() != 0) GTEST_SKIP() << "this is not root: all other tests ran as an ordinary user";
  const int program = open("/proc/self/exe", O_RDONLY | O_CLOEXEC);  // its folder may be private
  ASSERT_GE(program, 0);
  int output[2];
  ASSERT_EQ(pipe2(output, O_CLOEXEC), 0);
  char name[] = "test_gige";
  char filter[] =
      "--gtest_filter=GigeDriver.AnswersEach*:GigeDriver.DeliversAll*:GigeDriver.FiresTheLine*:"
      "GigeDriver.TurnsMono16*";
  char* arguments[] = {name, filter, nullptr};
  char fatal[] = "G_DEBUG=fatal-criticals";
  char* environment[] = {fatal, nullptr};
  const pid_t child = fork();
  if (child == 0) {
    dup2(output[1], STDOUT_FILENO);
    dup2(output[1], STDERR_FILENO);
    if (setgroups(0, nullptr) == 0 && setgid(kNobody) == 0 && setuid(kNobody) == 0 &&
        chdir("/") == 0)
      fexecve(program, arguments, environment);
    _exit(127);
  }
  close(output[1]);
  std::string said;
  char buffer[4096];
  for (ssize_t n; (n = read(output[0], buffer, sizeof buffer)) > 0;)
    said.append(buffer, static_cast<std::size_t>(n));
  close(output[0]);
  close(program);
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << said;
  EXPECT_THAT(said, AllOf(HasSubstr(fmt::format("as user {}", kNobody)), HasSubstr("PASSED  ] 4")));
}

/// Says who runs the tests: the test above looks for it.
class WhoIsIt : public ::testing::Environment {
  void SetUp() override { std::cout << "as user " << geteuid() << std::endl; }
};
[[maybe_unused]] const auto* const g_who_is_it = ::testing::AddGlobalTestEnvironment(new WhoIsIt);

}  // namespace
}  // namespace turntable
