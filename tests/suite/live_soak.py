"""How long a live stream takes from capture to answer, minute by minute, and what it holds of memory.

    python3 tests/suite/live_soak.py target/release/loci IMAGES [MINUTES [FPS]] [--viewer RERUN] [--model DIR]

The images of the folder are played again and again at FPS frames a second (10 minutes at 30, unless told), as a camera
would give them (`--play-fps`), into a map that the first round founds. With `--viewer` the program at RERUN looks on: it
connects in the first fifth, stalls in the second, and is killed in the third. Prints a table for BENCHMARKS.md; fails if a
frame is dropped, lost or without an answer.
"""

import argparse
import json
import os
import re
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

IMAGES = {".jpg", ".jpeg", ".png"}
# Frames of the beginning that are not judged: files and models are read for the first time.
WARM_UP = 100


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("loci", type=Path)
    parser.add_argument("images", type=Path)
    parser.add_argument("minutes", type=float, nargs="?", default=10)
    parser.add_argument("fps", type=float, nargs="?", default=30)
    parser.add_argument("--viewer", type=Path)
    parser.add_argument("--model", default=None)
    arguments = parser.parse_args()
    count = round(60 * arguments.minutes * arguments.fps)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        link_again_and_again(arguments.images, folder / "frames", count)
        records, memory_kib = play(arguments, folder, count)
    report(records, memory_kib, arguments.fps)
    flow = records[-1]["flow"]
    lost = {loss: flow[loss] for loss in ("unreadable", "lost", "dropped", "spared", "missed")}
    print(f"\n{len(records)} of {count} frames answered; {lost}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    is_whole = len(records) == count and not any(lost[loss] for loss in ("unreadable", "lost", "dropped"))
    sys.exit(0 if is_whole else "frames were lost")


def link_again_and_again(images, folder, count):
    folder.mkdir()
    images = sorted(path.resolve() for path in images.rglob("*") if path.suffix.lower() in IMAGES)
    for index in range(count):
        image = images[index % len(images)]
        (folder / f"{index:06}{image.suffix}").symlink_to(image)


def play(arguments, folder, count):
    """Every record, and the memory of the program in KiB every second, with its time in seconds."""
    command = [arguments.loci, "run", folder / "frames", "--json", "--map", folder / "map",
               "--play-fps", str(arguments.fps)]
    if arguments.model:
        command += ["--model", arguments.model]
    if arguments.viewer:
        port = free_port()
        command += ["--rerun", f"connect=127.0.0.1:{port}"]
        viewer = subprocess.Popen([arguments.viewer, "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)],
                                  stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    fifth = count / arguments.fps / 5
    ills = [(fifth, signal.SIGSTOP), (2 * fifth, signal.SIGKILL)] if arguments.viewer else []
    records, memory_kib, started, looked = [], [], time.monotonic(), 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as run:
        for line in run.stdout:
            records.append(json.loads(line))
            now = time.monotonic() - started
            if ills and now > ills[0][0]:
                viewer.send_signal(ills.pop(0)[1])
            if now - looked >= 1:
                memory_kib.append((now, resident_kib(run.pid)))
                looked = now
    return records, memory_kib


def report(records, memory_kib, fps):
    print("| Minute | Capture to answer, median, ms | 99 of 100, ms | Worst, ms | Memory, MiB |\n|---|---:|---:|---:|---:|")
    answers = [record["latency_us"]["answer"] / 1e3 for record in records]
    minute = round(60 * fps)
    for start in range(0, len(records), minute):
        judged = answers[max(start, WARM_UP):start + minute]
        held = [kib for seconds, kib in memory_kib if start <= seconds * fps < start + minute]
        print(row(start // minute + 1, judged, max(held, default=0) / 1024))
    print(row("all", answers[WARM_UP:], max(kib for _, kib in memory_kib) / 1024))


def row(name, answers, mib):
    answers = sorted(answers)
    most = answers[len(answers) * 99 // 100]
    return f"| {name} | {statistics.median(answers):.1f} | {most:.1f} | {answers[-1]:.1f} | {mib:.1f} |"


def resident_kib(pid):
    status = Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", status)[1])


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


main()
