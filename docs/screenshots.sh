#!/bin/sh
# Takes pictures of a run in rerun, of the review of its map, and of the review of its log, for README and docs:
#
#     docs/screenshots.sh FOLDER [SOURCE]
#
# writes rerun.png, review.png and run.png, once the recordings are found to be whole. LOCI is the program; for the rest
# see screenshot.sh.
set -eu
[ $# = 1 ] || [ $# = 2 ] || { echo "usage: docs/screenshots.sh FOLDER [SOURCE]" >&2; exit 2; }
pictures=$1
source=${2:-synthetic:street?laps=2&frames=30&light=noon,dusk&seed=7}
loci=${LOCI:-loci}
here=$(dirname "$0")
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT

"$loci" run "$source" --map "$made/map" --rerun "save=$made/rerun.rrd" --json >"$made/run.jsonl"
"$loci" review "$made/map" --out "$made/review.rrd" --no-open
"$loci" review "$made/run.jsonl" --map "$made/map" --out "$made/run.rrd" --no-open
for picture in rerun review run; do
    "${RERUN_VIEWER:-rerun}" rrd verify "$made/$picture.rrd"
    "$here/screenshot.sh" "$made/$picture.rrd" "$pictures/$picture.png"
done
