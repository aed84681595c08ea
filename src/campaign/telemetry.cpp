#include "src/campaign/telemetry.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "src/core/errors.h"

namespace turntable {

TelemetryWatch::TelemetryWatch(const Rig& rig, const TelemetryConfig& config)
    : rig_(rig), config_(config) {
  if (rig.channels.size() != config.channels.size())
    throw ConfigError("rig", "/telemetry/channels",
                      fmt::format("found {} channels in the file and {} on the rig.",
                                  config.channels.size(), rig.channels.size()));
}

std::optional<TelemetryReading> TelemetryWatch::read_if_due() {
  if (rig_.channels.empty()) return std::nullopt;
  if (last_ && seconds(rig_.clock->now()) - last_->rig_time_s < config_.every_s)
    return std::nullopt;
  return read();
}

TelemetryReading TelemetryWatch::read() {
  TelemetryReading reading;
  reading.rig_time_s = seconds(rig_.clock->now());
  for (const Channel& channel : rig_.channels) {
    auto& value = reading.values.emplace_back();
    try {
      value = channel.read();
      if (!std::isfinite(*value)) throw DeviceError("not a finite number");
    } catch (const Interrupted&) {
      throw;
    } catch (const Error& e) {
      value.reset();
      reading.trouble +=
          fmt::format("{}{}: {}", reading.trouble.empty() ? "" : "; ", channel.name, e.what());
    }
  }
  last_ = reading;
  return reading;
}

bool TelemetryWatch::out(std::size_t channel, bool coming_back) const {
  const auto& hold = config_.channels[channel].hold;
  if (!hold || !last_) return false;
  const auto& value = last_->values[channel];
  if (!value) return true;
  return coming_back ? *value < hold->resume_lower || *value > hold->resume_upper
                     : *value < hold->lower || *value > hold->upper;
}

std::string TelemetryWatch::complaint(bool coming_back) const {
  std::string text;
  for (std::size_t i = 0; i < config_.channels.size(); ++i) {
    if (!out(i, coming_back)) continue;
    const ChannelConfig& c = config_.channels[i];
    const auto& value = last_->values[i];
    text += fmt::format("{}{} {}, allowed: {} to {} {}", text.empty() ? "" : "; ", c.name,
                        value ? fmt::format("{:.6g} {}", *value, c.unit) : "cannot be read",
                        coming_back ? c.hold->resume_lower : c.hold->lower,
                        coming_back ? c.hold->resume_upper : c.hold->upper, c.unit);
  }
  return text;
}

double TelemetryWatch::for_s() const {
  double longest = 0.0;
  for (std::size_t i = 0; i < config_.channels.size(); ++i)
    if (out(i, true)) longest = std::max(longest, config_.channels[i].hold->for_s);
  return longest;
}

double TelemetryWatch::give_up_s() const {
  double shortest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < config_.channels.size(); ++i)
    if (out(i, true) && config_.channels[i].hold->give_up_s > 0.0)
      shortest = std::min(shortest, config_.channels[i].hold->give_up_s);
  return shortest;
}

}  // namespace turntable
