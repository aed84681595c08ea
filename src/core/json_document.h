// JSON files that people write: parsed, checked against their schema, errors with file and place.
#pragma once

#include <filesystem>
#include <functional>
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
/// The same for a text with one long list of objects, the array `list` at its top: each is checked by
/// the schema of its items, handed to `visit` with its place, and forgotten, so that memory does not
/// grow with the list. The result has the first one only.
Json parse_json(std::string_view text, const std::string& name, std::string_view schema,
                std::string_view list,
                const std::function<void(const Json& item, std::size_t place)>& visit);

/// A built-in schema, made ready once for many values.
class SchemaCheck {
 public:
  /// @param part JSON pointer to the part of it that is meant, which must not refer to others.
  explicit SchemaCheck(std::string_view schema, const std::string& part = "");
  ~SchemaCheck();
  /// @param at JSON pointer to the value in its file. @throws ConfigError as above.
  void operator()(const Json& value, const std::string& name, const std::string& at = "") const;

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
