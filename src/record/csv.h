// Comma-separated tables, the same bytes for the same values on every machine.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace turntable {

/// RFC 4180 with "\n" line ends. Build it row by row, then write it in one go.
class Csv {
 public:
  explicit Csv(const std::vector<std::string>& header);

  /// Appends a cell to the present row; text is quoted only where it must be.
  Csv& text(std::string_view value);
  /// Fixed decimals; never "-0.000"; an empty cell for a value that is not finite.
  Csv& number(double value, int decimals);
  Csv& integer(std::int64_t value);
  Csv& empty() { return text({}); }
  /// Ends the row. The number of cells must be the header's.
  void end_row();

  const std::string& str() const { return out_; }
  /// @throws RecordError.
  void write(const std::filesystem::path& file) const;

 private:
  std::string out_;
  std::size_t columns_ = 0;
  std::size_t cells_ = 0;
};

/// "12.340": fixed decimals without a negative zero, for CSV and Markdown alike.
std::string fixed(double value, int decimals);

}  // namespace turntable
