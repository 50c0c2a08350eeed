"""What a robot that stands still makes of the change from day to night: nine webcams, one after the other, in time order.

    python3 tests/suite/webcam_stream.py target/release/loci [--interleaved]

The program gets all frames as one stream, no labels and an empty map, in its default configuration. A place is the camera's
that most of what it learnt came from. Night is the darkest 30 % of each camera; its frames before which the camera was not
seen yet are left out, for there is nothing to join. LOCI_DATA names the folder of the sequences.
With --interleaved all frames come in the order of their times, almost every one from another camera than the one before.
"""

import argparse
import csv
import json
import os
import subprocess
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

NIGHT = 0.3


def rows(data, is_interleaved):
    with open(data / "ground_truth.csv") as table:
        return sorted(csv.DictReader(table), key=lambda row: (not is_interleaved and row["place"], row["captured_at_utc"]))


def stream(program, options, frames, folder):
    """A record of every frame."""
    pictures = folder / "frames"
    pictures.mkdir()
    for index, frame in enumerate(frames):
        (pictures / f"{index:05d}.jpg").symlink_to(frame.resolve())
    command = [program, "run", pictures, "--map", folder / "map", "--json", *options]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return [json.loads(line) for line in answer.stdout.splitlines()]


def nights(table):
    """Indices of the darkest frames of each camera, of those after its first."""
    of_camera = defaultdict(list)
    for index, row in enumerate(table):
        of_camera[row["place"]].append(index)
    dark = [sorted(frames, key=lambda frame: float(table[frame]["mean_luminance"]))[:int(NIGHT * len(frames))] for frames in of_camera.values()]
    return [frame for frames, first in zip(dark, of_camera.values()) for frame in frames if frame > first[0]]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program", type=Path, help="the program loci")
    parser.add_argument("--interleaved", action="store_true", help="all cameras at once, by the clock")
    parser.add_argument("--place-interval", help="that of the program, instead of its default")
    arguments = parser.parse_args()
    program, options = arguments.program.resolve(), []
    if arguments.place_interval:
        options = ["--place-interval", arguments.place_interval]
    data = Path(os.environ.get("LOCI_DATA", "../shared/data")) / "webcams_day_night"
    table = rows(data, arguments.interleaved)
    with tempfile.TemporaryDirectory() as name:
        records = stream(program, options, [data / row["file"] for row in table], Path(name))
    learnt = defaultdict(Counter)
    for record, row in zip(records, table, strict=True):
        if record["experience"] is not None:
            learnt[record["place"]][row["place"]] += 1
    owner = {place: cameras.most_common(1)[0][0] for place, cameras in learnt.items()}
    pure = sum(cameras.most_common(1)[0][1] for cameras in learnt.values())
    count = sum(map(Counter.total, learnt.values()))
    if not count:
        raise SystemExit("nothing was learnt")
    dark = nights(table)
    known = [frame for frame in dark if records[frame]["decision"] not in ("unknown", "new_place")]
    right = sum(owner.get(records[frame]["place"]) == table[frame]["place"] for frame in known)
    print(f"{len(records)} frames of {len(set(owner.values()))} cameras: {len(owner)} places, {count} frames learnt")
    print(f"purity {pure / count:.4f} ({pure}/{count})")
    print(f"night frames that join a place of their camera: {right / len(dark):.4f} ({right}/{len(dark)}); of another: {len(known) - right}")


if __name__ == "__main__":
    main()
