#!/usr/bin/env python3
"""How long ranks of a fit take to exchange a gradient, over loopback and with a delay: exchange.py WEFT --data FOLDER [options]

Runs `weft train` over ranks, and prints what rank 0 says at its end. Without a delay the ranks talk over loopback. With one,
each rank is in a network namespace whose only way out is a TUN device, and this program carries the packets from one to the
other: each arrives --delay-ms after it was sent, and those of one sender follow one another at --gbit. That needs root and
/dev/net/tun; the kernel needs no netem. A packet has up to 65,000 bytes, as a network card with segmentation offload takes
them. None is lost. The carrying takes processor time from the ranks.
"""

import argparse
import ctypes
import fcntl
import heapq
import os
import re
import select
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent.parent
LIBC = ctypes.CDLL(None, use_errno=True)
CLONE_NEWNET, TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x40000000, 0x400454CA, 1, 0x1000
MTU = 65000


def enter_namespace(rank, parent):
    """In the child, before it becomes weft: a network of its own, whose TUN device it gives to its parent."""
    if LIBC.unshare(CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), "no network namespace; this needs root")
    device = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", b"tun0", IFF_TUN | IFF_NO_PI))
    for words in ("link set lo up", f"link set tun0 mtu {MTU} up", f"addr add 10.77.0.{rank + 1}/24 dev tun0"):
        subprocess.run(["ip", *words.split()], check=True, stdin=subprocess.DEVNULL)
    socket.send_fds(parent, [b"x"], [device])
    os.close(device)


def carry(devices, delay_s, bytes_per_s, goes_on):
    """Carries packets between the devices, one for each rank, while goes_on()."""
    poll = select.poll()
    rank_of = {device: rank for rank, device in enumerate(devices)}
    for device in devices:
        os.set_blocking(device, False)
        poll.register(device, select.POLLIN)
    waiting, number, free_at = [], 0, [0.0] * len(devices)
    next_look = 0.0
    while True:
        now = time.monotonic()
        if now > next_look:
            if not goes_on():
                return
            next_look = now + 0.2
        while waiting and waiting[0][0] <= now:
            _, _, device, packet = heapq.heappop(waiting)
            try:
                os.write(device, packet)
            except OSError:  # that rank has ended
                pass
        until = min(next_look, waiting[0][0]) if waiting else next_look
        for device, _ in poll.poll(max(0.0, 1e3 * (until - time.monotonic()))):
            try:
                packet = os.read(device, MTU + 100)
            except OSError:
                continue
            to = packet[19] - 1 if packet[0] >> 4 == 4 else -1  # the last byte of the IPv4 address
            if not 0 <= to < len(devices):
                continue
            sender = rank_of[device]
            free_at[sender] = max(free_at[sender], time.monotonic()) + len(packet) / bytes_per_s
            number += 1
            heapq.heappush(waiting, (free_at[sender] + delay_s, number, devices[to], packet))


def run_with_delay(words, ranks, delay_s, bytes_per_s):
    """@return what rank 0 printed."""
    processes, devices, outputs = [], [], []
    for rank in range(ranks):
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        environment = {**os.environ, "WEFT_RANK": str(rank), "WEFT_RANKS": str(ranks), "WEFT_INTERFACE": "tun0"}
        outputs.append(tempfile.TemporaryFile())
        processes.append(subprocess.Popen(words, env=environment, stdin=subprocess.DEVNULL, stdout=outputs[-1],
                                          stderr=subprocess.STDOUT,
                                          preexec_fn=lambda r=rank, s=theirs: enter_namespace(r, s)))
        devices.append(socket.recv_fds(ours, 1, 1)[1][0])
        ours.close()
        theirs.close()
    carry(devices, delay_s, bytes_per_s, lambda: any(one.poll() is None for one in processes))
    for device in devices:
        os.close(device)
    texts = []
    for output in outputs:
        output.seek(0)
        texts.append(output.read().decode(errors="replace"))
    for one, text in zip(processes, texts):
        if one.returncode != 0:
            sys.exit(f"a rank ended with {one.returncode}: {text}")
    return texts[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weft")
    parser.add_argument("--config", default=str(ROOT / "configs/experiments/tshirt.yaml"))
    parser.add_argument("--data", required=True, help="of the config, such as 48 examples")
    parser.add_argument("--ranks", type=int, nargs="+", default=[2, 3, 4])
    parser.add_argument("--rules", nargs="+", default=["adam", "one_bit"], choices=["adam", "sign", "one_bit"],
                        help="one_bit: only for odd numbers of ranks")
    parser.add_argument("--delay-ms", type=float, nargs="+", default=[0], help="one way; 0: over loopback")
    parser.add_argument("--gbit", type=float, default=10.0, help="with a delay: Gbit/s of each rank")
    parser.add_argument("--iterations", type=int, default=20)
    options = parser.parse_args()
    print("ranks  rule      delay ms  MB a rank and iteration  ms an exchange", flush=True)
    for ranks in options.ranks:
        for rule in options.rules:
            if rule == "one_bit" and ranks % 2 == 0:
                continue
            for delay in options.delay_ms:
                with tempfile.TemporaryDirectory(prefix="weft-exchange-") as folder:
                    settings = {"iterations": options.iterations, "warmup": 1, "evaluate_every": options.iterations,
                                "calibrate": "false"}
                    if rule == "adam":
                        settings["parts"] = ranks
                    else:
                        settings |= {"optimiser": "signsgd", "vote": rule, "votes": ranks}
                    words = [options.weft, "train", options.config, "--data", options.data, "--out", f"{folder}/model.h5",
                             "--jobs", "1"]
                    for key, value in settings.items():
                        words += ["--set", f"predictor.params.training.{key}={value}"]
                    if delay > 0:
                        text = run_with_delay(words, ranks, delay / 1e3, options.gbit * 1e9 / 8)
                    else:
                        end = subprocess.run([*words, "--ranks", str(ranks)], check=False, capture_output=True, text=True)
                        text = end.stdout + end.stderr
                    said = re.search(r"sent ([\d.]+) MB in all; an exchange of the gradient took ([\d.]+) ms", text)
                    if said is None:
                        sys.exit(f"weft train did not say it: {text}")
                    sent = float(said.group(1)) / options.iterations
                    print(f"{ranks:5}  {rule:8} {delay:9g} {sent:24.3f} {float(said.group(2)):15.1f}", flush=True)


if __name__ == "__main__":
    main()
