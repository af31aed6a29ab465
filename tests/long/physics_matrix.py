#!/usr/bin/env python3
"""The physics suite for three fabrics on three edge lengths: physics_matrix.py WEFT OUT [--set KEY=VALUE ...]

Runs `weft evaluate physics configs/experiments/physics.yaml` with the weight and stiffness of each fabric (warp and weft in the
mean, since the suite has one stiffness for both) on sheets of each edge length, writes its results to OUT/FABRIC-EDGEmm, and prints
the table of docs/measurements/physics-matrix.md: of every test the worst part of a bound, over its comparisons on that edge. A folder
that is complete is not run again. Exit code 0: every comparison is within its bound; 1: some are not, and they are listed.

Takes some minutes on two cores, so it is run by hand:  physics_matrix.py build/release/bin/weft out/physics-matrix
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
# kg/m^2, N/m and N m: configs/fabrics/NAME.yaml, means of warp and weft.
FABRICS = {
    "basic": (0.15, 137.5, 2.0e-5),
    "cotton_plain": (0.1503, 261.1, 1.235e-5),
    "denim": (0.407, 8890.0, 3.525e-5),
}
EDGES_MM = (5, 10, 20)
# These also run on sheets of half the edge, so 5 mm is a part of the run of 10 mm.
HALVED = ("hanging", "incline")
TESTS = ["elastica", "orthotropy", "hanging", "catenary", "incline", "cloth on cloth", "thrown sheet", "crease", "free fall",
         "rest", "momentum", "energy", "refinement"]


def run(weft, out, fabric, edge_mm, extra):
    folder = out / f"{fabric}-{edge_mm}mm"
    if not (folder / "physics.json").exists():
        density, stretch, bend = FABRICS[fabric]
        changes = {
            "fine_edge_m": edge_mm / 1000, "garment_edge_m": edge_mm / 1000, "density_kg_per_m2": density,
            "stretch_n_per_m": stretch, "bend_n_m": bend, "folds.count": 0,
            "tests": json.dumps([test for test in TESTS if edge_mm > min(EDGES_MM) or test not in HALVED]),
        }
        command = [weft, "evaluate", "physics", str(ROOT / "configs/experiments/physics.yaml"), "--quiet", "--out", str(folder)]
        for key, value in changes.items():
            command += ["--set", f"physics.{key}={value}"]
        for change in extra:
            command += ["--set", change]
        done = subprocess.run(command, stdout=subprocess.DEVNULL)
        if done.returncode not in (0, 1):
            sys.exit(f"{' '.join(command)}: exit code {done.returncode}")
    return json.loads((folder / "physics.json").read_text())["rows"]


def edge_of(row, edge_mm):
    """Edge of the sheet, mm: the case's name begins with it unless all cases of the test have the edge of the run."""
    words = row["case"].split()
    return float(words[0]) if len(words) > 1 and words[1] == "mm" else edge_mm


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weft")
    parser.add_argument("out", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    columns = [(fabric, edge) for fabric in FABRICS for edge in EDGES_MM]
    rows = {column: {} for column in columns}
    for fabric, edge in sorted(columns, key=lambda column: -column[1]):
        for row in run(given.weft, given.out, fabric, edge, given.set):
            column = (fabric, edge_of(row, edge))
            if column in rows:
                rows[column][row["test"], row["case"], row["variant"], row["quantity"]] = row
    rows = {column: list(of_column.values()) for column, of_column in rows.items()}
    print("| test | " + " | ".join(f"{fabric} {edge} mm" for fabric, edge in columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    for test in TESTS:
        cells = []
        for column in columns:
            of_test = [row for row in rows[column] if row["test"] == test]
            worst = max((row["error"] / row["bound"] if row["error"] is not None else float("inf") for row in of_test),
                        default=None)
            failed = sum(not row["passed"] for row in of_test)
            cells.append("" if worst is None else f"{worst:.2g}" + (f" ({failed} of {len(of_test)})" if failed else ""))
        print(f"| {test} | " + " | ".join(cells) + " |")
    failures = [(column, row) for column in columns for row in rows[column] if not row["passed"]]
    print(f"\n{sum(map(len, rows.values()))} comparisons, {len(failures)} outside their bound")
    for (fabric, edge), row in failures:
        print(f"{fabric}, {edge} mm: {row['test']}, {row['case']} ({row['variant']}): {row['quantity']} {row['measured']:.5g} for "
              f"{row['reference']:.5g}, error {row['error']:.3g}, bound {row['bound']:.3g}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
