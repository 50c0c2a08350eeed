"""Counts the instructions that each stage takes, which a noisy machine does not change.

    python3 benches/instructions.py          (needs valgrind)

The benches run under callgrind, which knows AVX2 but not AVX-512; what a call took is the mean of all calls.
"""

import json
import re
import subprocess
import tempfile
from collections import defaultdict
from pathlib import Path

# What a bench is run with, and what is counted in it.
BENCHES = (
    ("stages", ("--test",), (
        "loci::source::codec::decode",
        "loci::kernel::luma::luma",
        "loci::cnn::preprocess::Preprocessor::tensor",
        "loci::feature::orb::OrbExtractor::extract",
        "stages::bag_of_words",
    )),
    ("growth", ("1000",), ("growth::ask",)),
    ("verification", (), ("loci::verification::verify::Verifier::vote_and_verify",)),
)
CALL = re.compile(r"calls=(\d+)")
NAME = re.compile(r"c?fn=\((\d+)\)(?: (.*))?")


def executable(bench):
    """Builds a bench; answers its program."""
    command = ["cargo", "bench", "--no-default-features", "--bench", bench, "--no-run", "--message-format=json"]
    built = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    made = (json.loads(line) for line in built.splitlines())
    return next(one["executable"] for one in made if one.get("executable") and one["target"]["name"] == bench)


def calls(profile):
    """Calls of every function, and the instructions they took, those of what they called among them."""
    names, found, called, count = {}, defaultdict(lambda: [0, 0]), None, None
    for line in profile:
        if count is not None:
            found[called][0] += count
            found[called][1] += int(line.split()[1])
            count = None
        elif name := NAME.match(line):
            number, text = name.groups()
            names.setdefault(number, text)
            if line.startswith("cfn"):
                called = names[number]
        elif call := CALL.match(line):
            count = int(call[1])
    return found


def main():
    print("| Bench | Stage | Calls | Instructions, millions |\n|---|---|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        for bench, arguments, stages in BENCHES:
            profile = Path(folder) / bench
            valgrind = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={profile}"]
            command = [*valgrind, executable(bench), "--bench", *arguments]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            with profile.open() as lines:
                found = calls(lines)
            for stage in stages:
                count, instructions = found[stage]
                if count == 0:
                    raise SystemExit(f"{stage} is not in what callgrind saw of {bench}")
                print(f"| {bench} | `{stage}` | {count:,} | {instructions / count / 1e6:.2f} |", flush=True)


if __name__ == "__main__":
    main()
