"""How long a live stream takes from capture to answer, and what it holds of memory.

    python3 tests/suite/live_soak.py target/release/loci IMAGES [MINUTES [FPS]] [--viewer RERUN [--rounds N]]

The images of the folder are played again and again at FPS frames a second (10 minutes at 30, unless told), as a camera
would give them (`--play-fps`), into a map that the first round founds. With `--viewer` that is done N times (5, unless
told) with nobody looking on and N times while the program at RERUN does, in turn: it connects at the beginning, stalls
after a fifth of the time, and is killed after two. Prints tables for BENCHMARKS.md; fails if a frame is lost, dropped
or without an answer, or if memory grows by more than a twentieth between the second fifth and the last.
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
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--model")
    arguments = parser.parse_args()
    faults = compare(arguments) if arguments.viewer else soak(arguments)
    sys.exit("; ".join(faults) or 0)


def soak(arguments):
    records, memory_kib = play(arguments, None)
    report(records, memory_kib, arguments.fps)
    return found_faults(records, memory_kib, arguments)


def compare(arguments):
    """Rounds without and with a viewer in turn, so that whatever else the machine does falls on both."""
    names = {None: "nobody", arguments.viewer: "a viewer"}
    rows, most, faults = [], {viewer: [] for viewer in names}, []
    for number in range(1, arguments.rounds + 1):
        for viewer, name in names.items():
            records, memory_kib = play(arguments, viewer)
            faults += found_faults(records, memory_kib, arguments)
            answers = answers_ms(records)[WARM_UP:]
            most[viewer].append(at_most(answers, 0.99))
            rows.append(row(f"{number}, {name}", answers, memory_kib))
    print_head("Round, who looks on")
    print("\n".join(rows))
    ratios = sorted(with_viewer / alone for alone, with_viewer in zip(*most.values()))
    print(f"\nWith the viewer, 99 of 100 take {statistics.median(ratios):.3f} times as long (median of "
          f"{len(ratios)} rounds, {ratios[0]:.3f} to {ratios[-1]:.3f}).")
    return faults


def link_again_and_again(images, folder, count):
    folder.mkdir()
    images = sorted(path.resolve() for path in images.rglob("*") if path.suffix.lower() in IMAGES)
    for index in range(count):
        image = images[index % len(images)]
        (folder / f"{index:06}{image.suffix}").symlink_to(image)


def play(arguments, viewer):
    """Every record, and the memory of the program in KiB every second."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        link_again_and_again(arguments.images, folder / "frames", frame_count(arguments))
        command = [arguments.loci, "run", folder / "frames", "--json", "--map", folder / "map",
                   "--play-fps", str(arguments.fps)]
        if arguments.model:
            command += ["--model", arguments.model]
        if viewer is None:
            return listen(command, lambda seconds: None)
        port = free_port()
        # What is called rerun may be a script that starts the viewer: all of them are to be stopped and killed.
        looking = subprocess.Popen([viewer, "--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        fifth = 60 * arguments.minutes / 5
        ills = [(fifth, signal.SIGSTOP), (2 * fifth, signal.SIGKILL)]

        def harm(seconds):
            if ills and seconds > ills[0][0]:
                if looking.poll() is not None:
                    sys.exit(f"the viewer ended by itself ({looking.returncode})")
                os.killpg(looking.pid, ills.pop(0)[1])

        try:
            return listen(command + ["--rerun", f"connect=127.0.0.1:{port}"], harm)
        finally:
            if ills:
                os.killpg(looking.pid, signal.SIGKILL)
            looking.wait()


def listen(command, every_frame):
    records, memory_kib, started = [], [], time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as run:
        for line in run.stdout:
            records.append(json.loads(line))
            now = time.monotonic() - started
            every_frame(now)
            if now > len(memory_kib):
                memory_kib.append(resident_kib(run.pid))
    return records, memory_kib


def frame_count(arguments):
    return round(60 * arguments.minutes * arguments.fps)


def report(records, memory_kib, fps):
    """Prints a row a minute and one for all."""
    print_head("Minute")
    answers = answers_ms(records)
    minute = round(60 * fps)
    for start in range(0, len(records), minute):
        held = memory_kib[start // minute * 60:][:60]
        print(row(start // minute + 1, answers[max(start, WARM_UP):start + minute], held))
    print(row("all", answers[WARM_UP:], memory_kib))


def print_head(first):
    print(f"| {first} | Capture to answer, median, ms | 99 of 100, ms | Worst, ms | Memory, MiB |")
    print("|---|---:|---:|---:|---:|")


def answers_ms(records):
    return [record["latency_us"]["answer"] / 1e3 for record in records]


def row(name, answers, held_kib):
    figures = [statistics.median(answers), at_most(answers, 0.99), max(answers)] if answers else []
    return f"| {name} | {' | '.join(f'{figure:.1f}' for figure in figures)} | {max(held_kib, default=0) / 1024:.1f} |"


def at_most(values, share):
    return sorted(values)[int(len(values) * share)] if values else 0.0


def found_faults(records, memory_kib, arguments):
    count = frame_count(arguments)
    flow = records[-1]["flow"] if records else {}
    losses = {loss: flow.get(loss) for loss in LOSSES}
    fifth = len(memory_kib) // 5
    growth = max(memory_kib[4 * fifth:]) / max(memory_kib[fifth:2 * fifth]) if fifth else 1.0
    print(f"{len(records)} of {count} frames answered; {losses}; memory grew {growth:.3f} times; "
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
