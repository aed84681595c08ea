#include "src/campaign/pace.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/record/atomic_file.h"

namespace turntable {
namespace {

constexpr double kPrior = 4.0;
/// Of what was known before a run, at most so much weight is kept: rigs change.
constexpr std::size_t kMemory = 2000;

std::filesystem::path overheads_file(const std::string& rig_name) {
  std::filesystem::path folder;
  if (const char* state = std::getenv("XDG_STATE_HOME"); state != nullptr && *state != '\0')
    folder = state;
  else if (const char* home = std::getenv("HOME"); home != nullptr && *home != '\0')
    folder = std::filesystem::path(home) / ".local/state";
  else
    return {};
  return folder / "turntable" / (rig_name + "-overheads.json");
}

}  // namespace

Pace::Pace(const Plan& plan, const RigFile& rig, const std::vector<std::size_t>& todo,
           const Overheads& known)
    : planned_(pose_times(plan, rig)), known_(known) {
  images_.reserve(plan.poses.size());
  for (const PlannedPose& pose : plan.poses) images_.push_back(pose.images);
  for (const std::size_t pose : todo) {
    kinematics_left_s_ += planned_[pose].motion_s + planned_[pose].settle_s;
    legs_left_ += planned_[pose].legs;
    images_left_ += images_[pose];
  }
}

void Pace::taken(std::size_t pose, double elapsed_s, double images_s) {
  const PhaseTimes& planned = planned_[pose];
  kinematics_left_s_ -= planned.motion_s + planned.settle_s;
  legs_left_ -= planned.legs;
  images_left_ -= images_[pose];
  over_s_ += elapsed_s - images_s - planned.motion_s - planned.settle_s;
  legs_ += planned.legs;
  images_s_ += images_s;
  images_taken_ += images_[pose];
  ++poses_;
}

Overheads Pace::learned() const {
  return {(kPrior * known_.leg_s + over_s_) / (kPrior + legs_),
          (kPrior * known_.image_s + images_s_) / (kPrior + images_taken_),
          std::min(known_.poses + poses_, kMemory)};
}

double Pace::left_s() const {
  const Overheads now = learned();
  return std::max(0.0, kinematics_left_s_ + now.leg_s * legs_left_ + now.image_s * images_left_);
}

std::optional<Overheads> known_overheads(const std::string& rig_name) {
  try {
    const std::filesystem::path file = overheads_file(rig_name);
    if (file.empty() || !std::filesystem::exists(file)) return std::nullopt;
    const auto json = nlohmann::json::parse(read_text(file));
    const Overheads known{json.at("leg_s"), json.at("image_s"), json.at("poses")};
    if (!std::isfinite(known.leg_s) || !(known.image_s >= 0.0) || known.image_s > 3600.0 ||
        std::abs(known.leg_s) > 3600.0 || known.poses == 0)
      return std::nullopt;
    return known;
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

void remember_overheads(const std::string& rig_name, const Overheads& overheads) {
  try {
    const std::filesystem::path file = overheads_file(rig_name);
    if (file.empty() || overheads.poses == 0) return;
    std::filesystem::create_directories(file.parent_path());
    const nlohmann::json json{{"rig", rig_name},
                              {"leg_s", overheads.leg_s},
                              {"image_s", overheads.image_s},
                              {"poses", overheads.poses}};
    write_atomically(file, json.dump(1) + "\n");
  } catch (const std::exception&) {
  }
}

}  // namespace turntable
