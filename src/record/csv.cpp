#include "src/record/csv.h"

#include <fmt/format.h>

#include <cassert>
#include <cmath>

#include "src/record/atomic_file.h"

namespace turntable {

std::string fixed(double value, int decimals) {
  std::string text = fmt::format("{:.{}f}", value, decimals);
  if (text.front() == '-' && text.find_first_not_of("-0.") == std::string::npos) text.erase(0, 1);
  return text;
}

Csv::Csv(const std::vector<std::string>& header) : columns_(header.size()) {
  for (const auto& name : header) text(name);
  end_row();
}

Csv& Csv::text(std::string_view value) {
  if (cells_++ > 0) out_ += ',';
  if (value.find_first_of(",\"\r\n") == std::string_view::npos) {
    out_ += value;
    return *this;
  }
  out_ += '"';
  for (const char c : value) {
    if (c == '"') out_ += '"';
    out_ += c;
  }
  out_ += '"';
  return *this;
}

Csv& Csv::number(double value, int decimals) {
  return text(std::isfinite(value) ? fixed(value, decimals) : std::string());
}

Csv& Csv::integer(std::int64_t value) { return text(std::to_string(value)); }

void Csv::end_row() {
  assert(cells_ == columns_);
  cells_ = 0;
  out_ += '\n';
}

void Csv::write(const std::filesystem::path& file) const { write_atomically(file, out_); }

}  // namespace turntable
