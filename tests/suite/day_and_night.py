"""What a CNN that was trained on a map's own clusters recognises at night: the paper's claim.

    LOCI_DATA=DIR python3 tests/suite/day_and_night.py target/release/loci [FURTHER ARGUMENTS OF loci train]

`webcams_day_night` at LOCI_DATA: nine fixed cameras, about a frame each half hour. The robot stands at one after the
other and maps frames in the order of time, by BoW+HV alone and without labels: the first 60 % of each camera's, or of
all its frames those of the day alone. `loci train` makes a CNN of that map twice, on the shipped trunk and as the paper has
it. Asked are the frames of the night that were not mapped: those darker than halfway from the camera's darkest to its
brightest. Searched are all frames that were mapped, and the map that a robot founds with that method. The program needs
the features train and evaluation. Prints a table for BENCHMARKS.md.
"""

import csv
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

DATA = Path(os.environ["LOCI_DATA"]).resolve() / "webcams_day_night"
LOCI = Path(sys.argv[1]).resolve()
TRAINING = sys.argv[2:]
MAPPED_SHARE = 0.6
MAPPED = {
    "days and nights": lambda share, is_night: share < MAPPED_SHARE,
    "days": lambda share, is_night: not is_night,
}


def main():
    print("| Mapped | Method | Searched | Asked | R@1 | Recall | Precision |\n|---|---|---|---|---|---|---|")
    for mapped, is_known in MAPPED.items():
        with tempfile.TemporaryDirectory() as folder:
            measure(mapped, is_known, Path(folder))


def measure(mapped, is_known, folder):
    lay_out(folder, is_known)
    run("run", folder / "frames", "--map", folder / "map", "--model", "none")
    rows(mapped, "BoW+HV", evaluate(folder, "bow_hv", None))
    rows(mapped, "shipped CNN", evaluate(folder, "cnn", None))
    for architecture in ("trunk", "paper"):
        out = folder / architecture
        arguments = ["--architecture", architecture, "--out", out, "--accept", "--json", *TRAINING]
        print(architecture, run("train", folder / "map", *arguments).decode(), file=sys.stderr, flush=True)
        rows(mapped, f"{architecture} CNN", evaluate(folder, "cnn", out))


def lay_out(folder, is_known):
    """Links the frames to be mapped into a folder, and writes the ground truth of all."""
    with open(DATA / "ground_truth.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    (folder / "frames").mkdir()
    with open(folder / "truth.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["file", "place", "known", "is_night"])
        for place in sorted({row["place"] for row in rows}):
            frames = sorted((row for row in rows if row["place"] == place), key=lambda row: row["captured_at_utc"])
            light = [float(row["mean_luminance"]) for row in frames]
            halfway = (min(light) + max(light)) / 2
            for index, row in enumerate(frames):
                is_night = float(row["mean_luminance"]) < halfway
                known = is_known(index / len(frames), is_night)
                table.writerow([DATA / row["file"], place, int(known), int(is_night)])
                if known:
                    link = folder / "frames" / row["file"].replace("/", "_")
                    link.symlink_to(DATA / row["file"])


def evaluate(folder, method, model):
    given = ["--model", model] if model else []
    answer = run("evaluate", "--reference-rows", "known=1", "--query-rows", "known=0,is_night=1", "--truth", folder / "truth.csv",
                 "--methods", method, "--databases", "frames,map", "--json", *given)
    return json.loads(answer)["experiments"][0]["results"]


def run(*arguments):
    return subprocess.run([LOCI, *map(str, arguments)], check=True, stdout=subprocess.PIPE).stdout


def rows(mapped, name, results):
    for result in results:
        figures = result["figures"]
        cells = [mapped, name, result["database"], str(figures["recall_at_1"]["n"])]
        cells += [ratio(figures[figure]) for figure in ("recall_at_1", "recall", "precision")]
        print("| " + " | ".join(cells) + " |", flush=True)


def ratio(counted):
    n = counted.get("n", 0)
    return f"{counted['successes'] / n:.3f} ({counted['successes']}/{n})" if n else "–"


main()
