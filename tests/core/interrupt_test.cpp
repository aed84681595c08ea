#include "src/core/interrupt.h"

#include <gtest/gtest.h>

#include <csignal>
#include <cstdlib>
#include <thread>

#include "src/core/errors.h"

namespace turntable {
namespace {

class Interrupt : public ::testing::Test {
 protected:
  void SetUp() override {
    for (const int signal : kSignals) ::sigaction(signal, nullptr, &saved_[signal]);
    set_interrupt_level(0);
  }
  void TearDown() override {
    for (const int signal : kSignals) ::sigaction(signal, &saved_[signal], nullptr);
    set_interrupt_level(0);
  }

 private:
  static constexpr int kSignals[] = {SIGINT, SIGTERM, SIGHUP, SIGPIPE};
  struct sigaction saved_[NSIG] = {};
};

TEST_F(Interrupt, nothing_throws_at_level_0) {
  EXPECT_NO_THROW(throw_if_interrupted());
  EXPECT_NO_THROW(throw_if_stopping_now());
}

TEST_F(Interrupt, the_first_ctrl_c_ends_between_poses_and_the_second_at_once) {
  install_interrupt_handlers();
  std::raise(SIGINT);
  EXPECT_EQ(interrupt_level(), 1);
  EXPECT_THROW(throw_if_interrupted(), Interrupted);
  EXPECT_NO_THROW(throw_if_stopping_now());
  std::raise(SIGINT);
  EXPECT_EQ(interrupt_level(), 2);
  EXPECT_THROW(throw_if_stopping_now(), Interrupted);
}

TEST_F(Interrupt, sigterm_and_sighup_stop_at_once) {
  install_interrupt_handlers();
  for (const int signal : {SIGTERM, SIGHUP}) {
    set_interrupt_level(0);
    std::raise(signal);
    EXPECT_EQ(interrupt_level(), 2);
  }
}

TEST_F(Interrupt, a_broken_pipe_is_not_deadly) {
  install_interrupt_handlers();
  std::raise(SIGPIPE);
  EXPECT_EQ(interrupt_level(), 0);
}

TEST_F(Interrupt, a_shield_lets_this_thread_talk_to_the_devices_on_the_way_out) {
  set_interrupt_level(2);
  {
    const InterruptShield outer;
    {
      const InterruptShield inner;
      EXPECT_NO_THROW(throw_if_stopping_now());
    }
    EXPECT_NO_THROW(throw_if_stopping_now());
    std::thread([] { EXPECT_THROW(throw_if_stopping_now(), Interrupted); }).join();
  }
  EXPECT_THROW(throw_if_stopping_now(), Interrupted);
}

TEST_F(Interrupt, while_poses_are_taken_the_first_ctrl_c_pauses_and_the_second_stops) {
  install_interrupt_handlers();
  {
    const PauseAtFirstInterrupt poses;
    std::raise(SIGINT);
    EXPECT_TRUE(pause_requested());
    EXPECT_EQ(interrupt_level(), 0);
    request_pause(false);  // it goes on
    std::raise(SIGINT);
    EXPECT_TRUE(pause_requested()) << "a first one again";
    EXPECT_EQ(interrupt_level(), 0);
    std::raise(SIGINT);
    EXPECT_EQ(interrupt_level(), 2);
  }
  EXPECT_FALSE(pause_requested());
}

TEST_F(Interrupt, a_ctrl_c_in_a_pause_that_another_program_asked_for_stops) {
  install_interrupt_handlers();
  const PauseAtFirstInterrupt poses;
  request_pause(true);
  std::raise(SIGINT);
  EXPECT_EQ(interrupt_level(), 2);
}

TEST_F(Interrupt, after_the_poses_the_first_ctrl_c_ends_again) {
  install_interrupt_handlers();
  { const PauseAtFirstInterrupt poses; }
  std::raise(SIGINT);
  EXPECT_FALSE(pause_requested());
  EXPECT_EQ(interrupt_level(), 1);
}

using InterruptDeathTest = Interrupt;

TEST_F(InterruptDeathTest, a_third_ctrl_c_ends_the_program) {
  EXPECT_EXIT(
      {
        install_interrupt_handlers();
        for (int i = 0; i < 3; ++i) std::raise(SIGINT);
      },
      ::testing::ExitedWithCode(137), "may still be moving");
}

TEST(Interrupts, TwoPressesOfCtrlCNeverKillWhateverTheyMean) {
  EXPECT_EXIT(
      {
        set_interrupt_level(0);
        install_interrupt_handlers();
        stop_at_first_interrupt();
        std::raise(SIGINT);
        if (interrupt_level() != 2) std::_Exit(1);
        std::raise(SIGINT);
        std::raise(SIGTERM);
        if (interrupt_level() != 2) std::_Exit(2);
        std::_Exit(42);
      },
      ::testing::ExitedWithCode(42), "");
  EXPECT_EXIT(
      {
        set_interrupt_level(0);
        install_interrupt_handlers();
        for (int i = 0; i < 3; ++i) std::raise(SIGINT);
        std::_Exit(42);
      },
      ::testing::ExitedWithCode(137), "may still be moving");
}

TEST(Interrupts, ACtrlCBeforeTheVerbSaidThatItStopsCountsAsWell) {
  EXPECT_EXIT(
      {
        set_interrupt_level(0);
        install_interrupt_handlers();
        std::raise(SIGINT);
        stop_at_first_interrupt();
        std::_Exit(interrupt_level() == 2 ? 42 : 1);
      },
      ::testing::ExitedWithCode(42), "");
}

}  // namespace
}  // namespace turntable
