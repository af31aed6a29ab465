#include "report/paper_tables.hpp"

#include "test_support.hpp"
#include "weft/error.hpp"

namespace weft::test {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr const char* kAblation = R"({"factors": ["optimiser"], "complete": true, "arms": [
  {"name": "rprop", "levels": {"optimiser": "rprop"}, "failed": [], "unpaired": 0, "metrics": {
    "error_mm": {"n": 20, "mean": 12.345, "median": 10.5, "mean_95": [11, 13.5], "median_95": [9.5, 12]}}},
  {"name": "a|b & 50 %", "levels": {"optimiser": "a|b & 50 %"}, "failed": [{"seed": 3}], "unpaired": 0, "metrics": {
    "error_mm": {"n": 19, "mean": 14, "median": null, "mean_95": [null, null], "median_95": [null, null],
      "difference": {"n": 19, "mean": -1.5, "mean_95": [-2, -1]}}}}]})";

TEST(PaperTables, AnAblationAsMarkdownAndLatex) {
  const Folder folder;
  folder.write("ablation.json", kAblation);
  const auto tables = paper_tables(folder.path());
  ASSERT_EQ(tables.size(), 1u);
  EXPECT_EQ(
      markdown_of(tables),
      "error_mm (mean vertex distance from the goal after settling): mean and median with the bootstrap's 95 % intervals, "
      "and the mean of the paired differences to the baseline, the row without one.\n\n"
      "| optimiser | n | failed | mean, mm | 95 %, mm | median, mm | 95 %, mm | difference, mm | 95 %, mm |\n"
      "|---|---:|---:|---:|---:|---:|---:|---:|---:|\n"
      "| rprop | 20 | 0 | 12.3 | [11.0, 13.5] | 10.5 | [9.5, 12.0] |  |  |\n"
      "| a\\|b & 50 % | 19 | 1 | 14.0 |  |  |  | -1.5 | [-2.0, -1.0] |\n");
  EXPECT_EQ(
      latex_of(tables),
      "% Tables of weft; they need \\usepackage{booktabs}.\n\n"
      "\\begin{table}\n  \\centering\n"
      "  \\caption{error\\_mm (mean vertex distance from the goal after settling): mean and median with the "
      "bootstrap's 95 \\% intervals, and the mean of the paired differences to the baseline, the row without one.}\n"
      "  \\label{tab:ablation-error-mm}\n  \\begin{tabular}{lrrrrrrrr}\n    \\toprule\n"
      "    optimiser & n & failed & mean, mm & 95 \\%, mm & median, mm & 95 \\%, mm & difference, mm & 95 \\%, mm \\\\\n    \\midrule\n"
      "    rprop & 20 & 0 & 12.3 & [11.0, 13.5] & 10.5 & [9.5, 12.0] &  &  \\\\\n"
      "    a$\\vert$b \\& 50 \\% & 19 & 1 & 14.0 &  &  &  & $-$1.5 & [$-$2.0, $-$1.0] \\\\\n"
      "    \\bottomrule\n  \\end{tabular}\n\\end{table}\n");
}

TEST(PaperTables, SmallMeansBesideLargeOnesKeepTwoDigits) {
  const Folder folder;
  const auto arm = [](const std::string& name, const std::string& mean) {
    return R"({"name": ")" + name + R"(", "levels": {"a": ")" + name +
           R"("}, "failed": [], "metrics": {"loss": {"n": 1, "mean": )" + mean + "}}}";
  };
  folder.write("ablation.json", R"({"factors": ["a"], "arms": [)" + arm("x", "4.44") + ", " + arm("y", "881.2") + "]}");
  EXPECT_THAT(markdown_of(paper_tables(folder.path())), AllOf(HasSubstr("| 4.4 |"), HasSubstr("| 881.2 |")));
  folder.write("ablation.json",
               R"({"factors": ["a"], "arms": [)" + arm("x", "0.0444") + ", " + arm("y", "881.2") + "]}");
  EXPECT_THAT(markdown_of(paper_tables(folder.path())), AllOf(HasSubstr("| 0.0 |"), HasSubstr("| 881.2 |")));
}

TEST(PaperTables, EvaluationsHaveTheirTables) {
  const Folder folder;
  const std::string by_width =
      R"("by_width": [{"width": 0.1, "n": 50, "median_mm": 1.234, "mean_mm": 2, "sd_mm": null, "q1_mm": 1, "q3_mm": 2.5,
          "median_95_mm": [1, 1.5], "mean_95_mm": [null, 3],
          "outliers": 3, "silhouette_iou": 0.987, "success_10mm": 0.96, "success_20mm": 1, "success_30mm": 1}])";
  folder.write("planning.json", R"({"goals": "fresh", "complete": false, )" + by_width +
                                    R"(, "columns": {"test": {"goals": "test", )" + by_width + "}}}");
  folder.write("estimation.json",
               R"({"complete": true, "goals": "fresh", "method": "posterior", "cases": [
      {"true_material": [0.5, 0.2, 0.3, 0.4], "knowledge": [{"centre": [0.5, 0.5, 0.5, 0.5], "width": [1, 1, 1, 1]},
       {"centre": [0.6, 0.2, 0.3, 0.4], "width": [0.2, 0.1, 0.1, 0.1]}]},
      {"true_material": [0.5, 0.5, 0.5, 0.5], "knowledge": [{"centre": [0.5, 0.5, 0.5, 0.5], "width": [1, 1, 1, 1]}]},
      {"seed": 3, "status": "crashed", "failed": "x"}], "columns": {"fresh": {"posterior": {"n": 50, "properties": {"bend": {
      "abs_error": {"mean": 0.05, "median": 0.04, "sd": 0.03, "median_95": [0.03, 0.06]}, "width": {"median": 0.25}, "failure_rate": 0.02,
      "coverage": {"0.5": 0.5, "0.8": 0.82}, "interval_score": 0.3}}}}}})");
  folder.write(
      "prediction.json",
      R"({"settled": {"from_start": {"n": 12, "mean_mm": 3.5, "median_mm": 2.25, "sigma_mm": 2.0, "nll": 1.5, "nse": 1.25,
      "coverage_1sigma": 0.7215}, "no_knowledge": {"n": 12, "mean_mm": 9.5}}, "by_step": [{"steps": 1, "n": 9, "mean_mm": 0.5, "median_mm": 0.4, "sigma_mm": 0.6,
      "nll": -1.25, "coverage_1sigma": 0.7}]})");
  folder.write(
      "physics.json",
      R"({"rows": [{"test": "hanging", "case": "strip", "variant": "finer", "quantity": "length, m", "reference": 1.5,
      "measured": 1.50001, "error": null, "bound": 0.01, "passed": true}]})");
  const std::string text = markdown_of(paper_tables(folder.path()));
  EXPECT_THAT(text, HasSubstr("(goals: fresh); not all cells have run.\n"));
  EXPECT_THAT(text, HasSubstr("(goals: test).\n"));
  EXPECT_THAT(
      text, HasSubstr("| 0.10 | 50 | 1.23 | [1.00, 1.50] | 2.00 |  |  | 1.00 | 2.50 | 3 | 0.987 | 96 | 100 | 100 |\n"));
  EXPECT_THAT(text, HasSubstr("| median \\|c - q\\| |"));
  EXPECT_THAT(
      text,
      HasSubstr(
          "| posterior | bend | 50 | 0.040 | [0.030, 0.060] | 0.050 |  | 0.030 | 0.250 |  |  | 2 | 50 | 82 | 0.300 |\n"));
  EXPECT_THAT(text, HasSubstr("(cases: fresh, method: posterior).\n"));
  EXPECT_THAT(text, HasSubstr("| 0 | 2 | 0.000 | 1.000 | 100 | 0.150 | 1.000 | 100 |"));
  EXPECT_THAT(text, HasSubstr("| 1 | 1 | 0.100 | 0.200 | 0 | 0.000 | 0.100 | 100 |"));
  EXPECT_THAT(text, HasSubstr("| from the flat start | 12 | 3.50 | 2.25 | 2.00 | 72.2 | 1.25 | 1.50 |\n"));
  EXPECT_THAT(text, HasSubstr("| without knowledge of the material | 12 | 9.50 |  |  |  |  |  |\n"));
  EXPECT_THAT(text, HasSubstr("| 1 | 9 | 0.50 | 0.40 | 0.60 | -1.250 | 70 |\n"));
  EXPECT_THAT(text, HasSubstr("| hanging | strip | finer | length, m | 1.5 | 1.5 |  | 0.01 | yes |\n"));
  EXPECT_THAT(latex_of(paper_tables(folder.path())), HasSubstr("median $\\vert$c - q$\\vert$"));
}

TEST(PaperTables, SmallErrorsOfEstimatesKeepTheirDigits) {
  const Folder folder;
  folder.write("estimation.json",
               R"({"columns": {"fresh": {"posterior": {"n": 5, "properties": {
      "bend": {"abs_error": {"mean": 0.05, "median": 0.04}, "width": {"median": 0.25}, "coverage": {}},
      "friction": {"abs_error": {"mean": 0.0002, "median": 0.0001}, "width": {"median": 0.02}, "coverage": {}}}}}}})");
  const std::string text = markdown_of(paper_tables(folder.path()));
  EXPECT_THAT(text, AllOf(HasSubstr("| posterior | bend | 5 | 0.0400 |  | 0.0500 |"),
                          HasSubstr("| posterior | friction | 5 | 0.0001 |  | 0.0002 |"), HasSubstr("| 0.020 |")));
}

TEST(PaperTables, ThePhysicsSuiteIsSummedUpByTestQuantityAndBound) {
  const Folder folder;
  folder.write("physics.json", R"({"rows": [
    {"test": "elastica", "case": "5 mm", "variant": "default", "quantity": "drop/L", "error": 0.0256, "bound": 0.03, "passed": true},
    {"test": "elastica", "case": "20 mm", "variant": "default", "quantity": "drop/L", "error": 0.001, "bound": 0.06, "passed": true},
    {"test": "elastica", "case": "6 mm", "variant": "default", "quantity": "drop/L", "error": 0.031, "bound": 0.03, "passed": false},
    {"test": "elastica", "case": "7 mm", "variant": "default", "quantity": "drop/L", "error": null, "bound": 0.03, "passed": false},
    {"test": "properties", "case": "bend from 0 to 1", "variant": "default", "quantity": "settled shape moves mm", "measured": 21.484,
     "error": 0.05, "bound": 1, "passed": true}]})");
  const auto tables = paper_tables(folder.path());
  ASSERT_EQ(tables.size(), 3u);
  EXPECT_EQ(tables[0].label, "physics-summary");
  EXPECT_EQ(markdown_of(tables[0]),
            "| test | quantity | comparisons | within bound | median error | largest error | bound |\n"
            "|---|---|---:|---:|---:|---:|---:|\n"
            "| elastica | drop/L | 3 | 1 | 0.028 | 0.031 | 0.03 |\n"
            "| elastica | drop/L | 1 | 1 | 0.001 | 0.001 | 0.06 |\n"
            "| properties | settled shape moves mm | 1 | 1 | 0.05 | 0.05 | 1 |\n");
  EXPECT_EQ(tables[1].label, "physics-properties");
  EXPECT_EQ(markdown_of(tables[1]), "| change | moves by, mm |\n|---|---:|\n| bend from 0 to 1 | 21.48 |\n");
}

TEST(PaperTables, AnAblationOfThePhysicsSuiteTellsWhatEachArmIsWithinAndRefuses) {
  const Folder folder;
  folder.write("ablation.json",
               R"({"factors": ["simulator"], "cases": ["incline, mu 0.1", "incline, mu 0.3", "inclined", "folds"],
    "arms": [
    {"name": "cloth", "levels": {"simulator": "cloth"}, "failed": [], "metrics": {
      "incline: motion, m": {"n": 2, "mean": 0.2, "median": 0.2, "largest": 0.3}, "incline: within bounds": {"n": 2, "mean": 1.0},
      "folds: distance, mm": {"n": 0, "mean": null, "median": null, "largest": null}, "folds: within bounds": {"n": 1, "mean": 1.0}}},
    {"name": "bullet", "levels": {"simulator": "bullet"}, "failed": [{"seed": 1}, {"seed": 2}], "metrics": {
      "incline: motion, m": {"n": 1, "mean": 4, "median": 4, "largest": 4}, "incline: within bounds": {"n": 1, "mean": 0.0},
      "folds: distance, mm": {"n": 1, "mean": 3, "median": 3, "largest": 3}, "folds: within bounds": {"n": 1, "mean": 1.0}}}]})");
  const auto tables = paper_tables(folder.path());
  ASSERT_GE(tables.size(), 2u);
  EXPECT_EQ(tables[1].label, "ablation-physics");
  EXPECT_EQ(markdown_of(tables[1]),
            "| test | quantity | simulator | cases | within | failed | median | largest |\n"
            "|---|---|---|---:|---:|---:|---:|---:|\n"
            "| incline | motion, m | cloth | 2 | 2 | 0 | 0.2 | 0.3 |\n"
            "| incline | motion, m | bullet | 2 | 0 | 1 | 4 | 4 |\n"
            "| folds | distance, mm | bullet | 1 | 1 | 0 | 3 | 3 |\n");
}

TEST(PaperTables, AnAblationOfThePhysicsSuiteHasOneTableOfAllMetrics) {
  const Folder folder;
  folder.write("ablation.json", R"({"factors": ["simulator"], "cases": ["free fall"], "arms": [
    {"name": "cloth", "levels": {"simulator": "cloth"}, "failed": [], "metrics": {"free fall: error": {"n": 1, "mean": 0.000125}}},
    {"name": "bullet", "levels": {"simulator": "bullet"}, "failed": [], "metrics": {}}]})");
  const auto tables = paper_tables(folder.path());
  ASSERT_EQ(tables.size(), 3u);
  EXPECT_EQ(tables[0].label, "ablation-summary");
  EXPECT_EQ(markdown_of(tables[0]),
            "| metric | cloth | bullet |\n|---|---:|---:|\n| free fall: error | 0.000125 |  |\n");
}

TEST(PaperTables, ADamagedFileIsNamed) {
  const Folder folder;
  EXPECT_THAT(paper_tables(folder.path()), IsEmpty());
  folder.write("planning.json", R"({"goals": "fresh"})");
  EXPECT_THAT(message_of<ConfigError>([&] { paper_tables(folder.path()); }), HasSubstr("planning.json: is damaged: "));
}

}  // namespace
}  // namespace weft::test
