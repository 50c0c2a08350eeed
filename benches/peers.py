"""Compares Loci with OpenCV, stage by stage: time and quality, on the same frames, in one run, one thread each.

    pip install opencv-python-headless
    python3 benches/peers.py [IMAGES...]

Frames are 240 of a synthetic street, or the given images, brought to 640×480. Either looks at all of them once, and
then three times, of which the median counts; that five times in turn. "Faster by" is the median of the five ratios, for
the machine's speed may change between two rounds. OpenCV's time includes the keypoints that Python gets. Quality: every
frame is warped in a known way; features of both are matched (nearest both ways), and a match is true if it lies within
3 px of where the warp puts it. Correspondences to be verified are made up: 200, of which 60 or none are true.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 640, 480
PASSES = 3
ROUNDS = 5
QUALITY_FRAMES = 24
TRUE_WITHIN_PX = 3.0
PAIRS_OF_IMAGES = 500


def loci(*arguments):
    """Runs Loci's side; answers the last line that it prints."""
    command = ["cargo", "bench", "--quiet", "--no-default-features", "--bench", "peers", "--", *map(str, arguments)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1])
    return done.stdout.strip().splitlines()[-1] if done.stdout.strip() else ""


def frames_of(paths, folder):
    """Frames as BGR images."""
    if paths:
        images = [cv2.imread(path) for path in paths]
        if unread := [path for path, image in zip(paths, images) if image is None]:
            sys.exit(f"{unread[0]} is no image that can be read")
        return [cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for image in images]
    file = folder / "frames"
    loci("frames", file, 240)
    frames = np.frombuffer(file.read_bytes(), np.uint8).reshape(-1, HEIGHT, WIDTH, 3)
    return [cv2.cvtColor(frame, cv2.COLOR_RGB2BGR) for frame in frames]


def median_ms(work, frames):
    passes = []
    for _ in range(1 + PASSES):
        started = time.perf_counter()
        for frame in frames:
            work(frame)
        passes.append((time.perf_counter() - started) * 1e3 / len(frames))
    return np.median(passes[1:])


def rounds(peer, ours):
    """Medians of both times, measured in turn, and of what one is to the other in a round."""
    times = np.array([(peer(), ours()) for _ in range(ROUNDS)])
    return *np.median(times, axis=0), np.median(times[:, 0] / times[:, 1], axis=0)


def compare_stages(frames, folder):
    print(f"\n| Stage, {len(frames)} frames | OpenCV, ms | Loci, ms | Loci is faster by |\n|---|---:|---:|---:|")
    jpegs = [cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 90])[1] for frame in frames]
    file = folder / "jpegs"
    file.write_bytes(b"".join(len(jpeg).to_bytes(4, "little") + jpeg.tobytes() for jpeg in jpegs))

    def made_input(frame):
        small = cv2.resize(frame, (224, 224), interpolation=cv2.INTER_AREA)
        return cv2.dnn.blobFromImage(small, 1 / 128, mean=(127, 127, 127), swapRB=True)

    peers = [
        ("JPEG to colour", lambda jpeg: cv2.imdecode(jpeg, cv2.IMREAD_COLOR), jpegs),
        ("colour to grey", lambda frame: cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), frames),
        ("input of the CNN, 224×224", made_input, frames),
    ]
    theirs, ours, ratios = rounds(
        lambda: [median_ms(work, items) for _, work, items in peers],
        lambda: [float(ms) for ms in loci("stages", file).split()],
    )
    for (stage, _, _), their_ms, our_ms, ratio in zip(peers, theirs, ours, ratios):
        print(f"| {stage} | {their_ms:.2f} | {our_ms:.2f} | {ratio:.1f} × |")


def compare_verification(folder):
    print("\n| 200 correspondences | | OpenCV, µs | inliers | Loci, µs | inliers | Loci is faster by |")
    print("|---|---|---:|---:|---:|---:|---:|")
    estimators = [
        ("affine, RANSAC", lambda a, b: cv2.estimateAffinePartial2D(a, b, ransacReprojThreshold=3)),
        ("homography, MAGSAC", lambda a, b: cv2.findHomography(a, b, cv2.USAC_MAGSAC, 3)),
    ]
    file = folder / "pairs"
    for true in (60, 0):
        loci("pairs", file, true, PAIRS_OF_IMAGES)
        points = np.frombuffer(file.read_bytes(), np.float32).reshape(PAIRS_OF_IMAGES, -1, 4)
        for name, estimate in estimators:

            def by_opencv():
                times, inliers = [], []
                for pair in points:
                    a, b = np.ascontiguousarray(pair[:, :2]), np.ascontiguousarray(pair[:, 2:])
                    started = time.perf_counter()
                    _, mask = estimate(a, b)
                    times.append((time.perf_counter() - started) * 1e6)
                    inliers.append(0 if mask is None else int(mask.sum()))
                return np.median(times), min(inliers), max(inliers)

            def by_loci():
                return [float(word) for word in loci("verify", true, PAIRS_OF_IMAGES).split()]

            *times, ratio = rounds(lambda: by_opencv()[0], lambda: by_loci()[0])
            inliers = [f"{least:.0f} to {most:.0f}" for _, least, most in (by_opencv(), by_loci())]
            told = " | ".join(f"{us:.1f} | {found}" for us, found in zip(times, inliers))
            print(f"| {true} true | {name} | {told} | {ratio:.1f} × |")


def compare_orb(file, frames):
    print(f"| ORB of {len(frames)} frames | OpenCV, ms | Loci, ms | Loci is faster by |\n|---|---:|---:|---:|")
    for features in (500, 1000, 2000):
        orb = cv2.ORB_create(features)
        peer, ours, ratio = rounds(
            lambda: median_ms(lambda frame: orb.detectAndCompute(frame, None), frames),
            lambda: float(loci("orb", file, features)),
        )
        print(f"| {features:,} features | {peer:.2f} | {ours:.2f} | {ratio:.1f} × |")


def warps():
    """Name, what happens to the image, and the 2×3 matrix that says where its points go."""
    same = np.float64([[1, 0, 0], [0, 1, 0]])
    centre = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    turned = cv2.getRotationMatrix2D(centre, 15, 1.0)
    smaller = cv2.getRotationMatrix2D(centre, 0, 0.8)
    both = cv2.getRotationMatrix2D(centre, 15, 0.8)

    def moved(image, matrix):
        return cv2.warpAffine(image, matrix, (WIDTH, HEIGHT))

    def darker(image):
        return np.clip(image * 0.5 + 10, 0, 255).round().astype(np.uint8)

    def blurred(image):
        return cv2.GaussianBlur(image, (0, 0), 1.5)

    return [
        ("rotation 15°", lambda image: moved(image, turned), turned),
        ("scale 0.8", lambda image: moved(image, smaller), smaller),
        ("light × 0.5 + 10", darker, same),
        ("blur 1.5", blurred, same),
        ("all together", lambda image: blurred(darker(moved(image, both))), both),
    ]


def by_opencv(frames, orb):
    for frame in frames:
        keypoints, descriptors = orb.detectAndCompute(frame, None)
        if descriptors is None:
            descriptors = np.empty((0, 32), np.uint8)
        yield np.float32([keypoint.pt for keypoint in keypoints]).reshape(-1, 2), descriptors


def by_loci(frames, folder):
    file, out = folder / "warped", folder / "features"
    file.write_bytes(b"".join(frame.tobytes() for frame in frames))
    loci("orb", file, 1000, out)
    rest = out.read_bytes()
    for _ in frames:
        count = int.from_bytes(rest[:4], "little")
        rows = np.frombuffer(rest[4:4 + 40 * count], np.uint8).reshape(-1, 40)
        yield rows[:, :8].copy().view("<f4"), rows[:, 8:].copy()
        rest = rest[4 + 40 * count:]


def true_inliers(known, warped, matrix):
    (points, descriptors), (warped_points, warped_descriptors) = known, warped
    if not len(points) or not len(warped_points):
        return 0
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(descriptors, warped_descriptors)
    expected = points @ matrix[:, :2].T + matrix[:, 2]
    apart_px = [np.hypot(*(expected[match.queryIdx] - warped_points[match.trainIdx])) for match in matches]
    return sum(distance <= TRUE_WITHIN_PX for distance in apart_px)


def compare_quality(frames, folder):
    frames = frames[:: max(1, len(frames) // QUALITY_FRAMES)]
    orb = cv2.ORB_create(1000)
    known = {"OpenCV": list(by_opencv(frames, orb)), "Loci": list(by_loci(frames, folder))}
    print(f"\n| True inliers, mean of {len(frames)} frames | OpenCV | Loci |\n|---|---:|---:|")
    kept = {who: np.mean([len(points) for points, _ in features]) for who, features in known.items()}
    print(f"| features kept | {kept['OpenCV']:.0f} | {kept['Loci']:.0f} |")
    for name, warp, matrix in warps():
        warped = [warp(frame) for frame in frames]
        found = {"OpenCV": by_opencv(warped, orb), "Loci": by_loci(warped, folder)}
        mean = {who: np.mean([true_inliers(a, b, matrix) for a, b in zip(known[who], found[who])]) for who in known}
        print(f"| {name} | {mean['OpenCV']:.0f} | {mean['Loci']:.0f} |")


def main():
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        colour = frames_of(sys.argv[1:], folder)
        frames = np.stack([cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in colour])
        file = folder / "grey"
        file.write_bytes(frames.tobytes())
        compare_orb(file, frames)
        compare_quality(frames, folder)
        compare_stages(colour, folder)
        compare_verification(folder)


if __name__ == "__main__":
    main()
