#!/usr/bin/env python3
"""`weft ... --on slurm` with a real Slurm on this machine, and what goes wrong in clusters: test_slurm.py WEFT [options]

Four nodes on loopback (slurm_kit.py). Each scenario runs a sweep or another command on them, breaks something, and compares
the result with that of one process, byte for byte: nothing is lost, nothing is there twice, and weft says what happened.
--all adds what takes longer: a real time limit, ranks under mpirun, and every other command that takes --on. Exit code 0: all
held; 1: not; 77: Slurm is not installed, or this is not root, and nothing was tested.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import traceback
from pathlib import Path

from slurm_kit import Slurm, environment_of, missing_programs, name_of, parent_of

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "long"))
import fault_kit  # noqa: E402

SKIPPED = 77
SEEDS = 8  # of two arms: cells of a sweep


class Failed(Exception):
    pass


def require(condition, text):
    if not condition:
        raise Failed(text)


class Bench:
    """The cluster, the inputs, and the right results."""

    def __init__(self, weft, slurm, folder, plugins=None):
        self.weft, self.slurm, self.folder = str(Path(weft).resolve()), slurm, folder
        task = fault_kit.TASK
        if plugins:  # a cell lasts some seconds, so that it can be broken in the middle
            task = task.replace("optimiser: {plugin: rprop}",
                                f"optimiser: {{plugin: patient, params: {{pause_s: 0.4}}}}\nplugin_path: ['{plugins.resolve()}']")
            require("patient" in task, "the task has another optimiser")
        for name, text in (("task", task), ("ablation", fault_kit.ablation(SEEDS)),
                           ("experiment", fault_kit.EXPERIMENT), ("physics", fault_kit.PHYSICS)):
            (folder / f"{name}.yaml").write_text(text)
        self.environment = {name: value for name, value in slurm.environment.items()
                            if not name.startswith(("WEFT_", "LC_", "LANG"))}
        self.environment["XDG_CONFIG_HOME"] = str(folder / "config")
        self.profile("test")
        self._right = {}
        self.out = None

    def profile(self, name, **keys):
        """A profile in the user's folder: four tasks, one a node."""
        values = {"cpus": 2, "tasks": 4, "poll_s": 1, "grace_s": 15, **keys}
        file = self.folder / "config" / "weft" / f"{name}.yaml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("".join(f"{key}: {json.dumps(value)}\n" for key, value in values.items()))

    def start(self, arguments, *options, stdout=subprocess.PIPE):
        """Starts weft in the folder of the inputs."""
        return subprocess.Popen([self.weft, *shlex.split(arguments), *options], cwd=self.folder, env=self.environment,
                                stdin=subprocess.DEVNULL, stdout=stdout, stderr=subprocess.STDOUT, text=True)

    def run(self, arguments, *options, seconds=180, code=0):
        """@return what it printed."""
        process = self.start(arguments, *options)
        end, text = time.monotonic() + seconds, None
        while text is None:
            try:
                text = process.communicate(timeout=1)[0]
            except subprocess.TimeoutExpired:
                self.slurm.hurry()
                if time.monotonic() > end:
                    process.kill()
                    raise Failed(f"weft {arguments} did not end: {process.communicate()[0]}\n{self.slurm.jobs()}") from None
        require(code is None or process.returncode == code,
                f"weft {arguments} {' '.join(options)} ended with {process.returncode}, must be {code}: {text}")
        return text

    def submit(self, arguments, out, profile="test", file=""):
        """Submits and comes back. @param file of the result, such as /model.h5. @return the ids of array and merge."""
        self.out = self.folder / out
        self.run(f"{arguments} --out {out}{file} --detach", "--on", f"slurm:{profile}")
        return self.record(arguments)

    def record(self, arguments):
        label = "-".join(word for word in arguments.split()[:2] if not word.endswith(".yaml"))  # evaluate-physics
        record = json.loads(next((self.out / "slurm").glob(f"{label}*/submission.json")).read_text())
        return record["array"], record["merge"]

    def say_status(self, code=0):
        """@return what `weft status` prints."""
        return self.run("status", str(self.out), code=code)

    def status(self):
        return json.loads(self.run("status --json", str(self.out), code=None))[0]

    def wait_for_units(self, count, seconds=90):
        """Until so many units of work are there, while the work goes on."""
        end = time.monotonic() + seconds
        while (status := self.status())["done"] < count:
            require(time.monotonic() < end and not status["is_over"], f"{count} units do not come: {status}")
            time.sleep(0.2)

    def wait_until_over(self, seconds=180):
        end = time.monotonic() + seconds
        while not (status := self.status())["is_over"]:
            require(time.monotonic() < end, f"it does not end: {status}\n{self.slurm.jobs()}\n{self.logs()}")
            self.slurm.hurry()
            time.sleep(0.5)
        return status

    def logs(self):
        return "\n".join(f"{log.name}: {log.read_text(errors='replace')[-1500:]}"
                         for log in sorted(self.out.glob("slurm/*/logs/*.log")))

    def right(self, arguments, file=""):
        """{file: bytes} of one process with two jobs, which writes to a folder of the same name: some results hold it."""
        if arguments not in self._right:
            folder = self.folder / f"right{len(self._right)}"
            folder.mkdir()
            for one in self.folder.iterdir():
                if (one.suffix == ".yaml" or one.name in ("data", "model")) and one != self.out:
                    (folder / one.name).symlink_to(one)
            name = self.out.name if file else "out"
            jobs = "8" if arguments == SWEEP else "2"  # its cells wait more than they work
            one = subprocess.run([self.weft, *shlex.split(arguments), "--out", name + file, "--jobs", jobs, "--quiet"], cwd=folder,
                                 env=self.environment, capture_output=True, text=True, check=False)
            require(one.returncode == 0, f"weft {arguments} in one process failed: {one.stderr}")
            self._right[arguments] = fault_kit.contents(folder / name)
        return self._right[arguments]

    def require_right(self, arguments, file=""):
        """The result equals that of one process, and nothing is left behind."""
        found = {name: data for name, data in fault_kit.contents(self.out).items() if not name.startswith("slurm/")}
        right = self.right(arguments, file)
        wrong = sorted(name for name in right.keys() | found.keys() if right.get(name) != found.get(name))
        require(not wrong, f"not as from one process: {wrong}\n{self.logs()}")
        left = fault_kit.left_behind(self.out)
        require(not left, f"left behind: {left}")

    def require_done(self, arguments, *texts, file=""):
        """Waits, and checks the result and what weft says about the run. @return that."""
        status = self.wait_until_over()
        require(status["is_done"], f"not done: {status}\n{self.logs()}")
        self.require_right(arguments, file)
        said = self.say_status()
        for text in texts:
            require(text in said, f"'{text}' is not said: {said}")
        return said


SWEEP = "ablate ablation.yaml"


def plain(bench):
    """Followed to its end; called again, it submits nothing; a second command for the folder is refused as ever."""
    bench.out = bench.folder / "plain"
    dry = bench.run(f"{SWEEP} --out plain --dry-run", "--on", "slurm:test")
    require("#SBATCH --array=1-4" in dry and "--dependency" not in dry, f"the dry run shows: {dry}")
    require(not bench.out.exists() and not bench.slurm.jobs(), "the dry run did something")
    text = bench.run(f"{SWEEP} --out plain", "--on", "slurm:test")
    require(f"{2 * SEEDS} of {2 * SEEDS} cells" in text and "error_mm" in text, f"it said: {text}")
    bench.require_done(SWEEP)
    before = len(bench.slurm.jobs())
    text = bench.run(f"{SWEEP} --out plain", "--on", "slurm:test")
    require("nothing was submitted" in text and len(bench.slurm.jobs()) == before, f"called again: {text}")
    nodes = {node for job, _, _, node in bench.slurm.jobs() if "_" in job}
    require(len(nodes) > 1, f"all tasks ran on {nodes}")


def node_killed(bench):
    """A node loses its power in the middle of its task. Slurm finds out and starts the task on another one."""
    array, _ = bench.submit(SWEEP, "node_killed")
    bench.wait_for_units(3)
    running = [(job, node) for job, state, _, node in bench.slurm.jobs() if job.startswith(array) and state == "RUNNING"]
    require(running, "no task runs any more")
    job, node = running[0]
    bench.slurm.kill_node(node)
    try:
        said = bench.require_done(SWEEP)
        task = job.partition("_")[2]
        require(f"task {task} was started" in said or f"task {task} failed on {node}" in said or
                (bench.out / f"slurm/ablate/tasks/{array}.all-done").exists(), f"nothing is said about task {task}: {said}")
    finally:
        bench.slurm.start_node(node)
        bench.slurm.wait_for_nodes()


def killed_and_requeued(bench):
    """kill -9 of weft in one task, of the script of another one, and a third that an administrator requeues."""
    array, _ = bench.submit(SWEEP, "killed")
    bench.wait_for_units(2)
    tasks = [job for job, state, _, _ in bench.slurm.jobs() if job.startswith(array + "_") and state == "RUNNING"]
    require(len(tasks) >= 3, f"only {tasks} run")
    # The script is the child of slurmstepd; weft is a child of the script.
    processes = bench.slurm.processes_of(tasks[0])
    programs = [one for one in processes if name_of(one) == "weft" and name_of(parent_of(one)) != "weft"]
    os.kill(programs[0], signal.SIGKILL)
    scripts = [one for one in bench.slurm.processes_of(tasks[1]) if name_of(parent_of(one)).startswith("slurmstepd")]
    os.kill(scripts[0], signal.SIGKILL)
    requeued = bench.slurm.run("scontrol", "requeue", tasks[2])
    require(requeued.returncode == 0, f"scontrol requeue: {requeued.stderr}")
    said = bench.require_done(SWEEP, f"task {tasks[0].partition('_')[2]} was started 2 times", "by a signal from outside")
    require(f"task {tasks[1].partition('_')[2]} failed on n" in said, f"the killed script is not named: {said}")


def ask_to_end(bench, job):
    """As Slurm does before a time limit."""
    sent = bench.slurm.run("scancel", "--signal=TERM", "--batch", job)
    require(sent.returncode == 0, f"scancel: {sent.stderr}")


def asked_to_end(bench):
    """SIGTERM as before a time limit: the task ends at once and goes back to the queue. A cancelled one also ends in order."""
    array, _ = bench.submit(SWEEP, "asked", profile="test")
    bench.wait_for_units(2)
    task, other = [job for job, state, _, _ in bench.slurm.jobs() if job.startswith(array + "_") and state == "RUNNING"][:2]
    ask_to_end(bench, task)
    require(bench.slurm.run("scancel", other).returncode == 0, "scancel failed")
    number, gone = task.partition("_")[2], other.partition("_")[2]
    said = bench.require_done(SWEEP)
    require(re.search(f"task {gone} failed on n.: it was cancelled\n", said), f"the cancelled task is not named: {said}")
    record = (bench.out / f"slurm/ablate/tasks/{other}.txt").read_text()
    require("ended code=75" in record, f"the cancelled task did not end in order: {record}")
    log = (bench.out / f"slurm/ablate/logs/task-{task}.log").read_text()
    record = (bench.out / f"slurm/ablate/tasks/{task}.txt").read_text()
    require("stopping" in log and "goes back to the queue" in log, f"task {number} says: {log}")
    require("ended code=75" in record and "requeued" in record, f"task {number} recorded: {record}")


def never_starts(bench):
    """Only one node is there, and one of the waiting tasks is held: the others do its work, and it is cancelled."""
    others = ",".join(bench.slurm.nodes[1:])
    bench.slurm.run("scontrol", "update", f"NodeName={others}", "State=DRAIN", "Reason=test")
    try:
        array, _ = bench.submit(SWEEP, "never")
        held = bench.slurm.run("scontrol", "hold", f"{array}_4")
        require(held.returncode == 0, f"scontrol hold: {held.stderr}")
        bench.wait_for_units(1)
        said = bench.say_status()
        require("task 4 does not start: JobHeld" in said, f"the held task is not named: {said}")
        bench.require_done(SWEEP)
    finally:
        bench.slurm.run("scontrol", "update", f"NodeName={others}", "State=RESUME")
        bench.slurm.wait_for_nodes()


def controller_restarted(bench):
    """slurmctld goes away in the middle, and comes back; whoever follows the jobs is told, and goes on."""
    bench.right(SWEEP)
    bench.out = bench.folder / "controller"
    log = bench.folder / "follower.log"
    with log.open("w") as stream:
        follower = bench.start(f"{SWEEP} --out controller", "--on", "slurm:test", stdout=stream)

    def wait_until(condition, what):
        end = time.monotonic() + 90
        while not condition():
            require(follower.poll() is None and time.monotonic() < end, f"{what}: {log.read_text()}")
            time.sleep(0.1)

    wait_until(lambda: "submitted jobs" in log.read_text(), "nothing was submitted")
    bench.wait_for_units(1)
    bench.slurm.stop_controller()
    try:
        wait_until(lambda: "Slurm does not answer" in log.read_text(), "it is not said that slurmctld is away")
    finally:
        bench.slurm.start_controller()
    code = follower.wait(timeout=180)
    require(code == 0, f"it ended with {code}: {log.read_text()}")
    bench.require_done(SWEEP)


def no_room(bench):
    """The disk of one node is full: its task says so and fails, and the others do its work."""
    node = bench.slurm.nodes[2]
    cells = bench.folder / "no_room/cells"
    cells.mkdir(parents=True)
    bench.slurm.kill_node(node)
    bench.slurm.wrappers[node] = ("unshare", "-m", "sh", "-c",
                                  f"mount -t tmpfs -o size=8k tmpfs {shlex.quote(str(cells))} && "
                                  f"head -c 8192 /dev/zero >{shlex.quote(str(cells / 'full'))}; "
                                  'exec "$@"', "sh")
    bench.slurm.start_node(node)
    try:
        bench.slurm.wait_for_nodes()
        bench.submit(SWEEP, "no_room")
        bench.require_done(SWEEP, f"failed on {node}: weft ended with exit code 1", "No space left on device")
    finally:
        bench.slurm.kill_node(node)
        del bench.slurm.wrappers[node]
        bench.slurm.start_node(node)
        bench.slurm.wait_for_nodes()


def too_little_memory(bench):
    """Cells that need more memory than their task has count as lost; with enough of it the same command does them again."""
    bench.profile("small", memory_mb=1)
    bench.submit(SWEEP, "memory", profile="small")
    status = bench.wait_until_over()
    table = (bench.out / "ablation.csv").read_text()
    is_said = "there was not enough memory" in table or "std::bad_alloc" in table
    require(not status["is_done"] and is_said, f"{status}: {table}")
    require("the merge failed" in bench.say_status(code=1), "the failure is not said")
    bench.submit(f"{SWEEP} --retry-failed=all", "memory")
    bench.require_done(SWEEP)


def cancelled(bench):
    """Cancelled in the middle; another command is refused meanwhile; the same command submits only what is left."""
    bench.submit(SWEEP, "cancelled")
    bench.wait_for_units(2)
    refused = bench.run(f"{SWEEP} --out cancelled --seed 77 --accept-changed", "--on", "slurm:test", code=2)
    require("jobs of another command are in the queue" in refused, f"refused: {refused}")
    again = bench.run(f"{SWEEP} --out cancelled --detach", "--on", "slurm:test")
    require("in the queue already" in again and "to change it" not in again, f"called again: {again}")
    bench.profile("other", tasks=3)
    bench.profile("test", grace_s=20)
    for profile in ("other", "test"):  # by its name, and by what it says
        again = bench.run(f"{SWEEP} --out cancelled --detach", "--on", f"slurm:{profile}")
        require("the profile test as it was then" in again, f"with another profile: {again}")
    bench.profile("test")
    bench.run("cancel", str(bench.out))
    status = bench.wait_until_over()
    require(not status["is_done"] and 2 <= status["done"] < status["total"], f"after the cancel: {status}")
    require("it was cancelled" in bench.say_status(code=1), "the cancel is not said")
    bench.submit(SWEEP, "cancelled")
    record = json.loads((bench.out / "slurm/ablate/submission.json").read_text())
    require(record["left"] == status["total"] - status["done"], f"submitted {record['left']} after {status}")
    bench.require_done(SWEEP)


def killed_while_submitting(bench):
    """The command was killed after sbatch took the array, before it was noted: the next one finds it, and submits the rest."""
    array, merge = bench.submit(SWEEP, "submitting")
    record = bench.out / "slurm/ablate/submission.json"
    content = json.loads(record.read_text())
    bench.slurm.run("scancel", merge, content["report"])
    record.write_text(json.dumps({**content, "array": "", "merge": "", "report": ""}))
    text = bench.run(f"{SWEEP} --out submitting --detach", "--on", "slurm:test")
    found, new = bench.record(SWEEP)
    require("in the queue already" in text and found == array and new not in ("", merge), f"{found}, {new}: {text}")
    bench.require_done(SWEEP)
    tasks = [job for job, _, _, _ in bench.slurm.jobs() if job.startswith(array + "_")]
    require(len(tasks) == 4, f"tasks {tasks}")


def refusals(bench):
    """What is wrong is said before anything changes."""
    bench.profile("wrong", partition="nowhere")
    text = bench.run(f"{SWEEP} --out wrong", "--on", "slurm:wrong", code=1)
    require("sbatch refused" in text and "partition" in text, f"a partition that is not there: {text}")
    text = bench.run(f"{SWEEP} --out wrong2", "--on", "slurm:tset", code=2)
    require("no profile is called tset" in text and "nearest: test" in text, f"a wrong name: {text}")
    bench.profile("many", tasks=2000)
    (bench.folder / "many.yaml").write_text(fault_kit.ablation(501))  # 1,002 cells; MaxArraySize is 1001
    text = bench.run("ablate many.yaml --out many", "--on", "slurm:many", code=1)
    require("lower `tasks` of the profile" in text, f"an array that is too large: {text}")
    kept = bench.environment["SLURM_CONF"]
    elsewhere = bench.folder / "elsewhere.conf"
    elsewhere.write_text(re.sub("SlurmctldPort=.*", "SlurmctldPort=1", Path(kept).read_text()))
    bench.environment["SLURM_CONF"] = str(elsewhere)
    text = bench.run(f"{SWEEP} --out wrong3", "--on", "slurm:test", code=1)
    bench.environment["SLURM_CONF"] = kept
    require("Slurm does not say" in text, f"without a controller: {text}")
    require(not (bench.folder / "wrong2").exists() and not (bench.folder / "wrong3").exists(), "a folder was made")


def generated(bench):
    """A dataset: files are shared, and a node that reads another config would be refused."""
    work = "generate experiment.yaml --seed 7 --examples 48"
    bench.submit(work, "generated")
    bench.require_done(work)


def physics(bench):
    """A command that is one unit of work."""
    work = "evaluate physics physics.yaml"
    bench.submit(work, "physics")
    bench.require_done(work)


def real_time_limit(bench):
    """A task that needs several times its time limit."""
    bench.profile("limit", tasks=1, time_limit_min=1, grace_s=45, cpus=1)
    (bench.folder / "long.yaml").write_text(fault_kit.ablation(25))
    work = "ablate long.yaml"
    bench.right(work)
    bench.submit(work, "limit", profile="limit")
    bench.wait_until_over(900)
    bench.require_done(work, "as before a time limit")


def fit_data(bench):
    """Examples that fits share."""
    if not (bench.folder / "data").exists():
        bench.run("generate experiment.yaml --examples 48 --out data --quiet")


def wait_for_ranks(bench, job, count, start, seconds=90):
    """Once they have worked, the ranks of the program's n-th start."""
    end = time.monotonic() + seconds
    while True:
        record = (bench.out / f"slurm/train-model/tasks/{job}.txt")
        starts = record.read_text().count("killed") + record.read_text().count("began") if record.exists() else 0
        found = [one for one in bench.slurm.processes_of(job) if name_of(one) == "weft"]
        if starts == start and len(found) == count and list(bench.out.glob("*checkpoint*")):
            return found
        require(time.monotonic() < end, f"start {start} of the ranks does not come: {found}\n{bench.logs()}")
        bench.slurm.hurry()
        time.sleep(0.1)


def with_model(file):
    return "--set " + shlex.quote(f"predictor.params.model={file}")


# The four nodes have one address, and not the names that Slurm gives them, so mpirun is told where its processes run.
MPIRUN = "mpirun --allow-run-as-root --host localhost:2 --mca ras ^slurm --mca plm ^slurm"
FIT_OVER_RANKS = "train experiment.yaml --data data --set predictor.params.training.parts=4"


def trained_over_ranks(bench):
    """srun starts the four ranks of a fit, one on each node. One is killed, and later the job is asked to end: it goes on."""
    fit_data(bench)
    bench.profile("ranks", ranks=4, cpus=2, environment=["WEFT_INTERFACE=lo"])
    array, _ = bench.submit(FIT_OVER_RANKS, "ranks", profile="ranks", file="/model.h5")
    first = wait_for_ranks(bench, f"{array}_1", 4, 1)
    nodes = {environment_of(one)["SLURMD_NODENAME"] for one in first}
    require(len(nodes) == 4, f"the ranks ran on {nodes}")
    os.kill(first[2], signal.SIGKILL)
    wait_for_ranks(bench, f"{array}_1", 4, 2)
    ask_to_end(bench, f"{array}_1")
    bench.require_done(FIT_OVER_RANKS, "the job was started 3 times", "by a signal from outside",
                       "1 x after Slurm asked it to end", file="/model.h5")
    record = (bench.out / f"slurm/train-model/tasks/{array}_1.txt").read_text()
    require("ended code=75 stops=1" in record, f"the ranks were killed, and not asked to end: {record}")


def started_by_mpirun(bench):
    """mpirun of Open MPI starts two ranks on one node. The job is asked to end in the middle, and goes on."""
    require(shutil.which("mpirun"), "no mpirun (Debian: openmpi-bin)")
    fit_data(bench)
    bench.profile("mpi", ranks=2, cpus=1, sbatch=["--nodes=1"], launcher=MPIRUN)
    work, file = f"{FIT_OVER_RANKS} --set predictor.params.training.iterations=600", "/model.h5"
    array, _ = bench.submit(work, "mpi", profile="mpi", file=file)
    ranks = wait_for_ranks(bench, f"{array}_1", 2, 1)
    require({environment_of(one).get("OMPI_COMM_WORLD_RANK") for one in ranks} == {"0", "1"}, "mpirun did not start them")
    ask_to_end(bench, f"{array}_1")
    bench.require_done(work, "the job was started 2 times", "1 x after Slurm asked it to end", file=file)
    log = (bench.out / f"slurm/train-model/logs/task-{array}_1.log").read_text()
    require("2 ranks, 1 threads, from the checkpoint" in log, f"the second start began from the start: {log}")


def evaluated(bench):
    """An evaluation whose cells are shared, of the model of `trained_over_ranks`."""
    model = bench.folder / "ranks/model.h5"
    require(model.exists(), "run it with trained_over_ranks")
    work = f"evaluate planning experiment.yaml {with_model(model)} --cases 2 --widths 0.1 1 --seed 3"
    bench.submit(work, "evaluated")
    bench.require_done(work)


def learned(bench):
    """Fit, calibration and evaluations on the cluster equal those of one process."""
    fit_data(bench)
    work, file = "train experiment.yaml --data data", "/model.h5"
    bench.submit(work, "model", file=file)
    bench.require_done(work, file=file)
    # What was planned decides the numeric variant, also on a machine that would choose another one.
    plan = re.sub(r'"kernels": "\w+"', '"kernels": "v2"', (bench.out / "slurm/train-model/identity.json").read_text())
    require('"kernels": "v2"' in plan, f"no variant was planned: {plan}")
    (bench.folder / "variant/slurm/train-model").mkdir(parents=True)
    (bench.folder / "variant/slurm/train-model/identity.json").write_text(plan)
    bench.run(f"{work} --out variant/model.h5 --quiet")
    saved = (bench.folder / "variant/config.yaml").read_text()
    require(re.search("kernels: \"?v2", saved), f"another variant was taken: {saved}")
    model = with_model(bench.folder / "model/model.h5")  # a saved config holds the whole path
    work = f"calibrate experiment.yaml {model} --data data"
    bench.submit(work, "calibrated", file=file)
    bench.require_done(work, file=file)
    for work in (f"evaluate prediction experiment.yaml {model} --data data",
                 f"evaluate estimation experiment.yaml {model} --cases 3 --seed 5"):
        bench.submit(work, "-".join(work.split()[:2]))
        bench.require_done(work)
    work = "learn experiment.yaml"
    bench.submit(work, "out")  # its calibration names the folder
    bench.require_done(work)


SCENARIOS = [refusals, plain, node_killed, killed_and_requeued, asked_to_end, never_starts, controller_restarted, no_room,
             cancelled, killed_while_submitting, too_little_memory, generated, physics, trained_over_ranks, evaluated]
LONGER = [real_time_limit, started_by_mpirun, learned]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weft")
    parser.add_argument("--plugins", type=Path, help="folder of the optimiser `patient` (patient.cpp): slower cells")
    parser.add_argument("--all", action="store_true", help="also what takes longer")
    parser.add_argument("--only", type=lambda names: names.split(","), metavar="NAMES", help="comma-separated")
    options = parser.parse_args()
    missing = missing_programs()
    if missing or os.getuid() != 0:
        print(f"NOTHING WAS TESTED: {'not installed: ' + ', '.join(missing) if missing else 'this needs root'}")
        return SKIPPED
    chosen = [one for one in SCENARIOS + LONGER if (one.__name__ in options.only if options.only else
                                                    options.all or one in SCENARIOS)]
    failed = 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # the cluster ends with this
    with Slurm() as slurm:
        work = slurm.folder / "it's a folder"  # a word for the shell only in quotation marks
        work.mkdir()
        bench = Bench(options.weft, slurm, work, options.plugins)
        for scenario in chosen:
            started = time.monotonic()
            try:
                scenario(bench)
                print(f"{scenario.__name__}: held ({time.monotonic() - started:.0f} s)", flush=True)
            except Failed as problem:
                failed += 1
                print(f"{scenario.__name__}: FAILED ({time.monotonic() - started:.0f} s): {problem}", flush=True)
            except Exception:  # one that breaks must not hide the others
                failed += 1
                print(f"{scenario.__name__}: BROKE ({time.monotonic() - started:.0f} s)\n{traceback.format_exc()}", flush=True)
            slurm.cancel_all()
    print(f"{len(chosen) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
