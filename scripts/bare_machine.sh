#!/bin/sh
# Tries this checkout on a bare machine: the smallest Debian or Ubuntu that debootstrap makes, `make` and Python.
#
#     scripts/bare_machine.sh SUITE [STEP ...]       such as  scripts/bare_machine.sh trixie demo
#
# SUITE is bookworm, trixie, noble, resolute or their like. Steps: demo and test are what `make` calls so; wheel
# installs the wheel with pip alone and works in an empty folder; walk goes as a newcomer from such an install to
# the mesh of a folder of photographs, and prints its time. Without any: demo test. Packages come from where
# this machine's own apt and pip fetch theirs. Needs root; leaves nothing behind. The steps are stopped
# after LIMIT_S seconds, by default two hours.
# Exit status: 0 all well, 1 a step failed, 77 it cannot be tried here (the reason is the last line).
set -eu
cd "$(dirname "$0")/.."

skip() { echo "bare machine: skipped, $*"; exit 77; }

if [ "${1:-}" != inside ]; then
    suite=${1:?usage: scripts/bare_machine.sh SUITE [demo] [test] [wheel] [walk]}
    shift
    [ "$(id -u)" = 0 ] || skip "only root can make one"
    free_gb=$(df -Pk "${TMPDIR:-/tmp}" | awk 'NR == 2 { print int($4 / 1000000) }')
    [ "$free_gb" -ge 6 ] || skip "it takes 6 GB of ${TMPDIR:-/tmp}, where $free_gb GB are free"
    command -v apt-get >/dev/null || skip "this machine has no apt-get, whose mirrors it would use"
    if ! command -v debootstrap >/dev/null; then
        { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq debootstrap; } >/dev/null 2>&1 ||
            skip "debootstrap is not installed and apt-get cannot install it"
    fi
    eval "$(apt-config shell http_proxy Acquire::http::Proxy)"
    [ -z "${http_proxy:-}" ] || export http_proxy
    root=$(mktemp -d "${TMPDIR:-/tmp}/bare-$suite.XXXXXX")
    chmod 755 "$root"  # apt fetches as a user of its own
    trap 'rm -rf "$root"' EXIT
    trap 'exit 130' INT TERM

    # The suite lies in the repository that apt uses, or, another distribution's, beside it on the same mirror.
    mirror=""
    for configured in $(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' | sort -u); do
        for name in debian ubuntu; do
            candidate=$(dirname "$configured")/$name
            if [ -z "$mirror" ] && wget -q -T 20 -t 2 -O "$root.release" "$candidate/dists/$suite/Release"; then
                mirror=$candidate
            fi
        done
    done
    [ -n "$mirror" ] || { rm -f "$root.release"; skip "the mirrors of this machine's apt have no $suite"; }
    case $(sed -n 's/^Origin: //p' "$root.release") in
        Ubuntu) script=gutsy components=main,universe keyring=/usr/share/keyrings/ubuntu-archive-keyring.gpg ;;
        *) script=sid components=main keyring=/usr/share/keyrings/debian-archive-keyring.gpg ;;
    esac
    rm -f "$root.release"
    signed=--no-check-gpg  # a machine of one distribution seldom has the keys of the other
    [ ! -e "$keyring" ] || signed=--keyring=$keyring

    began=$(date +%s)
    if ! debootstrap --variant=minbase --components=$components "$signed" --include=make,python3 \
        "$suite" "$root" "$mirror" "/usr/share/debootstrap/scripts/$script" >"$root/debootstrap.log" 2>&1; then
        tail -n 5 "$root/debootstrap.log"
        echo "bare machine $suite: debootstrap failed"
        exit 1
    fi
    echo "bare machine $suite: $(chroot "$root" python3 --version), bootstrapped in $(($(date +%s) - began)) s"

    mkdir "$root/checkout" "$root/host"
    git ls-files -z --cached --others --exclude-standard | tar --create --null --files-from=- |
        tar --extract --directory="$root/checkout" --no-same-owner
    # What is mounted goes with the last process of these name spaces, so that `rm` cannot reach through it.
    [ $# -gt 0 ] || set -- demo test
    # The first process of a name space hears no TERM: KILL it is.
    timeout --signal=KILL "${LIMIT_S:-7200}" unshare --mount --pid --fork --kill-child sh scripts/bare_machine.sh inside "$suite" "$root" "$@"
    exit
fi

suite=$2 root=$3
shift 3
mount --make-rprivate /
mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys"
mkdir -p "$root/dev/shm"
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
mkdir -p "$root/dev/pts"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
cp /etc/hosts "$root/etc/hosts"

# pip finds packages as it does on this machine; the files that its configuration names are in /host.
host_python=python3
[ ! -x .venv/bin/python ] || host_python=.venv/bin/python
"$host_python" - "$root" <<'PYTHON'
import ast, configparser, pathlib, subprocess, sys

WHERE_PACKAGES_ARE = {
    "index-url", "extra-index-url", "find-links", "no-index", "trusted-host", "proxy", "cert", "client-cert",
    "constraint", "timeout", "default-timeout", "retries",
}
root = pathlib.Path(sys.argv[1])
listed = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True).stdout
options = {}
for line in sorted(listed.splitlines(), key=lambda line: line.startswith(":env:")):  # as pip: these win
    name, _, value = line.partition("=")
    key = name.rpartition(".")[2]
    if key in WHERE_PACKAGES_ARE:
        options[key] = ast.literal_eval(value)
for key, value in options.items():
    words = value.split()
    for number, word in enumerate(words):
        path = pathlib.Path(word.removeprefix("file://"))
        if not path.is_absolute() or not path.exists():
            continue
        # The pages of an index may point to files beside it.
        shared = path.parent if key.endswith("index-url") else path
        seen = root / "host" / f"{key}-{number}"
        seen.mkdir() if shared.is_dir() else seen.touch()
        subprocess.run(["mount", "--bind", shared, seen], check=True)
        words[number] = word.replace(str(shared), f"/{seen.relative_to(root)}", 1)
    options[key] = " ".join(words)
configuration = configparser.RawConfigParser()
configuration["global"] = options
with (root / "etc/pip.conf").open("w") as file:
    configuration.write(file)
PYTHON

within() {
    env -i PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 \
        ${http_proxy:+http_proxy="$http_proxy"} chroot "$root" sh -euc "$1"
}

# As the README says it under "With pip alone"; then the commands of someone who has no checkout.
install='
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-venv \
        $(sed -n "s/^sudo apt-get install //p" /checkout/README.md) >/dev/null
    rm -rf /venv /dist /empty
    python3 -m venv /venv
    /venv/bin/pip wheel --quiet --no-deps --wheel-dir /dist /checkout
    /venv/bin/pip install --quiet /dist/*.whl
    mkdir /empty
    cd /empty
    PATH=/venv/bin:$PATH
'
wheel="$install"'
    vntoolkit doctor
    vntoolkit demo --out demo
    vntoolkit recipe run figure02 --quick
    vntoolkit track demo/reconstruction
    vntoolkit dress demo/reconstruction/track --motion data/walk.bvh --out cloth.usdc
    for part in "rest 0:1" "presses 1:13" "touch 37:40"; do
        set -- $part
        vntoolkit simulate gel --out "$1" --frames "$2" --size 320x240 --samples 1
    done
    vntoolkit calibrate presses presses/capture.mkv --background rest/capture.mkv --ball-radius-mm 2.4 \
        --pixel-mm 0.05 --out gel.json
    vntoolkit reconstruct touch/capture.mkv --rig gel.json --background rest/capture.mkv --to depth --out touched
    cat touched/contact.csv
'
# The photographs are rendered first; that is not in the time.
walk='
    began=$(date +%s)
'"$install"'
    installed=$(date +%s)
    vntoolkit simulate board --frames ::10 --out given/board
    vntoolkit simulate sweater --frames 0:3 --out given/sweater
    for scene in board sweater; do
        mkdir "$scene"
        python -c "
import av, sys
for k, frame in enumerate(av.open(sys.argv[1]).decode(video=0)):
    frame.to_image().save(f\"{sys.argv[2]}/IMG_{k:04}.png\")" given/$scene/capture.mkv $scene
    done
    filmed=$(date +%s)
    vntoolkit doctor sweater
    vntoolkit calibrate board board --square-mm 16 --out rig.json
    vntoolkit reconstruct sweater --rig rig.json --to mesh --out result --distance 5
    vntoolkit report result
    vntoolkit export result --to obj --out meshes
    ls meshes
    echo "walk: installed in $((installed - began)) s, first mesh $(($(date +%s) - filmed)) s later"
'
version=$(within 'python3 --version')
for step in "$@"; do
    began=$(date +%s)
    case $step in
        wheel) commands=$wheel ;;
        walk) commands=$walk ;;
        *) commands="cd /checkout && make $step" ;;
    esac
    fate="passed"
    within "$commands" </dev/null || fate="FAILED"
    echo "bare machine $suite, $version: $step $fate in $(($(date +%s) - began)) s"
    [ "$fate" = passed ] || exit 1
done
