#include "drivers/text_template.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <stdexcept>

#include "protocols/ascii_dialog.h"

namespace turntable {
namespace {

bool decimal_digit(char c) { return c >= '0' && c <= '9'; }

/// Blanks at the ends gone, others single.
std::string single_blanks(std::string_view text) {
  std::string s;
  for (const char c : text) {
    const bool blank = c == ' ' || c == '\t';
    if (blank && (s.empty() || s.back() == ' ')) continue;
    s += blank ? ' ' : c;
  }
  if (s.ends_with(' ')) s.pop_back();
  return s;
}

std::size_t number_length(std::string_view text) {
  const std::size_t sign = !text.empty() && text[0] == '+' ? 1 : 0;
  if (text.substr(sign).starts_with('-') && sign == 1) return 0;
  double value = 0;
  const auto [end, error] = std::from_chars(text.data() + sign, text.data() + text.size(), value);
  if (error != std::errc() || !std::isfinite(value)) return 0;
  return static_cast<std::size_t>(end - text.data());
}

/// How much of `rest` is `wanted`, in which leading zeros of a number do not count; nothing if it is
/// not there.
std::optional<std::size_t> length_of(std::string_view wanted, std::string_view rest) {
  std::size_t at = 0;
  const auto digits = [](std::string_view text) {
    std::size_t n = 0;
    while (n < text.size() && decimal_digit(text[n])) ++n;
    return n;
  };
  const auto without_zeros = [](std::string_view number) {
    return number.substr(std::min(number.find_first_not_of('0'), number.size() - 1));
  };
  for (std::size_t i = 0; i < wanted.size();) {
    if (at >= rest.size()) return std::nullopt;
    if (decimal_digit(wanted[i])) {
      const std::size_t n = digits(wanted.substr(i)), m = digits(rest.substr(at));
      if (m == 0 || without_zeros(wanted.substr(i, n)) != without_zeros(rest.substr(at, m)))
        return std::nullopt;
      i += n;
      at += m;
    } else {
      if (upper(wanted.substr(i, 1)) != upper(rest.substr(at, 1))) return std::nullopt;
      ++i;
      ++at;
    }
  }
  return at;
}

}  // namespace

std::optional<double> plain_number(std::string_view text) {
  const std::size_t n = number_length(text);
  if (n == 0 || n != text.size()) return std::nullopt;
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0;
  std::from_chars(text.data(), text.data() + text.size(), value);
  return value;
}

TextTemplate::TextTemplate(std::string_view text) : text_(text) {
  const std::string plain = single_blanks(text);
  for (std::size_t at = 0; at < plain.size();) {
    const std::size_t open = plain.find_first_of("{}", at);
    if (open > at) pieces_.push_back({false, plain.substr(at, std::min(open, plain.size()) - at)});
    if (open == std::string::npos) break;
    const std::size_t close = plain.find_first_of("{}", open + 1);
    if (plain[open] == '}' || close == std::string::npos || plain[close] == '{')
      throw std::invalid_argument("a brace has no partner: places are written {axis}");
    const std::string name = plain.substr(open + 1, close - open - 1);
    if (name.empty()) throw std::invalid_argument("a place has no name: {}");
    if (!pieces_.empty() && pieces_.back().place)
      throw std::invalid_argument(
          "two places stand side by side, so that nobody could tell where the second one begins");
    pieces_.push_back({true, name});
    at = close + 1;
  }
}

std::vector<std::string> TextTemplate::places() const {
  std::vector<std::string> names;
  for (const Piece& piece : pieces_)
    if (piece.place) names.push_back(piece.text);
  return names;
}

bool TextTemplate::has(std::string_view place) const {
  return std::ranges::any_of(pieces_, [&](const Piece& p) { return p.place && p.text == place; });
}

std::string TextTemplate::fill(const Places& places) const {
  std::string line;
  for (const Piece& piece : pieces_) line += piece.place ? places.at(piece.text) : piece.text;
  return line;
}

std::optional<TextTemplate::Places> TextTemplate::find(std::string_view line,
                                                       const Places& given) const {
  Places found;
  if (!fits(0, single_blanks(line), given, found)) return std::nullopt;
  return found;
}

bool TextTemplate::fits(std::size_t index, std::string_view rest, const Places& given,
                        Places& found) const {
  if (index == pieces_.size()) return rest.empty();
  const Piece& piece = pieces_[index];
  const auto goes_on = [&](std::size_t length) {
    if (!fits(index + 1, rest.substr(length), given, found)) return false;
    if (piece.place) found[piece.text] = std::string(rest.substr(0, length));
    return true;
  };
  if (!piece.place) {
    if (rest.size() >= piece.text.size())
      return upper(rest.substr(0, piece.text.size())) == upper(piece.text) &&
             goes_on(piece.text.size());
    // A blank before something that is not there.
    return rest.size() + 1 == piece.text.size() && piece.text.ends_with(' ') &&
           upper(rest) == upper(piece.text.substr(0, rest.size())) && goes_on(rest.size());
  }
  if (piece.text == "axis" || piece.text == "id") {
    const auto length = length_of(given.at(piece.text), rest);
    return length && goes_on(*length);
  }
  if (piece.text == "value") {
    const std::size_t length = number_length(rest);
    return length > 0 && goes_on(length);
  }
  if (piece.text == "values") {
    const std::size_t length = std::min(rest.find_first_not_of("0123456789+-.eE,; "), rest.size());
    for (std::size_t n = length; n > 0; --n)
      if (goes_on(n)) return true;
    return false;
  }
  if (piece.text == "any" || piece.text == "text") {
    for (std::size_t n = piece.text == "any" ? 0 : 1; n <= rest.size(); ++n)
      if (goes_on(n)) return true;
    return false;
  }
  // A word ends at a blank, or where the letters after it begin: there is one way to read it.
  std::size_t word = std::min(rest.find(' '), rest.size());
  if (index + 1 < pieces_.size())
    for (std::size_t n = 1; n < word; ++n)
      if (upper(rest.substr(n, 1)) == upper(pieces_[index + 1].text.substr(0, 1))) word = n;
  return word > 0 && goes_on(word);
}

}  // namespace turntable
