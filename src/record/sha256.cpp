#include "src/record/sha256.h"

#include <openssl/evp.h>

#include <array>

#include "src/core/errors.h"

namespace turntable {

std::string sha256_hex(std::string_view bytes) {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned int size = 0;
  if (EVP_Digest(bytes.data(), bytes.size(), digest.data(), &size, EVP_sha256(), nullptr) != 1)
    throw RecordError("SHA-256 is not available from OpenSSL");
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string hex;
  hex.reserve(2 * size);
  for (unsigned int i = 0; i < size; ++i) {
    hex += kDigits[digest[i] >> 4u];
    hex += kDigits[digest[i] & 0xfu];
  }
  return hex;
}

}  // namespace turntable
