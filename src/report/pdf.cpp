#include "src/report/pdf.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

#include "src/core/errors.h"
#include "src/record/atomic_file.h"
#include "src/record/folder.h"
#include "src/report/chromium.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using std::chrono::steady_clock;

/// Chromium's names, the one that begins fastest first.
constexpr const char* kPrograms[] = {"chromium-headless-shell", "chromium", "chromium-browser",
                                     "google-chrome"};

constexpr const char* kByHand = "print the page beside it from any browser.";

bool is_whole_pdf(std::string_view bytes) {
  return bytes.starts_with("%PDF-") &&
         bytes.substr(bytes.size() - std::min<std::size_t>(bytes.size(), 32)).find("%%EOF") !=
             std::string_view::npos;
}

}  // namespace

struct PdfPrinter::Printing {
  std::chrono::milliseconds timeout;
  std::optional<Scratch> place;
  std::optional<std::string> no_place;  ///< why there is none
  std::optional<Chromium> chromium;     ///< goes before its place does
  std::size_t next = 0;                 ///< of the programs
  std::string tried;                    ///< what became of those before

  fs::path page() const { return place->path() / "report.html"; }
  /// Made now.
  fs::path folder_of(const char* program) const {
    const fs::path folder = place->path() / program;
    std::error_code ignored;  // the program will say that it is not there
    fs::create_directory(folder, ignored);
    return folder;
  }
  /// The next program that is there, if any.
  void start() {
    for (chromium.reset(); !chromium && next < std::size(kPrograms); ++next) {
      try {
        chromium.emplace(kPrograms[next], folder_of(kPrograms[next]));
        if (!chromium->started()) chromium.reset();
      } catch (const ChromiumTrouble& e) {
        note(kPrograms[next], e);
      }
    }
  }
  void note(const char* program, const ChromiumTrouble& trouble) {
    tried += fmt::format("{}{} {}", tried.empty() ? "" : "; ", program, trouble.what());
  }
  void give_up(const ChromiumTrouble& trouble) {
    note(kPrograms[next - 1], trouble);
    start();
  }
};

PdfPrinter::PdfPrinter(std::chrono::milliseconds timeout)
    : printing_(std::make_unique<Printing>()) {
  printing_->timeout = timeout;
  try {
    printing_->place.emplace("turntable-print");
    printing_->start();
  } catch (const RecordError& e) {
    printing_->no_place = e.what();
  }
}

PdfPrinter::~PdfPrinter() = default;

void PdfPrinter::load(std::string_view page) {
  constexpr std::chrono::milliseconds kMoment{500};  // it has been up for long
  Printing& p = *printing_;
  if (p.no_place) return;
  try {
    write_atomically(p.page(), page);
    if (p.chromium) p.chromium->load(p.page(), {steady_clock::now() + kMoment, {}});
  } catch (const RecordError& e) {
    p.no_place = e.what();
  } catch (const ChromiumLate&) {  // `print` has more patience
  } catch (const ChromiumTrouble& e) {
    p.give_up(e);
  }
}

std::optional<std::string> PdfPrinter::print(const fs::path& pdf,
                                             const std::function<void()>& waiting) {
  Printing& p = *printing_;
  if (p.no_place) return fmt::format("{} was not printed: {}", pdf.string(), *p.no_place);
  const Patience patience{steady_clock::now() + p.timeout, waiting};
  while (p.chromium) {
    try {
      if (!p.chromium->loading()) p.chromium->load(p.page(), patience);
      const std::string bytes = p.chromium->pdf(patience);
      if (!is_whole_pdf(bytes)) throw ChromiumTrouble("sent a PDF without an end");
      write_atomically(pdf, bytes);
      return {};
    } catch (const ChromiumLate& e) {
      p.note(kPrograms[p.next - 1], e);
      break;
    } catch (const ChromiumTrouble& e) {
      p.give_up(e);
    } catch (const RecordError& e) {
      return fmt::format("{} was not printed: {}", pdf.string(), e.what());
    }
  }
  if (!p.tried.empty())
    return fmt::format("{} was not printed: {}. Instead, {}", pdf.string(), p.tried, kByHand);
  return fmt::format(
      "{} was not printed: Chromium is not there, which would. Install it (Debian: "
      "chromium-headless-shell), or {}",
      pdf.string(), kByHand);
}

}  // namespace turntable
