#include "src/record/sha256.h"

#include <openssl/evp.h>

#include <array>

#include "src/core/errors.h"

namespace turntable {
namespace {

void require_done(int result) {
  if (result != 1) throw RecordError("SHA-256 is not available from OpenSSL");
}

}  // namespace

Sha256::Sha256()
    : context_(::EVP_MD_CTX_new(),
               [](void* c) { ::EVP_MD_CTX_free(static_cast<EVP_MD_CTX*>(c)); }) {
  require_done(
      ::EVP_DigestInit_ex(static_cast<EVP_MD_CTX*>(context_.get()), ::EVP_sha256(), nullptr));
}

void Sha256::add(std::string_view bytes) {
  require_done(
      ::EVP_DigestUpdate(static_cast<EVP_MD_CTX*>(context_.get()), bytes.data(), bytes.size()));
}

std::string Sha256::hex() {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned int size = 0;
  require_done(
      ::EVP_DigestFinal_ex(static_cast<EVP_MD_CTX*>(context_.get()), digest.data(), &size));
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string hex;
  hex.reserve(2 * size);
  for (unsigned int i = 0; i < size; ++i) {
    hex += kDigits[digest[i] >> 4u];
    hex += kDigits[digest[i] & 0xfu];
  }
  return hex;
}

std::string sha256_hex(std::string_view bytes) {
  Sha256 hash;
  hash.add(bytes);
  return hash.hex();
}

}  // namespace turntable
