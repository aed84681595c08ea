// Where the points of a target are (scenarios/targets/README.md), for verbs that need no rig.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <string>
#include <vector>

namespace turntable {

struct TargetFile {
  std::string file;  ///< as named in messages
  std::string title;
  std::vector<Eigen::Vector3d> points_mm;  ///< the first one is M0; they may lie in a plane
  double uncertainty_mm = 0.0;  ///< standard uncertainty of each coordinate; 0 = not stated
};

/// A target file, or the target of a rig file. @throws ConfigError: neither of the two, schema, two
/// points in one place. Whether they span enough is for `TargetModel::refusal` to say.
TargetFile load_target(const std::filesystem::path& file);

}  // namespace turntable
