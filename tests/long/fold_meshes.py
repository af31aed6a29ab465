#!/usr/bin/env python3
"""Imports mesh files as people have them, lays those that are worn, and folds each once in both simulators.

Usage: fold_meshes.py WEFT FOLDER [NAME ...]

FOLDER holds the OBJ files; NAME takes those that begin with it. Prints a Markdown table: what was found and done, and of
the default fold in `cloth` and `bullet` the width that is left, the height, and the crossings after any segment. Ends
with 1 if a fold crossed itself or a mesh could not be imported.
"""
import json
import pathlib
import subprocess
import sys
import tempfile

# What these meshes need to be told (units, and edges that a fold can use).
OPTIONS = {
    "cipc-tableCloth": ["--remesh", "0.02"],
    "dedo-apron_0": ["--piece", "1", "--remesh", "0.04"],
    "dedo-cloth_z_up": ["--remesh", "0.05"],
    "diffcloth-dress-v5k": ["--units", "in", "--remesh", "0.02"],
}


def run(arguments):
    return subprocess.run([str(a) for a in arguments], capture_output=True, text=True, check=False)


def fold(weft, task, simulator):
    result = run([weft, "garment", "fold", task, "--json", "--set", f"simulator.plugin={simulator}"])
    try:
        facts = json.loads(result.stdout)
    except json.JSONDecodeError:
        return f"failed: {result.stderr.strip().splitlines()[-1] if result.stderr.strip() else result.returncode}", False
    text = f"{100 * facts['width_share']:.0f} %, {1e3 * facts['height_m']:.0f} mm, {facts['crossings']}"
    return text, facts["crossings"] == 0 and facts["released"]


def main(weft, folder, names):
    meshes = sorted(path for path in pathlib.Path(folder).glob("*.obj")
                    if not names or any(path.stem.startswith(name) for name in names))
    if not meshes:
        sys.exit(f"{folder}: no OBJ file")
    good = True
    print("| mesh | options | vertices | done | `cloth`: width, height, crossings | `bullet` |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as work:
        for mesh in meshes:
            out = pathlib.Path(work) / mesh.stem
            options = OPTIONS.get(mesh.stem, [])
            imported = run([weft, "garment", "import", mesh, "--no-tuning", "--json", "--garment-name", "cloth", "--out", out,
                            *options])
            if imported.returncode != 0:
                print(f"| {mesh.stem} | {' '.join(options)} | | {imported.stderr.strip().splitlines()[-1]} | | |", flush=True)
                good = False
                continue
            facts = json.loads(imported.stdout)
            done = "; ".join(f["text"].split(":")[0] for f in facts["findings"] if f["kind"] == "mended")
            cells = []
            for simulator in ("cloth", "bullet"):
                text, passed = fold(weft, out / "cloth_fold.yaml", simulator)
                good = good and passed
                cells.append(text)
            print(f"| {mesh.stem} | {' '.join(options)} | {facts['vertices']} | {done} | {cells[0]} | {cells[1]} |", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], sys.argv[2], sys.argv[3:]))
