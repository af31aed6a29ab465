#!/usr/bin/env python3
"""An environment of weft that replays a recorded session (docs/environment-protocol.md):

weft export RECORDED --to csv --every 12 --out replay
weft run TASK --set environment.command=[python3,replay_environment.py,replay/vertices.csv] --set knowledge=none
"""
import csv
import json
import sys

frames = {}  # number: [V][3] m
with open(sys.argv[1], newline="") as file:
    for row in csv.DictReader(file):
        frames.setdefault(int(row["frame"]), []).append([float(row[key]) for key in ("x_m", "y_m", "z_m")])

frame, frames_per_segment = 0, 12
for line in sys.stdin:
    request = json.loads(line)
    kind = request["type"]
    if kind == "hello":
        frames_per_segment = request["frames_per_segment"]
        answer = {"type": "hello", "protocol": "weft environment", "version": 1}
    elif kind == "execute":
        frame += frames_per_segment
        answer = {"type": "executed"}
    elif kind == "release":
        frame = max(frames)
        answer = {"type": "released", "settled": True}
    elif kind == "observe" and frame in frames:
        answer = {"type": "observation", "positions_m": frames[frame]}
    else:
        answer = {"type": "error", "message": f"no answer to {kind} at frame {frame} of the recording"}
    print(json.dumps(answer), flush=True)
