#include "src/report/provenance_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

Json start(const std::string& command) {
  return {{"uid", "a-b"},
          {"plan_sha256", "77"},
          {"archive", "full"},
          {"devices", {"mc1: answers \"a|b\" `c`"}},
          {"provenance",
           {{"program", "turntable"},
            {"version", "0.1.0"},
            {"commit", "c0ffee"},
            {"modified", true},
            {"compiler", "12.2.0"},
            {"host", "rig_pc"},
            {"command", command},
            {"folder", "/home/lab"},
            {"libraries", {{"eigen", "3.4.0"}, {"opencv", "4.6.0"}}},
            {"rig", {{"file", "rig_a_b.json"}, {"sha256", "11"}}},
            {"sources", {{{"file", "c|d.json"}, {"sha256", "22"}}}},
            {"camera", {{"model", "gige"}, {"exposure_us", 5000.0}, {"trigger", "Line1"}}},
            {"axes",
             {{"yaw", {{"unit", "deg"}, {"lower", -90.0}, {"upper", 90.0}, {"retries", 2}}}}}}}};
}

RunRecord record_of(const std::vector<Json>& starts) {
  RunRecord record;
  record.plan.name = "night";
  record.plan.poses.resize(3);
  for (const Json& document : starts) {
    record.sessions.emplace_back();
    record.sessions.back().start_document = document.dump();
    record.sessions.back().began_utc = "2026-01-31T12:00:00.000Z";
  }
  if (!starts.empty()) record.start_document = starts.front().dump();
  return record;
}

std::string text_of(const RunRecord& record) {
  Results results;
  results.record = record;
  results.calibration.source = "the sweep of last week";
  return provenance_text(results);
}

TEST(ProvenanceReport, SaysPlanProgramDevicesAxesCameraAndFiles) {
  const std::string md = text_of(record_of({start("run campaign.json")}));
  EXPECT_THAT(md, AllOf(HasSubstr("| plan | night, 3 poses, SHA-256 `77` |"),
                        HasSubstr("| began | 2026-01-31T12:00:00.000Z |"),
                        HasSubstr("| command | turntable run campaign.json in /home/lab |"),
                        HasSubstr("commit c0ffee and changes to it"),
                        HasSubstr("| libraries | eigen 3.4.0, opencv 4.6.0 |"),
                        HasSubstr("| yaw | "), HasSubstr("| -90 to 90 deg |"), HasSubstr("| 2 |"),
                        HasSubstr("exposure 5000 us, gain as the camera was set"),
                        HasSubstr("| rig_a_b.json | `11` |"), HasSubstr("`22` |")));
  EXPECT_THAT(md, Not(HasSubstr("session"))) << "there is one only";
  EXPECT_THAT(md, Not(HasSubstr("seed"))) << "it is not simulated";
}

TEST(ProvenanceReport, TextFromElsewhereStaysInItsCell) {
  const std::string md = text_of(record_of({start("run campaign.json")}));
  EXPECT_THAT(md, AllOf(HasSubstr(R"(| device | mc1: answers "a\|b" \`c\` |)"),
                        HasSubstr(R"(| c\|d.json |)")));
}

TEST(ProvenanceReport, SaysWhatALaterSessionWasTakenWith) {
  Json later = start("resume run");
  later["provenance"]["commit"] = "decaf";
  later["provenance"]["accepted_changes"] = {"motion.json: has changed"};
  const std::string md = text_of(record_of({start("run campaign.json"), later}));
  EXPECT_THAT(md, AllOf(HasSubstr("| command (session 2) | turntable resume run in"),
                        HasSubstr("| program (session 2) | turntable 0.1.0, commit decaf"),
                        HasSubstr("| accepted change (session 2) | motion.json: has changed |")));
  EXPECT_THAT(md, Not(HasSubstr("computer (session 2)"))) << "it is the same one";
}

TEST(ProvenanceReport, AJournalWithoutAStartOrWithABareOneHasASection) {
  EXPECT_THAT(text_of(record_of({})), HasSubstr("The journal has no start document."));
  const std::string bare = text_of(record_of({Json::object()}));
  EXPECT_THAT(bare, AllOf(HasSubstr("## Provenance"), HasSubstr("| plan | night")));
}

}  // namespace
}  // namespace turntable
