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

/// What an assumption weighs, in legs or images, and what earlier runs do.
constexpr double kAssumed = 4.0, kLearned = 100.0;
/// Of what was known before a run, at most so much weight is kept: rigs change.
constexpr std::size_t kMemory = 2000;

std::size_t place(AxisId axis) { return static_cast<std::size_t>(axis); }

std::filesystem::path overheads_file(const std::string& key) {
  std::filesystem::path folder;
  if (const char* state = std::getenv("XDG_STATE_HOME"); state != nullptr && *state != '\0')
    folder = state;
  else if (const char* home = std::getenv("HOME"); home != nullptr && *home != '\0')
    folder = std::filesystem::path(home) / ".local/state";
  else
    return {};
  return folder / "turntable" / (key + "-overheads.json");
}

}  // namespace

Pace::Pace(const Plan& plan, const RigFile& rig, const std::vector<std::size_t>& todo,
           const Overheads& known)
    : planned_(pose_times(plan, rig, todo)), known_(known) {
  if (known_.poses == 0) known_.image_s += rig.camera.answer_s();
  images_.reserve(todo.size());
  for (const std::size_t pose : todo) images_.push_back(plan.poses[pose].images);
  for (std::size_t i = 0; i < todo.size(); ++i) {
    kinematics_left_s_ += planned_[i].motion_s + planned_[i].settle_s;
    legs_[place(planned_[i].slowest)].left += planned_[i].legs;
    images_left_ += images_[i];
  }
}

void Pace::taken(double elapsed_s, double images_s) {
  const PhaseTimes& planned = planned_[poses_];
  Legs& legs = legs_[place(planned.slowest)];
  kinematics_left_s_ -= planned.motion_s + planned.settle_s;
  legs.left -= planned.legs;
  legs.taken += planned.legs;
  legs.over_s += elapsed_s - images_s - planned.motion_s - planned.settle_s;
  images_left_ -= images_[poses_];
  images_s_ += images_s;
  images_taken_ += images_[poses_];
  ++poses_;
}

Overheads Pace::learned() const {
  Overheads now;
  const double weight =
      known_.poses == 0 ? kAssumed : std::min(kLearned, static_cast<double>(known_.poses));
  for (std::size_t i = 0; i < legs_.size(); ++i) {
    const double prior = known_.leg_s[i] ? weight : 0.0;
    const double seen = prior + legs_[i].taken;
    if (seen > 0.0) now.leg_s[i] = (prior * known_.leg_s[i].value_or(0.0) + legs_[i].over_s) / seen;
  }
  now.image_s = (weight * known_.image_s + images_s_) / (weight + images_taken_);
  now.poses = std::min(known_.poses + poses_, kMemory);
  return now;
}

double Pace::left_s() const {
  const Overheads now = learned();
  double sum = 0.0, known = 0.0;
  for (const auto& leg : now.leg_s) {
    sum += leg.value_or(0.0);
    known += leg.has_value();
  }
  const double others = known > 0.0 ? sum / known : 0.0;
  double left = kinematics_left_s_ + now.image_s * images_left_;
  for (std::size_t i = 0; i < legs_.size(); ++i)
    left += now.leg_s[i].value_or(others) * legs_[i].left;
  return std::max(0.0, left);
}

std::string pace_key(const RigFile& rig, double speed) {
  std::string key = rig.name;
  if (speed != 1.0) key += fmt::format("-x{:g}", speed);
  for (const ControllerConfig& controller : rig.controllers) {
    const LineConfig& line = controller.line;
    const std::string_view kind = line.kind == LineConfig::Kind::kSerial      ? "serial"
                                  : line.kind == LineConfig::Kind::kTcp       ? "tcp"
                                  : line.kind == LineConfig::Kind::kModbusTcp ? "modbus_tcp"
                                                                              : "";
    if (kind.empty()) continue;
    key += fmt::format("-{}.{}", controller.name, kind);
    if (line.baud != 0) key += fmt::format(".{}", line.baud);
    // A pty is a served controller, or somebody's relay.
    std::error_code error;
    if (std::filesystem::canonical(line.serial_port, error).string().starts_with("/dev/pts/"))
      key += ".pty";
  }
  return key;
}

std::optional<Overheads> known_overheads(const std::string& key) {
  try {
    const std::filesystem::path file = overheads_file(key);
    if (file.empty() || !std::filesystem::exists(file)) return std::nullopt;
    const auto json = nlohmann::json::parse(read_text(file));
    const auto sane = [](double s) { return std::isfinite(s) && std::abs(s) < 3600.0; };
    Overheads known;
    known.image_s = json.at("image_s");
    known.poses = json.at("poses");
    if (!sane(known.image_s) || known.image_s < 0.0 || known.poses == 0) return std::nullopt;
    for (const AxisId id : kAllAxes)
      if (const auto leg = json.at("leg_s").find(axis_name(id)); leg != json.at("leg_s").end()) {
        known.leg_s[place(id)] = leg->get<double>();
        if (!sane(*known.leg_s[place(id)])) return std::nullopt;
      }
    return known;
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

void remember_overheads(const std::string& key, const Overheads& overheads) {
  try {
    const std::filesystem::path file = overheads_file(key);
    if (file.empty() || overheads.poses == 0) return;
    std::filesystem::create_directories(file.parent_path());
    remove_temporaries(file.parent_path());
    auto legs = nlohmann::json::object();
    for (const AxisId id : kAllAxes)
      if (const auto& leg = overheads.leg_s[place(id)]) legs[std::string(axis_name(id))] = *leg;
    const nlohmann::json json{
        {"key", key}, {"leg_s", legs}, {"image_s", overheads.image_s}, {"poses", overheads.poses}};
    write_atomically(file, json.dump(1) + "\n");
  } catch (const std::exception&) {
  }
}

}  // namespace turntable
