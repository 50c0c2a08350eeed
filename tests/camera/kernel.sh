#!/bin/sh
# Puts a Linux kernel and the modules of the made-up cameras into a cache and prints the folder: vmlinuz, modules/*.ko
# and modules/order, which names those to load at start, one after the other.
#
# The kernel is the newest that apt offers, since mirrors drop older ones. Nothing is installed: the packages are
# unpacked, and v4l2loopback is built against the headers of the same version.
set -eu

cache=${XDG_CACHE_HOME:-${HOME:?is not set; set HOME or XDG_CACHE_HOME}/.cache}/loci-camera-test

fail() {
    echo "camera test: $*" >&2
    exit 1
}

# What apt says of field $2 of the newest version of package $1.
field() {
    apt-cache show --no-all-versions "$1" 2>/dev/null | sed -n "s/^$2: //p"
}

# The first package of the kind $2 (a pattern) that package $1 needs.
needed() {
    field "$1" Depends | grep -oE "(^|[ ,])$2" | head -n 1 | tr -d ' ,'
}

update() {
    as_root=
    [ "$(id -u)" = 0 ] || as_root=sudo
    $as_root apt-get update -qq || fail "apt's lists are too old or missing, and apt-get update failed"
}


# Sets $release, as uname says it, and $version, of the package.
find_newest() {
    image=$(needed linux-image-amd64 'linux-image-[0-9][^ ,]*') || image=
    release=${image#linux-image-}
    version=$(field "linux-image-${release:-amd64}" Version)
    [ -n "$release" ]
}

# Downloads the packages into the current folder.
download() {
    common=$(needed "linux-headers-$release" 'linux-headers-[^ ,]*-common') &&
        kbuild=$(needed "linux-headers-$release" 'linux-kbuild-[^ ,]*') &&
        apt-get download -qq "linux-image-$release" "linux-headers-$release" "$common" "$kbuild" v4l2loopback-dkms \
            2>download.log
}

# Unpacks kernel and headers into root/ and builds v4l2loopback.
build() {
    mkdir root
    for package in ./*.deb; do
        dpkg-deb --extract "$package" root
    done
    # Newer packages have their libraries below usr.
    [ -d root/lib ] || ln -s usr/lib root/lib
    # Unpacked elsewhere, the headers do not find their other half.
    headers=$PWD/root/usr/src/linux-headers-$release
    sed -i "s|/usr/src/|$PWD/root/usr/src/|" "$headers/Makefile"
    loopback=$(echo "$PWD"/root/usr/src/v4l2loopback-*)
    # Who built the kernel had BTF, types for tracers, of which the headers have none.
    make -s -C "$headers" M="$loopback" CONFIG_DEBUG_INFO_BTF_MODULES= modules >build.log 2>&1 || {
        tail -n 30 build.log >&2
        fail "v4l2loopback does not build against linux-headers-$release"
    }
    mkdir -p "root/lib/modules/$release/extra"
    cp "$loopback/v4l2loopback.ko" "root/lib/modules/$release/extra"
    PATH=$PATH:/usr/sbin:/sbin depmod --basedir root "$release"
}

# Copies what the machine needs into ready/, the modules plain and in the order in which they load.
collect() {
    mkdir -p ready/modules
    cp "root/boot/vmlinuz-$release" ready/vmlinuz
    for wanted in 9p 9pnet_virtio virtio_pci vivid v4l2loopback; do
        PATH=$PATH:/usr/sbin:/sbin modprobe --dirname root --set-version "$release" --show-depends "$wanted" ||
            fail "linux-image-$release has no module $wanted"
    done >needed.list
    awk '$1 == "insmod" && !seen[$2]++ { print $2 }' needed.list >modules.list
    while read -r module; do
        name=$(basename "$module")
        case $name in
        *.xz) xz -dc "$module" >"ready/modules/${name%.xz}" ;;
        *) cp "$module" ready/modules ;;
        esac
        name=${name%%.ko*}
        # The cameras themselves come and go as the test wants it.
        [ "$name" = vivid ] || [ "$name" = v4l2loopback ] || echo "$name" >>ready/modules/order
    done <modules.list
}

[ "$(uname -m)" = x86_64 ] || fail "it boots a kernel for x86-64, which $(uname -m) is not"
command -v apt-get >/dev/null || fail "it takes a kernel from Debian's archive, and there is no apt-get"
find_newest || { update && find_newest; } || fail "apt knows no linux-image-amd64; Debian's archive has it"

ready=$cache/$version-$release
if [ ! -f "$ready/vmlinuz" ]; then
    mkdir -p "$cache"
    work=$(mktemp -d "$cache/.work.XXXXXX")
    trap 'rm -rf "$work"' EXIT
    trap 'exit 1' HUP INT TERM
    cd "$work"
    echo "camera test: fetching linux-image-$release and v4l2loopback" >&2
    # Lists may be so old that they name what mirrors have dropped.
    download || { update && find_newest && download; } || {
        cat download.log >&2
        fail "the packages of linux-image-$release cannot be downloaded"
    }
    ready=$cache/$version-$release
    build
    collect
    # Kernels from before would never be looked at again.
    rm -rf "${cache:?}"/[0-9]*
    mv ready "$ready"
fi
echo "$ready"
