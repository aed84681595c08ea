// Columns of numbers that other programs wrote: comma-separated, the first line names them.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace turntable {

struct NumberTable {
  std::map<std::string, std::vector<double>> columns;  ///< the wanted ones that are there
  std::vector<int> lines;                              ///< of each row, counted from 1
  std::vector<std::string> unused;                     ///< names of the other columns

  std::size_t rows() const { return lines.size(); }
  bool has(const std::string& name) const { return columns.contains(name); }
  const std::vector<double>& at(const std::string& name) const { return columns.at(name); }
};

/// Other columns may hold anything. Empty lines are skipped.
/// @throws ConfigError with file and line: unreadable, a required column missing, a row of another
/// length, a cell of a wanted column that is no finite number.
NumberTable read_number_table(const std::filesystem::path& file,
                              const std::vector<std::string>& required,
                              const std::vector<std::string>& optional = {});
/// The same of text that is there already, by the name that errors call it.
NumberTable number_table(std::string_view text, const std::string& name,
                         const std::vector<std::string>& required,
                         const std::vector<std::string>& optional = {});

}  // namespace turntable
