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
/// something else. It has a temporary folder of its own ("turntable-print-..."), which goes with this object, as
/// Chromium and its children do; after kill -9 the folder is left.
class PdfPrinter {
 public:
  /// @param timeout how long `print` waits at most
  explicit PdfPrinter(std::chrono::milliseconds timeout = kPrintTimeout);
  ~PdfPrinter();
  PdfPrinter(const PdfPrinter&) = delete;
  PdfPrinter& operator=(const PdfPrinter&) = delete;

  /// The page to be printed, of `page_for_paper`. Once. Waits a moment at most; whatever goes wrong, `print` tells.
  /// @throws Interrupted.
  void load(std::string_view page);
  /// Writes what was loaded as `pdf`: A4, figures as vectors. Where one of Chromium's programs fails, the
  /// next that is there is tried.
  /// @param waiting called now and then meanwhile.
  /// @return nothing if it worked; else why not and what to do, in a sentence.
  /// @throws Interrupted.
  std::optional<std::string> print(const std::filesystem::path& pdf,
                                   const std::function<void()>& waiting = {});

 private:
  struct Printing;
  std::unique_ptr<Printing> printing_;
};

}  // namespace turntable
