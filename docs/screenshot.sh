#!/bin/sh
# Takes a picture of a recording as rerun's viewer shows it, without a display:
#
#     docs/screenshot.sh RECORDING.rrd PICTURE.png
#
# RERUN_VIEWER is the viewer (rerun-sdk 0.36.3 from PyPI has it). Packages: xvfb xauth mesa-vulkan-drivers ffmpeg.
set -eu
[ $# = 2 ] || { echo "usage: docs/screenshot.sh RECORDING.rrd PICTURE.png" >&2; exit 2; }
recording=$1
picture=$2
[ -s "$recording" ] || { echo "screenshot: there is no recording $recording" >&2; exit 1; }
set -- /usr/share/vulkan/icd.d/lvp_icd.*.json
icd=$1
[ -f "$icd" ] || { echo "screenshot: install mesa-vulkan-drivers: there is no $icd" >&2; exit 1; }

rm -f "$picture"
told=$(mktemp)
busy=
trap 'rm -f "$told" "$picture.large.png"; [ -z "$busy" ] || kill $busy 2>/dev/null || true' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM HUP
# What the viewer tells at its start is gone again after some seconds, and the picture is taken after ten frames:
# these have to be slow. So it draws in one thread, on a core that others are busy on for a while.
core=$(taskset -cp $$ | sed 's/.*: //; s/[,-].*//')
for _ in 1 2 3; do
    timeout 20 taskset -c "$core" sh -c 'while :; do :; done' &
    busy="$busy $!"
done
# One that hangs is ended. Its window has twice 1400×900 pixels. The screen is more than twice as large, for the
# pointer in its middle would point at something.
VK_ICD_FILENAMES=$icd LP_NUM_THREADS=0 timeout 240 taskset -c "$core" \
    xvfb-run --auto-servernum --server-args="-screen 0 6000x4000x24" \
    "${RERUN_VIEWER:-rerun}" "$recording" --renderer vulkan --bind 127.0.0.1 --port 0 --window-size 1400x900 \
    --screenshot-to "$picture.large.png" >"$told" 2>&1 || true
[ -s "$picture.large.png" ] || { echo "screenshot: the viewer took none of $recording" >&2; exit 1; }
# What it says of the recording; of a container without a graphics card and of its own end it says something, too.
grep -E "(WARN|ERROR).*(::cache::|re_view_|re_chunk|re_entity_db|re_importer|re_log_encoding|re_video)" "$told" && {
    echo "screenshot: the viewer does not like $recording" >&2
    exit 1
}
ffmpeg -loglevel error -y -i "$picture.large.png" -vf scale=1400:900:flags=area -pix_fmt rgb24 "$picture"
