#include "drivers/sim/fault_file.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "src/core/json_document.h"

namespace turntable::sim {

std::vector<NamedFault> load_fault_file(const std::filesystem::path& file) {
  const Json json = parse_json(read_text(file), file.string(), "faults");
  std::vector<NamedFault> faults;
  for (const Json& f : json.at("faults")) {
    Fault fault;
    fault.kind =
        fault_from_name(f.at("fault").get<std::string>()).value();  // the schema lists them
    fault.verb = f.value("on", "");
    fault.nth = f.value("nth", 1);
    fault.times = f.value("times", 1);
    fault.delay_s = f.value("after_ms", 0.0) / 1000.0;
    fault.text = f.value("text", "");
    faults.push_back({f.at("controller"), fmt::format("/faults/{}/controller", faults.size()),
                      std::move(fault)});
  }
  return faults;
}

}  // namespace turntable::sim
