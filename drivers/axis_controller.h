// What all controllers have in common: axes by channel, each with the one motion loop; a line that
// is locked for each exchange, on which a stop goes first, and which is opened again if it was closed
// while nothing moved; nothing moves before the set-up has been compared. A driver supplies the hooks below, in whole pulses: what it makes of them on
// the wire is all that it is about.
#pragma once

#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/controller.h"
#include "drivers/motion.h"
#include "src/core/errors.h"

namespace turntable {

class AxisController : public Controller {
 public:
  ~AxisController() override;
  std::string identity() const final;
  std::vector<std::string> connect() final;
  void configure() final;
  Axis<Millimetres>* linear_axis(AxisId id) final;
  Axis<Degrees>* rotary_axis(AxisId id) final;
  void trust_reference(AxisId id) final;
  void pulse_output(const std::string& name) final;
  void keep_alive() final;
  void forbid_all() final;
  void begin_stop_all() final;
  void finish_stop_all() final;

  /// One axis of the controller as a driver sees it: in the controller's own sense of direction.
  struct Channel {
    AxisConfig config;
    std::size_t index = 0;  ///< in `channels()`

    double unit(Steps s) const { return static_cast<double>(s.count) * config.per_step(); }
    Steps steps(double value) const {
      return StepScale<Degrees>{{config.per_step()}}.to_steps({value});
    }
  };

 protected:
  /// Takes the axes and the configuration out of `setup`.
  explicit AxisController(ControllerSetup& setup);

  // ---- What a driver supplies. No hook sends a motion command twice.

  /// Asks who is there and how it is set up; changes nothing. @return what the device says it is;
  /// adds a line (`difference`) for everything that is not as the rig file says. Called locked.
  virtual std::string observe(std::vector<std::string>& differences) = 0;
  /// Writes the set-up of the rig file. Moves nothing. Called locked.
  virtual void write_setup() = 0;
  /// False while the controller can take no motion command for this channel because another one
  /// moves; has to become true in bounded time. Called locked.
  virtual bool free(const Channel&) { return true; }
  /// Called locked. @param from where the axis stands. @throws DeviceError if refused, LineError.
  virtual Acknowledgement start_move(const Channel& channel, Steps from, Steps to) = 0;
  virtual Acknowledgement start_home(const Channel& channel) = 0;
  /// As `AxisPort::count_from_home`. Called locked.
  virtual bool count_from_home(const Channel&) { return false; }
  /// Reads, retrying a bounded number of times (`retried`) and not past `deadline`. Called
  /// unlocked: every exchange takes the lock for itself, so that a stop can come between.
  virtual AxisStatus<Steps> status(const Channel& channel, Time deadline) = 0;
  /// False if the controller knows that the axis has not been homed since it was switched on.
  virtual bool may_be_homed(const Channel&) { return true; }
  /// True where positions mean something without homing, as those of absolute encoders do: an axis of a
  /// controller that is connected, and set up as the rig file says, counts as homed.
  virtual bool positions_are_absolute() const { return false; }
  /// May be sent again. Called locked, with everybody else giving way.
  virtual void send_stop(const Channel& channel, bool immediate) = 0;
  /// Called locked.
  virtual void switch_output(const OutputConfig& output, bool on) = 0;
  /// How often a read may be asked.
  virtual int attempts() const { return 3; }

  // ---- What it may use.

  const std::vector<Channel>& channels() const { return channels_; }
  const ControllerConfig& config() const { return config_; }
  Clock& clock() const { return *clock_; }
  Time reply_timeout() const { return from_seconds(config_.reply_timeout_s); }
  const SharedLine& line() const { return line_; }
  const std::string& line_name() const { return line_.name(); }
  std::unique_lock<std::recursive_mutex> lock() const { return line_.lock(); }
  /// True if an exchange should end its waiting because a stop waits for the line.
  bool gives_way() const { return line_.gives_way(); }
  /// The last thing before the bytes of a motion: what went before may have taken its time.
  /// @throws GaveWay if a stop waits.
  void require_no_stop(const Channel& channel) const;
  /// "axis yaw (channel Y of mc1 on /dev/ttyUSB0)"
  std::string where(const Channel& channel) const;
  /// "yaw: SetSpeed? Y: wanted 25, found 20"
  static std::string difference(const Channel& channel, const std::string& what,
                                const std::string& wanted, const std::string& found);
  /// The channel's letter, upper case. @throws ConfigError unless every channel is one of `letters`
  /// (any case) and none is given twice: `require_letters`.
  static char letter(const Channel& channel);
  void require_letters(std::string_view letters) const;
  /// @throws ConfigError if an output of the rig file is not of the kind the controller understands.
  void require_outputs(bool as_text) const;
  /// Reads, and writes of settings, may be said again after silence or noise, and for a second after
  /// "busy"; motion commands never come here.
  template <class F>
  auto retried(Time deadline, F&& exchange) {
    const int most = once_ ? 1 : attempts();
    const Time busy_until = clock_->now() + kBusyPatience;
    for (int attempt = 1;; ++attempt) {
      try {
        return exchange();
      } catch (const GaveWay&) {
        throw;
      } catch (const BusyError&) {
        if (once_ || gives_way() || clock_->now() >= std::min(deadline, busy_until)) throw;
        clock_->sleep_for(kBusyPause);
        --attempt;
      } catch (const TimeoutError&) {
        if (attempt == most || clock_->now() >= deadline) throw;
      } catch (const ProtocolError&) {
        if (attempt == most || clock_->now() >= deadline) throw;
      }
    }
  }

 private:
  class Port;
  template <class Q>
  class ChannelAxis;
  template <class Q>
  Axis<Q>* find(AxisId id);
  void require_ready() const;
  void stop_channel(const Channel& channel, bool immediate);
  void notice_reopening();
  void connect_again(const LineError& why);
  template <class F>
  auto on_open_line(F&& exchange);

  static constexpr Time kBusyPause = std::chrono::milliseconds{50};
  static constexpr Time kBusyPatience = std::chrono::seconds{1};

  ControllerConfig config_;
  Clock* clock_;
  std::vector<Channel> channels_;
  std::vector<std::unique_ptr<Port>> ports_;  ///< by channel
  std::vector<std::exception_ptr>
      not_told_;                   ///< by channel: why the last stop was not acknowledged
  SharedLine line_;                ///< its lock guards all that is below, too
  unsigned opened_;                ///< the line's count of openings, as last seen
  std::atomic<bool> once_{false};  ///< several axes are being stopped: nobody is asked twice yet
  bool connected_ = false;
  std::string details_;
  std::vector<std::string> differences_;
};

}  // namespace turntable
