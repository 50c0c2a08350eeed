"""What a fleet's map of a billion keyframes needs, and what stays on a robot: the numbers of ARCHITECTURE.md.

    python3 deploy/fleet_size.py [KEYFRAMES]

Sizes are those of Loci's own formats; what is assumed of machines and networks stands below, to be changed.
"""

import math
import random
import sys

KEYFRAMES = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10**9

# Of a keyframe, in bytes: ARCHITECTURE.md, "Map", and src/recognition/keyframe_index.rs.
DESCRIPTOR = 256
WORDS = 256
FEATURES = WORDS * (32 + 7)
THUMBNAIL = 10_000
POSTING = 3
KEYFRAME = 56
# What the robot's index may take by default.
ROBOT_MEMORY = 256 << 20

# A graph over descriptors (HNSW, m = 16): twice m links on its lowest layer, and the layers above, 1/(m - 1) of it.
GRAPH = 2 * 16 * 4 * (1 + 1 / 15)
# A node of the engine: memory for vectors and graph, of 128 GB.
NODE_MEMORY = 96e9
REPLICAS = 2

# Milliseconds of one shard's answer: median, and what one in a hundred exceeds.
SHARD_MEDIAN, SHARD_P99 = 4.0, 20.0
# Share of strangers' descriptors that exceed the shipped CNN's threshold, and with how many each was compared: its card.
FALSE_SHARE, COMPARED = 0.005, 505
# Keyframes within the circle of which a robot knows that it is in it: a site, or a tile of a city.
TILE = 100_000
# BENCHMARKS.md, "Queries as the map grows": a query of 1,000 words reads 21.4 postings of every image of 1,000 words.
POSTING_NS, VISITS = 2.2, 21.4 * WORDS / 1000


def size(count):
    for unit in ("B", "kB", "MB", "GB", "TB", "PB"):
        if count < 1000 or unit == "PB":
            return f"{count:.3g} {unit}"
        count /= 1000


def row(name, value):
    print(f"| {name} | {value} |")


def slowest_ms(fan_out, rng, queries=4000):
    """Median and 99th percentile of the slowest of so many shards, log-normal each."""
    sigma = math.log(SHARD_P99 / SHARD_MEDIAN) / 2.326
    answer_ms = lambda: rng.lognormvariate(math.log(SHARD_MEDIAN), sigma)
    slowest = sorted(max(answer_ms() for _ in range(fan_out)) for _ in range(queries))
    return slowest[queries // 2], slowest[queries * 99 // 100]


def main():
    rng = random.Random(1)
    shards = max(1, math.ceil(KEYFRAMES * (DESCRIPTOR + GRAPH) / NODE_MEMORY))
    print(f"| {KEYFRAMES:,} keyframes | |\n|---|---:|")
    row("descriptors, 8 bits a value", size(KEYFRAMES * DESCRIPTOR))
    row("graph over them", size(KEYFRAMES * GRAPH))
    row("features that verify a candidate, on disks", size(KEYFRAMES * FEATURES))
    row("thumbnails, in an object store", size(KEYFRAMES * THUMBNAIL))
    row("shards of 96 GB in memory, with replicas", f"{shards}, {shards * REPLICAS}")
    for fan_out in sorted({1, 2, shards}):
        median, most = slowest_ms(fan_out, rng)
        row(f"slowest answer of {fan_out} asked at once, median and 99 of 100, simulated", f"{median:.1f}, {most:.1f} ms")
    wrong = FALSE_SHARE / COMPARED
    row("keyframes of other places above the threshold, all asked", f"{KEYFRAMES * wrong:,.0f}")
    row(f"the same within a tile of {TILE:,}", f"{TILE * wrong:.1f}")
    row("words instead, a query of 1,000 on one core", f"{KEYFRAMES * VISITS * POSTING_NS * 1e-9:.0f} s")
    row("up, a query", size(DESCRIPTOR))
    row("down, eight candidates with features", size(8 * FEATURES))
    robot = ROBOT_MEMORY // (WORDS * POSTING + KEYFRAME + DESCRIPTOR)
    row(f"keyframes at most that a robot searches itself in {ROBOT_MEMORY >> 20} MiB", f"{robot:,}")
    row("their disk", size(robot * (FEATURES + DESCRIPTOR + 4 * WORDS)))


if __name__ == "__main__":
    main()
