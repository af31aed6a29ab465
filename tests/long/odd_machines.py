#!/usr/bin/env python3
"""Machines and users that are not the developer's: odd_machines.py BUILD [options]

BUILD is a build folder of weft. Each command of fault_kit.py must give its result byte for byte, but for times,

- while the clock of the machine jumps back by a day, again and again (faketime);
- on one processor (taskset);
- in a program whose numbers have a decimal comma (de_DE.UTF-8, made by localedef; failing_calls.c sets it);
- for an ordinary user who owns nothing but a folder, with an installed weft (setpriv; only if root runs this script).

And on a processor without AVX2 (qemu-x86_64 -cpu Nehalem) cloth and bullet, where they are made for AVX2, must be
refused with the reason before they are loaded, while `weft plugins` and the conformance of emd pass. A minute or two.
Exit code 0: all of that held; 1: something did not.
"""

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

from fault_kit import CLEAN, Kit, differences, left_behind, parser

DAY = 86400
FAKETIME = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1"


class JumpingClock:
    """A clock that is a day late, then right, then a day late ...: every change is a jump, half of them back."""

    def __init__(self, folder):
        self._file = folder / "clock"
        self._end = threading.Event()
        self._set(0)
        self._thread = threading.Thread(target=self._jump)
        self.jumps = 0
        # Only the time of day jumps: the monotonic clock of a machine never does.
        self.environment = {"LD_PRELOAD": FAKETIME, "FAKETIME_TIMESTAMP_FILE": str(self._file), "FAKETIME_NO_CACHE": "1",
                            "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1"}

    def _set(self, offset):
        part = self._file.with_suffix(".part")
        part.write_text(f"{offset:+d}\n")
        part.rename(self._file)

    def _jump(self):
        while not self._end.wait(0.1):
            self.jumps += 1
            self._set(-DAY if self.jumps % 2 else 0)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()


def compare(kit, work, name, problems, **start):
    """Runs a command on the odd machine and compares its result with that of the ordinary one."""
    right, _ = kit.right(work)
    folder = kit.folder / "odd"
    folder.mkdir()
    folder.chmod(0o777)
    end = kit.begin(work, folder, **start).finish()
    wrong = [f"ended with {end.code}: {end.errors}"] if end.code else []
    wrong += differences(right, folder / "out") + [f"{one} was left" for one in left_behind(folder)]
    problems += [f"{name}, {work.name}: {text}" for text in wrong]
    shutil.rmtree(folder)


def clock(kit, _, problems):
    jumps = 0
    with JumpingClock(kit.folder) as jumping:
        shown = {int(subprocess.run(["date", "+%s"], env={**CLEAN, **jumping.environment}, capture_output=True, text=True,
                                    check=True).stdout) // (DAY // 2) for _ in range(20) if not jumping._end.wait(0.03)}
        if len(shown) < 2:
            problems.append("clock: it does not jump")
        for work in kit.single_works:
            compare(kit, work, "clock", problems, environment=jumping.environment)
        jumps = jumping.jumps
    return f"{jumps} jumps"


def one_processor(kit, _, problems):
    for work in kit.single_works:
        compare(kit, work, "one processor", problems, before=("taskset", "-c", str(min(os.sched_getaffinity(0)))),
                options=("--quiet",))
    return ""


def comma(kit, build, problems):
    folder = kit.folder / "locales"
    folder.mkdir()
    # localedef warns about names that this machine does not know, and then ends with 1.
    subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / "de_DE.UTF-8")], capture_output=True, check=False)
    environment = {"LOCPATH": str(folder), "LC_ALL": "de_DE.UTF-8", "SET_LOCALE": "1",
                   "LD_PRELOAD": str(build / "tests/long/libfailing_calls.so")}
    half = subprocess.run(["printf", "%.1f", "0,5"], env={**CLEAN, **environment}, capture_output=True, text=True, check=False)
    if half.stdout != "0,5":
        problems.append(f"comma: the locale has none: {half.stdout} {half.stderr}")
    for work in kit.single_works:
        compare(kit, work, "comma", problems, environment=environment)
    return ""


def ordinary_user(kit, build, problems):
    if os.geteuid() != 0:
        return "skipped: this script runs as an ordinary user itself"
    prefix = kit.folder / "installed"
    subprocess.run(["cmake", "--install", str(build), "--prefix", str(prefix)], capture_output=True, check=True)
    kit.folder.chmod(0o755)
    home = kit.folder / "home"
    home.mkdir()
    shutil.chown(home, "nobody")
    user = ("setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", "--no-new-privs")
    here, kit.weft = kit.weft, str(prefix / "bin/weft")
    for work in kit.single_works:
        compare(kit, work, "ordinary user", problems, before=user, environment={"HOME": str(home)})
    refused = kit.start(kit.works[0].arguments, kit.inputs, before=user).finish()
    if refused.code == 0 or "Permission denied" not in refused.errors:
        problems.append(f"ordinary user: in a folder of root it ended with {refused.code}: {refused.errors}")
    kit.weft = here
    return "weft from " + str(prefix.relative_to(kit.folder))


def no_avx2(_, build, problems):
    old = ["qemu-x86_64", "-cpu", "Nehalem", str(build / "bin/weft")]

    def weft(*words):
        return subprocess.run([*old, *words], env=CLEAN, capture_output=True, text=True, check=False)

    plugins = weft("plugins")
    if plugins.returncode != 0:
        problems.append(f"no AVX2: weft plugins ended with {plugins.returncode}: {plugins.stderr}")
    made_for_avx2 = [name for name in ("cloth", "bullet") if (build / f"lib/weft/plugins/libweft_simulator_{name}.so").exists()]
    for name in made_for_avx2:
        library = build / f"lib/weft/plugins/libweft_simulator_{name}.so"
        lines = [line for line in plugins.stdout.splitlines() if library.name in line]
        if len(lines) != 1 or "refused" not in lines[0] or "AVX2" not in lines[0]:
            problems.append(f"no AVX2: weft plugins does not refuse {name} with the reason: {lines}")
        refusal = weft("conformance", "--in-process", str(library))
        if refusal.returncode not in (1, 2) or "AVX2" not in refusal.stderr + refusal.stdout:
            problems.append(f"no AVX2: conformance of {name} ended with {refusal.returncode}: {refusal.stderr}")
    # In one process: qemu emulates the processor for the program that it starts, and not for its children.
    emd = weft("conformance", "--in-process", str(build / "lib/weft/plugins/libweft_predictor_emd.so"))
    if emd.returncode != 0:
        problems.append(f"no AVX2: conformance of emd ended with {emd.returncode}: {emd.stdout}{emd.stderr}")
    return emd.stdout.strip().splitlines()[-1] if emd.stdout.strip() else ""


MACHINES = {"clock": clock, "one_processor": one_processor, "comma": comma, "ordinary_user": ordinary_user,
            "no_avx2": no_avx2}


def main():
    options = parser(__doc__)
    options.add_argument("--machine", choices=MACHINES, action="append", help="only this one (repeatable)")
    options = options.parse_args()
    build = Path(options.weft).resolve()
    problems = []
    with Kit(build / "bin/weft", options.only) as kit:
        for name in options.machine or MACHINES:
            before = len(problems)
            note = MACHINES[name](kit, build, problems)
            print(f"{name:14} {len(problems) - before} wrong{'  ' + note if note else ''}", flush=True)
            for problem in problems[before:]:
                print("  " + problem, flush=True)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
