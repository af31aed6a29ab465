#include "report/page.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>

#include "report/cases_file.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr const char* kTemplate = "<main></main><!--weft-data--><script>show()</script>";

/// One triangle that is lifted for one segment and let go.
SessionRecord small_session() {
  SessionRecord session;
  session.config = "description: </script><script>alert(1)</script>\n";
  session.provenance = R"({"seed": 3})";
  session.summary = R"({"error_mm": 1.25})";
  session.garment_name = "triangle";
  session.faces.resize(1, 3);
  session.faces << 0, 1, 2;
  session.start.resize(3, 3);
  session.start << 0, 0, 0, 1, 0, 0, 0, 1, 0;
  session.goal = session.default_shape = session.final_shape = session.start;
  for (int f = 0; f <= 13; ++f) session.frames.push_back(session.start.array() + 0.001 * f);
  RoundRecord round;
  round.controls = Controls::Ones(1, 5);
  round.state = Vector::Zero(5);
  round.observed = session.frames.back();
  round.losses = Vector::Ones(2);
  round.mean = {session.start};
  round.sigma = {Positions::Constant(3, 3, 0.1)};
  session.rounds.push_back(round);
  return session;
}

class ReportFolder : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("weft-report-" + std::to_string(::getpid()) + "-" +
                                           ::testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directories(folder_);
  }
  void TearDown() override {
    ::unsetenv("WEFT_REPORT_TEMPLATE");
    fs::remove_all(folder_);
  }
  void write(const std::string& name, const std::string& text) const { std::ofstream(folder_ / name) << text; }
  std::string read(const std::string& name) const {
    std::ifstream stream(folder_ / name);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  fs::path folder_;
};

TEST(Report, PutsTheDataWhereTheTemplateSays) {
  const std::string page = session_page(kTemplate, small_session());
  EXPECT_THAT(page, AllOf(HasSubstr("<main></main><script type=\"application/json\" id=\"weft-data\">{"),
                          HasSubstr("\"error_mm\":1.25"), HasSubstr("id=\"weft-array-0\""),
                          HasSubstr("</script>\n<script>show()</script>"), Not(HasSubstr("<!--weft-data-->"))));
}

TEST(Report, TextOfARunCannotEndTheDataElement) {
  const std::string page = session_page(kTemplate, small_session());
  EXPECT_THAT(page, Not(HasSubstr("<script>alert")));
  EXPECT_THAT(page, HasSubstr("\\u003c/script>\\u003cscript>alert(1)"));
}

TEST(Report, MeasuresPredictionsAgainstWhatHappened) {
  // Every coordinate is off by 13 mm, well inside a sigma of 100 mm.
  const std::string page = session_page(kTemplate, small_session());
  EXPECT_THAT(page, HasSubstr("\"prediction\":{\"error_mm\":[22.51"));
  EXPECT_THAT(page, HasSubstr("\"sigma_mm\":[173.2"));
  EXPECT_THAT(page, HasSubstr("\"coverage_1sigma\":[1.0]"));
}

TEST(Report, RefusesATemplateWithoutAPlaceForData) {
  EXPECT_THROW(session_page("<html></html>", small_session()), ConfigError);
}

TEST_F(ReportFolder, TakesTheTemplateThatTheEnvironmentNames) {
  write("template.html", kTemplate);
  ::setenv("WEFT_REPORT_TEMPLATE", (folder_ / "template.html").c_str(), 1);
  EXPECT_EQ(find_report_template().text, kTemplate);
  ::setenv("WEFT_REPORT_TEMPLATE", (folder_ / "nothing.html").c_str(), 1);
  EXPECT_THAT(find_report_template().reason, HasSubstr("nothing.html, which is not a file"));
  EXPECT_THAT(write_report(folder_), HasSubstr("nothing.html"));
  EXPECT_FALSE(fs::exists(folder_ / "report.html"));
}

TEST_F(ReportFolder, ShowsWhicheverExperimentsAreThere) {
  write("template.html", kTemplate);
  ::setenv("WEFT_REPORT_TEMPLATE", (folder_ / "template.html").c_str(), 1);
  write("planning.json", R"({"cases": [], "by_width": []})");
  EXPECT_EQ(write_report(folder_), "");
  EXPECT_THAT(read("report.html"), AllOf(HasSubstr("\"kind\":\"evaluation\""), HasSubstr("\"planning\":{\"cases\":[]"),
                                         Not(HasSubstr("\"estimation\""))));
  // Times lie apart and are joined: objects by key, lists by entry.
  write("ablation.json", R"({"arms": [{"metrics": {"error_mm": {"n": 2}}}, {"metrics": {}}]})");
  write("provenance.json", R"({"commit": "abc"})");
  write("times.json",
        R"({"threads": 3, "cores": 4, "ablation.json": {"arms": [{"metrics": {"plan_seconds": {"n": 1}}}]}})");
  EXPECT_EQ(write_report(folder_), "");
  EXPECT_THAT(read("report.html"), AllOf(HasSubstr(R"("metrics":{"error_mm":{"n":2},"plan_seconds":{"n":1}})"),
                                         HasSubstr(R"({"commit":"abc","threads":3,"cores":4})")));
  write("times.json", "{damaged");
  EXPECT_THROW(write_report(folder_), ConfigError);
  std::filesystem::remove(folder_ / "times.json");
  write("ablation.json", "{damaged");
  EXPECT_THROW(write_report(folder_), ConfigError);
}

TEST_F(ReportFolder, CasesCanBeLookedAt) {
  const auto session = small_session();
  const auto write_cases = [&](double somewhere, std::int64_t goal) {
    auto file = Hdf5File::create(folder_ / "cases.h5");
    file.write("/garment/name", std::string("triangle"));
    file.write("/garment/rest", Controls(session.start.leftCols(2)));
    const Eigen::Matrix<std::int64_t, Eigen::Dynamic, 3, Eigen::RowMajor> faces = session.faces.cast<std::int64_t>();
    file.write("/garment/faces", faces);
    const std::vector<double> goals(9, 0.0), finals(18, somewhere);
    const std::vector<std::int64_t> goal_of = {0, goal};
    file.write("/planning/goals", {1, 3, 3}, goals.data());
    file.write("/planning/finals", {2, 3, 3}, finals.data());
    file.write("/planning/goal_of", {2}, goal_of.data());
    file.commit();
  };
  write_cases(0.01, 0);
  EXPECT_THAT(experiment_page(kTemplate, folder_), Not(HasSubstr("goal_of")));  // of no experiment that is there
  write("planning.json", R"({"cases": [], "by_width": []})");
  EXPECT_THAT(experiment_page(kTemplate, folder_),
              AllOf(HasSubstr("\"name\":\"triangle\",\"vertices\":3"), HasSubstr("\"goal_of\":[0,0]")));
  write_cases(0.01, 1);
  EXPECT_THROW(experiment_page(kTemplate, folder_), ConfigError);
  write_cases(std::numeric_limits<double>::quiet_NaN(), 0);
  EXPECT_THROW(experiment_page(kTemplate, folder_), ConfigError);
}

TEST_F(ReportFolder, ManipulationsCanBeLookedAt) {
  const auto session = small_session();
  Garment garment;
  garment.name = "triangle";
  garment.faces = session.faces;
  garment.rest = session.start.leftCols(2);
  const auto write_cases = [&](const std::vector<std::int64_t>& first) {
    auto file = create_cases_file(folder_ / "cases.h5", garment);
    write_shapes(file, "/estimation/shapes", {session.start, session.goal, session.start});
    file.write("/estimation/first", {static_cast<Index>(first.size())}, first.data());
    file.commit();
  };
  write("estimation.json", R"({"cases": [], "properties": {}})");
  write_cases({0, 2, 2, 3});
  const std::string page = experiment_page(kTemplate, folder_);
  EXPECT_THAT(page, AllOf(HasSubstr("\"shape\":[2,3,3]"), HasSubstr("},null,{"), HasSubstr("\"shape\":[1,3,3]")));
  for (const auto& wrong : std::vector<std::vector<std::int64_t>>{{0, 2}, {1, 3}, {0, 4, 3}, {0, 9}}) {
    write_cases(wrong);
    EXPECT_THROW(experiment_page(kTemplate, folder_), ConfigError);
  }
}

TEST_F(ReportFolder, RefusesWhatIsNoSession) {
  EXPECT_THROW(read_session(folder_ / "session.h5"), ConfigError);
  auto file = Hdf5File::create(folder_ / "session.h5");
  file.write("/schema", std::string("something else"));
  file.commit();
  try {
    read_session(folder_ / "session.h5");
    FAIL();
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), HasSubstr("this is not a recorded session"));
  }
}

}  // namespace
}  // namespace weft
