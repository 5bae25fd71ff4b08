#!/bin/sh
# Sets up everything that vntoolkit needs on Debian and Ubuntu: system libraries (when it may install them,
# else it prints the line that does), a virtual environment in .venv, and the locked Python packages.
set -eu
cd "$(dirname "$0")/.."

python=${PYTHON3:-python3}
wanted=""

has_library() { { /sbin/ldconfig -p 2>/dev/null || ldconfig -p; } | grep -q "$1"; }

command -v "$python" >/dev/null 2>&1 || wanted="$wanted python3"
"$python" -c 'import venv, ensurepip' >/dev/null 2>&1 || wanted="$wanted python3-venv"
# open3d needs the first four, pymeshlab the last three; without libOpenGL it cannot save a .ply file.
# vntoolkit/libraries.py holds the same list.
has_library libGL.so.1 || wanted="$wanted libgl1"
has_library libEGL.so.1 || wanted="$wanted libegl1"
has_library libusb-1.0.so.0 || wanted="$wanted libusb-1.0-0"
has_library libidn2.so.0 || wanted="$wanted libidn2-0"
has_library libOpenGL.so.0 || wanted="$wanted libopengl0"
has_library libcom_err.so.2 || wanted="$wanted libcom-err2"
has_library libp11-kit.so.0 || wanted="$wanted libp11-kit0"

if [ -n "$wanted" ]; then
    install="apt-get install -y --no-install-recommends$wanted"
    if ! command -v apt-get >/dev/null 2>&1; then
        echo "set-up: these system packages are missing, named as on Debian:$wanted" >&2
        echo "set-up: install them with your system's package manager, then run the same command again" >&2
        exit 1
    elif [ "$(id -u)" = 0 ]; then
        echo "set-up: installing$wanted"
        apt-get update -qq && DEBIAN_FRONTEND=noninteractive $install -qq >/dev/null
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        echo "set-up: installing$wanted"
        sudo apt-get update -qq && sudo DEBIAN_FRONTEND=noninteractive $install -qq >/dev/null
    else
        echo "set-up: system packages are missing and may not be installed from here. Run this, then try again:" >&2
        echo "    sudo apt-get update && sudo $install" >&2
        exit 1
    fi
fi

if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
    echo "set-up: Python 3.11 or newer is needed, this is $("$python" --version 2>&1);" >&2
    echo "set-up: install a newer one and name it: PYTHON3=python3.12 make demo" >&2
    exit 1
fi

# 3.0 GB of packages and 0.9 GB that pip unpacks on the way.
free_gb=$(df -Pk . | awk 'NR == 2 { print int($4 / 1000000) }')
if [ ! -x .venv/bin/python ] && [ "$free_gb" -lt 5 ]; then
    echo "set-up: 5 GB of disk are needed for the Python packages, $free_gb GB are free in $(pwd)" >&2
    echo "set-up: free some space or move the checkout to another disk, then run the same command again" >&2
    exit 1
fi

[ -x .venv/bin/python ] || "$python" -m venv .venv
echo "set-up: installing the locked Python packages into .venv (about 3.0 GB, once)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
# the build backend is one of the locked packages: with isolation pip would fetch the newest one, unpinned
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
echo "set-up: compiling loops (a minute or two, once)"
.venv/bin/python scripts/compile_loops.py 2>/dev/null ||
    echo "set-up: some loops were not compiled; the first commands will do it" >&2
