"""Fits the weights by which the program takes what the CNN and geometry say of a place together.

    python3 models/fuse.py target/release/loci --tower DIR          (one folder a floor, frames in order of their names)

Maps are founded by the program itself, and other frames are looked at with them, read only:

    synthetic    both worlds, seeds 31, 33 and 34: a lap at noon is mapped; another lap at noon, at dusk and at night is
                 looked at, right within two frames of sixty; and a lap of a world that is not in the map
    real         every other floor of IE Tower VPR is mapped; altered copies of its frames (moved camera, other light, worse
                 sensor, something in the way) and copies by night are looked at, right within two frames; and the floors
                 between, which look alike and are in no map, by day and by night; both ways round

Of every frame count the right and the wrong place that the CNN holds for the likeliest, that geometry does, and that is
farthest ahead of what else the CNN finds: between these a decision is made. Right and wrong weigh the same. Prints the
[fusion] table of the card and the constant of src/recognition/fusion.rs, and what the BoW score would add on maps that
were not fitted on; needs a quarter of an hour. Nothing else is looked at: none of the sequences on which figures are
reported, but that the tower's floors are also asked about as strangers to each other.
"""

import argparse
import json
import re
import subprocess
import tempfile
import tomllib
from pathlib import Path

import numpy as np
from PIL import Image, ImageFilter

import fit
import night

SEEDS = (31, 33, 34)
LAP_FRAMES = 60
TOLERANCE_FRAMES = 2
NIGHT_SIDE_PX = 448
RIVAL = 4
BEYOND_DOUBT_INLIERS = 16
LEAST_SCORE = 1e-3
RIDGE = 1e-2
CARD = Path(__file__).parent / "efficientnet-lite0" / "card.toml"


# ---------------------------------------------------------------- frames


def altered(picture, random):
    """The same view on another day."""
    width, height = picture.size
    share = random.uniform(0.7, 1.0, 2)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * share + random.uniform(0, 1, 2) * (1 - share)
    corners = np.clip(corners + random.uniform(-0.06, 0.06, (4, 2)), 0, 1) * [width, height]
    square = fit.perspective(corners, width)
    picture = picture.transform((width, width), Image.Transform.PERSPECTIVE, square, Image.Resampling.BILINEAR)
    picture = picture.resize((width, height), Image.Resampling.BILINEAR)
    if random.uniform() < 0.4:
        picture = picture.filter(ImageFilter.GaussianBlur(random.uniform(0.5, 2.5)))
    values = np.asarray(picture, float) / 255
    across, down = np.linspace(-1, 1, width)[None, :], np.linspace(-1, 1, height)[:, None]
    light = random.uniform(-0.5, 0.3) + random.uniform(-0.5, 0.5) * across + random.uniform(-0.5, 0.5) * down
    values = values ** np.exp(random.uniform(-0.7, 0.7)) * np.exp(light)[..., None]
    if random.uniform() < 0.25:
        values = values * random.uniform(0.12, 0.5)
    values = values + random.normal(0, random.uniform(0, 0.04), values.shape)
    if random.uniform() < 0.5:
        left, top = int(random.uniform(0, 0.7) * width), int(random.uniform(0, 0.5) * height)
        values[top:top + int(random.uniform(0.2, 0.5) * height), left:left + int(random.uniform(0.1, 0.3) * width)] = random.uniform(0, 1, 3)
    return Image.fromarray(np.clip(255 * values, 0, 255).astype(np.uint8))


def by_night(picture, random):
    """The same view by night."""
    square = picture.resize((NIGHT_SIDE_PX, NIGHT_SIDE_PX), Image.Resampling.BILINEAR)
    values = night.photographed(np.asarray(square, np.float32) / 255, random)
    return Image.fromarray(np.clip(255 * values, 0, 255).astype(np.uint8)).resize(picture.size, Image.Resampling.BILINEAR)


def floors(tower, folder):
    """Folders of frames: the even and the odd floors as links, and altered copies and copies by night of each."""
    frames, floor = fit.walk_frames(tower)
    names = np.unique(floor)
    random = np.random.default_rng(fit.SEED)
    for parity, half in enumerate(("even", "odd")):
        copies, nights = folder / f"{half}-altered", folder / f"{half}-night"
        for part in (folder / half, copies, nights):
            part.mkdir()
        chosen = [frame for frame, name in zip(frames, floor) if name in names[parity::2]]
        for index, frame in enumerate(chosen):
            (folder / half / f"{index:05d}.jpg").symlink_to(frame.resolve())
            picture = Image.open(frame).convert("RGB")
            altered(picture, random).save(copies / f"{index:05d}.jpg", quality=int(random.uniform(40, 92)))
            by_night(picture, random).save(nights / f"{index:05d}.jpg", quality=int(random.uniform(50, 92)))


def experiments(folder):
    """(mapped, looked at, whether a frame looked at shows what a mapped one does)."""
    def within(frame, mapped):
        return abs(frame - mapped) <= TOLERANCE_FRAMES

    def in_a_later_lap(frame, mapped):
        return frame >= LAP_FRAMES and min((frame - mapped) % LAP_FRAMES, (mapped - frame) % LAP_FRAMES) <= TOLERANCE_FRAMES

    def never(*_):
        return False

    for half, other in (("even", "odd"), ("odd", "even")):
        for copies in ("altered", "night"):
            yield folder / half, folder / f"{half}-{copies}", within
        for strangers in (other, f"{other}-night"):
            yield folder / half, folder / strangers, never
    for world in ("street", "corridor"):
        for seed in SEEDS:
            mapped = f"synthetic:{world}?laps=1&light=noon&seed={seed}"
            for light in ("noon", "dusk", "night"):
                yield mapped, f"synthetic:{world}?laps=2&light={light}&seed={seed}", in_a_later_lap
            yield mapped, f"synthetic:{world}?laps=1&light=dusk&seed={seed + 50}", never


# ---------------------------------------------------------------- evidence


def run(program, *arguments):
    answer = subprocess.run([program, *map(str, arguments)], capture_output=True)
    if answer.returncode != 0:
        raise SystemExit(answer.stderr.decode())
    return answer.stdout.decode()


def evidence(program, mapped, looked_at, is_same, folder):
    """Of every frame, place by place: cosine and margin, effective inliers and margin of their ln(1 + n), ln of the BoW
    score, and whether it is right."""
    place_map = folder / re.sub(r"\W", "_", str(mapped))
    if not place_map.exists():
        run(program, "run", mapped, "--map", place_map)
    known = json.loads(run(program, "map", "export", place_map, "--out", "-"))
    frame_of = {experience["experience"]: int(experience["frame_index"]) for experience in known["experiences"]}
    shows = {place["id"]: [frame_of[id] for id in place["experiences"]] for place in known["places"]}
    near = {place["id"]: {place["id"], *place["neighbours"]} for place in known["places"]}
    first = LAP_FRAMES if "laps=2" in str(looked_at) else 0
    for line in run(program, "run", looked_at, "--map", place_map, "--read-only", "--sequence", "off", "--json").splitlines():
        record = json.loads(line)
        frame, candidates = record["frame"], record["candidates"]
        named = {candidate["place"]: candidate["score"] for candidate in candidates if candidate["by"] == "cnn"}
        if frame < first or not named:
            continue
        found, shared = {}, {candidate["place"]: candidate["score"] for candidate in reversed(candidates) if candidate["by"] == "bow_hv"}
        for candidate in candidates:
            cosine, inliers = found.get(candidate["place"], (min(named.values()), 0))
            if candidate["by"] == "cnn":
                cosine = max(cosine, candidate["score"])
            found[candidate["place"]] = cosine, max(inliers, candidate.get("inliers") or 0)
        yield [(*ahead(place, found, named, near[place]), np.log(shared.get(place, 0) + LEAST_SCORE), any(is_same(frame, mapped) for mapped in shows[place]))
               for place in found]


def ahead(place, found, named, near):
    """Cosine and inliers of a place, each with what it is ahead of others, as src/recognition/fusion.rs has it.

    That the cosine passes the card's threshold counts for nothing here.
    """
    cosine, inliers = found[place]
    others = sorted((score for other, score in named.items() if other != place), reverse=True)
    cosine_margin = cosine - others[RIVAL - 1] if len(others) >= RIVAL else 0

    def is_rival(other):
        fewer, more = sorted((inliers, found[other][1]))
        return other not in near and not (fewer >= BEYOND_DOUBT_INLIERS and more < 2 * fewer)

    rivals = [found[other][1] for other in found if is_rival(other)]
    return cosine, cosine_margin, inliers, np.log1p(inliers) - np.log1p(max(rivals, default=0))


def contested(frames):
    """What was found, whether it is right, and a weight, of the places that a decision is about."""
    for places in frames:
        for is_right in (True, False):
            alike = [place for place in places if place[-1] == is_right]
            if alike:
                chosen = {max(alike, key=lambda place: place[clue]) for clue in range(3)}
                yield from ((*place, 1 / len(chosen)) for place in chosen)


def logistic(design, right, weights):
    """The likeliest weights of the columns, both kinds weighing the same."""
    share = np.where(right, weights[right].sum(), weights[~right].sum())
    weights = weights / share * len(right) / 2
    spread = np.maximum(design.std(0), 1e-9)
    spread[0] = 1
    design, solution = design / spread, np.zeros(design.shape[1])
    for _ in range(80):
        chance = 1 / (1 + np.exp(-design @ solution))
        slope = design.T @ (weights * (right - chance)) - RIDGE * solution
        curvature = design.T @ (design * (weights * chance * (1 - chance))[:, None]) + RIDGE * np.eye(len(solution))
        solution += np.linalg.solve(curvature, slope)
    return solution / spread


def held_out_loss(design, right, weights, mapped):
    """Log loss on each map by the weights of the others, both kinds weighing the same."""
    log_odds = np.zeros(len(right))
    for one in np.unique(mapped):
        others = mapped != one
        log_odds[~others] = design[~others] @ logistic(design[others], right[others], weights[others])
    share = weights / np.where(right, weights[right].sum(), weights[~right].sum()) / 2
    return (share * np.logaddexp(0, np.where(right, -log_odds, log_odds))).sum()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program", type=Path, help="the program loci")
    parser.add_argument("--tower", type=Path, required=True, help="folder with one folder of frames a floor")
    arguments = parser.parse_args()
    decision = tomllib.loads(CARD.read_text())["decision"]
    seen = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        floors(arguments.tower, folder)
        for mapped, looked_at, is_same in experiments(folder):
            frames = list(evidence(arguments.program.resolve(), mapped, looked_at, is_same, folder))
            seen += ((*row, str(mapped)) for row in contested(frames))
            print(f"# {Path(str(mapped)).name} by {Path(str(looked_at)).name}: {len(frames)} frames", flush=True)
    *columns, mapped = zip(*seen)
    cosine, margin, inliers, inlier_margin, shared, right, weights = (np.array(column, float) for column in columns)
    mapped = np.array(mapped)
    right, one = right.astype(bool), np.ones(len(right))
    slope, offset = decision["calibration_slope"], decision["calibration_offset"]
    geometry = [np.log1p(inliers), np.minimum(inliers, 1), inlier_margin]
    clues = np.stack([one, slope * cosine + offset, slope * margin, *geometry], 1)
    together = logistic(clues, right, weights)
    names = ("offset", "cosine", "cosine_margin", "inliers", "any_inliers", "inlier_margin")
    print(f"# {len(right)} places in contest, {right.sum()} of them right")
    print("[fusion]", *(f"{name} = {weight:.3f}" for name, weight in zip(names, together)), sep="\n")
    for name, design in (("these", clues), ("these and ln(BoW score)", np.column_stack([clues, shared]))):
        print(f"# log loss on maps that were not fitted on, {name}: {held_out_loss(design, right, weights, mapped):.4f}")
    print("GEOMETRY =", [round(float(weight), 3) for weight in logistic(np.stack([one, *geometry], 1), right, weights)])


if __name__ == "__main__":
    main()
