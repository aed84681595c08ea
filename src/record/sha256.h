// SHA-256 of texts and files' bytes: what identifies plans, rig files and images.
#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace turntable {

/// Of bytes that come piece by piece. @throws RecordError if the cryptographic library refuses.
class Sha256 {
 public:
  Sha256();
  void add(std::string_view bytes);
  /// 64 lower-case hexadecimal digits; nothing may be added afterwards.
  std::string hex();

 private:
  std::shared_ptr<void> context_;
};

/// 64 lower-case hexadecimal digits. @throws RecordError as above.
std::string sha256_hex(std::string_view bytes);

}  // namespace turntable
