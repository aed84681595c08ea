// A camera of the Video4Linux system (USB cameras, frame grabbers), or a video file or image
// sequence in its place. It runs freely: nothing tells it when to expose, so a trigger throws
// frames away until one is certain to have been exposed after it.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "drivers/camera.h"

namespace turntable {

/// Frame ids count all frames grabbed, so that those thrown away show as gaps. Colour becomes luma,
/// of 16 bits the upper eight are kept. A frame that does not come ends a trigger after 10 s at the
/// latest, which is the library's own limit.
/// @throws ConfigError for a file that is not there or asked to change its exposure; DeviceError if
/// the device is not there, or does not take size, exposure or gain as the rig file says.
std::unique_ptr<Camera> open_usb_camera(CameraSetup setup);

/// "/dev/video0: name of the card", for every device that captures; also if another program uses
/// it.
std::vector<std::string> find_usb_cameras();

/// Grabs until a frame was exposed after the call, from a camera that runs freely behind a buffer.
/// At least `stale` frames are thrown away. A frame that came faster than half an interval was
/// waiting in the buffer; one that had to be waited for may have begun up to two intervals earlier
/// (one to expose, one to transfer), so that it has to come later than that. No buffer is deeper
/// than 32 frames (VIDEO_MAX_FRAME of the kernel): behind them everything is new.
/// An `interval` of 0 is a file, which has no buffer.
/// @param grab false = no frame came. @return false if grab did.
bool grab_after_now(const std::function<bool()>& grab, const Clock& clock, int stale,
                    Time interval);

}  // namespace turntable
