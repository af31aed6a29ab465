#!/usr/bin/env python3
"""Tests of compare_trees.py on two trees whose bin/weft copies ready-made results."""

import contextlib
import io
import json
import subprocess
import tempfile
import unittest
from pathlib import Path

import compare_trees

# Pretends to be weft: copies the results of its tree into --out and writes down that it was called.
WEFT = """#!/bin/sh
folder=$(dirname "$0")/..
echo "$*" >> "$folder/calls"
if [ -e "$folder/fails" ]; then echo "error: no plugin is called bullet"; exit 1; fi
while [ "$1" != --out ]; do shift; done
case $2 in
  *.h5) cp "$folder/answers/session.h5" "$2"; echo "{\\"loss\\": 0.5, \\"iterations_per_s\\": $$}" > "$(dirname "$2")/training.json" ;;
  *) cp "$folder"/answers/* "$2" ;;
esac
"""
SUMMARY = {"error_mm": 22.845131628018684, "released": True, "plan_seconds": [1.5], "knowledge": [{"centre": [0.5, 0.25]}]}
PHYSICS = "test,measured,cpu_seconds\nfall,1.25,3\nhang,2.5,4\n"
SHAPES = {"/final_shape": [[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]], "/rounds/000/losses": [[0.25, 0.75]]}


class CompareTrees(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = Path(temporary.name)
        for side in ("base", "new"):
            (self.folder / side / "bin").mkdir(parents=True)
            (self.folder / side / "configs").mkdir()
            (self.folder / side / "answers").mkdir()
            (self.folder / side / "CMakeCache.txt").write_text(f"CMAKE_HOME_DIRECTORY:INTERNAL={self.folder / side}\n")
            weft = self.folder / side / "bin" / "weft"
            weft.write_text(WEFT)
            weft.chmod(0o755)
            self.answer(side)

    def answer(self, side, summary=SUMMARY, physics=PHYSICS, shapes=SHAPES):
        """Sets what the program of a tree computes."""
        answers = self.folder / side / "answers"
        (answers / "summary.json").write_text(json.dumps(summary))
        (answers / "physics.csv").write_text(physics)
        words = []
        for number, (path, rows) in enumerate(shapes.items()):
            text = self.folder / f"{number}.txt"
            text.write_text("\n".join(" ".join(map(repr, row)) for row in rows) + "\n")
            words += [str(text), "-dims", f"{len(rows)},{len(rows[0])}", "-path", path, "-type", "TEXTFP", "-size", "64"]
        for name in ("session.h5", "shard-00000.h5"):
            (answers / name).unlink(missing_ok=True)  # h5import adds to a file that is there
            subprocess.run(["h5import", *words, "-o", str(answers / name)], check=True, capture_output=True)

    def compare(self, *options, code):
        """Runs the comparison, expects an exit code and returns the table."""
        table, log = io.StringIO(), io.StringIO()
        folders = ["base", "out"] if "--base-only" in options else ["base", "new", "out"]
        with contextlib.redirect_stdout(table), contextlib.redirect_stderr(log):
            got = compare_trees.main([str(self.folder / name) for name in folders] + list(options))
        self.assertEqual(got, code, table.getvalue() + log.getvalue())
        return table.getvalue() or log.getvalue()

    def calls(self, side):
        file = self.folder / side / "calls"
        return file.read_text().splitlines() if file.exists() else []

    def test_equal_trees(self):
        table = self.compare(code=0)
        self.assertEqual(table.count(" equal "), 17, table)
        self.assertIn("seeds     5001         equal    12 values, error_mm 22.845131628018684\n", table)
        self.assertIn("plugins   torchscript  skipped  no module given (--module)\n", table)
        self.assertIn("training  200          equal    9 values\n", table)
        self.assertIn("physics   suite        equal    4 values, 2 rows\n", table)
        self.assertEqual((self.folder / "out" / "comparison.txt").read_text(), table)
        self.assertEqual(len(self.calls("new")), 17)
        self.assertTrue(self.calls("new")[0].startswith(
            f"run {self.folder}/new/configs/tasks/tshirt_fold.yaml --seed 5001 --out "), self.calls("new")[0])
        training = [call for call in self.calls("new") if call.startswith("train ")]
        self.assertIn(f"--data {self.folder.resolve()}/out/new/examples-64 ", training[0])

    def test_seconds_do_not_count(self):
        self.answer("new", summary={**SUMMARY, "plan_seconds": [9.0, 9.0]}, physics=PHYSICS.replace(",3", ",5"))
        self.compare("--only", "seeds,physics", code=0)

    def test_one_digit_of_a_summary(self):
        self.answer("new", summary={**SUMMARY, "error_mm": 22.845131628018688})
        table = self.compare("--only", "seeds", "--run", "5002", code=1)
        self.assertEqual(table, "seeds     5002         DIFFERS  1 place, the first:\n"
                                "            error_mm 22.845131628018684 | 22.845131628018688\n")

    def test_one_number_of_a_dataset(self):
        self.answer("new", shapes={**SHAPES, "/final_shape": [[1.5, 2.5, 3.5], [4.5, 5.5, 6.75]]})
        table = self.compare("--only", "examples", code=1)
        self.assertIn("shard-00000.h5 /final_shape: 1 of 6 differ, by at most 0.25 (6.5 | 6.75)", table)

    def test_the_last_bit_of_a_dataset(self):
        self.answer("new", shapes={**SHAPES, "/rounds/000/losses": [[0.25, 0.75 + 2.0**-53]]})
        self.assertIn("/rounds/000/losses: 1 of 2 differ", self.compare("--only", "examples", code=1))

    def test_another_shape(self):
        self.answer("new", shapes={**SHAPES, "/final_shape": [[1.5, 2.5, 3.5]]})  # one row less
        self.assertIn("/final_shape: shape [2, 3] | [1, 3]", self.compare("--only", "examples", code=1))

    def test_what_only_one_tree_has(self):
        more = {**SHAPES, "/goal": [[1.0, 2.0]]}
        self.answer("new", shapes=more, summary={**SUMMARY, "ended": "converged"})
        table = self.compare("--only", "seeds", "--run", "5001", code=0)
        self.assertIn("only in new: ended, session.h5 /goal", table)
        self.answer("new")
        self.answer("base", shapes=more)
        for side in ("base", "new"):  # other answers of the same program: forget what it computed
            (self.folder / side / "configs" / "changed.yaml").write_text("again")
        self.assertIn("session.h5 /goal: missing in new", self.compare("--only", "seeds", "--run", "5001", code=1))

    def test_text_that_names_the_tree_does_not_count(self):
        self.answer("base", shapes={**SHAPES, "/checksum": [[1.0]]})
        self.answer("new", shapes={**SHAPES, "/checksum": [[2.0]]})
        self.compare("--only", "examples", code=0)

    def test_a_cell_of_a_table(self):
        self.answer("new", physics=PHYSICS.replace("1.25", "1.2500000001"))
        self.assertIn("physics.csv row 1 measured 1.25 | 1.2500000001", self.compare("--only", "physics", code=1))
        self.answer("new", physics=PHYSICS + "slide,1,1\n")
        (self.folder / "new" / "configs" / "changed.yaml").write_text("again")
        self.assertIn("physics.csv: 2 | 3 rows", self.compare("--only", "physics", code=1))

    def test_a_command_that_fails(self):
        (self.folder / "new" / "fails").touch()
        table = self.compare("--only", "plugins", "--run", "bullet", code=1)
        self.assertEqual(table, "plugins   bullet       FAILED   new: exit code 1: error: no plugin is called bullet\n")

    def test_a_command_without_results(self):
        for side in ("base", "new"):
            (self.folder / side / "answers" / "physics.csv").unlink()
        self.assertIn("nothing to compare: no physics.csv", self.compare("--only", "physics", code=1))

    def test_results_are_used_again_until_the_tree_changes(self):
        self.compare("--base-only", "--only", "seeds", code=0)
        self.assertEqual((len(self.calls("base")), len(self.calls("new"))), (5, 0))
        self.compare("--only", "seeds", code=0)
        self.compare("--only", "seeds", code=0)
        self.assertEqual((len(self.calls("base")), len(self.calls("new"))), (5, 5))
        library = self.folder / "new" / "lib" / "weft" / "plugins" / "libweft_optimiser_rprop.so"
        library.parent.mkdir(parents=True)
        library.write_text("other code")
        self.compare("--only", "seeds", code=0)
        self.assertEqual((len(self.calls("base")), len(self.calls("new"))), (5, 10))

    def test_an_interrupted_run_is_made_again(self):
        part = self.folder / "out" / "base" / "seeds-5001.part"
        part.mkdir(parents=True)
        (part / "summary.json").write_text("half")
        self.compare("--only", "seeds", "--run", "5001", code=0)
        self.assertFalse(part.exists())

    def test_training_needs_its_examples(self):
        self.assertIn("needs examples-64, which is not there", self.compare("--only", "training", code=1))

    def test_wrong_use(self):
        self.assertIn("no piece is called seed; pieces: seeds", self.compare("--only", "seed", code=2))
        self.assertIn("no run of seeds is called 7", self.compare("--only", "seeds", "--run", "7", code=2))
        (self.folder / "new" / "bin" / "weft").unlink()
        self.assertIn("is not a build folder of weft", self.compare(code=2))


if __name__ == "__main__":
    unittest.main()
