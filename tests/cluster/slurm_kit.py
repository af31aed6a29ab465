"""A real Slurm on one machine: munged, slurmctld and some slurmd on loopback, with folders, ports and a key of their own.

It needs root, since slurmd starts the jobs of any user. Nothing of the machine's own Slurm or munge is used or changed,
and its processes are ended by their ids.
"""

import ctypes
import os
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

PRCTL, PR_SET_PDEATHSIG = ctypes.CDLL(None).prctl, 1
PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "scancel")
CONFIG = """ClusterName=weft
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.sock
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
SlurmctldPort={port}
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
SlurmdTimeout={node_timeout}
SlurmctldTimeout=10
InactiveLimit=0
KillWait=2
MinJobAge=300
JobRequeue=1
SchedulerParameters=sched_interval=1,batch_sched_delay=0,bf_interval=2,sched_min_interval=0
NodeName=n[1-{nodes}] NodeHostname={host} NodeAddr=127.0.0.1 Port=[{first}-{last}] CPUs=2 RealMemory=2000 State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def missing_programs():
    """What of Slurm and munge is not installed."""
    path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
    return [name for name in PROGRAMS if shutil.which(name, path=path) is None]


def free_ports(count):
    """The first of `count` free ports in a row."""
    for first in range(21000 + os.getpid() % 200 * 40, 60000, 40):
        taken = []
        try:
            for port in range(first, first + count):
                one = socket.socket()
                taken.append(one)
                one.bind(("127.0.0.1", port))
            return first
        except OSError:
            continue
        finally:
            for one in taken:
                one.close()
    raise RuntimeError("no free ports")


def all_processes():
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]


def parent_of(process):
    """0 for one that has ended."""
    try:
        return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    except (OSError, ValueError, IndexError):
        return 0


def name_of(process):
    try:
        return Path(f"/proc/{process}/comm").read_text().strip()
    except OSError:
        return ""


def has_open_in(process, folder):
    """Whether a process has a file of a folder open."""
    try:
        return any(os.readlink(file).startswith(f"{folder}/") for file in Path(f"/proc/{process}/fd").iterdir())
    except OSError:
        return False


def descendants(process):
    """The processes that a process started, and those that they started."""
    parents = {one: parent_of(one) for one in all_processes()}
    found, new = [], [process]
    while new:
        new = [one for one, parent in parents.items() if parent in new]
        found += new
    return found


def environment_of(process):
    try:
        words = Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
    except OSError:
        return {}
    return dict(word.decode(errors="replace").split("=", 1) for word in words if b"=" in word)


class Slurm:
    """A context manager: its daemons end with it."""

    def __init__(self, nodes=4, node_timeout=6):
        self.nodes = [f"n{i}" for i in range(1, nodes + 1)]
        self._temporary = tempfile.TemporaryDirectory(prefix="weft-slurm-", ignore_cleanup_errors=True)
        self.folder = Path(self._temporary.name)
        self.folder.chmod(0o755)
        self.host = socket.gethostname()
        first = free_ports(nodes + 1)
        (self.folder / "slurm.conf").write_text(CONFIG.format(
            host=self.host, folder=self.folder, port=first, node_timeout=node_timeout, nodes=nodes,
            first=first + 1, last=first + nodes))
        for name in ("state", *(f"spool-{node}" for node in self.nodes)):
            (self.folder / name).mkdir(mode=0o700)
        key = self.folder / "munge.key"
        key.write_bytes(secrets.token_bytes(1024))
        key.chmod(0o400)
        path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
        # No message of another cluster, and no name of a job around this one.
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith(("SLURM", "SBATCH"))}
        self.environment.update(SLURM_CONF=str(self.folder / "slurm.conf"), PATH=path)
        self._munged = self._controller = None
        self._daemons = {}
        self.wrappers = {}  # node -> words before slurmd

    def __enter__(self):
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _start(self):
        f = self.folder
        self._munged = self._popen(
            "munged", "--foreground", f"--socket={f}/munge.sock", f"--pid-file={f}/munged.pid",
            f"--log-file={f}/munged.log", f"--seed-file={f}/munge.seed", f"--key-file={f}/munge.key", "--force")
        self._until(lambda: (f / "munge.sock").exists(), 10, "munged does not start")
        self.start_controller()
        for node in self.nodes:
            self.start_node(node)
        self.wait_for_nodes()

    def _popen(self, *words):
        # A session of its own: ^C in the terminal does not reach it. It ends when this program is killed.
        return subprocess.Popen(words, env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL, start_new_session=True,
                                preexec_fn=lambda: PRCTL(PR_SET_PDEATHSIG, signal.SIGKILL))

    def _until(self, condition, seconds, problem):
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"{problem}; {self.logs()}")
            time.sleep(0.1)

    def logs(self):
        return "\n".join(f"{log.name}: {log.read_text(errors='replace')[-1500:]}"
                         for log in sorted(self.folder.glob("*.log")))

    def start_controller(self):
        self._controller = self._popen("slurmctld", "-D", "-f", str(self.folder / "slurm.conf"))
        self._until(lambda: self.run("scontrol", "ping").returncode == 0, 20, "slurmctld does not answer")

    def stop_controller(self):
        self._controller.terminate()
        try:
            self._controller.wait(20)
        except subprocess.TimeoutExpired:
            self._controller.kill()
            self._controller.wait()

    def wait_for_nodes(self):
        self._until(lambda: self.states(self.nodes) <= {"idle", "mix", "alloc"}, 30, "the nodes do not register")

    def cancel_all(self):
        """Ends all jobs, and waits until the nodes are free."""
        self.run("scancel", "-u", str(os.getuid()))
        self._until(lambda: self.states(self.nodes) == {"idle"}, 60, "the nodes do not become free")

    def start_node(self, node):
        self._daemons[node] = self._popen(*self.wrappers.get(node, ()), "slurmd", "-D", "-f",
                                          str(self.folder / "slurm.conf"), "-N", node)

    def kill_node(self, node):
        """What a power cut does: its daemon and all that runs on it end at once."""
        daemon = self._daemons.pop(node)
        victims = {daemon.pid, *descendants(daemon.pid), *self.processes_on(node)}
        # Stopped first, so that none of them sees how another one ends and tells slurmctld.
        for sign in (signal.SIGSTOP, signal.SIGKILL):
            for victim in victims:
                self._send(victim, sign)
        for victim in self.processes_on(node):  # begun in the meantime
            self._send(victim, signal.SIGKILL)
        daemon.wait()

    @staticmethod
    def _send(process, sign):
        try:
            os.kill(process, sign)
        except ProcessLookupError:
            pass

    def processes_on(self, node):
        """What runs there: jobs, which are known by their environment, and the slurmstepd that started them."""
        jobs = [process for process in all_processes()
                if (of := environment_of(process)).get("SLURM_CONF") == self.environment["SLURM_CONF"]
                and of.get("SLURMD_NODENAME") == node and process != os.getpid()]
        steps = {parent for job in jobs if name_of(parent := parent_of(job)).startswith("slurmstepd")}
        return [*steps, *jobs]

    def processes_of(self, job):
        """The processes of a job or an array task, by the id of squeue."""
        array, _, task = job.partition("_")
        wanted = {"SLURM_ARRAY_JOB_ID": array, "SLURM_ARRAY_TASK_ID": task} if task else {"SLURM_JOB_ID": array}
        return [process for process in all_processes()
                if (of := environment_of(process)).get("SLURM_CONF") == self.environment["SLURM_CONF"]
                and all(of.get(name) == value for name, value in wanted.items())]

    def run(self, *words, **options):
        return subprocess.run(words, env=self.environment, capture_output=True, text=True, stdin=subprocess.DEVNULL,
                              **options)

    def states(self, nodes):
        out = self.run("sinfo", "-h", "-N", "-n", ",".join(nodes), "-o", "%t").stdout
        return set(out.split())

    def hurry(self):
        """Slurm lets a job that goes back to the queue wait for two minutes; the tests do not."""
        for job, state, reason, _ in self.jobs():
            if state == "PENDING" and reason == "BeginTime":
                self.run("scontrol", "update", f"JobId={job}", "StartTime=now")

    def jobs(self):
        """[(id, state, reason, node)] of all jobs that slurmctld still knows, one per array task."""
        out = self.run("squeue", "-h", "-r", "-t", "all", "-o", "%i|%T|%r|%N").stdout
        return [tuple(line.split("|")) for line in out.splitlines()]

    def __exit__(self, *_):
        if self._controller is not None and self._controller.poll() is None:
            self.run("scancel", "-u", str(os.getuid()))
        for node in list(self._daemons):
            if self._daemons[node].poll() is None:
                self.kill_node(node)
        for node in self.nodes:
            for process in self.processes_on(node):
                self._send(process, signal.SIGKILL)
        for process in all_processes():  # steps that waited for a daemon
            if name_of(process).startswith("slurmstepd") and has_open_in(process, self.folder):
                self._send(process, signal.SIGKILL)
        for daemon in (self._controller, self._munged):
            if daemon is not None and daemon.poll() is None:
                daemon.terminate()
                try:
                    daemon.wait(10)
                except subprocess.TimeoutExpired:
                    daemon.kill()
                    daemon.wait()
        self._temporary.cleanup()
