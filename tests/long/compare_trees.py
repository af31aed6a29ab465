#!/usr/bin/env python3
"""Compares two built trees of weft by the numbers that they compute: a change of structure must not change a digit.

    tests/long/compare_trees.py BASE_BUILD NEW_BUILD OUT [--only seeds,estimate] [--run NAME] [--module M.pt]
    tests/long/compare_trees.py BASE_BUILD OUT --base-only      computes the numbers of the first tree ahead of time

BASE_BUILD and NEW_BUILD are build folders with bin/weft; each tree uses the configs and the model of its own sources.
Pieces:
    seeds     the five sessions of the README's table
    estimate  three of them with knowledge=estimate
    plugins   one session for every plugin that `seeds` does not use
    examples  64 examples of `weft generate`
    training  200 iterations of `weft train` on those examples
    physics   physics.csv of `weft evaluate physics`
A tree's results are kept in OUT/base and OUT/new and used again while its program, libraries and configs stay the same,
so a comparison that was interrupted goes on where it stopped. The commands run one after the other.

Compared are values: every number of a JSON file, every cell of a CSV file, every dataset of an HDF5 file. Left out is
what may differ between equal runs (seconds) or trees (commit, saved config, identity of a dataset). Something that only
the new tree writes is named but does not count as a difference. The table goes to stdout and to OUT/comparison.txt.
Exit code 0: all equal; 1: something differs or failed; 2: wrong use. Needs h5ls and h5diff (Debian: hdf5-tools).
"""

import argparse
import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

PIECES = ("seeds", "estimate", "plugins", "examples", "training", "physics")
# Text that names the tree or its config, not a result. A checksum covers them.
LEFT_OUT_OF_HDF5 = {"config", "provenance", "summary", "training", "checksum", "identity", "dataset", "identities"}
# In training.json, what depends on the machine or names the dataset.
LEFT_OUT_OF_JSON = {"iterations_per_s", "threads", "dataset"}


NETWORK_TASK = "tshirt_fold_network.yaml"


def older(task):
    """The task file of a tree from before NETWORK_TASK, where it does not have that."""
    return task if Path(task).exists() else task.replace(NETWORK_TASK, "tshirt_fold.yaml")


@dataclass
class Run:
    """One command of weft and the files of its output folder to compare."""

    piece: str
    name: str
    command: list  # {configs}: the tree's configs folder; {runs}: the folder with all runs of this tree
    files: list  # patterns in the output folder
    out: str = ""  # file in the output folder to give as --out; empty: the folder
    needs: str = ""  # name of a run whose results this one reads
    skip: str = ""  # why it cannot run

    @property
    def key(self):
        return f"{self.piece}-{self.name}"


def session(piece, name, seed, *settings, task=NETWORK_TASK):
    command = ["run", "{configs}/tasks/" + task, "--seed", str(seed)]
    for setting in settings:
        command += ["--set", setting]
    return Run(piece, name, command, ["summary.json", "session.h5"])


def all_runs(module):
    runs = [session("seeds", str(seed), seed) for seed in range(5001, 5006)]
    runs += [session("estimate", str(seed), seed, "knowledge=estimate") for seed in range(5001, 5004)]
    runs += [
        session("plugins", "bullet", 5001, "simulator=bullet"),
        session("plugins", "spline", 5001, "trajectory={plugin: spline, params: {control_points: 6}}"),
        session("plugins", "ceres", 5001, "optimiser={plugin: ceres, params: {method: lbfgs}}"),
        session("plugins", "nlopt", 5001, "optimiser={plugin: nlopt, params: {algorithm: MMA}}"),
        session("plugins", "mppi", 5001, "optimiser={plugin: mppi, params: {method: mppi, samples: 8}}",
                "planning.iterations=20", "planning.replan_iterations=5"),
        session("plugins", "rollout", 5001, "planning.iterations=1", task="tshirt_fold_simulator.yaml"),
        session("plugins", "torchscript", 5001, "predictor={plugin: torchscript, params: {module: '" + module + "'}}"),
    ]
    if not module:
        runs[-1].skip = "no module given (--module)"
    experiment = "{configs}/experiments/tshirt.yaml"
    runs += [
        Run("examples", "64", ["generate", experiment, "--examples", "64"], ["shard-*.h5"]),
        Run("training", "200", ["train", experiment, "--data", "{runs}/examples-64", "--set",
                                "predictor.params.training.iterations=200"], ["model.h5", "training.json"], "model.h5", "examples-64"),
        Run("physics", "suite", ["evaluate", "physics", "{configs}/experiments/physics.yaml"], ["physics.csv"]),
    ]
    return runs


class Tree:
    """A built tree, and the folder that keeps what it computed."""

    def __init__(self, build, folder):
        self.build, self.folder = build.resolve(), folder.resolve()
        self.weft = self.build / "bin" / "weft"
        cache = self.build / "CMakeCache.txt"
        if not self.weft.is_file() or not cache.is_file():
            raise SystemExit2(f"{build} is not a build folder of weft: it has no bin/weft or no CMakeCache.txt")
        source = re.search(r"^CMAKE_HOME_DIRECTORY:INTERNAL=(.*)$", cache.read_text(), re.M)
        self.configs = Path(source.group(1)) / "configs"
        self.state = self._hash()

    def _hash(self):
        """Names this program: its results are used again only while this stays the same."""
        digest = hashlib.sha256()
        files = [self.weft, *sorted(self.build.glob("lib/**/*.so*")), *sorted(self.configs.rglob("*"))]
        for file in files:
            if file.is_file():
                digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
        return digest.hexdigest()

    def run(self, run, jobs):
        """Runs the command unless its results are there. Returns why it failed, or an empty string."""
        out = self.folder / run.key
        words = [word.replace("{configs}", str(self.configs)).replace("{runs}", str(self.folder)) for word in run.command]
        # In older trees the task of the network alone is the default task.
        words = [older(word) if word.endswith(NETWORK_TASK) else word for word in words]
        mark = json.dumps({"program": self.state, "command": words})
        record = out / "made_by.json"
        if record.is_file() and record.read_text() == mark:
            return ""
        if run.needs and not (self.folder / run.needs / "made_by.json").is_file():
            return f"needs {run.needs}, which is not there"
        # Starts from an empty folder, because weft would resume a stopped generation or training.
        part = self.folder / (run.key + ".part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.rmtree(out, ignore_errors=True)
        part.mkdir(parents=True)
        environment = {name: value for name, value in os.environ.items() if not name.startswith("WEFT_")}
        say(f"{self.folder.name}: {run.key}")
        with open(part / "log.txt", "w") as log:
            code = subprocess.run([str(self.weft), *words, "--out", str(part / run.out) if run.out else str(part), "--quiet",
                                   "--jobs", str(jobs)], stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=environment,
                                  preexec_fn=lambda: os.nice(10)).returncode
        if code:
            last = (part / "log.txt").read_text().strip().splitlines()
            return f"{self.folder.name}: exit code {code}: {last[-1] if last else 'no message'}"
        (part / "made_by.json").write_text(mark)
        part.rename(out)
        return ""


@dataclass
class Comparison:
    """The result of comparing the files of one run."""

    compared: int = 0  # numbers and texts
    differences: list = field(default_factory=list)
    missing: list = field(default_factory=list)  # what the new tree does not write; a difference too
    added: list = field(default_factory=list)
    told: str = ""  # the result in a few words

    def names(self, where, base, new):
        """Reports what only one side has; returns what both have, in order."""
        self.missing += [f"{where}{name}: missing in new" for name in base if name not in new]
        self.added += [f"{where}{name}" for name in new if name not in base]
        return [name for name in base if name in new]


def leaves(value, path=""):
    """Every number, text and truth value of a JSON value by its path, without the left-out entries."""
    if isinstance(value, dict):
        for name, item in value.items():
            if "seconds" not in name and name not in LEFT_OUT_OF_JSON:
                yield from leaves(item, f"{path}.{name}" if path else name)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from leaves(item, f"{path}[{index}]")
    else:
        yield path, value


def compare_json(base, new, found):
    sides = [dict(leaves(json.loads(file.read_text()))) for file in (base, new)]
    for path in found.names("", *sides):
        found.compared += 1
        if sides[0][path] != sides[1][path]:
            found.differences.append(f"{path} {sides[0][path]!r} | {sides[1][path]!r}")
    if "error_mm" in sides[0]:
        found.told = f"error_mm {sides[0]['error_mm']!r}"


def compare_csv(base, new, found):
    sides = []
    for file in (base, new):
        with open(file, newline="") as stream:
            sides.append(list(csv.DictReader(stream)))
    if len(sides[0]) != len(sides[1]):
        found.differences.append(f"{base.name}: {len(sides[0])} | {len(sides[1])} rows")
        return
    if not sides[0]:
        return
    # Times are in times.csv, and were here before.
    columns = found.names(f"{base.name} column ",
                          *([column for column in side[0] if "seconds" not in column] for side in sides))
    for index, rows in enumerate(zip(*sides)):
        for column in columns:
            found.compared += 1
            if rows[0][column] != rows[1][column]:
                found.differences.append(f"{base.name} row {index + 1} {column} {rows[0][column]} | {rows[1][column]}")
    found.told = found.told or f"{len(sides[0])} rows"


def datasets(file):
    """Shape of every dataset of an HDF5 file that is compared, by its path, such as {"/final_shape": [965, 3]}."""
    listed = subprocess.run(["h5ls", "-r", str(file)], capture_output=True, text=True, check=True).stdout
    shapes = {}
    for line in listed.splitlines():
        match = re.match(r"(/.*?) +Dataset \{(.*)\}$", line)
        if match and not LEFT_OUT_OF_HDF5 & set(match.group(1).split("/")):
            text = match.group(2).replace("SCALAR", "1")
            shapes[match.group(1)] = [int(size.split("/")[0]) for size in text.split(", ")]
    return shapes


def largest_difference(base, new, path):
    """The largest |base - new| of a dataset, both values written out as h5diff prints them."""
    report = subprocess.run(["h5diff", "-r", str(base), str(new), path], capture_output=True, text=True).stdout
    rows = re.findall(r"^\[.*\] +(\S+) +(\S+) +(\S+)\s*$", report, re.M)
    if not rows:
        return ""
    row = max(rows, key=lambda row: float(row[2]))
    return f", by at most {row[2]} ({row[0]} | {row[1]})"


def compare_hdf5(base, new, found):
    sides = [datasets(base), datasets(new)]
    common = found.names(f"{base.name} ", *sides)
    equal_shape = []
    for path in common:
        if sides[0][path] != sides[1][path]:
            found.differences.append(f"{base.name} {path}: shape {sides[0][path]} | {sides[1][path]}")
        else:
            equal_shape.append(path)
    excluded = ["--exclude-path", "/none"]
    for file in (base, new):
        every = subprocess.run(["h5ls", "-r", str(file)], capture_output=True, text=True, check=True).stdout
        for path in re.findall(r"^(/.*?) +Dataset", every, re.M):
            if path not in equal_shape:
                excluded += ["--exclude-path", path]
    answer = subprocess.run(["h5diff", "-v", *excluded, str(base), str(new)], capture_output=True, text=True)
    counts = dict(re.findall(r"^dataset: <(.*?)> and <.*?>\n(?:.*\n)*?(\d+) differences found", answer.stdout, re.M))
    for path in equal_shape:
        numbers = 1
        for size in sides[0][path]:
            numbers *= size
        if path not in counts:
            found.differences.append(f"{base.name} {path}: h5diff does not compare it: {answer.stderr.strip()}")
            continue
        found.compared += numbers
        if counts[path] != "0":
            found.differences.append(
                f"{base.name} {path}: {counts[path]} of {numbers} differ{largest_difference(base, new, path)}")


COMPARE = {".json": compare_json, ".csv": compare_csv, ".h5": compare_hdf5}


def compare_runs(run, base, new):
    found = Comparison()
    for pattern in run.files:
        sides = [sorted(file.name for file in folder.glob(pattern)) for folder in (base, new)]
        for name in found.names("file ", *sides):
            COMPARE[Path(name).suffix](base / name, new / name, found)
    if not found.compared and not found.differences and not found.missing:
        found.differences.append(f"nothing to compare: no {' or '.join(run.files)}")
    return found


class SystemExit2(Exception):
    """Wrong use: exit code 2."""


def say(text):
    print(text, file=sys.stderr, flush=True)


def rows_of(run, base, new, options):
    """The lines of the table about one run, and whether they are good news."""
    head = f"{run.piece:<9} {run.name:<12} "
    if run.skip:
        return [head + f"skipped  {run.skip}"], True
    for tree in (base, new):
        why = tree.run(run, options.jobs) if tree else ""
        if why:
            return [head + f"FAILED   {why}"], False
    if not new:
        return [head + "made"], True
    found = compare_runs(run, base.folder / run.key, new.folder / run.key)
    lines = []
    wrong = found.differences + found.missing
    if wrong:
        count = len(wrong)
        lines.append(head + f"DIFFERS  {count} place{'s' if count > 1 else ''}, the first:")
        lines += [f"            {text}" for text in wrong[:12]]
    else:
        lines.append(head + f"equal    {found.compared} values{', ' + found.told if found.told else ''}")
    if found.added:
        lines.append(f"            only in new: {', '.join(found.added[:8])}{' ...' if len(found.added) > 8 else ''}")
    return lines, not wrong


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="BASE_BUILD NEW_BUILD OUT, or BASE_BUILD OUT")
    parser.add_argument("--only", default=",".join(PIECES), help="pieces, separated by commas; default: all")
    parser.add_argument("--run", default="", help="only the run of this name, such as 5001 or bullet")
    parser.add_argument("--base-only", action="store_true", help="compute the base's results and compare nothing")
    parser.add_argument("--module", default="", help="module file for the session with predictor torchscript")
    parser.add_argument("--jobs", type=int, default=0, help="threads of each command; 0: all that it may use")
    options = parser.parse_args(arguments)
    pieces = options.only.split(",")
    try:
        wrong = [piece for piece in pieces if piece not in PIECES]
        if wrong:
            raise SystemExit2(f"no piece is called {wrong[0]}; pieces: {', '.join(PIECES)}")
        if len(options.folders) != (2 if options.base_only else 3):
            raise SystemExit2("give BASE_BUILD NEW_BUILD OUT, or with --base-only BASE_BUILD OUT")
        for program in ("h5ls", "h5diff"):
            if not shutil.which(program):
                raise SystemExit2(f"{program} is missing (Debian: hdf5-tools)")
        runs = [run for run in all_runs(options.module) if run.piece in pieces and options.run in ("", run.name)]
        if not runs:
            raise SystemExit2(f"no run of {options.only} is called {options.run}")
        out = options.folders[-1]
        base = Tree(options.folders[0], out / "base")
        new = None if options.base_only else Tree(options.folders[1], out / "new")
    except SystemExit2 as problem:
        say(f"compare_trees: {problem}")
        return 2
    out.mkdir(parents=True, exist_ok=True)
    good = True
    with open(out / ("base.txt" if options.base_only else "comparison.txt"), "w") as table:
        for run in runs:
            lines, fine = rows_of(run, base, new, options)
            good = good and fine
            for line in lines:
                print(line, flush=True)
                print(line, file=table, flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
