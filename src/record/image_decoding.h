// Encoded images to pixels by OpenCV, with what the libraries below it have to say.
#pragma once

#include <opencv2/core/mat.hpp>
#include <string>

namespace turntable {

struct DecodedImage {
  cv::Mat pixels;  ///< as stored: depth and channels are the file's; empty if it cannot be decoded
  std::string said;  ///< by libpng, libjpeg or libtiff, a line each; empty if nothing
};

/// Never throws for what is in `bytes`, and nothing of it is printed. May be called from any thread.
/// @param bytes of a whole file; not changed.
DecodedImage decode_image(std::string& bytes);

}  // namespace turntable
