#!/usr/bin/env bash
# make_root.sh ROOT: a small Debian root with Mesa's Vulkan drivers of AMD and NVIDIA, the libraries
# that answer them in the kernel's place, and the program that asks them about a shader. Needs to be
# root, a registry of Debian and a gigabyte. Does nothing where the root is there.
set -euo pipefail
root=$1
here=$(cd "$(dirname "$0")" && pwd)
if [ ! -d "$root/usr/share/vulkan/icd.d" ]; then
    if ! command -v mmdebstrap >/dev/null || ! command -v gcc >/dev/null; then
        apt-get update -q >/dev/null
        DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends \
            mmdebstrap gcc libc6-dev libvulkan-dev debian-archive-keyring >/dev/null
    fi
    # The registry that this machine uses.
    registry=$(cat /etc/apt/sources.list.d/*.sources 2>/dev/null | sed -n 's/^URIs: *//p' | head -1)
    registry=${registry:-$(awk '/^deb /{print $2; exit}' /etc/apt/sources.list)}
    mkdir -p "$(dirname "$root")"
    rm -rf "$root.part"
    # Mesa of the backports: that of the release itself knows neither compiler's statistics well.
    mmdebstrap --quiet --variant=essential --aptopt='APT::Default-Release "trixie-backports"' \
        --include=libvulkan1,mesa-vulkan-drivers,mesa-drm-shim trixie "$root.part" \
        "deb $registry trixie main" "deb $registry trixie-backports main"
    rm -rf "$root"
    mv "$root.part" "$root"
fi
if [ ! -x "$root/relight-statistics" ] || [ "$here/statistics.c" -nt "$root/relight-statistics" ]; then
    gcc -O1 -Wall -Wextra -o "$root/relight-statistics.part" "$here/statistics.c" -l:libvulkan.so.1
    mv "$root/relight-statistics.part" "$root/relight-statistics"
fi
