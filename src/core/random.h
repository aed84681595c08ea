// Reproducible randomness. Every draw is addressed by (seed, stream, index), so that it does not
// depend on what was drawn before it, on threads, or on the order in which devices were built.
#pragma once

#include <cstdint>
#include <limits>
#include <string_view>

namespace turntable {

/// A small generator (SplitMix64, Steele et al. 2014) that satisfies UniformRandomBitGenerator; its
/// draws are the same on every platform, which the standard library's distributions do not promise.
class Random {
 public:
  using result_type = std::uint64_t;

  /// @param stream what is drawn ("yaw repeatability"); @param index which one (move or frame
  /// number).
  Random(std::uint64_t seed, std::string_view stream, std::uint64_t index = 0);

  result_type operator()() {
    state_ += 0x9e3779b97f4a7c15u;
    std::uint64_t z = state_;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
  static constexpr result_type min() { return 0; }
  static constexpr result_type max() { return std::numeric_limits<result_type>::max(); }

  /// In [0, 1).
  double uniform() { return static_cast<double>((*this)() >> 11) * 0x1.0p-53; }
  double uniform(double lower, double upper) { return lower + (upper - lower) * uniform(); }
  /// Zero mean, unit standard deviation.
  double normal();

 private:
  std::uint64_t state_;
};

}  // namespace turntable
