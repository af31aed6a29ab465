#!/usr/bin/env python3
"""Links, anchors and names of files in the documents lead somewhere, in the source tree and in an installed one.

Usage: check_documents.py ROOT

- A link leads to a file that is installed with the documents (cmake/WeftInstall.cmake); sources are named as code.
- An anchor is a heading of its target, under the rule of GitHub and under that of mkdocs.
- A path of the source tree that is written as code exists. `weft/X.hpp` is a header of the contract, `room/X` a file
  of a room of framework/. Words in capitals (KIND, NAME) and <...> stand for something.
- Where a path stands beside a name, as "`name` in `path`" or "`path` (`name`)", the name occurs in that file.
- An empty line stands before each list and table: mkdocs shows them as text otherwise, though GitHub does not.
- These pages keep their length: README.md, docs/write-a-plugin.md.
- Every row of a table in docs/trust.md that promises something names tests, and these exist: "`PROGRAM`: `Suite.Case`"
  is a gtest case of a program that weft_test() makes, "`folder.name`" alone one of add_test(). A * stands for anything.
- CITATION.cff has the version of the project.
Old records may name what was there then: CHANGELOG.md and docs/measurements/ are checked for links only.
"""
import fnmatch
import pathlib
import re
import sys
import unicodedata

LINK = re.compile(r"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")
SOURCE_FOLDERS = ("apps/", "cmake/", "configs/", "docs/", "framework/", "plugins/", "tests/")
LONGEST = {"README.md": 90, "docs/write-a-plugin.md": 200}  # lines


def documents(root):
    """The Markdown files that are installed."""
    pages = [root / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "MIGRATION.md")]
    pages += sorted((root / "docs").rglob("*.md")) + sorted(root.glob("plugins/*/*/README.md"))
    return [page for page in pages if page.exists()]


def prose(text):
    """The text without fenced and indented blocks, line by line; these lines are left empty."""
    lines, fenced = [], False
    for line in text.split("\n"):
        if line.lstrip().startswith("```"):
            fenced = not fenced
            line = ""
        lines.append("" if fenced or line.startswith("    ") else line)
    return lines


def plain(heading):
    return LINK.sub(r"\1", heading).replace("`", "").replace("*", "")


def anchors(text):
    """The anchors of a page that work on GitHub and on the site alike."""
    github, site = set(), set()
    for line in prose(text):
        if match := re.match(r"#{1,6} +(.*?) *#*$", line):
            title = plain(match[1])
            github.add(re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-"))
            ascii_title = unicodedata.normalize("NFKD", title).encode("ascii", "ignore").decode()
            site.add(re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", ascii_title).strip().lower()))
    return github & site


def check_links(root, page, text, fail):
    installed = {p.resolve() for p in documents(root)} | {(root / "LICENSE").resolve()}
    without_code = re.sub(r"`[^`]*`", lambda code: re.sub(r".", "x", code[0]), "\n".join(prose(text)))
    for match in LINK.finditer(without_code):  # a link may span two lines
        number = without_code.count("\n", 0, match.start()) + 1
        target, _, anchor = match[2].partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        file = (page.parent / target).resolve() if target else page.resolve()
        if not file.exists():
            fail(page, number, f"links to {target}, which does not exist")
        elif file not in installed and (root / "docs").resolve() not in file.parents:
            fail(page, number, f"links to {target}, which is not installed with the documents; write its name as code")
        elif anchor and (file.suffix != ".md" or anchor not in anchors(file.read_text())):
            fail(page, number, f"links to {match[2]}, but no heading there has this anchor")


def source(root, code):
    """The files that a piece of code names; None if it names none."""
    if re.search(r"[^\w./*+-]|//", code) or re.search(r"\b[A-Z]{4,}\b|KIND_|_NAME|cmd_X", code):
        return None
    if code.startswith("weft/") and code.endswith(".hpp"):
        code = "framework/include/" + code
    elif re.match(r"(?!include/)\w+/", code) and (root / "framework" / code.split("/")[0]).is_dir():
        code = "framework/" + code
    if not code.startswith(SOURCE_FOLDERS):
        return None
    return sorted(root.glob(code.rstrip("/")))


def check_names(root, page, text, fail):
    for number, line in enumerate(prose(text), 1):
        for code in re.findall(r"`([^`]+)`", line):
            if source(root, code) == []:
                fail(page, number, f"names {code}, which does not exist")
        pairs = re.findall(r"`([\w:]+)(?:\(\))?` in `([^`]+)`", line)
        pairs += [(name, path) for path, name in re.findall(r"`([^`]+)` \(`([\w:]+)(?:\(\))?`\)", line)]
        for name, path in pairs:
            for file in source(root, path) or []:
                files = [f for f in file.rglob("*") if f.is_file()] if file.is_dir() else [file]
                word = re.compile(r"\b" + re.escape(name.split("::")[-1]) + r"\b")
                if not any(word.search(f.read_text(errors="ignore")) for f in files):
                    fail(page, number, f"looks for {name} in {path}, where it is not")


def check_blocks(page, text, fail):
    before, in_list = "", False
    for number, line in enumerate(prose(text), 1):
        item, table = re.match(r"\s*([-*]|\d+\.) ", line), line.startswith("|")
        free = not before.strip() or before.startswith("#")
        if (item and not free and not in_list) or (table and not free and not before.startswith("|")):
            fail(page, number, "a list or table needs an empty line before it")
        in_list = bool(item) or (in_list and (line.startswith(" ") or not free))
        before = line


def tests(root):
    """The names of all tests: "PROGRAM: Suite.Case" of gtest, and those of add_test() with * for what CMake computes."""
    names = set()
    for lists in sorted((root / "tests").rglob("CMakeLists.txt")) + sorted((root / "cmake").glob("*.cmake")):
        text = lists.read_text()
        names |= {re.sub(r"\$\{\w+\}", "*", name) for name in re.findall(r"add_test\(NAME ([^\s)]+)", text)}
        for program, sources in re.findall(r"weft_test\((\w+) SOURCES ([^)]*)\)", text):
            for source in re.findall(r"[\w/]+\.cpp|\$\{\w+\}", sources):
                files = lists.parent.glob("*.cpp" if source.startswith("$") else source)
                for file in files:
                    for suite, case in re.findall(r"\bTEST(?:_F|_P)?\((\w+),\s*(\w+)\)", file.read_text()):
                        names.add(f"{program}: {suite}.{case}")
    return names


def check_trust(root, page, text, fail):
    known = tests(root)
    for number, line in enumerate(prose(text), 1):
        if not line.startswith("| ") or line.startswith("| promise "):
            continue
        cell = line.rstrip().rstrip("|").rpartition(" | ")[2]
        named, program = 0, ""
        for code, colon in re.findall(r"`([^`]+)`(:?)", cell):
            if colon:
                program = code
            elif re.fullmatch(r"[\w*]+\.[\w*.]+", code) and not code.endswith((".py", ".md", ".yaml")):
                name = f"{program}: {code}" if code[0].isupper() else code
                named += 1
                if not any(fnmatch.fnmatchcase(one, name) or fnmatch.fnmatchcase(name, one) for one in known):
                    fail(page, number, f"names the test {name}, which does not exist")
        if named == 0:
            fail(page, number, "promises something without a test")


def check_citation(root, fail):
    citation, project = root / "CITATION.cff", root / "CMakeLists.txt"
    if citation.exists():
        cited = re.search(r"^version: (\S+)$", citation.read_text(), re.MULTILINE)
        built = re.search(r"^project\(.*VERSION (\S+)", project.read_text(), re.MULTILINE)
        if not cited or cited[1] != built[1]:
            fail(citation, 1, f"cites another version than {built[1]}, the project's")


def check(root):
    """@return what is wrong, one line each, and the number of pages."""
    wrong = []

    def fail(page, number, text):
        wrong.append(f"{page.relative_to(root)}:{number}: {text}")

    check_citation(root, fail)
    pages = documents(root)
    for page in pages:
        text = page.read_text()
        check_links(root, page, text, fail)
        check_blocks(page, text, fail)
        name = page.relative_to(root).as_posix()
        if name != "CHANGELOG.md" and not name.startswith("docs/measurements/"):
            check_names(root, page, text, fail)
        if name == "docs/trust.md":
            check_trust(root, page, text, fail)
        if (lines := text.count("\n")) > LONGEST.get(name, lines):
            fail(page, lines, f"has {lines} lines, at most {LONGEST[name]} are allowed")
    return wrong, len(pages)


if __name__ == "__main__":
    failures, count = check(pathlib.Path(sys.argv[1]).resolve())
    print("\n".join(failures + [f"{count} documents, {len(failures)} errors"]))
    sys.exit(1 if failures or count < 20 else 0)
