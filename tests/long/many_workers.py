#!/usr/bin/env python3
"""Many weft processes share one sweep while processes are killed at random: many_workers.py WEFT [options]

Starts --processes times the same `weft ablate` on one folder, kills -9 a random one of them, or of the children that
they started, --kills times, and starts another in its place. In the end every cell must have one row, and every row
must hold the numbers of a run that nobody disturbed. With the same --seed the same moments and victims are chosen; what
they are doing at that moment differs from run to run.

The full test, about five minutes on two cores:  many_workers.py build/release/bin/weft --processes 8 --cells 200 --kills 40
CI runs a smaller one. Exit code 0: all rows are there and right; 1: they are not.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fault_kit import TASK, ablation


def children_of(pid):
    """The processes that a process has started and that live."""
    found = []
    try:
        for task in os.listdir(f"/proc/{pid}/task"):
            found += map(int, Path(f"/proc/{pid}/task/{task}/children").read_text().split())
    except OSError:
        pass  # it has ended
    return found


def rows_of(folder):
    """{file name: (status, what a clock did not decide)} of the rows of a sweep."""
    rows = {}
    for file in sorted((folder / "cells").glob("*.json")):
        if file.name.endswith(".times.json"):
            continue
        row = json.loads(file.read_text())
        numbers = {name: value for name, value in row["metrics"].items() if "seconds" not in name}
        rows[file.name] = (row["status"], row["paired_by"], numbers)
    return rows


def ablate(weft, file, out, *options, jobs=1):
    command = [weft, "ablate", str(file), "--out", str(out), "--quiet", "--jobs", str(jobs), *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def disturb(options, file, out, dice):
    """Runs the processes, kills some, and returns when the sweep is done."""
    crew = [ablate(options.weft, file, out) for _ in range(options.processes)]
    kills = 0
    while kills < options.kills:
        time.sleep(dice.uniform(*options.pause))
        crew = [one for one in crew if one.poll() is None]
        if not crew:
            break  # the sweep was done before all kills
        victim = dice.choice(crew)
        family = children_of(victim.pid)
        target = dice.choice(family) if family and dice.random() < 0.5 else victim.pid
        try:
            os.kill(target, signal.SIGKILL)
            kills += 1
        except ProcessLookupError:
            continue
        if target == victim.pid:
            victim.wait()
            crew.append(ablate(options.weft, file, out))
    for one in crew:
        one.communicate()
    return kills


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weft")
    parser.add_argument("--processes", type=int, default=8)
    parser.add_argument("--cells", type=int, default=200)
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--pause", type=float, nargs=2, default=(0.2, 2.0), metavar="S", help="between two kills")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    options.weft = str(Path(options.weft).resolve())
    dice = random.Random(options.seed)
    with tempfile.TemporaryDirectory(prefix="weft-workers-") as name:
        folder = Path(name)
        (folder / "task.yaml").write_text(TASK)
        file = folder / "ablation.yaml"
        file.write_text(ablation(options.cells // 2))
        cells = options.cells // 2 * 2

        calm = ablate(options.weft, file, folder / "calm", jobs=os.cpu_count())
        _, errors = calm.communicate()
        if calm.returncode != 0:
            print(f"the undisturbed sweep failed with {calm.returncode}: {errors}")
            return 1
        started = time.monotonic()
        kills = disturb(options, file, folder / "shared", dice)
        # A cell whose processes were killed three times is lost, and is asked for again.
        last = ablate(options.weft, file, folder / "shared", "--retry-failed")
        _, errors = last.communicate()
        print(f"{options.processes} processes, {cells} cells, {kills} kills, {time.monotonic() - started:.0f} s")

        expected, found = rows_of(folder / "calm"), rows_of(folder / "shared")
        problems = []
        if last.returncode != 0:
            problems.append(f"the last process ended with {last.returncode}: {errors}")
        if len(expected) != cells:
            problems.append(f"the undisturbed sweep has {len(expected)} rows")
        if found.keys() != expected.keys():
            problems.append(f"rows missing: {sorted(expected.keys() - found.keys())}, "
                            f"too many: {sorted(found.keys() - expected.keys())}")
        for row in sorted(found.keys() & expected.keys()):
            if found[row] != expected[row]:
                problems.append(f"{row}: {found[row]}, must be {expected[row]}")
        for other in sorted((folder / "shared").rglob("*")):
            if ".tmp" in other.name or ".claim" in other.name:
                problems.append(f"{other.relative_to(folder)} was left behind")
        for problem in problems:
            print(problem)
        return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
