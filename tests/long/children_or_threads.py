#!/usr/bin/env python3
"""What child processes cost against threads: children_or_threads.py WEFT [options]

`weft generate` and `weft ablate` do the same work with child processes, as they do it by default, and with threads
(--in-process), alternating. CPU seconds are those of weft and its children together; both also get the wall time. A pair's
order changes from one to the next. The ratio is that of a pair, children over threads; its median is printed with the lower
and upper quartile. Wall time means nothing on a machine with other work.

Two amounts of work tell a start from what grows with the work: the difference of the two differences, over the units between
them, is what a unit costs more.

The full test, an hour on two idle cores:  children_or_threads.py build/release/bin/weft --pairs 15 --examples 2000 --cells 400
Exit code 0 unless a median CPU ratio of the larger amount is above --limit (1.03), or the results differ: 1.
"""

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fault_kit import CLEAN, ROOT, TASK, ablation, contents


def run(words, folder):
    """@return (CPU seconds, wall seconds) of a command and its children."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    end = subprocess.run(words, cwd=folder, env=CLEAN, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    wall, after = time.monotonic() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if end.returncode != 0:
        raise SystemExit(f"{' '.join(words)} ended with {end.returncode}: {end.stderr}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def pair(words, folder, threads_first):
    """@return ((CPU, wall) of children, of threads, whether both results are the same."""
    times, results = {}, {}
    for name in ("threads", "children") if threads_first else ("children", "threads"):
        times[name] = run([*words, "--out", "out", *(["--in-process"] if name == "threads" else [])], folder)
        results[name] = contents(folder / "out")
        shutil.rmtree(folder / "out")
    return times["children"], times["threads"], results["children"] == results["threads"]


def summary(values):
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return {"median": middle, "lower quartile": low, "upper quartile": high}


def measure(name, words, units, folder, pairs):
    """Runs the pairs of an amount of work. @return its figures."""
    children, threads, same = [], [], True
    for number in range(pairs):
        one, other, equal = pair(words, folder, number % 2 == 0)
        children.append(one)
        threads.append(other)
        same = same and equal
    ratios = [[one[k] / other[k] for one, other in zip(children, threads)] for k in (0, 1)]
    more = statistics.median(one[0] - other[0] for one, other in zip(children, threads))
    figures = {"command": name, "units": units, "pairs": pairs, "equal results": same,
               "CPU s of threads": statistics.median(one[0] for one in threads), "CPU s more": more,
               "CPU ratio": summary(ratios[0]), "wall ratio": summary(ratios[1])}
    print(f"{name:9} {units:6} units, {pairs} pairs: CPU {figures['CPU s of threads']:.2f} s with threads, children "
          f"{more:+.3f} s, ratio {figures['CPU ratio']['median']:.4f} ({figures['CPU ratio']['lower quartile']:.4f} to "
          f"{figures['CPU ratio']['upper quartile']:.4f}); wall ratio {figures['wall ratio']['median']:.4f}"
          f"{'' if same else '; THE RESULTS DIFFER'}", flush=True)
    return figures


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("weft")
    options.add_argument("--pairs", type=int, default=5, help="at least 2")
    options.add_argument("--examples", type=int, default=320, help="of the larger amount; the smaller one is a quarter")
    options.add_argument("--cells", type=int, default=40, help="the same for ablate; a multiple of 8")
    options.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    options.add_argument("--limit", type=float, default=1.03)
    options.add_argument("--json", type=Path, help="write the figures into this file")
    options = options.parse_args()
    weft = str(Path(options.weft).resolve())
    all_figures = []
    with tempfile.TemporaryDirectory(prefix="weft-children-") as name:
        folder = Path(name)
        (folder / "task.yaml").write_text(TASK)
        for share in (4, 1):
            examples, seeds = options.examples // share, options.cells // 2 // share  # two arms
            (folder / "ablation.yaml").write_text(ablation(seeds))
            common = ["--quiet", "--jobs", str(options.jobs)]
            generate = [weft, "generate", str(ROOT / "configs/experiments/towel_small.yaml"), "--examples", str(examples)]
            all_figures += [measure("generate", generate + common, examples, folder, options.pairs),
                            measure("ablate", [weft, "ablate", "ablation.yaml", *common], 2 * seeds, folder, options.pairs)]
    for small, large in zip(all_figures[:2], all_figures[2:]):
        each = (large["CPU s more"] - small["CPU s more"]) / (large["units"] - small["units"])
        print(f"{large['command']:9} {1e3 * each:+.3f} ms of CPU time for each unit, "
              f"{small['CPU s more'] - each * small['units']:+.3f} s for the start")
    if options.json:
        options.json.write_text(json.dumps(all_figures, indent=1) + "\n")
    wrong = [one for one in all_figures[2:] if one["CPU ratio"]["median"] > options.limit]
    return 1 if wrong or not all(one["equal results"] for one in all_figures) else 0


if __name__ == "__main__":
    sys.exit(main())
