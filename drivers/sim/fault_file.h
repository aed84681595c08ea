// Faults as a file, for `turntable simulate --faults` (scenarios/README.md lists every field).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "drivers/sim/faults.h"

namespace turntable::sim {

struct NamedFault {
  std::string controller;
  std::string place;  ///< JSON pointer of the controller's name, for messages
  Fault fault;
};

/// @throws ConfigError.
std::vector<NamedFault> load_fault_file(const std::filesystem::path& file);

}  // namespace turntable::sim
