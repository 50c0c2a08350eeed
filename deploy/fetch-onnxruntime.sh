#!/bin/sh
# Puts ONNX Runtime where `loci` looks for it: ${XDG_CACHE_HOME:-~/.cache}/loci.
#
# The library comes from the wheel on PyPI, through pip, pinned by version and SHA-256, and nothing of
# Python is installed. It needs python3 with pip, glibc 2.28 or newer, and 40 MB. A second run changes nothing.
set -eu

version=1.32.0
library=libonnxruntime.so.$version

fail() {
    echo "fetch-onnxruntime: $*" >&2
    exit 1
}

case "$(uname -m)" in
x86_64)
    arch=x86_64
    sha256=6c1585d1bbf45b0712ea4a21b705c5fcb4ba04ff2e30f1fbf81a49faf658638f
    ;;
aarch64 | arm64)
    arch=aarch64
    sha256=49852228a93995158b2a813d4df487d47a1b76b0eaa894507ef49e91b6d7954a
    ;;
*) fail "no ONNX Runtime is pinned for $(uname -m); build one and name it with --onnxruntime PATH" ;;
esac

pins=$(dirname "$0")/onnxruntime-requirements.txt
cache=${XDG_CACHE_HOME:-${HOME:?is not set; set HOME or XDG_CACHE_HOME}/.cache}/loci

is_right() {
    [ -f "$1" ] && [ "$(sha256sum <"$1" | cut -d ' ' -f 1)" = "$sha256" ]
}

if is_right "$cache/$library" && is_right "$cache/libonnxruntime.so"; then
    echo "ONNX Runtime $version is already in $cache"
    exit 0
fi

command -v python3 >/dev/null || fail "python3 is missing; install it with pip (Debian: apt install python3 python3-pip)"
python3 -m pip --version >/dev/null 2>&1 || fail "python3 has no pip; install it (Debian: apt install python3-pip)"
[ -f "$pins" ] || fail "$pins is missing; run this script from a complete checkout"
mkdir -p "$cache" 2>/dev/null || fail "cannot create $cache; set XDG_CACHE_HOME to a folder you may write to"

# Beside the target, so that the last step is a rename within one file system.
work=$(mktemp -d "$cache/.fetch.XXXXXX" 2>/dev/null) || fail "cannot write to $cache; set XDG_CACHE_HOME to a folder you may write to"
trap 'rm -rf "$work"' EXIT
trap 'exit 1' HUP INT TERM

if ! python3 -m pip download --quiet --disable-pip-version-check --dest "$work" \
    --require-hashes --no-deps --only-binary=:all: \
    --implementation cp --python-version 3.11 --abi cp311 --platform "manylinux_2_28_$arch" \
    --requirement "$pins" >"$work/pip.log" 2>&1; then
    reason=$(grep -i '^ *error' "$work/pip.log" | tail -n 1)
    fail "pip could not download onnxruntime $version (${reason:-no reason given}); check the network and pip's index, then run this again"
fi

python3 - "$work" "$library" <<'PYTHON' || fail "the wheel of onnxruntime $version does not hold $library; run this again"
import pathlib, shutil, sys, zipfile

work, library = pathlib.Path(sys.argv[1]), sys.argv[2]
wanted = {
    f"onnxruntime/capi/{library}": library,
    "onnxruntime/LICENSE": "libonnxruntime-LICENSE",
    "onnxruntime/ThirdPartyNotices.txt": "libonnxruntime-ThirdPartyNotices.txt",
}
with zipfile.ZipFile(next(work.glob("*.whl"))) as wheel:
    for member, name in wanted.items():
        with wheel.open(member) as packed, open(work / name, "wb") as unpacked:
            shutil.copyfileobj(packed, unpacked)
PYTHON

is_right "$work/$library" || fail "$library has another SHA-256 than the pinned one; run this again"
chmod 644 "$work/$library" "$work"/libonnxruntime-*
ln -s "$library" "$work/libonnxruntime.so"
for name in libonnxruntime-LICENSE libonnxruntime-ThirdPartyNotices.txt "$library" libonnxruntime.so; do
    mv -f "$work/$name" "$cache/$name"
done
echo "ONNX Runtime $version is now in $cache"
