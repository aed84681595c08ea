#include "src/core/image.h"

#include <cassert>

namespace turntable {
namespace {

/// Weights of blue, green and red in 2^-14; they add up to one, so grey written as colour comes
/// back exactly.
constexpr std::uint32_t kBlue = 1868, kGreen = 9617, kRed = 4899;
static_assert(kBlue + kGreen + kRed == 1u << 14u);

template <class Channel>
Image convert(const ForeignPixels& from) {
  constexpr unsigned kDropped = 8 * sizeof(Channel) - 8;
  Image out(from.size, 0);
  const auto* bytes = static_cast<const std::uint8_t*>(from.data);
  for (int v = 0; v < out.height; ++v) {
    const auto* p = reinterpret_cast<const Channel*>(bytes + v * from.stride);
    std::uint8_t* to = out.row(v);
    for (int u = 0; u < out.width; ++u, p += from.channels) {
      const std::uint32_t grey =
          from.channels == 1 ? p[0]
                             : (kBlue * p[0] + kGreen * p[1] + kRed * p[2] + (1u << 13u)) >> 14u;
      to[u] = static_cast<std::uint8_t>(grey >> kDropped);
    }
  }
  return out;
}

}  // namespace

Image to_grey(const ForeignPixels& pixels) {
  assert(pixels.channels == 1 || pixels.channels == 3 || pixels.channels == 4);
  assert(pixels.bits == 8 || pixels.bits == 16);
  return pixels.bits == 8 ? convert<std::uint8_t>(pixels) : convert<std::uint16_t>(pixels);
}

}  // namespace turntable
