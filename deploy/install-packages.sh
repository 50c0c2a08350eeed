#!/bin/sh
# Installs the Debian or Ubuntu packages named as arguments that are missing, and says which.
set -eu

missing=
for package in "$@"; do
    dpkg-query --show --showformat='${db:Status-Status}\n' "$package" 2>/dev/null | grep -qx installed ||
        missing="$missing $package"
done
# Python from elsewhere than Debian serves as well.
if python3 -m pip --version >/dev/null 2>&1; then
    missing=$(printf '%s' "$missing" | sed -E 's/ python3(-pip)?( |$)/\2/g; s/ python3(-pip)?( |$)/\2/g')
fi
[ -n "$(echo $missing)" ] || exit 0

if ! command -v apt-get >/dev/null; then
    echo "install-packages: please install these packages, or what your system calls them:$missing" >&2
    exit 1
fi
echo "Installing Debian packages:$missing"
as_root=
[ "$(id -u)" = 0 ] || as_root=sudo
# shellcheck disable=SC2086 # a list of words
$as_root apt-get update -qq && DEBIAN_FRONTEND=noninteractive $as_root apt-get install -y -qq $missing >/dev/null
