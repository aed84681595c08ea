// JSON files that people write: parsed, checked against their schema, errors with file and place.
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace turntable {

using Json = nlohmann::json;

/// The text of a file. @throws ConfigError if it cannot be read.
std::string read_text(const std::filesystem::path& file);

/// Parses `file` and checks it against the schema named `schema` ("rig", "scenario", ...; the files
/// under scenarios/schema, built into the program). @throws ConfigError naming the file, the JSON
/// pointer or the line and column, what was found and what is allowed.
Json load_json(const std::filesystem::path& file, std::string_view schema);
/// The same for text already read; `name` stands for the file in messages.
Json parse_json(std::string_view text, const std::string& name, std::string_view schema);

/// A built-in schema, made ready once for many values.
class SchemaCheck {
 public:
  explicit SchemaCheck(std::string_view schema);
  ~SchemaCheck();
  /// @throws ConfigError as above.
  void operator()(const Json& value, const std::string& name) const;

 private:
  struct Parsed;
  std::unique_ptr<Parsed> parsed_;
};

/// Which of the project's formats a file says it is, by its "format" key ("turntable-scenario/1" ->
/// "scenario").
/// @throws ConfigError if it is none.
std::string format_of(const std::filesystem::path& file);

/// Names of the built-in schemas.
const std::vector<std::string>& schema_names();

}  // namespace turntable
