#include "src/report/paper_svg.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <optional>
#include <string>

namespace turntable {
namespace {

constexpr std::string_view kUse = "<use xlink:href='#gpPt", kTranslate = "' transform='translate(",
                           kScale = ") scale(", kColour = ")' color='", kEnd = "'/>";

/// "<use xlink:href='#gpPt6' transform='translate(1,2) scale(3)' color='rgb(0, 0, 0)'/>"
struct Mark {
  std::string_view shape, place, scale, colour;

  bool looks_like(const Mark& other) const {
    return shape == other.shape && scale == other.scale && colour == other.colour;
  }
};

/// Takes `text` up to `end`, and `end`, off the front.
bool take(std::string_view& line, std::string_view end, std::string_view& text) {
  const std::size_t at = line.find(end);
  if (at == std::string_view::npos) return false;
  text = line.substr(0, at);
  line.remove_prefix(at + end.size());
  return true;
}

std::optional<Mark> mark_of(std::string_view line) {
  line.remove_prefix(std::min(line.find_first_not_of(" \t"), line.size()));
  if (!line.starts_with(kUse)) return {};
  line.remove_prefix(kUse.size());
  Mark mark;
  if (take(line, kTranslate, mark.shape) && take(line, kScale, mark.place) &&
      take(line, kColour, mark.scale) && take(line, kEnd, mark.colour) && line.empty())
    return mark;
  return {};
}

double number(std::string_view text) {
  double value = 0;
  std::from_chars(text.data(), text.data() + text.size(), value);
  return value;
}

/// gnuplot's shapes in its order, each as a path relative to the mark's place: {0} is half its width, {1} the
/// width, {2} and {3} a triangle's and a diamond's reach. A disc is the round end of a line without length, which is
/// printed faster than arcs.
struct Shape {
  enum Drawn { kOpen, kFilled, kDot };
  std::string_view name, path;
  Drawn drawn;
};
constexpr std::string_view kSquare = "m-{0} -{0}h{1}v{1}h-{1}z",
                           kCircle = "m-{0} 0a{0} {0} 0 1 0 {1} 0a{0} {0} 0 1 0 -{1} 0z",
                           kUp = "m0 -{2}l-{2} {1}h{2}h{2}z", kDown = "m0 {2}l{2} -{1}h-{2}h-{2}z",
                           kDiamond = "m0 -{3}l{3} {3}l-{3} {3}l-{3} -{3}z";
constexpr Shape kShapes[] = {
    {"0", "m-{0} 0h{1}m-{0} -{0}v{1}", Shape::kOpen},
    {"1", "m-{0} -{0}l{1} {1}m0 -{1}l-{1} {1}", Shape::kOpen},
    {"3", kSquare, Shape::kOpen},
    {"4", kSquare, Shape::kFilled},
    {"5", kCircle, Shape::kOpen},
    {"6", "h0", Shape::kDot},
    {"7", kUp, Shape::kOpen},
    {"8", kUp, Shape::kFilled},
    {"9", kDown, Shape::kOpen},
    {"10", kDown, Shape::kFilled},
    {"11", kDiamond, Shape::kOpen},
    {"12", kDiamond, Shape::kFilled},
};

const Shape* find_shape(std::string_view name) {
  for (const Shape& shape : kShapes)
    if (shape.name == name) return &shape;
  return nullptr;
}

/// Width of the lines of marks, where a mark's half width is 1.
double line_width(std::string_view svg) {
  constexpr std::string_view kWidth = "id='gpPt0' stroke-width='";
  const std::size_t at = svg.find(kWidth);
  return at == std::string_view::npos ? 0.2 : number(svg.substr(at + kWidth.size(), 8));
}

}  // namespace

std::string marks_as_paths(std::string_view svg) {
  const double width = line_width(svg);
  std::string out;
  out.reserve(svg.size());
  std::optional<Mark> open;  // of the path that is being written
  std::string outline;       // its marks' shape
  const Shape* shape = nullptr;
  const auto close = [&] {
    if (!open) return;
    const double half = number(open->scale);
    if (shape->drawn == Shape::kDot)
      out += fmt::format("' stroke='{}' stroke-width='{:.2f}' stroke-linecap='round'/>\n",
                         open->colour, (2 + width) * half);
    else
      out += fmt::format("' stroke='{0}' stroke-width='{1:.3f}' fill='{2}'/>\n", open->colour,
                         width * half, shape->drawn == Shape::kFilled ? open->colour : "none");
    open.reset();
  };
  while (!svg.empty()) {
    const std::size_t end = std::min(svg.find('\n'), svg.size() - 1);
    const std::string_view line = svg.substr(0, end);
    const std::optional<Mark> mark = mark_of(line);
    if (mark && open && mark->looks_like(*open)) {
      out += fmt::format("M{}{}", mark->place, outline);
    } else {
      close();
      shape = mark ? find_shape(mark->shape) : nullptr;
      if (shape != nullptr) {
        open = mark;
        const auto length = [&](double units) {
          return fmt::format("{:.2f}", units * number(mark->scale));
        };
        outline = fmt::format(fmt::runtime(shape->path), length(1), length(2), length(1.33),
                              length(1.414));
        out += fmt::format("<path d='M{}{}", mark->place, outline);
      } else {
        out += svg.substr(0, end + 1);
      }
    }
    svg.remove_prefix(end + 1);
  }
  close();
  return out;
}

}  // namespace turntable
