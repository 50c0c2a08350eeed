"""What ORB gains from contrast that is evened out before FAST: BoW+HV on copies of the sequences.

    LOCI_DATA=DIR python3 tests/suite/contrast.py target/release/loci

The copies are made by OpenCV (pip install opencv-python-headless), once as they are, once with CLAHE (clip limit 2, 8 × 8
tiles, on lightness), once with local contrast normalised (mean and deviation within a sixteenth of the longer side).
"""

import argparse
import csv
import json
import os
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np

EXPERIMENTS = {
    "corridor_two_laps": [["--reference-rows", "lap=1", "--query-rows", "lap=2"]],
    "robot_laps": [["--reference-rows", "drive=2023-12-09_car1,lap=1..2", "--query-rows", f"drive={drive}"] for drive in ("2023-12-06_car1", "2024-03-06_car2")],
    "webcams_day_night": [["--reference-rows", "mean_luminance=70%..", "--query-rows", "mean_luminance=..30%"]],
    "buildings_viewpoints": [["--recent", "0"]],
}
JPEG_QUALITY = 95


def as_it_is(picture):
    return picture


def clahe(picture):
    lab = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB)
    lab[..., 0] = cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(lab[..., 0])
    return cv2.cvtColor(lab, cv2.COLOR_LAB2BGR)


def normalised(picture):
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
    reach = max(grey.shape) / 16
    mean = cv2.GaussianBlur(grey, (0, 0), reach)
    deviation = cv2.GaussianBlur((grey - mean) ** 2, (0, 0), reach) ** 0.5
    return cv2.merge([np.clip(127 + 45 * (grey - mean) / (deviation + 6), 0, 255).astype(np.uint8)] * 3)


def copy(sequence, folder, change):
    with open(sequence / "ground_truth.csv") as table:
        rows = list(csv.DictReader(table))
    for row in rows:
        name = row.get("file") or row["image"]
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), change(cv2.imread(str(sequence / name))), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    (folder / "ground_truth.csv").write_text((sequence / "ground_truth.csv").read_text())


def figures(program, folder, rows):
    command = [program, "evaluate", "--truth", folder / "ground_truth.csv", *rows, "--methods", "bow_hv", "--databases", "frames", "--json"]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return json.loads(answer.stdout)["experiments"][0]["results"][0]["figures"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program", type=Path, help="the program loci")
    program = parser.parse_args().program.resolve()
    data = Path(os.environ["LOCI_DATA"])
    for change in (as_it_is, clahe, normalised):
        for sequence, experiments in EXPERIMENTS.items():
            with tempfile.TemporaryDirectory() as name:
                copy(data / sequence, Path(name), change)
                for rows in experiments:
                    found = figures(program, Path(name), rows)
                    shares = [f"{key} {found[key]['successes']}/{found[key]['n']}" for key in ("recall_at_1", "precision", "recall")]
                    print(change.__name__, sequence, *rows[-1:], *shares, sep="  ", flush=True)


if __name__ == "__main__":
    main()
