// A GigE Vision camera on loopback: Aravis' fake camera, in this process, filled with images that
// the caller makes. Whoever opens it speaks the real protocol over real sockets, in real time.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "src/core/image.h"

namespace turntable::sim {

struct GigePeerOptions {
  std::string serial = "SIM01";
  int lost_packets_per_1000 = 0;
};

class GigePeer {
 public:
  /// What the whole sensor sees at the n-th exposure, counted from 0. Called on the peer's own
  /// thread while the client waits for its frame; must not throw.
  using Expose = std::function<Image(std::uint64_t exposure)>;

  /// @throws LineError if another camera is served on this computer: the port is the protocol's.
  GigePeer(Expose expose, ImageSize sensor, GigePeerOptions options = {});
  ~GigePeer();

  std::string address() const;
  std::string id() const;  ///< under which it is found
  std::uint64_t exposures() const;
  /// An edge on Line0. Exposes if the client has armed the camera to trigger on it, and returns
  /// when `Expose` has: nothing moves under it.
  void hardware_trigger();
  /// As if its plug were pulled: nothing is answered any more.
  void kill();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace turntable::sim
