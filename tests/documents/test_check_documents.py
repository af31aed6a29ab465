#!/usr/bin/env python3
"""The check of the documents finds what it is for: each case writes one page into a small tree.

Usage: test_check_documents.py [CMAKE], which is also run on quotes that are wrong.
"""
import pathlib
import subprocess
import sys
import tempfile
import unittest

from check_documents import check

CMAKE = sys.argv.pop(1) if len(sys.argv) > 1 else "cmake"
QUOTES = pathlib.Path(__file__).resolve().parents[2] / "cmake/WeftQuotes.cmake"


class Documents(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.root = pathlib.Path(self.folder.name).resolve()
        self.write("docs/guide.md", "# Guide\n\n## Two words, a `comma`\n\n## A & B\n")
        self.write("docs/images/x.png", "")
        self.write("plugins/trajectory/arc/README.md", "# arc\n")
        self.write("framework/session/planner.cpp", "void plan() {}\n")
        self.write("framework/include/weft/types.hpp", "struct Controls;\n")
        self.write("LICENSE", "")

    def tearDown(self):
        self.folder.cleanup()

    def write(self, name, text):
        file = self.root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)

    def wrong(self, text, name="README.md"):
        self.write(name, text)
        return check(self.root)[0]

    def test_accepts_what_is_there(self):
        self.assertEqual([], self.wrong(
            "[a](docs/guide.md), [b](docs/guide.md#two-words-a-comma), [c](LICENSE), [d](https://x.y/z#q), ![e](docs/images/x.png)\n"
            "[f](#here), `plan` in `framework/session/planner.cpp`, `weft/types.hpp` (`Controls`), `session/planner.cpp`,\n"
            "`framework/*/planner.cpp`, `plugins/KIND/NAME`, `docs/images/`, `a [x](nowhere.md)`\n# Here\n"
            "```\n[x](nowhere.md)\n```\n"))

    def test_refuses_a_link_to_nowhere(self):
        self.assertRegex(self.wrong("text\n[a](docs/none.md)\n")[0], r"README\.md:2: links to docs/none\.md")
        self.assertRegex(self.wrong("text\n[two\nlines](docs/none.md)\n")[0], r"README\.md:2: links to docs/none\.md")

    def test_refuses_a_link_of_a_plugin(self):
        self.assertEqual(1, len(self.wrong("[a](../guide.md)\n", "plugins/trajectory/arc/README.md")))

    def test_refuses_a_broken_anchor(self):
        self.assertRegex(self.wrong("[a](docs/guide.md#three-words)\n")[0], "anchor")
        self.assertRegex(self.wrong("[a](#there)\n# Here\n")[0], "anchor")

    def test_refuses_an_anchor_that_is_another_one_on_the_site(self):
        self.assertRegex(self.wrong("[a](docs/guide.md#a--b)\n")[0], "anchor")

    def test_refuses_a_link_that_breaks_when_installed(self):
        self.assertRegex(self.wrong("[a](framework/session/planner.cpp)\n")[0], "not installed")

    def test_refuses_names_of_files_that_are_not_there(self):
        for name in ("framework/session/none.cpp", "weft/none.hpp", "session/none.cpp", "tests/*/none"):
            self.assertRegex(self.wrong(f"see `{name}`\n")[0], "does not exist")

    def test_refuses_a_function_that_is_elsewhere(self):
        self.assertRegex(self.wrong("`fold` in `framework/session/planner.cpp`\n")[0], "where it is not")
        self.assertRegex(self.wrong("`framework/session/planner.cpp` (`fold`)\n")[0], "where it is not")

    def test_lets_old_records_name_what_was_there(self):
        self.assertEqual([], self.wrong("`framework/src/none.cpp`\n", "docs/measurements/old.md"))
        self.assertEqual(1, len(self.wrong("[a](none.md)\n", "docs/measurements/old.md")))

    def test_refuses_a_citation_of_another_version(self):
        self.write("CMakeLists.txt", "project(weft VERSION 0.3.0 LANGUAGES CXX)\n")
        self.write("CITATION.cff", "cff-version: 1.2.0\nversion: 0.3.0\n")
        self.assertEqual([], self.wrong("text\n"))
        self.write("CITATION.cff", "cff-version: 1.2.0\nversion: 0.2.0\n")
        self.assertRegex(self.wrong("text\n")[0], "CITATION.cff:1: cites another version than 0.3.0")

    def test_refuses_blocks_that_mkdocs_shows_as_text(self):
        self.assertEqual([], self.wrong("# Here\n- a\n- b\n  c\n- d\n\ntext\n\n1. a\n\n| a |\n|---|\n| b |\n"))
        self.assertRegex(self.wrong("text\n- a\n")[0], "README.md:2: a list or table needs an empty line")
        self.assertRegex(self.wrong("- a\n\ntext\n- b\n")[0], "README.md:4: a list")
        self.assertRegex(self.wrong("text\n| a |\n|---|\n")[0], "README.md:2: a list or table")

    def test_refuses_promises_without_a_test_that_exists(self):
        self.write("tests/unit/CMakeLists.txt", "weft_test(unit SOURCES test_a.cpp\n  LIBRARIES x)\n"
                                                "add_test(NAME long.kills COMMAND x)\nadd_test(NAME laws.${kind} COMMAND x)\n")
        self.write("tests/unit/test_a.cpp", "TEST(Folder, IsKept) {}\nTEST_F(Folder,\n       IsFound) {}\n")
        head = "# Trust\n\n| promise | test |\n|---|---|\n"

        def wrong(row):
            return self.wrong(head + row + "\n", "docs/trust.md")

        self.assertEqual([], wrong("| a | `unit`: `Folder.IsKept`, `Folder.IsFound`; `long.kills` |"))
        self.assertEqual([], wrong("| a | `unit`: `Folder.*` |"))
        self.assertEqual([], wrong("| a | `laws.simulator`; all of it: `tests/unit/test_a.cpp` |"))
        self.assertRegex(wrong("| a | `unit`: `Folder.IsLost` |")[0], r"trust\.md:5: names the test unit: Folder\.IsLost")
        self.assertRegex(wrong("| a | `apps`: `Folder.IsKept` |")[0], "apps: Folder.IsKept, which does not exist")
        self.assertRegex(wrong("| a | `long.saves` |")[0], "does not exist")
        self.assertRegex(wrong("| a `b.c` | by hand |")[0], "without a test")

    def test_refuses_a_long_readme(self):
        self.assertEqual([], self.wrong("a\n" * 90))
        self.assertRegex(self.wrong("a\n" * 91)[0], "91 lines")


class Quotes(unittest.TestCase):
    SOURCE = "int a;\nint b;\n\nint c;\nint d;\n"

    def run_on(self, quote, block):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            (root / "x.cpp").write_text(self.SOURCE)
            (root / "page.md").write_text(f"<!-- quote: {quote} -->\n```cpp\n{block}```\n")
            command = [CMAKE, f"-DROOT={root}", "-DGUIDE=page.md", "-P", str(QUOTES)]
            return subprocess.run(command, capture_output=True, text=True, check=False).returncode

    def test_whole_files(self):
        self.assertEqual(0, self.run_on("x.cpp", self.SOURCE))
        self.assertNotEqual(0, self.run_on("x.cpp", self.SOURCE + "int e;\n"))

    def test_parts(self):
        self.assertEqual(0, self.run_on('x.cpp from "nt b" to "int c"', "int b;\n\nint c;\n"))
        self.assertEqual(0, self.run_on('x.cpp from "int b" to "int b"', "int b;\n"))
        self.assertNotEqual(0, self.run_on('x.cpp from "int b" to "int c"', "int b;\nint c;\n"))
        self.assertNotEqual(0, self.run_on('x.cpp from "int b" to "int a"', "int b;\n"))
        self.assertNotEqual(0, self.run_on('x.cpp from "int e" to "int a"', ""))


if __name__ == "__main__":
    unittest.main()
