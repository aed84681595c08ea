// How long what is left will take: the plan's kinematics, and what this rig adds to them, learned
// from earlier runs and from the poses taken so far.
//   T = sum(motion + settling) + sum over axes(leg_s * legs) + image_s * images
// A leg is one command of a move: two where an axis overshoots. A pose's legs are those of its
// slowest axis, and so is what it took too long. Each overhead is a mean that starts from what is
// assumed, or from what earlier runs have taught; an axis that nobody has seen yet is taken for the mean
// of the others.
#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "src/campaign/planning.h"

namespace turntable {

struct Overheads {
  /// By order of kAllAxes: command, polling, the last read-back; nothing for an axis not seen yet. s
  std::array<std::optional<double>, kAllAxes.size()> leg_s;
  double image_s = kFrameSeconds;  ///< trigger, exposure, transfer, inspection
  std::size_t poses = 0;           ///< that they were learned from; 0 = assumed
};

class Pace {
 public:
  /// @param todo places in the plan of what will be taken, in this order, from zero angles on.
  Pace(const Plan& plan, const RigFile& rig, const std::vector<std::size_t>& todo,
       const Overheads& known);

  /// The next pose was taken, in `elapsed_s` of the rig's time from the one before, of which `images_s`
  /// for its images. Waits of which nobody can know (people, holds) left out.
  void taken(double elapsed_s, double images_s);
  /// Rig time for the poses that are left, s.
  double left_s() const;
  Overheads learned() const;

 private:
  std::vector<PhaseTimes> planned_;  ///< of `todo`, as is
  std::vector<int> images_;
  Overheads known_;
  double kinematics_left_s_ = 0.0, images_left_ = 0.0;
  double images_s_ = 0.0, images_taken_ = 0.0;
  struct Legs {
    double left = 0.0, taken = 0.0;
    double over_s = 0.0;  ///< of those taken
  };
  std::array<Legs, kAllAxes.size()> legs_;
  std::size_t poses_ = 0;  ///< taken
};

/// What overheads are learned for: the rig by its name, the pace of its clock, and how its controllers
/// are reached. A rehearsal on served devices at ten times the speed says nothing about the night.
/// "ideal", or "ideal-x10-mc1.tcp" for what is not a simulation inside the program at its own pace.
std::string pace_key(const RigFile& rig, double speed);
/// What earlier runs under this key have taught; nothing if there were none, or the file cannot be read.
/// Kept in $XDG_STATE_HOME/turntable (default ~/.local/state/turntable).
std::optional<Overheads> known_overheads(const std::string& key);
/// Silent where it cannot: an estimate is a courtesy.
void remember_overheads(const std::string& key, const Overheads& overheads);

}  // namespace turntable
