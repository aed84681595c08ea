// Lines of text with places to fill in, as a person writes them who knows a controller's manual and no
// programming: "/{axis} move abs {value}" is filled in, "@{axis} OK {state} {warning} {value}" is found
// again in an answer. No regular expressions. Upper and lower case are the same in an answer, and so is
// any number of blanks; the whole line has to fit.
//
//   {axis}    the axis' channel as the rig file names it; "1 2" is "01 2" too
//   {value}   a number: 12, -0.5, 1.2e-3
//   {values}  numbers, one for each axis, with commas, semicolons or blanks between
//   {id}      a number that the program counts up with each line it sends, and expects back
//   {any}     whatever is there, perhaps nothing
//   {text}    whatever is there, but something
//   {name}    any other name: one word of a list that the description gives for that name; it ends at a
//             blank, or where what is written after it begins
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace turntable {

class TextTemplate {
 public:
  /// What was found, or is to be filled in, by the name of its place.
  using Places = std::map<std::string, std::string, std::less<>>;

  TextTemplate() = default;
  /// @throws std::invalid_argument that says what is wrong with the text: a brace without its partner, an
  /// empty name, two places side by side.
  explicit TextTemplate(std::string_view text);

  const std::string& text() const { return text_; }
  bool empty() const { return pieces_.empty(); }
  /// Names in their order.
  std::vector<std::string> places() const;
  bool has(std::string_view place) const;
  /// Every place must be in `places`.
  std::string fill(const Places& places) const;
  /// What the places stand for in `line`; nothing if it does not fit. @param given values that must
  /// be found as they are: {axis} and {id}.
  std::optional<Places> find(std::string_view line, const Places& given) const;

 private:
  struct Piece {
    bool place = false;
    std::string text;  ///< the place's name, or the letters themselves
  };
  bool fits(std::size_t piece, std::string_view rest, const Places& given, Places& found) const;

  std::string text_;
  std::vector<Piece> pieces_;
};

/// A number in plain or exponential form, with nothing beside it; nothing if it is none or not finite.
std::optional<double> plain_number(std::string_view text);

}  // namespace turntable
