// SHA-256 of texts and files' bytes: what identifies plans, rig files and images.
#pragma once

#include <string>
#include <string_view>

namespace turntable {

/// 64 lower-case hexadecimal digits. @throws RecordError if the cryptographic library refuses.
std::string sha256_hex(std::string_view bytes);

}  // namespace turntable
