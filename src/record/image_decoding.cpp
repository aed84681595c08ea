#include "src/record/image_decoding.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <iostream>
#include <mutex>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>
#include <streambuf>
#include <string_view>

namespace turntable {
namespace {

/// Where what this thread prints to `stderr` goes instead.
thread_local std::string* listening = nullptr;

ssize_t hear(void*, const char* text, size_t size) {
  if (listening == nullptr) return ::write(STDERR_FILENO, text, size);
  constexpr std::size_t kMost = 1000;  // a damaged file can have a complaint for every row
  if (listening->size() < kMost) listening->append(text, std::min(size, kMost - listening->size()));
  return static_cast<ssize_t>(size);
}

/// The same for C++, where OpenCV prints itself.
class Hearing : public std::streambuf {
  std::streamsize xsputn(const char* text, std::streamsize size) override {
    return hear(nullptr, text, static_cast<std::size_t>(size));
  }
  int_type overflow(int_type c) override {
    const char byte = traits_type::to_char_type(c);
    if (!traits_type::eq_int_type(c, traits_type::eof())) xsputn(&byte, 1);
    return traits_type::not_eof(c);
  }
};

/// libpng, libjpeg, libtiff and OpenCV print what they find, without the file's name, and OpenCV
/// has no door to that. The GNU C library lets `stderr` be another stream: one that tells the
/// threads apart. What the others print still reaches descriptor 2.
void listen_to_libraries() {
  static std::once_flag once;
  std::call_once(once, [] {
    std::FILE* stream = ::fopencookie(nullptr, "w", {nullptr, hear, nullptr, nullptr});
    if (stream == nullptr) return;  // no memory: it is printed as before
    std::setvbuf(stream, nullptr, _IONBF, 0);
    stderr = stream;
    static Hearing hearing;  // outlives every stream
    std::cerr.rdbuf(&hearing);
    cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  });
}

/// All lines as one, to stand in a sentence.
std::string one_line(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    if (end > 0) out.append(out.empty() ? "" : "; ").append(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  for (char& c : out)
    if (static_cast<unsigned char>(c) < ' ') c = ' ';
  return out;
}

}  // namespace

DecodedImage decode_image(std::string& bytes) {
  listen_to_libraries();
  DecodedImage out;
  std::string said;
  listening = &said;
  try {
    out.pixels = cv::imdecode(cv::Mat(1, static_cast<int>(bytes.size()), CV_8UC1, bytes.data()),
                              cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {  // the same as no pixels
    out.pixels.release();
  }
  listening = nullptr;
  out.said = one_line(said);
  return out;
}

}  // namespace turntable
