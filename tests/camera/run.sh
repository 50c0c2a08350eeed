#!/bin/sh
# Cameras in a virtual machine: boots what prepare.sh built, in which init and scenes let cameras come and go under loci,
# and has checks.py judge what loci said. It needs neither a camera nor rights on this machine, and no KVM.
set -eu
cd "$(dirname "$0")/../.."

machine=${CARGO_TARGET_DIR:-target}/camera-test
# A machine that hangs is ended after so many seconds.
limit=${LOCI_CAMERA_TEST_SECONDS:-110}

[ -f "$machine/initramfs" ] || {
    echo "camera test: $machine/initramfs is missing; run tests/camera/prepare.sh first" >&2
    exit 1
}
rm -rf "$machine/share/out"

# Nehalem, for where each instruction is translated, vectors of AVX2 take longer than those of SSE.
ended=0
timeout --kill-after=5 "$limit" qemu-system-x86_64 \
    -accel tcg -cpu Nehalem -smp 2 -m 1024 -nodefaults -display none -no-reboot \
    -kernel "$machine/vmlinuz" -initrd "$machine/initramfs" \
    -append "console=ttyS0 quiet panic=-1 rdinit=/init" -serial "file:$machine/console" \
    -virtfs "local,path=$machine/share,mount_tag=share,security_model=none" </dev/null || ended=$?

python3 tests/camera/checks.py "$machine/share" && [ "$ended" = 0 ] && exit 0
[ "$ended" != 124 ] || echo "camera test: the machine was ended after $limit s"
echo "camera test: failed; what the console said last:"
tail -n 40 "$machine/console"
for messages in "$machine"/share/out/*.err; do
    echo "-- $messages"
    tail -n 20 "$messages"
done
exit 1
