#!/bin/sh
# Sets up .venv with pinned packages, and a Vulkan driver that SAPIEN accepts when this machine has none.
# Usage: scripts/setup.sh [dev|torch]     PYTHON=python3.12 chooses the interpreter.
#   dev    also what `make test` needs: all that is light, Chromium by apt, an emulated headset by npm
#   torch  .venv-torch, with what `make test-torch` needs: PyTorch, ManiSkill, Ray, Open3D (4 GB).
#          PyPI's PyTorch for Linux on x86-64 brings CUDA, 3 GB more; where pip is offered the build for processors,
#          `2.13.0+cpu`, it takes that: PIP_FIND_LINKS=FOLDER with its wheel, or PIP_EXTRA_INDEX_URL=INDEX
set -eu
cd "$(dirname "$0")/.."
extras="${1:+[$1]}"
venv=.venv
if [ "${1:-}" = torch ]; then extras="[test-torch]"; venv=.venv-torch; fi
stamp="$venv/.installed${1:+-$1}"

as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
apt_install() { as_root env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends "$@" >/dev/null; }
has() { command -v "$1" >/dev/null 2>&1; }

python="${PYTHON:-}"
if [ -z "$python" ]; then
    for candidate in python3.11 python3.12 python3.10 python3; do
        if has "$candidate"; then python="$candidate"; break; fi
    done
fi
[ -n "$python" ] || { echo "setup: no Python found, expected 3.10 to 3.12" >&2; exit 1; }

if [ ! -x $venv/bin/python ]; then
    if ! "$python" -c 'import ensurepip' 2>/dev/null; then
        has apt-get || { echo "setup: $python cannot make a venv, and there is no apt-get" >&2; exit 1; }
        as_root apt-get -qq update
        apt_install python3-venv
    fi
    "$python" -m venv $venv
fi

if [ ! -f "$stamp" ] || [ pyproject.toml -nt "$stamp" ] || [ constraints.txt -nt "$stamp" ]; then
    $venv/bin/python -m pip install --quiet -c constraints.txt -e ".$extras"
    # sapien asks for OpenCV's build with windows, whose files need libGL; the headless build must be written last
    $venv/bin/python -m pip install --quiet --force-reinstall --no-deps -c constraints.txt opencv-python-headless
    touch "$stamp"
fi

if [ "${1:-}" = dev ]; then
    if ! has chromium && ! has chromium-browser && ! has google-chrome && has apt-get; then
        echo "setup: installing Chromium for the tests of pages"
        as_root apt-get -qq update
        apt_install chromium
    fi
    if ! has npm && has apt-get; then
        as_root apt-get -qq update
        apt_install nodejs npm
    fi
    if has npm && [ ! -d node_modules/iwer ]; then
        npm install --silent --no-save --no-package-lock iwer@2.5.0
    fi
fi

if [ "${1:-}" = torch ] && ! $venv/bin/python -c 'import open3d' 2>/dev/null && has apt-get; then
    as_root apt-get -qq update
    apt_install libusb-1.0-0 libgl1 libgomp1
fi

renders() { $venv/bin/python -c 'from freeart21.doctor import require_rendering; require_rendering()' 2>/dev/null; }
if ! renders && command -v apt-get >/dev/null; then
    echo "setup: installing a software Vulkan driver"
    codename="$(. /etc/os-release && echo "${VERSION_CODENAME:-}")"
    release=""
    if [ "$codename" = bookworm ]; then   # Debian 12's own Mesa 22.3 is too old for SAPIEN, its backports are not
        release="-t bookworm-backports"
        if ! grep -rqs bookworm-backports /etc/apt/sources.list /etc/apt/sources.list.d; then
            mirror="$(grep -rhosE 'https?://[^ ]*/debian/?( |$)' /etc/apt/sources.list /etc/apt/sources.list.d | head -n 1 | tr -d ' ')"
            echo "deb ${mirror:-http://deb.debian.org/debian} bookworm-backports main" |
                as_root tee /etc/apt/sources.list.d/bookworm-backports.list >/dev/null
        fi
    fi
    as_root apt-get -qq update
    # shellcheck disable=SC2086
    apt_install $release mesa-vulkan-drivers libx11-6
fi
renders || { $venv/bin/freeart21 doctor; exit 1; }
