#!/bin/sh
# Takes a picture of a recording as rerun's viewer shows it, without a display:
#
#     docs/screenshot.sh RECORDING.rrd PICTURE.png
#
# RERUN is the viewer (rerun-sdk 0.36.3 from PyPI has it). Packages: xvfb mesa-vulkan-drivers ffmpeg.
set -eu
[ $# = 2 ] || { echo "usage: docs/screenshot.sh RECORDING.rrd PICTURE.png" >&2; exit 2; }
recording=$1
picture=$2
icd=$(echo /usr/share/vulkan/icd.d/lvp_icd.*.json)
[ -f "$icd" ] || { echo "screenshot: install mesa-vulkan-drivers: there is no $icd" >&2; exit 1; }

rm -f "$picture"
# The viewer draws in software, which takes seconds; one that hangs is ended. Its window has twice 1400×900 pixels. The
# screen is more than twice as large, for the pointer in its middle would point at something.
VK_ICD_FILENAMES=$icd timeout 120 xvfb-run --auto-servernum --server-args="-screen 0 6000x4000x24" \
    "${RERUN:-rerun}" "$recording" --renderer vulkan --bind 127.0.0.1 --port 0 --window-size 1400x900 \
    --screenshot-to "$picture.large.png" >/dev/null 2>&1 || true
[ -s "$picture.large.png" ] || { echo "screenshot: the viewer took none of $recording" >&2; exit 1; }
ffmpeg -loglevel error -y -i "$picture.large.png" -vf scale=1400:900:flags=area -pix_fmt rgb24 "$picture"
rm "$picture.large.png"
