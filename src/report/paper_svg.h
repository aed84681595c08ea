// gnuplot's SVG made light for print.
#pragma once

#include <string>
#include <string_view>

namespace turntable {

/// Marks that follow one another with the same shape, size and colour as one path: a browser prints thousands
/// of them in a fraction of the time that as many references take, and they look the same. Everything
/// else is left as it is, shapes unknown here too.
std::string marks_as_paths(std::string_view svg);

}  // namespace turntable
