// What an error says.
#pragma once

#include <gtest/gtest.h>

#include <exception>
#include <string>

namespace turntable {

/// The message of the E that `action` throws; a failure of the test if it throws another, or nothing.
template <class E, class F>
std::string message_of(F&& action) {
  try {
    action();
  } catch (const E& error) {
    return error.what();
  } catch (const std::exception& error) {
    ADD_FAILURE() << "another kind of error: " << error.what();
    return {};
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

}  // namespace turntable
