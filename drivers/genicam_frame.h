// What the id and the bytes of a GenICam frame mean.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "src/core/image.h"

namespace turntable {

/// A camera's frame ids without their wrap-around. GigE Vision block ids have 16 bits and skip 0
/// (65535 is followed by 1); extended ids of GigE Vision 2 and those of USB3 Vision have 64 bits.
/// A camera that does count 0 (Aravis' fake one) is understood too.
class FrameIds {
 public:
  /// Takes the id of the next frame seen. @return how many ids later than the last one it is, 1 if
  /// nothing is missing; nothing if it does not come after it. Of 16-bit ids, half the circle does.
  std::optional<std::uint64_t> advance(std::uint64_t raw);
  /// Of the last frame: its first id, plus the steps since.
  std::uint64_t current() const { return current_; }

 private:
  bool started_ = false;
  std::uint64_t raw_ = 0;
  std::uint64_t current_ = 0;
};

/// Significant bits of Mono8, Mono10, Mono12 and Mono16; 0 for any other pixel format.
int significant_bits(std::string_view pixel_format);

/// The upper eight of the significant bits. Wider formats hold a pixel right-aligned in a 16-bit
/// little-endian word. `stride` bytes from row to row.
Image top_8_bits(const std::uint8_t* data, ImageSize size, std::size_t stride, int bits);

}  // namespace turntable
