#include "drivers/genicam_frame.h"

#include <algorithm>

namespace turntable {

std::optional<std::uint64_t> FrameIds::advance(std::uint64_t raw) {
  constexpr std::uint64_t kLast = 0xffff;
  std::uint64_t step = 1;
  if (!started_) {
    started_ = true;
    current_ = raw - 1;
  } else if (raw > kLast || raw_ > kLast) {  // 64 bits
    if (raw <= raw_) return std::nullopt;
    step = raw - raw_;
  } else {
    step = (raw - raw_) & kLast;
    if (step == 0 || step > kLast / 2) return std::nullopt;
    if (raw < raw_ && raw > 0) --step;  // 0 was skipped
  }
  raw_ = raw;
  current_ += step;
  return step;
}

int significant_bits(std::string_view pixel_format) {
  if (pixel_format == "Mono8") return 8;
  if (pixel_format == "Mono10") return 10;
  if (pixel_format == "Mono12") return 12;
  if (pixel_format == "Mono16") return 16;
  return 0;
}

Image top_8_bits(const std::uint8_t* data, ImageSize size, std::size_t stride, int bits) {
  Image image(size, 0);
  for (int v = 0; v < size.height; ++v) {
    const std::uint8_t* from = data + static_cast<std::size_t>(v) * stride;
    std::uint8_t* to = image.row(v);
    if (bits == 8) {
      std::copy_n(from, size.width, to);
      continue;
    }
    for (int u = 0; u < size.width; ++u)
      to[u] = static_cast<std::uint8_t>(
          std::min(255, (from[2 * u] | from[2 * u + 1] << 8) >> (bits - 8)));
  }
  return image;
}

}  // namespace turntable
