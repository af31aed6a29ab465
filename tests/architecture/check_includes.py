#!/usr/bin/env python3
"""Checks that the includes of the tree are those that docs/architecture.md allows: check_includes.py ROOT [--table]

The document's table "room | holds | may include" has one row for each room of the framework, one for apps and one for
plugins. This script reads every #include of framework/, apps/ and plugins/ and fails when table and tree differ.
--table prints the third column as the tree has it. Exit code 0: all rules hold; 1: a rule is broken; 2: wrong use.

The rules, each with its own message:
    an include that the table does not allow, and a table entry that no include uses
    a room without a row, a row without a room, a room that README's layout table does not name
    circles between rooms, and between files
    a contract header (framework/include/weft) that includes another file of ours than weft/...
    a plugin that includes another plugin, or anything but weft/... and its own files
    a source without the header of its name, or a header without its source, unless the document lists it
    an include of ours in angle brackets, or of a file that does not exist
"""

import re
import sys
from collections import defaultdict
from pathlib import Path

DOCUMENT = "docs/architecture.md"
CONTRACT = "weft"  # the room framework/include/weft, under the name that its includes begin with
SUFFIXES = {".hpp", ".cpp", ".h", ".inc"}
INCLUDE_FOLDERS = ("framework/include", "framework", "plugins", "apps", "tests", "")
GENERATED = {"weft_commit.hpp"}  # written by the build


def room_of(file):
    """The row of the table that a file belongs to: a room of the framework, apps, plugins; its path is from the root."""
    parts = file.parts
    if parts[0] != "framework":
        return parts[0]
    return CONTRACT if parts[:3] == ("framework", "include", "weft") else parts[1]


def plugin_of(file):
    return file.parts[:3]  # plugins/KIND/NAME


class Tree:
    """The sources of a tree and what they include."""

    def __init__(self, root):
        self.root = root
        self.files = sorted(
            path.relative_to(root)
            for folder in ("framework", "apps", "plugins")
            for path in (root / folder).rglob("*")
            if path.suffix in SUFFIXES and path.is_file() and len(path.relative_to(root).parts) > 2)
        self.rooms = sorted({room_of(file) for file in self.files if file.parts[0] == "framework"})
        self.includes = defaultdict(list)  # file -> [(line, file of ours)]
        self.problems = []
        for file in self.files:
            self._read(file)

    def _read(self, file):
        for number, line in enumerate((self.root / file).read_text(encoding="utf-8").splitlines(), 1):
            match = re.match(r'\s*#\s*include\s*([<"])([^>"]+)[>"]', line)
            if not match:
                continue
            bracket, name = match.groups()
            target = self._find(file, name, bracket == '"')
            if bracket == "<" and target:
                self.problems.append(f'{file}:{number}: <{name}> is a file of ours, write "{name}"')
            elif bracket == '"' and not target and name not in GENERATED:
                self.problems.append(f'{file}:{number}: "{name}" is not a file of this tree')
            if target:
                self.includes[file].append((number, target))

    def _find(self, file, name, beside):
        """The included file, its path from the root, or None where it is not ours."""
        folders = [file.parent] if beside else []
        for folder in folders + [Path(folder) for folder in INCLUDE_FOLDERS]:
            path = (self.root / folder / name).resolve()
            if path.is_file() and path.is_relative_to(self.root):
                return path.relative_to(self.root)
        return None

    def edges(self):
        """{(room, included room): first place that includes it}, without what a room includes of itself."""
        edges = {}
        for file in self.files:
            for number, target in self.includes[file]:
                pair = (room_of(file), room_of(target))
                if pair[0] != pair[1]:
                    edges.setdefault(pair, f"{file}:{number}")
        return edges


def circle(graph):
    """Some path that returns to where it began, or an empty list."""
    state = {}  # node -> 1: on the path, 2: done

    def walk(node, path):
        state[node] = 1
        for follower in sorted(graph.get(node, ())):
            if state.get(follower) == 1:
                return path[path.index(follower):] + [follower]
            if follower not in state:
                found = walk(follower, path + [follower])
                if found:
                    return found
        state[node] = 2
        return []

    for node in sorted(graph):
        if node not in state:
            found = walk(node, [node])
            if found:
                return found
    return []


def levels(rooms, edges):
    """Length of the longest chain of rooms, each of which includes the next. Asks for a graph without circles."""
    below = {room: [other for first, other in edges if first == room and other in rooms] for room in rooms}

    def height(room):
        return 1 + max((height(other) for other in below[room]), default=0)

    return max(map(height, rooms), default=0)


def code_words(cell):
    return re.findall(r"`([^`]+)`", cell)


class Document:
    """What docs/architecture.md says: the table, the files that stand alone, the count of rooms, levels and edges."""

    def __init__(self, text):
        self.allowed = {}  # row -> [rooms]
        self.problems = []
        inside = False
        for line in text.splitlines():
            cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
            if cells == ["room", "holds", "may include"]:
                inside = True
            elif not line.startswith("|"):
                inside = False
            elif inside and code_words(cells[0]):
                name = code_words(cells[0])[0]
                if name in self.allowed:
                    self.problems.append(f"{DOCUMENT}: two rows for {name}")
                self.allowed[name] = code_words(cells[2]) if len(cells) > 2 else []
        if not self.allowed:
            self.problems.append(f"{DOCUMENT}: the table | room | holds | may include | is missing")
        self.alone = set(re.findall(r"^- `(framework/[^`]+)`: ", text, re.M))
        count = re.search(r"(\d+) rooms, (\d+) levels, (\d+) edges", text)
        self.count = tuple(map(int, count.groups())) if count else None


def check_table(tree, document):
    edges = tree.edges()
    rows = set(tree.rooms) | {"apps", "plugins"}
    for room in sorted(rows - set(document.allowed)):
        yield f"{DOCUMENT}: the table has no row for {room}"
    for row in sorted(set(document.allowed) - rows):
        yield f"{DOCUMENT}: the table has a row for {row}, which is not a room of this tree"
    for (room, other), place in sorted(edges.items()):
        if other not in document.allowed.get(room, []):
            yield f"{place}: {room} includes {other}, which the table in {DOCUMENT} does not allow"
    for room, others in sorted(document.allowed.items()):
        for other in others:
            if (room, other) not in edges:
                yield f"{DOCUMENT}: the table allows {room} to include {other}, which no file does"


def check_circles(tree):
    graph = defaultdict(set)
    for room, other in tree.edges():
        graph[room].add(other)
    found = circle(graph)
    if found:
        yield f"the rooms include one another in a circle: {' -> '.join(found)}"
    files = {file: {target for _, target in tree.includes[file]} for file in tree.files}
    found = circle(files)
    if found:
        yield f"files include one another in a circle: {' -> '.join(map(str, found))}"


def check_count(tree, document):
    edges = [(room, other) for room, other in tree.edges() if room in tree.rooms and other in tree.rooms]
    there = (len(tree.rooms), levels(tree.rooms, edges), len(edges))
    if document.count != there:
        said = "{} rooms, {} levels, {} edges".format(*document.count) if document.count else "no such count"
        yield f"{DOCUMENT} says {said}; the tree has {there[0]} rooms, {there[1]} levels, {there[2]} edges"


def check_contract_and_plugins(tree):
    for file in tree.files:
        for number, target in tree.includes[file]:
            if room_of(file) == CONTRACT and room_of(target) != CONTRACT:
                yield f"{file}:{number}: a header of the contract includes {target}, which plugins do not have"
            if room_of(file) != "plugins" or room_of(target) == CONTRACT:
                continue
            if room_of(target) != "plugins":
                yield f"{file}:{number}: a plugin includes {target}; it may include weft/... and its own files"
            elif plugin_of(file) != plugin_of(target):
                yield f"{file}:{number}: a plugin includes another plugin: {target}"


def check_pairs(tree, document):
    """One header, one source: sdk/NAME.cpp and weft/NAME.hpp, in the other rooms NAME.cpp and NAME.hpp side by side."""
    files = set(tree.files)
    for file in sorted(file for file in files if file.parts[0] == "framework"):
        header = file.suffix == ".hpp"
        if not header and file.suffix != ".cpp":
            continue
        partners = [file.with_suffix(".cpp" if header else ".hpp")]
        if room_of(file) == CONTRACT:
            # A header that exports nothing has no source: it holds interfaces, plain data and inline functions alone.
            text = (tree.root / file).read_text(encoding="utf-8")
            if not re.search(r"\bWEFT_API\b", re.sub(r"//.*|#define(?:.*\\\n)*.*", "", text)):
                continue
            partners = [Path("framework/sdk") / file.with_suffix(".cpp").name]
        elif file.parts[1] == "sdk" and not header:
            partners.append(Path("framework/include/weft") / file.with_suffix(".hpp").name)
        lonely = not any(partner in files for partner in partners)
        listed = str(file) in document.alone
        if lonely and not listed:
            kind = "source" if header else "header"
            yield f"{file}: has no {kind} of its name ({partners[-1]}), and {DOCUMENT} does not list it as standing alone"
        if listed and not lonely:
            yield f"{DOCUMENT}: lists {file} as standing alone, but there is {partners[-1]}"
    for name in sorted(document.alone - {str(file) for file in files}):
        yield f"{DOCUMENT}: lists {name} as standing alone, which does not exist"


def check_readme(tree):
    """README's layout table names every room in its rows about framework/, and no other."""
    text = (tree.root / "README.md").read_text(encoding="utf-8")
    section = re.search(r"^## Layout\n(.*?)(?=^## |\Z)", text, re.M | re.S)
    rows = [line for line in section.group(1).splitlines() if line.startswith("| `framework/")] if section else []
    if not rows:
        yield "README.md: the section Layout has no table row that begins with `framework/`"
        return
    named = {word.rstrip("/").removeprefix("framework").strip("/").removeprefix("include/")
             for row in rows for word in code_words(row) if word.endswith("/")} - {""}
    for room in tree.rooms:
        if room not in named:
            yield f"README.md: the layout table does not name the room {room}"
    for name in sorted(named - set(tree.rooms)):
        yield f"README.md: the layout table names {name}, which is not a room of this tree"


def check(root):
    """All broken rules of a tree, as messages."""
    tree = Tree(root)
    file = root / DOCUMENT
    if not file.is_file() or not (root / "README.md").is_file() or not tree.files:
        return [f"{root} is not a source tree of weft: it lacks {DOCUMENT}, README.md or sources"]
    document = Document(file.read_text(encoding="utf-8"))
    circles = list(check_circles(tree))
    problems = tree.problems + document.problems + list(check_table(tree, document)) + circles
    if not circles:
        problems += check_count(tree, document)
    problems += check_contract_and_plugins(tree)
    problems += check_pairs(tree, document)
    problems += check_readme(tree)
    return problems


def main(arguments):
    options = [word for word in arguments if word.startswith("-")]
    folders = [word for word in arguments if not word.startswith("-")]
    if len(folders) != 1 or any(option != "--table" for option in options):
        print(__doc__, file=sys.stderr)
        return 2
    root = Path(folders[0]).resolve()
    if options:
        tree = Tree(root)
        others = defaultdict(list)
        for room, other in sorted(tree.edges()):
            others[room].append(f"`{other}`")
        for room in tree.rooms + ["apps", "plugins"]:
            print(f"| `{room}` | ... | {', '.join(others[room])} |")
        return 0
    problems = check(root)
    for problem in problems:
        print(problem)
    print(f"{len(problems)} broken rules" if problems else "table and tree agree")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
