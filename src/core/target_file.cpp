#include "src/core/target_file.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/rig_file.h"

namespace turntable {

TargetFile load_target(const std::filesystem::path& file) {
  TargetFile target;
  target.file = file.string();
  const std::string format = format_of(file);
  if (format == "rig") {
    const RigFile rig = load_rig_file(file);
    target.title = rig.title;
    target.points_mm = rig.target.points_mm;
    return target;
  }
  if (format != "target")
    throw ConfigError(target.file, "/format",
                      fmt::format("found a {} file, allowed: \"turntable-target/1\" or a rig file. "
                                  "Name a file that says where the target's points are.",
                                  format));
  const Json json = load_json(file, "target");
  target.title = json.value("title", file.stem().string());
  for (const Json& p : json.at("points_mm"))
    target.points_mm.emplace_back(p.at(0).get<double>(), p.at(1).get<double>(),
                                  p.at(2).get<double>());
  target.uncertainty_mm = json.value("uncertainty_mm", 0.0);
  for (std::size_t i = 0; i < target.points_mm.size(); ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (target.points_mm[i] == target.points_mm[j])
        throw ConfigError(
            target.file, fmt::format("/points_mm/{}", i),
            fmt::format("stands where point {} does, allowed: points apart. Correct one.", j));
  return target;
}

}  // namespace turntable
