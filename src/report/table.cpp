#include "src/report/table.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>

#include "src/record/atomic_file.h"
#include "src/record/csv.h"

namespace turntable {
namespace {

template <class... Ts>
struct Overloaded : Ts... {
  using Ts::operator()...;
};
template <class... Ts>
Overloaded(Ts...) -> Overloaded<Ts...>;

bool holds_interval(const Table& table, std::size_t column) {
  for (const std::vector<Cell>& row : table.rows)
    if (std::holds_alternative<WithInterval>(row[column])) return true;
  return false;
}

bool holds_text(const Table& table, std::size_t column) {
  for (const std::vector<Cell>& row : table.rows)
    if (std::holds_alternative<std::string>(row[column])) return true;
  return false;
}

/// "change_deg" -> "change_lower_deg".
std::string with_bound(const std::string& name, std::string_view bound) {
  const std::size_t unit = name.rfind('_');
  if (unit == std::string::npos) return fmt::format("{}_{}", name, bound);
  return fmt::format("{}_{}{}", name.substr(0, unit), bound, name.substr(unit));
}

std::string readable(double value, int decimals) {
  return std::isfinite(value) ? fixed(value, decimals) : "-";
}

/// As a reader sees it.
std::string readable(const Cell& cell, int decimals) {
  return std::visit(
      Overloaded{[](std::monostate) { return std::string(); },
                 [](const std::string& text) { return text; },
                 [](std::int64_t number) { return fmt::format("{}", number); },
                 [&](double number) { return readable(number, decimals); },
                 [](const Rounded& number) { return readable(number.value, number.decimals); },
                 [&](const WithInterval& w) {
                   if (!std::isfinite(w.value)) return std::string("-");
                   return fmt::format("{} [{}, {}]", readable(w.value, decimals),
                                      readable(w.interval.lower, decimals),
                                      readable(w.interval.upper, decimals));
                 }},
      cell);
}

}  // namespace

std::string table_csv(const Table& table) {
  std::vector<std::string> header;
  std::vector<bool> interval;
  for (std::size_t c = 0; c < table.columns.size(); ++c) {
    const std::string& name = table.columns[c].csv;
    interval.push_back(holds_interval(table, c));
    if (name.empty()) continue;
    header.push_back(name);
    if (!interval.back()) continue;
    header.push_back(with_bound(name, "lower"));
    header.push_back(with_bound(name, "upper"));
  }
  Csv csv(header);
  for (const std::vector<Cell>& row : table.rows) {
    for (std::size_t c = 0; c < table.columns.size(); ++c) {
      if (table.columns[c].csv.empty()) continue;
      const int decimals = table.columns[c].decimals + 2;
      std::visit(Overloaded{[&](std::monostate) { csv.empty(); },
                            [&](const std::string& text) { csv.text(text); },
                            [&](std::int64_t number) { csv.integer(number); },
                            [&](double number) { csv.number(number, decimals); },
                            [&](const Rounded& n) { csv.number(n.value, n.decimals); },
                            [&](const WithInterval& w) {
                              csv.number(w.value, decimals).number(w.interval.lower, decimals);
                              csv.number(w.interval.upper, decimals);
                            }},
                 row[c]);
      if (interval[c] && !std::holds_alternative<WithInterval>(row[c])) csv.empty().empty();
    }
    csv.end_row();
  }
  return csv.str();
}

std::string markdown_text(std::string_view text) {
  const auto word = [&](std::size_t i) {
    return i < text.size() && (std::isalnum(static_cast<unsigned char>(text[i])) ||
                               text[i] == '_' || static_cast<unsigned char>(text[i]) >= 0x80);
  };
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    const bool first = i == 0, last = i + 1 == text.size();
    const bool mark = c == '_'
                          ? first || !word(i - 1) || !word(i + 1)  // within a word it marks nothing
                      : c == '&' ? !last && (word(i + 1) || text[i + 1] == '#')
                      : c == '#' ? first || last
                                 : std::string_view("\\`*[]<|~").find(c) != std::string_view::npos;
    if (mark) out += '\\';
    out += std::iscntrl(static_cast<unsigned char>(c)) ? ' ' : c;
  }
  return out;
}

std::string table_markdown(const Table& table) {
  std::string head = "|", rule = "|", body;
  for (std::size_t c = 0; c < table.columns.size(); ++c) {
    if (table.columns[c].title.empty()) continue;
    head += fmt::format(" {} |", table.columns[c].title);
    rule += holds_text(table, c) ? "---|" : "--:|";
  }
  for (const std::vector<Cell>& row : table.rows) {
    body += "|";
    for (std::size_t c = 0; c < table.columns.size(); ++c) {
      if (table.columns[c].title.empty()) continue;
      std::string text = readable(row[c], table.columns[c].decimals);
      if (std::holds_alternative<std::string>(row[c])) text = markdown_text(text);
      body += text.empty() ? " |" : fmt::format(" {} |", text);
    }
    body += "\n";
  }
  return head + "\n" + rule + "\n" + body;
}

std::string latex_text(std::string_view text) {
  std::string out;
  for (const char c : text) switch (c) {
      case '&':
      case '%':
      case '$':
      case '#':
      case '_':
      case '{':
      case '}':
        out += '\\';
        out += c;
        break;
      case '\\':
        out += "\\textbackslash{}";
        break;
      case '~':
        out += "\\textasciitilde{}";
        break;
      case '^':
        out += "\\textasciicircum{}";
        break;
      case '<':
        out += "$<$";
        break;
      case '>':
        out += "$>$";
        break;
      case '|':
        out += "$|$";
        break;
      default:
        out += c;
    }
  return out;
}

std::string table_latex(const Table& table) {
  std::string columns, head, body;
  for (std::size_t c = 0; c < table.columns.size(); ++c) {
    if (table.columns[c].title.empty()) continue;
    head += (columns.empty() ? "" : " & ") + latex_text(table.columns[c].title);
    columns += holds_text(table, c) ? 'l' : 'r';
  }
  for (const std::vector<Cell>& row : table.rows) {
    std::string line;
    bool first = true;
    for (std::size_t c = 0; c < table.columns.size(); ++c) {
      if (table.columns[c].title.empty()) continue;
      std::string text = latex_text(readable(row[c], table.columns[c].decimals));
      // A hyphen before a digit is a minus sign; a bracket after a line's end would be its option.
      const bool number = !std::holds_alternative<std::string>(row[c]) && !text.empty();
      if (number && text != "-") text = "$" + text + "$";
      line += (first ? "" : " & ") + text;
      first = false;
    }
    body += line + " \\\\\n";
  }
  return fmt::format(
      "% {}\n\\begin{{tabular}}{{{}}}\n\\hline\n{} \\\\\n\\hline\n{}\\hline\n\\end{{tabular}}\n",
      table.title, columns, head, body);
}

WrittenTable write_table(const Table& all, const Table& shown,
                         const std::filesystem::path& folder) {
  const std::string markdown = table_markdown(shown);
  write_atomically(folder / (shown.name + ".csv"), table_csv(all));
  write_atomically(folder / (shown.name + ".md"),
                   fmt::format("# {}\n\n{}", markdown_text(shown.title), markdown));
  write_atomically(folder / (shown.name + ".tex"), table_latex(shown));
  return {shown.name, shown.title, markdown};
}

WrittenTable write_table(const Table& table, const std::filesystem::path& folder) {
  return write_table(table, table, folder);
}

const WrittenTable* find_table(const std::vector<WrittenTable>& written, std::string_view name) {
  const auto found = std::ranges::find(written, name, &WrittenTable::name);
  return found == written.end() ? nullptr : &*found;
}

}  // namespace turntable
