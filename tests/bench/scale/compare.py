#!/usr/bin/env python3
"""Runs what simulate.py predicts: compare.py WEFT --processes N --examples N --shard N

So many `weft generate --share` with one thread each make one dataset, on the processors of this machine. Prints what it took
and what the model says from what was measured before: the CPU time of an example and of a start, and what the file system takes.
The model has the processors of this machine, so other work on them makes the run slower than it says.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from measure import file_costs  # noqa: E402
from simulate import Costs, Plan, simulate  # noqa: E402

ALONE = 512  # examples that are measured in one process
ROOT = Path(__file__).resolve().parent.parent.parent.parent


def cpu_of(command, folder, examples):
    """CPU seconds of a command and its children that make the examples of another folder that are missing."""
    words = list(command)
    words[words.index("--examples") + 1], words[words.index("--out") + 1] = str(examples), folder
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(words, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weft")
    parser.add_argument("--config", default=str(ROOT / "configs/experiments/towel_small.yaml"))
    parser.add_argument("--processes", type=int, default=8)
    parser.add_argument("--examples", type=int, default=512)
    parser.add_argument("--shard", type=int, default=8)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="weft-scale-") as name:
        command = [options.weft, "generate", options.config, "--examples", str(options.examples), "--out", f"{name}/data",
                   "--set", f"data.shard_examples={options.shard}", "--jobs", "1", "--quiet"]
        # What a start and an example take alone.
        first = cpu_of(command, f"{name}/alone", options.shard)
        more = cpu_of(command, f"{name}/alone", options.shard + ALONE)
        example = more / ALONE
        start = max(0.0, first - options.shard * example)
        (Path(name) / "files").mkdir()
        look, claim, write, _, bandwidth = file_costs(Path(name) / "files")
        size = sum(file.stat().st_size for file in Path(f"{name}/alone").glob("shard-*.h5")) / (options.shard + ALONE)
        processors = len(os.sched_getaffinity(0))
        costs = Costs(start_s=start, example_s=example, example_bytes=size, look_s=look, claim_s=claim, write_s=write,
                      bandwidth=bandwidth, task_starts_per_s=1000.0)
        model = simulate(Plan(options.examples, options.shard, options.processes, 1,
                              processors=min(processors, options.processes)), costs)
        share = (*command, "--share")
        started, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        processes = [subprocess.Popen(share) for _ in range(options.processes)]
        codes = [process.wait() for process in processes]
        seconds, after = time.monotonic() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        if set(codes) - {0, 3}:
            print(f"exit codes {codes}")
            return 1
        files = len(list(Path(f"{name}/data").glob("shard-*.h5")))
    said = options.examples * example + options.processes * start
    print(f"{options.processes} processes, {files} files of {options.shard}: {used:.1f} CPU s (the model: {said:.1f}), "
          f"{seconds:.1f} s on {processors} processors, {used / seconds:.2f} of them used (the model: {model['seconds']:.1f} s, "
          f"{model['server_load']:.3f} of it at the files); an example {example:.4f}, a start {start:.2f} CPU s, a look "
          f"{look * 1e6:.0f} us, a claim {claim * 1e6:.0f} us, a file {write * 1e3:.1f} ms, {bandwidth / 1e6:.0f} MB/s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
