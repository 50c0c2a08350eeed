"""What vocabularies switched by light gain over one that was trained in every light.

    LOCI_DATA=DIR python3 tests/suite/light_switch.py target/release/loci

`webcams_day_night` at LOCI_DATA: nine fixed cameras. Every other one is asked about, with vocabularies trained on the
rest; then the other way round. A camera's frames are cut into day and night at the median luminance of the training
frames, and into two halves by time; each half is known once and asked about once. Prints a table for BENCHMARKS.md.
"""

import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

DATA = Path(os.environ["LOCI_DATA"]).resolve() / "webcams_day_night"
LOCI = Path(sys.argv[1]).resolve()
COLUMNS = ["file", "place", "half", "is_night"]

# What is known of one half of the time, and what is asked about the other.
TASKS = {
    "day → night": ("is_night=0", "is_night=1"),
    "day and night → night": (None, "is_night=1"),
    "night → day": ("is_night=1", "is_night=0"),
    "day and night → day": (None, "is_night=0"),
}
SETS = {"one, of day and night": ["all"], "switched": ["night", "day"]}


def main():
    with open(DATA / "ground_truth.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    cameras = sorted({row["place"] for row in rows})
    counts = Counter()
    for asked in (cameras[0::2], cameras[1::2]):
        with tempfile.TemporaryDirectory() as folder:
            measure([row for row in rows if row["place"] in asked],
                    [row for row in rows if row["place"] not in asked], Path(folder), counts)
    print("| Known → asked | Vocabularies | R@1 | Precision | Recall |\n|---|---|---|---|---|")
    for task in TASKS:
        for name in SETS:
            cells = [ratio(counts, (task, name, figure)) for figure in ("recall_at_1", "precision", "recall")]
            print(f"| {task} | {name} | " + " | ".join(cells) + " |")


def measure(asked, training, folder, counts):
    """Adds up what is recognised of the rows `asked` with vocabularies of the rows `training`."""
    border = statistics.median(float(row["mean_luminance"]) for row in training)
    is_night = lambda row: float(row["mean_luminance"]) < border
    for name, wanted in (("all", training), ("night", list(filter(is_night, training))),
                         ("day", [row for row in training if not is_night(row)])):
        train(folder / name, wanted)
    with open(folder / "truth.csv", "w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        for place in sorted({row["place"] for row in asked}):
            frames = sorted((row for row in asked if row["place"] == place), key=lambda row: row["file"])
            for index, row in enumerate(frames):
                table.writerow({"file": DATA / row["file"], "place": place, "is_night": int(is_night(row)),
                                "half": 1 + (2 * index >= len(frames))})
    for task, (known, wanted) in TASKS.items():
        for name, vocabularies in SETS.items():
            for half in (1, 2):
                rows = [",".join(filter(None, (f"half={half}", known))), f"half={3 - half},{wanted}"]
                for figure, counted in evaluate(folder, rows, vocabularies).items():
                    if isinstance(counted, dict) and "successes" in counted:
                        counts[task, name, figure, "successes"] += counted["successes"]
                        counts[task, name, figure, "n"] += counted["n"]


def train(folder, rows):
    folder.mkdir()
    for row in rows:
        (folder / row["file"].replace("/", "_")).symlink_to(DATA / row["file"])
    run("vocab", "train", folder, "--depth", "4", "--out", f"{folder}.lvoc")


def evaluate(folder, rows, vocabularies):
    given = [argument for name in vocabularies for argument in ("--vocab", folder / f"{name}.lvoc")]
    answer = run("evaluate", "--reference-rows", rows[0], "--query-rows", rows[1], "--truth", folder / "truth.csv",
                 "--methods", "bow_hv", "--databases", "map", "--json", *given)
    return json.loads(answer)["experiments"][0]["results"][0]["figures"]


def run(*arguments):
    return subprocess.run([LOCI, *map(str, arguments)], check=True, stdout=subprocess.PIPE).stdout


def ratio(counts, key):
    successes, n = counts[*key, "successes"], counts[*key, "n"]
    return f"{successes / n:.3f} ({successes}/{n})" if n else "–"


main()
