// A table as the report writes it: CSV with units in its header, Markdown and LaTeX, from one set of
// rows.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <variant>
#include <vector>

#include "src/evaluation/statistics.h"

namespace turntable {

struct TableColumn {
  std::string
      csv;  ///< empty: not in the CSV file; else its header in the CSV file, with its unit: "rmse_yaw_deg"; of an interval the
            ///< stem, to which _lower and _upper are added before the unit
  std::string title;  ///< in Markdown and LaTeX: "RMSE yaw / deg"; empty: CSV only
  int decimals = 4;   ///< to be read; CSV has two more
};

/// Nothing, text, a whole number, a number, a number with decimals of its own, or one with its interval.
struct Rounded {
  double value;
  int decimals;  ///< everywhere: digits beyond were never known
};
using Cell = std::variant<std::monostate, std::string, std::int64_t, double, Rounded, WithInterval>;

struct Table {
  std::string name;   ///< file stem
  std::string title;  ///< one line, no Markdown
  std::vector<TableColumn> columns;
  std::vector<std::vector<Cell>> rows;  ///< a cell for every column
};

/// A table that was written.
struct WrittenTable {
  std::string name;
  std::string title;
  std::string markdown;  ///< the table itself
};

std::string table_csv(const Table& table);
/// GitHub's tables, texts as they are; numbers to the right; "-" for a value that is not finite.
std::string table_markdown(const Table& table);
/// One tabular environment that needs no package.
std::string table_latex(const Table& table);

/// Text for Markdown, in a paragraph, heading, cell of a table or alternative of an image: what it would read as
/// marks is escaped. The name of a scenario stays as it is.
std::string markdown_text(std::string_view text);
/// Text for LaTeX: its special characters escaped.
std::string latex_text(std::string_view text);

/// Writes <folder>/<name>.{csv,md,tex}. @throws RecordError.
WrittenTable write_table(const Table& table, const std::filesystem::path& folder);
/// The same of a table that is shorter or turned where it is read: CSV of `all`, the rest of `shown`.
WrittenTable write_table(const Table& all, const Table& shown, const std::filesystem::path& folder);

/// The table of that name, or nullptr.
const WrittenTable* find_table(const std::vector<WrittenTable>& written, std::string_view name);

}  // namespace turntable
