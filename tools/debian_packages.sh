#!/usr/bin/env bash
# Sees to the Debian packages that the Python wheels load but do not carry.
# As root it installs the missing ones; otherwise it prints the apt line to run and stops.
# With the argument `tests` it also installs the browser that a test of the report uses.
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"

for_bpy=(libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1)
for_open3d=(libegl1 libusb-1.0-0)
for_tests=(chromium) # opens the evaluation's report; its test is skipped without a browser

if ! command -v dpkg-query >/dev/null || ! command -v apt-get >/dev/null; then
    echo "note: not a Debian system; bpy and open3d need what Debian calls" \
        "${for_bpy[*]} ${for_open3d[*]}"
    exit 0
fi

missing=()
wanted=("${for_bpy[@]}" "${for_open3d[@]}")
# Nobody is asked to type a line for what only a test wants.
if [[ "${1:-}" == tests && "$(id -u)" -eq 0 ]]; then
    wanted=("${for_tests[@]}" "${wanted[@]}")
fi
for package in "${wanted[@]}"; do
    # One line an architecture; any installed one counts.
    if ! grep -qx installed < <(dpkg-query -W -f='${db:Status-Status}\n' "$package" 2>/dev/null); then
        missing+=("$package")
    fi
done

# Debian splits the part of Python that makes virtual environments into a package of its own.
if [[ ! -x "${VENV:-.venv}/bin/python" ]]; then
    if python="$("$here/find_python.sh" 2>/dev/null)"; then
        "$python" -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3.11-venv)
    elif grep -q '^VERSION_CODENAME=bookworm' "${OS_RELEASE:-/etc/os-release}" 2>/dev/null; then
        missing+=(python3.11-venv) # brings python3.11 itself
    fi
fi

if [[ ${#missing[@]} -eq 0 ]]; then
    exit 0
fi
line="apt-get install -y --no-install-recommends ${missing[*]}"
if [[ "$(id -u)" -ne 0 ]]; then
    echo "error: Debian packages are missing; run this line, then make setup again:" >&2
    echo "    sudo $line" >&2
    exit 2
fi
echo "Installing Debian packages: ${missing[*]}"
export DEBIAN_FRONTEND=noninteractive
if ! { apt-get update -q && $line; }; then
    echo "error: apt-get failed (see above); mend it, then run by hand: $line" >&2
    exit 2
fi
