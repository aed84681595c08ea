// A page printed as PDF, by Chromium without a window.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

namespace turntable {

/// Prints a page (`page_for_paper`) as `pdf`: A4, figures as vectors. Chromium gets a folder of its own,
/// which is gone afterwards, and is killed with its children if it takes longer than a minute.
/// @return nothing if it worked; else why not and what to do, in a sentence.
/// @throws Interrupted.
std::optional<std::string> print_pdf(std::string_view page, const std::filesystem::path& pdf);

}  // namespace turntable
