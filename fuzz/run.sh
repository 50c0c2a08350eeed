#!/bin/sh
# Fuzzes every reader, or those named as arguments, for FUZZ_SECONDS of processor time each (600).
#
# It needs cargo-fuzz and a C++ compiler, and the stable compiler does. What it learnt stays in corpus/,
# what made a reader fail is put into artifacts/; then it goes on with the next one and fails at the end.
set -eu
cd "$(dirname "$0")/.."

seconds=${FUZZ_SECONDS:-600}
case $seconds in
'' | *[!0-9]*)
    echo "fuzz: FUZZ_SECONDS=$seconds is not a whole number of seconds" >&2
    exit 1
    ;;
esac
command -v cargo-fuzz >/dev/null || {
    echo "fuzz: cargo-fuzz is missing; install it with: cargo install cargo-fuzz --locked" >&2
    exit 1
}
times_file=$(mktemp)
trap 'rm -f "$times_file"' EXIT
trap 'exit 1' HUP INT TERM

# Sets $used: whole seconds of processor time that this script's children have used so far.
measure() {
    # Not in a subshell, which would count its own children.
    times >"$times_file"
    used=$(awk 'NR == 2 { for (i = 1; i <= 2; i++) { split($i, part, "m"); sum += part[1] * 60 + part[2] } }
        END { printf "%d", sum }' "$times_file")
}

# Runs the target $1 until it has used $seconds; on a busy machine a second of the clock gives less.
fuzz() {
    mkdir -p "fuzz/corpus/$1"
    measure
    end=$((used + seconds))
    while [ "$used" -lt "$end" ]; do
        cargo fuzz run --sanitizer none "$1" "fuzz/corpus/$1" "fuzz/seeds/$1" -- \
            -max_total_time=$((end - used)) -max_len=4096 -timeout=25 -rss_limit_mb=2048 \
            -print_final_stats=1 -verbosity=0 || return 1
        measure
    done
}

[ $# -gt 0 ] || set -- $(cargo fuzz list)
cargo fuzz build --sanitizer none
failed=
for target in "$@"; do
    printf '\n== %s, for %s s\n' "$target" "$seconds"
    fuzz "$target" || failed="$failed $target"
done
[ -z "$failed" ] || {
    echo "fuzz: these readers failed:$failed; see fuzz/README.md on how to go on" >&2
    exit 1
}
