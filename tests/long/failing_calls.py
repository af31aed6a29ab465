#!/usr/bin/env python3
"""The n-th write, fsync or rename of a command fails: failing_calls.py WEFT SHIM [options]

SHIM is the library of failing_calls.c. For each command and each n from 1 to 40 the n-th call on a file of its result
folder fails, counted over all its processes: a write with EIO; a write with ENOSPC, and all writes after it, as on a
disk that stays full; a write with ENOSPC once; an fsync with EIO; a rename with EIO; a file that cannot be made, with
EACCES. Then weft must

- end with an exit code that is not 0, and name the file and the reason;
- leave no temporary, no claim, and no file that differs from that of an undisturbed run;
- give the right result, byte for byte, when the same command runs again.

A session that was executed is written first: `run` that can write no second file keeps it, and says where.

A call that weft can do without may fail without a word: then the result is right already. The full test takes an hour
on two cores:  failing_calls.py build/release/bin/weft build/release/tests/long/libfailing_calls.so
CI runs every 8th n. Exit code 0: all of that held; 1: something did not.
"""

import errno
import os
import shutil
import sys
from dataclasses import dataclass

from fault_kit import Kit, contents, differences, left_behind, parser


@dataclass(frozen=True)
class Fault:
    name: str
    call: str
    error: int
    stays: bool = False


FAULTS = (
    Fault("write EIO", "write", errno.EIO),
    Fault("write ENOSPC", "write", errno.ENOSPC),
    Fault("disk full", "write", errno.ENOSPC, stays=True),
    Fault("fsync EIO", "fsync", errno.EIO),
    Fault("rename EIO", "rename", errno.EIO),
    Fault("create EACCES", "create", errno.EACCES),
)
# What a command that goes on later leaves when it fails: half a fit or a calibrated model, and what that belongs to; the
# cases that have ended.
UNFINISHED = {name: ("model.checkpoint.h5", "model.provenance.json", "model.h5", "model.calibration.json")
              for name in ("train", "calibrate")} | {"physics": ("physics.checkpoint.json",)}


def environment(shim, fault, number, folder):
    counter = folder / "counter"
    counter.write_bytes(bytes(8))
    values = {"LD_PRELOAD": shim, "FAIL_CALL": fault.call, "FAIL_AT": number, "FAIL_ERRNO": fault.error,
              "FAIL_FOLDER": folder / "out", "FAIL_COUNTER": counter}
    if fault.stays:
        values["FAIL_AFTER"] = 1
    return {name: str(value) for name, value in values.items()}


def calls_counted(folder):
    return int.from_bytes((folder / "counter").read_bytes(), sys.byteorder)


def half_written(right, folder, unfinished):
    """What a failed command left that is not a file of the right result."""
    out = folder / "out"
    found = contents(out) if out.exists() else {}
    wrong = [f"{name} is not that of an undisturbed run" for name, data in found.items()
             if right.get(name) != data and name not in unfinished]
    return wrong + [f"{name} was left" for name in left_behind(folder)]


def one(kit, work, fault, number, shim):
    """@return whether there are so many calls, whether weft failed, and what is wrong."""
    right, _ = kit.right(work)
    folder = kit.folder / "failing"
    folder.mkdir()
    wrong = []
    end = kit.begin(work, folder, environment(shim, fault, number, folder)).finish()
    is_hit = calls_counted(folder) >= number
    if end.code == 0:
        wrong += differences(right, folder / "out") + [f"{name} was left" for name in left_behind(folder)]
    else:
        if not is_hit:
            wrong.append(f"ended with {end.code} though nothing failed: {end.errors}")
        elif end.code not in (1, 2):
            wrong.append(f"ended with {end.code}: {end.errors}")
        elif os.strerror(fault.error) not in end.errors or "out" not in end.errors:
            wrong.append(f"did not say where and why: {end.errors}")
        wrong += half_written(right, folder, UNFINISHED.get(work.name, ()))
        again = kit.begin(work, folder).finish()
        if again.code != 0:
            wrong.append(f"ended with {again.code} when it was run again: {again.errors}")
        wrong += differences(right, folder / "out") + [f"{name} was left" for name in left_behind(folder)]
    shutil.rmtree(folder)
    return is_hit, end.code != 0, wrong


def session_comes_first(kit, work, shim):
    """What is wrong with `run` that fails to name its second file."""
    right, _ = kit.right(work)
    folder = kit.folder / "second"
    folder.mkdir()
    end = kit.begin(work, folder, environment(shim, Fault("", "rename", errno.EIO), 2, folder)).finish()
    wrong = []
    if end.code != 1 or "the session is kept in out/session.h5" not in end.errors:
        wrong.append(f"ended with {end.code} at its second file: {end.errors}")
    if contents(folder / "out").get("session.h5") != right["session.h5"]:
        wrong.append("the session was not written first")
    shutil.rmtree(folder)
    return wrong


def main():
    options = parser(__doc__)
    options.add_argument("shim")
    options.add_argument("--most", type=int, default=40, help="the last n")
    options.add_argument("--every", type=int, default=1, help="step between two n")
    options = options.parse_args()
    shim = os.path.abspath(options.shim)
    count = 0
    with Kit(options.weft, options.only) as kit:
        for work in kit.single_works:
            for text in session_comes_first(kit, work, shim) if work.name == "run" else ():
                print(f"run: {text}", flush=True)
                count += 1
        for work in kit.single_works:
            for fault in FAULTS:
                injected = failed = bad = 0
                for number in range(1, options.most + 1, options.every):
                    is_hit, has_failed, wrong = one(kit, work, fault, number, shim)
                    for text in wrong:
                        print(f"{work.name}, {fault.name} at call {number}: {text}", flush=True)
                    injected += is_hit
                    failed += has_failed
                    bad += bool(wrong)
                    if not is_hit:
                        break  # there are fewer calls
                count += bad
                print(f"{work.name:10} {fault.name:13} {injected:3} injected, {failed:3} ended with an error, "
                      f"{bad} wrong", flush=True)
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
