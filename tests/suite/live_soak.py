"""How long a live stream takes from capture to answer, minute by minute, and what it holds of memory.

    python3 tests/suite/live_soak.py target/release/loci IMAGES [MINUTES [FPS]] [--viewer RERUN] [--model DIR]

The images of the folder are played again and again at FPS frames a second (10 minutes at 30, unless told), as a camera
would give them (`--play-fps`), into a map that the first round founds. With `--viewer` the same is done once more while
the program at RERUN looks on: it connects at the beginning, stalls after a fifth, and is killed after two. Prints tables
for BENCHMARKS.md; fails if a frame is lost, dropped or without an answer, or if memory grows by more than a twentieth
between the second fifth and the last.
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
LOSSES = ("unreadable", "lost", "dropped", "spared", "missed")
MOST_GROWTH = 1.05


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("loci", type=Path)
    parser.add_argument("images", type=Path)
    parser.add_argument("minutes", type=float, nargs="?", default=10)
    parser.add_argument("fps", type=float, nargs="?", default=30)
    parser.add_argument("--viewer", type=Path)
    parser.add_argument("--model")
    arguments = parser.parse_args()
    count = round(60 * arguments.minutes * arguments.fps)
    viewers = [None] + ([arguments.viewer] if arguments.viewer else [])
    faults, most = [], []
    for viewer in viewers:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            link_again_and_again(arguments.images, folder / "frames", count)
            records, memory_kib = play(arguments, folder, count, viewer)
        print(f"\n{'A viewer that stalls and dies' if viewer else 'Nobody looks on'}\n")
        most.append(report(records, memory_kib, arguments.fps))
        faults += found_faults(records, memory_kib, count)
    if len(most) == 2:
        print(f"\nWith the viewer, 99 of 100 take {most[1] / most[0]:.3f} times as long.")
    sys.exit("; ".join(faults) or 0)


def link_again_and_again(images, folder, count):
    folder.mkdir()
    images = sorted(path.resolve() for path in images.rglob("*") if path.suffix.lower() in IMAGES)
    for index in range(count):
        image = images[index % len(images)]
        (folder / f"{index:06}{image.suffix}").symlink_to(image)


def play(arguments, folder, count, viewer):
    """Every record, and the memory of the program in KiB every second."""
    command = [arguments.loci, "run", folder / "frames", "--json", "--map", folder / "map",
               "--play-fps", str(arguments.fps)]
    if arguments.model:
        command += ["--model", arguments.model]
    ills = []
    if viewer:
        port = free_port()
        command += ["--rerun", f"connect=127.0.0.1:{port}"]
        looking = subprocess.Popen([viewer, "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        fifth = count / arguments.fps / 5
        ills = [(fifth, signal.SIGSTOP), (2 * fifth, signal.SIGKILL)]
    records, memory_kib, started = [], [], time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as run:
        for line in run.stdout:
            records.append(json.loads(line))
            now = time.monotonic() - started
            if ills and now > ills[0][0]:
                looking.send_signal(ills.pop(0)[1])
            if now > len(memory_kib):
                memory_kib.append(resident_kib(run.pid))
    if viewer:
        looking.kill()
    return records, memory_kib


def report(records, memory_kib, fps):
    """Prints a row a minute and one for all; answers what 99 of 100 took at most."""
    print("| Minute | Capture to answer, median, ms | 99 of 100, ms | Worst, ms | Memory, MiB |")
    print("|---|---:|---:|---:|---:|")
    answers = [record["latency_us"]["answer"] / 1e3 for record in records]
    minute = round(60 * fps)
    for start in range(0, len(records), minute):
        held = memory_kib[start // minute * 60:][:60]
        print(row(start // minute + 1, answers[max(start, WARM_UP):start + minute], held))
    print(row("all", answers[WARM_UP:], memory_kib))
    return at_most(answers[WARM_UP:], 0.99)


def row(name, answers, held_kib):
    figures = [statistics.median(answers), at_most(answers, 0.99), max(answers)] if answers else []
    return f"| {name} | {' | '.join(f'{figure:.1f}' for figure in figures)} | {max(held_kib, default=0) / 1024:.1f} |"


def at_most(values, share):
    return sorted(values)[int(len(values) * share)] if values else 0.0


def found_faults(records, memory_kib, count):
    flow = records[-1]["flow"] if records else {}
    losses = {loss: flow.get(loss) for loss in LOSSES}
    fifth = len(memory_kib) // 5
    growth = max(memory_kib[4 * fifth:]) / max(memory_kib[fifth:2 * fifth]) if fifth else 1.0
    print(f"\n{len(records)} of {count} frames answered; {losses}; memory grew {growth:.3f} times; "
          f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    is_whole = len(records) == count and not any(losses[loss] for loss in ("unreadable", "lost", "dropped"))
    return ([] if is_whole else ["frames were lost"]) + ([] if growth <= MOST_GROWTH else ["memory grew"])


def resident_kib(pid):
    """0 of a program that has just ended."""
    status = Path(f"/proc/{pid}/status")
    found = re.search(r"VmRSS:\s+(\d+)", status.read_text()) if status.exists() else None
    return int(found[1]) if found else 0


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


main()
