#!/bin/bash
# Builds a MicroPython image for the RP2040 from the sources of Debian 13 (trixie), on any recent Debian.
#
# usage: build_image.sh FOLDER       leaves FOLDER/RPI_PICO-<version>.bin; nothing to do if it is there
#
# Takes about 3 minutes. The packages of the other suite are fetched through an apt state of their own in
# FOLDER; the system's sources are not touched. Needs: dpkg-dev cmake make python3 and Debian 12's or
# 13's gcc-arm-none-eabi with libnewlib-arm-none-eabi and libstdc++-arm-none-eabi-newlib.
set -euo pipefail
folder=${1:?a folder for the image}
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
version=1.25.0
image=$folder/RPI_PICO-debian-$version.bin
if [ -s "$image" ]; then echo "$image"; exit 0; fi

work=$folder/build
rm -rf "$work"
mkdir -p "$work/apt/lists/partial" "$work/apt/cache/archives/partial"
cd "$work"

# an apt state of its own, with the mirror that this system uses
mirror=$(sed -n 's/^URIs: *//p' /etc/apt/sources.list.d/debian.sources 2>/dev/null | head -1)
if [ -z "$mirror" ]; then mirror=$(sed -n 's/^deb \(\[[^]]*\] *\)\?\([^ ]*\).*/\2/p' /etc/apt/sources.list | head -1); fi
key=/usr/share/keyrings/debian-archive-keyring.gpg
for kind in deb deb-src; do echo "$kind [signed-by=$key] $mirror trixie main"; done > suite.list
chmod 755 "$work"; chmod 644 suite.list
suite() {
    "$@" -o Dir::Etc::sourcelist="$work/suite.list" -o Dir::Etc::sourceparts=/dev/null \
        -o Dir::State::lists="$work/apt/lists" -o Dir::Cache="$work/apt/cache" \
        -o Dir::State::status=/dev/null -o APT::Sandbox::User="$(id -un)" -qq \
        -o Acquire::Retries=5 -o APT::Update::Error-Mode=any
}
# a mirror may refuse for a moment, and apt's own retries follow each other at once; what is fetched stays
patiently() {
    for pause_s in 5 15 45; do
        if "$@" >&2; then return; fi
        echo "again in $pause_s s" >&2
        sleep "$pause_s"
    done
    "$@" >&2
}
echo "fetching sources" >&2
# without Error-Mode an index that could not be fetched is a warning only, and the sources are missed below
patiently suite apt-get update
patiently suite apt-get source --download-only micropython mbedtls
patiently suite apt-get download pico-sdk-source tinyusb-source
dpkg-source --no-check -x micropython_*.dsc micropython > /dev/null
dpkg-source --no-check -x mbedtls_*.dsc mbedtls > /dev/null
for deb in ./*.deb; do dpkg-deb -x "$deb" root; done

# Debian's source has empty folders where these libraries belong, and the build asks for two files to be there
lib=micropython/lib
for name in pico-sdk tinyusb mbedtls; do rm -rf "${lib:?}/$name"; done
mv root/usr/src/pico-sdk root/usr/src/tinyusb mbedtls $lib/
touch $lib/pico-sdk/README.md $lib/tinyusb/README.rst $lib/mbedtls/README.md $lib/micropython-lib/README.md
printf 'freeze("$(PORT_DIR)/modules")\ninclude("$(MPY_DIR)/extmod/asyncio")\n' > manifest.py

echo "building" >&2
jobs=$(nproc)
make -s -C micropython/mpy-cross -j"$jobs" > mpy-cross.log 2>&1
cmake -S micropython/ports/rp2 -B out -DMICROPY_BOARD=RPI_PICO -DPICO_NO_PICOTOOL=1 \
    -DMICROPY_FROZEN_MANIFEST="$work/manifest.py" > cmake.log 2>&1
make -s -C out -j"$jobs" > make.log 2>&1
python3 - "$work/out" "$image" <<'PYTHON'
import pathlib, sys
built = max(pathlib.Path(sys.argv[1]).glob("firmware*.bin"))
image = pathlib.Path(sys.argv[2])
part = image.with_suffix(".part")
part.write_bytes(built.read_bytes())
part.replace(image)
PYTHON
cd "$folder"
rm -rf "$work"
echo "$image"
