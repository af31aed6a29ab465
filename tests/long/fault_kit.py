"""What the scripts with faults share: every command on small inputs, and the comparison of its result with the right one.

A command runs in a folder of its own and writes to `out` there, so that no result holds the folder's name.
"""

import argparse
import os
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
TASK = f"""garment: {ROOT}/configs/garments/towel_coarse.yaml
material: {ROOT}/configs/fabrics/basic.yaml
manipulation: {{grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}}
predictor: {{plugin: rollout}}
optimiser: {{plugin: rprop}}
goal: {{random: {{min_distance_mm: 10}}}}
settle: {{max_frames: 10}}
planning: {{instances: 1, iterations: 1, replan_iterations: 0, horizon: 12}}
"""


def ablation(seeds):
    """An ablation of TASK with two arms."""
    return f"""task: task.yaml
factors:
  noise:
    low: {{planning.noise: 0.1}}
    high: {{planning.noise: 0.4}}
seeds: {{first: 1, count: {seeds}}}
"""


EXPERIMENT = f"""extends: {ROOT}/configs/experiments/towel_small.yaml
data: {{shard_examples: 8}}
learn: {{examples: 24, calibration_examples: 16, held_out_examples: 16}}
predictor: {{params: {{training: {{iterations: 60, warmup: 5, evaluate_every: 10, checkpoint_every: 10}}}}}}
planning: {{instances: 2, iterations: 2, replan_iterations: 1}}
estimation: {{instances: 2, iterations: 2, later_iterations: 1}}
goal: {{random: {{min_distance_mm: 5}}}}
max_segments: 12
"""
PHYSICS = f"""extends: task.yaml
simulator: {{plugin: cloth}}
physics: {{tests: [free fall, hanging], garment_edge_m: 0.05}}
"""
SCENE = f"""garment: {ROOT}/configs/garments/towel_coarse.yaml
simulator: {{plugin: cloth}}
fabric: {{density_kg_per_m2: 0.15, stretch_n_per_m: {{warp: 120, weft: 120, shear: 50}},
         bend_n_m: {{warp: 2.0e-5, weft: 2.0e-5}}, friction: 0.3, self_friction: 0.3, thickness_m: 0.001}}
ground: {{height_m: -0.3}}
duration_s: 5
output_every_frames: 6
"""


@dataclass(frozen=True)
class Work:
    """A command of weft. {inputs}: the folder with its inputs; its results go to `out`."""

    name: str
    arguments: str
    options: tuple = ("--quiet", "--jobs=2")
    once: bool = False  # refused where its results are there


WORKS = (
    Work("run", "run {inputs}/task.yaml --seed 3 --out out"),
    Work("generate", "generate {inputs}/experiment.yaml --seed 7 --examples 40 --out out"),
    Work("train", "train {inputs}/experiment.yaml --data {inputs}/data --out out/model.h5"),
    Work("calibrate", "calibrate {inputs}/experiment.yaml --set predictor.params.model={inputs}/model.h5"
                      " --data {inputs}/data --out out/model.h5"),
    Work("ablate", "ablate {inputs}/ablation.yaml --out out"),
    Work("planning", "evaluate planning {inputs}/experiment.yaml --set predictor.params.model={inputs}/model.h5"
                     " --cases 2 --widths 0.1 1 --seed 3 --out out"),
    Work("estimation", "evaluate estimation {inputs}/experiment.yaml --set predictor.params.model={inputs}/model.h5"
                       " --cases 3 --seed 5 --out out"),
    Work("prediction", "evaluate prediction {inputs}/experiment.yaml --set predictor.params.model={inputs}/model.h5"
                       " --data {inputs}/data --out out"),
    Work("physics", "evaluate physics {inputs}/physics.yaml --out out"),
    Work("learn", "learn {inputs}/experiment.yaml --out out"),
    Work("merge", "dataset merge {inputs}/data --out out", options=("--quiet",), once=True),
    Work("split", "dataset split {inputs}/data --out out", options=("--quiet",), once=True),
    Work("simulate", "simulate {inputs}/scene.yaml --out out"),
    Work("import", f"garment import {ROOT}/configs/garments/towel_coarse.obj --units m --up z --remesh 0.05 --out out",
         options=("--quiet",)),  # the command line is in its files
    Work("export", "export {inputs}/session --to gltf --to usd --to csv --to obj --png 0,last --size 64x48 --every 10"
                   " --out out", options=("--quiet",)),
)


class Kit:
    """The program, the inputs of the commands, and their right results. A context manager: its folder goes with it."""

    def __init__(self, weft, only=()):
        self.weft = str(Path(weft).resolve())
        self._temporary = tempfile.TemporaryDirectory(prefix="weft-faults-")
        self.folder = Path(self._temporary.name)
        self.inputs = self.folder / "inputs"
        self.inputs.mkdir()
        for name, text in (("task", TASK), ("ablation", ablation(3)), ("experiment", EXPERIMENT), ("physics", PHYSICS),
                           ("scene", SCENE)):
            (self.inputs / f"{name}.yaml").write_text(text)
        self.works = [work for work in WORKS if not only or work.name in only]
        if unknown := set(only) - {work.name for work in WORKS}:
            raise SystemExit(f"no command is called {', '.join(sorted(unknown))}; they are: "
                             + " ".join(work.name for work in WORKS))
        self._must("run", "{inputs}/task.yaml --seed 3 --out {inputs}/session")
        self._must("generate", "{inputs}/experiment.yaml --examples 48 --out {inputs}/data")
        with_torch = self._must("train", "{inputs}/experiment.yaml --data {inputs}/data --out {inputs}/model.h5",
                                may_lack="made without libtorch")
        if not with_torch:
            without = [work for work in self.works
                       if "{inputs}/model.h5" not in work.arguments and work.name not in ("train", "learn")]
            print("made without libtorch, so left out: "
                  + " ".join(work.name for work in self.works if work not in without), flush=True)
            self.works = without
        # Each step of learn is another of these commands.
        self.single_works = [work for work in self.works if work.name != "learn"]
        self._right = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._temporary.cleanup()

    def _must(self, command, arguments, may_lack=None):
        end = self.start(command + " " + arguments, self.folder).finish()
        if end.code != 0 and not (may_lack and may_lack in end.errors):
            raise SystemExit(f"weft {command} of the inputs failed with {end.code}: {end.errors}")
        return end.code == 0

    def start(self, arguments, folder, environment=None, before=(), options=Work.options):
        """Starts weft in a folder. @param before words before the program, such as `taskset -c 0`."""
        words = [*before, self.weft, *arguments.replace("{inputs}", str(self.inputs)).split(), *options]
        return Running(words, folder, {**CLEAN, **(environment or {})})

    def begin(self, work, folder, environment=None, before=(), options=None):
        return self.start(work.arguments, folder, environment, before, options or work.options)

    def right(self, work):
        """{file name: bytes} of the undisturbed result, and the seconds that it took."""
        if work.name not in self._right:
            folder = self.folder / f"right-{work.name}"
            folder.mkdir()
            started = time.monotonic()
            end = self.begin(work, folder).finish()
            if end.code != 0:
                raise SystemExit(f"weft {work.name} failed undisturbed with {end.code}: {end.errors}")
            self._right[work.name] = (contents(folder / "out"), time.monotonic() - started)
        return self._right[work.name]


CLEAN = {name: value for name, value in os.environ.items() if not name.startswith(("WEFT_", "LC_", "LANG"))}


@dataclass
class End:
    code: int  # minus the signal, if one ended it
    errors: str  # what it wrote to stderr


class Running:
    """A started weft, in a process group of its own."""

    def __init__(self, words, folder, environment):
        self._errors = tempfile.TemporaryFile()
        self.process = subprocess.Popen(words, cwd=folder, env=environment, stdin=subprocess.DEVNULL,
                                        stdout=subprocess.DEVNULL, stderr=self._errors, start_new_session=True)

    def finish(self, seconds=600):
        """Waits. A command that takes too long is killed, and has ended with -9."""
        try:
            code = self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            code = self.process.wait()
        self._errors.seek(0)
        return End(code, self._errors.read().decode(errors="replace"))

    def family(self):
        """The processes of its group that live."""
        members = []
        for entry in Path("/proc").iterdir():
            try:
                state, _, group = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
            except (OSError, ValueError):
                continue  # no process, or one that has ended
            if group == str(self.process.pid) and state != "Z":
                members.append(int(entry.name))
        return members


def depends_on_time(name):
    """Whether two equal runs may write this file differently: docs/file-formats.md."""
    return name == "report.html" or name.endswith(("times.json", "times.csv"))


def contents(folder):
    """{name: bytes} of the files of a result that do not depend on the time."""
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*"))
            if file.is_file() and not depends_on_time(file.name)}


def left_behind(folder):
    """Temporaries and claims, which no command that ended by itself may leave."""
    return [str(file.relative_to(folder)) for file in sorted(folder.rglob("*"))
            if ".tmp" in file.name or ".claim" in file.name]


def differences(right, folder):
    """What is wrong with a result, one text each."""
    found = contents(folder) if folder.exists() else {}
    wrong = [f"{name} is missing" for name in right.keys() - found.keys()]
    wrong += [f"{name} is there, and should not be" for name in found.keys() - right.keys()]
    wrong += [f"{name} holds other bytes" for name in right.keys() & found.keys() if right[name] != found[name]]
    return sorted(wrong)


def parser(text):
    """The options that the scripts share."""
    options = argparse.ArgumentParser(description=text.splitlines()[0])
    options.add_argument("weft")
    options.add_argument("--only", type=lambda names: names.split(","), default=(), metavar="NAMES",
                         help="comma-separated: " + " ".join(work.name for work in WORKS))
    options.add_argument("--seed", type=int, default=1)
    return options
