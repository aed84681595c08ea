#include "src/report/html_report.h"

#include <fmt/format.h>
#include <md4c-html.h>
#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <functional>
#include <nlohmann/json.hpp>

#include "report_assets.h"
#include "src/record/atomic_file.h"
#include "src/report/paper_svg.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

std::string_view asset(std::string_view name) {
  for (const auto& [stem, text] : embedded::report_assets())
    if (stem == name) return text;
  throw std::logic_error(fmt::format("{} is not built in", name));
}

/// "[0.23, 0.57]" is not broken into lines.
void keep_intervals_whole(std::string& html) {
  for (std::size_t at = 0; (at = html.find('[', at)) != std::string::npos; ++at) {
    const std::size_t end = html.find_first_not_of("+-.0123456789, ", at + 1);
    const std::size_t blank = html.find(", ", at);
    if (end != std::string::npos && html[end] == ']' && blank < end)
      html.replace(blank + 1, 1, "&#160;");
  }
}

void replace_every(std::string& text, std::string_view from, std::string_view to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
    text.replace(at, from.size(), to);
}

/// The text of a piece of HTML, without its tags.
std::string without_tags(std::string_view html) {
  std::string text;
  bool tag = false;
  for (const char c : html) {
    if (c == '<') tag = true;
    if (!tag) text += c;
    if (c == '>') tag = false;
  }
  return text;
}

/// "Errors against the turntable" -> "errors-against-the-turntable"; of a long text its first words: a
/// name in a PDF has 127 bytes at most.
std::string slug(std::string_view text) {
  std::string out;
  for (const char c : text) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
    if (plain)
      out += c;
    else if (c >= 'A' && c <= 'Z')
      out += static_cast<char>(c - 'A' + 'a');
    else if (!out.empty() && out.back() != '-')
      out += '-';
  }
  constexpr std::size_t kLongest = 80;
  if (out.size() > kLongest) {
    const std::size_t word = out.rfind('-', kLongest);
    out.resize(word == std::string::npos ? kLongest : word);
  }
  while (!out.empty() && out.back() == '-') out.pop_back();
  return out;
}

/// A heading of the page and where it stands in its HTML.
struct Heading {
  char level;  ///< '1' to '6'
  std::string id, text;
  std::size_t at;
};

/// Headings that `markdown_to_html` gave ids.
std::vector<Heading> headings_of(std::string_view body) {
  std::vector<Heading> headings;
  constexpr std::string_view kId = " id=\"";
  for (std::size_t at = 0; (at = body.find("<h", at)) != std::string_view::npos; ++at) {
    if (at + 3 >= body.size() || body.substr(at + 3, kId.size()) != kId) continue;
    const std::size_t id = at + 3 + kId.size(), quote = body.find('"', id);
    const std::size_t text = quote + 2, end = body.find("</h", text);
    headings.push_back({body[at + 2], std::string(body.substr(id, quote - id)),
                        without_tags(body.substr(text, end - text)), at});
  }
  return headings;
}

/// Sections and subsections as nested lists.
std::string contents(const std::vector<Heading>& headings) {
  std::string html = "<nav id=\"page-contents\" aria-label=\"Contents\"><h2>Contents</h2>\n<ul>\n";
  bool item = false, inner = false;
  for (const Heading& h : headings) {
    if (h.level != '2' && h.level != '3') continue;
    if (h.level == '3' && item && !inner) {
      html += "\n<ul>\n";
      inner = true;
    } else if (h.level == '2' && inner) {
      html += "</li>\n</ul></li>\n";
      inner = false;
    } else if (item) {
      html += "</li>\n";
    }
    html += fmt::format("<li><a href=\"#{}\">{}</a>", h.id, h.text);
    item = true;
  }
  if (inner) html += "</li>\n</ul>";
  return html + (item ? "</li>\n" : "") + "</ul>\n</nav>\n";
}

/// "rgb(  0, 114, 178)" -> "#0072b2", wherever it stands in a tag.
void shorten_colours(std::string& tag) {
  for (std::size_t at = 0; (at = tag.find("rgb(", at)) != std::string::npos;) {
    const std::size_t close = tag.find(')', at);
    std::array<int, 3> rgb{};
    const char* p = tag.data() + at + 4;
    const char* const end = tag.data() + close;
    for (int& part : rgb) {
      while (p < end && (*p == ' ' || *p == ',')) ++p;
      p = std::from_chars(p, end, part).ptr;
    }
    tag.replace(at, close - at + 1, fmt::format("#{:02x}{:02x}{:02x}", rgb[0], rgb[1], rgb[2]));
  }
}

/// The value of an attribute, in whichever quotes; empty if it is not there.
std::string_view attribute(std::string_view tag, std::string_view name) {
  for (std::size_t at = 0; (at = tag.find(name, at)) != std::string_view::npos; ++at) {
    const std::size_t equals = at + name.size();
    if (at == 0 || tag[at - 1] != ' ' || equals + 1 >= tag.size() || tag[equals] != '=') continue;
    const char quote = tag[equals + 1];
    return tag.substr(equals + 2, tag.find(quote, equals + 2) - equals - 2);
  }
  return {};
}

/// Reads gnuplot's SVG tag by tag and writes what a page needs of it.
class SvgInliner {
 public:
  SvgInliner(std::string_view svg, const Figure& figure, std::string prefix)
      : svg_(svg), figure_(figure), prefix_(std::move(prefix)) {
    out_.reserve(svg.size());
  }

  std::string result() {
    std::size_t at = svg_.find("<svg");
    while (at < svg_.size()) {
      const std::size_t open = svg_.find('<', at);
      text(svg_.substr(at, open - at));
      if (open == std::string_view::npos) break;
      const std::size_t close = svg_.find('>', open);
      if (close == std::string_view::npos) break;
      at = close + 1;
      const std::string_view tag = svg_.substr(open, at - open);
      // Names of the parts, which a pointer would show, and gnuplot's own.
      if (tag == "<title>" || tag == "<desc>") {
        at = svg_.find("</", at);
        at = svg_.find('>', at) + 1;
        continue;
      }
      element(tag);
    }
    if (!figure_.elements.empty() && element_ != figure_.elements.size()) linked_ = false;
    if (!linked_) out_.insert(4, " class=\"unlinked\"");  // behind "<svg"
    return out_;
  }

 private:
  struct Group {
    std::size_t begin, content;  ///< where it and what it holds begin in `out_`
    bool element = false;        ///< of a plot command
  };

  void text(std::string_view text) {
    // Between two elements there is only white space, of which one line end is kept.
    if (text.find_first_not_of(" \t\n") != std::string_view::npos)
      out_ += text;
    else if (!text.empty() && !out_.empty() && out_.back() != '\n')
      out_ += '\n';
  }

  void element(std::string_view tag) {
    if (tag.starts_with("<svg")) {
      out_ += fmt::format("<svg role=\"img\" aria-labelledby=\"caption-{}\" viewBox=\"{}\">",
                          figure_.name, attribute(squeeze(tag), "viewBox"));
    } else if (tag == "</g>") {
      end_group();
    } else if (tag.starts_with("<g")) {
      begin_group(tag);
    } else {
      if (tag.starts_with("<use")) ++uses_;
      if (tag.starts_with("<text")) names_ = true;
      out_ += rewritten(tag);
    }
  }

  void begin_group(std::string_view tag) {
    groups_.push_back({out_.size(), 0});
    const std::string_view id = attribute(tag, "id");
    if (!id.starts_with("gnuplot_plot_")) {
      out_ += id.empty() ? rewritten(tag) : "<g>";
      groups_.back().content = out_.size();
      return;
    }
    uses_ = 0;
    names_ = false;
    out_ += "<g class=\"plot\">";
    groups_.back().content = out_.size();
    groups_.back().element = true;
  }

  void end_group() {
    if (groups_.empty()) return;
    const Group group = groups_.back();
    groups_.pop_back();
    if (group.element) end_element(group);
    if (!group.element && out_.find_first_not_of(" \t\n", group.content) == std::string::npos)
      out_.resize(group.begin);  // gnuplot begins many groups and draws nothing in them
    else
      out_ += "</g>";
  }

  /// Now that its points are counted. gnuplot draws an element's points in the order of the rows, and
  /// behind them the key's: one, or three in colours of a palette.
  void end_element(const Group& group) {
    const std::size_t place = element_++;
    if (place >= figure_.elements.size()) return;
    const Element& shows = figure_.elements[place];
    std::string attributes;
    if (!shows.solver.empty()) attributes += fmt::format(" data-solver=\"{}\"", shows.solver);
    if (!shows.poses.empty()) {
      const std::size_t points = shows.poses.size();
      if (names_ ? uses_ == points + 1 || uses_ == points + 3 : uses_ == points) {
        attributes += " data-poses=\"";
        for (const std::size_t pose : shows.poses) attributes += fmt::format("{} ", pose);
        attributes.back() = '"';
      } else {
        linked_ = false;
      }
    }
    out_.insert(group.content - 1, attributes);
  }

  /// With ids of this figure, short colours, and HTML's way to refer.
  std::string rewritten(std::string_view tag) const {
    std::string out = squeeze(tag);
    shorten_colours(out);
    replace_every(out, "xlink:href", "href");
    for (const std::string before : {" id='", " id=\"", "href='#", "href=\"#", "url(#"})
      replace_every(out, before, before + prefix_);
    replace_every(out, "\"sans\"", "\"sans-serif\"");
    return out;
  }

  /// One blank where there are several, and none about "=".
  static std::string squeeze(std::string_view tag) {
    std::string out;
    for (const char c : tag) {
      const bool blank = c == ' ' || c == '\n' || c == '\t';
      if (blank && (out.ends_with(' ') || out.ends_with('='))) continue;
      if (c == '=' && out.ends_with(' ')) out.pop_back();
      out += blank ? ' ' : c;
    }
    return out;
  }

  std::string_view svg_;
  const Figure& figure_;
  std::string prefix_, out_;
  std::vector<Group> groups_;
  std::size_t element_ = 0, uses_ = 0;
  bool names_ = false;  ///< the element has its name in the key
  bool linked_ = true;
};

/// The class of pictures that are nearly as high as wide: many panels, which half a page makes too small.
std::string_view tall_class(std::string_view svg) {
  double left = 0, top = 0, width = 1, height = 0;
  const std::size_t begin = std::min(svg.find("<svg"), svg.size());
  const std::string box(attribute(svg.substr(begin, svg.find('>', begin) - begin), "viewBox"));
  std::sscanf(box.c_str(), "%lf %lf %lf %lf", &left, &top, &width, &height);
  return height > 0.85 * width ? " class=\"tall\"" : "";
}

/// A figure as Markdown has it: an image and its caption, each a paragraph.
struct PlainFigure {
  std::string file;              ///< "figures/<name>.svg"
  std::string_view alternative;  ///< "<text>"
  std::string_view caption;      ///< HTML
};

/// Replaces every figure of a body by what `drawn` makes of it; nothing = it stays.
void replace_figures(std::string& body,
                     const std::function<std::string(const PlainFigure&)>& drawn) {
  constexpr std::string_view kImage = "<p><img src=\"", kAlternative = "\" alt=\"",
                             kBetween = "\"></p>\n<p>", kEnd = "</p>";
  const std::string_view plain = body;
  std::string out;
  std::size_t done = 0;
  for (std::size_t at = 0; (at = plain.find(kImage, at)) != std::string_view::npos;) {
    const std::size_t begin = at;
    const auto next = [&](std::string_view end) {
      const std::size_t from = at, to = plain.find(end, from);
      at = to == std::string_view::npos ? plain.size() : to + end.size();
      return plain.substr(from, to - from);
    };
    at += kImage.size();
    PlainFigure figure;
    figure.file = next(kAlternative);
    figure.alternative = next(kBetween);
    figure.caption = next(kEnd);
    if (figure.alternative.find('"') !=
        std::string_view::npos) {  // of a later image: this has no caption
      at = begin + kImage.size();
      continue;
    }
    const std::string html = drawn(figure);
    if (html.empty()) continue;
    out.append(plain, done, begin - done).append(html);
    done = at;
  }
  out.append(plain, done);
  body = std::move(out);
}

/// The whole page. The first screen: all up to the sections, and what is in a report at a glance;
/// contents follow it.
std::string document(std::string body, std::string_view behind) {
  const std::vector<Heading> headings = headings_of(body);
  std::size_t first = body.size();
  for (const Heading& h : headings)
    if (h.level == '2' && h.id != "at-a-glance") {
      first = h.at;
      break;
    }
  const std::string_view all = body;
  return fmt::format(
      "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<title>{}</title>\n<style>\n{}</style>\n</head>\n<body>\n<header>\n{}</header>\n{}<main>\n"
      "{}</main>\n{}</body>\n</html>\n",
      headings.empty() ? "Report" : headings.front().text, asset("report.css"),
      all.substr(0, first), contents(headings), all.substr(first), behind);
}

}  // namespace

std::string inline_svg(std::string_view svg, const Figure& figure, const std::string& prefix) {
  return SvgInliner(svg, figure, prefix).result();
}

std::string data_uri(std::string_view type, std::string_view bytes) {
  std::string base64((bytes.size() + 2) / 3 * 4 + 1, '\0');
  const int size = EVP_EncodeBlock(reinterpret_cast<unsigned char*>(base64.data()),
                                   reinterpret_cast<const unsigned char*>(bytes.data()),
                                   static_cast<int>(bytes.size()));
  base64.resize(static_cast<std::size_t>(size));
  return fmt::format("data:{};base64,{}", type, base64);
}

std::string markdown_to_html(std::string_view markdown) {
  std::string html;
  const auto append = [](const MD_CHAR* text, MD_SIZE size, void* out) {
    static_cast<std::string*>(out)->append(text, size);
  };
  constexpr unsigned kNoAutolinks = MD_FLAG_TABLES | MD_FLAG_STRIKETHROUGH | MD_FLAG_NOHTML;
  if (md_html(markdown.data(), static_cast<MD_SIZE>(markdown.size()), append, &html, kNoAutolinks,
              0) != 0)
    throw std::bad_alloc();  // it fails of nothing else
  replace_every(html, "<p>&lt;details&gt;&lt;summary&gt;", "<details><summary>");
  replace_every(html, "&lt;/summary&gt;</p>", "</summary>");
  replace_every(html, "<p>&lt;/details&gt;</p>", "</details>");
  replace_every(html, "<table>", "<div class=\"scroll\"><table>");
  replace_every(html, "</table>", "</table></div>");
  keep_intervals_whole(html);
  replace_every(html, "<th", "<th scope=\"col\"");
  replace_every(html, "<th scope=\"col\"ead", "<thead");
  // Ids for the headings, told apart by a number where two have the same text.
  std::map<std::string, int> seen;
  for (std::size_t at = 0; (at = html.find("<h", at)) != std::string::npos; ++at) {
    if (at + 3 >= html.size() || html[at + 2] < '1' || html[at + 2] > '6' || html[at + 3] != '>')
      continue;
    const std::size_t end = html.find("</h", at);
    std::string id = slug(without_tags(std::string_view(html).substr(at + 4, end - at - 4)));
    if (id.empty()) id = "section";
    if (const int number = ++seen[id]; number > 1) id += fmt::format("-{}", number);
    html.insert(at + 3, fmt::format(" id=\"{}\"", id));
  }
  return html;
}

fs::path write_html(const fs::path& markdown, const std::vector<Figure>& figures,
                    const Json* poses) {
  std::string body = markdown_to_html(read_text(markdown));
  replace_figures(body, [&](const PlainFigure& plain) -> std::string {
    for (std::size_t i = 0; i < figures.size(); ++i) {
      if (!figures[i].drawn || plain.file != fmt::format("figures/{}.svg", figures[i].name))
        continue;
      const std::string svg = read_text(markdown.parent_path() / plain.file);
      return fmt::format(
          "<figure id=\"figure-{0}\"{1}>\n<div class=\"view\">{2}</div>\n<figcaption "
          "id=\"caption-{0}\">{3}</figcaption>\n</figure>",
          figures[i].name, tall_class(svg), inline_svg(svg, figures[i], fmt::format("f{}-", i)),
          plain.caption);
    }
    return {};
  });
  std::string data;
  if (poses != nullptr) {
    data = poses->dump(-1, ' ', false, Json::error_handler_t::replace);
    replace_every(data, "</", "<\\/");
    data = "<script type=\"application/json\" id=\"page-data\">" + data + "</script>\n";
  }
  fs::path file = markdown;
  file.replace_extension(".html");
  write_atomically(file, document(std::move(body), fmt::format("{}<script>\n{}</script>\n", data,
                                                               asset("report.js"))));
  return file;
}

std::string page_for_paper(const fs::path& markdown) {
  std::string body = markdown_to_html(read_text(markdown));
  replace_every(body, "<details>", "<details open>");
  // Links to files beside the report would name where it lay when it was printed.
  constexpr std::string_view kLink = "<a href=\"";
  for (std::size_t at = 0; (at = body.find(kLink, at)) != std::string::npos; at += 2) {
    const std::string_view target = std::string_view(body).substr(at + kLink.size());
    if (!target.starts_with("#") && !target.starts_with("http"))
      body.erase(at + 2, target.find('"') + kLink.size() - 1);
  }
  replace_figures(body, [&](const PlainFigure& figure) {
    const std::string svg = read_text(markdown.parent_path() / figure.file);
    return fmt::format(
        "<figure{}>\n<img src=\"{}\" alt=\"{}\">\n<figcaption>{}</figcaption>\n</figure>",
        tall_class(svg), data_uri("image/svg+xml", marks_as_paths(svg)), figure.alternative,
        figure.caption);
  });
  return document(std::move(body), "");
}

}  // namespace turntable
