"""Compares Loci's features with OpenCV's: time and quality, on the same frames, in one run, one thread each.

    pip install opencv-python-headless
    python3 benches/peers.py [IMAGES...]

Frames are 240 of a synthetic street, or the given images, brought to 640×480. Either looks at all of them once, and then
five times, of which the median counts; that three times in turn. OpenCV's time includes the keypoints that Python gets.
Quality: every frame is warped in a known way; features of both are matched (nearest both ways), and a match is true if it
lies within 3 px of where the warp puts it.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 640, 480
PASSES = 5
ROUNDS = 3
QUALITY_FRAMES = 24
TRUE_WITHIN_PX = 3.0


def loci(*arguments):
    """Runs Loci's side; answers the last line that it prints."""
    command = ["cargo", "bench", "--quiet", "--no-default-features", "--bench", "peers", "--", *map(str, arguments)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1])
    return done.stdout.strip().splitlines()[-1] if done.stdout.strip() else ""


def frames_of(paths, folder):
    file = folder / "frames"
    if paths:
        images = [cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in paths]
        file.write_bytes(b"".join(cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).tobytes() for image in images))
    else:
        loci("frames", file, 240)
    return file, np.frombuffer(file.read_bytes(), np.uint8).reshape(-1, HEIGHT, WIDTH)


def median_ms(work, frames):
    passes = []
    for _ in range(1 + PASSES):
        started = time.perf_counter()
        for frame in frames:
            work(frame)
        passes.append((time.perf_counter() - started) * 1e3 / len(frames))
    return np.median(passes[1:])


def compare_times(file, frames):
    print(f"| ORB of {len(frames)} frames | OpenCV, ms | Loci, ms | Loci is faster by |\n|---|---:|---:|---:|")
    for features in (500, 1000, 2000):
        orb = cv2.ORB_create(features)
        rounds = []
        for _ in range(ROUNDS):
            peer = median_ms(lambda frame: orb.detectAndCompute(frame, None), frames)
            rounds.append((peer, float(loci("orb", file, features))))
        peer, ours = np.median(rounds, axis=0)
        print(f"| {features:,} features | {peer:.2f} | {ours:.2f} | {peer / ours:.1f} × |")


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
    near = [np.hypot(*(expected[match.queryIdx] - warped_points[match.trainIdx])) <= TRUE_WITHIN_PX for match in matches]
    return sum(near)


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
        file, frames = frames_of(sys.argv[1:], folder)
        compare_times(file, frames)
        compare_quality(frames, folder)


if __name__ == "__main__":
    main()
