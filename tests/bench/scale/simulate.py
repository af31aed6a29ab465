#!/usr/bin/env python3
"""How long a dataset takes on many machines, where it saturates, and what failures cost: simulate.py [options]

A model of `weft generate --on slurm` by discrete events, with unit costs that measure.py measured (docs/scale.md). Tasks are
started by slurmctld one after the other, and each needs start_s before its first example. A task makes one file at a time
with all its cores. For each file it looks through the list of files until it finds one that nobody has: a look costs look_s
at the file server, a claim claim_s, a written file write_s and its bytes. The server answers one request after the other. A
node that fails loses its file; its tasks begin again after detect_s and requeue_s, and its claim is taken when nobody
touched it for claim_dead_s.

simulate.py --processors K says how many processors all tasks really share; docs/scale.md compares that with runs on two.
"""

import argparse
import heapq
import random
from dataclasses import dataclass, fields


@dataclass
class Costs:
    start_s: float = 0.6  # CPU time of weft until its first example
    example_s: float = 0.5  # CPU time of an example
    spread: float = 0.3  # standard deviation of the time of an example, relative
    example_bytes: float = 60e3
    look_s: float = 20e-6  # the file server: whether a file is there
    claim_s: float = 300e-6  # a claim, and its end
    write_s: float = 5e-3  # a file, with fsync and rename
    bandwidth: float = 500e6  # bytes/s of the file server
    task_starts_per_s: float = 20.0  # of slurmctld
    node_mtbf_h: float = 10000.0  # mean time between failures of one node
    detect_s: float = 300.0  # until slurmctld knows (SlurmdTimeout)
    requeue_s: float = 120.0
    claim_dead_s: float = 60.0


@dataclass
class Plan:
    examples: int
    shard: int  # examples of a file
    cores: int
    cores_per_task: int
    cores_per_node: int = 50
    processors: float = 0  # that all tasks share; 0: as many as cores


class Server:
    """Requests are answered in the order in which they come."""

    def __init__(self):
        self.free_at, self.busy = 0.0, 0.0

    def request(self, now, seconds):
        begin = max(now, self.free_at)
        self.free_at = begin + seconds
        self.busy += seconds
        return self.free_at


def simulate(plan, costs, seed=1):
    """@return a dict: seconds, ideal_s, efficiency, server_load, failures, lost_examples."""
    dice = random.Random(seed)
    files = (plan.examples + plan.shard - 1) // plan.shard
    tasks = max(1, min(plan.cores // plan.cores_per_task, files))
    slow = max(1.0, tasks * plan.cores_per_task / plan.processors) if plan.processors else 1.0
    server = Server()
    free = 0  # the next file that nobody has had
    returned = []  # (time, file) of files whose task's node failed
    lost = failures = 0
    last = 0.0
    tasks_per_node = max(1, plan.cores_per_node // plan.cores_per_task)
    rate = 1.0 / (costs.node_mtbf_h * 3600.0) / tasks_per_node  # failures that one task sees as the first of its node
    events = []  # (time, task, examples of the file that it has made; 0: it looks for one)
    seen = [0] * tasks  # files that a task has looked at
    for task in range(tasks):
        heapq.heappush(events, (task / costs.task_starts_per_s + costs.start_s * slow, task, 0))
    while events:
        now, task, made = heapq.heappop(events)
        if made:
            last = max(last, server.request(now, costs.write_s + made * costs.example_bytes / costs.bandwidth))
            heapq.heappush(events, (server.free_at, task, 0))
            continue
        if returned and returned[0][0] <= now:
            heapq.heappop(returned)
        elif free < files:
            free += 1
        elif returned:
            heapq.heappush(events, (returned[0][0], task, 0))
            continue
        else:  # others work on the rest: the task looks at the files that it has not seen, and ends
            last = max(last, server.request(now, costs.look_s * (files - seen[task])))
            continue
        looks = max(0, free - seen[task])
        seen[task] = free
        now = server.request(now, costs.look_s * looks + costs.claim_s)
        size = min(plan.shard, plan.examples)
        mean = size * costs.example_s * slow / plan.cores_per_task
        work = max(0.2 * mean, dice.gauss(mean, mean * costs.spread / max(1.0, size) ** 0.5))
        # The last examples of a file leave some cores idle.
        work += costs.example_s * slow * (1.0 - 1.0 / plan.cores_per_task) / 2.0
        fails_after = dice.expovariate(rate * tasks_per_node)
        if fails_after < work:
            failures += 1 if dice.random() < 1.0 / tasks_per_node else 0
            lost += size * fails_after / work
            heapq.heappush(returned, (now + fails_after + costs.claim_dead_s, 0))
            heapq.heappush(events, (now + fails_after + costs.detect_s + costs.requeue_s + costs.start_s * slow, task, 0))
            continue
        heapq.heappush(events, (now + work, task, size))
    processors = plan.processors or tasks * plan.cores_per_task
    ideal = plan.examples * costs.example_s / processors
    return {"tasks": tasks, "files": files, "seconds": last, "ideal_s": ideal, "efficiency": ideal / last,
            "server_load": server.busy / last, "failures": failures, "lost_examples": lost}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--examples", type=int, default=10_000_000)
    parser.add_argument("--cores", type=int, nargs="+", default=[10, 100, 1000, 3000, 10000])
    parser.add_argument("--shards", type=int, nargs="+", default=[16, 64, 256, 1024, 4096], help="examples of a file")
    parser.add_argument("--cores-per-task", type=int, nargs="+", default=[4])
    parser.add_argument("--processors", type=float, default=0, help="that all tasks share; 0: as many as cores")
    parser.add_argument("--seed", type=int, default=1)
    for field in fields(Costs):
        parser.add_argument("--" + field.name.replace("_", "-"), type=float, default=field.default)
    options = parser.parse_args()
    costs = Costs(**{field.name: getattr(options, field.name) for field in fields(Costs)})
    print("  cores  per task  shard   files  tasks     hours  efficiency  server load  failures/h  lost examples")
    for cores in options.cores:
        for per_task in options.cores_per_task:
            for shard in options.shards:
                r = simulate(Plan(options.examples, shard, cores, per_task, processors=options.processors), costs, options.seed)
                hours = r["seconds"] / 3600
                print(f"{cores:7} {per_task:9} {shard:6} {r['files']:7} {r['tasks']:6} {hours:9.3f} {r['efficiency']:11.3f}"
                      f" {r['server_load']:12.3f} {r['failures'] / hours:11.2f} {r['lost_examples']:14.0f}", flush=True)


if __name__ == "__main__":
    main()
