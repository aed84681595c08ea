// Channels of telemetry: a number in a text file, an instrument that answers a query in text, a
// Modbus register. Instruments only ever get queries, and a query that fails may be asked again.
#pragma once

#include <functional>
#include <string_view>
#include <vector>

#include "src/core/rig.h"
#include "src/core/rig_file.h"

namespace turntable {

/// By order of the rig file. Channels on one line share it. The clock must outlive them.
/// @param simulated reads a channel whose source is simulated.
/// @throws LineError if a line cannot be opened.
std::vector<Channel> open_channels(const TelemetryConfig& telemetry, Clock& clock,
                                   const std::function<double(const ChannelConfig&)>& simulated);

/// The first number in `text`, "+021.37 C" or "T=21.4"; not what belongs to a name ("PT100"), a date, a
/// time or an address. @throws ProtocolError if there is none, or it may mean two things: a comma between
/// digits whose meaning was not stated, marks that may part thousands.
double first_number(std::string_view text, Decimal decimal = Decimal::kUnstated);

}  // namespace turntable
