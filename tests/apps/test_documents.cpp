// Tables of parameters in the documents are the program's. Links and names are checked by tests/documents.
#include <fstream>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

TEST(Documents, ParameterTablesAreThoseOfTheProgram) {
  const fs::path root = WEFT_SOURCE_DIR;
  std::vector<std::pair<std::string, fs::path>> described{{"experiment", root / "docs/configuration.md"},
                                                          {"scene", root / "docs/scenes.md"},
                                                          {"slurm", root / "docs/cluster.md"}};
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
  EXPECT_GE(tables, 10);
}

}  // namespace
}  // namespace weft
