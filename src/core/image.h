// Grey images as plain memory, so that no floor below the image libraries has to know them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "src/core/clock.h"

namespace turntable {

struct ImageSize {
  int width = 0;
  int height = 0;
  friend bool operator==(ImageSize, ImageSize) = default;
};

/// Somebody else's pixels: row-major, 8 bit, `stride` bytes from row to row.
struct ImageView {
  const std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;

  const std::uint8_t* row(int v) const { return data + v * stride; }
  ImageSize size() const { return {width, height}; }
  bool empty() const { return width <= 0 || height <= 0; }
};

/// An 8-bit grey image that owns its pixels. Pixel (0,0) is the centre of the top-left pixel; u
/// right, v down.
struct Image {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;

  Image() = default;
  Image(ImageSize size, std::uint8_t grey)
      : width(size.width),
        height(size.height),
        pixels(static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height), grey) {
  }
  std::uint8_t* row(int v) { return pixels.data() + static_cast<std::ptrdiff_t>(v) * width; }
  operator ImageView() const { return {pixels.data(), width, height, width}; }
  ImageSize size() const { return {width, height}; }
};

/// Pixels as an image library hands them out: 8 or 16 bit in the machine's own byte order; one
/// channel is grey, three or four are blue, green, red and an opacity that nobody looks at.
struct ForeignPixels {
  const void* data = nullptr;
  ImageSize size;
  std::ptrdiff_t stride = 0;  ///< bytes from row to row
  int channels = 1;
  int bits = 8;
};

/// Grey stays as it is, colour becomes its luma (ITU-R BT.601: 0.299 red, 0.587 green, 0.114 blue),
/// and of 16 bits the upper eight are kept.
Image to_grey(const ForeignPixels& pixels);

/// One exposure.
struct Frame {
  Image image;
  std::uint64_t id = 0;  ///< the camera's own counter; a gap is a lost frame
  Time timestamp{0};     ///< start of exposure on the rig's clock
};

}  // namespace turntable
