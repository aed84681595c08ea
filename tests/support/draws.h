// Random draws of a test, seeded from the test's own name: the same every time, different in every
// test.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <string>

#include "src/core/random.h"

namespace turntable {

inline Random draws_of_this_test(std::uint64_t index = 0) {
  const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
  return Random(1, std::string(info->test_suite_name()) + "." + info->name(), index);
}

}  // namespace turntable
