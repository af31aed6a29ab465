// Links in the documents lead somewhere, and tables of parameters are the program's.
#include <fstream>
#include <regex>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

TEST(Documents, LinksToFilesLeadSomewhere) {
  const fs::path root = WEFT_SOURCE_DIR;
  std::vector<fs::path> files;
  for (const fs::path& folder : {root, root / "docs"}) {
    for (const auto& item : fs::directory_iterator(folder)) {
      if (item.path().extension() == ".md") files.push_back(item.path());
    }
  }
  ASSERT_GE(files.size(), 4u);
  const std::regex link("\\]\\(([^)#]+)(#[^)]*)?\\)");
  for (const auto& file : files) {
    // Code blocks hold no links, but C++ lambdas look like them.
    std::string prose;
    bool code = false;
    std::ifstream stream(file);
    for (std::string line; std::getline(stream, line);) {
      if (line.starts_with("```")) code = !code;
      if (!code) prose += line + "\n";
    }
    for (std::sregex_iterator it(prose.begin(), prose.end(), link), end; it != end; ++it) {
      const std::string target = (*it)[1];
      if (target.starts_with("http")) continue;
      EXPECT_TRUE(fs::exists(file.parent_path() / target)) << file << " links to " << target;
    }
  }
}

TEST(Documents, ParameterTablesAreThoseOfTheProgram) {
  const fs::path root = WEFT_SOURCE_DIR;
  std::vector<std::pair<std::string, fs::path>> described{{"experiment", root / "docs/configuration.md"},
                                                          {"scene", root / "docs/scenes.md"}};
  for (const auto& kind : fs::directory_iterator(root / "plugins")) {
    if (!kind.is_directory()) continue;
    for (const auto& plugin : fs::directory_iterator(kind)) {
      const std::string name = kind.path().filename().string() + "/" + plugin.path().filename().string();
      if (plugin.is_directory()) described.emplace_back(name, plugin.path() / "README.md");
    }
  }
  int tables = 0;
  for (const auto& [name, file] : described) {
    std::ifstream stream(file);
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    const auto table = text.find("| parameter | type |");
    if (table == std::string::npos) continue;
    ++tables;
    const test::Outcome told =
        test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' describe " + name + " --markdown");
    ASSERT_EQ(told.code, 0) << told.output;
    EXPECT_EQ(text.substr(table, told.output.size()), told.output) << file;
  }
  EXPECT_GE(tables, 9);
}

}  // namespace
}  // namespace weft
