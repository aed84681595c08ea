#include "src/vision/components.h"

#include <algorithm>
#include <cmath>

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

constexpr int kTileWidth = 64, kTileHeight = 8;

int tiles_across(int width) { return (width + kTileWidth - 1) / kTileWidth; }

/// Extreme of a part of a row; at full tile width a loop of known length, of which the compiler
/// makes vector code.
std::uint8_t extreme_of(const std::uint8_t* p, int count, bool bright) {
  std::uint8_t extreme = p[0];
  if (count == kTileWidth) {
    if (bright)
      for (int i = 1; i < kTileWidth; ++i) extreme = std::max(extreme, p[i]);
    else
      for (int i = 1; i < kTileWidth; ++i) extreme = std::min(extreme, p[i]);
  } else {
    for (int i = 1; i < count; ++i)
      extreme = bright ? std::max(extreme, p[i]) : std::min(extreme, p[i]);
  }
  return extreme;
}

}  // namespace

GreyScan scan_greys(ImageView image, bool bright) {
  const int width = image.width, across = tiles_across(width);
  GreyScan scan;
  scan.bright = bright;
  if (image.empty()) return scan;
  scan.tiles.reserve(
      static_cast<std::size_t>(across * ((image.height + kTileHeight - 1) / kTileHeight)));
  // Column by column, so that the loop over the pixels is free of everything but min and max.
  const auto columns = static_cast<std::size_t>(width);
  std::vector<std::uint8_t> high(columns), low(columns);       // of the tiles' rows
  std::vector<std::uint8_t> other(columns, bright ? 255 : 0);  // the opposite one, of the image
  std::uint8_t searched = bright ? 0 : 255;
  for (int top = 0; top < image.height; top += kTileHeight) {
    // Below the last row it counts again.
    const auto row = [&](int i) { return image.row(std::min(top + i, image.height - 1)); };
    const std::uint8_t *a = row(0), *b = row(1), *c = row(2), *d = row(3), *e = row(4), *f = row(5),
                       *g = row(6), *h = row(7);
    std::uint8_t *hi = high.data(), *lo = low.data();
    for (int u = 0; u < width; ++u) {
      hi[u] = std::max(std::max(std::max(a[u], b[u]), std::max(c[u], d[u])),
                       std::max(std::max(e[u], f[u]), std::max(g[u], h[u])));
      lo[u] = std::min(std::min(std::min(a[u], b[u]), std::min(c[u], d[u])),
                       std::min(std::min(e[u], f[u]), std::min(g[u], h[u])));
    }
    const std::uint8_t* wanted = bright ? hi : lo;
    std::uint8_t* rest = other.data();
    if (bright)
      for (int u = 0; u < width; ++u) rest[u] = std::min(rest[u], lo[u]);
    else
      for (int u = 0; u < width; ++u) rest[u] = std::max(rest[u], hi[u]);
    for (int left = 0; left < width; left += kTileWidth) {
      scan.tiles.push_back(extreme_of(wanted + left, std::min(kTileWidth, width - left), bright));
      searched =
          bright ? std::max(searched, scan.tiles.back()) : std::min(searched, scan.tiles.back());
    }
  }
  const std::uint8_t opposite = extreme_of(other.data(), width, !bright);
  scan.range = bright ? GreyRange{opposite, searched} : GreyRange{searched, opposite};
  return scan;
}

GreyRange grey_range(ImageView image) { return scan_greys(image, true).range; }

double choose_threshold(GreyRange range, bool bright) {
  // Strong images afford a low threshold, which keeps the flanks of the spot; weak ones do not.
  const int span = range.peak_to_peak();
  const double coefficient = span >= 150 ? 0.30 : span >= 80 ? 0.40 : 0.50;
  return bright ? range.min + coefficient * span : range.max - coefficient * span;
}

std::vector<Component> find_components(ImageView image, const GreyScan& scan, double threshold,
                                       std::size_t max_components) {
  const bool bright = scan.bright;
  // As whole greys: bright means >= limit, dark means <= limit.
  const int whole = bright ? static_cast<int>(std::floor(threshold)) + 1
                           : static_cast<int>(std::ceil(threshold)) - 1;
  if (image.empty() || whole < 0 || whole > 255) return {};
  const auto limit = static_cast<std::uint8_t>(whole);
  const auto foreground = [&](std::uint8_t g) { return bright ? g >= limit : g <= limit; };

  Forest forest;
  std::vector<Run> above, here;
  std::vector<int> open;  // first columns of the tiles that hold foreground
  bool full = false;
  for (int v = 0; v < image.height && !full; ++v) {
    if (v % kTileHeight == 0) {
      open.clear();
      const int across = tiles_across(image.width), first = v / kTileHeight * across;
      for (int t = 0; t < across; ++t)
        if (foreground(scan.tiles[static_cast<std::size_t>(first + t)]))
          open.push_back(t * kTileWidth);
      if (open.empty()) {
        above.clear();
        v += kTileHeight - 1;
        continue;
      }
    }
    const std::uint8_t* row = image.row(v);
    here.clear();
    std::size_t candidate = 0;  // first run above that may still touch
    int u = 0;
    for (const int left : open) {
      const int end = std::min(image.width, left + kTileWidth);
      if (u < left && !foreground(extreme_of(row + left, end - left, bright))) continue;
      u = std::max(u, left);
      while (!full) {
        while (u < end && !foreground(row[u])) ++u;
        if (u >= end) break;  // a run may have gone on into the next tile
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
          // Pieces that join later count apart, hence the factor.
          full = forest.size() >= 4 * max_components;
          if (full) break;
          parent = forest.add(piece);
        }
        here.push_back({piece.box.left, piece.box.right, parent});
      }
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

std::vector<Component> find_components(ImageView image, double threshold, bool bright,
                                       std::size_t max_components) {
  return find_components(image, scan_greys(image, bright), threshold, max_components);
}

}  // namespace turntable
