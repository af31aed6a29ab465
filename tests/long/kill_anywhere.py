#!/usr/bin/env python3
"""Commands are killed at random moments, and the same command finishes the work: kill_anywhere.py WEFT [options]

Each command runs undisturbed first. Then, --moments times, it begins in an empty folder and is killed (kill -9) at a
random moment of that time. Of five times, once the victim is one of its child processes instead, if it has one, and once the
command is asked to stop (SIGTERM): then it must answer, end with 1 within ten seconds, or with 0 if it was done, and leave no
temporary file, claim or process. Then the same command runs until it ends. Its result must equal the undisturbed one byte
for byte, but for files that hold times; no temporary file, no claim and no process may be left. The same --seed draws the
same moments; what a command is doing then differs from run to run.

The full test, some half an hour on two cores:  kill_anywhere.py build/release/bin/weft --moments 50
CI runs fewer moments. Exit code 0: every result was right; 1: one was not.
"""

import os
import random
import shutil
import signal
import sys
import time

from fault_kit import Kit, contents, differences, left_behind, parser


STOP_SECONDS = 10


def ask_to_stop(kit, work, folder, moment):
    """Sends SIGTERM to the command at a moment. @return stopped or nobody; and what went wrong, one text each."""
    running = kit.begin(work, folder)
    time.sleep(moment)
    running.process.terminate()
    end = running.finish(STOP_SECONDS)
    wrong = []
    if end.code == -signal.SIGTERM and not contents(folder / "out"):
        pass  # before it could catch signals, and before any work
    elif end.code == -signal.SIGKILL:
        wrong.append(f"did not end within {STOP_SECONDS} s after SIGTERM: {end.errors}")
    elif end.code not in (0, 1):
        wrong.append(f"ended with {end.code} after SIGTERM: {end.errors}")
    elif end.code == 1 and "stopping; " not in end.errors:
        wrong.append(f"did not answer SIGTERM: {end.errors}")
    if running.family():
        wrong.append("child processes live on after SIGTERM")
        os.killpg(running.process.pid, signal.SIGKILL)
    wrong += [f"{name} was left after SIGTERM" for name in left_behind(folder)]
    return ("nobody" if end.code == 0 else "stopped"), wrong


def disturb(kit, work, folder, moment, hits_child, dice):
    """Kills the command or a child at a moment. @return who was killed: command, child or nobody; and what went wrong."""
    running = kit.begin(work, folder)
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
        return "command", ["child processes live on after the command was killed"]
    if victim == running.process.pid and end.code == -signal.SIGKILL:
        return "command", []
    if end.code != 0:
        return "child", [f"ended with {end.code} after a child was killed: {end.errors}"]
    return ("nobody" if victim in (None, running.process.pid) else "child"), []


def main():
    options = parser(__doc__)
    options.add_argument("--moments", type=int, default=50, help="for each command")
    options = options.parse_args()
    problems = []
    with Kit(options.weft, options.only) as kit:
        for work in kit.works:
            right, seconds = kit.right(work)
            dice = random.Random(f"{options.seed} {work.name}")
            killed = {"command": 0, "child": 0, "stopped": 0, "nobody": 0}
            bad = 0
            for number in range(options.moments):
                folder = kit.folder / "killed"
                folder.mkdir()
                moment = dice.uniform(0.0, seconds)
                if number % 5 == 4:
                    who, texts = ask_to_stop(kit, work, folder, moment)
                else:
                    who, texts = disturb(kit, work, folder, moment, number % 5 == 2, dice)
                killed[who] += 1
                was_done = work.once and not differences(right, folder / "out")
                last = kit.begin(work, folder).finish()
                if last.code != 0 and not (was_done and "already" in last.errors):
                    texts.append(f"ended with {last.code} when it was run again: {last.errors}")
                texts += differences(right, folder / "out") + [f"{name} was left" for name in left_behind(folder)]
                for text in texts:
                    problems.append(f"{work.name}, {who}, after {moment:.2f} s: {text}")
                    print(problems[-1], flush=True)
                bad += bool(texts)
                shutil.rmtree(folder)
            print(f"{work.name:10} {seconds:5.1f} s, {len(right):3} files, disturbed {options.moments} times "
                  f"(the command killed {killed['command']}, a child {killed['child']}, asked to stop "
                  f"{killed['stopped']}, ended before {killed['nobody']}): "
                  f"{bad} wrong", flush=True)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
