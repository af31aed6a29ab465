// Links in the documents lead somewhere.
#include <fstream>
#include <regex>

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

}  // namespace
}  // namespace weft
