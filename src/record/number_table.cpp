#include "src/record/number_table.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "src/core/errors.h"
#include "src/core/json_document.h"

namespace turntable {
namespace {

std::vector<std::string> split(std::string_view line) {
  std::vector<std::string> cells;
  for (std::size_t at = 0;;) {
    const std::size_t comma = line.find(',', at);
    std::string_view cell = line.substr(at, comma - at);
    while (!cell.empty() && (cell.front() == ' ' || cell.front() == '\t')) cell.remove_prefix(1);
    while (!cell.empty() && (cell.back() == ' ' || cell.back() == '\t')) cell.remove_suffix(1);
    cells.emplace_back(cell);
    if (comma == std::string_view::npos) return cells;
    at = comma + 1;
  }
}

}  // namespace

NumberTable read_number_table(const std::filesystem::path& file,
                              const std::vector<std::string>& required,
                              const std::vector<std::string>& optional) {
  return number_table(read_text(file), file.string(), required, optional);
}

NumberTable number_table(std::string_view text, const std::string& name,
                         const std::vector<std::string>& required,
                         const std::vector<std::string>& optional) {
  if (text.find('\0') != std::string::npos)
    throw ConfigError(name, "", "is no plain text. Save the table as CSV in UTF-8.");
  NumberTable table;
  std::vector<std::string> header;
  std::vector<std::pair<std::size_t, std::vector<double>*>> wanted;
  std::size_t at = text.starts_with("\xEF\xBB\xBF") ? 3 : 0;  // a mark that spreadsheets leave
  for (int line = 1; at < text.size(); ++line) {
    std::size_t end = text.find('\n', at);
    if (end == std::string_view::npos) end = text.size();
    std::string_view content = text.substr(at, end - at);
    at = end + 1;
    if (content.ends_with('\r')) content.remove_suffix(1);
    if (content.empty()) continue;
    const std::vector<std::string> cells = split(content);
    if (header.empty()) {
      header = cells;
      std::vector<std::string> all = required;
      all.insert(all.end(), optional.begin(), optional.end());
      for (const std::string& column : header)
        if (std::ranges::find(all, column) == all.end()) table.unused.push_back(column);
      for (const std::string& column : all) {
        const auto found = std::ranges::find(header, column);
        if (found == header.end()) {
          if (std::ranges::find(required, column) == required.end()) continue;
          throw ConfigError(name, fmt::format("line {}", line),
                            fmt::format("column \"{}\" is missing; found: {}. Name the columns in "
                                        "the first line, separated by commas.",
                                        column, fmt::join(header, ", ")));
        }
        if (std::ranges::count(header, column) > 1)
          throw ConfigError(name, fmt::format("line {}", line),
                            fmt::format("column \"{}\" stands twice. Rename one of them.", column));
        wanted.emplace_back(found - header.begin(), &table.columns[column]);
      }
      continue;
    }
    if (cells.size() != header.size())
      throw ConfigError(name, fmt::format("line {}", line),
                        fmt::format("found {} cells, allowed: {} as in the first line.",
                                    cells.size(), header.size()));
    for (const auto& [column, values] : wanted) {
      const std::string& cell = cells[column];
      double value = NAN;
      const auto [rest, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
      if (error != std::errc{} || rest != cell.data() + cell.size() || !std::isfinite(value))
        throw ConfigError(name, fmt::format("line {}, column {}", line, header[column]),
                          fmt::format("found \"{}\", allowed: a finite number.", cell));
      values->push_back(value);
    }
    table.lines.push_back(line);
  }
  if (table.rows() == 0)
    throw ConfigError(name, "", "holds no rows. Give a first line with names and rows of numbers.");
  return table;
}

}  // namespace turntable
