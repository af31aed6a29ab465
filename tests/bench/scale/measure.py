#!/usr/bin/env python3
"""The unit costs of docs/scale.md on this machine: measure.py WEFT [--config FILE] [--folder DIR]

Files: looks, claims, and whole files with fsync and rename, in DIR (a folder of the file system in question). weft: the CPU
time until the first example, of an example, and its bytes. Slurm, if it is installed and this is root: starts of tasks, and
the time of an answer to squeue. Prints one line each.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent.parent
sys.path.insert(0, str(ROOT / "tests/cluster"))
from slurm_kit import Slurm, missing_programs  # noqa: E402


def timed(count, work):
    """Seconds of one call."""
    started = time.perf_counter()
    for i in range(count):
        work(i)
    return (time.perf_counter() - started) / count


def write_whole(file, data):
    with open(f"{file}.tmp", "wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
    os.rename(f"{file}.tmp", file)


def file_costs(folder):
    """Seconds of a look, of a claim and its end, of a file of 1 kB and of one of 8 MB; bytes/s of the latter."""
    many = folder / "many"
    many.mkdir()
    for i in range(10000):
        (many / f"shard-{i:05}.h5").touch()
    look = timed(20000, lambda i: os.path.exists(many / f"shard-{i % 10000:05}.h5"))

    def claim(i):
        file = folder / f"{i}.claim"
        number = os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
        os.write(number, b"x" * 100)
        os.close(number)
        os.unlink(file)

    claimed = timed(3000, claim)
    small, large = b"x" * 1000, os.urandom(8 << 20)
    written = timed(200, lambda i: write_whole(folder / f"s{i}", small))
    seconds = timed(30, lambda i: write_whole(folder / f"l{i}", large))
    return look, claimed, written, seconds, len(large) / seconds


def files(folder):
    look, claimed, small, large, speed = file_costs(folder)
    print(f"a look: {look * 1e6:.1f} us")
    print(f"a claim: {claimed * 1e6:.1f} us")
    print(f"a file of 1 kB: {small * 1e3:.2f} ms")
    print(f"a file of 8 MB: {large * 1e3:.1f} ms, {speed / 1e6:.0f} MB/s")


def cpu_of(words):
    """CPU seconds of a command and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def weft(program, config, folder):
    def generate(count):
        return [program, "generate", config, "--examples", str(count), "--out", str(folder / "data"), "--jobs", "1", "--quiet"]

    first = cpu_of(generate(1))
    start = cpu_of(generate(1))
    more = cpu_of(generate(17))
    size = sum(file.stat().st_size for file in (folder / "data").glob("shard-*.h5"))
    print(f"start of weft: {start:.2f} CPU s; an example: {(more - start) / 16:.3f} CPU s (the first one {first - start:.2f}), "
          f"{size / 17 / 1e3:.1f} kB")


def slurm(folder):
    if missing_programs() or os.getuid() != 0:
        print("Slurm: not measured, it is not installed or this is not root")
        return
    with Slurm() as cluster:
        script = folder / "true.sh"
        script.write_text("#!/bin/bash\n#SBATCH --array=1-200\n#SBATCH --output=/dev/null\ntrue\n")
        started = time.perf_counter()
        cluster.run("sbatch", str(script))
        submitted = time.perf_counter() - started
        while any(state in ("PENDING", "RUNNING", "COMPLETING", "CONFIGURING") for _, state, _, _ in cluster.jobs()):
            time.sleep(0.5)
        seconds = time.perf_counter() - started
        print(f"sbatch of an array: {submitted * 1e3:.0f} ms; 200 tasks, two a node, ended after {seconds:.1f} s: "
              f"{200 / seconds:.1f} a second")
        script.write_text("#!/bin/bash\n#SBATCH --array=1-1000\n#SBATCH --hold\n#SBATCH --output=/dev/null\ntrue\n")
        cluster.run("sbatch", str(script))
        print(f"squeue of 1000 waiting tasks: {timed(20, lambda _: cluster.jobs()) * 1e3:.0f} ms")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weft")
    parser.add_argument("--config", default=str(ROOT / "configs/experiments/tshirt.yaml"))
    parser.add_argument("--folder", default=None)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder, prefix="weft-measure-") as name:
        folder = Path(name)
        files(folder)
        weft(options.weft, options.config, folder)
        slurm(folder)


if __name__ == "__main__":
    main()
