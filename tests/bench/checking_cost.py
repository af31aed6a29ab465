#!/usr/bin/env python3
"""What the checks between weft and its plugins cost: checking_cost.py WEFT ARGUMENT...

Runs `WEFT ARGUMENT...` under callgrind (Debian: valgrind), which counts instructions, and prints which part of them the
checks took: everything that the checked objects of framework/loader execute themselves, and what they call in the C and
C++ libraries (memory, mostly). The calls into plugins, and back from them into weft, are not part of it. Numbers that do
not depend on the machine's load; the command takes some fifty times as long.

    tests/bench/checking_cost.py build/release/bin/weft run configs/tasks/tshirt_fold.yaml --out /tmp/out --jobs 1
"""

import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

CHECK = re.compile(r"weft::\(anonymous namespace\)::(Checked|PredictionSizes|CaseSizes|sizes_of|all_finite_cotangent)"
                   r"|weft::Guard|weft::all_finite|weft::call_back|weft::where_text|weft::write_where")
# What a check calls outside of weft: memory and texts.
LIBRARIES = ("libc.so", "libstdc++", "libm.so", "ld-linux", "libgcc", "vgpreload")


def read_costs(profile):
    """@return instructions of the run; of the checks themselves; {callee: instructions} of their calls to libraries and,
    to look through, of their other calls."""
    names, objects = {}, {}

    def name(text, known):  # "(12) name" defines, "(12)" refers
        number, _, rest = text.partition(" ")
        if rest:
            known[number] = rest
        return known[number]

    total = own = 0
    called, others, own_by = Counter(), Counter(), Counter()
    function = callee = ""
    object_ = callee_object = ""
    is_call = False
    for line in profile.read_text(errors="replace").splitlines():
        key, equals, value = line.partition("=")
        if key == "fn":
            function, is_call = name(value, names), False
        elif key == "ob":
            object_ = callee_object = name(value, objects)
        elif key == "cob":
            callee_object = name(value, objects)
        elif key == "cfn":
            callee = name(value, names)
        elif key == "calls":
            is_call = True
        elif key in ("summary", "totals") or line.startswith(("summary:", "totals:")):
            total = int(line.split()[-1])
        elif line and (line[0].isdigit() or line[0] in "+-*") and not equals:
            cost = int(line.split()[-1]) if len(line.split()) > 1 else 0
            if CHECK.search(function):
                if not is_call:
                    own += cost
                    own_by[function] += cost
                elif not CHECK.search(callee):
                    is_library = any(one in callee_object for one in LIBRARIES)
                    (called if is_library else others)[f"{callee}  [{Path(callee_object).name}]"] += cost
            if is_call:
                is_call, callee_object = False, object_
    return total, own, own_by, called, others


def main():
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    with tempfile.TemporaryDirectory(prefix="weft-checking-") as folder:
        profile = Path(folder) / "callgrind.out"
        end = subprocess.run(["valgrind", "--tool=callgrind", f"--callgrind-out-file={profile}", "--trace-children=no",
                              *sys.argv[1:]], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if end.returncode != 0:
            raise SystemExit(f"the command ended with {end.returncode}: {end.stderr[-2000:]}")
        total, own, own_by, called, others = read_costs(profile)
    if total == 0 or own == 0:
        raise SystemExit("no instruction of a check was counted: is the program stripped?")
    print(f"instructions of the run          {total:16,}")
    print(f"of the checks themselves         {own:16,}  {own / total:.4%}")
    print(f"of libraries that they call      {called.total():16,}  {called.total() / total:.4%}")
    print(f"checks in all                    {own + called.total():16,}  {(own + called.total()) / total:.4%}")
    for title, costs in (("the checks", own_by), ("libraries they call", called), ("not counted: other calls", others)):
        print(f"\n{title}, the most first:")
        for what, cost in costs.most_common(8):
            print(f"{cost:16,}  {what[:150]}")


if __name__ == "__main__":
    main()
