#!/usr/bin/env python3
"""Commands are killed at random moments, and the same command finishes the work: kill_anywhere.py WEFT [options]

Each command runs undisturbed first. Then, --moments times, it begins in an empty folder and is killed (kill -9) at a
random moment of that time; each third time the victim is one of its child processes instead, if it has one. Then the
same command runs until it ends. Its result must equal the undisturbed one byte for byte, but for files that hold times;
no temporary file, no claim and no process may be left. The same --seed draws the same moments; what a command is doing
then differs from run to run.

The full test, some half an hour on two cores:  kill_anywhere.py build/release/bin/weft --moments 50
CI runs fewer moments. Exit code 0: every result was right; 1: one was not.
"""

import os
import random
import shutil
import signal
import sys
import time

from fault_kit import Kit, differences, left_behind, parser


def disturb(kit, work, folder, moment, hits_child, dice):
    """Kills the command or a child at a moment. @return who was killed: command, child or nobody; and what went wrong."""
    running = kit.start(work.arguments, folder)
    time.sleep(moment)
    children = [one for one in running.family() if one != running.process.pid]
    victim = dice.choice(sorted(children)) if hits_child and children else running.process.pid
    try:
        os.kill(victim, signal.SIGKILL)
    except ProcessLookupError:
        victim = None
    end = running.finish()
    deadline = time.monotonic() + 10
    while running.family() and time.monotonic() < deadline:
        time.sleep(0.01)
    if running.family():
        os.killpg(running.process.pid, signal.SIGKILL)
        return "command", "child processes live on after the command was killed"
    if victim == running.process.pid and end.code == -signal.SIGKILL:
        return "command", ""
    if end.code != 0:
        return "child", f"ended with {end.code} after a child was killed: {end.errors}"
    return ("nobody" if victim in (None, running.process.pid) else "child"), ""


def main():
    options = parser(__doc__)
    options.add_argument("--moments", type=int, default=50, help="for each command")
    options = options.parse_args()
    problems = []
    with Kit(options.weft, options.only) as kit:
        for work in kit.works:
            right, seconds = kit.right(work)
            dice = random.Random(f"{options.seed} {work.name}")
            killed = {"command": 0, "child": 0, "nobody": 0}
            bad = 0
            for number in range(options.moments):
                folder = kit.folder / "killed"
                folder.mkdir()
                moment = dice.uniform(0.0, seconds)
                who, wrong = disturb(kit, work, folder, moment, number % 3 == 2, dice)
                killed[who] += 1
                texts = [wrong] if wrong else []
                last = kit.start(work.arguments, folder).finish()
                if last.code != 0:
                    texts.append(f"ended with {last.code} when it was run again: {last.errors}")
                texts += differences(right, folder / "out") + [f"{name} was left" for name in left_behind(folder)]
                for text in texts:
                    problems.append(f"{work.name}, {who} killed after {moment:.2f} s: {text}")
                    print(problems[-1], flush=True)
                bad += bool(texts)
                shutil.rmtree(folder)
            print(f"{work.name:10} {seconds:5.1f} s, {len(right):3} files, killed {options.moments} times "
                  f"(the command {killed['command']}, a child {killed['child']}, ended before {killed['nobody']}): "
                  f"{bad} wrong", flush=True)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
