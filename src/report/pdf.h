// A page printed as PDF, by Chromium without a window.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

namespace turntable {

constexpr std::chrono::seconds kPrintTimeout{60};

/// Prints one page. Chromium starts when this is made and loads when it is told to, each while the caller does
/// something else. It has a temporary folder of its own, which goes with this object, as Chromium and
/// its children do.
class PdfPrinter {
 public:
  PdfPrinter();
  ~PdfPrinter();
  PdfPrinter(const PdfPrinter&) = delete;
  PdfPrinter& operator=(const PdfPrinter&) = delete;

  /// Of `page_for_paper`, once. Whatever goes wrong, `print` tells. @throws Interrupted.
  void load(std::string_view page);
  /// Writes what was loaded as `pdf`: A4, figures as vectors.
  /// @param waiting called now and then meanwhile, for at most `kPrintTimeout`.
  /// @return nothing if it worked; else why not and what to do, in a sentence.
  /// @throws Interrupted.
  std::optional<std::string> print(const std::filesystem::path& pdf,
                                   const std::function<void()>& waiting = {});

 private:
  struct Printing;
  std::unique_ptr<Printing> printing_;
};

}  // namespace turntable
