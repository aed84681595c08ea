#include "src/core/json_document.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cstring>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <sstream>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validation_results.hpp>
#include <valijson/validator.hpp>

#include "schemas.h"
#include "src/core/errors.h"
#include "src/core/file_errors.h"

namespace turntable {
namespace {

using valijson::adapters::NlohmannJsonAdapter;

/// What reads a document calls itself for every level, and has a stack of some megabytes.
constexpr int kDeepest = 100;
/// Likewise for every letter of a string that is compared with a pattern.
constexpr std::size_t kLongestOfPattern = 1000;

std::string_view schema_text(std::string_view name) {
  for (const auto& [stem, text] : embedded::schemas())
    if (stem == name) return text;
  throw std::logic_error(fmt::format("no built-in schema '{}'", name));
}

/// Puts what references lead to in their place: those to other built-in schemas ("rig.schema.json#/
/// properties/pattern"), and within these their own, which would lead nowhere from here.
Json inlined(const Json& node, const Json& document, bool own) {
  if (node.is_array()) {
    Json out = Json::array();
    for (const Json& item : node) out.push_back(inlined(item, document, own));
    return out;
  }
  if (!node.is_object()) return node;
  if (const auto it = node.find("$ref"); it != node.end() && it->is_string()) {
    const auto reference = it->get<std::string>();
    const std::size_t hash = reference.find('#');
    const Json::json_pointer place(reference.substr(hash + 1));
    if (hash > 0) {
      constexpr std::string_view kEnding = ".schema.json";
      const Json other =
          Json::parse(schema_text(std::string_view(reference).substr(0, hash - kEnding.size())));
      return inlined(other.at(place), other, false);
    }
    if (!own) return inlined(document.at(place), document, false);
  }
  Json out = Json::object();
  for (const auto& [key, value] : node.items()) out[key] = inlined(value, document, own);
  return out;
}

Json whole_schema(std::string_view name) {
  const Json schema = Json::parse(schema_text(name));
  return inlined(schema, schema, true);
}

/// valijson names a place as "<root>[axes][yaw][limits_deg][0]"; users get a JSON pointer.
std::string pointer_of(const valijson::ValidationResults::Error& error) {
  Json::json_pointer pointer;
  for (std::string part : error.context) {
    if (part == "<root>") continue;
    if (part.size() >= 2 && part.front() == '[' && part.back() == ']')
      part = part.substr(1, part.size() - 2);
    if (part.size() >= 2 && part.front() == '"' && part.back() == '"')
      part = part.substr(1, part.size() - 2);
    pointer /= part;  // as a pointer writes a name with a slash or a tilde
  }
  return pointer.to_string();
}

/// Value for a message: short, on one line.
std::string shown(const Json& value) {
  std::string text = value.dump();
  if (text.size() > 60) text = text.substr(0, 57) + "...";
  return text;
}

/// The schema that governs the value at `pointer`, as far as plain properties and items lead.
const Json* schema_at(const Json& root, const Json::json_pointer& pointer) {
  const Json* at = &root;
  const auto resolve = [&root](const Json* schema) {
    while (schema->contains("$ref")) {
      const auto reference = schema->at("$ref").get<std::string>();
      schema = &root.at(Json::json_pointer(reference.substr(1)));
    }
    return schema;
  };
  at = resolve(at);
  std::istringstream parts(pointer.to_string());
  std::string part;
  std::getline(parts, part, '/');
  while (std::getline(parts, part, '/')) {
    if (at->contains("properties") && at->at("properties").contains(part))
      at = &at->at("properties").at(part);
    else if (at->contains("items") && at->at("items").is_object())
      at = &at->at("items");
    else if (at->contains("additionalProperties") && at->at("additionalProperties").is_object())
      at = &at->at("additionalProperties");
    else
      return nullptr;
    at = resolve(at);
  }
  return at;
}

std::string keys_of(const Json& object) {
  std::string keys;
  for (const auto& [key, value] : object.items()) keys += (keys.empty() ? "" : ", ") + key;
  return keys;
}

/// What is wrong with `value` against `schema` in a person's words; empty if this level shows
/// nothing.
std::string explain(const Json& value, const Json& schema) {
  if (value.is_object() && schema.contains("properties")) {
    const Json& properties = schema.at("properties");
    if (schema.value("additionalProperties", Json(true)) == Json(false))
      for (const auto& [key, member] : value.items())
        if (!properties.contains(key))
          return fmt::format("unknown key \"{}\"; allowed here: {}. Remove it or correct its name.",
                             key, keys_of(properties));
    if (schema.contains("required"))
      for (const auto& key : schema.at("required"))
        if (!value.contains(key))
          return fmt::format(
              "key {} is missing. Add it ({}).", key.dump(),
              properties.contains(key)
                  ? properties.at(key.get<std::string>()).value("description", "see the schema")
                  : "see the schema");
  }
  std::string allowed;
  if (schema.contains("const")) allowed = schema.at("const").dump();
  if (schema.contains("enum")) allowed = "one of " + schema.at("enum").dump();
  if (allowed.empty() && schema.contains("type")) {
    allowed = schema.at("type").is_string() ? schema.at("type").get<std::string>()
                                            : schema.at("type").dump();
    for (const char* bound : {"minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum",
                              "minItems", "maxItems", "minLength", "multipleOf", "pattern"})
      if (schema.contains(bound)) allowed += fmt::format(", {} {}", bound, schema.at(bound).dump());
  }
  if (allowed.empty()) return {};
  const std::string description = schema.value("description", "");
  return fmt::format("found {}, allowed: {}{}.", shown(value), allowed,
                     description.empty() ? "" : " (" + description + ")");
}

/// Where a string stands that is too long to be compared with its pattern; nothing if none does.
std::optional<Json::json_pointer> too_long(const Json& value, const Json& schema,
                                           const Json::json_pointer& at = Json::json_pointer()) {
  if (value.is_string() && value.get_ref<const std::string&>().size() > kLongestOfPattern) {
    const Json* governing = schema_at(schema, at);
    if (governing != nullptr && governing->contains("pattern")) return at;
  }
  if (value.is_array())
    for (std::size_t i = 0; i < value.size(); ++i)
      if (auto found = too_long(value[i], schema, at / i)) return found;
  if (value.is_object())
    for (const auto& [key, member] : value.items())
      if (auto found = too_long(member, schema, at / key)) return found;
  return {};
}

[[noreturn]] void throw_schema_error(const Json& value, const Json& schema, const std::string& name,
                                     const std::string& place,
                                     valijson::ValidationResults& results) {
  // The deepest complaint is the cause; the others repeat it from above.
  valijson::ValidationResults::Error error, deepest;
  bool have = false;
  while (results.popError(error))
    if (!have || error.context.size() > deepest.context.size()) {
      deepest = error;
      have = true;
    }
  const std::string pointer = pointer_of(deepest);
  const Json::json_pointer at(pointer);
  std::string words;
  if (value.contains(at))
    if (const Json* governing = schema_at(schema, at)) words = explain(value.at(at), *governing);
  if (words.empty()) words = deepest.description;
  throw ConfigError(name, place + pointer == "" ? "/" : place + pointer, words);
}

/// @param keep is asked for every object that ends, with the key of the document that it stands in
/// and its depth; false = forgotten.
Json parse_or_throw(
    std::string_view text, const std::string& name,
    const std::function<bool(const std::string& key, int depth, const Json&)>& keep = {}) {
  if (text.find_first_not_of(" \t\r\n") == std::string_view::npos)
    throw ConfigError(name, "", "is empty, allowed: JSON. Restore it from a copy.");
  try {
    // JSON lets a key stand twice, and the last one wins: two limits on one axis would pass without
    // a word.
    std::vector<std::set<std::string>> open_objects;
    std::string top_key;
    const auto refuse_twice = [&](int depth, Json::parse_event_t event, Json& parsed) {
      if (depth > kDeepest)
        throw ConfigError(
            name, "",
            fmt::format(
                "holds arrays or objects within each other, more than {} deep, which no file of "
                "this program does. Restore it from a copy.",
                kDeepest));
      if (event == Json::parse_event_t::object_start) open_objects.emplace_back();
      if (event == Json::parse_event_t::object_end) open_objects.pop_back();
      if (event == Json::parse_event_t::key && depth == 1) top_key = parsed.get<std::string>();
      if (event == Json::parse_event_t::key &&
          !open_objects.back().insert(parsed.get<std::string>()).second)
        throw ConfigError(
            name, "",
            fmt::format("key {} stands twice in one object. Remove one of them.", parsed.dump()));
      return event != Json::parse_event_t::object_end || !keep || keep(top_key, depth, parsed);
    };
    return Json::parse(text, refuse_twice);
  } catch (const Json::parse_error& e) {
    const std::size_t end = std::min(text.size(), e.byte == 0 ? 0 : e.byte - 1);
    const auto line =
        1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(end), '\n');
    const std::size_t newline = text.substr(0, end).rfind('\n');
    const std::size_t column = end - (newline == std::string_view::npos ? 0 : newline + 1) + 1;
    std::string detail = e.what();
    if (const auto at = detail.find("syntax error"); at != std::string::npos)
      detail = detail.substr(at);
    throw ConfigError(
        name, "",
        fmt::format("not valid JSON at line {}, column {}: {} (JSON has no comments, no "
                    "trailing commas, no NaN)",
                    line, column, detail));
  } catch (const Json::exception& e) {
    throw ConfigError(name, "", fmt::format("not valid JSON: {}", e.what()));
  }
}

}  // namespace

namespace {

/// Of a program without descriptors nothing follows about the file.
[[noreturn]] void refuse_unread(const std::filesystem::path& file, int cause) {
  if (cause == ENOENT || cause == ENOTDIR || cause == EACCES)
    throw ConfigError(file.string(), "",
                      "cannot be read: no such file, or no permission. Check the path.");
  const std::string what =
      fmt::format("cannot be read: {}. {}", std::strerror(cause), file_advice(cause));
  if (cause == EMFILE || cause == ENFILE || cause == ENOMEM)
    throw RecordError(fmt::format("{}: {}", file.string(), what));
  throw ConfigError(file.string(), "", what);
}

}  // namespace

std::string read_text(const std::filesystem::path& file) {
  std::error_code error;
  const auto status = std::filesystem::status(file, error);
  if (std::filesystem::is_directory(status))
    throw ConfigError(file.string(), "", "is a folder, allowed: a file. Check the path.");
  // Opening a pipe would wait for its writer, reading a device may never end.
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
    throw ConfigError(file.string(), "", "is a device or a pipe, allowed: a file. Check the path.");
  const int fd = uninterrupted([&] { return ::open(file.c_str(), O_RDONLY | O_CLOEXEC); });
  if (fd < 0) refuse_unread(file, errno);
  std::string text;
  if (const auto size = std::filesystem::file_size(file, error); !error) text.reserve(size);
  std::vector<char> piece(1u << 16);
  for (;;) {
    const ssize_t n = uninterrupted([&] { return ::read(fd, piece.data(), piece.size()); });
    if (n > 0) {
      text.append(piece.data(), static_cast<std::size_t>(n));
      continue;
    }
    const int cause = n < 0 ? errno : 0;
    ::close(fd);
    // Half a file is no file: what is missing could be taken for what was never there.
    if (n < 0) refuse_unread(file, cause);
    return text;
  }
}

namespace {

/// @param value is parsed already.
void check_document(const Json& value, const std::string& name, std::string_view schema_name) {
  const Json schema_json = whole_schema(schema_name);

  // One cheap look first: a file of another kind should not be answered with a list of missing
  // keys.
  const Json& format = schema_json.at("properties").at("format");
  if (!value.is_object() || !value.contains("format") || value.at("format") != format.at("const"))
    throw ConfigError(
        name, "/format",
        fmt::format("found {}, allowed: {}. This is not a {} file.",
                    value.is_object() && value.contains("format") ? shown(value.at("format"))
                                                                  : "no \"format\" key",
                    format.at("const").dump(), schema_name));

  SchemaCheck{schema_name}(value, name);
}

}  // namespace

Json parse_json(std::string_view text, const std::string& name, std::string_view schema) {
  Json value = parse_or_throw(text, name);
  check_document(value, name, schema);
  return value;
}

Json parse_json(std::string_view text, const std::string& name, std::string_view schema,
                std::string_view list,
                const std::function<void(const Json& item, std::size_t place)>& visit) {
  const SchemaCheck check(schema, fmt::format("/properties/{}/items", list));
  std::size_t place = 0;
  Json value = parse_or_throw(text, name, [&](const std::string& key, int depth, const Json& item) {
    constexpr int kItem = 2;  // below the document and its array
    if (depth != kItem || key != list) return true;
    check(item, name, fmt::format("/{}/{}", list, place));
    visit(item, place);
    return place++ == 0;
  });
  check_document(value, name, schema);
  return value;
}

struct SchemaCheck::Parsed {
  Json json;
  valijson::Schema schema;
};

SchemaCheck::SchemaCheck(std::string_view schema, const std::string& part)
    : parsed_(std::make_unique<Parsed>()) {
  parsed_->json = whole_schema(schema).at(Json::json_pointer(part));
  valijson::SchemaParser().populateSchema(NlohmannJsonAdapter(parsed_->json), parsed_->schema);
}
SchemaCheck::~SchemaCheck() = default;

void SchemaCheck::operator()(const Json& value, const std::string& name,
                             const std::string& at) const {
  if (const auto place = too_long(value, parsed_->json))
    throw ConfigError(
        name, at + place->to_string(),
        fmt::format("found a text of {} letters, allowed: up to {}. Shorten it.",
                    value.at(*place).get_ref<const std::string&>().size(), kLongestOfPattern));
  valijson::Validator validator;
  valijson::ValidationResults results;
  if (!validator.validate(parsed_->schema, NlohmannJsonAdapter(value), &results))
    throw_schema_error(value, parsed_->json, name, at, results);
}

Json load_json(const std::filesystem::path& file, std::string_view schema) {
  return parse_json(read_text(file), file.string(), schema);
}

std::string format_of(const std::filesystem::path& file) {
  const Json value = parse_or_throw(read_text(file), file.string());
  if (value.is_object() && value.contains("format") && value.at("format").is_string()) {
    const auto text = value.at("format").get<std::string>();
    const auto slash = text.find('/');
    if (text.starts_with("turntable-") && slash != std::string::npos)
      return text.substr(10, slash - 10);
  }
  throw ConfigError(file.string(), "/format",
                    "no \"turntable-...\" format is stated. Name the file's kind, for example "
                    "\"format\": \"turntable-scenario/1\".");
}

const std::vector<std::string>& schema_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> list;
    for (const auto& [stem, text] : embedded::schemas()) list.emplace_back(stem);
    return list;
  }();
  return names;
}

}  // namespace turntable
