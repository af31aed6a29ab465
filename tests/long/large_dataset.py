#!/usr/bin/env python3
"""Training from a dataset larger than the memory it may take: large_dataset.py WEFT REPEAT_DATASET OUT [options]

Makes OUT anew, with --examples examples of --config, and writes them again and again under new numbers until the set has --gib GiB
(repeat_dataset.cpp beside this, built with the tests). Then it fits --iterations iterations, --pairs times by
turns: from the large set, whose shapes are read by index, and from the few examples in memory (--in-memory). It fails if

- the fit of the large set, with its calibration (--calibrate), ever holds --most-gib GiB or more;
- the fits of the few examples, by index and in memory, are not the same bytes;
- the median over the pairs of the steps a second is below --least of those in memory (--least 0: only printed).

The full test, which needs two idle cores and 21 GiB of disk:  large_dataset.py build/release/bin/weft \\
    build/release/bin/repeat_dataset OUT --gib 20 --pairs 5 --calibrate --least 0.95
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
GIB = 2**30


def fail(reason):
    print(f"failed: {reason}")
    sys.exit(1)


def run(words):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    if done.returncode:
        fail(f"{' '.join(map(str, words))} ended with {done.returncode}: {done.stdout}{done.stderr}")
    return done.stdout


class Fits:
    def __init__(self, options):
        self.options = options
        self.number = 0

    def fit(self, data, *more, calibrate=False):
        """@return the model's file, seconds between the reports of progress, and the peak of the resident memory in GiB."""
        o = self.options
        self.number += 1
        model = o.out / f"fit-{self.number}/model.h5"
        training = {"iterations": o.iterations, "evaluate_every": o.iterations // 4, "evaluation_cases": 6,
                    "calibrate": "true" if calibrate else "false"}
        words = [o.weft, "train", o.config, "--jobs", o.jobs, "--data", data, "--out", model, *more]
        for key, value in training.items():
            words += ["--set", f"predictor.params.training.{key}={value}"]
        process = subprocess.Popen([str(word) for word in words], stdout=subprocess.PIPE, text=True)
        times = []
        for line in process.stdout:
            if re.match(rf" *\d+ of {o.iterations} ", line):
                times.append(time.monotonic())
        _, status, usage = os.wait4(process.pid, 0)
        if status:
            fail(f"{' '.join(map(str, words))} ended with {status}")
        return model, times[-1] - times[0], usage.ru_maxrss / 2**20


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weft", type=Path)
    parser.add_argument("repeat_dataset", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", type=Path, default=ROOT / "configs/experiments/tshirt.yaml")
    parser.add_argument("--examples", type=int, default=256)
    parser.add_argument("--gib", type=float, default=20.0)
    parser.add_argument("--iterations", type=int, default=400)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--most-gib", type=float, default=1.5)
    parser.add_argument("--least", type=float, default=0.0)
    parser.add_argument("--calibrate", action="store_true")
    options = parser.parse_args()
    few, large = options.out / "few", options.out / "large"
    shutil.rmtree(options.out, ignore_errors=True)  # what another build made would be refused
    run([options.weft, "generate", options.config, "--examples", options.examples, "--seed", 1, "--jobs", options.jobs, "--quiet",
         "--out", few])
    size = sum(file.stat().st_size for file in few.glob("shard-*.h5"))
    copies = max(2, -int(-options.gib * GIB // size))
    print(f"{copies} times {options.examples} examples, {copies * size / GIB:.2f} GiB", flush=True)
    run([options.repeat_dataset, few, large, copies])
    fits = Fits(options)
    by_index, in_memory = fits.fit(few)[0], fits.fit(few, "--in-memory")[0]
    if by_index.read_bytes() != in_memory.read_bytes():
        fail(f"{by_index} and {in_memory} are not the same bytes")
    print("by index and in memory: the same model, byte for byte", flush=True)
    ratios, peaks = [], []
    for _ in range(options.pairs):
        _, indexed, peak = fits.fit(large)
        _, held, _ = fits.fit(few, "--in-memory")
        ratios.append(held / indexed)
        peaks.append(peak)
        steps = options.iterations * 3 / 4
        print(f"steps a second: by index {steps / indexed:.1f}, in memory {steps / held:.1f}, ratio {ratios[-1]:.3f}; "
              f"peak {peak:.2f} GiB", flush=True)
    if options.calibrate:
        peaks.append(fits.fit(large, calibrate=True)[2])
        print(f"peak with the calibration {peaks[-1]:.2f} GiB", flush=True)
    if max(peaks) >= options.most_gib:
        fail(f"the fit held {max(peaks):.2f} GiB, must be below {options.most_gib:.2f}")
    if statistics.median(ratios) < options.least:
        fail(f"{statistics.median(ratios):.3f} of the steps a second, must be at least {options.least:.2f}")
    print(f"passed: median ratio {statistics.median(ratios):.3f}, peak {max(peaks):.2f} GiB")


if __name__ == "__main__":
    main()
