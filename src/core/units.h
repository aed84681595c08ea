// Units as types where motor steps meet millimetres and degrees; suffixes (_mm, _deg, _rad, _px,
// _s) everywhere else. A mistaken unit is then a compile error exactly where it could move
// hardware.
#pragma once

#include <cmath>
#include <compare>
#include <cstdint>
#include <numbers>
#include <string_view>

namespace turntable {

/// A number with a unit. `Tag` names the unit and nothing else.
template <class Tag>
struct Quantity {
  double value = 0.0;

  friend constexpr auto operator<=>(Quantity, Quantity) = default;
  friend constexpr Quantity operator+(Quantity a, Quantity b) { return {a.value + b.value}; }
  friend constexpr Quantity operator-(Quantity a, Quantity b) { return {a.value - b.value}; }
  friend constexpr Quantity operator-(Quantity a) { return {-a.value}; }
  friend constexpr Quantity operator*(double k, Quantity a) { return {k * a.value}; }
  static constexpr std::string_view unit() { return Tag::kUnit; }
};

struct MillimetreTag {
  static constexpr std::string_view kUnit = "mm";
};
struct DegreeTag {
  static constexpr std::string_view kUnit = "deg";
};
using Millimetres = Quantity<MillimetreTag>;
using Degrees = Quantity<DegreeTag>;

template <class Tag>
Quantity<Tag> abs(Quantity<Tag> q) {
  return {std::abs(q.value)};
}

/// Whole pulses of a motor; what an open-loop controller really counts.
struct Steps {
  std::int64_t count = 0;
  friend constexpr auto operator<=>(Steps, Steps) = default;
};

/// The one place where pulses become engineering units and back.
template <class Q>
struct StepScale {
  Q per_step;  ///< > 0

  Q from_steps(Steps s) const { return {static_cast<double>(s.count) * per_step.value}; }
  /// Nearest pulse; halves away from zero.
  Steps to_steps(Q q) const { return {std::llround(q.value / per_step.value)}; }
  /// The value on the pulse grid nearest to `q`.
  Q on_grid(Q q) const { return from_steps(to_steps(q)); }
};

constexpr double kDegPerRad = 180.0 / std::numbers::pi;
constexpr double deg_from_rad(double rad) { return rad * kDegPerRad; }
constexpr double rad_from_deg(double deg) { return deg / kDegPerRad; }

}  // namespace turntable
