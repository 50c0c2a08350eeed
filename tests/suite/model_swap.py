"""How long frames take while another model takes over from the running one.

    python3 tests/suite/model_swap.py target/release/loci SOURCE [RUNS]

SOURCE is read as fast as it goes, against the map of a first run through it. Half a second later the link to the model
is turned over to a copy whose network has another hash and does the same. What is measured is what a frame takes
by its own record (latency_us.total), and when its line arrives behind the one before. Each run is followed by one in
which nothing is deployed, judged around the same frame. Prints a table for BENCHMARKS.md; fails if a frame is missing.
"""

import hashlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LOCI = Path(sys.argv[1]).resolve()
SOURCE = sys.argv[2]
RUNS = int(sys.argv[3]) if len(sys.argv) > 3 else 3
SHIPPED = Path(__file__).resolve().parents[2] / "models/efficientnet-lite0"
# Frames on either side of the swap that are looked at.
AROUND = 20


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        other_model(folder / "second")
        link = folder / "current"
        link.symlink_to(SHIPPED)
        first = subprocess.run([LOCI, "run", SOURCE, "--json", "--map", folder / "map"], check=True,
                               stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        frames = len(first.stdout.splitlines())
        print(f"{frames} frames; map of {keyframes(folder / 'map')} keyframes; load {os.getloadavg()[0]:.1f} "
              f"on {os.cpu_count()} cores\n")
        print("| Run | Answered | Swap at | Median, ms | Worst ±20, ms | Ratio | Worst of all, ms | "
              "Lines apart: median, worst ±20, ratio |\n|---|---|---|---|---|---|---|---|")
        for run in range(1, RUNS + 1):
            swapped_at = drive(folder, f"{run}, swap", frames, link, None)
            drive(folder, f"{run}, none", frames, link, swapped_at)


def drive(folder, name, frames, link, around):
    """Runs once over a copy of the map, with a swap if `around` is None, and prints a row."""
    shutil.rmtree(folder / "copy", ignore_errors=True)
    shutil.copytree(folder / "map", folder / "copy")
    turn_over(link, SHIPPED)
    started = time.monotonic()
    arrivals, records, is_deployed = [], [], around is not None
    with subprocess.Popen([LOCI, "run", SOURCE, "--json", "--map", folder / "copy", "--model", link],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        for line in run.stdout:
            arrivals.append(time.monotonic())
            records.append(json.loads(line))
            if not is_deployed and time.monotonic() - started > 0.5:
                turn_over(link, folder / "second")
                is_deployed = True
        said = [line for line in run.stderr.read().decode().splitlines() if line.startswith("loci: ")]
    assert run.returncode == 0, said
    assert [record["frame"] for record in records] == list(range(frames)), "frames are missing"
    if around is None:
        swaps = [record["frame"] for record in records if "model" in record]
        assert len(swaps) == 1, f"the stream was too short, or: {said}"
        around = swaps[0]
        print(f"<!-- {said} -->", file=sys.stderr)
    print(row(name, around, [record["latency_us"]["total"] / 1e3 for record in records], arrivals))
    return around


def row(name, around, totals, arrivals):
    apart = [0.0] + [1e3 * (b - a) for a, b in zip(arrivals, arrivals[1:])]
    near = slice(max(around - AROUND, 1), around + AROUND + 1)
    median, worst = statistics.median(totals), max(totals[near])
    apart_median, apart_worst = statistics.median(apart), max(apart[near])
    return (f"| {name} | {len(totals)} | {around} | {median:.1f} | {worst:.1f} | {worst / median:.2f} | "
            f"{max(totals):.1f} | {apart_median:.1f}, {apart_worst:.1f}, {apart_worst / apart_median:.2f} |")


def other_model(folder):
    folder.mkdir()
    # The last of several producers' names counts: field 2 of the outermost message, a text of five bytes.
    network = (SHIPPED / "model.onnx").read_bytes() + b"\x12\x05again"
    old = hashlib.sha256((SHIPPED / "model.onnx").read_bytes()).hexdigest()
    card = (SHIPPED / "card.toml").read_text().replace(old, hashlib.sha256(network).hexdigest())
    (folder / "model.onnx").write_bytes(network)
    (folder / "card.toml").write_text(card.replace('"efficientnet-lite0"', '"site-2"', 1))


def turn_over(link, folder):
    beside = link.with_suffix(".next")
    beside.symlink_to(folder)
    beside.rename(link)


def keyframes(folder):
    info = subprocess.run([LOCI, "map", "info", folder, "--json"], check=True, stdout=subprocess.PIPE)
    return json.loads(info.stdout)["keyframes"]


main()
