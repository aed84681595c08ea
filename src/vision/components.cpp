#include "src/vision/components.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace turntable {
namespace {

struct Run {
  int left, right;  ///< both included
  int parent;       ///< index of the component's node
};

/// Union-find over components under construction.
class Forest {
 public:
  int add(const Component& component) {
    nodes_.push_back({static_cast<int>(nodes_.size()), component});
    return nodes_.back().parent;
  }
  int root(int i) {
    while (nodes_[index(i)].parent != i) {
      nodes_[index(i)].parent = nodes_[index(nodes_[index(i)].parent)].parent;
      i = nodes_[index(i)].parent;
    }
    return i;
  }
  int join(int a, int b, bool bright) {
    a = root(a);
    b = root(b);
    if (a == b) return a;
    if (b < a) std::swap(a, b);  // the earlier one keeps its place in the order
    merge(nodes_[index(a)].component, nodes_[index(b)].component, bright);
    nodes_[index(b)].parent = a;
    return a;
  }
  static void merge(Component& into, const Component& from, bool bright) {
    into.box.left = std::min(into.box.left, from.box.left);
    into.box.right = std::max(into.box.right, from.box.right);
    into.box.top = std::min(into.box.top, from.box.top);
    into.box.bottom = std::max(into.box.bottom, from.box.bottom);
    into.area_px += from.area_px;
    into.extreme =
        bright ? std::max(into.extreme, from.extreme) : std::min(into.extreme, from.extreme);
  }
  Component& at(int i) { return nodes_[index(i)].component; }
  std::size_t size() const { return nodes_.size(); }
  std::vector<Component> roots() const {
    std::vector<Component> out;
    for (std::size_t i = 0; i < nodes_.size(); ++i)
      if (nodes_[i].parent == static_cast<int>(i)) out.push_back(nodes_[i].component);
    return out;
  }

 private:
  struct Node {
    int parent;
    Component component;
  };
  static std::size_t index(int i) { return static_cast<std::size_t>(i); }
  std::vector<Node> nodes_;
};

/// Whether any of 64 neighbouring pixels is foreground; the compiler makes vector code of it.
bool any_foreground(const std::uint8_t* p, std::uint8_t limit, bool bright) {
  std::uint8_t extreme = p[0];
  if (bright)
    for (int i = 1; i < 64; ++i) extreme = std::max(extreme, p[i]);
  else
    for (int i = 1; i < 64; ++i) extreme = std::min(extreme, p[i]);
  return bright ? extreme >= limit : extreme <= limit;
}

}  // namespace

GreyRange grey_range(ImageView image) {
  std::uint8_t low = 255, high = 0;
  for (int v = 0; v < image.height; ++v) {
    const std::uint8_t* row = image.row(v);
    for (int u = 0; u < image.width; ++u) {
      low = std::min(low, row[u]);
      high = std::max(high, row[u]);
    }
  }
  return {low, high};
}

double choose_threshold(GreyRange range, bool bright) {
  // Strong images afford a low threshold, which keeps the flanks of the spot; weak ones do not.
  const int span = range.peak_to_peak();
  const double coefficient = span >= 150 ? 0.30 : span >= 80 ? 0.40 : 0.50;
  return bright ? range.min + coefficient * span : range.max - coefficient * span;
}

std::vector<Component> find_components(ImageView image, double threshold, bool bright,
                                       std::size_t max_components) {
  // As whole greys: bright means >= limit, dark means <= limit.
  const int whole = bright ? static_cast<int>(std::floor(threshold)) + 1
                           : static_cast<int>(std::ceil(threshold)) - 1;
  if (image.empty() || whole < 0 || whole > 255) return {};
  const auto limit = static_cast<std::uint8_t>(whole);
  const auto foreground = [&](std::uint8_t g) { return bright ? g >= limit : g <= limit; };

  Forest forest;
  std::vector<Run> above, here;
  for (int v = 0; v < image.height; ++v) {
    const std::uint8_t* row = image.row(v);
    here.clear();
    std::size_t candidate = 0;  // first run above that may still touch
    for (int u = 0; u < image.width;) {
      if (u + 64 <= image.width && !any_foreground(row + u, limit, bright)) {
        u += 64;
        continue;
      }
      const int block_end = std::min(image.width, u + 64);
      while (u < block_end && !foreground(row[u])) ++u;
      if (u == block_end) continue;
      Component piece;
      piece.box = {u, v, u, v};
      piece.extreme = row[u];
      while (u < image.width && foreground(row[u])) {
        piece.extreme =
            bright ? std::max<int>(piece.extreme, row[u]) : std::min<int>(piece.extreme, row[u]);
        ++u;
      }
      piece.box.right = u - 1;
      piece.area_px = piece.box.width();

      int parent = -1;
      while (candidate < above.size() && above[candidate].right < piece.box.left - 1) ++candidate;
      for (std::size_t i = candidate; i < above.size() && above[i].left <= piece.box.right + 1;
           ++i) {
        if (parent < 0) {
          parent = forest.root(above[i].parent);
          Forest::merge(forest.at(parent), piece, bright);
        } else {
          parent = forest.join(parent, above[i].parent, bright);
        }
      }
      if (parent < 0) {
        if (forest.size() >= 4 * max_components) break;
        parent = forest.add(piece);
      }
      here.push_back({piece.box.left, piece.box.right, parent});
    }
    std::swap(above, here);
  }

  std::vector<Component> components = forest.roots();
  if (components.size() > max_components) components.resize(max_components);
  for (Component& c : components)
    c.touches_border = c.box.left == 0 || c.box.top == 0 || c.box.right == image.width - 1 ||
                       c.box.bottom == image.height - 1;
  return components;
}

}  // namespace turntable
