"""Scores a model folder on the local test sequences: single frames, nearest neighbour by cosine.

    LOCI_DATA=DIR PYTHONPATH=models python3 tests/score_model.py --model models/efficientnet-lite0

Prints what the card's [metrics] state. "Recall" divides right acceptances by all queries, each of which
has its place among the references. The threshold is the card's; it was fixed without these data.
"""

import argparse
import csv
import os
import tomllib
from pathlib import Path

import numpy as np
import onnxruntime

import build

LAP_FRAMES = 40
RECENT_FRAMES = 10
PHASE_TOLERANCE = 0.05
EXTREME_SHARE = 0.3


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def corridor(folder):
    """Laps 2 and 3 against lap 1. Right: listed, or within 2 frames round the closed lap; the 10 frames
    just before a query are no references, as they show the same place without any recognition."""
    table = rows(folder / "ground_truth.csv")
    files = [folder / row["file"] for row in table]
    query, reference = np.arange(LAP_FRAMES, len(files)), np.arange(LAP_FRAMES)
    apart = np.abs(query[:, None] % LAP_FRAMES - reference[None])
    right = np.minimum(apart, LAP_FRAMES - apart) <= 2
    for i, q in enumerate(query):
        for file in table[q]["same_place_as"].split():
            if int(file[:3]) <= LAP_FRAMES:
                right[i, int(file[:3]) - 1] = True
    recent = query[:, None] - reference[None] < RECENT_FRAMES
    return [("corridor", files, query, reference, right, recent)]


def robot(folder):
    """Laps 1 and 2 of the second drive are the references; right within 5 % of a lap."""
    table = [row for row in rows(folder / "ground_truth.csv") if row["reliable"] == "1"]
    files = [folder / row["file"] for row in table]
    drive = np.array([row["drive"] for row in table])
    lap = np.array([int(row["lap"]) for row in table])
    phase = np.array([float(row["lap_phase"]) for row in table])
    first, second, third = sorted(set(drive))
    reference = np.flatnonzero((drive == second) & ((lap == 1) | (lap == 2)))
    tasks = []
    for name, chosen, step in [("robot_same_day", (drive == second) & (lap > 2), 4),
                               ("robot_3_days_before", drive == first, 2), ("robot_3_months_other_car", drive == third, 1)]:
        query = np.flatnonzero(chosen)[::step]
        apart = np.abs(phase[query][:, None] - phase[reference][None])
        tasks.append((name, files, query, reference, np.minimum(apart, 1 - apart) <= PHASE_TOLERANCE, None))
    return tasks


def webcams(folder):
    """The darkest 30 % of each camera against the brightest 30 % of all cameras."""
    table = rows(folder / "ground_truth.csv")
    place = np.array([row["place"] for row in table])
    light = np.array([float(row["mean_luminance"]) for row in table])
    query, reference = [], []
    for name in np.unique(place):
        order = np.flatnonzero(place == name)
        order = order[np.argsort(light[order], kind="stable")]
        count = int(EXTREME_SHARE * len(order))
        query += list(order[:count])
        reference += list(order[-count:])
    right = place[query][:, None] == place[reference][None]
    return [("webcams_dark_to_bright", [folder / row["file"] for row in table], query, reference, right, None)]


def describe(session, files):
    descriptors = np.concatenate([session.run(None, {"image": build.load_image(file)})[0] for file in files])
    return descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)


def recall_at_precision(cosines, right, precision):
    """The largest recall over all thresholds that keep the precision: hindsight."""
    order = np.argsort(-cosines, kind="stable")
    found = np.cumsum(right[order])
    kept = found >= (precision - 1e-9) * np.arange(1, len(order) + 1)
    return found[kept].max() / len(order) if kept.any() else 0.0


def score(task, descriptors, decision):
    name, _, query, reference, right, recent = task
    similar = descriptors[query] @ descriptors[reference].T
    if recent is not None:
        similar = np.where(recent, -2, similar)
    best = similar.argmax(1)
    cosines, right = similar.max(1), right[np.arange(len(best)), best]
    taken = cosines > decision["recognise_above"]
    chance = 1 / (1 + np.exp(-(decision["calibration_slope"] * cosines + decision["calibration_offset"])))
    precision = f"{right[taken].mean():.3f}" if taken.any() else "none accepted"
    print(f'{name} = "n {len(query)} queries, {len(reference)} references: R@1 {right.mean():.3f}; at the threshold: '
          f"precision {precision}, recall {(taken & right).mean():.3f}; in hindsight: recall "
          f"{recall_at_precision(cosines, right, 0.95):.3f} at precision 0.95, {recall_at_precision(cosines, right, 1.0):.3f} "
          f'at 1.0; mean confidence {chance.mean():.2f}"')


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--model", type=Path, default=Path(build.__file__).parent / build.NAME, help="folder of model.onnx and card.toml")
    parser.add_argument("--data", type=Path, default=os.environ.get("LOCI_DATA"), help="folder of the sequences; default: LOCI_DATA")
    arguments = parser.parse_args()
    if arguments.data is None:
        parser.error("no test sequences: give --data DIR or set LOCI_DATA")
    session = onnxruntime.InferenceSession(arguments.model / "model.onnx", providers=["CPUExecutionProvider"])
    decision = tomllib.loads((arguments.model / "card.toml").read_text())["decision"]
    for tasks in (corridor(arguments.data / "corridor_two_laps"), robot(arguments.data / "robot_laps"),
                  webcams(arguments.data / "webcams_day_night")):
        descriptors = describe(session, tasks[0][1])
        for task in tasks:
            score(task, descriptors, decision)


if __name__ == "__main__":
    main()
