#include "src/core/random.h"

#include <boost/random/normal_distribution.hpp>

namespace turntable {

Random::Random(std::uint64_t seed, std::string_view stream, std::uint64_t index) : state_(seed) {
  // FNV-1a over the stream's name, then one mixing step per part, so that neighbours share nothing.
  std::uint64_t name = 0xcbf29ce484222325u;
  for (const char c : stream) name = (name ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  state_ = (*this)() ^ name;
  state_ = (*this)() ^ index;
  state_ = (*this)();
}

double Random::normal() { return boost::random::normal_distribution<double>()(*this); }

}  // namespace turntable
