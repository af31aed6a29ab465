#!/usr/bin/env python3
"""Tests of check_includes.py: a small tree that keeps every rule passes, and one violation of each kind is named."""

import contextlib
import io
import tempfile
import unittest
from pathlib import Path

import check_includes

GOOD = {
    "docs/architecture.md": """# Architecture
4 rooms, 3 levels, 4 edges, no circles.

| room | holds | may include |
|---|---|---|
| `weft` | the contract | |
| `sdk` | its sources | `weft` |
| `loader` | finds plugins | `weft` |
| `session` | one fold | `loader`, `weft` |
| `apps` | the commands | `session` |
| `plugins` | engines | `weft` |

| another | table |
|---|---|
| `nothing` | to do with it |

- `framework/session/tables.hpp`: constants alone
""",
    "README.md": """# weft
## Layout
| folder | holds |
|---|---|
| `framework/` | the contract `include/weft/`, its sources `sdk/`; `loader/`, `session/` |
| `apps/` | the commands |
## License
`framework/elsewhere/` does not count.
""",
    "framework/include/weft/types.hpp": "#pragma once\n#include <vector>\nstruct Shape { std::vector<double> p; };\n",
    "framework/include/weft/error.hpp": '#pragma once\n#include "weft/types.hpp"\nWEFT_API void fail(const Shape&);\n',
    "framework/include/weft/plugin.hpp": "#pragma once\n#define WEFT_PLUGIN(name) \\\n  extern \"C\" WEFT_API int name;\n"
                                         "// no WEFT_API is meant here\n",
    "framework/sdk/error.cpp": '#include "weft/error.hpp"\n',
    "framework/loader/registry.hpp": '#pragma once\n#include "weft/error.hpp"\n',
    "framework/loader/registry.cpp": '#include "loader/registry.hpp"\n',
    "framework/session/session.hpp": '#pragma once\n#include "weft/types.hpp"\n',
    "framework/session/session.cpp": '#include "session/session.hpp"\n\n#include "loader/registry.hpp"\n'
                                     '#include "session/tables.hpp"\n',
    "framework/session/tables.hpp": "#pragma once\n",
    "apps/weft/main.cpp": '#include "options.hpp"\n#include "weft_commit.hpp"\n',
    "apps/weft/options.hpp": '#pragma once\n#include "session/session.hpp"\n',
    "plugins/trajectory/arc/arc.hpp": '#pragma once\n#include "weft/types.hpp"\n',
    "plugins/trajectory/arc/arc.cpp": '#include "arc.hpp"\n',
    "plugins/trajectory/spline/spline.cpp": '// #include "arc.hpp" is not an include\n#include "weft/error.hpp"\n',
}


class CheckIncludes(unittest.TestCase):
    def check(self, changes):
        """The messages about the good tree after `changes`, {file: content}; None removes the file."""
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder).resolve()
            for name, content in {**GOOD, **changes}.items():
                if content is None:
                    continue
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                (root / name).write_text(content)
            return check_includes.check(root)

    def expect(self, message, changes):
        """Exactly one message, so that no rule hides behind another."""
        self.assertEqual(self.check(changes), [message])

    def expect_among(self, message, changes):
        self.assertIn(message, self.check(changes))

    def document(self, old, new):
        self.assertIn(old, GOOD["docs/architecture.md"])
        return {"docs/architecture.md": GOOD["docs/architecture.md"].replace(old, new)}

    def test_a_tree_that_keeps_the_rules_passes(self):
        self.assertEqual(self.check({}), [])

    def test_an_edge_that_is_not_in_the_table(self):
        self.expect_among("framework/loader/registry.cpp:2: loader includes session, which the table in "
                          "docs/architecture.md does not allow",
                          {"framework/loader/registry.cpp": '#include "loader/registry.hpp"\n#include "session/tables.hpp"\n'})

    def test_a_relative_path_is_an_edge_too(self):
        self.expect_among("framework/loader/registry.cpp:2: loader includes session, which the table in "
                          "docs/architecture.md does not allow",
                          {"framework/loader/registry.cpp": '#include "registry.hpp"\n#include "../session/tables.hpp"\n'})

    def test_an_edge_of_the_table_that_no_include_uses(self):
        self.expect("docs/architecture.md: the table allows apps to include weft, which no file does",
                    self.document("| `session` |\n| `plugins`", "| `session`, `weft` |\n| `plugins`"))

    def test_a_room_without_a_row(self):
        self.expect_among("docs/architecture.md: the table has no row for meshes", {"framework/meshes/mesher.cpp": "\n"})

    def test_a_row_without_a_room(self):
        self.expect("docs/architecture.md: the table has a row for report, which is not a room of this tree",
                    self.document("| `apps` |", "| `report` | pages | |\n| `apps` |"))

    def test_two_rows_for_a_room(self):
        self.expect("docs/architecture.md: two rows for sdk",
                    self.document("| `apps` |", "| `sdk` | again | `weft` |\n| `apps` |"))

    def test_a_document_without_the_table(self):
        self.expect_among("docs/architecture.md: the table | room | holds | may include | is missing",
                          self.document("| room | holds | may include |", "| room | what it holds | may include |"))

    def test_rooms_in_a_circle_that_the_table_allows(self):
        changes = self.document("| finds plugins | `weft` |", "| finds plugins | `session`, `weft` |")
        changes["framework/loader/registry.cpp"] = '#include "loader/registry.hpp"\n#include "session/tables.hpp"\n'
        self.expect("the rooms include one another in a circle: session -> loader -> session", changes)

    def test_files_in_a_circle(self):
        self.expect("files include one another in a circle: framework/session/session.hpp -> "
                    "framework/session/tables.hpp -> framework/session/session.hpp",
                    {"framework/session/session.hpp": '#pragma once\n#include "weft/types.hpp"\n#include "session/tables.hpp"\n',
                     "framework/session/tables.hpp": '#pragma once\n#include "session/session.hpp"\n'})

    def test_a_wrong_count(self):
        self.expect("docs/architecture.md says 4 rooms, 3 levels, 5 edges; the tree has 4 rooms, 3 levels, 4 edges",
                    self.document("4 edges", "5 edges"))

    def test_no_count(self):
        self.expect("docs/architecture.md says no such count; the tree has 4 rooms, 3 levels, 4 edges",
                    self.document("4 rooms, 3 levels, 4 edges", "few rooms"))

    def test_the_contract_includes_an_innard(self):
        self.expect_among("framework/include/weft/error.hpp:2: a header of the contract includes "
                          "framework/loader/registry.hpp, which plugins do not have",
                          {"framework/include/weft/error.hpp": '#pragma once\n#include "loader/registry.hpp"\nWEFT_API int f();\n',
                           "framework/loader/registry.hpp": "#pragma once\n"})

    def test_a_plugin_includes_another_plugin(self):
        for name in ("../arc/arc.hpp", "trajectory/arc/arc.hpp"):
            self.expect("plugins/trajectory/spline/spline.cpp:1: a plugin includes another plugin: "
                        "plugins/trajectory/arc/arc.hpp",
                        {"plugins/trajectory/spline/spline.cpp": f'#include "{name}"\n'})

    def test_a_plugin_includes_an_innard(self):
        self.expect_among("plugins/trajectory/spline/spline.cpp:1: a plugin includes framework/session/session.hpp; it may "
                          "include weft/... and its own files",
                          {"plugins/trajectory/spline/spline.cpp": '#include "session/session.hpp"\n'})

    def test_a_source_without_its_header(self):
        self.expect("framework/session/replay.cpp: has no header of its name (framework/session/replay.hpp), and "
                    "docs/architecture.md does not list it as standing alone",
                    {"framework/session/replay.cpp": '#include "session/session.hpp"\n'})

    def test_a_source_of_the_contract_without_its_header(self):
        self.expect("framework/sdk/params.cpp: has no header of its name (framework/include/weft/params.hpp), and "
                    "docs/architecture.md does not list it as standing alone",
                    {"framework/sdk/params.cpp": '#include "weft/types.hpp"\n'})

    def test_a_header_without_its_source(self):
        self.expect("framework/session/replay.hpp: has no source of its name (framework/session/replay.cpp), and "
                    "docs/architecture.md does not list it as standing alone",
                    {"framework/session/replay.hpp": "#pragma once\n"})

    def test_a_header_of_the_contract_that_exports_without_its_source(self):
        self.expect("framework/include/weft/types.hpp: has no source of its name (framework/sdk/types.cpp), and "
                    "docs/architecture.md does not list it as standing alone",
                    {"framework/include/weft/types.hpp": "#pragma once\nWEFT_API int count();\n"})

    def test_a_list_of_files_that_has_aged(self):
        self.expect("docs/architecture.md: lists framework/session/tables.hpp as standing alone, but there is "
                    "framework/session/tables.cpp",
                    {"framework/session/tables.cpp": '#include "session/tables.hpp"\n'})
        self.expect("docs/architecture.md: lists framework/session/gone.hpp as standing alone, which does not exist",
                    self.document("- `framework/session/tables.hpp`: constants alone",
                                  "- `framework/session/tables.hpp`: constants alone\n- `framework/session/gone.hpp`: gone"))

    def test_the_readme_lacks_a_room(self):
        self.expect("README.md: the layout table does not name the room loader",
                    {"README.md": GOOD["README.md"].replace("`loader/`, ", "")})

    def test_the_readme_names_a_room_that_is_none(self):
        self.expect("README.md: the layout table names meshes, which is not a room of this tree",
                    {"README.md": GOOD["README.md"].replace("`loader/`, ", "`loader/`, `meshes/`, ")})

    def test_a_readme_without_the_table(self):
        self.expect("README.md: the section Layout has no table row that begins with `framework/`",
                    {"README.md": "# weft\n"})

    def test_angle_brackets_hide_nothing(self):
        self.expect('plugins/trajectory/arc/arc.hpp:1: <weft/types.hpp> is a file of ours, write "weft/types.hpp"',
                    {"plugins/trajectory/arc/arc.hpp": "#include <weft/types.hpp>\n"})

    def test_an_include_that_leads_nowhere(self):
        self.expect('plugins/trajectory/arc/arc.hpp:2: "weft/typos.hpp" is not a file of this tree',
                    {"plugins/trajectory/arc/arc.hpp": '#pragma once\n#include "weft/typos.hpp"\n'})

    def test_a_folder_without_sources_is_refused(self):
        self.assertRegex(self.check({name: None for name in GOOD if name.endswith("pp")})[0], "is not a source tree of weft")

    def test_exit_codes(self):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            self.assertEqual(check_includes.main([]), 2)
            self.assertEqual(check_includes.main(["/", "--tables"]), 2)
            with tempfile.TemporaryDirectory() as folder:
                self.assertEqual(check_includes.main([folder]), 1)


if __name__ == "__main__":
    unittest.main()
