#!/bin/sh
# Builds all that the virtual machine runs: kernel, loci, the feeder, the frames of a drive and the initramfs.
# What takes long is kept, so a second run takes seconds.
set -eu
cd "$(dirname "$0")/../.."

cargo=${CARGO:-cargo}
target=x86_64-unknown-linux-gnu
build=${CARGO_TARGET_DIR:-target}
machine=$build/camera-test
root=$machine/root
# Small, since without a processor's help a frame takes ten times as long.
world='corridor?laps=2&light=noon&frames=40&size=320x240'
# One frame of the second lap, of which half arrives.
broken=60

kernel=$(tests/camera/kernel.sh)

# Static, for the machine has no libraries; with the target named, what runs while building is as ever.
CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUSTFLAGS="-C target-feature=+crt-static" \
    $cargo build --release --no-default-features --features cli,v4l --target "$target" --bin loci

rm -rf "$machine"
mkdir -p "$root/bin" "$root/modules" "$root/vocab" "$machine/share/frames"
cp "$kernel/vmlinuz" "$machine"
cp "$kernel/modules"/* "$root/modules"
cp tests/camera/init tests/camera/scenes "$root"
cp "$(command -v busybox)" "$root/bin/busybox"
strip -o "$root/bin/loci" "$build/$target/release/loci"
cp vocab/default.lvoc "$root/vocab"
gcc -static -O2 -Wall -Wextra -Werror -o "$root/bin/feed" tests/camera/feed.c

# A drive is LAP-NUMBER.jpg, both laps the same way. Real frames, where there are any.
frames=$machine/share/frames
real=${LOCI_DATA:-}/corridor_two_laps
if [ -d "$real" ]; then
    tail -n +2 "$real/ground_truth.csv" | while IFS=, read -r file lap _; do
        cp "$real/$file" "$frames/$lap-$file"
    done
else
    $cargo run --release --no-default-features --example camera_frames -- "$world" "$frames"
fi
victim=$(find "$frames" -name "?-0$broken.jpg")
head -c $(($(wc -c <"$victim") / 2)) "$victim" >"$victim.half"
mv "$victim.half" "$victim"

(cd "$root" && find . | cpio --quiet --create --format=newc) >"$machine/initramfs"
