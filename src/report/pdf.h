// A page printed as PDF, by Chromium without a window.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

namespace turntable {

constexpr std::chrono::seconds kPrintTimeout{60};

/// Prints a page (`page_for_paper`) as `pdf`: A4, figures as vectors. Chromium gets a folder of its own,
/// which is gone afterwards, and is killed with its children if it takes longer than `kPrintTimeout`.
/// @param waiting called now and then meanwhile.
/// @return nothing if it worked; else why not and what to do, in a sentence.
/// @throws Interrupted.
std::optional<std::string> print_pdf(std::string_view page, const std::filesystem::path& pdf,
                                     const std::function<void()>& waiting = {});

}  // namespace turntable
