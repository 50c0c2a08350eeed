"""How often `loci map merge` joins the right places, and how many places it leaves double.

    LOCI_DATA=DIR python3 tests/suite/joins.py target/release/loci

Each map is made by one `loci run`. Two drives of `robot_laps` are joined with each other: a join is right if a keyframe
of the one place lies within 5 % of a lap of one of the other, and a place of B is double if it has such a place in A
and is not joined. The floors of `tower_walk`, which look alike, are joined with each other, and other recordings with
recordings from elsewhere: there, every join is wrong. Prints a table for BENCHMARKS.md.
"""

import csv
import itertools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

DATA = Path(os.environ["LOCI_DATA"]).resolve()
LOCI = Path(sys.argv[1]).resolve()
LAPS = DATA / "robot_laps"
TOLERANCE = 0.05


def main():
    print("| A | B | Places of A | of B | Joins | right | Places of B left double |\n|---|---|---:|---:|---:|---:|---:|")
    phases = lap_phases()
    with tempfile.TemporaryDirectory() as folder:
        mapped = {}

        def map_of(recording):
            if recording not in mapped:
                path = Path(folder) / str(len(mapped))
                loci("run", recording, "--map", path)
                mapped[recording] = path
            return mapped[recording]

        drives = sorted(path for path in LAPS.iterdir() if path.is_dir())
        for a, b in itertools.permutations(drives, 2):
            joins = joined(map_of(a), map_of(b))
            places, others = (placed(map_of(drive), phases[drive.name]) for drive in (a, b))
            right = [join for join in joins if is_same(places[join["place"]], others[join["other"]])]
            at_both = {other for other in others if any(is_same(there, others[other]) for there in places.values())}
            double = at_both - {join["other"] for join in joins}
            row(a.name, b.name, len(places), len(others), len(joins), len(right), len(double))
        floors = sorted(path for path in (DATA / "tower_walk").iterdir() if path.is_dir())
        unlike(map_of, "a floor of tower_walk", "another floor", itertools.combinations(floors, 2))
        elsewhere = [drives[0], DATA / "corridor_two_laps", floors[0]]
        unlike(map_of, "a recording", "one from elsewhere", itertools.combinations(elsewhere, 2))


def unlike(map_of, a, b, pairs):
    """A row of recordings that share no place."""
    sizes, joins = [0, 0], 0
    for pair in pairs:
        maps = [map_of(recording) for recording in pair]
        joins += len(joined(*maps))
        sizes = [size + len(rows_of(one)) for size, one in zip(sizes, maps)]
    row(a, b, *sizes, joins, 0, "–")


def row(*cells):
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def loci(*arguments):
    done = subprocess.run([LOCI, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode not in (0, 3):
        sys.exit(done.stderr)
    return done.stdout


def joined(a, b):
    return json.loads(loci("map", "merge", a, b, "--dry-run", "--json"))["joins"]


def rows_of(path):
    """The names of its keyframes' frames, by place."""
    places = {}
    for experience in csv.DictReader(loci("map", "export", path, "--out", "-", "--format", "csv").splitlines()):
        if experience["is_keyframe"] == "true":
            places.setdefault(int(experience["place"]), []).append(experience["frame_name"])
    return places


def placed(path, phases):
    """The lap phases of its keyframes, by place."""
    return {place: [phases[name] for name in names] for place, names in rows_of(path).items()}


def lap_phases():
    """The lap phase of every image, by drive and name."""
    phases = {}
    with open(LAPS / "ground_truth.csv", newline="") as file:
        for image in csv.DictReader(file):
            phases.setdefault(image["drive"], {})[Path(image["file"]).name] = float(image["lap_phase"])
    return phases


def is_same(phases, others):
    apart = (abs(one - other) % 1 for one in phases for other in others)
    return any(min(distance, 1 - distance) <= TOLERANCE for distance in apart)


main()
