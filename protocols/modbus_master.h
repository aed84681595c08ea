// Modbus, the master's side, through libmodbus: RTU frames on a serial line or a serial server, or
// Modbus TCP through a gateway. Several slaves may share one line.
//
// libmodbus would wait in a select of its own and write past the wire log, so it never sees the
// line: it makes and checks the frames (address, function, CRC, transaction) on a socket pair inside
// this process, and what passes there is carried to and from the `Line` on the `Clock`.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "protocols/shared_line.h"
#include "src/core/errors.h"

namespace turntable {

/// The slave understood, and said no.
class ModbusException : public DeviceError {
 public:
  ModbusException(const std::string& what, int code) : DeviceError(what), code_(code) {}
  int code() const { return code_; }

 private:
  int code_;
};

/// The silence that RTU wants between two frames: 3.5 characters of 11 bits, and 1.75 ms above 19200
/// baud ("MODBUS over serial line" V1.02, 2.5.1.1).
Time rtu_silence(int baud);

class ModbusMaster {
 public:
  enum class Framing { kRtu, kTcp };
  /// Whether a write may be sent again after a failure: a setting may, the opcode of a motion not.
  enum class Repeat { kNever, kAllowed };
  /// Several masters may share a line: each exchange takes its turn.
  /// @param give_way asked every 20 ms while waiting: true ends the wait (somebody more urgent needs
  /// the line).
  ModbusMaster(SharedLine line, Clock& clock, Framing framing, Time timeout,
               std::function<bool()> give_way = {});
  ~ModbusMaster();
  ModbusMaster(const ModbusMaster&) = delete;
  ModbusMaster& operator=(const ModbusMaster&) = delete;

  // One exchange each; nothing is sent twice. Addresses are those on the wire, counted from 0.
  // What is on the line from before is thrown away first; frames of other slaves are passed over, and so
  // is the master's own frame where the adapter hands it back. A wait ends at its deadline whatever
  // arrives.
  // @throws TimeoutError (BusyError for exceptions 05 and 06 to what may be asked again), ProtocolError (bad CRC, not an answer to this),
  // ModbusException, LineError.

  /// Function 3.
  std::vector<std::uint16_t> read_holding(int slave, std::uint16_t address, int count);
  /// Function 4.
  std::vector<std::uint16_t> read_input(int slave, std::uint16_t address, int count);
  /// Function 6.
  void write_register(int slave, std::uint16_t address, std::uint16_t value,
                      Repeat repeat = Repeat::kNever);
  /// Function 16.
  void write_registers(int slave, std::uint16_t address, std::span<const std::uint16_t> values,
                       Repeat repeat = Repeat::kNever);

  /// While it lives, an exchange after trouble waits 5 ms at most for the line to be quiet, and until an
  /// answer that may be on its way has come: a stop cannot wait longer, and may be said again.
  class Urgent {
   public:
    explicit Urgent(ModbusMaster& master) : master_(master) { master_.urgent_ = true; }
    ~Urgent() { master_.urgent_ = false; }
    Urgent(const Urgent&) = delete;
    Urgent& operator=(const Urgent&) = delete;

   private:
    ModbusMaster& master_;
  };

 private:
  class Context;

  std::vector<std::uint16_t> read(int function, int slave, std::uint16_t address, int count);
  void write(const std::string& pdu, int slave, Repeat repeat);
  std::string exchange(const std::string& pdu, int slave, std::size_t answer_bytes, Repeat repeat);
  void send(const std::string& frame, Time deadline);
  bool drop_echo(std::string& received, std::string_view frame, int function, bool& due);
  std::string answer_in(std::string_view received, int function, int slave,
                        std::size_t answer_bytes);
  [[noreturn]] void refused(const std::string& pdu, int slave, int code, Repeat repeat) const;
  [[noreturn]] void unanswered(const std::string& received, const std::string& frame,
                               int slave) const;
  void settle(Time unanswered_since);

  SharedLine line_;
  Clock* clock_;
  Framing framing_;
  Time timeout_;
  std::function<bool()> give_way_;
  std::unique_ptr<Context> context_;
  std::uint16_t transaction_ = 0;  ///< kTcp: tells a late answer from the present one
  bool urgent_ = false;
};

}  // namespace turntable
