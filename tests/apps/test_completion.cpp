// `weft completion bash`: what bash offers at the end of a command line.
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

/// What bash offers for the last of these words, in a folder, each in brackets. The words are quoted for the shell.
std::string offered(const std::string& words, const std::filesystem::path& folder = WEFT_SOURCE_DIR) {
  const std::string script = "source <(\"$0\" completion bash); cd \"$1\"; COMP_WORDS=(weft " + words +
                             "); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _weft; printf \"[%s]\" \"${COMPREPLY[@]}\"";
  const test::Outcome told =
      test::run_shell("bash --norc -c '" + script + "' '" WEFT_PROGRAM "' '" + folder.string() + "'");
  EXPECT_EQ(told.code, 0) << told.output;
  return told.output;
}

TEST(Completion, OffersTheCommandsThatHelpShows) {
  EXPECT_THAT(offered("\"\""), AllOf(HasSubstr("[run]"), HasSubstr("[garment]"), Not(HasSubstr("[worker]")),
                                     Not(HasSubstr("[--help]"))));
  EXPECT_EQ(offered("disp"), "[displacement]");
  EXPECT_EQ(offered("evaluate ph"), "[physics]");
  EXPECT_EQ(offered("--vers"), "[--version]");
}

TEST(Completion, OffersTheOptionsOfACommandAndTheirChoices) {
  EXPECT_THAT(offered("run task.yaml --"),
              AllOf(HasSubstr("[--set]"), HasSubstr("[--seed]"), Not(HasSubstr("[--to]"))));
  EXPECT_EQ(offered("describe --json-s"), "[--json-schema]");
  EXPECT_EQ(offered("export results --to \"\""), "[gltf][usd][obj][csv][html][webp]");
  EXPECT_EQ(offered("export results --to = g"), "[gltf]");  // bash makes three words of --to=g
  EXPECT_EQ(offered("completion z"), "[zsh]");
}

TEST(Completion, OffersFilesWhereArgumentsAreFiles) {
  const test::Folder folder;
  folder.write("my task.yaml", "");
  std::filesystem::create_directory(folder / "mine");
  EXPECT_THAT(offered("run m", folder.path()), AllOf(HasSubstr("[my task.yaml]"), HasSubstr("[mine]")));
  EXPECT_EQ(offered("run --out min", folder.path()), "[mine]");
  // The value of an option is no command.
  EXPECT_EQ(offered("evaluate planning --out prediction x.yaml --widt", folder.path()), "[--widths]");
}

TEST(Completion, EndsInTheScriptOfEachShell) {
  const test::Outcome zsh = test::run_shell("'" WEFT_PROGRAM "' completion zsh");
  EXPECT_EQ(zsh.code, 0);
  EXPECT_THAT(zsh.output, ::testing::StartsWith("#compdef weft\n"));
  const test::Outcome fish = test::run_shell("'" WEFT_PROGRAM "' completion fish");
  EXPECT_EQ(fish.code, 2);
  EXPECT_THAT(fish.output, HasSubstr("fish not in {bash,zsh}"));
}

}  // namespace
}  // namespace weft
